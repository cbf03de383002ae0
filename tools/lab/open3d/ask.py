"""Answers the questions of `bench peers` with Open3D: rays by `RaycastingScene`, places by `VoxelGrid`.

usage: ask.py FOLDER EDGE

FOLDER holds cubes.bin (int32), vertices.bin (float32), triangles.bin (uint32), points.bin and rays.bin (float64). Every line of
standard input, KIND COUNT, asks the first COUNT questions in one call of the library, on one thread, with everything converted
beforehand: so Python's own time is that of one call. Answers go to answers.bin (float64), the call's seconds to standard output.
"""

import sys
import time
from pathlib import Path

import numpy as np
import open3d as o3d

folder, edge = Path(sys.argv[1]), float(sys.argv[2])


def read(name, kind, width):
    return np.fromfile(folder / f"{name}.bin", dtype=kind).reshape(-1, width)


cubes = read("cubes", np.int32, 3)
# The grid rounds places down from its least corner.
low = cubes.min(axis=0) * edge
high = (cubes.max(axis=0) + 1) * edge
centers = o3d.geometry.PointCloud(o3d.utility.Vector3dVector((cubes + 0.5) * edge))
grid = o3d.geometry.VoxelGrid.create_from_point_cloud_within_bounds(centers, edge, low, high)
scene = o3d.t.geometry.RaycastingScene(nthreads=1)
scene.add_triangles(
    o3d.core.Tensor(read("vertices", np.float32, 3)), o3d.core.Tensor(read("triangles", np.uint32, 3))
)
points = read("points", np.float64, 3)
rays = read("rays", np.float64, 7)
print(o3d.__version__, flush=True)

for line in sys.stdin:
    kind, count = line.split()
    count = int(count)
    if kind == "points":
        asked = o3d.utility.Vector3dVector(points[:count])
        start = time.perf_counter()
        found = grid.check_if_included(asked)
        seconds = time.perf_counter() - start
        answers = np.asarray(found, dtype=np.float64)
    else:
        asked = o3d.core.Tensor(rays[:count, :6].astype(np.float32))
        start = time.perf_counter()
        found = scene.cast_rays(asked, nthreads=1)
        seconds = time.perf_counter() - start
        answers = found["t_hit"].numpy().astype(np.float64)
        answers[answers > rays[:count, 6]] = np.inf
    answers.tofile(folder / "answers.bin")
    print(seconds, flush=True)
