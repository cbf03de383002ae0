"""Obstructions of pawns: in scenes with known obstructions, and against slicetool."""

from __future__ import annotations

import json
import os
import subprocess

import numpy as np
import pytest

import scan
import slicewalk

PROGRAMS = os.environ.get("SLICEWALK_PROGRAMS")
START, GOAL = (1, 3, 0.1), (7, 3, 0.1)
ON_STAGE = (7, 3, 0.6)


def face(*sides):
    """Points every 5 cm on an axis-aligned face; each side is a coordinate or a range."""
    axes = [np.arange(side[0] + 0.025, side[1], 0.05) if isinstance(side, tuple) else [side] for side in sides]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def wall(y, z):
    return face(4.025, y, z)


GROUND = [face((0, 8), (0, 6), 0)]
SCENES = {
    "narrow": ([*GROUND, wall((0, 2.7), (0, 2.5)), wall((3.3, 6), (0, 2.5))], {"pawn": "box:0.9x0.9x1.8"}),
    "low": ([*GROUND, wall((0, 2.4), (0, 2.5)), wall((2.4, 3.6), (1.5, 2.5)), wall((3.6, 6), (0, 2.5))], {}),
    "high": ([face((0, 4), (0, 6), 0), face((4, 8), (0, 6), 0.5), wall((0, 6), (0, 0.5))], {}),
    "islands": ([face((0, 4), (0, 6), 0), face((5.5, 8), (0, 6), 0)], {}),
}
REASONS = {
    "narrow": ("width", 0.6, 0.11),
    "low": ("headroom", 1.5, 0.05),
    "high": ("step", 0.5, 0.03),
    "islands": ("unseen", 1.5, 0.5),
}


@pytest.fixture(scope="module", params=SCENES)
def scene(request, tmp_path_factory):
    """Name, archive, goal and pawn of each scene."""
    faces, pawn = SCENES[request.param]
    path = tmp_path_factory.mktemp("scene") / "scene.slices"
    archive = slicewalk.from_numpy(scan.millimetres(np.concatenate(faces)), path, pixel=scan.PIXEL)
    return request.param, archive, ON_STAGE if request.param == "high" else GOAL, pawn


def of_slicetool(archive, start, goal, *options):
    ends = [f"--{name}={','.join(map(str, at))}" for name, at in (("from", start), ("to", goal))]
    command = [f"{PROGRAMS}/slicetool", "route", archive.path, *ends, "--json", *options]
    blocked = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)["blocked"]
    return (blocked["x"], blocked["y"], blocked["z"]), blocked["reason"], blocked["needs"]


def check_same(blocked, expected):
    at, reason, needs = expected
    assert blocked.reason == reason
    assert blocked.at == pytest.approx(at, abs=2e-6)
    assert blocked.needs == pytest.approx(needs, abs=2e-6)


def test_reasons_places_and_needs(scene):
    name, archive, goal, pawn = scene
    route = archive.route(START, goal, explain=True, **pawn)
    reason, needs, within = REASONS[name]
    assert (bool(route), route.reason, route.blocked.reason) == (False, "not_connected", reason)
    assert route.blocked.needs == pytest.approx(needs, abs=within)
    assert isinstance(route.blocked.at, tuple)
    assert 2.5 <= route.blocked.at[0] <= 4.3
    assert reason in repr(route)
    # Only on demand, because it takes long.
    assert archive.route(START, goal, **pawn).blocked is None
    assert archive.route(START, (2, 3, 0.1), explain=True, **pawn).blocked is None
    assert archive.route(START, (70, 3, 0.1), explain=True, **pawn).blocked is None
    with slicewalk.Stream(archive, "64MiB") as stream:
        stream.load([[*archive.bounds[0], *archive.bounds[1]]])
        assert stream.view().route(START, goal, explain=True, **pawn).blocked == route.blocked
    # The named change is enough.
    change = {
        "width": {"pawn": f"box:{route.blocked.needs}x{route.blocked.needs}x1.8"},
        "headroom": {"pawn": f"box:0.5x0.5x{route.blocked.needs}"},
        "step": {"climb": route.blocked.needs},
    }
    if reason in change:
        assert archive.route(START, goal, **change[reason])


@pytest.mark.skipif(PROGRAMS is None, reason="SLICEWALK_PROGRAMS names no folder with slicetool")
def test_answers_are_those_of_slicetool(scene):
    _, archive, goal, pawn = scene
    options = [f"--pawn={pawn['pawn']}"] if pawn else []
    check_same(archive.route(START, goal, explain=True, **pawn).blocked, of_slicetool(archive, START, goal, *options))


@pytest.fixture(scope="module")
def halls(tmp_path_factory):
    """A hall of which stations saw both ends; of the middle only the floor was scanned, from just above it."""
    folder, points = tmp_path_factory.mktemp("halls"), scan.room()
    x, z = points[:, 0], points[:, 2]
    parts = {"west": x < 3.1, "east": x > 4.9, "middle": (x >= 3.1) & (x <= 4.9) & (z == 0)}
    for name, part in parts.items():
        (folder / f"{name}.las").write_bytes(scan.las(points[part]))
    stations = "file,x,y,z\nwest.las,1.8,3,1.5\neast.las,6.2,3,1.5\nmiddle.las,4,3,0.1\n"
    (folder / "stations.csv").write_text(stations)
    options = {"free_space": True, "stations": folder / "stations.csv"}
    files = [folder / f"{name}.las" for name in parts]
    slicewalk.convert(files, folder / "halls.slices", pixel=scan.PIXEL, units="m", **options)
    return slicewalk.open(folder / "halls.slices")


def test_unseen_ground_is_the_reason_in_seen_space(halls):
    pawn, start, goal = "box:0.5x0.5x1.7", (1.4, 2.2, 0.1), (6.6, 2.2, 0.1)
    assert halls.route(start, goal, pawn=pawn)
    route = halls.route(start, goal, pawn=pawn, seen=True, explain=True)
    assert (route.reason, route.blocked.reason) == ("not_connected", "unseen")
    # Seen space at body height ends about 2 m from the middle.
    assert 3 < route.blocked.needs < 5
    if PROGRAMS is not None:
        check_same(route.blocked, of_slicetool(halls, start, goal, f"--pawn={pawn}", "--seen"))


def test_the_search_can_be_interrupted_and_needs_its_pages(scene):
    _, archive, goal, pawn = scene
    stages = []

    def stop(stage, *_):
        stages.append(stage)
        if stage == "obstruction":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        archive.route(START, goal, explain=True, progress=stop, **pawn)
    assert stages[-1] == "obstruction"
    with slicewalk.Stream(archive, "64MiB") as stream, pytest.raises(slicewalk.NotLoadedError):
        stream.view().route(START, goal, explain=True, **pawn)
    with pytest.raises(TypeError, match="explain"):
        archive.route(START, goal, explain=None)
