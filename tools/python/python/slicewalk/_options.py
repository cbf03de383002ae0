"""Conversion options, named as on the command line but with underscores. `src/options.rs` reads them."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from typing import Literal, TypedDict

StrPath = str | PathLike[str]
Place = tuple[float, float, float]


class _ArchiveOptions(TypedDict, total=False):
    slice: float | None
    max_slope: float
    classifier: Literal["plane", "span", "thesis"]
    min_points: int
    drop_isolated: bool
    drop_floaters: int
    levels: bool | Literal["on", "off"]


class _WorkOptions(TypedDict, total=False):
    memory: int | str
    threads: int | None
    temp_dir: StrPath | None
    force: bool


class WriterOptions(_ArchiveOptions, _WorkOptions, total=False):
    """Options of a `Writer`, which knows neither the floor nor the spacing of the points."""

    tolerance: float
    fill_holes: float | None
    up: Literal["z", "y"]
    crs: str


class ClusterOptions(_ArchiveOptions, total=False):
    """Options of `cluster.convert`."""

    pixel: float | Literal["auto"]
    tolerance: float | Literal["auto"]
    fill_holes: float | Literal["auto"] | None
    up: Literal["auto", "z", "y", "x", "-z", "-y", "-x"]
    exclude_class: str | int | Iterable[int]
    remove_moving: bool
    free_space: bool
    stations: StrPath | None
    units: float | Literal["auto", "m", "ft", "us-ft"]
    scale_from: tuple[Place, Place, float]
    transform: StrPath | None
    opacity: float
    min_opacity: float
    max_size: float | None
    crs: str | None
    columns: str | None
    mesh: Literal["exact", "sampled"]
    colour: Literal["rgb", "intensity", "class", "auto", "off"]
    colour_error: float
    allow_incomplete: bool
    quiet: bool


class PlanOptions(ClusterOptions, _WorkOptions, total=False):
    """Options of `write_plan`."""


class ConvertOptions(PlanOptions, total=False):
    """Options of `convert`."""

    plan: StrPath | None
    removed: StrPath | None
    resume: bool
    shard: str | tuple[int, int] | None
