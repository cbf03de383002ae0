"""Labels points as moving (1) or not (0) with dufomap: label.py POINTS.f64 LABELS.u8 X,Y,Z...

POINTS.f64 holds x, y, z and the number of the station of each point as little-endian 64-bit floats; each X,Y,Z is a station.
"""

import sys

import numpy as np
from dufomap import dufomap

points = np.fromfile(sys.argv[1], dtype="<f8").reshape(-1, 4)
stations = np.array([[float(v) for v in place.split(",")] for place in sys.argv[3:]])
labels = np.zeros(len(points), dtype=np.uint8)
clouds = [np.flatnonzero(points[:, 3] == number) for number in range(len(stations))]
poses = [[*map(float, place), 1.0, 0.0, 0.0, 0.0] for place in stations]
peer = dufomap(0.1, 0.2, 1, num_threads=2)
peer.setCluster(0, 20, 0.2)
for cloud, pose in zip(clouds, poses):
    peer.run(points[cloud, :3].astype(np.float32), pose, cloud_transform=False)
peer.oncePropagateCluster(False, False)
for cloud, pose in zip(clouds, poses):
    labels[cloud] = np.asarray(peer.segment(points[cloud, :3].astype(np.float32), pose, cloud_transform=False)).ravel()
labels.tofile(sys.argv[2])
