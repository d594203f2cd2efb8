"""Base of the scenario models: frozen, strict numbers, no unknown keys."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Strict
from pydantic_core import PydanticKnownError

from dockctl.errors import Code

MAX_NUMBER = 1e12
"""Maximum magnitude of a number in SI units, and inverse of the minimum, so that products stay finite."""
MAX_COORDINATE_M = 10_000.0
"""A harbor is within 10 km of the origin, so that single precision resolves 1 mm."""
MAX_TURN_DEG = 36_000.0
"""Limit of headings, a hundred turns: far larger ones count as a diverged integration."""


def _bounded(value: float) -> float:
    """Check the magnitude; a validator, because a bound on a field would replace the bound of its type."""
    if abs(value) > MAX_NUMBER:
        raise PydanticKnownError("less_than_equal", {"le": MAX_NUMBER})
    return value


def _not_tiny(value: float) -> float:
    if value < 1 / MAX_NUMBER:
        raise PydanticKnownError("greater_than_equal", {"ge": 1 / MAX_NUMBER})
    return value


Number = Annotated[float, Strict(), Field(allow_inf_nan=False), AfterValidator(_bounded)]
Positive = Annotated[Number, Field(gt=0), AfterValidator(_not_tiny)]
NonNegative = Annotated[Number, Field(ge=0)]
Speed = Annotated[NonNegative, Field(le=10)]
"""Speed of a boat or of the water [m/s]: the strongest tidal streams reach 10 m/s."""
Coordinate = Annotated[Number, Field(ge=-MAX_COORDINATE_M, le=MAX_COORDINATE_M)]
Heading = Annotated[Number, Field(ge=-MAX_TURN_DEG, le=MAX_TURN_DEG)]
Turn = Annotated[NonNegative, Field(le=MAX_TURN_DEG)]
Length = Annotated[Positive, Field(le=MAX_COORDINATE_M)]
Fraction = Annotated[float, Strict(), Field(allow_inf_nan=False, ge=0, le=1)]
Count = Annotated[int, Strict(), Field(ge=1)]
Flag = Annotated[bool, Strict()]
Title = Annotated[str, Field(min_length=1)]
"""Name that is shown in reports and figures."""

NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"
"""Pattern of the names of scenarios, experiments and checkpoints: safe in paths and on command lines."""
Name = Annotated[str, Field(pattern=NAME)]


class Model(BaseModel):
    """A frozen model that rejects unknown keys.

    Attributes:
        file_keys: further keys in files of this model, which the loader replaces.
    """

    file_keys: ClassVar[tuple[str, ...]] = ()
    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)


class FieldError(ValueError):
    """Raised by a validator to report a field of its model.

    Args:
        field: dotted path of the field within the model.
        message: what was found and what is allowed, without the field's name.
        code: kind of the error.
        suggestion: the value that the user probably meant, or an empty string.
    """

    def __init__(self, field: str, message: str, code: Code = "invalid", suggestion: str = "") -> None:
        super().__init__(f"{field}: {message}")
        self.field, self.message, self.code, self.suggestion = field, message, code, suggestion


class Pose(Model):
    """Planar pose in the world frame: meters, and degrees counterclockwise from +x."""

    x_m: Coordinate
    y_m: Coordinate
    heading_deg: Heading
