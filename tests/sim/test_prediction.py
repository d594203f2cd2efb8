"""The compiled prediction against the actuators and the reference equations of motion, step by step."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dockctl.geometry import rotate
from dockctl.sim.actuation import respond
from dockctl.sim.integration import cos_sin, propeller
from dockctl.sim.prediction import predict
from dockctl.sim.vessel import ReferenceVesselModel, VesselModel
from tests.sim.vessels import THESIS

VESSEL = THESIS.model_copy(update={"control_period_s": 1.0, "substeps": 10})
CURRENT = np.array([0.08, -0.05])
FORCE = np.random.default_rng(2).uniform(-3, 3, (6, 3))  # of each step
RESPONSE = np.array([12.0, -0.1, 0.4, math.radians(20), 0.8])
"""Thrust [N] and rudder angle [rad] at the start, propeller lag [s], rudder rate [rad/s], astern factor."""


def test_the_propeller_has_the_same_forces_in_both_implementations() -> None:
    commands = np.random.default_rng(0).uniform([-50, -0.6], [50, 0.6], (20, 2))
    found = [propeller(force, rudder, VESSEL.propeller_arm_m) for force, rudder in commands]
    np.testing.assert_allclose(found, VesselModel(VESSEL).tau(commands), rtol=1e-15, atol=1e-15)


def test_cosine_and_sine_without_a_call_are_accurate() -> None:
    """Against NumPy in extended precision, also at the ends of the quarters."""
    rng, exact = np.random.default_rng(0), np.arange(-2000, 2001) * (np.pi / 4)
    near = [exact, np.nextafter(exact, -np.inf), np.nextafter(exact, np.inf)]
    angles = np.concatenate([*near, rng.uniform(-7, 7, 10_000), rng.uniform(-1e5, 1e5, 10_000)])
    found = np.array([cos_sin(angle) for angle in angles])
    long = angles.astype(np.longdouble)
    expected = np.column_stack([np.cos(long), np.sin(long)])
    assert np.abs(found - expected).max() < 2.1e-16


def test_predictions_follow_the_reference_model() -> None:
    """In the frame of the water the current is absent; it carries the boat along with it."""
    rng, model, part_s = np.random.default_rng(1), ReferenceVesselModel(VESSEL), 0.1
    state = np.array([1.0, -2.0, 0.7, 0.3, -0.1, 0.05])
    wanted = rng.uniform([-50, -0.6], [50, 0.6], (3, 6, 2))
    own = tuple(model.coefficients[0])
    poses, velocities = predict(state, wanted, RESPONSE, CURRENT, FORCE, own, VESSEL.propeller_arm_m, 1.0, 10)
    eta, nu = np.tile(state[:3], (3, 1)), np.tile(state[3:], (3, 1))
    thrust, angle, lag, rate, astern = np.tile(RESPONSE[:, None], 3)
    for step in range(6):
        actual = np.empty((3, 10, 2))
        held = np.repeat(wanted[:, step, None], 10, axis=1)
        respond(held, thrust, angle, lag, rate, astern, part_s, actual)
        surge, sway = rotate(*FORCE[step, :2], -eta[:, 2])
        wind = np.column_stack([surge, sway, np.full(3, FORCE[step, 2])])
        path = model.path(eta, nu, model.tau(actual) + wind[:, None])
        for half, row in ((1, 5), (2, 10)):
            drift = np.append(CURRENT * (step + half / 2), 0)
            assert poses[:, 2 * step + half - 1] == pytest.approx(path[:, row, :3] + drift, abs=1e-9)
        eta, nu = path[:, -1, :3].copy(), path[:, -1, 3:].copy()
        over_ground = nu[:, :2] + np.column_stack(rotate(CURRENT[0], CURRENT[1], -eta[:, 2]))
        assert velocities[:, step] == pytest.approx(over_ground, abs=1e-9)
