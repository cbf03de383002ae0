"""Prints the bytes of cubes in Draco: integers of three axes (int32) come on standard input.

Its densest setting for points: the k-d tree at compression level 7, on a grid of exactly the cubes.
"""

import sys

import DracoPy
import numpy as np

cubes = np.frombuffer(sys.stdin.buffer.read(), dtype=np.int32).reshape(-1, 3)
cubes = cubes - cubes.min(axis=0)
bits = int(cubes.max()).bit_length()
coded = DracoPy.encode(
    cubes.astype(np.float32),
    quantization_bits=bits,
    quantization_range=float(2**bits - 1),
    quantization_origin=[0.0, 0.0, 0.0],
    compression_level=7,
    create_metadata=False,
)
again = np.rint(DracoPy.decode(coded).points).astype(np.int32)


def ordered(points):
    return points[np.lexsort(points.T)]


if not np.array_equal(ordered(again), ordered(cubes)):
    sys.exit("Draco lost cubes")
print(len(coded))
