"""Results of queries that are more than a number."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    _Place = tuple[float, float, float]

STATES = np.array(["walking", "falling", "blocked", "arrived"])


@dataclass(frozen=True, eq=False)
class Region:
    """The voxels of a box; see :meth:`Pages.region`. All arrays have the shape (slices, rows along y, columns along x).

    Attributes:
        kind: uint8, 0 empty, 1 floor, 2 obstacle
        bottom: uint8, lowest solid in the voxel (quanta above the slice's floor, 0 to 255; 0 in an empty voxel)
        top: uint8, highest solid in the voxel (like `bottom`)
        first: column, row and slice of the first voxel, counted from the origin
        pixel_size: edge of a pixel (m)
        slice_height: height of a slice (m)

    """

    kind: NDArray[np.uint8]
    bottom: NDArray[np.uint8]
    top: NDArray[np.uint8]
    first: tuple[int, int, int]
    pixel_size: float
    slice_height: float

    @property
    def occupied(self) -> NDArray[np.bool_]:
        """True for each occupied voxel."""
        return self.kind > 0

    @property
    def x(self) -> NDArray[np.float64]:
        """Middle of each column (m)."""
        return (self.first[0] + 0.5 + np.arange(self.kind.shape[2], dtype=np.float64)) * self.pixel_size

    @property
    def y(self) -> NDArray[np.float64]:
        """Middle of each row (m)."""
        return (self.first[1] + 0.5 + np.arange(self.kind.shape[1], dtype=np.float64)) * self.pixel_size

    @property
    def z(self) -> NDArray[np.float64]:
        """Lower end of each slice (m)."""
        return (self.first[2] + np.arange(self.kind.shape[0], dtype=np.float64)) * self.slice_height

    @property
    def points(self) -> NDArray[np.float64]:
        """Middle of each occupied voxel (m), of shape (N, 3), in the order of ``kind[occupied]``."""
        slices, rows, columns = np.nonzero(self.kind)
        return np.column_stack([self.x[columns], self.y[rows], self.z[slices] + 0.5 * self.slice_height])

    def __repr__(self) -> str:
        """Return size and counts of voxels."""
        count = " × ".join(map(str, self.kind.shape))
        occupied, obstacle = int(np.count_nonzero(self.kind)), int(np.count_nonzero(self.kind == 2))
        return f"<slicewalk.Region of {count} voxels: {occupied} occupied, {obstacle} of them obstacles>"

    def slices(self) -> dict[int, NDArray[np.uint8]]:
        """Return a view of `kind` for each occupied slice, keyed by the slice's number (slice 0 begins at z = 0).

        >>> slices = slicewalk.open("room.slices").region((0, 0, 0, 8, 6, 2.5)).slices()
        >>> slices[0].shape, len(slices)
        ((61, 81), 9)
        """
        layers = enumerate(self.kind, self.first[2])
        return {number: layer for number, layer in layers if layer.any()}

    def to_xarray(self) -> Any:
        """Return an ``xarray.Dataset`` of kind, bottom and top over z, y, x (centres of voxels). Needs xarray."""
        import xarray  # noqa: PLC0415

        axes = ("z", "y", "x")
        fields = {"kind": (axes, self.kind), "bottom": (axes, self.bottom), "top": (axes, self.top)}
        middles = self.z + 0.5 * self.slice_height
        places = {"z": middles, "y": self.y, "x": self.x}
        facts = {"pixel_size": self.pixel_size, "slice_height": self.slice_height}
        return xarray.Dataset(fields, places, facts)


class SurfacePoints(NamedTuple):
    """The nearest places on the surface of solid space; see :meth:`Pages.nearest_surfaces`.

    `distance` has the shape (N,), `point` and `gradient` have (N, 3).
    """

    distance: NDArray[np.float64]
    point: NDArray[np.float64]
    gradient: NDArray[np.float64]


def surface_points(rows: NDArray[np.float64]) -> SurfacePoints:
    """Split rows of seven numbers: distance, point, gradient."""
    return SurfacePoints(rows[:, 0], rows[:, 1:4], rows[:, 4:7])


class Storey(NamedTuple):
    """Floors at about the same height: middle height (m) and area (m²)."""

    z: float
    area: float


class Passage(NamedTuple):
    """A narrow place between two wider ones: its middle on the floor and its clear width (m)."""

    at: _Place
    width: float


class Leak(NamedTuple):
    """A place where a region ends although nothing blocks it.

    `kind` is ``"hole"``, ``"edge"`` or ``"ledge"``; `drop` is the depth (m), or None if nothing was scanned below.
    """

    at: _Place
    width: float
    drop: float | None
    kind: str


class Extreme(NamedTuple):
    """A place and the height there (m)."""

    at: _Place
    height: float


@dataclass(frozen=True, eq=False)
class Reach:
    """Everything that a pawn can reach on foot; see :meth:`Pages.reach`.

    Attributes:
        area: area of all standing places (m²)
        storeys: storeys from the lowest up
        passages: passages, narrowest first
        leaks: leaks, ordered by place
        lowest_headroom: None under the open sky
        highest_step: None on a level floor
        places: float64 of shape (N, 4), ``x, y, z, clearance`` of each standing place (m), at the middle of a pixel

    """

    area: float
    storeys: list[Storey]
    passages: list[Passage]
    leaks: list[Leak]
    lowest_headroom: Extreme | None
    highest_step: Extreme | None
    places: NDArray[np.float64]

    def __repr__(self) -> str:
        """Return area and counts."""
        return (
            f"<slicewalk.Reach: {self.area:.1f} m², {len(self.places)} places, storeys {len(self.storeys)}, "
            f"passages {len(self.passages)}, leaks {len(self.leaks)}>"
        )

    @classmethod
    def _of(  # noqa: PLR0913, PLR0917
        cls,
        area: float,
        storeys: list[Any],
        passages: list[Any],
        leaks: list[Any],
        headroom: Any,
        step: Any,
        places: NDArray[np.float64],
    ) -> Reach:
        return cls(
            area,
            [Storey(*storey) for storey in storeys],
            [Passage(tuple(at), width) for at, width in passages],
            [Leak(tuple(at), width, drop, kind) for at, width, drop, kind in leaks],
            Extreme(tuple(headroom[0]), headroom[1]) if headroom else None,
            Extreme(tuple(step[0]), step[1]) if step else None,
            places,
        )


class Obstruction(NamedTuple):
    """Obstruction of a pawn: where its best way stops, and the measure that would pass.

    The best way stops at `at`. Of the changes that open a way, `reason` is the smallest one relative to the pawn:

    - ``"width"``, ``"length"``, ``"headroom"``: `needs` is the width along its shorter side, the length or the height
      of the largest pawn that passes with all else as it is (m)
    - ``"step"``, ``"slope"``, ``"ramp"``: `needs` is the `climb` (m), the `max_grade` or the `max_ramp` (m) that passes
    - ``"gap"``: the ground between is deeper, or a wall without a way through; ``"unseen"``: it was not scanned, or
      with ``seen=True`` the pawn was not seen on it; `needs` is the distance to the ground that leads to the goal (m)
    """

    at: _Place
    reason: str
    needs: float


@dataclass(frozen=True, eq=False)
class Route:
    """A route; see :meth:`Pages.route`.

    Attributes:
        found: whether there is a route
        length: length of the lines between its points, including heights (m); None without a route
        reason: why there is no route: ``"not_standing_from"``, ``"not_standing_to"``, ``"not_connected"``. With
            ``seen=True``, ground on which the pawn was not seen counts as none
        points: float64 of shape (N, 3): places to reach in turn (m)
        blocked: with ``explain=True``, what is in the way if the two places are not connected; otherwise None
        headings: of a pawn with a `length`, float64 of shape (N,): its heading at each point (degrees clockwise from
            +y, 0 to 360); two points at one place are a turn. Otherwise None

    """

    found: bool
    length: float | None
    reason: str | None
    points: NDArray[np.float64]
    blocked: Obstruction | None = None
    headings: NDArray[np.float64] | None = None

    def __bool__(self) -> bool:
        """Return whether there is a route."""
        return self.found

    def __repr__(self) -> str:
        """Return the length, or why there is no route."""
        if self.length is None:
            why = f" ({self.blocked.reason})" if self.blocked else ""
            return f"<slicewalk.Route: none, {self.reason}{why}>"
        return f"<slicewalk.Route: {self.length:.2f} m, {len(self.points)} points>"


class StepReport(NamedTuple):
    """Result of a step of a :class:`Walker`.

    `stop` says what blocked the pawn: ``"wall"``, ``"steep"``, ``"headroom"``, ``"corner"``, ``"inside"``, ``"ledge"``,
    ``"void"``, or None. `missing` counts the pages that it waits for; `unspent` is the time left over (s).
    """

    state: str
    stop: str | None
    missing: int
    unspent: float
    ticks: int
    moved: _Place

    @property
    def waits(self) -> bool:
        """True if the pawn waits for pages."""
        return self.missing > 0


@dataclass(frozen=True, eq=False)
class Path:
    """The path that a :class:`Walker` took.

    Attributes:
        seconds: float64 of shape (N,): time after each frame (s)
        feet: float64 of shape (N, 3): feet after each frame (m)
        states: str of shape (N,): state after each frame
        waypoints_reached: number of waypoints reached
        start: feet before the first frame (m)

    """

    seconds: NDArray[np.float64]
    feet: NDArray[np.float64]
    states: NDArray[np.str_]
    waypoints_reached: int
    start: _Place

    @classmethod
    def _of(
        cls,
        seconds: NDArray[np.float64],
        feet: NDArray[np.float64],
        codes: NDArray[np.uint8],
        reached: int,
        start: _Place,
    ) -> Path:
        return cls(seconds, feet, STATES[codes], reached, start)

    def __repr__(self) -> str:
        """Return final state, time and length."""
        return f"<slicewalk.Path: {self.state} after {self.seconds[-1]:.1f} s and {self.length:.2f} m>"

    @property
    def state(self) -> str:
        """State at the end."""
        return str(self.states[-1])

    @property
    def length(self) -> float:
        """Length of the path from its start (m)."""
        return float(np.linalg.norm(np.diff(self.feet, axis=0, prepend=[self.start]), axis=1).sum())
