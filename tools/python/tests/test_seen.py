"""Seen space: against brute force over its cells, and against slicetool."""

from __future__ import annotations

import itertools
import os
import pickle
import subprocess
import threading

import numpy as np
import pytest

import scan
import slicewalk

PROGRAMS = os.environ.get("SLICEWALK_PROGRAMS")
STATION = (4, 3, 1.5)


@pytest.fixture
def seen(folder):
    """The room with the space that one station in its middle saw."""
    return slicewalk.open(folder / "seen.slices")


@pytest.fixture
def space(seen):
    """Its seen space."""
    return seen.seen_space()


def cells(space):
    """Middles of all cells around the room, and which were seen."""
    size = np.array(space.cell_size)
    first, last = np.floor([-2, -2, -2] / size), np.ceil([10, 8, 5] / size)
    index = np.stack(np.meshgrid(*map(np.arange, first, last), indexing="ij"), axis=-1)
    return index.astype(int), space.places(((index + 0.5) * size).reshape(-1, 3)).reshape(index.shape[:3])


def test_places_are_those_of_the_cells(seen, space):
    assert space.cell_size == pytest.approx((0.4, 0.4, 0.3))
    index, found = cells(space)
    assert found.dtype == bool
    assert found.sum() == space.cells == seen.info()["seen"]["cells"] > 300
    inside = index[found] * space.cell_size
    # Nothing is seen at surfaces, or behind them.
    assert (inside > 0.1).all()
    assert (inside + space.cell_size < (7.9, 5.9, 2.5)).all()
    assert seen.overlaps(np.hstack([inside + 1e-6, inside + space.cell_size - 1e-6])).sum() == 0
    # All places of a cell have its answer.
    random = np.random.default_rng(1)
    places = random.uniform((-1, -1, -1), (9, 7, 4), (5000, 3))
    own = np.floor(places / space.cell_size).astype(int) - index[0, 0, 0]
    assert (space.places(places) == found[tuple(own.T)]).all()
    assert f"{space.cells} cells" in repr(space)


def test_boxes_are_seen_if_all_their_cells_are(space):
    index, found = cells(space)
    random = np.random.default_rng(2)
    low = random.uniform((0, 0, 0), (7, 5, 2), (3000, 3))
    high = low + random.uniform(0, (2, 2, 0.8), (3000, 3))
    answers = space.boxes(np.hstack([low, high]))
    ends = [np.floor(corner / space.cell_size).astype(int) - index[0, 0, 0] for corner in (low, high)]
    for first, last, answer in zip(*ends, answers, strict=True):
        assert answer == found[tuple(slice(a, b + 1) for a, b in zip(first, last, strict=True))].all()
    assert 100 < answers.sum() < 2900
    assert (space.boxes(np.stack([low, high], axis=1)) == answers).all()
    assert (space.boxes(np.hstack([low, high]), threads=1) == answers).all()
    assert not space.boxes([[-np.inf, 2, 1, np.inf, 3, 1.2]]).any()
    assert space.boxes([]).shape == (0,)


def test_rays_are_seen_if_their_places_are(seen, space):
    random = np.random.default_rng(3)
    rays = np.hstack([random.uniform((1, 1, 0.6), (7, 5, 2), (2000, 3)), random.normal(0, 1, (2000, 3))])
    rays = np.column_stack([rays, random.uniform(0.1, 6, 2000)])
    hits = seen.cast(rays)
    answers = space.rays(rays, hits)
    assert np.isfinite(hits).sum() > 200
    ways = rays[:, 3:6] / np.linalg.norm(rays[:, 3:6], axis=1)[:, None]
    length = np.minimum(hits, rays[:, 6])
    share = np.linspace(0, 1, 400)
    places = rays[:, None, :3] + share[None, :, None] * (length[:, None, None] * ways[:, None])
    sampled = space.places(places.reshape(-1, 3)).reshape(places.shape[:2])
    ends = np.floor(places[:, -1] / space.cell_size)
    near = (np.abs(np.floor(places / space.cell_size) - ends[:, None]) <= 2).all(axis=2)
    expected = (sampled | near & np.isfinite(hits)[:, None]).all(axis=1)
    # A ray may cut the corner of a cell between two samples.
    assert not (answers & ~expected).any()
    assert (answers != expected).sum() < 40
    assert 200 < answers.sum() < 1800
    # Without hits, the whole length counts.
    whole = space.rays(rays)
    assert not (whole & ~answers).any()
    assert (whole == answers)[np.isinf(hits)].all()
    assert (space.rays(rays, np.inf) == whole).all()
    assert not space.rays(rays, np.nan).any()
    assert space.rays([], []).shape == (0,)
    assert not space.rays([[*STATION, 1, 0, 0, np.inf]]).any()


@pytest.mark.skipif(PROGRAMS is None, reason="SLICEWALK_PROGRAMS names no folder with slicetool")
def test_answers_are_those_of_slicetool(folder, seen, space):
    def column(option, rows):
        text = "\n".join(",".join(map(repr, row)) for row in rows.tolist())
        command = [f"{PROGRAMS}/slicetool", "query", folder / "seen.slices", option, "-"]
        lines = subprocess.run(command, input=text, check=True, capture_output=True, text=True).stdout.splitlines()
        assert lines[0].endswith(",seen")
        return np.array([line.rsplit(",", 1)[1] == "1" for line in lines[1:]])

    random = np.random.default_rng(4)
    low = random.uniform((0, 0, 0), (8, 6, 2.5), (2000, 3))
    boxes = np.hstack([low, low + random.uniform(0, 1, (2000, 3))])
    assert (column("--boxes", boxes) == space.boxes(boxes)).all()
    rays = np.hstack([low, random.normal(0, 1, (2000, 3)), random.uniform(0.1, 5, (2000, 1))])
    assert (column("--rays", rays) == space.rays(rays, seen.cast(rays))).all()


def test_reach_and_routes_stay_in_seen_space(seen, space):
    start, goal = (2, 2, 0.1), (6, 4, 0.1)
    options = {"pawn": "box:0.5x0.5x1.7"}
    free, reach = seen.reach(start, **options), seen.reach(start, seen=True, **options)
    # The pawn's middle was seen wherever it stands, except for the three slices of 0.3 m at the floor.
    lines = np.hstack([free.places[:, :3] + (0, 0, 1.05), free.places[:, :3] + (0, 0, 1.7)])
    is_seen = space.boxes(lines)
    assert 0 < is_seen.sum() < len(is_seen)
    rows = {tuple(row) for row in free.places[is_seen, :3].round(6).tolist()}
    # All of it hangs together here.
    assert rows == {tuple(row) for row in reach.places[:, :3].round(6).tolist()}
    route = seen.route(start, goal, seen=True, **options)
    assert route
    assert route.length == pytest.approx(seen.route(start, goal, **options).length, rel=0.2)
    steps = [a + (b - a) * share for a, b in itertools.pairwise(route.points) for share in np.linspace(0, 1, 50)]
    assert space.boxes([[*(step + (0, 0, 1.05)), *(step + (0, 0, 1.7))] for step in steps]).mean() > 0.95
    # Beside a wall one can stand, but nobody saw that.
    corner = (0.5, 0.5, 0.1)
    assert seen.route(start, corner, **options)
    assert seen.route(start, corner, seen=True, **options).reason == "not_standing_to"
    assert seen.route(corner, start, seen=True, **options).reason == "not_standing_from"
    with pytest.raises(slicewalk.ParameterError, match="all of it seen"):
        seen.reach(corner, seen=True, **options)
    with slicewalk.Stream(seen, "64MiB") as stream:
        stream.load([[*seen.bounds[0], *seen.bounds[1]]])
        view = stream.view()
        assert (view.route(start, goal, seen=True, **options).points == route.points).all()
        assert (view.reach(start, seen=True, **options).places == reach.places).all()


def test_occupancy_grids_call_unseen_ground_unknown(folder, seen, space):
    options = {"pawn": (0.1, 1.7), "climb": 0.35}
    plain = slicewalk.to_occupancy_grid(slicewalk.open(folder / "room.slices"), 0.0, **options)
    grid = slicewalk.to_occupancy_grid(seen, 0.0, **options)
    rows, columns = np.nonzero(plain.data == 0)
    middles = np.array(grid.origin) + (np.column_stack([columns, rows]) + 0.5) * grid.resolution
    lines = np.column_stack([middles, np.full(len(middles), 1.05), middles, np.full(len(middles), 1.69)])
    expected = np.where(space.boxes(lines), 0, -1)
    assert 100 < (expected == 0).sum() < len(expected)
    assert (grid.data[rows, columns] == expected).all()
    assert (grid.data == plain.data)[plain.data != 0].all()
    with slicewalk.Stream(seen, "64MiB") as stream:
        stream.load([[*seen.bounds[0], *seen.bounds[1]]])
        view = slicewalk.to_occupancy_grid(stream.view(), 0.0, bounds=seen.bounds, **options)
        assert (view.data == grid.data).all()


def test_archives_without_seen_space(folder, seen):
    room = slicewalk.open(folder / "room.slices")
    assert room.seen_space() is None
    assert room.seen_space(memory=0) is None
    for ask in (room.reach, lambda start, **options: room.route(start, (6, 4, 0.1), **options)):
        with pytest.raises(slicewalk.ParameterError, match=r"seen: .*free_space=True"):
            ask((2, 2, 0.1), seen=True)
        with pytest.raises(TypeError, match="seen"):
            ask((2, 2, 0.1), seen=None)
    with slicewalk.Stream(room, "64MiB") as stream, pytest.raises(slicewalk.ParameterError, match="free_space"):
        stream.view().route((2, 2, 0.1), (6, 4, 0.1), seen=True)


def test_levels_do_not_say_what_was_seen(tmp_path):
    (tmp_path / "room.las").write_bytes(scan.las(scan.room()))
    (tmp_path / "stations.csv").write_text("file,x,y,z\nroom.las,4,3,1.5\n")
    options = {"free_space": True, "stations": tmp_path / "stations.csv", "levels": "on"}
    slicewalk.convert(tmp_path / "room.las", tmp_path / "a.slices", pixel=0.05, units="m", **options)
    archive = slicewalk.open(tmp_path / "a.slices")
    assert archive.seen_space().cells > 1000
    with pytest.raises(slicewalk.ParameterError, match="levels do not say"):
        archive.level(1).reach((2, 2, 0.1), seen=True)


def test_memory_and_damage(folder):
    path = folder / "seen.slices"
    archive = slicewalk.open(path)
    with pytest.raises(slicewalk.LimitError, match="memory for the seen space"):
        archive.seen_space(memory="1KiB")
    # Once read, it stays.
    assert archive.seen_space(memory="1MiB").cells == archive.seen_space(memory=0).cells
    assert pickle.loads(pickle.dumps(archive)).seen_space().cells == archive.seen_space().cells
    data = bytearray(path.read_bytes())
    # The trailer ends the pages; the directory follows here.
    data[data.rindex(b"\x89SEE\r\n\x1a\n") + 20] ^= 1
    broken = slicewalk.open(bytes(data))
    with pytest.raises(slicewalk.FormatError) as error:
        broken.seen_space()
    assert error.value.rule == "V1"
    with pytest.raises(slicewalk.FormatError):
        broken.route((2, 2, 0.1), (6, 4, 0.1), seen=True)
    assert broken.route((2, 2, 0.1), (6, 4, 0.1))
    assert [finding.rule for finding in broken.verify()] == ["V1"]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda space: space.places([1, 2, 3]), r"places: expected shape \(N, 3\).*reshape\(1, 3\)"),
        (lambda space: space.places([[1, 2, 3], [1, 2, np.nan]]), "places: row 1: .*finite"),
        (lambda space: space.boxes([[1, 2, 3]]), r"boxes: expected shape \(N, 6\)"),
        (lambda space: space.boxes([[1, 2, 3, 0, 4, 5]]), "boxes: row 0"),
        (lambda space: space.rays([[1, 2, 3]]), r"rays: expected shape \(N, 7\)"),
        (lambda space: space.rays([[1, 2, 3, 0, 0, 0, 1]]), "rays: row 0"),
        (lambda space: space.rays([[1, 2, 3, 1, 0, 0, 1]], [1, 2]), r"distances: expected shape \(1,\), found \(2,\)"),
        (lambda space: space.rays([[1, 2, 3, 1, 0, 0, 1]], [-1]), "rays: row 0: .*0 or more"),
        (
            lambda space: space.rays([[1, 2, 3, 1, 0, 0, 1]], np.ma.masked_equal([2.0], 2)),
            "distances: expected numbers, found masked ones",
        ),
    ],
)
def test_rows_that_make_no_sense(space, call, words):
    with pytest.raises(ValueError, match=words):
        call(space)


def test_types_that_make_no_sense(space):
    for call in (lambda: space.places([["a", "b", "c"]]), lambda: space.rays([[1, 2, 3, 1, 0, 0, 1]], ["a"])):
        with pytest.raises(TypeError, match="expected numbers"):
            call()
    with pytest.raises(TypeError):
        slicewalk.SeenSpace()


def test_threads_share_it(seen):
    random = np.random.default_rng(5)
    places = random.uniform((0, 0, 0), (8, 6, 2.5), (50_000, 3))
    expected = seen.seen_space().places(places, threads=1)
    wrong = []

    def ask(archive):
        if (archive.seen_space().places(places) != expected).any():
            wrong.append(archive)

    fresh = slicewalk.open(seen.path)
    threads = [threading.Thread(target=ask, args=(fresh,)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
