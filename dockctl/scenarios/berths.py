"""The section ``task.berths``: berths to which the episodes move the poses of the task."""

from __future__ import annotations

from collections import Counter
from typing import Literal, Self, get_args

from pydantic import Field, model_validator

from dockctl.scenarios.base import Count, FieldError, Flag, Model
from dockctl.scenarios.harbor import BerthPlace, Generated, HarborSpec, Marina, Places, Side

BerthKind = Literal["trained", "held_out"]
MAX_HARBORS = 32
"""Maximum number of copies of a harbor with different vacant berths."""


class BerthPlaces(Model):
    """Center lines of berths by quay [m]: y at the east and west quay, x at the north and south quay."""

    east: Places = ()
    west: Places = ()
    north: Places = ()
    south: Places = ()

    @property
    def places(self) -> tuple[BerthPlace, ...]:
        """All berths, quay by quay."""
        return tuple(BerthPlace(side, at) for side in get_args(Side) for at in getattr(self, side))

    def field(self, place: BerthPlace) -> str:
        """Return the field with a berth of these, for example ``east.0``."""
        return f"{place.side}.{getattr(self, place.side).index(place.at_m)}"


class Berths(Model):
    """Berths for the episodes: each episode moves all poses of the task to one of the berths.

    A marina's berths are split into groups of at most `vacant` berths. Each group has its own copy of the
    harbor, in which only these berths are free. Generated layouts have their own free berths.
    """

    trained: BerthPlaces = Field(default=BerthPlaces(), description="berths used in training")
    held_out: BerthPlaces = Field(default=BerthPlaces(), description="berths used only in evaluation")
    mirrored: Flag = Field(default=True, description="also mirror the task about the berth")
    vacant: Count = 6

    @model_validator(mode="after")
    def _are_disjoint(self) -> Self:
        groups = sum(-(-len(self.places(kind)) // self.vacant) for kind in get_args(BerthKind))
        if groups > MAX_HARBORS:
            message = f"{self.vacant} vacant berths at a time need {groups} harbors, at most {MAX_HARBORS}"
            raise FieldError("vacant", message, "out_of_range")
        for kind in get_args(BerthKind):
            listed: BerthPlaces = getattr(self, kind)
            if twice := [place for place, number in Counter(listed.places).items() if number > 1]:
                message = f"the {twice[0].side} berth at {twice[0].at_m:g} is listed twice"
                raise FieldError(f"{kind}.{listed.field(twice[0])}", message, "duplicate")
        if common := set(self.trained.places) & set(self.held_out.places):
            place = min(common)
            message = f"the {place.side} berth at {place.at_m:g} is also in trained"
            raise FieldError(f"held_out.{self.held_out.field(place)}", message, "duplicate")
        return self

    def places(self, kind: BerthKind) -> tuple[BerthPlace, ...]:
        """Return the berths of one kind."""
        listed: BerthPlaces = getattr(self, kind)
        return listed.places


def require_berths(harbor: HarborSpec, berths: Berths | None, *, is_given: bool) -> None:
    """Check that a harbor has the berths of a task.

    Args:
        is_given: whether the task has the key, for the place of an error.

    Raises:
        FieldError: the harbor does not have one of the berths, or none is given.
    """
    field = "task.berths"
    if isinstance(harbor, Generated):
        if berths is None and harbor.layouts + harbor.held_out_layouts > 1:
            several = "layouts" if harbor.layouts > 1 else "held_out_layouts"
            message = "several layouts need 'task: {berths: {}}', so that episodes use the free berths of all"
            raise FieldError(field if is_given else f"harbor.{several}", message, "missing_key")
        if berths is not None and (
            berths.trained.places or berths.held_out.places or berths.vacant != Berths().vacant
        ):
            message = "generated layouts have their own free berths; omit trained, held_out and vacant"
            raise FieldError(field, message, "mismatch")
        return
    if berths is None:
        return
    if not berths.trained.places:
        raise FieldError(
            f"{field}.trained",
            "expected at least one berth; only generated layouts need no list",
            "missing_key",
        )
    if not isinstance(harbor, Marina):
        message = "the harbor has no berths: expected kind marina or generated"
        raise FieldError(field, message, "mismatch")
    for kind in get_args(BerthKind):
        for place in berths.places(kind):
            if place in harbor.berths:
                continue
            on_side = [berth.at_m for berth in harbor.berths if berth.side == place.side]
            nearest = min(on_side, key=lambda at: abs(at - place.at_m), default=None)
            hint = "that quay has none" if nearest is None else f"the nearest one is at {nearest:g}"
            message = f"no berth on the {place.side} quay at {place.at_m:g}; {hint}"
            raise FieldError(f"{field}.{kind}.{getattr(berths, kind).field(place)}", message, "mismatch")
