"""Minimum-time docking plans: dockctl's equations of motion with CasADi symbols, solved by IPOPT.

The commands of the control periods, the states between them and the length of the periods are the variables
(multiple shooting). Every plan is then executed by the simulator, in periods of the scenario's length: it
counts only if the boat docks there, without a contact.

Obstacles are the convex outlines of what lies between keel and deck, each separated from the hull by a line
at the end of every period; those that the simulator finds in the way are added until there are none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product
from typing import Any

import casadi as ca
import numpy as np
from scipy.spatial import ConvexHull

from dockctl.evaluation.rollout import Episode
from dockctl.geometry import Floats, rotate, wrap
from dockctl.scenarios.layouts import layouts
from dockctl.scenarios.loader import LoadedScenario
from dockctl.sim import integration
from dockctl.sim.conditions.wind import UniformWind, wind_force
from dockctl.sim.goal import TO_INTERMEDIATE, Limit
from dockctl.sim.harbor.build import build_harbor
from dockctl.sim.harbor.solids import hull_outline
from dockctl.sim.simulator import Simulator
from dockctl.sim.starts import Start
from dockctl.sim.vessel import VesselModel
from dockctl.sim.world import World

ca.GlobalOptions.setNumpyMode(1)  # NumPy functions accept symbols: dockctl can be called

CLEARANCE_M = 0.05
"""Between the hull and the outlines in the way, at the end of every period."""
WITHIN = 0.999
"""Fraction of the tolerances that a plan uses: they are strict, and the simulator rounds differently."""
LIMIT_S = 20.0
"""CPU time of the solver for one plan; most of those that are found take about one second."""
SMOOTH_S = 1e-4
"""Weight of the squared changes of the commands relative to time: idle commands stay constant."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Commands and states of a docking in legs: to the intermediate pose, if there is one, and to the berth.

    Attributes:
        states: (n + 1, 6) x, y [m], heading [rad], and velocity relative to the water [m/s, m/s, rad/s].
        commands: (n, 2) propeller force [N] and rudder angle [rad].
        periods: number of periods of each leg, together n.
        period_s: length of the periods of each leg [s].
    """

    states: Floats
    commands: Floats
    periods: tuple[int, ...]
    period_s: tuple[float, ...]

    @property
    def time_s(self) -> float:
        return float(np.dot(self.periods, self.period_s))

    @property
    def in_one_leg(self) -> Plan:
        """The same plan without an intermediate pose, if its periods are equal."""
        return replace(self, periods=(sum(self.periods),), period_s=self.period_s[:1])

    def resampled(self, periods: Sequence[int]) -> Plan:
        """Return the same motion in other numbers of periods."""
        ends = np.cumsum([0, *self.periods])
        at = np.concatenate(
            [np.linspace(a, b, n, endpoint=False) for (a, b), n in zip(pairwise(ends), periods, strict=True)]
        )
        rows = np.append(at, ends[-1])
        states = [np.interp(rows, np.arange(ends[-1] + 1), column) for column in self.states.T]
        length = [h * old / new for h, old, new in zip(self.period_s, self.periods, periods, strict=True)]
        return Plan(np.transpose(states), self.commands[at.astype(int)], tuple(periods), tuple(length))


@dataclass(frozen=True, eq=False)
class Docking:
    """The task of one episode.

    Attributes:
        worlds: the harbors of the scenario.
        start: at rest; its seed draws the conditions.
    """

    loaded: LoadedScenario
    worlds: Sequence[World]
    start: Start

    @cached_property
    def model(self) -> VesselModel:
        return VesselModel(self.loaded.scenario.vessel)

    @property
    def control_period_s(self) -> float:
        return self.loaded.scenario.vessel.control_period_s

    def simulator(self) -> Simulator:
        """Return the simulator of one boat at the start."""
        simulator = Simulator(self.loaded.scenario, self.worlds, 1)
        simulator.reset(np.array([0]), [replace(self.start, seed=0)])
        return simulator

    @cached_property
    def goals(self) -> list[tuple[Floats, Limit]]:
        """Pose and tolerance at the end of each leg."""
        task = self.loaded.scenario.task
        goals = [*zip(self.start.goals, (task.intermediate_tolerance, task.final_tolerance), strict=True)]
        return goals if self.start.phase == TO_INTERMEDIATE else goals[1:]

    @cached_property
    def water(self) -> Floats:
        """Velocity of the water over ground (2,) [m/s], constant."""
        return self.simulator().current()[0]

    def relative(self, eta: Any, nu: Any) -> Any:
        """Return surge, sway and yaw rate over ground relative to the water, of one pose."""
        along, across = rotate(*self.water, -eta[2])
        return nu[0] - along, nu[1] - across, nu[2]

    def footprint(self, name: str) -> Floats:
        """Return the convex outline (k, 2) of a part of the harbor between keel and deck [m]."""
        scenario = self.loaded.scenario
        layout = layouts(scenario.harbor, scenario.task.berths)[self.start.harbor]
        harbor = build_harbor(layout.harbor, self.loaded.base_dir)
        part = next(i for i, part in enumerate(harbor.parts) if part.name == name)
        triangles = harbor.triangles[harbor.part_of_triangle == part]
        low, high = triangles[:, :, 2].min(axis=1), triangles[:, :, 2].max(axis=1)
        hull = scenario.vessel.hull
        touchable = (low <= hull.freeboard_m) & (high >= -hull.draft_m)
        points = triangles[touchable][:, :, :2].reshape(-1, 2)
        return points[ConvexHull(points).vertices]


def thrust(model: VesselModel, command: Any) -> list[Any]:
    """Return `VesselModel.tau` for symbols."""
    force, rudder = ca.vertsplit(command)
    sideways = force * ca.sin(rudder)
    return [force * ca.cos(rudder), -sideways, model.vessel.propeller_arm_m * sideways]


def rate(model: VesselModel, state: Any, tau: Sequence[Any]) -> Any:
    """Return the time derivatives of a state (6,) in still water, by dockctl's own equations."""
    return ca.vertcat(*integration.rate.py_func(*ca.vertsplit(state)[2:], tau, model.coefficients[0], False))


def control_step(docking: Docking) -> ca.Function:
    """Return the state after a period, of state (6,), command (2,) and length [s], as `Simulator.step` does.

    The wind is that at the start of the period; in a current, the water carries the boat along.
    """
    model, simulator = docking.model, docking.simulator()
    state, command, length = ca.SX.sym("state", 6), ca.SX.sym("command", 2), ca.SX.sym("length")
    heading, surge, sway = (state[i] for i in (2, 3, 4))
    tau = thrust(model, command)
    for wind in (each for each in simulator.disturbances if isinstance(each, UniformWind)):
        along, across = rotate(*(wind.air_velocity()[0] - docking.water), -heading)
        force = ca.SX(wind_force(wind.wind, along - surge, across - sway))
        tau = [push + more for push, more in zip(tau, ca.horzsplit(force), strict=True)]
    after, h = state, length / model.vessel.substeps
    for _ in range(model.vessel.substeps):
        k1 = rate(model, after, tau)
        k2 = rate(model, after + h / 2 * k1, tau)
        k3 = rate(model, after + h / 2 * k2, tau)
        k4 = rate(model, after + h * k3, tau)
        after = after + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    after = after + ca.vertcat(*docking.water, 0, 0, 0, 0) * length
    return ca.Function("control_step", [state, command, length], [after])


def solve(docking: Docking, guess: Plan, obstacles: Sequence[Floats], *, held: bool = False) -> Plan | None:
    """Return the plan of minimum time near a guess, in periods of at most the scenario's; None if not found.

    Args:
        obstacles: convex outlines (k, 2) to stay clear of [m].
        held: take periods of the scenario's length, and return the smoothest commands instead.
    """
    opti, n, ends = ca.Opti(), sum(guess.periods), np.cumsum(guess.periods)
    states, commands = opti.variable(6, n + 1), opti.variable(2, n)  # commands relative to their limits
    lengths = opti.variable(len(ends))
    length = ca.vertcat(*(ca.repmat(lengths[leg], count) for leg, count in enumerate(guess.periods))).T
    limits, start = docking.model.command_limit, docking.start
    steps = control_step(docking).map(n)(states[:, :-1], ca.mtimes(ca.diag(limits), commands), length)
    at_rest = docking.relative(start.eta, start.nu)
    opti.subject_to(states[:, 0] == np.concatenate([start.eta, at_rest]))
    opti.subject_to(states[:, 1:] == steps)
    opti.subject_to(opti.bounded(-1, ca.vec(commands), 1))
    for end, (goal, limit) in zip(ends, docking.goals, strict=True):
        require_reached(opti, docking, states[:, end], goal, limit, guess.states[end, 2])
    for outline in obstacles:
        keep_clear(opti, docking, states[:, 1:], guess.states[1:], outline)
    changes = ca.sumsqr(ca.diff(commands, 1, 1))
    if held:
        opti.subject_to(lengths == docking.control_period_s)
        opti.minimize(changes)
    else:
        opti.subject_to(opti.bounded(0.05, lengths, docking.control_period_s))
        opti.minimize(ca.dot(lengths, ca.DM(guess.periods)) + SMOOTH_S * changes)
    opti.set_initial(states, guess.states.T)
    opti.set_initial(commands, (guess.commands / limits).T)
    opti.set_initial(lengths, guess.period_s)
    quiet = {"print_level": 0, "sb": "yes", "max_iter": 1000, "max_cpu_time": LIMIT_S}
    opti.solver("ipopt", {"print_time": False}, quiet)
    try:
        found = opti.solve()
    except RuntimeError:  # IPOPT did not converge
        return None
    found_lengths = np.ravel(found.value(lengths)).tolist()
    return Plan(found.value(states).T, found.value(commands).T * limits, guess.periods, tuple(found_lengths))


def require_reached(
    opti: ca.Opti, docking: Docking, state: Any, goal: Floats, limit: Limit, heading: float
) -> None:
    """Require that a state is within the tolerances; `heading` [rad] selects the turn."""
    nearest = heading - wrap(heading - goal[2])
    drift = rotate(*docking.water, -state[2])
    opti.subject_to(ca.sumsqr(state[:2] - goal[:2]) <= (WITHIN * limit.distance_m) ** 2)
    opti.subject_to(opti.bounded(-WITHIN * limit.heading, state[2] - nearest, WITHIN * limit.heading))
    opti.subject_to(ca.sumsqr(state[3:5] + ca.vertcat(*drift)) <= (WITHIN * limit.speed_mps) ** 2)


def keep_clear(opti: ca.Opti, docking: Docking, states: Any, guess: Floats, outline: Floats) -> None:
    """Require a line between the hull and a convex obstacle, with half of the clearance on either side."""
    n = len(guess)
    angle, offset = opti.variable(1, n), opti.variable(1, n)  # of the line: its normal, and where it is
    along, across = ca.cos(angle), ca.sin(angle)
    for x, y in hull_outline(docking.model.vessel.hull):
        shift_x, shift_y = rotate(x, y, states[2, :])
        opti.subject_to(
            along * (states[0, :] + shift_x) + across * (states[1, :] + shift_y) <= offset - CLEARANCE_M / 2
        )
    for x, y in outline:
        opti.subject_to(along * x + across * y >= offset + CLEARANCE_M / 2)
    toward = nearest_points(outline, guess[:, :2]) - guess[:, :2]
    normal = toward / np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-6)
    opti.set_initial(angle, np.arctan2(*normal.T[::-1])[None])
    middle = guess[:, :2] + toward / 2
    opti.set_initial(offset, (normal * middle).sum(axis=1)[None])


def nearest_points(outline: Floats, points: Floats) -> Floats:
    """Return the points (n, 2) of the boundary of an outline (k, 2) that are nearest to points (n, 2)."""
    foot, edge = outline, np.roll(outline, -1, axis=0) - outline
    share = ((points[:, None] - foot) * edge).sum(axis=2) / (edge**2).sum(axis=1)
    near = foot + np.clip(share, 0, 1)[:, :, None] * edge
    closest = np.linalg.norm(near - points[:, None], axis=2).argmin(axis=1)
    return near[np.arange(len(points)), closest]


@dataclass(frozen=True)
class Run:
    """A plan executed by the simulator.

    Attributes:
        steps: until the boat docked or touched something.
        docked: whether it docked.
        contact: name of what it touched, or None.
        off_m, off_deg: difference of the last pose from the plan.
    """

    steps: int
    docked: bool
    contact: str | None
    off_m: float
    off_deg: float


def carry_out(docking: Docking, plan: Plan) -> Run:
    """Run the commands of a plan in the simulator, each for one control period."""
    simulator, docked, contact = docking.simulator(), False, None
    for command in plan.commands:
        status = simulator.step(command[None])
        docked = bool(status.reached_final[0])
        if status.collided[0]:
            contact = docking.worlds[docking.start.harbor].obstacles.collided_part(simulator.eta[0])
        if docked or contact:
            break
    steps = int(simulator.steps[0])
    off = simulator.eta[0] - plan.states[steps, :3]
    return Run(steps, docked, contact, math.hypot(*off[:2]), math.degrees(abs(off[2])))


@dataclass(frozen=True, eq=False)
class Optimum:
    """The minimum time that was found, the plan in whole control periods, and its simulation."""

    time_s: float
    plan: Plan
    run: Run
    obstacles: tuple[str, ...]


def optimum(docking: Docking, guess: Plan) -> Optimum | None:
    """Return the fastest docking near a guess, or None if none is found that docks in the simulator."""
    outlines: dict[str, Floats] = {}
    while True:
        fastest = solve(docking, guess, [*outlines.values()])
        if fastest is None:
            return None
        held = in_whole_periods(docking, fastest, [*outlines.values()])
        if held is None:
            return None
        run = carry_out(docking, held)
        if run.docked:
            return Optimum(fastest.time_s, held, run, tuple(outlines))
        if run.contact is None or run.contact in outlines:
            return None
        outlines[run.contact] = docking.footprint(run.contact)


def in_whole_periods(docking: Docking, fastest: Plan, obstacles: Sequence[Floats]) -> Plan | None:
    """Return a plan in the fewest control periods near the fastest one, up to two more than its time has."""
    legs = [count * length for count, length in zip(fastest.periods, fastest.period_s, strict=True)]
    fewest = [math.ceil(leg / docking.control_period_s - 1e-9) for leg in legs]
    for more in sorted(product(range(3), repeat=len(legs)), key=sum):
        counts = [count + extra for count, extra in zip(fewest, more, strict=True)]
        held = solve(docking, fastest.resampled(counts), obstacles, held=True)
        if held is not None:
            return held
    return None


def straight(docking: Docking, speed_mps: float) -> Plan:
    """Return a guess: straight from pose to pose at a constant speed over ground."""
    here, legs, periods = docking.start.eta, [], []
    for goal, _ in docking.goals:
        goal = np.append(goal[:2], here[2] + wrap(goal[2] - here[2]))
        count = math.ceil(math.dist(goal[:2], here[:2]) / speed_mps / docking.control_period_s)
        poses = here + np.linspace(0, 1, count, endpoint=False)[:, None] * (goal - here)
        velocity = (goal - here) / (count * docking.control_period_s)
        legs += [(pose, velocity) for pose in poses]
        periods.append(count)
        here = goal
    legs.append((here, np.zeros(3)))
    states = [
        [*eta, *docking.relative(eta, (*rotate(*velocity[:2], -eta[2]), velocity[2]))]
        for eta, velocity in legs
    ]
    commands = np.zeros((len(legs) - 1, 2))
    return Plan(np.array(states), commands, tuple(periods), (docking.control_period_s,) * len(periods))


def followed(docking: Docking, episode: Episode) -> Plan:
    """Return a guess: the trajectory of a policy."""
    recorded = episode.trajectory
    poses = np.column_stack([recorded["pose"][:, :2], np.unwrap(recorded["pose"][:, 2])])
    states = [[*eta, *docking.relative(eta, nu)] for eta, nu in zip(poses, recorded["velocity"], strict=True)]
    first = int((recorded["phase"][1:] == TO_INTERMEDIATE).sum())
    periods = (episode.steps,) if len(docking.goals) == 1 else (first, episode.steps - first)
    return Plan(
        np.array(states), recorded["command"][1:], periods, (docking.control_period_s,) * len(periods)
    )
