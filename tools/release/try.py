"""Convert points with the installed package and ask for boxes; the argument is the version that it must have."""

from __future__ import annotations

import sys

import numpy as np

import slicewalk

assert slicewalk.__version__ == sys.argv[1], slicewalk.__version__
floor = np.random.default_rng(0).uniform(0, 4, (50_000, 3)) * (1, 1, 0)
archive = slicewalk.from_numpy(floor, "try.slices", pixel=0.1)
boxes = [[1, 1, -0.5, 1.5, 1.5, 0.5], [1, 1, 1, 1.5, 1.5, 2]]
assert archive.overlaps(boxes).tolist() == [slicewalk.HIT, slicewalk.CLEAR]
cubes = slicewalk.to_octomap(archive, "try.bt")
assert slicewalk.convert("try.bt", "again.slices")["cubes_read"] > 0
print(f"wheel: {archive.voxels} voxels, {cubes} cubes")
