"""The one family of errors that a user of dockctl meets.

Everything that the user can put right is a `DockctlError`; the command line prints its text
(never a traceback) and exits with `exit_code`. Anything else is a bug of ours.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches


class DockctlError(Exception):
    """Something that the user can put right; its text says what and how."""

    exit_code = 2


@dataclass(frozen=True)
class Problem:
    """One thing wrong in one input file.

    Args:
        file: the file as the user named it.
        line, column: where it stands, counted from 1; 0 where the place is unknown.
        field: dotted path of the field, for example ``poses.final.x_m``; empty for the whole file.
        message: what was found, what is allowed, and the nearest known name.
    """

    file: str
    line: int
    column: int
    field: str
    message: str

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}:{self.column}" if self.line else self.file
        return f"{place}: {self.field}: {self.message}" if self.field else f"{place}: {self.message}"


class InputError(DockctlError):
    """All the problems of an input at once, one a line."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


def nearest(name: str, known: Iterable[str]) -> str:
    """Return ``; did you mean 'x'?`` for the known name closest to `name`, or an empty string."""
    matches = get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f"; did you mean '{matches[0]}'?" if matches else ""
