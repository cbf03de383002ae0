"""Pawns with limits of their own: grades, ramps with landings, lengths. Answers are also compared with slicetool."""

from __future__ import annotations

import json
import os
import subprocess

import numpy as np
import pytest

import scan
import slicewalk

PROGRAMS = os.environ.get("SLICEWALK_PROGRAMS")
WHEELCHAIR = {"pawn": "cylinder:0.4x1.4", "climb": 0.02}
OPTIONS = ["--pawn=cylinder:0.4x1.4", "--climb=0.02"]
PIXEL = 0.05


def archive_of(points, path):
    return slicewalk.from_numpy(scan.millimetres(points), path, pixel=PIXEL)


def grid(width, depth):
    """Points every 2.5 cm, two along each edge of a pixel."""
    x, y = np.meshgrid(np.arange(0.0125, width, 0.025), np.arange(0.0125, depth, 0.025), indexing="ij")
    return x.ravel(), y.ravel()


@pytest.fixture(scope="module")
def ramp(tmp_path_factory):
    """Level ground, 8 m of ramp at 5.5 %, level ground."""
    x, y = grid(14, 3)
    points = np.stack([x, y, 0.055 * np.clip(x - 3, 0, 8)], axis=1)
    return archive_of(points, tmp_path_factory.mktemp("ramp") / "ramp.slices")


@pytest.fixture(scope="module")
def bend(tmp_path_factory):
    """Two corridors 1.1 m wide with a right angle between them."""
    width = 1.1
    x, y = grid(6.2, 6.2)
    inner = ((x < width) | (y < width)) & (x > 0.1) & (y > 0.1)
    walls = ~inner & ((x < width + 0.05) | (y < width + 0.05))
    heights = np.arange(0, 2, 0.05)
    stacked = [np.repeat(v[walls], len(heights)) for v in (x, y)]
    points = [
        np.stack([x[inner], y[inner], np.zeros(inner.sum())], axis=1),
        np.stack([*stacked, np.tile(heights, walls.sum())], axis=1),
    ]
    return archive_of(np.concatenate(points), tmp_path_factory.mktemp("bend") / "bend.slices")


def of_slicetool(archive, start, goal, *options):
    ends = [f"--{name}={','.join(map(str, at))}" for name, at in (("from", start), ("to", goal))]
    command = [f"{PROGRAMS}/slicetool", "route", archive.path, *ends, "--json", *OPTIONS, *options]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def check_same(route, answer):
    assert route.found == answer["found"]
    if route.found:
        assert route.length == pytest.approx(answer["length_m"], abs=1e-5)
    else:
        assert route.blocked.reason == answer["blocked"]["reason"]
        percent = 100 if route.blocked.reason == "slope" else 1
        assert route.blocked.needs * percent == pytest.approx(answer["blocked"]["needs"], abs=1e-5)


@pytest.mark.parametrize(
    ("limits", "options", "reason", "needs"),
    [
        ({}, [], None, None),
        ({"max_grade": 0.06}, ["--max-grade=6"], None, None),
        ({"max_grade": 0.04}, ["--max-grade=4"], "slope", 0.055),
        ({"max_ramp": 6}, ["--max-ramp=6"], "ramp", 8),
        ({"max_ramp": 9}, ["--max-ramp=9"], None, None),
    ],
)
def test_grades_and_landings(ramp, limits, options, reason, needs):
    start, goal = (1, 1.5, 0.1), (13, 1.5, 0.54)
    route = ramp.route(start, goal, explain=True, **WHEELCHAIR, **limits)
    assert (route.found, route.headings) == (reason is None, None)
    if reason is not None:
        assert route.blocked.reason == reason
        assert route.blocked.needs == pytest.approx(needs, rel=0.06)
    reach = ramp.reach(start, **WHEELCHAIR, **limits)
    farthest = reach.places[:, 0].max()
    assert (farthest > 12.5) == route.found
    if PROGRAMS is not None:
        check_same(route, of_slicetool(ramp, start, goal, *options))


def test_a_long_pawn_turns_where_there_is_room(bend):
    start, goal = (0.55, 4.5, 0.1), (4.5, 0.55, 0.1)
    route = bend.route(start, goal, **WHEELCHAIR, length=1.0)
    assert route
    assert route.headings.shape == (len(route.points),)
    # Down the one corridor, to the right along the other.
    assert abs(route.headings[0] - 180) < 30
    assert abs(route.headings[-1] - 90) < 30
    long = bend.route(start, goal, **WHEELCHAIR, length=2.0, explain=True)
    assert (long.reason, long.blocked.reason, long.headings.size) == ("not_connected", "length", 0)
    assert 1.0 < long.blocked.needs < 2.0
    areas = [bend.reach(start, **WHEELCHAIR, length=length).area for length in (None, 1.0, 2.0)]
    assert areas[0] >= areas[1] > 1.5 * areas[2]
    if PROGRAMS is not None:
        check_same(route, of_slicetool(bend, start, goal, "--length=1"))
        check_same(long, of_slicetool(bend, start, goal, "--length=2"))


def test_limits_that_no_pawn_can_have_are_refused(ramp):
    start, goal = (1, 1.5, 0.1), (13, 1.5, 0.54)
    for wrong in ({"max_grade": 0}, {"max_ramp": -1}, {"max_grade": float("nan")}, {"length": 0.5}):
        with pytest.raises(slicewalk.ParameterError):
            ramp.route(start, goal, **WHEELCHAIR, **wrong)
        with pytest.raises(slicewalk.ParameterError):
            ramp.reach(start, **WHEELCHAIR, **wrong)
    with pytest.raises(slicewalk.ParameterError, match="cylinder"):
        ramp.route(start, goal, pawn="box:0.5x0.5x1.8", length=1)
