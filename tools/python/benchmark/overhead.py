"""Time a conversion on a local cluster against the same parts run by hand, alternating, and print the ratio.

python benchmark/overhead.py FOLDER [TILES] [MILLIONS] [ROUNDS]

Both use two processes of one thread, the same plan and the same parts. By hand, each process takes the next free part,
then one of them merges and verifies. FOLDER receives TILES LAZ tiles of MILLIONS million points each, of rough ground
with about one point per voxel, and keeps them: 36 tiles of 10 million points, 2.5 GB, keep two cores busy for two
minutes. Needs laspy with lazrs.
"""

from __future__ import annotations

import multiprocessing
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path

import laspy
import numpy as np
from distributed import Client, LocalCluster

import slicewalk
import slicewalk.cluster

PARTS = 24
MEMORY = "256MiB"
SIDE = 300.0
OPTIONS = {"pixel": 0.1, "units": "m"}


def make(folder: Path, tiles: int, millions: int) -> list[Path]:
    """Write rough ground as adjacent tiles, six in a row; keep tiles that exist."""
    paths = [folder / f"{millions}m-{number:03}.laz" for number in range(tiles)]
    for number, path in enumerate(paths):
        if path.exists():
            continue
        random = np.random.default_rng(number)
        x, y = random.uniform(0, SIDE, (2, millions * 1_000_000))
        x += SIDE * (number % 6)
        y += SIDE * (number // 6)
        header = laspy.LasHeader(version="1.2", point_format=0)
        header.scales, header.offsets = np.full(3, 0.001), np.zeros(3)
        cloud = laspy.LasData(header)
        cloud.x, cloud.y = x, y
        cloud.z = 20 * np.sin(x / 90) * np.cos(y / 70) + random.normal(0, 0.02, len(x))
        part = path.with_suffix(".part.laz")
        cloud.write(part)
        part.rename(path)
    return paths


def convert_parts(folder: Path, paths: list[Path], numbers: multiprocessing.Queue[int | None]) -> None:
    """Convert parts until none is left."""
    while (number := numbers.get()) is not None:
        target = folder / f"{number}.slices"
        slicewalk.convert(
            paths, target, plan=folder / "plan.json", shard=(number, PARTS), memory=MEMORY, threads=1, quiet=True
        )


def by_hand(folder: Path, paths: list[Path]) -> float:
    """Return the seconds of plan, parts by two processes, merge and check."""
    started = time.perf_counter()
    slicewalk.write_plan(paths, folder / "plan.json", memory=MEMORY, quiet=True, **OPTIONS)
    context = multiprocessing.get_context("spawn")
    numbers = context.Queue()
    for number in [*range(1, PARTS + 1), None, None]:
        numbers.put(number)
    processes = [context.Process(target=convert_parts, args=(folder, paths, numbers)) for _ in range(2)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    if any(process.exitcode for process in processes):
        sys.exit("a part failed")
    whole = folder / "by-hand.slices"
    slicewalk.merge([folder / f"{number}.slices" for number in range(1, PARTS + 1)], whole)
    if slicewalk.open(whole).verify():
        sys.exit("the archive is damaged")
    return time.perf_counter() - started


def on_cluster(folder: Path, paths: list[Path]) -> float:
    """Return the seconds of the same work on a running cluster."""
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        started = time.perf_counter()
        slicewalk.cluster.convert(
            paths, folder / "cluster.slices", client, parts=PARTS, memory=MEMORY, quiet=True, **OPTIONS
        )
        return time.perf_counter() - started


def main() -> None:
    """Convert alternately and print medians."""
    folder = Path(sys.argv[1])
    tiles, millions, rounds = (int(one) for one in [*sys.argv[2:], *("36", "10", "3")[len(sys.argv) - 2 :]])
    folder.mkdir(exist_ok=True)
    paths = make(folder, tiles, millions)
    hand, cluster = [], []
    for number in range(rounds):
        with tempfile.TemporaryDirectory(dir=folder) as name:
            work = Path(name)
            both = [(by_hand, hand), (on_cluster, cluster)]
            for run, seconds in both if number % 2 == 0 else reversed(both):
                seconds.append(run(work, paths))
            if (work / "by-hand.slices").read_bytes() != (work / "cluster.slices").read_bytes():
                sys.exit("the archives differ")
            shutil.rmtree(work / "dask-scratch-space", ignore_errors=True)
        print(f"round {number + 1}: by hand {hand[-1]:.1f} s, on the cluster {cluster[-1]:.1f} s", flush=True)
    ratios = [a / b for a, b in zip(cluster, hand, strict=True)]
    print(f"{tiles} tiles, {PARTS} parts: by hand {statistics.median(hand):.1f} s, the cluster takes ", end="")
    print(f"{statistics.median(ratios):.3f} times as long ({min(ratios):.3f} to {max(ratios):.3f})")


if __name__ == "__main__":
    main()
