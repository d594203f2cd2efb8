"""Run a trained policy on a boat: from point clouds, pose and velocity to a command, with NumPy alone.

    pilot = Pilot.load("s3.npz")  # written by: dockctl export s3 --pilot s3.npz; s3.onnx needs ONNX Runtime
    decision = pilot.decide(now_s, pose, velocity, {"bow": cloud})  # once per control period

Frames and units are those of the simulator: the world frame of the goals has x and y horizontal [m] and
headings counterclockwise from +x [rad]; the body frame has x forward, y to port and z up [m], and its origin
at the center of gravity. Sectors, goals and the switch to the final pose are computed by the functions that
the simulator uses, in `dockctl.geometry` and `dockctl.sim.goal`.

If the policy cannot or should not act, the `Decision` is a stop (0 N, rudder amidships) with the reason: an
input is missing, too old or implausible, the boat has arrived, or time is up. The next decision with valid
inputs continues.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dockctl.errors import DockctlError
from dockctl.geometry import MAX_SECTORS, Floats, nearest_in_sectors, proximities
from dockctl.policy_files import Networks, not_a_policy, read_policy_file
from dockctl.reading import FOREIGN
from dockctl.sim.goal import TO_FINAL, TO_INTERMEDIATE, bearing, course, measure, offset, reached

PARTS = frozenset(
    {
        "phase", "distance", "heading_error", "velocity", "command", "lidar", "proximity", "bearing",
        "offset", "course", "apparent_wind", "through_water", "history",
    }
)  # fmt: skip
"""Parts of the observation that a pilot computes."""
FLOWS = {"apparent_wind": ("wind_ahead", "wind_port"), "through_water": ("u_water", "v_water")}
"""Inputs that only some policies observe, and their columns."""
BOUNDED = {"distance", "u", "v", "r", *(column for columns in FLOWS.values() for column in columns)}
"""Columns that must be within their bounds for the policy to act; other columns are clipped."""
EARLIER = re.compile(r"(.+)_(\d+)_ago")
"""Name of a column of the part `history`: another column, and the number of decisions since then."""
RANGE_MARGIN = 1.1
"""Factor on the range: a point may be farther from the body's origin than from its LiDAR."""
MAX_MAGNITUDE = 1e9
"""Limit of positions, headings and velocities, as in the simulator."""


@dataclass(frozen=True)
class Reading:
    """An input and the time at which it was measured [s], on the clock of `Pilot.decide`."""

    time_s: float
    value: ArrayLike


@dataclass(frozen=True)
class Checks:
    """Limits of the inputs.

    Attributes:
        max_age_s: maximum age of an input [s], and maximum time in the future.
        max_jump_m: how much farther the position may move between decisions than the maximum observable
            speed allows [m].
        min_points: minimum number of points of all clouds together.
    """

    max_age_s: float = 0.5
    max_jump_m: float = 1.0
    min_points: int = 1


@dataclass(frozen=True)
class Tolerance:
    """Limits at which a pose counts as reached: distance [m], heading [rad] and speed [m/s]."""

    distance_m: float
    heading: float
    speed_mps: float


@dataclass(frozen=True, eq=False)
class Decision:
    """A command, and how it was chosen.

    Attributes:
        propeller_n: propeller force of the command [N].
        rudder_rad: rudder angle of the command [rad].
        stop: why it is a stop; empty if the policy chose the command.
        arrived: the final pose is reached.
        phase: 0 on the way to the intermediate pose, 1 on the way to the final pose.
        action: index of the action; None at a stop, like the following attributes.
        observation: (k,) as the network receives it.
        sector_ranges_m: (sectors,) range of the nearest point in each sector [m].
        q_values: (actions,).
    """

    propeller_n: float
    rudder_rad: float
    stop: str
    arrived: bool
    phase: int
    action: int | None = None
    observation: NDArray[np.float32] | None = None
    sector_ranges_m: Floats | None = None
    q_values: NDArray[np.float32] | None = None


class _Unusable(Exception):
    """Why an input cannot be used."""


@dataclass(eq=False)
class Pilot:
    """A policy that decides from the readings of a real boat.

    Attributes:
        description: description of the policy, as written by `dockctl export` (docs/deployment.md).
        goals: (2, 3) intermediate and final pose, x, y [m] and heading [rad]; the first is NaN if there is no
            intermediate pose.
        phase: 0 on the way to the intermediate pose, 1 on the way to the final pose.
        flows: those of the inputs `apparent_wind` and `through_water` that the policy observes.
    """

    description: dict[str, Any]
    networks: Networks
    goals: Floats
    checks: Checks = field(default_factory=Checks)
    phase: int = field(init=False, repr=False)
    flows: tuple[str, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        facts = self.description
        self._columns: list[dict[str, Any]] = facts["observation"]
        names = (str(column["name"]) for column in self._columns)
        earlier = ((name, EARLIER.fullmatch(name)) for name in names)
        self._sources = [(match[1], int(match[2])) if match else (name, 0) for name, match in earlier]
        observed = {name for name, _ in self._sources}
        self.flows = tuple(name for name, columns in FLOWS.items() if not observed.isdisjoint(columns))
        self._seen: deque[dict[str, float]] = deque(maxlen=1 + max(age for _, age in self._sources))
        self._scale = np.array([column["scale"] for column in self._columns], float)
        self._low, self._high = (
            np.array([column[bound] for column in self._columns], np.float32) for bound in ("low", "high")
        )
        self._commands = np.array(facts["commands"], float)
        self._sectors, self._range_m = int(facts["lidar"]["sectors"]), float(facts["lidar"]["range_m"])
        self._max_steps = int(facts["max_steps"])
        self.control_period_s = float(facts["control_period_s"])
        positive = (self._sectors, self._range_m, self._max_steps, self.control_period_s, *self._scale)
        if self._commands.shape[1:] != (2,) or min(positive) <= 0:
            raise ValueError("expected commands of two numbers, and sizes and limits above 0")
        if self._sectors > MAX_SECTORS:
            raise ValueError(f"{self._sectors} sectors, expected at most {MAX_SECTORS}")
        self.final_tolerance, self.intermediate_tolerance = (
            Tolerance(
                *(float(facts["tolerances"][pose][key]) for key in ("distance_m", "heading_rad", "speed_mps"))
            )
            for pose in ("final", "intermediate")
        )
        self.reset()

    @classmethod
    def load(
        cls,
        file: str | Path,
        *,
        final: ArrayLike | None = None,
        intermediate: ArrayLike | None = None,
        checks: Checks | None = None,
    ) -> Pilot:
        """Load a file from ``dockctl export --pilot``, or, if ONNX Runtime is installed, from ``--onnx``.

        Args:
            final: (3,) x, y [m] and heading [rad] of the final pose, instead of the one in the file.
            intermediate: the same for the intermediate pose; requires `final`.

        Raises:
            DockctlError: the file is missing, damaged, or of another kind; a pose is not three numbers; ONNX
                Runtime is not installed.
        """
        facts, networks = read_policy_file(Path(file))
        try:
            goals = np.stack([_pose(facts["goals"][name]) for name in ("intermediate", "final")])
            pilot = cls(facts, networks, goals, checks or Checks())
        except FOREIGN as error:
            raise not_a_policy(file, error) from None
        if intermediate is not None and final is None:
            raise DockctlError("an intermediate pose also needs the final pose", code="missing_key")
        if final is not None:
            try:
                pilot.goals = np.stack([_pose(intermediate), _pose(final)])
            except (OverflowError, TypeError, ValueError) as error:
                raise DockctlError(str(error), code="wrong_type") from None
            pilot.reset()
        return pilot

    @property
    def limits(self) -> tuple[float, float]:
        """Maximum propeller force [N] and rudder angle [rad] of the vessel that the policy was made for."""
        return self.description["limits"]["propeller_n"], self.description["limits"]["rudder_rad"]

    def reset(self) -> None:
        """Start a maneuver, at the phase of the intermediate pose if there is one."""
        self.phase = TO_FINAL if np.isnan(self.goals[0]).any() else TO_INTERMEDIATE
        self._steps = 0
        self._stop()
        self._arrived = False
        self._position: tuple[float, Floats] | None = None

    def decide(
        self,
        now_s: float,
        pose: Reading | None,
        velocity: Reading | None,
        clouds: Mapping[str, Reading | None],
        *,
        apparent_wind: Reading | None = None,
        through_water: Reading | None = None,
    ) -> Decision:
        """Return the command for the next control period.

        Args:
            now_s: time [s].
            pose: (3,) x, y [m] and heading [rad], world frame; None if there is none yet.
            velocity: (3,) surge, sway [m/s] and yaw rate [rad/s] over ground, body frame.
            clouds: the points (k, 3) [m] of each LiDAR, or of all, in the body frame, without returns from
                the boat itself and the water; by name, which appears in the reasons of stops.
            apparent_wind: (2,) velocity of the air relative to the boat, ahead and to port [m/s], body frame;
                needed if `flows` contains it, like the next argument.
            through_water: (2,) surge and sway relative to the water [m/s], body frame.
        """
        self._steps += 1
        try:
            now_s = _seconds(now_s)
            eta, nu, points = self._checked(now_s, pose, velocity, clouds)
            given = {"apparent_wind": apparent_wind, "through_water": through_water}
            flows = {name: self._vector(now_s, name, given[name], 2) for name in self.flows}
            if self._steps > 1:  # as in the simulator, a goal is reached only after a step
                self._switch(eta, nu)
            if self._arrived:
                raise _Unusable("the final pose is reached")
            if self._steps > self._max_steps:
                raise _Unusable(f"not at the final pose after {self._max_steps} control periods")
            return self._choose(eta, nu, nearest_in_sectors(points, self._sectors, self._range_m), flows)
        except _Unusable as reason:
            self._stop()
            return Decision(0.0, 0.0, str(reason), self._arrived, self.phase)

    def _stop(self) -> None:
        """Record that there is no thrust, and clear the history, as at a start."""
        self._command = np.zeros(2)
        self._seen.clear()

    def _checked(
        self,
        now_s: float,
        pose: Reading | None,
        velocity: Reading | None,
        clouds: Mapping[str, Reading | None],
    ) -> tuple[Floats, Floats, Floats]:
        """Return pose and velocity (1, 3), and all points (k, 3).

        Raises:
            _Unusable: one of them is missing, too old, or implausible.
        """
        eta, nu = (
            self._vector(now_s, name, reading, 3)[None]
            for name, reading in (("pose", pose), ("velocity", velocity))
        )
        if not isinstance(clouds or {}, Mapping):
            raise _Unusable("clouds: not a mapping of names to readings")
        parts = [self._points(now_s, f"cloud '{name}'", cloud) for name, cloud in (clouds or {}).items()]
        points = np.concatenate([np.empty((0, 3)), *parts])
        if len(points) < self.checks.min_points:
            raise _Unusable(f"clouds: {len(points)} points, expected at least {self.checks.min_points}")
        self._require_no_jump(now_s, eta)
        return eta, nu, points

    def _vector(self, now_s: float, name: str, reading: Reading | None, size: int) -> Floats:
        vector = self._fresh(now_s, name, reading)
        if vector.shape != (size,) or not (np.abs(vector) < MAX_MAGNITUDE).all():
            raise _Unusable(f"{name}: {_short(vector)}, expected {size} finite numbers")
        return vector

    def _fresh(self, now_s: float, name: str, reading: Reading | None) -> Floats:
        if reading is None:
            raise _Unusable(f"{name}: no data yet")
        try:
            age = now_s - _seconds(reading.time_s)
            given: NDArray[Any] = np.ma.asarray(reading.value)
            if given.size and given.dtype.kind not in "iuf":  # also not booleans, times and complex numbers
                raise TypeError
            value: Floats = np.ma.filled(given.astype(float), np.nan)  # masked: not measured
        except Exception:  # invalid data may raise anything
            raise _Unusable(f"{name}: not a time and an array of numbers") from None
        if not abs(age) <= self.checks.max_age_s:
            raise _Unusable(f"{name}: {age:.3g} s old, expected at most {self.checks.max_age_s:g} s")
        return value

    def _points(self, now_s: float, name: str, cloud: Reading | None) -> Floats:
        points = self._fresh(now_s, name, cloud)
        if points.ndim != 2 or points.shape[1] != 3:
            raise _Unusable(f"{name}: shape {points.shape}, expected (points, 3)")
        if not np.isfinite(points).all():
            raise _Unusable(f"{name}: contains NaN or infinity; omit such points")
        farthest = float(np.abs(points).max(initial=0.0))  # first: the squares of larger numbers overflow
        if farthest < MAX_MAGNITUDE:
            farthest = math.sqrt(float((points * points).sum(axis=1).max(initial=0.0)))
        if farthest > RANGE_MARGIN * self._range_m:
            raise _Unusable(f"{name}: a point {farthest:.4g} m away, beyond the range of {self._range_m:g} m")
        return points

    def _require_no_jump(self, now_s: float, eta: Floats) -> None:
        previous, self._position = self._position, (now_s, eta[0, :2])
        if previous is None or ("u", 0) not in self._sources:
            return
        moved = math.dist(previous[1], eta[0, :2])
        allowed = self._speed_limit() * max(now_s - previous[0], 0.0) + self.checks.max_jump_m
        if moved > allowed:
            raise _Unusable(
                f"pose: moved {moved:.3g} m since the last decision, expected at most {allowed:.3g} m"
            )

    def _speed_limit(self) -> float:
        """Return the maximum surge that the policy observes [m/s]."""
        column = self._sources.index(("u", 0))
        return float(self._high[column] * self._scale[column])

    def _switch(self, eta: Floats, nu: Floats) -> None:
        """Continue with the final pose once the intermediate pose is reached; record the arrival."""
        phase = np.array([self.phase])
        speed = np.hypot(nu[:, 0], nu[:, 1])
        intermediate, final = reached(self, phase, *measure(eta, self.goals[phase]), speed)
        if intermediate[0]:
            self.phase = TO_FINAL
        self._arrived |= bool(final[0])

    def _choose(self, eta: Floats, nu: Floats, ranges: Floats, flows: Mapping[str, Floats]) -> Decision:
        """Return the decision of the policy.

        Raises:
            _Unusable: distance, speed or wind exceed what the policy observes.
        """
        self._seen.appendleft(self._quantities(eta, nu, self.goals[[self.phase]], ranges, flows))
        first = len(self._seen) - 1  # also used for all earlier decisions
        raw = np.array([self._seen[min(age, first)][name] for name, age in self._sources])
        scaled = (raw / self._scale).astype(np.float32)
        inside = (self._low <= scaled) & (scaled <= self._high)
        for index, (name, age) in enumerate(self._sources):
            if name in BOUNDED and not age and not inside[index]:
                bound, unit = self._high[index] * self._scale[index], self._columns[index]["unit"]
                raise _Unusable(
                    f"{name}: {raw[index]:.4g} {unit}, but the policy observes at most {bound:.4g} {unit}"
                )
        observation = np.clip(scaled, self._low, self._high)
        q_values = self.networks.q_values(observation[None])[0]
        if not np.isfinite(q_values).all():
            raise _Unusable("action values: not finite")
        action = int(self.networks.greedy(observation[None], q_values[None])[0])
        self._command = self._commands[action].copy()
        force, angle = self._command.tolist()
        return Decision(force, angle, "", False, self.phase, action, observation, ranges, q_values)

    def _quantities(
        self, eta: Floats, nu: Floats, goal: Floats, ranges: Floats, flows: Mapping[str, Floats]
    ) -> dict[str, float]:
        """Return the current value of every column that a policy may observe, before scaling."""
        distance, heading_error = measure(eta, goal)
        (direction,), (speed,), (track,) = bearing(eta, goal), *course(eta, nu, goal)
        ((ahead, port),) = offset(eta, goal)
        return {
            "phase": float(self.phase),
            "distance": distance[0],
            "heading_error": heading_error[0],
            **dict(zip(("u", "v", "r"), nu[0], strict=True)),
            **dict(zip(("propeller", "rudder"), self._command, strict=True)),
            **{f"range_{i}": value for i, value in enumerate(ranges, start=1)},
            **{f"proximity_{i}": value for i, value in enumerate(proximities(ranges), start=1)},
            "bearing_sin": np.sin(direction),
            "bearing_cos": np.cos(direction),
            "offset_ahead": ahead,
            "offset_port": port,
            "speed": speed,
            "course_sin": np.sin(track),
            "course_cos": np.cos(track),
            **{column: x for name in flows for column, x in zip(FLOWS[name], flows[name], strict=True)},
        }


def _seconds(now_s: Any) -> float:
    """Return the time [s] as a number.

    Raises:
        _Unusable: it is not a number, or not finite.
    """
    if not isinstance(now_s, bool) and isinstance(now_s, Real):
        with suppress(OverflowError):
            if math.isfinite(number := float(now_s)):
                return number
    raise _Unusable("now_s: not a finite number of seconds")


def _pose(given: ArrayLike | None) -> Floats:
    """Return a goal (3,); NaN for none.

    Raises:
        ValueError: it is not a finite pose.
    """
    if given is None:
        return np.full(3, np.nan)
    pose: Floats = np.ma.filled(np.ma.asarray(given, float), np.nan)
    if pose.shape != (3,) or not (np.abs(pose) < MAX_MAGNITUDE).all():
        raise ValueError(f"pose {_short(pose)}, expected x, y [m] and heading [rad]")
    return pose


def _short(values: NDArray[Any]) -> str:
    return np.array2string(values.ravel()[:4], precision=4, separator=", ")
