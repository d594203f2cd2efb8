"""Berths to which a task is carried: which are trained, which held out, and what is free meanwhile."""

from __future__ import annotations

from typing import Literal, NamedTuple, Self, get_args

from pydantic import Field, model_validator

from dockctl.scenarios.base import Count, FieldError, Flag, Model, Number
from dockctl.scenarios.harbor import HarborSpec, Marina, Side

BerthKind = Literal["trained", "held_out"]


class BerthPlace(NamedTuple):
    """One berth: its quay, and its centre line along the quay [m]."""

    side: Side
    at_m: float


class BerthPlaces(Model):
    """Berths by quay: their centre lines, y on the east and west quay, x on the north and south quay [m]."""

    east: tuple[Number, ...] = ()
    west: tuple[Number, ...] = ()
    north: tuple[Number, ...] = ()
    south: tuple[Number, ...] = ()

    @property
    def places(self) -> tuple[BerthPlace, ...]:
        """All of them, quay after quay."""
        return tuple(BerthPlace(side, at) for side in get_args(Side) for at in getattr(self, side))


class Berths(Model):
    """Every episode is carried, with all the task's poses, to one of these berths.

    `vacant` of them are free at a time, in a harbor of their own, and every other berth there holds a vessel.
    """

    trained: BerthPlaces = Field(description="berths of the training")
    held_out: BerthPlaces = Field(default=BerthPlaces(), description="berths of the evaluation alone")
    mirrored: Flag = Field(default=True, description="begin on either side of the berth")
    vacant: Count = 6

    @model_validator(mode="after")
    def _apart(self) -> Self:
        if not self.trained.places:
            raise FieldError("trained", "name at least one berth", "missing_key")
        if common := set(self.trained.places) & set(self.held_out.places):
            side, at = min(common)
            raise FieldError("held_out", f"the {side} berth at {at:g} is trained already", "duplicate")
        return self

    def places(self, kind: BerthKind) -> tuple[BerthPlace, ...]:
        """The berths of one kind."""
        listed: BerthPlaces = getattr(self, kind)
        return listed.places


class Layout(NamedTuple):
    """A harbor of a scenario, and the berths that are free in it for the task to be carried to."""

    harbor: HarborSpec
    kind: BerthKind | None
    berths: tuple[BerthPlace, ...]


def layouts(harbor: HarborSpec, berths: Berths | None) -> tuple[Layout, ...]:
    """Return the harbors of a scenario: its own, or one for each group of berths that are free together.

    A group takes every k-th berth of the list, so that those next to a free berth are taken.
    """
    if berths is None:
        return (Layout(harbor, None, ()),)
    assert isinstance(harbor, Marina)  # held by the scenario's validator
    kinds: tuple[BerthKind, ...] = ("trained", "held_out")
    groups = []
    for kind in kinds:
        places = berths.places(kind)
        count = -(-len(places) // berths.vacant)
        groups += [(kind, places[first::count]) for first in range(count)]
    return tuple(Layout(_freed(harbor, places), kind, places) for kind, places in groups)


def _freed(marina: Marina, places: tuple[BerthPlace, ...]) -> Marina:
    """Return the marina with just these berths free."""
    rows = [
        row.model_copy(update={f"free_{row.axis}_m": tuple(at for side, at in places if side == row.side)})
        for row in marina.rows
    ]
    return marina.model_copy(update={"rows": tuple(rows)})


def missing_berth(harbor: HarborSpec, berths: Berths) -> str:
    """Return which berth of the list the harbor lacks, or an empty string."""
    if not isinstance(harbor, Marina):
        return "only a harbor of kind marina has berths"
    there = {BerthPlace(row.side, at) for row in harbor.rows for at in row.berths}
    for place in berths.trained.places + berths.held_out.places:
        if place not in there:
            on_side = [berth.at_m for berth in there if berth.side == place.side]
            nearest = min(on_side, key=lambda at: abs(at - place.at_m), default=None)
            hint = "there is none on that quay" if nearest is None else f"the nearest one is at {nearest:g}"
            return f"no berth on the {place.side} quay at {place.at_m:g}; {hint}"
    return ""
