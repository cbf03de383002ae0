"""Bridges to other programs, without ROS: occupancy grids, OctoMap, Open3D, and arrays of points."""

from __future__ import annotations

import importlib
import json
import reprlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slicewalk._slicewalk import Pages, Writer, _write_export
from slicewalk._slicewalk import open as open_archive
from slicewalk.errors import LimitError, ParameterError, ParameterTypeError

if TYPE_CHECKING:
    import os

    from numpy.typing import ArrayLike, NDArray
    from typing_extensions import Unpack

    from slicewalk._options import WriterOptions
    from slicewalk._slicewalk import Archive

FREE, OCCUPIED, UNKNOWN = 0, 100, -1
_HIT, _NOT_LOADED = 1, 2
# Most pixels of a grid, as in `slicetool export`, and pixels decided at a time.
_MOST_PIXELS = 1 << 26
_BLOCK = 1 << 18


def _path(given: str | os.PathLike[str]) -> Path:
    try:
        return Path(given)
    except TypeError:
        raise ParameterTypeError(f"path: expected a path, found {given!r}", at="path") from None


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """Free and occupied pixels of a storey, as ``nav_msgs/OccupancyGrid`` has them; see :func:`to_occupancy_grid`.

    Attributes:
        data: int8 of shape (rows along y, columns along x): 0 free, 100 occupied, -1 unknown
        resolution: edge of a pixel (m)
        origin: x and y of the lower corner of the first pixel (m)

    """

    data: NDArray[np.int8]
    resolution: float
    origin: tuple[float, float]

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write ``NAME.yaml`` and ``NAME.pgm`` for the map server of Nav2, each all or nothing.

        Args:
            path: ``NAME``, or one of the two files

        Raises:
            OutputError: one of the files exists and is an archive, a plan or read-only
            FileError: a file cannot be written; MissingFileError without its folder

        >>> grid = slicewalk.to_occupancy_grid(slicewalk.open("room.slices"), 0.0)
        >>> grid.save("room.yaml")

        """
        path = _path(path)
        # A name may hold other dots: `storey_1.5` is no `storey_1` with an ending.
        name = path.stem if path.suffix in {".yaml", ".pgm"} else path.name
        image = path.with_name(f"{name}.pgm")
        x, y = self.origin
        # JSON's strings are YAML's, too.
        quoted = json.dumps(image.name, ensure_ascii=False)
        text = f"image: {quoted}\nmode: trinary\nresolution: {self.resolution!r}\norigin: [{x!r}, {y!r}, 0.0]\n"
        text += "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
        grey: NDArray[np.uint8] = np.full(self.data.shape, 205, np.uint8)
        grey[self.data == FREE], grey[self.data == OCCUPIED] = 254, 0
        rows, columns = grey.shape
        _write_export(image, f"P5\n{columns} {rows}\n255\n".encode() + grey[::-1].tobytes())
        _write_export(path.with_name(f"{name}.yaml"), text.encode(errors="surrogateescape"))


def _numbers(name: str, given: Any, count: int, expected: str) -> NDArray[np.float64]:
    """Return finite numbers, or raise an error that names the argument."""

    def wrong(kind: type[ParameterError]) -> ParameterError:
        return kind(f"{name}: expected {expected}, found {reprlib.repr(given)}", at=name)

    try:
        # numpy drops masks.
        array = np.empty(0) if np.ma.is_masked(given) else np.asarray(given)
        # Texts would be parsed, and truth values would count as numbers.
        is_type = array.dtype.kind in "iufO" and (count == 1 or array.ndim > 0)
        # None would become NaN.
        is_type = is_type and not (array.dtype.kind == "O" and None in array.ravel().tolist())
        numbers = array.astype(np.float64) if is_type else np.empty(0)
    except TypeError:
        is_type = False
    except (ValueError, OverflowError):
        is_type, numbers = True, np.empty(0)
    if not is_type:
        raise wrong(ParameterTypeError)
    if numbers.size != count or not np.isfinite(numbers).all():
        raise wrong(ParameterError)
    return numbers.ravel()


def _box(pages: Pages, bounds: ArrayLike | None) -> NDArray[np.float64]:
    """Return the bounds, or those of the archive, as two corners."""
    if not isinstance(pages, Pages):
        raise ParameterTypeError(f"pages: expected an Archive or a View, found {reprlib.repr(pages)}", at="pages")
    expected = "xmin, ymin, zmin, xmax, ymax, zmax in order"
    given = getattr(pages, "bounds", None) if bounds is None else bounds
    if given is None:
        message = f"bounds: expected {expected}; a view, an overview level and an archive without points have no bounds"
        raise ParameterError(message, at="bounds")
    box = _numbers("bounds", given, 6, "6 finite numbers").reshape(2, 3)
    if np.shape(given) not in {(6,), (2, 3)} or (box[0] > box[1]).any():
        raise ParameterError(f"bounds: expected {expected}, found {reprlib.repr(given)}", at="bounds")
    return box


def to_occupancy_grid(
    pages: Pages,
    z: float,
    *,
    pawn: tuple[float, float] = (0.1, 1.8),
    climb: float = 0.35,
    bounds: ArrayLike | None = None,
) -> OccupancyGrid:
    """Return where a round pawn fits on the floor at about a height.

    Each pixel is decided by the pawn's body above the climb height, over the highest floor within the climb height of
    `z`, or over `z` if there is none: occupied if the body meets solid; free if it meets none and has a floor; else, or
    if a page of a view is not loaded, unknown. If the archive has seen space (:meth:`Archive.seen_space`), a pixel is
    free only where the line through the middle of the body was seen, else unknown, as in ``slicetool export``.

    Args:
        pages: an archive or a view
        z: height of the floor (m)
        pawn: radius and height (m)
        climb: highest step (m), less than the pawn's height
        bounds: region; all of an archive by default

    Raises:
        ParameterError: an argument is invalid
        LimitError: the grid has more than 67,108,864 pixels

    >>> grid = slicewalk.to_occupancy_grid(slicewalk.open("room.slices"), 0.0)
    >>> grid.data.shape, int((grid.data == 0).sum()), int((grid.data == 100).sum())
    ((60, 80), 4256, 544)

    """
    low, high = _box(pages, bounds)
    (floor,) = _numbers("z", z, 1, "a height (m)")
    radius, height = _numbers("pawn", pawn, 2, "radius and height (m)")
    if radius < 0 or height <= 0:
        raise ParameterError(f"pawn: expected a radius of 0 or more and a height above 0, found {pawn}", at="pawn")
    (step,) = _numbers("climb", climb, 1, "a height (m)")
    if not 0 <= step < height:
        raise ParameterError(f"climb: expected 0 to less than the pawn's height, {height} m, found {climb}", at="climb")
    pixel = pages.pixel_size
    with np.errstate(over="ignore", invalid="ignore"):
        # As in the archive's own grid; a quotient rounds otherwise.
        per_metre = 1 / pixel
        first, last = np.floor(low[:2] * per_metre), np.floor(high[:2] * per_metre)
        size = last - first + 1
        count = float(size[0] * size[1])
    if not count <= _MOST_PIXELS:
        message = f"pixels of a grid (give smaller bounds): {count:.0f} is beyond the limit of {_MOST_PIXELS}"
        raise LimitError(message, found=f"{count:.0f}", expected=str(_MOST_PIXELS))
    columns, rows = size.astype(np.int64).tolist()
    data = np.empty(rows * columns, np.int8)
    for start in range(0, len(data), _BLOCK):
        row, column = np.divmod(np.arange(start, min(start + _BLOCK, len(data))), columns)
        middle = (np.column_stack([column, row]) + first + 0.5) * pixel
        data[start : start + _BLOCK] = _states(pages, middle, float(floor), (radius, height), step)
    origin = (float(first[0] * pixel), float(first[1] * pixel))
    return OccupancyGrid(data.reshape(rows, columns), pixel, origin)


def _states(
    pages: Pages, middle: NDArray[np.float64], z: float, pawn: tuple[float, float], climb: float
) -> NDArray[np.int8]:
    """Return the states of the pixels around these middles."""
    radius, height = pawn
    ends, ones = np.full((len(middle), 1), z), np.ones(len(middle))
    floor = pages.floor(np.hstack([middle, ends - climb, middle, ends + climb]))
    unloaded, has_floor = np.isnan(floor), floor > -np.inf
    ground = np.where(has_floor, floor, z)
    met = pages.overlaps_cylinders(np.column_stack([middle, ground + climb, radius * ones, (height - climb) * ones]))
    seen = pages._seen_space()
    is_free = has_floor
    if seen is not None:
        is_free = has_floor & seen._pawns(np.column_stack([middle, ground, climb * ones, height * ones]))
    choices = {UNKNOWN: unloaded | (met == _NOT_LOADED), OCCUPIED: met == _HIT, FREE: is_free}
    return np.select(list(choices.values()), list(choices), UNKNOWN).astype(np.int8)


def to_octomap(pages: Pages, path: str | os.PathLike[str], *, bounds: ArrayLike | None = None) -> int:
    """Write a region as an octree of OctoMap (``.bt``), and return the number of its occupied cubes.

    Cubes have the edge of a pixel and are occupied if a span reaches into them. All others that lie in seen space (see
    :meth:`Archive.seen_space`) are free. A tree has 65,536 cubes along each axis around the origin; a region beyond is
    moved by whole tiles, which a comment in the file states and :func:`convert` undoes. Memory: the tree.

    Raises:
        ParameterError: the region holds nothing solid, and nothing of it was seen
        LimitError: the region is larger than a tree
        OutputError: the file exists and is an archive, a plan or read-only
        FileError: the file cannot be written; MissingFileError without its folder

    >>> slicewalk.to_octomap(slicewalk.open("room.slices"), "room.bt") > 10_000
    True
    >>> slicewalk.convert("room.bt", "cubes.slices")["cubes_read"] > 0
    True

    """
    target = _path(path)
    occupied, free, data = pages._octomap(_box(pages, bounds))
    if occupied == free == 0:
        message = "bounds: expected a region with solid, found none; give other bounds"
        raise ParameterError(message, at="bounds")
    _write_export(target, data)
    return occupied


def to_open3d(pages: Pages, *, bounds: ArrayLike | None = None) -> Any:
    """Return an ``open3d.geometry.PointCloud``: the middle of each occupied voxel, floors green and obstacles red.

    Needs the package open3d.
    """
    open3d = importlib.import_module("open3d")
    region = pages.region(_box(pages, bounds))
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(region.points))
    colours = np.where((region.kind[region.occupied] == 2)[:, None], (0.8, 0.2, 0.2), (0.2, 0.7, 0.3))
    cloud.colors = open3d.utility.Vector3dVector(colours)
    return cloud


def from_numpy(
    points: ArrayLike, output: str | os.PathLike[str], *, pixel: float, **options: Unpack[WriterOptions]
) -> Archive:
    """Convert an array of points, N × 3 in metres, to an archive, and open it; `options` are those of :class:`Writer`.

    >>> points = np.random.default_rng(0).uniform(0, 4, (10_000, 3)) * (1, 1, 0)
    >>> slicewalk.from_numpy(points, "plane.slices", pixel=0.1, force=True).points_kept
    10000
    """
    with Writer(output, pixel=pixel, **options) as writer:
        writer.write(points)
    return open_archive(output)
