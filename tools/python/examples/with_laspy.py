"""Colour the points of a scan by whether a person can stand there: laspy in, laspy out.

python with_laspy.py SCAN.laz
"""

from __future__ import annotations

import sys

import numpy as np

import slicewalk

try:
    import laspy
except ImportError:
    sys.stderr.write("this example needs laspy: pip install laspy[lazrs]\n")
    sys.exit(3)


def main() -> None:
    """Write an archive from laspy's chunks, query it at every point, and classify the points."""
    scan = sys.argv[1]
    with laspy.open(scan) as reader, slicewalk.Writer("points.slices", pixel=0.05, force=True) as writer:
        for chunk in reader.chunk_iterator(1_000_000):
            writer.write(np.column_stack([chunk.x, chunk.y, chunk.z]))
    archive = slicewalk.open("points.slices")
    points = laspy.read(scan)
    xyz = points.xyz
    # A person of 0.5 × 0.5 × 1.8 m, standing 5 cm above the point.
    boxes = np.column_stack([xyz - (0.25, 0.25, -0.05), xyz + (0.25, 0.25, 1.8)])
    free = archive.overlaps(boxes) == slicewalk.CLEAR
    points.classification = np.where(free, 2, 1)
    points.write("standing.las")
    print(f"a person can stand on {free.sum()} of {len(free)} points; see standing.las (class 2)")


if __name__ == "__main__":
    main()
