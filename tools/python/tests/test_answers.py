"""Answers compared with brute force in numpy, on generated and real scans."""

from __future__ import annotations

import numpy as np
import pytest

import scan
import slicewalk

REAL = ["pump_room.laz", "room_single_station.laz"]


def check_boxes(pages, points, count, seed):
    """G1, G2 and the exact rule."""
    random = np.random.default_rng(seed)
    low, high = points.min(axis=0), points.max(axis=0)
    boxes = scan.boxes(random, low, high, count)
    answers = pages.overlaps(boxes)
    spans = scan.Spans(pages)
    grow = np.array([pages.pixel_size] * 2 + [pages.slice_height])
    for box, answer in zip(boxes, answers, strict=True):
        assert answer == spans.overlap(box), box
        inside = ((points >= box[:3]) & (points <= box[3:])).all(axis=1).any()
        near = ((points >= box[:3] - grow) & (points <= box[3:] + grow)).all(axis=1).any()
        assert inside <= answer <= near, box
    assert 0 < answers.sum() < count


def check_floors(pages, points, count, seed):
    random = np.random.default_rng(seed)
    low, high = points.min(axis=0), points.max(axis=0)
    boxes = scan.boxes(random, low, high, count)
    boxes[::2, 2], boxes[::2, 5] = low[2] - 1, high[2] + 1
    spans = scan.Spans(pages)
    answers = pages.floor(boxes)
    expected = np.array([spans.floor(box) for box in boxes])
    assert (np.isneginf(answers) == np.isneginf(expected)).all()
    known = np.isfinite(expected)
    assert known.any()
    assert np.allclose(answers[known], expected[known], atol=1e-9)
    # A floor lies in the box that begins at its height.
    above = boxes[known]
    above[:, 2] = answers[known]
    assert (pages.floor(above) == above[:, 2]).all()


def check_sweeps(pages, points, count, seed):
    random = np.random.default_rng(seed)
    low, high = points.min(axis=0), points.max(axis=0)
    boxes = scan.boxes(random, low, high, count)
    boxes[:, 3:] = boxes[:, :3] + np.minimum(boxes[:, 3:] - boxes[:, :3], 0.5)
    motions = random.normal(0, 2, (count, 3))
    motions[: count // 4, 2] = 0
    answers = pages.sweep(np.hstack([boxes, motions]))
    spans = scan.Spans(pages)
    for box, motion, answer in zip(boxes, motions, answers, strict=True):
        expected = min(1.0, spans.first(box[:3], box[3:], motion))
        assert abs(answer - expected) < 1e-6, (box, motion)
    assert (answers < 1).any()
    assert (answers == 1).any()


def check_rays(pages, points, count, seed):
    random = np.random.default_rng(seed)
    origins = random.uniform(points.min(axis=0) - 1, points.max(axis=0) + 1, (count, 3))
    ways = random.normal(0, 1, (count, 3))
    rays = np.hstack([origins, ways, np.full((count, 1), 5.0)])
    answers = pages.cast(rays)
    spans = scan.Spans(pages)
    for origin, way, answer in zip(origins, ways, answers, strict=True):
        motion = way / np.linalg.norm(way)
        expected = spans.first(origin, origin, motion)
        if abs(expected - 5) > 1e-6:
            expected = expected if expected < 5 else np.inf
            assert answer == expected or abs(answer - expected) < 1e-6, (origin, way)
    assert np.isinf(answers).any()
    assert np.isfinite(answers).any()


@pytest.mark.parametrize("check", [check_boxes, check_floors, check_sweeps, check_rays])
def test_made(check, doors, rubble):
    check(doors, rubble[0], 400, 7)


@pytest.mark.parametrize("check", [check_boxes, check_floors, check_sweeps, check_rays])
@pytest.mark.parametrize("name", REAL)
def test_real(check, name, real):
    points, archive = real(name)
    check(archive, points, 60, 8)


def test_ceilings(doors, rubble):
    spans = scan.Spans(doors)
    boxes = scan.boxes(np.random.default_rng(3), rubble[0].min(axis=0), rubble[0].max(axis=0), 300)
    answers = doors.ceiling(boxes)
    for box, answer in zip(boxes, answers, strict=True):
        # In this scan no span begins where another ends, so every bottom is an underside.
        bottoms = spans.under(box)[:, 2] * spans.quantum
        expected = min(bottoms[(bottoms >= box[2]) & (bottoms <= box[5])], default=np.inf)
        assert answer == expected or abs(answer - expected) < 1e-9
    assert np.isfinite(answers).any()


def test_round_shapes(doors, rubble):
    points = rubble[0]
    random = np.random.default_rng(4)
    grow = np.array([doors.pixel_size] * 2 + [doors.slice_height])
    centres = random.uniform(points.min(axis=0), points.max(axis=0), (300, 3))
    radius, height = random.uniform(0.05, 0.6, 300), random.uniform(0.1, 1, 300)
    spheres = doors.overlaps_spheres(np.column_stack([centres, radius]))
    cylinders = doors.overlaps_cylinders(np.column_stack([centres, radius, height]))
    for at, r, h, sphere, cylinder in zip(centres, radius, height, spheres, cylinders, strict=True):
        away = points - at
        far = np.linalg.norm(away[:, :2], axis=1)
        assert (np.linalg.norm(away, axis=1) <= r).any() <= sphere
        assert ((far <= r) & (away[:, 2] >= 0) & (away[:, 2] <= h)).any() <= cylinder
        # Grow by the diagonal of a pixel and by a slice.
        reach = r + np.linalg.norm(grow)
        assert sphere <= (np.linalg.norm(away, axis=1) <= reach).any()
        near = (far <= r + grow[0] * 2) & (away[:, 2] >= -grow[2]) & (away[:, 2] <= h + grow[2])
        assert cylinder <= near.any()
    assert 0 < spheres.sum() < 300
    assert 0 < cylinders.sum() < 300


def test_region_holds_every_voxel_of_the_points(rubble):
    points, archive = rubble
    low, high = archive.bounds
    region = archive.region([*low, *high])
    quanta = points[:, 2] * (255 / region.slice_height)
    pixels = np.floor(points[:, :2] * (1 / region.pixel_size)).astype(int)
    index = np.column_stack([pixels, np.floor(quanta).astype(int) // 255])
    column, row, number = (index - region.first).T
    assert region.occupied[number, row, column].all()
    assert region.occupied.sum() == archive.voxels
    assert (region.kind == 2).sum() == archive.info()["voxels"]["obstacle"]
    quanta -= index[:, 2] * 255
    assert (region.bottom[number, row, column] <= quanta + 1e-6).all()
    assert (region.top[number, row, column] >= quanta - 1e-6).all()
    assert (region.top[~region.occupied] == 0).all()
    part = archive.region([-1, -1, 1, 1, 1, 2])
    x, y, z = (at - of for at, of in zip(part.first, region.first, strict=True))
    slices, rows, columns = part.kind.shape
    assert (part.kind == region.kind[z : z + slices, y : y + rows, x : x + columns]).all()
    assert sorted(region.slices()) == sorted(set(index[:, 2]))


def test_columns_and_pages_say_the_same(rubble):
    points, archive = rubble
    spans = scan.Spans(archive)
    for x, y, _ in points[:200]:
        column = archive.column(x, y)
        own = spans.under(np.array([x, y, 0, x, y, 0]))
        own = own[np.argsort(own[:, 2])]
        assert len(column) == len(own)
        assert np.allclose(column.bottoms, own[:, 2] * spans.quantum, atol=1e-9)
        assert np.allclose(column.tops, own[:, 3] * spans.quantum, atol=1e-9)
        assert (column.obstacle == own[:, 4]).all()
    assert len(archive.column(1e6, 1e6)) == 0
    assert archive.page((1000, 0, 0)) is None


def test_xarray(rubble):
    pytest.importorskip("xarray")
    data = rubble[1].region([-1, -1, 1, 1, 1, 2]).to_xarray()
    assert dict(data.sizes) == {"z": 4, "y": 21, "x": 21}
    assert data.attrs["pixel_size"] == scan.PIXEL


def test_not_loaded_is_an_answer_of_its_own(folder):
    archive = slicewalk.open(folder / "room.slices")
    with slicewalk.Stream(archive, "64MiB", prefetch=False) as stream:
        view, wall = stream.view(), [[-0.1, 2, 0.5, 0.2, 2.5, 1.8]]
        assert view.overlaps(wall) == slicewalk.NOT_LOADED
        assert view.overlaps([[20, 20, 0, 21, 21, 1]]) == slicewalk.CLEAR
        assert np.isnan(view.floor([[3, 2, -1, 3.5, 2.5, 2]]))
        assert np.isnan(view.ceiling([[3, 2, 1, 3.5, 2.5, 9]]))
        assert np.isnan(view.cast([[4, 3, 1.2, 0, 0, -1, 10]]))
        assert np.isnan(view.sweep([[3, 2, 0.5, 3.5, 2.5, 1.8, 9, 0, 0]]))
        for ask in (
            lambda: view.column(0.05, 1),
            lambda: view.page((0, 0, 0)),
            lambda: view.region((0, 0, 0, 1, 1, 1)),
            lambda: view.reach((4, 3, 0.1)),
            lambda: slicewalk.Walker((4, 3, 0.1)).path(view, [(5, 3)]),
        ):
            with pytest.raises(slicewalk.NotLoadedError) as raised:
                ask()
            assert raised.value.pages
        assert slicewalk.Walker((4, 3, 0.1)).step(view, 0.1).waits
        stream.load(wall)
        assert view.overlaps(wall) == slicewalk.NOT_LOADED, "a view is about its moment"
        assert stream.view().overlaps(wall) == slicewalk.HIT


def test_middles_of_voxels(rubble):
    region = rubble[1].region([-1, -1, 1, 1, 1, 2])
    data = region.to_xarray()
    assert np.allclose(data.z, region.z + region.slice_height / 2)
    place = data.kind.sel(x=0.03, y=0.03, z=1.5, method="nearest")
    for axis, size in (("x", region.pixel_size), ("y", region.pixel_size), ("z", region.slice_height)):
        assert abs(float(place[axis]) - {"x": 0.03, "y": 0.03, "z": 1.5}[axis]) <= size / 2 + 1e-9


def test_what_is_printed_says_something(folder, rubble):
    archive = slicewalk.open(folder / "room.slices")
    slicewalk.convert(folder / "room.las", folder / "levels.slices", pixel=0.02, units="m", levels=True, force=True)
    reach, route = archive.reach((4, 3, 0.1)), archive.route((1, 1, 0.1), (7, 5, 0.1))
    path = slicewalk.Walker((1, 1, 0.1)).path(archive, route.points)
    said = {
        archive: "voxels, pixel 0.1 m, 9 slices",
        slicewalk.open(folder / "levels.slices").level(1): 'Pages level 1 of "',
        reach: " m², ",
        route: "7.2",
        archive.route((1, 1, 0.1), (70, 5, 0.1)): "none, not_standing_to",
        path: "arrived after",
        archive.region((0, 0, 0, 8, 6, 2.5)): "9 × 61 × 81 voxels",
    }
    for thing, text in said.items():
        assert text in repr(thing)
        assert len(repr(thing)) < 200
    # Those of an overview level are not counted.
    assert "voxels" not in repr(slicewalk.open(folder / "levels.slices").level(1))


def test_a_row_of_keys_is_a_key(rubble):
    archive = rubble[1]
    for key in archive.keys():
        assert archive.page(key).key == archive.page(tuple(key)).key == tuple(key)
    assert archive.colours(archive.keys()[0]) is None
    for key in (5, (1, 2), (1, 2, 3, 4), "abc", (1, 2, 1 << 40), None):
        with pytest.raises(TypeError, match="key: expected tx, ty, layer"):
            archive.page(key)
