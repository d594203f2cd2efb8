"""The control step of n boats: integrate, check for collisions, measure the goal, scan."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from dockctl.compute import map_on_all_cores
from dockctl.errors import DockctlError, require_shape
from dockctl.geometry import Bools, Floats, Ints, rotate
from dockctl.plugins import RANGE_SENSORS, Guard
from dockctl.scenarios.extensions import NoisyRangeSensor
from dockctl.scenarios.schema import Scenario
from dockctl.sim.collision import Obstacles
from dockctl.sim.devices import CPU, require_device, sensor_on, vessel_model
from dockctl.sim.disturbances import Disturbances
from dockctl.sim.goal import TO_FINAL, StepStatus, measure, reached
from dockctl.sim.starts import Start
from dockctl.sim.swept import first_contact, rounded_up
from dockctl.sim.vessel import coefficients
from dockctl.sim.world import World, prepare

Answer = TypeVar("Answer", bound=NDArray[Any])
STATE = (
    "eta", "nu", "command", "actuation", "phase", "goals", "harbor", "steps", "max_steps", "distance_m",
    "heading_error_rad", "sector_ranges_m", "resting",
)  # fmt: skip
"""Attributes with one row per boat."""


STATE_LIMIT = 1e9
"""Positions [m], headings [rad] or velocities above this limit mean that the integration diverged."""


class IntegrationError(DockctlError):
    """The integration step is too large for the forces, velocities or currents."""

    code = "out_of_range"


class Simulator:
    """The state of n boats and the control step that changes it; a single boat is a batch of one.

    Args:
        worlds: the harbors of the scenario; each boat is in the one that its start names.
        device: "cpu", or "cuda" for scans and equations of motion on an NVIDIA GPU, which pays off for
            hundreds of boats.

    Attributes (one row per boat):
        eta: (n, 3) x, y [m] and heading [rad].
        nu: (n, 3) u, v [m/s] and r [rad/s] over ground.
        command: (n, 2) propeller force [N] and rudder angle [rad] of the last step; zero at a start.
        actuation: (n, 2) mean actual force and angle over the last substep, if a condition changes them.
        phase: (n,) 0 on the way to the intermediate pose, 1 on the way to the final pose.
        goals: (n, 2, 3) intermediate and final pose of each boat.
        harbor: (n,) index of the world that each boat is in.
        steps, max_steps: (n,) control steps taken in this episode, and allowed.
        distance_m, heading_error_rad: (n,) relative to the goal of the current phase.
        sector_ranges_m: (n, sectors) nearest LiDAR returns.
        resting: (n,) boats without an episode, which keep their state and are not scanned.
    """

    def __init__(
        self, scenario: Scenario, worlds: Sequence[World], num_boats: int, device: str = CPU
    ) -> None:
        require_device(device)
        self._device = device
        self._sensor = Guard(RANGE_SENSORS, scenario.sensors.lidar.kind)
        self.task = scenario.task
        self.worlds = worlds
        self._prepared: set[int] = set()
        self.prepare([0])
        self.vessel = vessel_model(scenario.vessel, device)
        self.disturbances = Disturbances(scenario, num_boats)
        self._range_m = scenario.sensors.lidar.range_m
        if self.disturbances.define("range_noise") and not isinstance(worlds[0].lidar, NoisyRangeSensor):
            kind = scenario.sensors.lidar.kind
            message = f"the range sensor '{kind}' has no noisy_sector_ranges, which the conditions need"
            raise DockctlError(message, code="mismatch")
        self.eta = np.zeros((num_boats, 3))
        self.nu = np.zeros((num_boats, 3))
        self.command = np.zeros((num_boats, 2))
        self.actuation = np.zeros((num_boats, 2))
        self._coefficients: Floats | None = None
        self.phase = np.zeros(num_boats, np.int64)
        self.goals = np.zeros((num_boats, 2, 3))
        self.harbor = np.zeros(num_boats, np.int64)
        self.steps = np.zeros(num_boats, np.int64)
        self.max_steps = np.zeros(num_boats, np.int64)
        self.distance_m = np.zeros(num_boats)
        self.heading_error_rad = np.zeros(num_boats)
        self.sector_ranges_m = np.zeros((num_boats, scenario.sensors.lidar.sectors))
        self.resting = np.zeros(num_boats, bool)

    def prepare(self, harbors: Iterable[int]) -> None:
        """Build the sensor's tables for these harbors now, in parallel; `reset` does so for its starts."""
        missing = sorted({self._index(harbor) for harbor in harbors} - self._prepared)
        with self._sensor:
            prepare([self.worlds[number] for number in missing])
        self._prepared.update(missing)

    @property
    def goal(self) -> Floats:
        """Goal pose of the current phase, (n, 3)."""
        current: Floats = self.goals[np.arange(len(self.phase)), self.phase]
        return current

    def reset(self, rows: Ints, starts: Sequence[Start], rngs: Sequence[np.random.Generator] = ()) -> None:
        """Begin an episode in each of the rows (k,).

        Args:
            starts: k starts.
            rngs: k generators from which the conditions draw if a start has no seed of its own.
        """
        self.prepare(start.harbor for start in starts)
        self.eta[rows] = [start.eta for start in starts]
        self.nu[rows] = [start.nu for start in starts]
        self.phase[rows] = [start.phase for start in starts]
        self.goals[rows] = [start.goals for start in starts]
        self.harbor[rows] = [start.harbor for start in starts]
        self.max_steps[rows] = [start.max_steps for start in starts]
        self.steps[rows] = 0
        self.resting[rows] = False
        self.command[rows] = self.actuation[rows] = 0.0
        self.disturbances.reset(rows, starts, rngs)
        self._scale_coefficients(rows)
        self._measure()
        self.sector_ranges_m[rows] = self.scan(rows)

    def rest(self, rows: Ints) -> None:
        """Mark the boats in `rows` (k,) as resting until they are reset."""
        self.resting[rows] = True

    def step(self, command: Floats) -> StepStatus:
        """Hold the commands (n, 2) [N, rad] for one control period and return the result.

        Events are mutually exclusive: a boat that collides reaches no pose in that step. For a boat that
        reaches the intermediate pose, the final pose is the goal from the next step on.

        Raises:
            IntegrationError: the integration of a boat diverged.
            DockctlError: a condition failed, or returned another shape or a value that is not finite.
        """
        phase, distance, heading_error = self.phase.copy(), self.distance_m, self.heading_error_rad
        previous_command, self.command = self.command, command.astype(float)
        collided = self._move()
        self.steps += ~self.resting
        self.disturbances.advance(self.vessel.vessel.control_period_s)
        self._measure()
        speed = np.hypot(self.nu[:, 0], self.nu[:, 1])
        intermediate, final = reached(self.task, phase, self.distance_m, self.heading_error_rad, speed)
        active = np.flatnonzero(~self.resting)
        self.sector_ranges_m[active] = self.scan(active)
        status = StepStatus(
            phase=phase,
            distance_m=self.distance_m.copy(),
            heading_error_rad=self.heading_error_rad.copy(),
            previous_distance_m=distance,
            previous_heading_error_rad=heading_error,
            eta=self.eta.copy(),
            nu=self.nu.copy(),
            command=self.command.copy(),
            previous_command=previous_command,
            sector_ranges_m=self.sector_ranges_m.copy(),
            collided=collided,
            reached_intermediate=intermediate & ~collided & ~self.resting,
            reached_final=final & ~collided & ~self.resting,
            clearance_below=self._clearances(),
        )
        if status.reached_intermediate.any():
            self.phase[status.reached_intermediate] = TO_FINAL
            self._measure()
        return status

    def _clearances(self) -> Callable[[float], Floats]:
        """Return a function for the clearances at the current poses; it remains valid after later steps."""
        eta, harbor = self.eta.copy(), self.harbor.copy()

        def below(limit_m: float) -> Floats:
            clearance = np.full(len(eta), limit_m)
            for index in np.unique(harbor):
                rows = harbor == index
                clearance[rows] = self.worlds[self._index(index)].obstacles.clearance_below(
                    eta[rows], limit_m
                )
            return clearance

        return below

    def state(self) -> dict[str, Any]:
        """Return the arrays of all boats by name, and the states of the conditions in their order."""
        return {**{name: getattr(self, name) for name in STATE}, "conditions": self.disturbances.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from what `state` returned.

        Raises:
            DockctlError: the number of boats or the scenario differs.
            KeyError: a part of it is missing.
        """
        state = {"actuation": self.actuation, "resting": self.resting, **state}  # not in early versions
        for name in STATE:
            expected, given = getattr(self, name), state[name]
            if np.shape(given) != expected.shape or given.dtype != expected.dtype:
                message = f"{name} {np.shape(given)}, expected {expected.shape} of {expected.dtype}"
                raise DockctlError(f"the state of other boats: {message}", code="mismatch")
        if len(state["conditions"]) != len(self.disturbances) or state["harbor"].max() >= len(self.worlds):
            raise DockctlError("the state of boats in other harbors or conditions", code="mismatch")
        self.prepare(state["harbor"].tolist())
        for name in STATE:
            setattr(self, name, state[name])
        self.disturbances.restore(state["conditions"])
        self._scale_coefficients(np.arange(len(self.eta)))

    def scan(self, rows: Ints | None = None) -> Floats:
        """Return the sector ranges (k, sectors) [m] of the boats in `rows` (k,), by default of all.

        Raises:
            DockctlError: the sensor returned the wrong shape.
        """
        boats, sectors = self.sector_ranges_m.shape
        noise = self.disturbances.range_noise()

        def ranges_of(world: World, rows: Ints) -> Floats:
            sensor = sensor_on(self._device, world.lidar)
            if noise is None:
                return sensor.sector_ranges(self.eta[rows])
            # Checked by `__init__`; isinstance with a protocol would evaluate its properties in every scan.
            return cast(NoisyRangeSensor, sensor).noisy_sector_ranges(self.eta[rows], noise.of(rows))

        with self._sensor:
            ranges = self.in_harbors(ranges_of, rows, on_all_cores=self._device == CPU)
            require_shape("the range sensor", ranges.shape, (boats if rows is None else len(rows), sectors))
        if noise is not None:
            from dockctl.noise import uniforms  # compiles on import

            own = noise if rows is None else noise.of(rows)
            lost = uniforms(own.seeds + np.uint64(2), sectors) < own.lost_sectors[:, None]
            ranges = np.where(lost, self._range_m, ranges)
        scanned = np.arange(boats) if rows is None else rows
        return self.disturbances.reported_ranges(ranges, scanned, self._range_m)

    def in_harbors(
        self,
        query: Callable[[World, Ints], Answer],
        rows: Ints | None = None,
        *,
        on_all_cores: bool = False,
    ) -> Answer:
        """Evaluate a function of world and boats for each boat, in the boat's own world.

        Args:
            query: takes a world and boats (m,), and returns m rows.
            rows: (k,) which boats; all by default.
            on_all_cores: evaluate several worlds in parallel; for a function that releases the GIL.

        Returns:
            The answers in the order of the boats.
        """
        boats = np.arange(len(self.harbor)) if rows is None else rows
        if len(self.worlds) == 1:
            return query(self.worlds[0], boats)
        harbor = self.harbor[boats]
        order = np.argsort(harbor, kind="stable")
        numbers, first = np.unique(harbor[order], return_index=True)
        worlds, groups = [self.worlds[i] for i in numbers], np.split(boats[order], first[1:])
        if on_all_cores:
            pairs = zip(worlds, groups, strict=True)
            answers = map_on_all_cores(lambda pair: query(*pair), pairs)
        else:
            answers = [*map(query, worlds, groups)]
        return cast(Answer, np.concatenate(answers)[np.argsort(order)])

    def obstacles(self, row: int) -> Obstacles:
        """Return what the boat `row` can collide with."""
        return self.worlds[self._index(self.harbor[row])].obstacles

    def _index(self, harbor: int) -> int:
        """Return the index of a harbor in `worlds`; in a single world, all boats are in it."""
        return int(harbor) if len(self.worlds) > 1 else 0

    def _move(self) -> Bools:
        """Integrate the equations of motion over one control period; return which boats collided, (n,).

        In a current V_c that is constant over the period, they hold for the velocity relative to the water,
        nu_r = nu - R(psi)^T V_c, with eta' = R(psi) nu_r + V_c (Fossen 2012).

        A boat that is free at the end of the period but touched something on the way stays at the contact.

        Raises:
            IntegrationError: the integration diverged.
        """
        period = self.vessel.vessel.control_period_s
        before, nu_r, current = self.eta, self.nu, self.current()
        tau = self.vessel.tau(self._actuate())
        if self.disturbances:
            tau = tau + self.disturbances.sum("force", 3, before.copy(), self.nu.copy())[:, None]
            nu_r = nu_r - _in_body_frame(current, before[:, 2])
        eta, nu, travel = self.vessel.step_and_travel(before, nu_r, tau, self._coefficients)
        if self.disturbances:
            eta[:, :2] += current * period
            nu += _in_body_frame(current, eta[:, 2])
            travel += np.hypot(*current.T) * period
        self._check(eta, nu)
        eta[self.resting], nu[self.resting] = before[self.resting], self.nu[self.resting]
        self.eta, self.nu = eta, nu
        farthest = rounded_up(float(travel.max()))
        collided = self.in_harbors(lambda world, rows: world.obstacles.near(eta[rows], farthest))
        collided |= self.steps == 0  # a start may be inside an obstacle; later, getting there requires `near`
        collided &= ~self.resting
        for row in np.flatnonzero(collided).tolist():
            obstacles = self.obstacles(row)
            if obstacles.blocked(eta[[row]])[0]:
                continue
            own = None if self._coefficients is None else self._coefficients[[row]]
            path = self.vessel.path(before[[row]], nu_r[[row]], tau[[row]], own)[0]
            flow = np.tile(current[row], (len(path), 1))
            path[:, :2] += flow * np.linspace(0, period, len(path))[:, None]
            path[:, 3:] += _in_body_frame(flow, path[:, 2])
            contact = first_contact(path, obstacles, self.vessel.vessel.hull)
            if contact is None:
                collided[row] = False
            else:
                eta[row], nu[row] = contact[:3], contact[3:]
        return collided

    def current(self) -> Floats:
        """Return the velocity of the water over ground (n, 2), in the world frame [m/s]."""
        return self.disturbances.sum("water_velocity", 2)

    def wind(self) -> Floats:
        """Return the velocity of the air over ground (n, 2), in the world frame [m/s]."""
        return self.disturbances.sum("air_velocity", 2)

    def measured_pose(self) -> Floats:
        """Return the poses with sensor errors, (n, 3) [m, m, rad]."""
        return self.eta + self.disturbances.sum("pose_error", 3) if self.disturbances else self.eta

    def measured_velocity(self) -> Floats:
        """Return the velocities over ground with sensor errors, (n, 3) [m/s, m/s, rad/s]."""
        return self.nu + self.disturbances.sum("velocity_error", 3) if self.disturbances else self.nu

    def _scale_coefficients(self, rows: Ints) -> None:
        """Set the coefficients of the equations of motion of the boats in `rows` (k,)."""
        if not self.disturbances.define("coefficient_factors"):
            return
        own = self.vessel.vessel
        factors = self.disturbances.coefficient_factors()
        if self._coefficients is None:
            self._coefficients = np.repeat(self.vessel.coefficients, len(self.eta), axis=0)
        for row in rows:
            scaled = {name: getattr(own, name) * float(factor[row]) for name, factor in factors.items()}
            self._coefficients[row] = coefficients(own.model_copy(update=scaled))

    def _actuate(self) -> Floats:
        """Return propeller forces and rudder angles (n, k, 2) [N, rad], in equal parts of the period."""
        commands = self.command[:, None]
        if not self.disturbances.define("actuate"):
            return commands
        vessel = self.vessel.vessel
        commands = np.repeat(commands, vessel.substeps, axis=1)
        actual = self.disturbances.actuate(commands, vessel.control_period_s / vessel.substeps)
        self.actuation = actual[:, -1].copy()
        return actual

    def _check(self, eta: Floats, nu: Floats) -> None:
        """Check that the integration to these poses and velocities, (n, 3), did not diverge.

        Raises:
            IntegrationError: a pose or velocity is not finite, or far beyond any harbor or vessel.
        """
        if np.abs(eta).max() < STATE_LIMIT and np.abs(nu).max() < STATE_LIMIT:
            return
        state = np.hstack([eta, nu])
        for row in np.flatnonzero(~(np.abs(state) < STATE_LIMIT).all(axis=1)):
            (x, y, heading, u, v, r), (force, angle) = state[row], self.command[row]
            raise IntegrationError(
                f"boat {row}, step {self.steps[row] + 1}: the integration diverged at ({x:g}, {y:g}) m,"
                f" {heading:g} rad, {u:g} m/s, {v:g} m/s, {r:g} rad/s at {force:g} N, {np.degrees(angle):g}°;"
                " use starts, conditions and commands within the vessel's capabilities, or more substeps"
            )

    def _measure(self) -> None:
        self.distance_m, self.heading_error_rad = measure(self.eta, self.goal)


def _in_body_frame(velocity: Floats, heading: Floats) -> Floats:
    """Return R(psi)^T [V_x, V_y, 0], (n, 3), of velocities (n, 2) in the world frame [m/s]."""
    x, y = velocity.T
    return np.column_stack([*rotate(x, y, -heading), np.zeros(len(velocity))])
