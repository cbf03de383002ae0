"""Walkers, streams, reach and routes."""

from __future__ import annotations

import contextlib
import os
import pathlib
import threading
import time

import numpy as np
import pytest

import slicewalk


@pytest.fixture
def room(folder):
    """The room."""
    return slicewalk.open(folder / "room.slices")


def test_a_walker_walks_falls_and_stops(room):
    walker = slicewalk.Walker((2, 3, 1.0), speed=2)
    reports = [walker.step(room, 0.1) for _ in range(10)]
    assert reports[0].state == "falling"
    assert walker.falling == 0
    assert walker.feet == pytest.approx((2, 3, 0), abs=0.002)
    report = walker.step(room, 1, direction=(0, 1))
    assert (report.state, report.ticks, report.waits) == ("walking", 240, False)
    assert report.moved == pytest.approx((0, 2, 0), abs=1e-9)
    report = walker.step(room, 5, direction=(0, 9))
    assert report.stop == "wall"
    assert walker.step(room, 1, direction=(0, 1)).state == walker.state == "blocked"
    assert walker.feet[1] == pytest.approx(5.9 - 0.25, abs=1e-6)
    walker.place((1, 1, 0))
    assert walker.feet == (1, 1, 0)
    assert walker.step(room, 1, toward=(2, 1)).moved[0] == pytest.approx(1, abs=0.01)
    assert "Walker walking at (" in repr(walker)
    with pytest.raises(TypeError, match="exclude"):
        walker.step(room, 1, toward=(2, 1), direction=(1, 0))
    with pytest.raises(TypeError):
        walker.step(None, 1)


@pytest.mark.parametrize(
    "options",
    [
        {"pawn": "sphere:1"},
        {"pawn": "box:1x1x0"},
        {"pawn": 3},
        {"speed": -1},
        {"climb": 2},
        {"response": "bounce"},
        {"feet": (1, 1)},
        {"feet": (1, 1, np.nan)},
    ],
)
def test_walkers_that_make_no_sense(options):
    with pytest.raises(ValueError):
        slicewalk.Walker(**{"feet": (1, 1, 0), **options})


def test_paths(room):
    walker = slicewalk.Walker((1, 1, 0.1), pawn="cylinder:0.25x1.8")
    path = walker.path(room, np.array([[7.0, 1], [7, 5]]))
    assert path.state == "arrived"
    assert path.waypoints_reached == 2
    assert path.length == pytest.approx(10, abs=0.1)
    assert path.feet.shape == (len(path.seconds), 3)
    assert path.states.shape == path.seconds.shape
    assert path.seconds[0] == pytest.approx(1 / 60)
    assert walker.path(room, [(7, 5.9, 3)]).state == "blocked"
    assert slicewalk.Walker((1, 1, 0)).path(room, [(7, 5)], hz=30, max_seconds=2).state == "walking"
    for wrong in ([], [(np.nan, 1)], [1, 2], [(1, 2), (3,)], np.ma.masked_equal([[2.0, 3], [4, 9]], 9)):
        with pytest.raises(slicewalk.ParameterError, match="waypoints"):
            walker.path(room, wrong)
    with pytest.raises(slicewalk.ParameterError, match=r"^waypoints: expected shape \(N, 2\) or \(N, 3\), found"):
        walker.path(room, [(1, 2, 3, 4)])
    with pytest.raises(ValueError, match="hz"):
        walker.path(room, [(1, 1)], hz=0)


def test_a_stream_gives_the_same_path(room):
    waypoints = [(7, 1), (7, 5), (1, 5)]
    expected = slicewalk.Walker((1, 1, 0.1)).path(room, waypoints)
    for prefetch in (True, False):
        with slicewalk.Stream(room, "8MiB", prefetch=prefetch) as stream:
            path = slicewalk.Walker((1, 1, 0.1)).path(stream, waypoints)
            assert (path.feet == expected.feet).all()
            assert (path.states == expected.states).all()
            counters = stream.counters()
            assert counters["loaded"] > 0
            assert counters["peak_bytes"] <= counters["budget_bytes"] == 8 << 20
            assert stream.errors() == []


@pytest.mark.parametrize("hz", [0.1, 0.5, 1, 60])
def test_long_frames_take_all_of_their_time(room, hz):
    expected = slicewalk.Walker((1, 1, 0)).path(room, [(7, 1), (7, 5)], hz=1000)
    with slicewalk.Stream(room, "16MiB") as stream:
        for pages in (room, stream):
            path = slicewalk.Walker((1, 1, 0)).path(pages, [(7, 1), (7, 5)], hz=hz)
            assert path.state == "arrived"
            assert len(path.seconds) == pytest.approx(expected.seconds[-1] * hz, abs=1.1)


def test_the_length_of_a_path_counts_its_first_frame(room):
    path = slicewalk.Walker((1, 1, 0)).path(room, [(2, 1)], hz=1, max_seconds=1)
    assert path.start == (1, 1, 0)
    assert path.length == pytest.approx(1, abs=0.02)


def test_a_path_ends_below_the_scan(room):
    with slicewalk.Stream(room, "16MiB") as stream:
        for pages in (room, stream):
            path = slicewalk.Walker((20, 20, 1)).path(pages, [(1, 1)])
            assert (path.state, path.seconds[-1] < 2) == ("falling", True)


def test_a_stream_too_small_for_a_step_says_how_much_it_needs(room):
    errors = []
    # The smallest hold not even the table of pages.
    for kib in (1, 2, 4, 8, 16):
        with (
            pytest.raises(slicewalk.ParameterError) as raised,
            slicewalk.Stream(room, f"{kib}KiB", prefetch=False) as stream,
        ):
            slicewalk.Walker((6, 1, 0)).path(stream, [(7, 1)])
        errors.append(raised.value)
    assert {error.at for error in errors} == {"budget"}
    assert "one step needs at least" in str(errors[-1])


def test_a_walker_in_a_stream_waits_and_goes_on(room):
    with slicewalk.Stream(room, "8MiB") as stream:
        walker = slicewalk.Walker((1, 1, 0.1))
        for _ in range(5):
            walker.step(stream, 1 / 60, direction=(1, 0))
            assert stream.settle(20)
        assert not walker.step(stream, 1 / 60, direction=(1, 0)).waits
        assert walker.feet[0] > 1
    with pytest.raises(ValueError, match="closed"):
        walker.step(stream, 1 / 60)
    view = slicewalk.Stream(room, "8MiB").view()
    assert view.overlaps([[9, 9, 9, 10, 10, 10]]) == slicewalk.CLEAR


def test_streams_that_make_no_sense(room):
    with pytest.raises(slicewalk.Error, match=r"\d"):
        slicewalk.Stream(room, 10)
    with pytest.raises(slicewalk.ParameterError, match="unit"):
        slicewalk.Stream(room, "8 lightyears")
    with slicewalk.Stream(room, "8MiB") as stream:
        with pytest.raises(ValueError):
            stream.load([[0, 0, 0, 1, 1, np.inf]])
        with pytest.raises(ValueError):
            stream.body().hint((1, 0, 0, 0, 1, 1), (0, 0, 0))
        with pytest.raises(ValueError):
            stream.settle(-1)
        # The number at fault is named, not another one.
        with pytest.raises(slicewalk.ParameterError, match=r"^velocity: .* within ±1e9 m/s"):
            stream.body().hint((0, 0, 0, 1, 1, 1), (1e300, 0, 0))
        with pytest.raises(slicewalk.ParameterError, match=r"box: .* within ±1e9 m"):
            stream.load([[1e300] * 6])


@pytest.mark.parametrize(("option", "value"), [("hz", 0), ("max_seconds", 0), ("max_seconds", -1)])
def test_paths_name_the_option_that_makes_no_sense(room, option, value):
    with pytest.raises(slicewalk.ParameterError, match=f"^{option}: .* found {value}$") as raised:
        slicewalk.Walker((1, 1, 0)).path(room, [(2, 1)], **{option: value})
    assert raised.value.at == option


def test_reach(room):
    told = []
    reach = room.reach((4, 3, 0.1), progress=lambda *news: told.append(news))
    assert told
    # The middle of a 0.5 m wide pawn stays 0.25 m away from the walls, within a pixel.
    assert reach.area == pytest.approx((7.8 - 0.5) * (5.8 - 0.5), rel=0.1)
    assert len(reach.places) == pytest.approx(reach.area / 0.01)
    assert [round(storey.z, 1) for storey in reach.storeys] == [0]
    assert reach.storeys[0].area == pytest.approx(reach.area)
    assert (reach.passages, reach.leaks, reach.highest_step) == ([], [], None)
    assert reach.lowest_headroom.height == pytest.approx(2.5, abs=0.01)
    assert reach.places[:, 3].max() == pytest.approx(2.9, abs=0.2)
    with pytest.raises(slicewalk.ParameterError, match="cannot stand"):
        room.reach((4, 3, 0.1), pawn="box:0.5x0.5x2.6")


def test_routes(room):
    route = room.route((1, 1, 0.1), (7, 5, 0.1))
    assert route
    assert route.length == pytest.approx(np.hypot(6, 4), rel=0.05)
    assert route.points[0] == pytest.approx((1, 1, 0), abs=0.11)
    assert slicewalk.Walker((1, 1, 0)).path(room, route.points).state == "arrived"
    nowhere = room.route((1, 1, 0.1), (70, 5, 0.1))
    assert not nowhere
    assert (nowhere.length, nowhere.reason, nowhere.points.shape) == (None, "not_standing_to", (0, 3))
    assert room.route((-5, 1, 0.1), (1, 1, 0.1)).reason == "not_standing_from"
    assert room.route((1, 1, 0.1), (1, 1, 2.6)).reason == "not_connected"


def test_a_route_to_its_own_start_has_no_length(room):
    route = room.route((1, 1, 0.1), (1, 1, 0.1))
    assert str(route.length) == "0.0"


def test_a_walker_refuses_places_that_are_too_far(room):
    walker = slicewalk.Walker((1, 1, 0))
    with pytest.raises(slicewalk.ParameterError, match=r"^feet: .* within ±1e9 m"):
        walker.place((1e300, 0, 0))
    assert walker.feet == (1, 1, 0)


def test_real_stairs(real):
    _, archive = real("indoor_two_storey_zup.laz", 0.05)
    low, high = archive.bounds
    feet = np.random.default_rng(1).uniform(low[:2] + 1, high[:2] - 1, (4000, 2))
    boxes = np.column_stack([feet - 0.25, np.full(4000, low[2]), feet + 0.25, np.full(4000, high[2])])
    floors = archive.floor(boxes)
    places = np.column_stack([feet, floors])[np.isfinite(floors)]
    boxes = np.column_stack([places - (0.25, 0.25, -0.1), places + (0.25, 0.25, 1.8)])
    free = places[archive.overlaps(boxes) == slicewalk.CLEAR]
    reaches = []
    for place in free[:40]:
        # A box that is free from 10 cm above the floor up does not show what lies in those 10 cm.
        with contextlib.suppress(slicewalk.ParameterError):
            reaches.append(archive.reach(place))
    reach = max(reaches, key=lambda reach: reach.area)
    assert reach.area > 5
    route = archive.route(reach.places[0, :3], reach.places[-1, :3])
    assert route
    path = slicewalk.Walker(reach.places[0, :3], max_drop=0.35).path(archive, route.points)
    assert path.length > 0.5 * route.length


def test_time_runs_forward(room):
    walker = slicewalk.Walker((1, 1, 0.1))
    for dt in (np.nan, -1, np.inf, -np.inf):
        with pytest.raises(slicewalk.ParameterError, match="dt: expected seconds, 0 or more, found"):
            walker.step(room, dt)
    assert walker.step(room, 0).ticks == 0
    for call in (lambda: walker.step("x", 0.1), lambda: walker.path(None, [(1, 1)])):
        with pytest.raises(TypeError, match="pages: expected an Archive, a View or a Stream, found"):
            call()
    with slicewalk.Stream(room, "16MiB") as stream:
        for seconds in (np.nan, -1):
            with pytest.raises(ValueError, match="seconds: "):
                stream.settle(seconds)


def test_a_closed_stream_ends_with_its_thread_whoever_walked_on_it(folder):
    def threads():
        return sorted(
            pathlib.Path(f"/proc/self/task/{task}/comm").read_text() for task in os.listdir("/proc/self/task")
        )

    archive = slicewalk.open(folder / "room.slices")
    stream = slicewalk.Stream(archive, "16MiB")
    walker, body = slicewalk.Walker((1, 1, 0.1)), stream.body()
    walker.step(stream, 0.1)
    view = stream.view()
    if pathlib.Path("/proc/self/task").exists():
        # A thread names itself once it runs.
        until = time.monotonic() + 60
        while "slicewalk-prefe\n" not in threads():
            assert time.monotonic() < until
            time.sleep(0.01)
        stream.close()
        assert "slicewalk-prefe\n" not in threads()
    stream.close()
    assert "closed" in repr(stream)
    assert "closed" in repr(body)
    assert "pages in memory" in repr(view)
    for call in (
        lambda: walker.step(stream, 0.1),
        lambda: walker.path(stream, [(2, 2)]),
        lambda: body.hint((0, 0, 0, 1, 1, 1), (0, 0, 0)),
        stream.view,
    ):
        with pytest.raises(ValueError, match="the stream is closed"):
            call()
    with slicewalk.Stream(archive, "16MiB") as other:
        assert walker.step(other, 0.1).ticks >= 0
        assert "of 16777216 bytes" in repr(other)


def test_a_path_ends_when_its_stream_is_closed(folder):
    stream = slicewalk.Stream(slicewalk.open(folder / "room.slices"), "16MiB")
    timer = threading.Timer(0.3, stream.close)
    timer.start()
    with pytest.raises(ValueError, match="the stream is closed"):
        # Keeps turning.
        slicewalk.Walker((1, 1, 0.1)).path(stream, [(1, 1), (7, 5)] * 100_000, max_seconds=1e6, hz=1000)
    timer.join()
