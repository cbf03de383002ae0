"""The cost model and the simulated schedule of `tools/scale.py`."""

from __future__ import annotations

import importlib.util
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

PATH = Path(__file__).parents[3] / "tools" / "scale.py"
spec = importlib.util.spec_from_file_location("scale", PATH)
scale = importlib.util.module_from_spec(spec)
sys.modules["scale"] = scale
spec.loader.exec_module(scale)

AHN, CONSTANTS, CLUSTER = scale.SURVEYS["ahn"], scale.Constants(), scale.Cluster()
CALM = replace(CLUSTER, unequal=0, stragglers=0, lost=0)


def test_the_same_seed_gives_the_same_schedule():
    for survey in ("ahn", "world"):
        arguments = [sys.executable, PATH, survey, "--seed", "5", "--parts", "512"]
        first, second = (subprocess.check_output(arguments) for _ in range(2))
        assert first == second
    assert scale.simulate(AHN, CONSTANTS, CLUSTER, 1) != scale.simulate(AHN, CONSTANTS, CLUSTER, 2)


@pytest.mark.parametrize(("parts", "workers"), [(1, 1), (64, 64), (100, 7), (4096, 256)])
def test_equal_parts_on_calm_workers_take_what_arithmetic_says(parts, workers):
    cluster = replace(CALM, parts=parts, workers=workers)
    found = scale.simulate(AHN, CONSTANTS, cluster, 1)
    one = AHN.points * (1 + CONSTANTS.read_again) / CONSTANTS.points_a_second / parts / 3600
    assert math.isclose(found["parts_hours"], one * math.ceil(parts / workers))
    assert found["lost"] == 0
    assert found["hours"] >= 0.999 * (found["parts_hours"] + found["last_merge_hours"])


def test_what_goes_wrong_costs_time_and_about_its_share_is_lost():
    calm = scale.simulate(AHN, CONSTANTS, CALM, 1)
    for worse in ({"lost": 0.05}, {"stragglers": 0.2}, {"unequal": 0.8}):
        assert scale.simulate(AHN, CONSTANTS, replace(CALM, **worse), 1)["hours"] > calm["hours"]
    many = replace(CLUSTER, parts=20_000, lost=0.01)
    assert 130 < scale.simulate(AHN, CONSTANTS, many, 3)["lost"] < 280
    assert 0 < scale.simulate(AHN, CONSTANTS, many, 3)["busy"] <= 1
    with pytest.raises(RuntimeError):
        scale.simulate(AHN, CONSTANTS, replace(CLUSTER, lost=1.0), 1)


def test_costs_grow_with_the_survey_and_limits_break_in_the_end():
    twice = replace(AHN, points=2 * AHN.points, area_m2=2 * AHN.area_m2, tiles=2 * AHN.tiles)
    prices = scale.Prices()
    once, double = (scale.costs(survey, CONSTANTS, prices, CLUSTER) for survey in (AHN, twice))
    for name, value in once.items():
        assert math.isclose(double[name], 2 * value), name
    assert dict(scale.breaks(AHN, CONSTANTS, CLUSTER))["pages of one archive"] > 1
    world = scale.breaks(scale.SURVEYS["world"], CONSTANTS, replace(CLUSTER, parts=65_536))
    assert dict(world)["pages of one archive"] < 1
    assert world == sorted(world, key=lambda limit: limit[1])


def test_levels_of_the_tree():
    assert [scale.depth(parts, 64) for parts in (1, 64, 65, 4096, 4097)] == [1, 1, 2, 2, 3]
