"""Opens the exports of an archive in other readers and compares their contents: `check.py FOLDER`."""

import json
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import ezdxf
import laspy
import numpy as np
import pye57
import rasterio
import trimesh

PIXEL_M = 0.05
EPSG = 28992


def points_of_las(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions and classes."""
    scan = laspy.read(path)
    assert scan.header.parse_crs().to_epsg() == EPSG, path
    return np.asarray(scan.xyz), np.asarray(scan.classification)


def cubes_of_vrml(path: Path) -> dict[tuple[int, int, int], int]:
    """Lowest corners of occupied leaves (in cubes) as OctoMap's own program writes them, and their edges."""
    leaves = {}
    for block in path.read_text().split("Transform")[1:]:
        x, y, z, edge = map(float, re.findall(r"-?\d[\d.]*(?:e-?\d+)?", block)[:4])
        corner = (round((v - edge / 2) / PIXEL_M) for v in (x, y, z))
        leaves[tuple(corner)] = round(edge / PIXEL_M)
    return leaves


def main(folder: Path) -> None:
    """All exports of `house.slices`."""
    points, classes = points_of_las(folder / "house.las")
    again, _ = points_of_las(folder / "house.laz")
    assert np.array_equal(points, again)

    cloud = pye57.E57(str(folder / "house.e57")).read_scan(0, colors=True, ignore_missing_fields=True)
    found = np.column_stack([cloud[f"cartesian{axis}"] for axis in "XYZ"])
    assert found.shape == points.shape, (found.shape, points.shape)
    assert np.abs(found - points).max() < 1e-6
    print(f"libE57, laspy: {len(points):,} points")

    with rasterio.open(folder / "house.tif") as raster:
        assert raster.crs.to_epsg() == EPSG
        assert raster.res == (PIXEL_M, PIXEL_M)
        heights = raster.read(1)
        assert np.isnan(raster.nodata)
        floors = points[classes == 2]
        rows, columns = rasterio.transform.rowcol(raster.transform, floors[:, 0], floors[:, 1])
    highest = np.full_like(heights, -np.inf)
    np.maximum.at(highest, (np.asarray(rows), np.asarray(columns)), floors[:, 2])
    held = ~np.isnan(heights)
    # A voxel with a floor and an obstacle is one point with the class of obstacles. Points lie half a quantum (0.3 mm)
    # below the top.
    agree = np.isclose(heights[held], highest[held], rtol=0, atol=4e-4).mean()
    assert held.sum() > 10_000, held.sum()
    assert agree > 0.99, agree
    print(f"GDAL: {held.sum():,} heights, {agree:.2%} as the points")

    with rasterio.open(folder / "house_layers.tif") as raster:
        names = ("height", "slope", "roughness", "headroom", "clearance")
        assert raster.descriptions == names, raster.descriptions
        layers = dict(zip(names, raster.read(), strict=True))
    assert np.array_equal(layers["height"], heights, equal_nan=True)
    # Where all 3 × 3 floors lie within the climb height, their least-squares plane has a closed form.
    around = np.lib.stride_tricks.sliding_window_view(heights.astype(float), (3, 3))
    apart = np.abs(around - around[..., 1:2, 1:2]).max(axis=(2, 3))
    along = [around[..., 2].sum(-1) - around[..., 0].sum(-1), around[..., 2, :].sum(-1) - around[..., 0, :].sum(-1)]
    slopes = np.degrees(np.arctan(np.hypot(*along) / (6 * PIXEL_M)))
    whole = apart <= 0.35  # False where a pixel has no floor.
    assert whole.sum() > 10_000, whole.sum()
    assert np.allclose(slopes[whole], layers["slope"][1:-1, 1:-1][whole], atol=0.01)
    assert ((layers["clearance"][held] >= 0) & (layers["clearance"][held] <= 2)).all()

    distances = np.load(folder / "house.npy")
    assert distances.dtype == np.float32
    assert distances.shape == (50, 60, 80), distances.shape
    steps = max(np.abs(np.diff(distances, axis=axis)).max() for axis in range(3))
    assert steps <= PIXEL_M * 1.001, steps
    assert distances.min() < 0 < distances.max()
    print(f"numpy: {distances.size:,} distances from {distances.min():.3f} to {distances.max():.3f} m")

    drawing = ezdxf.readfile(folder / "house.dxf")
    assert not drawing.audit().errors
    lines = list(drawing.modelspace().query("POLYLINE"))
    assert lines
    assert {line.dxf.layer for line in lines} <= {"obstacles", "floors"}
    assert all(line.is_closed for line in lines)
    corners = np.array([vertex.dxf.location.xyz for line in lines for vertex in line.vertices])
    assert (corners[:, :2] >= points[:, :2].min(axis=0) - PIXEL_M).all()
    assert (corners[:, :2] <= points[:, :2].max(axis=0) + PIXEL_M).all()
    print(f"ezdxf: {len(lines)} polylines")

    svg = ET.parse(folder / "house.svg").getroot()  # noqa: S314
    assert svg.get("width", "").endswith("mm")

    scene = trimesh.load(folder / "house.glb")
    surface = scene.to_geometry()
    # glTF is y-up.
    size = np.ptp(points, axis=0)[[0, 2, 1]]
    assert np.allclose(np.ptp(surface.vertices, axis=0), size, atol=0.2), (surface.extents, size)
    assert surface.volume > 0
    print(f"trimesh: {len(surface.faces):,} triangles, {surface.volume:.1f} m³")

    vrml = folder / "house.bt.wrl"
    if vrml.exists():
        leaves = cubes_of_vrml(vrml)
        cubes = {
            (x + a, y + b, z + c)
            for (x, y, z), edge in leaves.items()
            for a in range(edge)
            for b in range(edge)
            for c in range(edge)
        }
        # Points lie half a quantum (0.3 mm) below the top, which may be the lower end of a cube.
        ways = [np.floor((points + [0, 0, above]) / PIXEL_M).astype(int) for above in (0.0, 4e-4)]
        assert all(tuple(a) in cubes or tuple(b) in cubes for a, b in zip(*ways, strict=True))
        head = json.loads((folder / "house.voxel.json").read_text())
        ends = np.array([head["sceneBounds"]["min"], head["sceneBounds"]["max"]]) / PIXEL_M
        low, high = np.min(list(cubes), axis=0), np.max(list(cubes), axis=0) + 1
        assert np.allclose(ends, [[low[0], low[2], -high[1]], [high[0], high[2], -low[1]]]), (ends, low, high)
        solid = set(map(tuple, np.loadtxt(folder / "house.voxel.txt", dtype=int).tolist()))
        assert solid == cubes, (len(solid), len(cubes))
        print(f"SuperSplat: {len(solid):,} voxels, the cubes of OctoMap")
        print(f"OctoMap: {len(leaves):,} leaves, {len(cubes):,} cubes, no point outside")


main(Path(sys.argv[1]))
