"""The rules of the contracts, and the error that names a broken rule."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

Rule = Literal[
    "valid",  # what its kind requires
    "shape",
    "finite",
    "in_range",  # in the space, the bounds, or the limits of the vessel
    "deterministic",  # the same seed gives the same result
    "independent_rows",  # a boat does not depend on the others
    "pure",  # arguments are not changed
    "unshared",  # what was returned does not change later
    "resumable",  # a saved state continues as if it had not stopped
    "consistent",  # two ways to the same result agree
]
Require = Callable[[Rule, object, str], None]
"""Takes a rule, whether it holds, and how it is broken; raises a `ContractError` if it does not hold."""


class ContractError(AssertionError):
    """A broken rule of a contract.

    Attributes:
        subject: what breaks it, for example ``reward term 'speed'``.
        rule: its name.
    """

    def __init__(self, subject: str, rule: Rule, message: str) -> None:
        super().__init__(f"{subject}: {message} (rule '{rule}')")
        self.subject = subject
        self.rule = rule


def contract_of(subject: str) -> Require:
    """Return the function that checks the rules of a contract for `subject`."""

    def require(rule: Rule, holds: object, message: str) -> None:
        if not holds:
            raise ContractError(subject, rule, message)

    return require
