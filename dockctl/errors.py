"""Errors that a user can fix.

Every such error is a `DockctlError`: the command line prints its text without a traceback and exits with
`exit_code`. Any other exception is a bug in dockctl. Tests and callers use `code`, the location and
`suggestion`; the wording may change.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Literal

Code = Literal[
    "invalid",  # right type, but the value cannot be used; the default
    "unknown_key",  # a key, parameter or option that does not exist
    "unknown_name",  # a name that is not registered, or a value that is not among the choices
    "missing_key",  # a required key, parameter or column is missing
    "wrong_type",
    "out_of_range",
    "duplicate",
    "yaml_syntax",
    "not_found",  # no such file, folder, run or checkpoint
    "not_readable",  # no permission, damaged, or not the expected format
    "not_writable",
    "mismatch",  # two inputs do not match
    "busy",  # another process is using it
    "unavailable",  # a device, memory or a package is not available on this machine
    "plugin",  # a plugin failed or broke its contract
    "diverged",  # training diverged and cannot succeed
    "untrusted",  # code in a received file that the user has not allowed to run
]


class DockctlError(Exception):
    """An error that the user can fix.

    Args:
        message: what was found and what is allowed.
        code: kind of the error; None for the default of the class.
        suggestion: the value that the user probably meant, or an empty string.
    """

    exit_code = 2
    code: Code = "invalid"

    def __init__(self, message: str, *, code: Code | None = None, suggestion: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.code = code or type(self).code
        self.suggestion = suggestion

    def __str__(self) -> str:
        return _with_suggestion(self.message, self.suggestion)


@dataclass(frozen=True)
class Problem:
    """One error in an input file.

    Args:
        file: path of the file as the user gave it.
        line, column: location, counted from 1; 0 if unknown.
        field: dotted path of the field, for example ``poses.final.x_m``; empty for the whole file.
        message: what was found and what is allowed.
        code: kind of the error.
        suggestion: the value that the user probably meant, or an empty string.
    """

    file: str
    line: int
    column: int
    field: str
    message: str
    code: Code = "invalid"
    suggestion: str = ""

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}:{self.column}" if self.line else self.file
        message = _with_suggestion(self.message, self.suggestion)
        return f"{place}: {self.field}: {message}" if self.field else f"{place}: {message}"


class InputError(DockctlError):
    """All problems of an input, one per line; `code` and `suggestion` are those of the first."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        first = self.problems[0]
        super().__init__("\n".join(map(str, self.problems)), code=first.code)
        self.suggestion = first.suggestion

    def __str__(self) -> str:
        return self.message


class DuplicateNameError(DockctlError):
    """A name is registered twice; `origins` names both."""

    code = "duplicate"

    def __init__(self, noun: str, name: str, origins: tuple[str, str]) -> None:
        super().__init__(f"{noun} '{name}' is registered twice: by {' and by '.join(origins)}; rename one")
        self.origins = origins


class UnknownNameError(DockctlError):
    """A name that is not registered."""

    code = "unknown_name"


class PluginError(DockctlError):
    """A plugin that cannot be used."""

    code = "plugin"


def one_line(error: BaseException) -> str:
    """Return type and message of an exception on one line; two lines would be printed as two errors."""
    text, *_ = str(getattr(error, "msg", error)).split("For further information visit ")  # links of pydantic
    message = " ".join(text.split())
    return f"{type(error).__name__}: {message}"


@contextmanager
def plugin_errors(what: str, path: Path | None = None) -> Iterator[None]:
    """Convert any exception in the block except a `DockctlError` to a `PluginError` with its location.

    Args:
        what: what failed, for example ``policy 'pid' fails``.
        path: the plugin's file, whose line is reported; by default that of the innermost frame.

    Raises:
        PluginError: the block raised such an exception.
    """
    try:
        yield
    except DockctlError:
        raise
    except (Exception, SystemExit) as error:
        raise PluginError(f"{what}: {one_line(error)}{_place(error, path)}") from error


def require_shape(who: str, shape: tuple[int, ...], expected: tuple[int, ...]) -> None:
    """Check the shape of an array that registered code returned.

    Args:
        who: the code, for example ``reward term 'speed'``.

    Raises:
        DockctlError: the shapes differ.
    """
    if shape != expected:
        raise DockctlError(
            f"{who} returned shape {shape}, expected {expected}, one row per boat", code="plugin"
        )


def nearest(name: str, known: Iterable[str]) -> str:
    """Return the known name closest to `name`, for `suggestion`; an empty string if none is close."""
    matches = get_close_matches(name, list(known), cutoff=0.5)
    swapped = [match for match in matches if sorted(match) == sorted(name)]  # `esat` is east, not west
    return (swapped or matches or [""])[0]


def _with_suggestion(message: str, suggestion: str) -> str:
    return f"{message}; did you mean '{suggestion}'?" if suggestion else message


def _place(error: BaseException, path: Path | None) -> str:
    """Return the line where a plugin failed: in the file `path`, else in the last frame outside dockctl."""
    if isinstance(error, SyntaxError) and error.lineno:
        return f" ({error.filename}:{error.lineno})"
    stack = traceback.extract_tb(error.__traceback__)
    here = str(Path(__file__).parent)  # dockctl loads the plugin
    frames = [f for f in stack if "importlib" not in f.filename and not f.filename.startswith(here)]
    own = [f for f in frames if f.filename == str(path)] or frames
    return f" ({own[-1].filename}:{own[-1].lineno})" if own else ""
