"""Harbors as data: a marina with rows of finger piers, or mesh files; the berths of a multi-berth task."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, NamedTuple, Self, get_args

from pydantic import Field, model_validator

from dockctl.errors import nearest
from dockctl.scenarios.base import Coordinate, Count, FieldError, Flag, Length, Model, Positive

VESSEL_MODELS = Path(__file__).parents[1] / "sim" / "harbor" / "vessels"
"""Folder of the moored vessels' mesh files; the name of a model is the name of its file."""
DEFAULT_MODELS = (
    "skiff", "console", "cuddy", "dinghy", "daysailer", "sloop", "cruiser",
    "sedan", "express", "flybridge", "inflatable", "catamaran",
)  # fmt: skip
"""The models of the packaged harbors. They are listed, because another file must not change these harbors."""

Places = Annotated[tuple[Coordinate, ...], Field(max_length=1000)]
"""Coordinates along a quay [m]."""
Side = Literal["east", "west", "north", "south"]
BerthKind = Literal["trained", "held_out"]
MAX_HARBORS = 32
"""Copies of a harbor with other vacant berths, at about 0.25 GB each."""


class Basin(Model):
    """Water area between the faces of the quays [m]."""

    x_min_m: Coordinate
    x_max_m: Coordinate
    y_min_m: Coordinate
    y_max_m: Coordinate

    @model_validator(mode="after")
    def _has_water(self) -> Self:
        for low, high in (("x_min_m", "x_max_m"), ("y_min_m", "y_max_m")):
            near, far = getattr(self, low), getattr(self, high)
            if near >= far:
                raise FieldError(low, f"{near:g} must be less than {high}, {far:g}", "out_of_range")
        return self


class _Row(Model):
    """Finger piers along one quay, with two berths between neighboring fingers."""

    finger_length_m: Length = 8.0
    finger_width_m: Length = 1.0

    @property
    def fingers(self) -> tuple[float, ...]:
        """Positions of the fingers' center lines along the quay [m]."""
        return self._along("finger")

    @property
    def berths(self) -> tuple[float, ...]:
        """Positions of the berths' center lines along the quay [m]."""
        return self._along("berth")

    @property
    def free(self) -> tuple[float, ...]:
        """Berths without a moored vessel, a subset of `berths` [m]."""
        return self._along("free")

    @property
    def axis(self) -> Literal["x", "y"]:
        """The world axis along the quay."""
        return "y" if hasattr(self, "berth_y_m") else "x"

    def _along(self, what: str) -> tuple[float, ...]:
        values: tuple[float, ...] = getattr(self, f"{what}_{self.axis}_m")
        return values

    @model_validator(mode="after")
    def _free_are_berths(self) -> Self:
        for at in self.free:
            if at not in self.berths:
                closest = min(self.berths, key=lambda berth: abs(berth - at))
                field = f"free_{self.axis}_m"
                raise FieldError(field, f"no berth at {at:g}", "unknown_name", f"{closest:g}")
        return self


class SideRow(_Row):
    """A row along the east or west quay; positions are y."""

    side: Literal["east", "west"]
    finger_y_m: Places = Field(default=(), description="center lines of the fingers")
    berth_y_m: Places = Field(min_length=1, description="center lines of the berths")
    free_y_m: Places = Field(default=(), description="berths without a moored vessel")


class EndRow(_Row):
    """A row along the north or south quay; positions are x."""

    side: Literal["north", "south"]
    finger_x_m: Places = Field(default=(), description="center lines of the fingers")
    berth_x_m: Places = Field(min_length=1, description="center lines of the berths")
    free_x_m: Places = Field(default=(), description="berths without a moored vessel")


PierRow = Annotated[SideRow | EndRow, Field(discriminator="side")]


def is_model_file(model: str) -> bool:
    """Return whether a vessel model is given as a path, and not by name."""
    return model.endswith(".obj")


class Fleet(Model):
    """The moored vessels: drawn from `models` with a fixed seed, every model once before any is repeated.

    A model is the name of a packaged one or the path of an OBJ file.
    """

    seed: int = Field(default=0, ge=0, strict=True)
    stern_gap_m: Length = 0.7
    models: tuple[str, ...] = Field(default=DEFAULT_MODELS, min_length=1)

    @model_validator(mode="after")
    def _models_exist(self) -> Self:
        known = sorted(file.stem for file in VESSEL_MODELS.glob("*.obj"))
        for index, name in enumerate(self.models):
            if name not in known and not is_model_file(name):
                message = f"unknown vessel model '{name}' (an OBJ file, or one of: {', '.join(known)})"
                raise FieldError(f"models.{index}", message, "unknown_name", nearest(name, known))
        return self


class MeshFile(Model):
    """A GLB, OBJ, STL or PLY file; rotated, scaled and shifted it is in meters with the water at z = 0."""

    path: str
    up: Literal["z", "y"] = Field(default="z", description="upward axis of the file; y in glTF")
    scale: Positive = 1.0
    shift_m: tuple[Coordinate, Coordinate, Coordinate] = (0.0, 0.0, 0.0)


class Marina(Model):
    """A basin with rows of finger piers, moored vessels, and optional solids from mesh files."""

    kind: Literal["marina"]
    name: str = "marina"
    basin: Basin
    rows: tuple[PierRow, ...] = Field(min_length=1, max_length=100)
    fleet: Fleet = Field(default_factory=Fleet)
    meshes: tuple[MeshFile, ...] = ()


class MeshHarbor(Model):
    """A harbor from mesh files only."""

    kind: Literal["meshes"]
    name: str = "meshes"
    meshes: tuple[MeshFile, ...] = Field(min_length=1)


HarborSpec = Annotated[Marina | MeshHarbor, Field(discriminator="kind")]


class BerthPlace(NamedTuple):
    """One berth: its quay, and the position of its center line along the quay [m]."""

    side: Side
    at_m: float


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
    def _are_disjoint(self) -> Self:
        if not self.trained.places:
            raise FieldError("trained", "expected at least one berth", "missing_key")
        groups = sum(-(-len(self.places(kind)) // self.vacant) for kind in get_args(BerthKind))
        if groups > MAX_HARBORS:
            message = f"{self.vacant} vacant berths at a time need {groups} harbors, at most {MAX_HARBORS}"
            raise FieldError("vacant", message, "out_of_range")
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
    """Return the harbors of a scenario: its own, or one for each group of berths that are vacant together.

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
    return tuple(Layout(_with_vacant_berths(harbor, places), kind, places) for kind, places in groups)


def _with_vacant_berths(marina: Marina, places: tuple[BerthPlace, ...]) -> Marina:
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
    existing = {BerthPlace(row.side, at) for row in harbor.rows for at in row.berths}
    for place in berths.trained.places + berths.held_out.places:
        if place not in existing:
            on_side = [berth.at_m for berth in existing if berth.side == place.side]
            nearest = min(on_side, key=lambda at: abs(at - place.at_m), default=None)
            hint = "that quay has none" if nearest is None else f"the nearest one is at {nearest:g}"
            return f"no berth on the {place.side} quay at {place.at_m:g}; {hint}"
    return ""
