"""Every error is one of slicewalk, names the argument, and is the error of Python that fits."""

from __future__ import annotations

import os
import pathlib
import pickle
import shutil

import numpy as np
import pytest

import slicewalk

BOX, NAN = [[3, 2, 0.5, 3.5, 2.5, 1.8]], float("nan")
START, RAY = (1, 1, 0.1), [[4, 3, 1.2, 1, 0, 0, 2]]


@pytest.fixture(scope="module")
def room(folder):
    return slicewalk.open(folder / "room.slices")


def streamed(call):
    def run(room):
        with slicewalk.Stream(room, "16MiB") as stream:
            call(stream)

    return run


def seen(call):
    def run(room):
        call(slicewalk.open(pathlib.Path(room.path).with_name("seen.slices")).seen_space())

    return run


def ended(call):
    def run(room):
        with slicewalk.Stream(room, "16MiB") as stream:
            body = stream.body()
        call(room, stream, body)

    return run


VALUES = {
    "boxes": lambda room: room.overlaps([[1, 2]]),
    "boxes ragged": lambda room: room.overlaps([[1], [1, 2]]),
    "threads": lambda room: room.overlaps(BOX, threads=0),
    "within": lambda room: room.nearest_surfaces([[0, 0, 0]], -1),
    "bounds": lambda room: room.region([NAN] * 6),
    "start": lambda room: room.reach((NAN, 0, 0)),
    "goal": lambda room: room.route(START, (1, 2)),
    "goal nested": lambda room: room.route(START, [(1, 2, 3)]),
    "goal huge": lambda room: room.route(START, (1, 2, 10**400)),
    "bounds huge": lambda room: room.region([10**400] * 6),
    "bounds of a grid": lambda room: slicewalk.to_occupancy_grid(room, 0, bounds=[10**400] * 6),
    "pawn": lambda room: room.reach(START, pawn="box:1"),
    "distances": seen(lambda space: space.rays(RAY, [[1], [1, 2]])),
    "feet": lambda _: slicewalk.Walker((NAN, 0, 0)),
    "feet far": lambda _: slicewalk.Walker((1e300, 0, 0)),
    "speed": lambda _: slicewalk.Walker(START, speed=-1),
    "climb": lambda _: slicewalk.Walker(START, climb=9),
    "climb route": lambda room: room.route(START, START, climb=9),
    "max_drop": lambda room: room.route(START, START, max_drop=-1),
    "max_grade": lambda room: room.route(START, START, max_grade=0),
    "max_ramp": lambda room: room.reach(START, max_ramp=0),
    "length": lambda room: room.reach(START, length=1),
    "budget": lambda room: slicewalk.Stream(room, 0),
    "budget low": lambda room: slicewalk.Stream(room, 1),
    "number": lambda room: room.level(9),
    "level": lambda room: room.colours((0, 0, 0), level=9),
    "x": lambda room: room.column(NAN, 1),
    "y": lambda room: room.column(1, NAN),
    "pixel": lambda _: slicewalk.Writer("a.slices", pixel=-1),
    "slice": lambda _: slicewalk.Writer("a.slices", pixel=0.1, slice=-1),
    "memory": lambda _: slicewalk.Writer("a.slices", pixel=0.1, memory=1),
    "direction": lambda room: slicewalk.Walker(START).step(room, 0.1, direction=(1,)),
    "box": streamed(lambda stream: stream.body().hint([NAN] * 6, (0, 0, 0))),
}
TYPES = {
    "boxes": lambda room: room.overlaps([["a"] * 6]),
    "key": lambda room: room.page("a"),
    "threads": lambda room: room.overlaps(BOX, threads=1.5),
    "within": lambda room: room.nearest_surfaces([[0, 0, 0]], "1"),
    "x": lambda room: room.column("1", 0),
    "climb": lambda room: room.route(START, START, climb="high"),
    "max_drop": lambda room: room.reach(START, max_drop="deep"),
    "seen": lambda room: room.reach(START, seen=1),
    "explain": lambda room: room.route(START, START, explain=None),
    "progress": lambda room: room.verify(3),
    "number": lambda room: room.level("1"),
    "level": lambda room: room.colours((0, 0, 0), level=None),
    "response": lambda _: slicewalk.Walker(START, response=None),
    "speed": lambda _: slicewalk.Walker(START, speed="fast"),
    "pages": lambda _: slicewalk.Walker(START).step(None, 0.1),
    "pawn": lambda room: room.reach(START, pawn=3),
    "pawn sizes": lambda _: slicewalk.Walker(START, pawn=(0.5, 0.5, 1.8)),
    "bounds": lambda room: room.region(None),
    "bounds text": lambda room: room.region("room"),
    "bounds elements": lambda room: room.region([[0, 0, 0], [1, 1, None]]),
    "start": lambda room: room.reach(5),
    "goal": lambda room: room.route(START, ("1", "1", "0")),
    "feet": lambda _: slicewalk.Walker(5),
    "feet later": lambda _: slicewalk.Walker(START).place(None),
    "direction": lambda room: slicewalk.Walker(START).step(room, 0.1, direction=1),
    "toward": lambda room: slicewalk.Walker(START).step(room, 0.1, toward="there"),
    "waypoints": lambda room: slicewalk.Walker(START).path(room, "there"),
    "box": streamed(lambda stream: stream.body().hint(1, (0, 0, 0))),
    "velocity": streamed(lambda stream: stream.body().hint(BOX[0], None)),
    "distances": seen(lambda space: space.rays(RAY, ["far"])),
    "z": lambda room: slicewalk.to_occupancy_grid(room, "high"),
    "climb of a grid": lambda room: slicewalk.to_occupancy_grid(room, 0, climb=True),
    "pawn of a grid": lambda room: slicewalk.to_occupancy_grid(room, 0, pawn=3),
    "bounds of a grid": lambda room: slicewalk.to_occupancy_grid(room, 0, bounds="room"),
    "bounds of a tree": lambda room: slicewalk.to_octomap(room, "a.bt", bounds=[None] * 6),
    "dt": lambda room: slicewalk.Walker(START).step(room, None),
    "hz": lambda room: slicewalk.Walker(START).path(room, [(1, 2)], hz="60"),
    "archive": lambda _: slicewalk.Stream("room.slices", "16MiB"),
    "prefetch": lambda room: slicewalk.Stream(room, "16MiB", prefetch=1),
    "seconds": streamed(lambda stream: stream.settle("1")),
    "source": lambda _: slicewalk.open(5),
    "timeout": lambda _: slicewalk.open("http://localhost/a", timeout="1"),
    "settings": lambda _: slicewalk.open("s3://bucket/a", settings={"secret": 1}),
    "inputs": lambda _: slicewalk.convert(b"room.las", "a.slices"),
    "output": lambda _: slicewalk.convert("room.las", None),
    "force": lambda _: slicewalk.merge(["a"], "b", force=1),
    "path": lambda room: slicewalk.to_octomap(room, None),
}
RANGES = {
    "threads": lambda room: room.overlaps(BOX, threads=-1),
    "threads large": lambda room: room.overlaps(BOX, threads=1 << 70),
    "number": lambda room: room.level(-1),
    "retries": lambda _: slicewalk.open("http://localhost/a", retries=-1),
}
KINDS = [
    (VALUES, slicewalk.ParameterError, ValueError),
    (TYPES, slicewalk.ParameterTypeError, TypeError),
    (RANGES, slicewalk.ParameterRangeError, OverflowError),
]


@pytest.mark.parametrize(
    ("name", "call", "kind", "base"),
    [
        pytest.param(*case, *kinds, id=f"{kinds[0].__name__} {case[0]}")
        for cases, *kinds in KINDS
        for case in cases.items()
    ],
)
def test_invalid_arguments_are_named(room, name, call, kind, base):
    with pytest.raises(base) as raised:
        call(room)
    error, name = raised.value, name.split(" ")[0]
    assert type(error) is kind
    assert error.at.startswith(name)
    assert str(error).startswith(name + ":")
    assert "secret" not in str(error)
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again), again.at) == (kind, str(error), error.at)


@pytest.mark.parametrize(
    "call",
    [
        ended(lambda _room, stream, _body: stream.view()),
        ended(lambda _room, stream, _body: stream.settle(1)),
        ended(lambda _room, _stream, body: body.hint(BOX[0], (0, 0, 0))),
        ended(lambda room, stream, _body: slicewalk.Walker(START).path(stream, [(1, 2)])),
    ],
)
def test_what_is_closed_says_so(room, call):
    with pytest.raises(slicewalk.ClosedError, match="the stream is closed") as raised:
        call(room)
    assert isinstance(raised.value, ValueError)


def test_a_file_that_cannot_be_written_is_named(room, tmp_path):
    with pytest.raises(FileNotFoundError) as raised:
        slicewalk.to_octomap(room, tmp_path / "none" / "a.bt")
    assert type(raised.value) is slicewalk.MissingFileError
    assert raised.value.path == raised.value.filename == str(tmp_path / "none" / "a.bt")
    (tmp_path / "a.bt").mkdir()
    with pytest.raises(OSError, match=r"a\.bt: is a folder") as raised:
        slicewalk.to_octomap(room, tmp_path / "a.bt")
    assert type(raised.value) is slicewalk.OutputError
    assert raised.value.path == str(tmp_path / "a.bt")
    grid = slicewalk.OccupancyGrid(np.zeros((1, 1), np.int8), 0.1, (0.0, 0.0))
    with pytest.raises(slicewalk.MissingFileError):
        grid.save(tmp_path / "none" / "a")
    assert [path.name for path in tmp_path.iterdir()] == ["a.bt"]


def test_an_export_never_replaces_an_archive(room, tmp_path):
    copy = pathlib.Path(shutil.copy(room.path, tmp_path / "a.slices"))
    grid = slicewalk.OccupancyGrid(np.zeros((1, 1), np.int8), 0.1, (0.0, 0.0))
    shutil.copy(room.path, tmp_path / "a.pgm")
    before = copy.read_bytes()
    for export in (lambda: slicewalk.to_octomap(slicewalk.open(copy), copy), lambda: grid.save(tmp_path / "a")):
        with pytest.raises(slicewalk.OutputError, match=r"is a slice archive, which .* never replaces"):
            export()
    assert copy.read_bytes() == (tmp_path / "a.pgm").read_bytes() == before
    assert sorted(os.listdir(tmp_path)) == ["a.pgm", "a.slices"]


@pytest.mark.skipif(os.name != "posix", reason="needs permissions")
def test_a_new_file_has_the_permissions_of_any_and_another_no_more_than_what_it_replaces(tmp_path):
    grid = slicewalk.OccupancyGrid(np.zeros((1, 1), np.int8), 0.1, (0.0, 0.0))

    def modes():
        grid.save(tmp_path / "a")
        return [(tmp_path / name).stat().st_mode & 0o777 for name in ("a.pgm", "a.yaml")]

    before = os.umask(0o027)
    try:
        assert modes() == [0o640, 0o640]
        (tmp_path / "a.pgm").chmod(0o600)
        (tmp_path / "a.yaml").chmod(0o666)
        assert modes() == [0o600, 0o640]
    finally:
        os.umask(before)
