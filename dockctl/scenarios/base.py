"""Base of the scenario models: frozen, strict numbers, no unknown keys."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, Strict

from dockctl.errors import Code

Number = Annotated[float, Strict(), Field(allow_inf_nan=False)]
Positive = Annotated[float, Strict(), Field(allow_inf_nan=False, gt=0)]
NonNegative = Annotated[float, Strict(), Field(allow_inf_nan=False, ge=0)]
Fraction = Annotated[float, Strict(), Field(allow_inf_nan=False, ge=0, le=1)]
Count = Annotated[int, Strict(), Field(ge=1)]
Flag = Annotated[bool, Strict()]

NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"
"""Pattern of the names of scenarios, experiments and checkpoints: safe in paths and on command lines."""
Name = Annotated[str, Field(pattern=NAME)]


class Model(BaseModel):
    """A frozen model that rejects unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")


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

    x_m: Number
    y_m: Number
    heading_deg: Number
