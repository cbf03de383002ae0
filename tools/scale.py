#!/usr/bin/env python3
"""Estimates cost and schedule of a large conversion: `tools/scale.py SURVEY [--workers N] [--parts N] [--seed S] ...`.

The cost model multiplies measured constants; the schedule is simulated, with parts of unequal length, stragglers and workers
that are lost. `tools/lab/results/costs.md` explains both and states where the constants come from. Equal arguments give equal output.
"""

from __future__ import annotations

import argparse
import heapq
import math
import random
from dataclasses import dataclass, fields, replace

GB = 1e9


@dataclass(frozen=True)
class Survey:
    """The scan to convert."""

    tiles: int
    points: float
    area_m2: float
    pixel_m: float
    laz_bytes_a_point: float


SURVEYS = {
    # AHN4: the Netherlands in about 1,370 sheets of 5 x 6.25 km, published as 640 G points; as tiles of 1 km2.
    "ahn": Survey(tiles=41_500, points=640e9, area_m2=41.5e9, pixel_m=0.5, laz_bytes_a_point=5.5),
    # All ice-free land in tiles of 1 km2, at 10 points per square metre.
    "world": Survey(tiles=100_000_000, points=1e15, area_m2=100e12, pixel_m=0.5, laz_bytes_a_point=5.5),
}


@dataclass(frozen=True)
class Constants:
    """Measured on the machine of `tools/lab/results/costs.md`; a core is one of its cores."""

    points_a_second: float = 1.24e6
    """LAZ points that one thread converts per second."""
    spilled_bytes_a_point: float = 9.0
    """Temporary bytes per point of a part that exceeds its memory."""
    archive_bytes_a_m2: float = 10.4
    """Archive bytes per square metre at the survey's pixel size."""
    pages_a_column: float = 2.2
    """Pages (64 x 64 pixels, 64 slices) in an occupied tile column."""
    merged_pages_a_second: float = 16_000.0
    """Pages that one merge reads, checks and writes per second."""
    read_again: float = 0.15
    """Fraction of the input that parts read in addition to their own: files cut by the border of a part."""
    requests_a_tile: float = 12.0
    """Requests to inspect a tile: header, records, chunk table, eight samples. The plan sends them for all tiles, a
    part for those that meet its columns."""
    tiles_a_list: float = 1000.0
    """Names per answer when a store lists a folder; every part lists its inputs."""
    plan_bytes_a_tile: float = 390.0
    """Bytes per tile of the plan file, which every part reads."""
    bytes_a_request: float = 8e6
    """Bytes per request for points."""
    plan_seconds_a_tile: float = 0.0004
    most_pages: float = 512 * 2**20
    """Most pages of one archive (spec, chapter 5)."""
    most_parts: int = 65_536
    most_shared: int = 32_768
    """Most inputs of one part that other parts read too."""


@dataclass(frozen=True)
class Prices:
    """Example prices, not quotes: insert your own."""

    core_hour: float = 0.04
    stored_gb_month: float = 0.023
    thousand_requests: float = 0.0004
    egress_gb: float = 0.0


@dataclass(frozen=True)
class Cluster:
    """Workers and their failures."""

    workers: int = 256
    parts: int = 4096
    fan_in: int = 64
    unequal: float = 0.3
    """Standard deviation of the logarithm of a part's length."""
    stragglers: float = 0.02
    """Fraction of attempts on a machine that takes `slower` times as long."""
    slower: float = 3.0
    lost: float = 0.01
    """Fraction of attempts that lose their worker, at a uniformly random moment."""
    restart_s: float = 120.0
    """Seconds until another worker is available and known to the scheduler."""
    failures: int = 16


def costs(survey: Survey, constants: Constants, prices: Prices, cluster: Cluster) -> dict[str, float]:
    """Totals: bytes, requests, core hours, money."""
    read = survey.points * survey.laz_bytes_a_point * (1 + constants.read_again)
    columns = survey.area_m2 / (64 * survey.pixel_m) ** 2
    pages = columns * constants.pages_a_column
    stored = survey.area_m2 * constants.archive_bytes_a_m2
    levels = depth(cluster.parts, cluster.fan_in)
    convert_s = survey.points * (1 + constants.read_again) / constants.points_a_second
    merge_s = pages * levels / constants.merged_pages_a_second
    plans = survey.tiles * constants.plan_bytes_a_tile * cluster.parts
    requests = (
        survey.tiles * constants.requests_a_tile * (2 + constants.read_again)
        + survey.tiles / constants.tiles_a_list * (1 + cluster.parts)
        + plans / constants.bytes_a_request
        + read / constants.bytes_a_request
        + stored * (1 + 2 * levels) / constants.bytes_a_request
    )
    core_hours = (convert_s + merge_s) / 3600
    money = (
        core_hours * prices.core_hour
        + requests / 1000 * prices.thousand_requests
        + stored / GB * prices.stored_gb_month
        + (read + plans) / GB * prices.egress_gb
    )
    return {
        "bytes_read": read,
        "bytes_of_plans": plans,
        "bytes_spilled": survey.points * constants.spilled_bytes_a_point,
        "bytes_stored": stored,
        "pages": pages,
        "requests": requests,
        "core_hours": core_hours,
        "money": money,
        "plan_seconds": survey.tiles * constants.plan_seconds_a_tile,
    }


def breaks(survey: Survey, constants: Constants, cluster: Cluster) -> list[tuple[str, float]]:
    """Return limits as multiples of what this conversion needs, the tightest first; a value below 1 is exceeded."""
    pages = survey.area_m2 / (64 * survey.pixel_m) ** 2 * constants.pages_a_column
    # Tiles along the border of a compact part, and of the largest node below the root of the tree.
    border = 4 * math.sqrt(survey.tiles / cluster.parts) + 4
    node = survey.tiles / min(cluster.fan_in, cluster.parts)
    listed = survey.tiles / constants.tiles_a_list * cluster.parts
    plan_bytes = survey.tiles * constants.plan_bytes_a_tile
    limits = [
        ("pages of one archive", constants.most_pages / pages),
        ("parts of one plan", constants.most_parts / cluster.parts),
        ("shared inputs of one part", constants.most_shared / border),
        ("shared inputs of one node of the tree", constants.most_shared / node),
        ("plan file of 256 MiB", (256 << 20) / plan_bytes),
        ("lists of all tiles by all parts, within 10^9 requests", 1e9 / listed),
        ("last merge by one thread, within a day", 86400 * constants.merged_pages_a_second / pages),
    ]
    return sorted(limits, key=lambda limit: limit[1])


def depth(parts: int, fan_in: int) -> int:
    """Return the levels of the tree of merges."""
    levels = 1
    while parts > fan_in:
        parts, levels = -(-parts // fan_in), levels + 1
    return levels


def simulate(survey: Survey, constants: Constants, cluster: Cluster, seed: int) -> dict[str, float]:
    """Return seconds until all parts and until the whole are done, busy fraction of the workers, and lost attempts."""
    dice = random.Random(seed)
    mean = survey.points * (1 + constants.read_again) / constants.points_a_second / cluster.parts
    lengths = [mean * dice.lognormvariate(-(cluster.unequal**2) / 2, cluster.unequal) for _ in range(cluster.parts)]
    pages = survey.area_m2 / (64 * survey.pixel_m) ** 2 * constants.pages_a_column
    free = [0.0] * cluster.workers
    now, busy, lost = 0.0, 0.0, 0
    levels, nodes = [lengths], cluster.parts
    while nodes > cluster.fan_in:
        nodes = -(-nodes // cluster.fan_in)
        levels.append([pages / nodes / constants.merged_pages_a_second] * nodes)
    levels.append([pages / constants.merged_pages_a_second])
    parts_done = 0.0
    for level in levels:
        # The lengths are unknown, so Dask takes parts in order. A level waits for the one below.
        done = now
        todo = [(length, 0) for length in reversed(level)]
        while todo:
            length, losses = todo.pop()
            start = max(heapq.heappop(free), now)
            took = length * (cluster.slower if dice.random() < cluster.stragglers else 1.0)
            if dice.random() < cluster.lost:
                took *= dice.random()
                lost, losses = lost + 1, losses + 1
                if losses > cluster.failures:
                    raise RuntimeError("a step lost its worker too often")
                todo.append((length, losses))
                heapq.heappush(free, start + took + cluster.restart_s)
            else:
                done = max(done, start + took)
                heapq.heappush(free, start + took)
            busy += took
        now = done
        parts_done = parts_done or now
    return {
        "parts_hours": parts_done / 3600,
        "hours": now / 3600,
        "last_merge_hours": levels[-1][0] / 3600,
        "busy": busy / (now * cluster.workers),
        "lost": lost,
        "ideal_hours": sum(lengths) / cluster.workers / 3600,
    }


def main(arguments: list[str] | None = None) -> None:
    """Print costs, schedule and limits."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("survey", choices=SURVEYS)
    parser.add_argument("--seed", type=int, default=1)
    groups = (Survey, Constants, Prices, Cluster)
    for group in groups:
        for field in fields(group):
            kind = int if field.type == "int" else float
            parser.add_argument(f"--{field.name.replace('_', '-')}", type=kind, metavar="N")
    given = parser.parse_args(arguments)

    def filled(base):
        named = {field.name: getattr(given, field.name) for field in fields(base)}
        return replace(base, **{name: value for name, value in named.items() if value is not None})

    survey, constants = filled(SURVEYS[given.survey]), filled(Constants())
    prices, cluster = filled(Prices()), filled(Cluster())
    for name, value in costs(survey, constants, prices, cluster).items():
        print(f"{name:20} {value:.4g}")
    for name, value in simulate(survey, constants, cluster, given.seed).items():
        print(f"{name:20} {value:.4g}")
    for name, value in breaks(survey, constants, cluster):
        print(f"{'BROKEN' if value < 1 else 'room'}: {name}: {value:.3g} x")


if __name__ == "__main__":
    main()
