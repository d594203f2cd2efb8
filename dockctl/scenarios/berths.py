"""Berths to which a task is moved: berths of the training, held-out berths, and which are free together."""

from __future__ import annotations

from typing import Literal, NamedTuple, Self, get_args

from pydantic import Field, model_validator

from dockctl.scenarios.base import Count, FieldError, Flag, Model, Number
from dockctl.scenarios.harbor import HarborSpec, Marina, Side

BerthKind = Literal["trained", "held_out"]


class BerthPlace(NamedTuple):
    """One berth: its quay, and the position of its center line along the quay [m]."""

    side: Side
    at_m: float


class BerthPlaces(Model):
    """Center lines of berths by quay [m]: y at the east and west quay, x at the north and south quay."""

    east: tuple[Number, ...] = ()
    west: tuple[Number, ...] = ()
    north: tuple[Number, ...] = ()
    south: tuple[Number, ...] = ()

    @property
    def places(self) -> tuple[BerthPlace, ...]:
        """All berths, quay by quay."""
        return tuple(BerthPlace(side, at) for side in get_args(Side) for at in getattr(self, side))


class Berths(Model):
    """Berths for the episodes: each episode moves all poses of the task to one of them.

    They are split into groups of at most `vacant` berths. Each group has its own copy of the harbor, in which
    only these berths are free.
    """

    trained: BerthPlaces = Field(description="berths of the training")
    held_out: BerthPlaces = Field(default=BerthPlaces(), description="berths used only by the evaluation")
    mirrored: Flag = Field(default=True, description="also mirror the task about the berth")
    vacant: Count = 6

    @model_validator(mode="after")
    def _apart(self) -> Self:
        if not self.trained.places:
            raise FieldError("trained", "expected at least one berth", "missing_key")
        if common := set(self.trained.places) & set(self.held_out.places):
            side, at = min(common)
            raise FieldError("held_out", f"the {side} berth at {at:g} is also in trained", "duplicate")
        return self

    def places(self, kind: BerthKind) -> tuple[BerthPlace, ...]:
        """Return the berths of one kind."""
        listed: BerthPlaces = getattr(self, kind)
        return listed.places


class Layout(NamedTuple):
    """A harbor of a scenario and the free berths in it to which the task can be moved."""

    harbor: HarborSpec
    kind: BerthKind | None
    berths: tuple[BerthPlace, ...]


def layouts(harbor: HarborSpec, berths: Berths | None) -> tuple[Layout, ...]:
    """Return the harbors of a scenario: its own, or one for each group of berths that are free together.

    A group has every k-th berth of the list, so that the neighbors of a free berth are occupied.
    """
    if berths is None:
        return (Layout(harbor, None, ()),)
    assert isinstance(harbor, Marina)  # checked by the scenario's validator
    kinds: tuple[BerthKind, ...] = ("trained", "held_out")
    groups = []
    for kind in kinds:
        places = berths.places(kind)
        count = -(-len(places) // berths.vacant)
        groups += [(kind, places[first::count]) for first in range(count)]
    return tuple(Layout(_freed(harbor, places), kind, places) for kind, places in groups)


def _freed(marina: Marina, places: tuple[BerthPlace, ...]) -> Marina:
    """Return the marina with only these berths free."""
    rows = [
        row.model_copy(update={f"free_{row.axis}_m": tuple(at for side, at in places if side == row.side)})
        for row in marina.rows
    ]
    return marina.model_copy(update={"rows": tuple(rows)})


def missing_berth(harbor: HarborSpec, berths: Berths) -> str:
    """Describe the first berth of the list that the harbor lacks; an empty string if it has all."""
    if not isinstance(harbor, Marina):
        return "the harbor has no berths: expected kind marina"
    there = {BerthPlace(row.side, at) for row in harbor.rows for at in row.berths}
    for place in berths.trained.places + berths.held_out.places:
        if place not in there:
            on_side = [berth.at_m for berth in there if berth.side == place.side]
            nearest = min(on_side, key=lambda at: abs(at - place.at_m), default=None)
            hint = "that quay has none" if nearest is None else f"the nearest one is at {nearest:g}"
            return f"no berth on the {place.side} quay at {place.at_m:g}; {hint}"
    return ""
