"""Walk in laser scans that are too large for memory.

>>> archive = slicewalk.open("room.slices")
>>> archive.overlaps([[3, 2, 0.5, 3.5, 2.5, 1.8]]) == slicewalk.CLEAR
array([ True])

`convert` and `Writer` make archives and `open` reads them. `Archive` and the `View` of a `Stream` answer queries about
boxes, rays, floors and routes; a `Walker` walks. Lengths are in metres, angles in degrees.
"""

from __future__ import annotations

from typing import Any

try:
    from slicewalk._slicewalk import (
        Archive,
        Body,
        Column,
        Page,
        Pages,
        SeenSpace,
        Stream,
        View,
        Walker,
        Writer,
        __version__,
        convert,
        merge,
        open,
        write_plan,
    )
except ImportError as _error:
    if "subinterpreter" not in str(_error):
        raise
    _message = "slicewalk cannot be imported in a subinterpreter; use threads of the main interpreter, or processes"
    raise ImportError(_message) from None

from slicewalk._bridges import OccupancyGrid, from_numpy, to_occupancy_grid, to_octomap, to_open3d
from slicewalk._options import ConvertOptions, PlanOptions, WriterOptions
from slicewalk._results import (
    Extreme,
    Leak,
    Obstruction,
    Passage,
    Path,
    Reach,
    Region,
    Route,
    StepReport,
    Storey,
    SurfacePoints,
)
from slicewalk.errors import (
    CancelledError,
    ClosedError,
    Error,
    FileError,
    FormatError,
    InputError,
    LimitError,
    MissingFileError,
    NotDurableError,
    NotLoadedError,
    OutputError,
    ParameterError,
    ParameterRangeError,
    ParameterTypeError,
    SlicewalkWarning,
    UnsupportedError,
)

CLEAR = 0
"""The shape touches no solid."""
HIT = 1
"""The shape touches solid."""
NOT_LOADED = 2
"""The shape touches no solid of the pages in memory, but meets pages that are not loaded."""

__all__ = [
    "CLEAR",
    "HIT",
    "NOT_LOADED",
    "Archive",
    "Body",
    "CancelledError",
    "ClosedError",
    "Column",
    "ConvertOptions",
    "Error",
    "Extreme",
    "FileError",
    "FormatError",
    "InputError",
    "Leak",
    "LimitError",
    "MissingFileError",
    "NotDurableError",
    "NotLoadedError",
    "Obstruction",
    "OccupancyGrid",
    "OutputError",
    "Page",
    "Pages",
    "ParameterError",
    "ParameterRangeError",
    "ParameterTypeError",
    "Passage",
    "Path",
    "PlanOptions",
    "Reach",
    "Region",
    "Route",
    "SeenSpace",
    "SlicewalkWarning",
    "StepReport",
    "Storey",
    "Stream",
    "SurfacePoints",
    "UnsupportedError",
    "View",
    "Walker",
    "Writer",
    "WriterOptions",
    "__version__",
    "convert",
    "from_numpy",
    "merge",
    "open",
    "to_occupancy_grid",
    "to_octomap",
    "to_open3d",
    "write_plan",
]


def _again(source: Any, identity: str, options: dict[str, Any] | None = None) -> Archive:
    """Reopen a pickled archive."""
    archive = open(source, **(options or {}))
    if archive._identity != identity:
        message = f"{archive.path}: another archive than the one that was pickled; pickle it again"
        raise Error(message, path=archive.path)
    return archive
