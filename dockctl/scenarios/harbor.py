"""Models of harbors: a marina, generated layouts, or mesh files."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import AfterValidator, BeforeValidator, Field, Strict, model_validator

from dockctl.errors import nearest
from dockctl.geometry import Floats, wrap
from dockctl.scenarios.base import (
    Coordinate,
    Count,
    FieldError,
    Fraction,
    Length,
    Model,
    Positive,
    Title,
)
from dockctl.scenarios.yaml_tree import describe

VESSEL_MODELS = Path(__file__).parents[1] / "sim" / "harbor" / "vessels"
"""Folder of the moored vessels' mesh files; the name of a model is the name of its file."""
DEFAULT_MODELS = (
    "skiff", "console", "cuddy", "dinghy", "daysailer", "sloop", "cruiser",
    "sedan", "express", "flybridge", "inflatable", "catamaran",
)  # fmt: skip
"""The models of the packaged harbors, listed so that an additional file does not change these harbors."""

Places = Annotated[tuple[Coordinate, ...], Field(max_length=1000)]
"""Coordinates along a quay [m]."""
Side = Literal["east", "west", "north", "south"]
QUAYS: dict[Side, str] = {"east": "x_max_m", "west": "x_min_m", "north": "y_max_m", "south": "y_min_m"}
"""The edge of the basin where the berths of a side begin."""
FACES: dict[Side, str] = {"east": "x_min_m", "west": "x_max_m", "north": "y_min_m", "south": "y_max_m"}
"""The edge of a pier or of land where the berths of a side begin: sterns point toward that side."""
INTO_BASIN: dict[Side, tuple[int, int]] = {"east": (-1, 0), "west": (1, 0), "north": (0, -1), "south": (0, 1)}
"""Direction in which the bow of a boat moored stern-to points."""
STERN_CLEARANCE_M = 1.0
"""Distance from the quay to the stern of a docked boat, unless its task has another one."""
AT_BERTH = 1e-3
"""Difference [m, rad] up to which a pose is on the center line of a berth, and has its heading."""
MAX_LAYOUTS = 1000
MIN_BERTH_M = 2.4
"""Minimum width of generated berths, which fits the narrowest of `DEFAULT_MODELS`."""


class Rectangle(Model):
    """A rectangle in the plane [m]."""

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


class Basin(Rectangle):
    """Water area between the faces of the quays [m]."""


class Entrance(Model):
    """A gap in one of the quays, through which the harbor is open to the sea [m]."""

    side: Side
    from_m: Coordinate
    to_m: Coordinate

    @model_validator(mode="after")
    def _is_a_gap(self) -> Self:
        if self.from_m >= self.to_m:
            message = f"{self.from_m:g} must be less than to_m, {self.to_m:g}"
            raise FieldError("from_m", message, "out_of_range")
        return self


class _Row(Model):
    """Berths along one edge of a quay, a pier or land, with finger piers between them."""

    finger_length_m: Length = 8.0
    finger_width_m: Length = 1.0
    edge_m: Coordinate | None = Field(
        default=None, description="x (east, west) or y of the edge of a pier or land; null for the quay"
    )

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
    """A GLB, OBJ, STL or PLY file; after rotation, scaling and shift, in meters with the water at z = 0."""

    path: str
    up: Literal["z", "y"] = Field(default="z", description="upward axis of the file; y in glTF")
    scale: Positive = 1.0
    shift_m: tuple[Coordinate, Coordinate, Coordinate] = (0.0, 0.0, 0.0)


Rectangles = Annotated[tuple[Rectangle, ...], Field(max_length=100)]


class Marina(Model):
    """A basin with rows of finger piers, moored vessels, and optional solids from mesh files."""

    kind: Literal["marina"]
    name: Title = "marina"
    basin: Basin
    entrance: Entrance | None = Field(default=None, description="gap in a quay; null for a closed basin")
    land: Rectangles = Field(default=(), description="quays inside the basin")
    piers: Rectangles = Field(default=(), description="walkways on piles")
    rows: tuple[PierRow, ...] = Field(min_length=1, max_length=100)
    fleet: Fleet = Field(default_factory=Fleet)
    meshes: tuple[MeshFile, ...] = ()

    @model_validator(mode="after")
    def _rows_have_an_edge(self) -> Self:
        for index, row in enumerate(self.rows):
            if row.edge_m is not None and self.under(row) is None:
                edges = [getattr(body, FACES[row.side]) for body in (*self.piers, *self.land)]
                known = ", ".join(f"{edge:g}" for edge in edges) or "none"
                field, message = f"rows.{index}.edge_m", f"{row.edge_m:g} is not {FACES[row.side]} of a pier"
                raise FieldError(field, f"{message} or land (known: {known})", "mismatch")
        return self

    @model_validator(mode="after")
    def _berths_differ(self) -> Self:
        """A berth is named by its side and position, which must therefore be unique."""
        seen: dict[tuple[str, float], int] = {}
        for index, row in enumerate(self.rows):
            for at in row.berths:
                if (row.side, at) in seen:
                    field = f"rows.{index}.berth_{row.axis}_m"
                    other = "another" if seen[row.side, at] != index else "this"
                    message = f"{other} {row.side} row also has a berth at {at:g}; move one of them"
                    raise FieldError(field, message, "duplicate")
                seen[row.side, at] = index
        return self

    @model_validator(mode="after")
    def _places_are_along_an_edge(self) -> Self:
        for index, row in enumerate(self.rows):
            for name, places in (("finger", row.fingers), ("berth", row.berths)):
                for number, at in enumerate(places):
                    if message := self._misplaced(row, at):
                        field = f"rows.{index}.{name}_{row.axis}_m.{number}"
                        raise FieldError(field, message, "out_of_range")
        return self

    def _misplaced(self, row: SideRow | EndRow, at: float) -> str:
        """Return why there is no edge at a position along a row, or an empty string."""
        bodies = [self.basin] if row.edge_m is None else self._bodies_at(row)
        ends = [[getattr(body, f"{row.axis}_{end}_m") for end in ("min", "max")] for body in bodies]
        if not any(low <= at <= high for low, high in ends):
            known = ", ".join(f"{low:g} to {high:g}" for low, high in ends)
            return f"{at:g} is beyond the end of the edge of the row, which is {known}"
        gap = self.entrance
        if row.edge_m is None and gap and gap.side == row.side and gap.from_m < at < gap.to_m:
            return f"{at:g} is in the entrance, {gap.from_m:g} to {gap.to_m:g}"
        return ""

    @model_validator(mode="after")
    def _entrance_in_its_quay(self) -> Self:
        if (gap := self.entrance) is not None:
            axis = "y" if gap.side in ("east", "west") else "x"
            low, high = (getattr(self.basin, f"{axis}_{end}_m") for end in ("min", "max"))
            if not low <= gap.from_m < gap.to_m <= high:
                message = f"the {gap.side} quay extends from {low:g} to {high:g}"
                raise FieldError("entrance", message, "out_of_range")
        return self

    def under(self, row: SideRow | EndRow) -> Rectangle | None:
        """Return the pier or land along which a row lies; None for the quay around the basin."""
        if row.edge_m is None:
            return None
        return next(iter(self._bodies_at(row)), None)

    def _bodies_at(self, row: SideRow | EndRow) -> list[Rectangle]:
        """Return the piers and land that have an edge where the row has its."""
        return [body for body in (*self.piers, *self.land) if getattr(body, FACES[row.side]) == row.edge_m]

    def edge_of(self, row: SideRow | EndRow) -> float:
        """Return the coordinate, across the row, of the edge along which it lies [m]."""
        if row.edge_m is not None:
            return row.edge_m
        quay: float = getattr(self.basin, QUAYS[row.side])
        return quay

    @property
    def berths(self) -> tuple[BerthPlace, ...]:
        """All berths, row by row."""
        return tuple(BerthPlace(row.side, at) for row in self.rows for at in row.berths)

    def row_of(self, place: BerthPlace) -> SideRow | EndRow:
        """Return the row of a berth.

        Raises:
            StopIteration: there is no such berth.
        """
        return next(row for row in self.rows if row.side == place.side and place.at_m in row.berths)


def _pair(given: Any) -> Any:
    if not isinstance(given, list | tuple):
        raise ValueError(f"found {describe(given)}, expected [low, high]")
    return given


def _ordered(interval: tuple[float, float]) -> tuple[float, float]:
    if interval[0] > interval[1]:
        raise ValueError(f"expected [low, high], found {interval[0]:g} above {interval[1]:g}")
    return interval


Interval = Annotated[tuple[Length, Length], BeforeValidator(_pair), AfterValidator(_ordered)]
"""Lower and upper bound of a random length [m]."""
Whole = Annotated[int, Strict()]
Counts = Annotated[tuple[Whole, Whole], BeforeValidator(_pair), AfterValidator(_ordered)]


class Generated(Model):
    """Random marina layouts, one for each seed; see `dockctl.scenarios.layouts`.

    The layouts of the seeds from `seed` on are for training, those from `held_out_seed` on for evaluation.
    """

    kind: Literal["generated"]
    name: Title = "generated"
    seed: int = Field(default=0, ge=0, strict=True, description="seed of the first layout")
    layouts: Count = Field(default=1, le=MAX_LAYOUTS, description="number of layouts for training")
    held_out_seed: int = Field(default=1_000_000, ge=0, strict=True)
    held_out_layouts: int = Field(default=0, ge=0, le=MAX_LAYOUTS, strict=True)
    basin_length_m: Interval = Field(default=(44.0, 68.0), description="along the quays with the most berths")
    fairway_m: Interval = Field(default=(13.0, 22.0), description="width between the bows of two rows")
    entrance_m: Interval = Field(default=(9.0, 14.0), description="width of the harbor's entrance")
    berth_width_m: Interval = Field(default=(2.6, 4.6), description="between center lines in one bay")
    finger_width_m: Interval = (0.6, 1.2)
    berths_between_fingers: Counts = (1, 3)
    without_fingers: Fraction = Field(
        default=0.0, description="probability that the boats of a row lie side by side, without fingers"
    )
    piers: Counts = Field(default=(0, 1), description="walkways with berths on both sides")
    free_berths: Counts = Field(default=(3, 8), description="berths without a moored vessel in each layout")

    @property
    def meshes(self) -> tuple[MeshFile, ...]:
        return ()

    @model_validator(mode="after")
    def _within_limits(self) -> Self:
        limits: dict[str, tuple[float, float]] = {
            "basin_length_m": (40, 200),
            "fairway_m": (8, 100),
            "entrance_m": (4, 40),
            "berth_width_m": (MIN_BERTH_M, 8),
            "finger_width_m": (0.3, 2),
            "berths_between_fingers": (1, 6),
            "piers": (0, 4),
            "free_berths": (1, 1000),
        }
        for field, (low, high) in limits.items():
            given = getattr(self, field)
            if given[0] < low or given[1] > high:
                message = f"[{given[0]:g}, {given[1]:g}] is not within {low:g} to {high:g}"
                raise FieldError(field, message, "out_of_range")
        return self

    @model_validator(mode="after")
    def _held_out_differ(self) -> Self:
        first, second = (
            range(start, start + count)
            for start, count in ((self.seed, self.layouts), (self.held_out_seed, self.held_out_layouts))
        )
        if second and first.start < second.stop and second.start < first.stop:
            seeds, trained = (f"{each.start} to {each[-1]}" for each in (second, first))
            message = f"the seeds {seeds} overlap those for training, {trained}"
            raise FieldError("held_out_seed", message, "duplicate")
        return self


class MeshHarbor(Model):
    """A harbor from mesh files only."""

    kind: Literal["meshes"]
    name: Title = "meshes"
    meshes: tuple[MeshFile, ...] = Field(min_length=1)


HarborSpec = Annotated[Marina | Generated | MeshHarbor, Field(discriminator="kind")]


class BerthPlace(NamedTuple):
    """One berth: its quay, and the position of its center line along the quay [m]."""

    side: Side
    at_m: float

    def __str__(self) -> str:
        return f"{self.side} {self.at_m:g}"


def point_off_quay(side: Side, edge_m: float, at_m: float, gap_m: float) -> tuple[float, float]:
    """Return x and y [m] of the point `gap_m` off the coordinate `edge_m`, at `at_m` along the quay."""
    x, y = (edge_m, at_m) if side in ("east", "west") else (at_m, edge_m)
    return x + gap_m * INTO_BASIN[side][0], y + gap_m * INTO_BASIN[side][1]


def berth_pose(marina: Marina, place: BerthPlace, gap_m: float) -> tuple[float, float, float]:
    """Return x, y [m] and heading in (-pi, pi] [rad] of a boat docked stern-to, `gap_m` off the quay."""
    cosine, sine = INTO_BASIN[place.side]
    edge = marina.edge_of(marina.row_of(place))
    return *point_off_quay(place.side, edge, place.at_m, gap_m), math.atan2(sine, cosine)


def docked_gap(places: Iterable[tuple[Marina, BerthPlace]], final: Floats, length_m: float) -> float:
    """Return how far off the quay a boat docks [m]: as at its own berth, or with its stern 1 m from the quay.

    Args:
        places: berths, of which one may be its own.
        final: (3,) final pose of its task [m, m, rad].
    """
    gaps = (_gap_at(marina, place, final) for marina, place in places)
    return next((gap for gap in gaps if gap is not None), length_m / 2 + STERN_CLEARANCE_M)


def _gap_at(marina: Marina, place: BerthPlace, pose: Floats) -> float | None:
    """Return how far a pose at a berth is off the quay [m]; None if it is not at this berth."""
    x, y, heading = berth_pose(marina, place, 0.0)
    cosine, sine = INTO_BASIN[place.side]
    to_x, to_y = float(pose[0]) - x, float(pose[1]) - y
    across, turn = to_y * cosine - to_x * sine, float(wrap(pose[2] - heading))
    return to_x * cosine + to_y * sine if max(abs(across), abs(turn)) < AT_BERTH else None
