"""Time 10⁶ boxes from Python against the library's batch, alternating on one thread, and print the ratio.

cargo build --release -p slicewalk-python --example rate
python benchmark/rate.py SCAN target/release/examples/rate
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import slicewalk

COUNT = 1_000_000
ROUNDS = 15


def boxes_in(bounds: np.ndarray, count: int) -> np.ndarray:
    """Return boxes of a pawn, 0.5 × 0.5 × 1.8 m, at random places."""
    random = np.random.default_rng(1)
    feet = random.uniform(bounds[0], bounds[1], (count, 3))
    return np.hstack([feet - (0.25, 0.25, 0), feet + (0.25, 0.25, 1.8)])


def main() -> None:
    """Time alternately and print medians."""
    scan, rate = sys.argv[1:]
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder, "scan.slices")
        slicewalk.convert(scan, target, pixel=0.05, quiet=True)
        archive = slicewalk.open(target)
        archive.load()
        boxes = boxes_in(archive.bounds, COUNT)
        raw = Path(folder, "boxes")
        raw.write_bytes(boxes.tobytes())
        peer = subprocess.Popen([rate, target, raw], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        own, other = [], []
        for _ in range(ROUNDS):
            started = time.perf_counter()
            answers = archive.overlaps(boxes, threads=1)
            own.append(time.perf_counter() - started)
            peer.stdin.write("\n")
            peer.stdin.flush()
            seconds, hits = peer.stdout.readline().split()
            other.append(float(seconds))
            if int(hits) != np.count_nonzero(answers == slicewalk.HIT):
                sys.exit("the answers differ")
        peer.stdin.close()
        peer.wait()
        started = time.perf_counter()
        archive.overlaps(boxes)
        many = time.perf_counter() - started
    ratios = [a / b for a, b in zip(other, own, strict=True)]
    print(f"{COUNT} boxes, one thread: Python {statistics.median(own) / COUNT * 1e9:.0f} ns a box,", end=" ")
    print(f"Rust {statistics.median(other) / COUNT * 1e9:.0f} ns a box; all cores {many / COUNT * 1e9:.0f} ns")
    print(f"rate: {statistics.median(ratios):.2f} of Rust's, of {ROUNDS} rounds {min(ratios):.2f} to {max(ratios):.2f}")
    print(f"load average: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
