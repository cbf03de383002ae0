"""Bridges to other programs: grids, octrees, clouds, arrays; and distances, compared with plain numpy."""

from __future__ import annotations

import itertools
import json
import os
import subprocess

import numpy as np
import pytest

import scan
import slicewalk

PROGRAMS = os.environ.get("SLICEWALK_PROGRAMS")


FREE, OCCUPIED = 1, 2


def leaves(path, kind=OCCUPIED):
    """Leaves of a ``.bt`` by the format's description: corners and edges in cubes, and the resolution."""
    head, data = path.read_bytes().split(b"\ndata\n", 1)
    assert head.startswith(b"# Octomap OcTree binary file\n")
    fields = dict(line.split(" ", 1) for line in head.decode().splitlines() if not line.startswith("#"))
    found, at, nodes = [], 0, 1

    def visit(corner, edge):
        nonlocal at, nodes
        children = int.from_bytes(data[at : at + 2], "little")
        at += 2
        for child in range(8):
            bits, half = children >> 2 * child & 3, edge // 2
            below = tuple(corner[axis] + half * (child >> axis & 1) for axis in range(3))
            nodes += bits != 0
            if bits == kind:
                found.append((below, half))
            elif bits == 3:
                visit(below, half)

    visit((-(1 << 15),) * 3, 1 << 16)
    assert at == len(data)
    assert nodes == int(fields["size"])
    return found, float(fields["res"])


def cells(found):
    return {
        (x + a, y + b, z + c)
        for (x, y, z), edge in found
        for a in range(edge)
        for b in range(edge)
        for c in range(edge)
    }


def test_octomap_holds_the_cubes_of_the_points(rubble, tmp_path):
    points, archive = rubble
    path = tmp_path / "a.bt"
    count = slicewalk.to_octomap(archive, path)
    found, resolution = leaves(path)
    cubes = cells(found)
    assert (resolution, len(cubes)) == (archive.pixel_size, count)
    # A point on the border of two cubes may lie within a rounding error of either.
    nudges = [np.array(nudge) for nudge in itertools.product((-1e-6, 1e-6), repeat=3)]
    around = np.stack([np.floor((points + nudge) / resolution).astype(int) for nudge in nudges], axis=1).tolist()
    assert all(any(tuple(cube) in cubes for cube in near) for near in around)
    # Converted again, a cube is a voxel.
    slicewalk.convert(path, tmp_path / "a.slices")
    again = slicewalk.open(tmp_path / "a.slices")
    assert (again.voxels, again.pixel_size, again.slice_height) == (count, resolution, resolution)
    assert slicewalk.to_octomap(again, tmp_path / "b.bt") == count
    assert (tmp_path / "b.bt").read_bytes() == path.read_bytes()


def test_full_blocks_of_cubes_are_joined(tmp_path):
    steps = np.arange(-0.375, 0.4, 0.05)
    points = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    archive = slicewalk.from_numpy(points, tmp_path / "a.slices", pixel=0.1, slice=0.1)
    count = slicewalk.to_octomap(archive, tmp_path / "a.bt")
    found, _ = leaves(tmp_path / "a.bt")
    assert len(cells(found)) == count == 512
    assert sorted(edge for _, edge in found) == [4] * 8
    with pytest.raises(ValueError, match="solid"):
        slicewalk.to_octomap(archive, tmp_path / "b.bt", bounds=(5, 5, 5, 6, 6, 6))
    # A region has the voxels that its box meets, cut where they end.
    part = (-0.3, -0.2, -0.1, 0.05, 0.25, 0.15)
    assert slicewalk.to_octomap(archive, tmp_path / "b.bt", bounds=part) == 4 * 5 * 3
    found, _ = leaves(tmp_path / "b.bt")
    assert {tuple(cube) for cube in itertools.product(range(-3, 1), range(-2, 3), range(-1, 2))} == cells(found)


def test_octrees_far_from_the_origin_are_moved_and_come_back(tmp_path):
    points = np.random.default_rng(5).uniform(0, 3, (2000, 3)) + (200_000, -500_000, 0)
    archive = slicewalk.from_numpy(points, tmp_path / "a.slices", pixel=0.1, slice=0.1)
    count = slicewalk.to_octomap(archive, tmp_path / "a.bt")
    assert b"# moved by -" in (tmp_path / "a.bt").read_bytes()[:80]
    slicewalk.convert(tmp_path / "a.bt", tmp_path / "b.slices")
    again = slicewalk.open(tmp_path / "b.slices")
    assert again.voxels == count
    assert np.abs(again.bounds - archive.bounds).max() <= 0.1 + 1e-9
    points[0, 0] += 10_000
    wide = slicewalk.from_numpy(points, tmp_path / "c.slices", pixel=0.1)
    with pytest.raises(slicewalk.errors.LimitError, match="smaller region"):
        slicewalk.to_octomap(wide, tmp_path / "c.bt")
    assert not (tmp_path / "c.bt").exists()


@pytest.mark.skipif(PROGRAMS is None, reason="SLICEWALK_PROGRAMS names no folder with slicetool")
@pytest.mark.parametrize("name", ["room.slices", "seen.slices"])
def test_octrees_are_those_of_slicetool(folder, tmp_path, name):
    slicewalk.to_octomap(slicewalk.open(folder / name), tmp_path / "a.bt")
    command = [f"{PROGRAMS}/slicetool", "export", folder / name, "-o", tmp_path / "b.bt"]
    subprocess.run(command, check=True, capture_output=True)
    assert (tmp_path / "a.bt").read_bytes() == (tmp_path / "b.bt").read_bytes()


@pytest.mark.parametrize("bounds", [None, (1.03, 1.25, 0.4, 5.93, 4.17, 1.67)])
def test_cubes_in_seen_space_are_free(folder, tmp_path, bounds):
    archive = slicewalk.open(folder / "seen.slices")
    space, path = archive.seen_space(), tmp_path / "a.bt"
    assert slicewalk.to_octomap(archive, path, bounds=bounds) == len(cells(leaves(path)[0]))
    occupied, free = cells(leaves(path)[0]), cells(leaves(path, FREE)[0])
    assert len(free) > 1000
    assert not occupied & free
    # All cubes of the region, and whether they lie in seen space: a little smaller, as they are closed there.
    size = np.array([archive.pixel_size, archive.pixel_size, archive.slice_height])
    low, high = np.reshape(archive.bounds if bounds is None else bounds, (2, 3))
    first, last = np.floor(low / size), np.floor(high / size)
    edge = archive.pixel_size
    ends = np.array([first, last + 1]) * size / edge
    ends = np.array([np.ceil(ends[0] - 1e-6), np.floor(ends[1] + 1e-6)]).astype(int)
    axes = [np.arange(a, b) for a, b in ends.T]
    cubes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = np.hstack([cubes * edge + 1e-4, (cubes + 1) * edge - 1e-4])
    expected = {tuple(cube) for cube in cubes[space.boxes(inside)].tolist()} - occupied
    # A cube across the border of two pages is in neither.
    border = archive.slice_height * 64
    missed = {cube for cube in expected - free if cube[2] * edge % border < border - edge + 1e-6}
    assert not free - expected
    assert not missed


@pytest.mark.parametrize("far", [0.3, 0.6, 0.7, 1.2])
def test_a_grid_ends_where_the_archive_does(tmp_path, far):
    edge = np.round(np.arange(0, far + 0.05, 0.1), 1)
    ground = np.stack(np.meshgrid(edge, edge, [0.0]), axis=-1).reshape(-1, 3)
    post = np.column_stack([np.full(40, far), np.full(40, far), np.arange(40) * 0.05])
    archive = slicewalk.from_numpy(np.vstack([ground, post]), tmp_path / "a.slices", pixel=0.1)
    grid = slicewalk.to_occupancy_grid(archive, 0.0, pawn=(0.0, 1.0))
    assert grid.data.shape == archive.region(archive.bounds).kind.shape[1:]
    assert grid.data[-1, -1] == 100


def test_grids_tell_free_occupied_and_unknown(folder, tmp_path):
    archive = slicewalk.open(folder / "room.slices")
    grid = slicewalk.to_occupancy_grid(archive, 0.0, bounds=(-1, -1, 0, 9, 7, 2))
    rows, columns = grid.data.shape
    x, y = np.meshgrid(
        grid.origin[0] + (np.arange(columns) + 0.5) * 0.1, grid.origin[1] + (np.arange(rows) + 0.5) * 0.1
    )
    inside = (x > 0.25) & (x < 7.75) & (y > 0.25) & (y < 5.75)
    outside = (x < -0.15) | (x > 8.15) | (y < -0.15) | (y > 6.15)
    wall = (x > 0) & (x < 0.1) & (y > 0) & (y < 6)
    assert (grid.data[inside] == 0).all()
    assert (grid.data[outside] == -1).all()
    assert (grid.data[wall] == 100).all()
    grid.save(tmp_path / "room.yaml")
    text = (tmp_path / "room.yaml").read_text()
    assert 'image: "room.pgm"' in text
    assert "resolution: 0.1" in text
    image = (tmp_path / "room.pgm").read_bytes()
    assert image.startswith(f"P5\n{columns} {rows}\n255\n".encode())
    grey = np.frombuffer(image[-rows * columns :], np.uint8).reshape(rows, columns)[::-1]
    assert (grey[inside] == 254).all()
    assert (grey[wall] == 0).all()
    assert (grey[outside] == 205).all()
    # Two metres up there is no floor: the room is unknown, its walls are in the way.
    high = slicewalk.to_occupancy_grid(archive, 1.0, pawn=(0.1, 1.0))
    assert set(np.unique(high.data)) == {-1, 100}
    # Nothing is known where no page is loaded, and a view needs bounds.
    with slicewalk.Stream(archive, "64MiB", prefetch=False) as stream:
        bare = slicewalk.to_occupancy_grid(stream.view(), 0.0, bounds=archive.bounds)
        assert (bare.data == -1).all()
        with pytest.raises(ValueError, match="bounds"):
            slicewalk.to_occupancy_grid(stream.view(), 0.0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["room.pgm", "room.yaml"]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("z", np.nan),
        ("z", "0"),
        ("pawn", "cylinder:.1x1"),
        ("pawn", (-1, 1)),
        ("pawn", (0.1, 0)),
        ("climb", 1.8),
        ("climb", -0.1),
        ("climb", True),
        ("bounds", [np.nan] * 6),
        ("bounds", [1, 2, 3, 4, 5]),
        ("bounds", [1, 1, 1, 0, 0, 0]),
        ("bounds", np.ma.masked_equal([0.0, 0, 0, 1, 1, 9], 9)),
        ("bounds", [[0, 0, 0], [1, 1]]),
        ("bounds", [[0, 1], [0, 1], [0, 1]]),
    ],
)
def test_grids_refuse_arguments_that_make_no_sense(folder, name, value):
    archive = slicewalk.open(folder / "room.slices")
    with pytest.raises(slicewalk.ParameterError, match=f"^{name}: ") as raised:
        slicewalk.to_occupancy_grid(archive, **{"z": 0, name: value})
    assert raised.value.at == name
    if name == "bounds":
        with pytest.raises(slicewalk.ParameterError, match=r"^bounds: "):
            slicewalk.to_octomap(archive, folder / "none.bt", bounds=value)


@pytest.mark.parametrize("far", [1e7, 1e300, 1e308])
def test_grids_are_of_a_sensible_size(folder, far):
    archive = slicewalk.open(folder / "room.slices")
    with pytest.raises(slicewalk.LimitError, match="smaller bounds"):
        slicewalk.to_occupancy_grid(archive, 0.0, bounds=(-far, -far, 0, far, far, 1))


def test_grids_are_decided_block_by_block(folder, monkeypatch):
    archive = slicewalk.open(folder / "seen.slices")
    whole = slicewalk.to_occupancy_grid(archive, 0.0)
    monkeypatch.setattr("slicewalk._bridges._BLOCK", 1000)
    assert np.array_equal(slicewalk.to_occupancy_grid(archive, 0.0).data, whole.data)


@pytest.mark.parametrize(
    ("given", "name"),
    [("a", "a"), ("a.yaml", "a"), ("a.pgm", "a"), ("storey_1.0", "storey_1.0"), ("b.v1.yaml", "b.v1")]
    + [(name, name) for name in ("a: b", "a #b", 'a "b"', "- ü")],
)
def test_a_grid_is_saved_as_two_files_of_its_name(tmp_path, given, name):
    grid = slicewalk.OccupancyGrid(np.zeros((1, 2), np.int8), 0.1, (0.0, 0.0))
    grid.save(tmp_path / given)
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"{name}.pgm", f"{name}.yaml"]
    assert (tmp_path / f"{name}.pgm").read_bytes().startswith(b"P5\n2 1\n")
    head, _, quoted = (tmp_path / f"{name}.yaml").read_text(encoding="utf-8").splitlines()[0].partition(" ")
    assert (head, json.loads(quoted)) == ("image:", f"{name}.pgm")


def test_arrays_become_archives_and_points_again(tmp_path):
    points = scan.rubble(3000, 2)
    archive = slicewalk.from_numpy(points, tmp_path / "a.slices", pixel=scan.PIXEL)
    assert archive.points_kept == len(points)
    region = archive.region(archive.bounds)
    assert region.points.shape == (archive.voxels, 3)
    apart = np.abs(region.points[None] - points[::50, None])
    half = np.array([scan.PIXEL, scan.PIXEL, scan.SLICE]) / 2 + 1e-9
    assert (apart <= half).all(axis=2).any(axis=1).all(), "every point lies in an occupied voxel"
    with pytest.raises(slicewalk.Error, match="force"):
        slicewalk.from_numpy(points, tmp_path / "a.slices", pixel=scan.PIXEL)


def test_open3d_gets_voxels(folder):
    open3d = pytest.importorskip("open3d", reason="open3d is not installed; `.ci/long open3d` does that")
    archive = slicewalk.open(folder / "room.slices")
    cloud = slicewalk.to_open3d(archive)
    assert isinstance(cloud, open3d.geometry.PointCloud)
    region = archive.region(archive.bounds)
    assert len(cloud.points) == archive.voxels
    assert np.array_equal(np.asarray(cloud.points), region.points)
    is_red = np.asarray(cloud.colors)[:, 0] > 0.5
    assert np.array_equal(is_red, region.kind[region.occupied] == 2)
    assert 0 < is_red.sum() < len(is_red)
    # Open3D works with it: each point is its own nearest neighbour, and a voxel grid of pixels holds all of them.
    assert np.asarray(cloud.compute_point_cloud_distance(cloud)).max() == 0
    part = slicewalk.to_open3d(archive, bounds=(0, 0, -1, 2, 2, 1))
    assert 0 < len(part.points) < archive.voxels


def test_the_nearest_surface_is_that_of_the_spans(rubble):
    _, archive = rubble
    low, high = archive.bounds
    random = np.random.default_rng(3)
    places = random.uniform(low - 0.5, high + 0.5, (4000, 3))
    within = 0.6
    region = archive.region(archive.bounds)
    slices, rows, columns = np.nonzero(region.kind)
    corner = np.column_stack([columns + region.first[0], rows + region.first[1]]) * archive.pixel_size
    heights = [
        ((slices + region.first[2]) * 255 + part[region.occupied].astype(int)) * archive.height_quantum
        for part in (region.bottom, region.top)
    ]
    low_end, high_end = (np.column_stack([corner + k * archive.pixel_size, z]) for k, z in enumerate(heights))
    expected = np.array(
        [
            np.sqrt((np.maximum(np.maximum(low_end - place, place - high_end), 0) ** 2).sum(axis=1)).min()
            for place in places
        ]
    )
    found = archive.nearest_surfaces(places, within)
    outside = expected > 1e-9
    near = outside & (expected <= within)
    assert np.allclose(found.distance[near], expected[near], atol=1e-9)
    assert np.isinf(found.distance[outside & (expected > within)]).all()
    assert (found.distance[~outside] <= 1e-9).all()
    assert np.isnan(found.point[np.isinf(found.distance)]).all()
    reached = np.isfinite(found.distance) & (np.abs(found.distance) > 1e-6)
    back = places - found.gradient * found.distance[:, None]
    assert np.allclose(back[reached], found.point[reached], atol=1e-9)
    assert near.sum() > 500
    with pytest.raises(ValueError, match="finite"):
        archive.nearest_surfaces([[0, 0, np.nan]], 1)
    with pytest.raises(ValueError, match="within"):
        archive.nearest_surfaces([[0, 0, 0]], -1)
    with slicewalk.Stream(archive, "64MiB", prefetch=False) as stream:
        assert np.isnan(stream.view().nearest_surfaces(places[near][:1], within).distance).all()
