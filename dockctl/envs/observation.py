"""The observation (thesis eqs. 3.9, 3.12): its parts, scaled to about unit range, and their composition.

A part is a function of the `View` of n boats, and of keyword-only parameters, that returns `Columns`. Values
are clipped to their bounds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, Field

from dockctl.errors import Code, DockctlError, require_shape
from dockctl.geometry import Floats, Ints, proximities, read_only, rotate
from dockctl.plugins import OBSERVATION_PARTS, Guard
from dockctl.scenarios.base import Count, Positive
from dockctl.scenarios.schema import ObservationPart
from dockctl.sim.goal import bearing as goal_bearing
from dockctl.sim.goal import course as goal_course
from dockctl.sim.goal import measure
from dockctl.sim.goal import offset as goal_offset

if TYPE_CHECKING:  # slow to import, and not needed to check a scenario
    from dockctl.sim.simulator import Simulator


@dataclass(frozen=True)
class View:
    """The state of n boats, as their sensors measure it, from which observations are computed.

    Parts must not write to it.

    Attributes:
        phase: (n,) int, 0 before the intermediate pose, 1 after it.
        distance_m: (n,) delta d, distance to the goal of the phase (eq. 3.5) [m].
        heading_error_rad: (n,) delta psi, heading minus that of the goal, in (-pi, pi] (eq. 3.6).
        eta, goal: (n, 3) own pose and goal of the phase, x, y [m] and heading [rad], world frame.
        nu: (n, 3) surge, sway [m/s] and yaw rate [rad/s] over ground, body frame.
        command: (n, 2) last propeller force [N] and rudder angle [rad].
        command_limit: (2,) maximum propeller force [N] and rudder angle [rad] of the vessel.
        sector_ranges_m: (n, sectors) nearest return of each sector of the range sensor [m].
        apparent_wind: (n, 2) velocity of the air relative to the boat [m/s], body frame.
        through_water: (n, 2) surge and sway relative to the water [m/s], body frame, as a speed log measures.
        past: earlier views, latest first; views before the start of the episode equal its first view. Empty
            without the part `history`, which computes other parts from them.
    """

    phase: Ints
    distance_m: Floats
    heading_error_rad: Floats
    eta: Floats
    goal: Floats
    nu: Floats
    command: Floats
    command_limit: Floats
    sector_ranges_m: Floats
    apparent_wind: Floats
    through_water: Floats
    past: tuple[View, ...] = ()

    @classmethod
    def of(cls, simulator: Simulator, sector_ranges_m: Floats, past: tuple[View, ...] = ()) -> View:
        """Return the view of a simulator's boats with these ranges (n, sectors) [m] and earlier views."""
        eta, nu, goal = simulator.measured_pose(), simulator.measured_velocity(), simulator.goal
        distance, heading_error = measure(eta, goal)

        def relative_to(world_velocity: Floats) -> Floats:
            if not simulator.disturbances:  # both are zero
                return -simulator.nu[:, :2]
            x, y = world_velocity.T
            return np.column_stack(rotate(x, y, -simulator.eta[:, 2])) - simulator.nu[:, :2]

        return cls(
            phase=simulator.phase,
            distance_m=distance,
            heading_error_rad=heading_error,
            eta=eta,
            goal=goal,
            nu=nu,
            command=simulator.command,
            command_limit=simulator.vessel.command_limit,
            sector_ranges_m=sector_ranges_m,
            apparent_wind=relative_to(simulator.wind()),
            through_water=-relative_to(simulator.current()),
            past=past,
        )

    def mirrored(self) -> View:
        """Return the view mirrored in the x axis, which swaps port and starboard."""
        pose, vector = np.array([1, -1, -1]), np.array([1, -1])
        return replace(
            self,
            heading_error_rad=-self.heading_error_rad,
            eta=self.eta * pose,
            goal=self.goal * pose,
            nu=self.nu * pose,
            command=self.command * vector,
            sector_ranges_m=self.sector_ranges_m[:, ::-1],
            apparent_wind=self.apparent_wind * vector,
            through_water=self.through_water * vector,
            past=tuple(view.mirrored() for view in self.past),
        )

    def copy(self) -> View:
        """Return a view with arrays of its own, without earlier views."""
        return replace(self, past=(), **{name: getattr(self, name).copy() for name in BY_BOAT})

    def read_only(self) -> View:
        """Return the view with arrays that cannot be written to."""
        arrays = {name: read_only(getattr(self, name)) for name in (*BY_BOAT, "command_limit")}
        return replace(self, past=tuple(view.read_only() for view in self.past), **arrays)

    def set_rows(self, rows: Ints, other: View) -> None:
        """Replace the rows (k,) with those of another view of the boats."""
        for name in BY_BOAT:
            getattr(self, name)[rows] = getattr(other, name)[rows]


BY_BOAT = tuple(field.name for field in fields(View) if field.name not in ("command_limit", "past"))
"""Attributes of a view with one row per boat."""


@dataclass(frozen=True)
class Columns:
    """k columns of the observation: values / scale, clipped to the bounds.

    Attributes:
        names: k names.
        values: (n, k).
        low: lower bound after scaling, one number or (k,).
        high: upper bound after scaling, one number or (k,).
        scale: what the values are divided by, one number or (k,).
        units: of the values, one per name; none by default.
    """

    names: Sequence[str]
    values: Floats
    low: ArrayLike
    high: ArrayLike
    scale: ArrayLike = 1.0
    units: Sequence[str] = ()


Part = Callable[..., Columns]

HISTORY = "history"
Ages = Annotated[Count, Field(le=100)]


def _present_part(name: str) -> str:
    if name == HISTORY or name not in OBSERVATION_PARTS.names():
        known = ", ".join(sorted({*OBSERVATION_PARTS.names()} - {HISTORY}))
        raise ValueError(f"found '{name}', expected one of {known}")
    return name


PartNames = Annotated[tuple[Annotated[str, AfterValidator(_present_part)], ...], Field(min_length=1)]

BLANK_BOATS = 2
"""Boats in the view used to check shapes; with one boat, (n, k) and (1, k) could not be distinguished."""


def observation_part(name: str, *, source: str = "") -> Callable[[Part], Part]:
    """Register the function below as a part of the observation.

    Args:
        name: its name in scenarios.
        source: equation or table.

    Raises:
        DuplicateNameError: the name is taken.
    """
    return lambda function: OBSERVATION_PARTS.register(name, function, kind="observation", source=source)


@observation_part("phase", source="eq. 3.12")
def phase(view: View) -> Columns:
    """Return s_task: 0 before the intermediate pose, 1 after it."""
    return Columns(["phase"], view.phase[:, None].astype(float), 0, 1)


@observation_part("distance", source="eq. 3.5")
def distance(view: View, *, scale_m: Positive = 10.0, cap_m: Positive = 100.0) -> Columns:
    """Return delta d / scale, capped."""
    return Columns(["distance"], view.distance_m[:, None], 0, cap_m / scale_m, scale_m, ["m"])


@observation_part("heading_error", source="eq. 3.6")
def heading_error(view: View) -> Columns:
    """Return delta psi [rad]."""
    return Columns(["heading_error"], view.heading_error_rad[:, None], -np.pi, np.pi, units=["rad"])


@observation_part("velocity", source="eq. 3.9")
def velocity(
    view: View,
    *,
    surge_mps: Positive = 0.4,
    sway_mps: Positive = 0.1,
    yaw_radps: Positive = 0.04,
    cap: Positive = 5.0,
) -> Columns:
    """Return u, v and r, each divided by its scale, clipped to ±cap."""
    scale, units = [surge_mps, sway_mps, yaw_radps], ["m/s", "m/s", "rad/s"]
    return Columns(["u", "v", "r"], view.nu, -cap, cap, scale, units)


@observation_part("command", source="eq. 3.9")
def command(view: View) -> Columns:
    """Return the last propeller force and rudder angle as fractions of the vessel's limits."""
    return Columns(["propeller", "rudder"], view.command, -1, 1, view.command_limit, ["N", "rad"])


@observation_part("lidar", source="eqs. 3.7, 3.8")
def lidar(view: View, *, cap_m: Positive = 20.0, scale_m: Positive = 10.0) -> Columns:
    """Return the nearest return of each sector, capped, divided by the scale."""
    names = [f"range_{sector + 1}" for sector in range(view.sector_ranges_m.shape[1])]
    return Columns(names, view.sector_ranges_m, 0, cap_m / scale_m, scale_m, ["m"] * len(names))


@observation_part("proximity", source="not in the thesis")
def proximity(view: View, *, full_m: Positive = 1.0) -> Columns:
    """Return full_m / range of each sector, at most 1, which resolves short ranges best."""
    names = [f"proximity_{sector + 1}" for sector in range(view.sector_ranges_m.shape[1])]
    return Columns(names, proximities(view.sector_ranges_m), 0, 1, 1 / full_m, ["1/m"] * len(names))


@observation_part("bearing", source="not in the thesis")
def bearing(view: View) -> Columns:
    """Return sine and cosine of the bearing of the goal in the body frame."""
    angle = goal_bearing(view.eta, view.goal)
    return Columns(["bearing_sin", "bearing_cos"], np.column_stack([np.sin(angle), np.cos(angle)]), -1, 1)


@observation_part("offset", source="not in the thesis")
def offset(view: View, *, scale_m: Positive = 2.0, cap_m: Positive = 10.0) -> Columns:
    """Return the position ahead and to port of the goal, / scale, clipped to ±cap.

    It resolves short distances, and networks need not multiply distance and bearing.
    """
    names, cap = ["offset_ahead", "offset_port"], cap_m / scale_m
    return Columns(names, goal_offset(view.eta, view.goal), -cap, cap, scale_m, ["m", "m"])


@observation_part("apparent_wind", source="not in the thesis")
def apparent_wind(view: View, *, scale_mps: Positive = 5.0, cap: Positive = 5.0) -> Columns:
    """Return the velocity of the air relative to the boat, ahead and to port, divided by the scale."""
    names, units = ["wind_ahead", "wind_port"], ["m/s", "m/s"]
    return Columns(names, view.apparent_wind, -cap, cap, scale_mps, units)


@observation_part("through_water", source="not in the thesis")
def through_water(
    view: View, *, surge_mps: Positive = 0.4, sway_mps: Positive = 0.1, cap: Positive = 5.0
) -> Columns:
    """Return surge and sway relative to the water, as from a speed log, each divided by its scale."""
    names, units = ["u_water", "v_water"], ["m/s", "m/s"]
    return Columns(names, view.through_water, -cap, cap, [surge_mps, sway_mps], units)


@observation_part("course", source="not in the thesis")
def course(view: View, *, scale_mps: Positive = 0.4, cap: Positive = 5.0) -> Columns:
    """Return speed over ground / scale, and sine and cosine of the course relative to the goal's heading."""
    speed, angle = goal_course(view.eta, view.nu, view.goal)
    values = np.column_stack([speed, np.sin(angle), np.cos(angle)])
    names, scale = ["speed", "course_sin", "course_cos"], [scale_mps, 1, 1]
    return Columns(names, values, [0, -1, -1], [cap, 1, 1], scale, ["m/s", "", ""])


@observation_part(HISTORY, source="not in the thesis")
def history(view: View, *, steps: Ages = 3, parts: PartNames = ("velocity", "command")) -> Columns:
    """Return other parts, with their default parameters, as they were 1 to `steps` control steps ago."""
    past = [*view.past[:steps], *[view.past[-1] if view.past else view] * (steps - len(view.past))]
    then = [OBSERVATION_PARTS.get(part).bind({})(each) for each in past for part in parts]
    ages = [age for age in range(1, steps + 1) for _ in parts]

    def each(bounds: Sequence[ArrayLike]) -> Floats:
        wide = zip(bounds, then, strict=True)
        return np.concatenate([np.broadcast_to(np.asarray(b, float), len(c.names)) for b, c in wide])

    return Columns(
        [f"{name}_{age}_ago" for columns, age in zip(then, ages, strict=True) for name in columns.names],
        np.hstack([columns.values for columns in then]),
        each([columns.low for columns in then]),
        each([columns.high for columns in then]),
        each([columns.scale for columns in then]),
        [unit for columns in then for unit in columns.units or [""] * len(columns.names)],
    )


class ObservationEncoder:
    """Computes observations from views: the columns of all parts, in the scenario's order.

    Attributes:
        names: names of the k columns.
        parts: the part of each column.
        space: Box of float32, (k,).
        past_steps: number of earlier views that the parts need.

    Args:
        parts: the parts that the scenario lists.
        sectors: number of sectors of the range sensor.

    Raises:
        DockctlError: a part or one of its parameters is unknown, a parameter is missing, or a part returns
            columns of the wrong shape or with a lower bound above the upper one.
    """

    def __init__(self, parts: Sequence[ObservationPart], sectors: int) -> None:
        default = OBSERVATION_PARTS.get(HISTORY).parameters["steps"]
        histories = [given.params for given in parts if given.part == HISTORY]
        self.past_steps: int = max((params.get("steps", default) for params in histories), default=0)
        self._parts: list[tuple[str, Guard, Part, int]] = []
        blank, columns, bounds = blank_view(sectors), [], []
        for given in parts:
            part = OBSERVATION_PARTS.get(given.part).bind(given.params)
            with (guard := Guard(OBSERVATION_PARTS, given.part)):
                columns.append(_checked(given.part, part(blank)))
                bounds.append(_bounds(given, columns[-1]))
            self._parts.append((given.part, guard, part, len(columns[-1].names)))
        self.names = tuple(name for column in columns for name in column.names)
        self.parts = tuple(
            given.part for given, column in zip(parts, columns, strict=True) for _ in column.names
        )
        low, high = map(np.concatenate, zip(*bounds, strict=True))
        self.space = Box(low, high)

    def __call__(self, view: View) -> NDArray[np.float32]:
        """Return the observations (n, k) of n boats, clipped to the bounds.

        Raises:
            DockctlError: a part failed, wrote to the view, or returned a different shape than before.
        """
        view = view.read_only()  # its arrays are those of the simulator
        values = np.empty((len(view.phase), len(self.names)), np.float32)
        end = 0
        for name, guard, part, width in self._parts:
            with guard:
                columns = part(view)
                start, end = end, end + width
                require_shape(f"observation part '{name}'", np.shape(columns.values), (len(values), width))
                values[:, start:end] = np.divide(columns.values, columns.scale)
        return np.clip(values, self.space.low, self.space.high)

    def columns(self, view: View) -> list[Columns]:
        """Return the columns of every part, before scaling and clipping.

        Raises:
            DockctlError: a part failed.
        """
        columns = []
        for _, guard, part, _ in self._parts:
            with guard:
                columns.append(part(view))
        return columns


def _checked(part: str, columns: Columns) -> Columns:
    """Check the shapes of the columns that a part returned for the blank view, and return the columns."""
    expected = (BLANK_BOATS, len(columns.names))
    if np.shape(columns.values) != expected:
        raise DockctlError(
            f"observation part '{part}' returned values of shape {np.shape(columns.values)} for"
            f" {expected[0]} boats, expected one row per boat and one column per name, {expected}",
            code="plugin",
        )
    for bound in (columns.low, columns.high, columns.scale):
        if np.shape(bound) not in ((), expected[1:]):
            raise DockctlError(
                f"observation part '{part}' returned a bound or scale of shape {np.shape(bound)},"
                f" expected one number, or one per name, {expected[1:]}",
                code="plugin",
            )
    return columns


def _bounds(given: ObservationPart, columns: Columns) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the lower and upper bound of each column.

    Raises:
        DockctlError: a bound is not finite, or a lower one exceeds the upper one.
    """
    count = len(columns.names)
    with np.errstate(over="ignore"):
        low, high = (
            np.broadcast_to(bound, count).astype(np.float32) for bound in (columns.low, columns.high)
        )
    if not (np.isfinite(low) & np.isfinite(high) & (low <= high)).all():
        message = f"observation part '{given.part}' with {given.params}: its bounds are {low} and {high}"
        code: Code = "out_of_range" if given.params else "plugin"  # without parameters, not the user's error
        raise DockctlError(f"{message}, expected finite numbers, lower bound first", code=code)
    return low, high


def blank_view(sectors: int, command_limit: Floats | None = None) -> View:
    """Return the view of `BLANK_BOATS` boats at rest; `command_limit` (2,) [N, rad] is 1 by default."""
    n, zeros = BLANK_BOATS, np.zeros
    return View(
        phase=zeros(n, np.int64),
        distance_m=zeros(n),
        heading_error_rad=zeros(n),
        eta=zeros((n, 3)),
        goal=zeros((n, 3)),
        nu=zeros((n, 3)),
        command=zeros((n, 2)),
        command_limit=np.ones(2) if command_limit is None else command_limit,
        sector_ranges_m=zeros((n, sectors)),
        apparent_wind=zeros((n, 2)),
        through_water=zeros((n, 2)),
    )
