"""Exceptions of slicewalk. Their attributes hold the details.

>>> try:
...     slicewalk.open("nowhere.slices")
... except slicewalk.Error as error:
...     print(type(error).__name__, error.path, error.errno)
MissingFileError nowhere.slices 2
"""

from __future__ import annotations

from typing import Any


class Error(Exception):
    """Base class of all errors of slicewalk. Attributes hold None where they do not apply.

    Attributes:
        path: file or address of the error
        at: position in it (``"header, byte 96"``), or name of a parameter
        reason: what is wrong, without the position
        expected: what was expected there
        found: what was found instead
        hint: what to do
        row: row of the array that caused the error

    """

    path: str | None = None
    at: str | None = None
    reason: str | None = None
    expected: str | None = None
    found: str | None = None
    hint: str | None = None
    row: int | None = None

    def __init__(self, message: str, **facts: Any) -> None:
        """Set the message and the attributes given by name."""
        super().__init__(message)
        self._facts = {name: value for name, value in facts.items() if value is not None}
        for name, value in self._facts.items():
            setattr(self, name, value)

    def __str__(self) -> str:
        """Return the message; the other base class might format it differently."""
        return str(self.args[0])

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the attributes too."""
        return _again, (type(self), str(self), self._facts)


def _again(kind: type[Error], message: str, facts: dict[str, Any]) -> Error:
    return kind(message, **facts)


class _SystemError(Error, OSError):
    def __init__(self, message: str, **facts: Any) -> None:
        super().__init__(message, **facts)
        self.filename = self.path


class FileError(_SystemError):
    """The operating system or a server refused a file. Has `errno`, `strerror` and `action` ("open")."""

    action: str | None = None


class MissingFileError(FileError, FileNotFoundError):
    """There is no such file or object."""


def file_error(path: str, action: str, error: OSError) -> FileError:
    """Return the error for a file that the system refuses, without the system's own, which may name another file."""
    kind = MissingFileError if isinstance(error, FileNotFoundError) else FileError
    facts = {"path": path, "errno": error.errno, "strerror": error.strerror, "action": action}
    return kind(f"{path}: cannot {action}: {error.strerror}", **facts)


class InputError(Error, ValueError):
    """A scan or mesh cannot be used; `at` says where in it."""


class FormatError(Error, ValueError):
    """An archive breaks a rule of its format. Has `rule`, `part` and `offset` (bytes)."""

    rule: str | None = None
    part: str | None = None
    offset: int | None = None


class LimitError(Error, ValueError):
    """A value is beyond a limit: `found` exceeds `expected`."""


class UnsupportedError(Error, ValueError):
    """A valid file uses what this version does not read; `hint` says what to do."""


class ParameterError(Error, ValueError):
    """A parameter, named by `at`, is invalid."""


class ParameterTypeError(ParameterError, TypeError):
    """A parameter has a value of the wrong type."""


class ParameterRangeError(ParameterError, OverflowError):
    """A parameter, a whole number, is negative or too large."""


class ClosedError(Error, ValueError):
    """The stream is closed, or the writer has ended."""


class OutputError(_SystemError):
    """A file must not be written under this name. Nothing was replaced."""


class NotDurableError(_SystemError):
    """A file is complete, but its folder could not be synced: after a power failure the file may be missing."""


class NotLoadedError(Error, LookupError):
    """The answer needs pages that are not in memory; `pages` has the keys of the first 16."""

    pages: list[tuple[int, int, int]]


class CancelledError(Error):
    """The work was cancelled; nothing was written."""


class SlicewalkWarning(UserWarning):
    """A problem of the input that does not stop the work."""
