"""Exceptions of slicewalk: what is wrong, and the facts as attributes.

>>> try:
...     slicewalk.open("nowhere.slices")
... except slicewalk.Error as error:
...     print(type(error).__name__, error.path, error.errno)
MissingFileError nowhere.slices 2
"""

from __future__ import annotations

from typing import Any


class Error(Exception):
    """Whatever slicewalk cannot do. Facts that an error does not have are None.

    Attributes:
        path: file or address that the error is about
        at: where in it (``"header, byte 96"``), or which parameter
        reason: what is wrong, without the place
        expected: what was expected there
        found: what was found instead
        hint: what to do
        row: row of the array that the error is about

    """

    path: str | None = None
    at: str | None = None
    reason: str | None = None
    expected: str | None = None
    found: str | None = None
    hint: str | None = None
    row: int | None = None

    def __init__(self, message: str, **facts: Any) -> None:
        """Take the message, and facts by name."""
        super().__init__(message)
        self._facts = {name: value for name, value in facts.items() if value is not None}
        for name, value in self._facts.items():
            setattr(self, name, value)

    def __str__(self) -> str:
        """Return the message, whatever the other base class makes of it."""
        return str(self.args[0])

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the facts too."""
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


class InputError(Error, ValueError):
    """A scan or mesh cannot be used; `at` says where in it."""


class FormatError(Error, ValueError):
    """An archive breaks a rule of its format. Has `rule`, `part` and `offset` (bytes)."""

    rule: str | None = None
    part: str | None = None
    offset: int | None = None


class LimitError(Error, ValueError):
    """A value lies beyond a limit: `found` beyond `expected`."""


class UnsupportedError(Error, ValueError):
    """A valid file uses what this version does not read; `hint` says what to do."""


class ParameterError(Error, ValueError):
    """A parameter, named by `at`, makes no sense."""


class OutputError(_SystemError):
    """A file must not be written under this name; what is there stays."""


class NotDurableError(_SystemError):
    """A file is complete under its name, but its folder could not be synced: a power failure may undo that."""


class NotLoadedError(Error, LookupError):
    """The answer takes pages that are not in memory: `pages` has the keys of the first 16."""

    pages: list[tuple[int, int, int]]


class CancelledError(Error):
    """The work was asked to stop; nothing was written."""


class SlicewalkWarning(UserWarning):
    """Something about the input that the user should know; work goes on."""
