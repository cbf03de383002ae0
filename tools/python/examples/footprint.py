"""Check where a robot fits: its footprint at 10⁶ places and headings of a scan.

python footprint.py SCAN.laz
"""

from __future__ import annotations

import sys
import time

import numpy as np

import slicewalk

LENGTH, WIDTH, HEIGHT = 0.6, 0.4, 0.5
"""The robot (m)."""
CLEARANCE = 0.05
"""The chassis clears ground up to this height (m)."""


def main() -> None:
    """Convert the scan, find the floor, and query all places at once."""
    scan = sys.argv[1]
    slicewalk.convert(scan, "footprint.slices", force=True, quiet=True)
    archive = slicewalk.open("footprint.slices")
    bounds = archive.bounds
    if bounds is None:
        sys.exit("the scan has no points")
    low, high = bounds
    random = np.random.default_rng(0)
    count = 1_000_000
    heading = random.uniform(0, 2 * np.pi, count)
    # The bounding box of the rotated footprint, never smaller than the robot.
    half = np.abs(np.stack([np.cos(heading), np.sin(heading)])) * LENGTH / 2
    half += np.abs(np.stack([np.sin(heading), np.cos(heading)])) * WIDTH / 2
    at = random.uniform(low[:2], high[:2], (count, 2))
    flat = np.hstack([at - half.T, at + half.T])
    floor = archive.floor(
        np.column_stack([flat[:, :2], np.full(count, low[2] - 1), flat[:, 2:], np.full(count, low[2] + 1)])
    )
    stands = np.isfinite(floor)
    feet, ground = flat[stands], floor[stands]
    boxes = np.column_stack([feet[:, :2], ground + CLEARANCE, feet[:, 2:], ground + HEIGHT])
    started = time.perf_counter()
    free = archive.overlaps(boxes) == slicewalk.CLEAR
    seconds = time.perf_counter() - started
    print(f"{stands.sum()} places have floor, the robot fits at {free.sum()} of them")
    print(f"{len(boxes)} boxes in {seconds:.2f} s, {seconds / max(len(boxes), 1) * 1e9:.0f} ns a box")


if __name__ == "__main__":
    main()
