"""Draw a storey: floor, obstacles, the area one can walk in, and the longest route in it.

python storey.py SCAN.laz
"""

from __future__ import annotations

import sys

import numpy as np

import slicewalk

try:
    import matplotlib as mpl
except ImportError:
    sys.stderr.write("this example needs matplotlib: pip install matplotlib\n")
    sys.exit(3)
mpl.use("Agg")
import matplotlib.pyplot as plt


def free_place(archive: slicewalk.Archive, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Find a place where a person can stand."""
    at = np.random.default_rng(0).uniform(low[:2], high[:2], (10_000, 2))
    count = len(at)
    column = np.column_stack([at - 0.25, np.full(count, -np.inf), at + 0.25, np.full(count, low[2] + 1)])
    feet = np.column_stack([at, archive.floor(column)])
    feet = feet[np.isfinite(feet[:, 2])]
    boxes = np.column_stack([feet - (0.25, 0.25, -0.3), feet + (0.25, 0.25, 1.8)])
    free = feet[archive.overlaps(boxes) == slicewalk.CLEAR]
    if not len(free):
        sys.exit("nobody can stand in this scan")
    place: np.ndarray = free[len(free) // 2]
    return place


def main() -> None:
    """Convert, walk, draw."""
    slicewalk.convert(sys.argv[1], "storey.slices", force=True, quiet=True)
    archive = slicewalk.open("storey.slices")
    bounds = archive.bounds
    if bounds is None:
        sys.exit("the scan has no points")
    low, high = bounds
    reach = archive.reach(free_place(archive, low, high))
    z = max(reach.storeys, key=lambda storey: storey.area).z
    region = archive.region([*low[:2], z - 0.3, *high[:2], z + 1.8])
    extent = (region.x[0], region.x[-1], region.y[0], region.y[-1])
    figure, axes = plt.subplots(figsize=(8, 8))
    axes.imshow(region.kind.max(axis=0), origin="lower", extent=extent, cmap="Greys", vmin=0, vmax=3)
    axes.scatter(reach.places[:, 0], reach.places[:, 1], c=reach.places[:, 3], s=1, cmap="viridis")
    ends = reach.places[[0, -1], :3]
    route = archive.route(ends[0], ends[1])
    axes.plot(route.points[:, 0], route.points[:, 1], color="tab:red")
    axes.set(title=f"{reach.area:.0f} m² to walk on", xlabel="x (m)", ylabel="y (m)", aspect="equal")
    figure.savefig("storey.png", dpi=150)
    print(f"storey.png: {reach.area:.1f} m², {len(reach.passages)} passages, a route of {route.length or 0:.1f} m")


if __name__ == "__main__":
    main()
