"""Prediction of the motion of a boat in wind and current, with what is estimated from its sensors."""

from __future__ import annotations

from contextlib import suppress
from itertools import product

import numpy as np
from pydantic import ValidationError

from dockctl.geometry import Floats, Ints, rotate, wrap
from dockctl.scenarios.schema import Scenario
from dockctl.scenarios.vessel import Vessel
from dockctl.sim.conditions.actuators import Actuators, RealActuators
from dockctl.sim.conditions.wind import Wind
from dockctl.sim.simulator import Simulator
from dockctl.sim.vessel import VesselModel

AVERAGED_S = 20.0
"""Time constant with which current and wind are averaged; the first values are plain means."""
OTHER_GUSTS_S = 2.0
"""Time constant of the gusts of forces other than `Wind`, that of gusts in VRX."""
CORRECTED = 0.35
"""Share of the difference between a measured and a predicted pose by which the prediction is corrected."""
LAGS = 3
"""Propeller lags that are compared, over their range."""
USUAL_ERROR = np.array([0.01, 0.01, 0.01])
"""Standard deviation of errors of a prediction of surge, sway [m/s] and yaw rate [rad/s] one step ahead."""
ASTERN_SPREAD = 0.1
"""Standard deviation of the astern factor around the middle of its range, before anything is measured."""


class Forecast:
    """Estimates what acts on n boats and how their actuators respond, and predicts their poses with it.

    The current is the difference of the velocities over ground and through the water, averaged. The force of
    the wind is that at the measured wind for one control step, and then returns to its average with the time
    constant of the scenario's gusts; forces of a plugin's conditions count as wind, known exactly. Each pose
    is the one predicted from the pose before and the measured velocities, corrected towards the measured one.
    The speed log measures without error.

    The ranges of delay, lag and rudder rate are those of the scenario's actuators: each delay with each of
    some lags predicts every step, and the pair with the smallest squared error so far in the episode is used.
    Each pair has its own astern factor, the least-squares estimate, to which the middle of its range is added
    like a measurement. Masses and damping are the vessel's own.

    Args:
        simulator: of the n boats; its sensors measure.
        scenario: of the simulator.
    """

    def __init__(self, simulator: Simulator, scenario: Scenario) -> None:
        vessel, boats = scenario.vessel, len(simulator.eta)
        self._simulator, self._period_s = simulator, vessel.control_period_s
        self._vessel = VesselModel(_with_fewest_substeps(vessel))
        kinds = (each for each in scenario.conditions.values() if isinstance(each, Actuators))
        self._range = next(kinds, Actuators())
        gusts = (each.gust_time_s for each in scenario.conditions.values() if isinstance(each, Wind))
        self._gust_s = next(gusts, OTHER_GUSTS_S)
        delays = range(self._range.delay_steps[0], self._range.delay_steps[-1] + 1)
        lags = np.unique(np.linspace(self._range.propeller_lag_s[0], self._range.propeller_lag_s[-1], LAGS))
        self._pairs = np.array([*product(delays, lags)])  # delay [steps], lag [s]
        self._usual_astern = np.mean([self._range.astern_factor[0], self._range.astern_factor[-1]])
        # For each pair without and with thrust astern, between which predictions are interpolated.
        self._shape = 2, len(self._pairs), boats
        self._actuators = self._built(np.tile(self._pairs.repeat(boats, axis=0), (2, 1)))
        self._actuators.astern[: boats * len(self._pairs)] = 0.0
        # World frame.
        self._current, self._wind, self._mean_wind = np.zeros((boats, 2)), *np.zeros((2, boats, 3))
        self._averaged = np.zeros(boats, np.int64)
        self._state = np.full((boats, 6), np.nan)  # pose, velocity through the water
        self._tau: Floats | None = None
        # Sums: squared error without thrust astern, this error times the effect of thrust astern, its square.
        self._sums = np.zeros((3, len(self._pairs), boats))

    def reset(self, rows: Ints) -> None:
        """Forget the episodes of the boats `rows` (k,)."""
        self._averaged[rows], self._state[rows], self._sums[:, :, rows] = 0, np.nan, 0.0
        actuators = self._actuators
        for values in (actuators.thrust, actuators.angle):
            values.reshape(self._shape)[:, :, rows] = 0.0
        actuators.past.reshape(*self._shape, *actuators.past.shape[1:])[:, :, rows] = 0.0

    def measure(self, eta: Floats, nu: Floats) -> None:
        """Update the estimates with measured poses and velocities over ground (n, 3)."""
        simulator = self._simulator
        own, heading = simulator.nu.copy(), simulator.eta[:, 2]
        through_water = own[:, :2] - _turned(simulator.current(), -heading)
        force = simulator.disturbances.sum("force", 3, simulator.eta.copy(), own)
        measured = np.column_stack([through_water, nu[:, 2]])
        self._compare(measured)
        share = np.maximum(1 / (self._averaged + 1), self._period_s / AVERAGED_S)[:, None]
        self._current += share * (_turned(nu[:, :2] - through_water, eta[:, 2]) - self._current)
        self._wind = _turned(force, heading)
        self._mean_wind += share * (self._wind - self._mean_wind)
        self._averaged += 1
        self._state = np.hstack([self._corrected(eta, measured), measured])

    def command(self, commands: Floats) -> None:
        """Record the commands (n, 2) [N, rad] of the next control step."""
        substeps = self._vessel.vessel.substeps
        held = np.tile(commands[:, None], (2 * len(self._pairs), substeps, 1))
        actual = self._actuators.actuate(held, self._period_s / substeps)
        self._tau = self._vessel.tau(actual).reshape(*self._shape, -1, 3)

    def poses(self, row: int, commands: Floats) -> tuple[Floats, Floats]:
        """Predict from the latest measurement where a boat will be, and how fast.

        Args:
            commands: (m, k, 2) of the next k control steps [N, rad].

        Returns:
            Poses (m, 2 k, 3) after every half of a control step, and velocities over ground (m, k, 2) [m/s]
            in the body frame after every one.
        """
        from dockctl.sim.prediction import predict  # compiles on import

        vessel, actuators, (best, astern) = self._vessel.vessel, self._actuators, self._best()
        pair = int(best[row])
        index = np.ravel_multi_index((1, pair, row), self._shape)
        state = [each[index] for each in (actuators.thrust, actuators.angle, actuators.lag, actuators.rate)]
        delayed = actuators.past[index, : int(self._pairs[pair, 0]), 0][::-1]
        wanted = np.concatenate([np.tile(delayed, (len(commands), 1, 1)), commands], axis=1)
        gust = np.exp(-self._period_s / self._gust_s * np.arange(commands.shape[1]))[:, None]
        predicted: tuple[Floats, Floats] = predict(
            self._state[row],
            wanted[:, : commands.shape[1]],
            np.array([*state, astern[row]]),
            self._current[row],
            self._mean_wind[row] + gust * (self._wind - self._mean_wind)[row],
            tuple(self._vessel.coefficients[0]),
            vessel.propeller_arm_m,
            self._period_s,
            vessel.substeps,
        )
        return predicted

    def actuators(self) -> tuple[Ints, Floats, Floats]:
        """Return the estimated delay [steps], propeller lag [s] and astern factor of each boat, (n,) each."""
        best, astern = self._best()
        delay, lag = self._pairs[best].T
        return delay.astype(np.int64), lag, astern

    def _best(self) -> tuple[Ints, Floats]:
        """Return the pair with the smallest error, (n,), and its astern factor."""
        squared_error, error_by_effect, squared_effect = self._sums
        certainty, usual = ASTERN_SPREAD**-2, self._usual_astern
        astern = (error_by_effect + certainty * usual) / (squared_effect + certainty)
        cost = squared_error - 2 * astern * error_by_effect + astern**2 * squared_effect
        cost += certainty * (astern - usual) ** 2
        best = cost.argmin(axis=0)
        return best, astern[best, np.arange(len(best))]

    def _corrected(self, eta: Floats, measured: Floats) -> Floats:
        """Return measured poses (n, 3) with less noise, from the velocities through the water (n, 3)."""
        before = self._state
        velocity = (before[:, 3:] + measured) / 2
        half_turned = before[:, 2] + velocity[:, 2] * self._period_s / 2
        predicted = before[:, :3] + self._period_s * _turned(velocity, half_turned)
        predicted[:, :2] += self._period_s * self._current
        x, y, heading = (eta - predicted).T
        error = np.column_stack([x, y, wrap(heading)])
        return np.where(np.isnan(before[:, :3]), eta, predicted + CORRECTED * error)

    def _compare(self, measured: Floats) -> None:
        """Compare velocities through the water (n, 3) with those predicted from the measurement before."""
        known = np.flatnonzero(~np.isnan(self._state[:, 0]))
        if self._tau is None or len(known) == 0:
            return
        tau = self._tau[:, :, known]
        copies = tau.shape[0] * tau.shape[1]
        state, force = (np.tile(each[known], (copies, 1)) for each in (self._state, self._wind))
        path = self._path(state, tau.reshape(-1, *tau.shape[3:]), force)
        without, full = path[:, -1, 3:].reshape(2, -1, len(known), 3) / USUAL_ERROR
        error, effect = measured[known] / USUAL_ERROR - without, full - without
        self._sums[:, :, known] += np.stack([error**2, error * effect, effect**2]).sum(axis=-1)

    def _path(self, state: Floats, tau: Floats, force: Floats) -> Floats:
        """Return poses and velocities relative to the water over a control step, (m, substeps + 1, 6).

        As in the simulator, the force of the wind is constant in the body frame.
        """
        eta, nu = state[:, :3].copy(), state[:, 3:].copy()
        return self._vessel.path(eta, nu, tau + _turned(force, -eta[:, 2])[:, None])

    def _built(self, pairs: Floats) -> RealActuators:
        """Return actuators at rest with these delays and lags, (m, 2), and the mean rudder rate."""
        built = RealActuators(self._range, len(pairs))
        built.delay, built.lag = pairs[:, 0].astype(np.int64), pairs[:, 1].copy()
        if (rate := self._range.rudder_rate_degps) is not None:
            built.rate[:] = np.radians(np.mean([rate[0], rate[-1]]))
        return built


def _with_fewest_substeps(vessel: Vessel) -> Vessel:
    """Return the vessel with the smallest even, stable number of substeps, for poses at half-periods."""
    for substeps in range(2, 2 * vessel.substeps, 2):
        with suppress(ValidationError):
            return Vessel.model_validate({**dict(vessel), "substeps": substeps})
    return vessel.model_copy(update={"substeps": 2 * vessel.substeps})


def _turned(vectors: Floats, angle: Floats) -> Floats:
    """Return vectors (n, 2 or more), whose first two components are horizontal, rotated by angles (n,)."""
    return np.column_stack([*rotate(vectors[:, 0], vectors[:, 1], angle), vectors[:, 2:]])
