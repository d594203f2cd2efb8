"""The vessel against closed forms, a reference solver, and the laws of mechanics."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.integrate import solve_ivp

from dockctl.geometry import Floats
from dockctl.scenarios.base import FieldError
from dockctl.scenarios.vessel import MAX_SPEED_MPS, Vessel
from dockctl.sim.vessel import ReferenceVesselModel, VesselModel, coriolis
from tests.sim.vessels import THESIS, vessels

EXAMPLES = int(os.environ.get("DOCKCTL_EXAMPLES", settings.default.max_examples))
OTHER = THESIS.model_copy(
    update={
        "Y_rdot_kgm": 9.0,
        "N_v_kgmps": 40.0,
        "Y_r_kgmps": -30.0,
        "mass_kg": 400.0,
        "control_period_s": 0.3,
    }
)
VESSELS = [pytest.param(THESIS, id="thesis"), pytest.param(OTHER, id="other")]

speeds = st.tuples(st.floats(-2, 2), st.floats(-1, 1), st.floats(-1, 1))
commands = st.tuples(st.floats(-50, 50), st.floats(-math.pi / 6, math.pi / 6))


def rows(*values: tuple[float, ...]) -> Floats:
    return np.array(values, float)


def simulate(
    model: VesselModel, eta: Floats, nu: Floats, command: Floats, periods: int
) -> tuple[Floats, Floats]:
    for _ in range(periods):
        eta, nu = model.step(eta, nu, command)
    return eta, nu


def test_twenty_seconds_from_rest_end_at_the_known_pose_and_velocity() -> None:
    eta, nu = simulate(VesselModel(THESIS), np.zeros((1, 3)), np.zeros((1, 3)), rows((50, math.pi / 6)), 40)
    assert eta[0] == pytest.approx([6.5939, 1.3046, 0.8453], abs=5e-5)
    assert nu[0] == pytest.approx([0.3587, -0.0884, 0.0428], abs=5e-5)


def test_terminal_surge_is_the_root_of_the_drag_balance() -> None:
    _, nu = simulate(VesselModel(THESIS), np.zeros((1, 3)), np.zeros((1, 3)), rows((50, 0)), 200)
    root = (-94.2 + math.sqrt(94.2**2 + 4 * 66 * 50)) / (2 * 66)
    assert root == pytest.approx(0.4119, abs=5e-5)
    assert nu[0] == pytest.approx([root, 0, 0], abs=1e-9)


def test_forces_of_a_turned_propeller() -> None:
    tau = VesselModel(THESIS).tau(rows((40, math.radians(30)), (-40, math.radians(30)), (40, 0)))
    assert tau[0] == pytest.approx([40 * math.sqrt(0.75), -20, 30])
    assert tau[1] == pytest.approx(-tau[0])
    assert tau[2] == pytest.approx([40, 0, 0])


def test_acceleration_by_hand() -> None:
    """u' of eq. 2.5 with u = 0.3, v = 0.1, r = 0.2, written out."""
    nu_dot = VesselModel(THESIS).nu_dot(rows((0.3, 0.1, 0.2)), rows((10, 0, 0)))
    surge = 10 + 150 * 0.2 * 0.1 + 120.6 * 0.1 * 0.2 - (94.2 + 66 * 0.3) * 0.3
    sway = -150 * 0.2 * 0.3 - 18.3 * 0.3 * 0.2 - (395.8 + 395.8 * 0.1) * 0.1 - 245.1 * 0.2
    yaw = (-120.6 + 18.3) * 0.3 * 0.1 - (942.5 + 245.1 * 0.2) * 0.2
    assert nu_dot[0] == pytest.approx([surge / 168.3, sway / 270.6, yaw / 100.0])


@pytest.mark.parametrize("vessel", VESSELS)
@given(nu=speeds)
def test_coriolis_forces_do_no_work(vessel: Vessel, nu: tuple[float, ...]) -> None:
    matrix = coriolis(vessel, rows(nu))[0]
    assert np.array_equal(matrix, -matrix.T)
    assert abs(np.array(nu) @ matrix @ np.array(nu)) < 1e-11


def pumped(model: VesselModel, seed: int, periods: int, boats: int = 8) -> Iterator[tuple[Floats, Floats]]:
    """Yield poses and velocities (n, 3) of boats, from rest, under the commands that add most energy.

    Half of the boats have random commands instead, held for one to twenty periods.
    """
    rng = np.random.default_rng(seed)
    force, angle = model.command_limit
    extremes = np.array([(p, phi) for p in (-force, force) for phi in (-angle, 0.0, angle)])
    hold = rng.integers(1, 21, boats)
    eta, nu = np.zeros((boats, 3)), np.zeros((boats, 3))
    held = np.zeros(boats, int)
    for period in range(periods):
        held = np.where(period % hold == 0, rng.integers(len(extremes), size=boats), held)
        strongest = (nu @ model.tau(extremes).T).argmax(axis=1)
        chosen = np.where((np.arange(boats) % 2 == 0) & nu.any(axis=1), strongest, held)
        eta, nu = model.step(eta, nu, extremes[chosen])
        yield eta, nu


def energy(vessel: Vessel, nu: Floats) -> Floats:
    """Kinetic energy (n,) with added mass [J]."""
    return np.asarray(np.einsum("ni,ij,nj->n", nu, vessel.inertia, nu) / 2)


@settings(max_examples=EXAMPLES)
@given(vessel=vessels(), seed=st.integers(0, 1000))
def test_every_accepted_vessel_stays_bounded_under_any_commands(vessel: Vessel, seed: int) -> None:
    """From rest, sqrt(2 E) grows at most at the rate of the thrust in the energy norm; damping bounds it."""
    model = VesselModel(vessel)
    thrust = model.tau(np.array([(model.command_limit[0], phi) for phi in (0.0, model.command_limit[1])]))
    growth = math.sqrt(max(np.einsum("ni,ij,nj->n", thrust, np.linalg.inv(vessel.inertia), thrust)))
    for period, (eta, nu) in enumerate(pumped(model, seed, 120), start=1):
        assert np.isfinite(eta).all()
        assert np.sqrt(2 * energy(vessel, nu)).max() <= growth * period * vessel.control_period_s * (1 + 1e-9)
        assert np.hypot(nu[:, 0], nu[:, 1]).max() < 2 * MAX_SPEED_MPS


@settings(max_examples=EXAMPLES)
@given(vessel=vessels(), seed=st.integers(0, 1000))
def test_without_thrust_the_kinetic_energy_never_grows(vessel: Vessel, seed: int) -> None:
    """Any accepted vessel, from velocities that it can reach."""
    model = VesselModel(vessel)
    *_, (eta, nu) = pumped(model, seed, 20)
    for _ in range(10):
        before = energy(vessel, nu)
        eta, nu = model.step(eta, nu, np.zeros((len(nu), 2)))
        assert (energy(vessel, nu) <= before).all()


@settings(max_examples=EXAMPLES)
@given(vessel=vessels(), seed=st.integers(0, 1000))
def test_mirrored_commands_give_the_mirrored_trajectory(vessel: Vessel, seed: int) -> None:
    model, mirror = VesselModel(vessel), np.array([1.0, -1.0, -1.0])
    *_, (eta, nu) = pumped(model, seed, 10)
    command = np.tile(model.command_limit * [1.0, 0.7], (len(eta), 1))
    ahead, mirrored = (
        simulate(model, eta * sign, nu * sign, command * sign[:2], 4) for sign in (np.ones(3), mirror)
    )
    for plain, other in zip(ahead, mirrored, strict=True):
        assert other == pytest.approx(plain * mirror, rel=1e-9, abs=1e-9)


@settings(max_examples=EXAMPLES)
@given(vessel=vessels(), seed=st.integers(0, 1000), turn=st.floats(-4, 4), shift=st.floats(-50, 50))
def test_the_motion_does_not_depend_on_position_and_direction(
    vessel: Vessel, seed: int, turn: float, shift: float
) -> None:
    model = VesselModel(vessel)
    *_, (eta, nu) = pumped(model, seed, 10)
    command = np.tile(model.command_limit, (len(eta), 1))
    c, s = math.cos(turn), math.sin(turn)

    def moved(poses: Floats) -> Floats:
        x, y, heading = poses.T
        return np.column_stack([c * x - s * y + shift, s * x + c * y - shift, heading + turn])

    after, velocity = simulate(model, eta, nu, command, 4)
    shifted, same_velocity = simulate(model, moved(eta), nu, command, 4)
    assert shifted == pytest.approx(moved(after), rel=1e-9, abs=1e-9)
    assert same_velocity == pytest.approx(velocity, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("vessel", VESSELS)
@given(nu=speeds, command=commands, heading=st.floats(-7, 7))
def test_the_fast_kernel_equals_the_matrices(
    vessel: Vessel, nu: tuple[float, ...], command: tuple[float, float], heading: float
) -> None:
    eta = rows((20, -3, heading))
    fast, plain = (
        model(vessel).step(eta, rows(nu), rows(command)) for model in (VesselModel, ReferenceVesselModel)
    )
    assert fast[0] == pytest.approx(plain[0], abs=1e-12)
    assert fast[1] == pytest.approx(plain[1], abs=1e-12)


@pytest.mark.parametrize("own", [False, True], ids=["one vessel", "own coefficients"])
@pytest.mark.parametrize("parts", [1, 5])
def test_the_fast_kernel_equals_the_matrices_for_forces_and_coefficients_of_each_boat(
    parts: int, own: bool
) -> None:
    rng = np.random.default_rng(0)
    eta, nu = rng.normal(size=(4, 3)), rng.uniform(-0.4, 0.4, (4, 3))
    tau, fast, plain = rng.uniform(-50, 50, (4, parts, 3)), VesselModel(THESIS), ReferenceVesselModel(THESIS)
    scaled = fast.coefficients * rng.uniform(0.8, 1.2, (4, 17)) if own else None
    for one, other in zip(
        [*fast.step_and_travel(eta, nu, tau, scaled), fast.path(eta, nu, tau, scaled)],
        [*plain.step_and_travel(eta, nu, tau, scaled), plain.path(eta, nu, tau, scaled)],
        strict=True,
    ):
        assert one == pytest.approx(other, abs=1e-12)


@pytest.mark.parametrize(("substeps", "tolerance"), [(5, 2e-4), (50, 2e-8), (250, 2e-10)])
def test_converges_to_a_reference_solver(substeps: int, tolerance: float) -> None:
    """Fourth order: the error of a tenth of the step is a ten-thousandth, down to 1e-10 of the solver."""
    model = VesselModel(THESIS.model_copy(update={"substeps": substeps}))
    command, start = rows((50, math.pi / 6)), np.array([0, 0, 0.4, 0.35, 0.05, 0.1])

    def rate(_: float, state: Floats) -> Floats:
        eta, nu = state[None, :3], state[None, 3:]
        return np.concatenate([model.eta_dot(eta, nu)[0], model.nu_dot(nu, model.tau(command))[0]])

    truth = solve_ivp(rate, (0, 3), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    eta, nu = simulate(model, start[None, :3], start[None, 3:], command, 6)
    assert np.concatenate([eta[0], nu[0]]) == pytest.approx(truth, abs=tolerance)


def test_one_step_for_the_whole_control_period_would_diverge() -> None:
    """With the yaw pole at -9.43 1/s, RK4 is stable for steps of up to 0.295 s: 0.25 s, but not 0.5 s."""
    spinning = rows((0, 0, 0.01))
    for substeps, stable in ((1, False), (2, True)):
        model = VesselModel(THESIS.model_copy(update={"substeps": substeps}))
        _, nu = simulate(model, np.zeros((1, 3)), spinning, np.zeros((1, 2)), 3)
        assert (abs(nu[0, 2]) < 0.01) == stable


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"yaw_inertia_kgm2": 5.0, "N_rdot_kgm2": 0.0, "Y_rdot_kgm": 0.0},
        {"X_u_kgps": 2000.0},
        {"X_uu_kgpm": 1.0e5},
        {"Y_vv_kgpm": 1.0e6},
        {"N_rr_kgm2": 1.0e6},
        {"control_period_s": 3.0},
    ],
)
def test_the_minimum_number_of_substeps_is_stable(change: dict[str, float]) -> None:
    """At full power the terminal velocity is that of many substeps."""
    given = {**THESIS.model_dump(), **change}

    def refusal(substeps: int) -> FieldError:
        with pytest.raises(ValidationError) as caught:
            Vessel.model_validate({**given, "substeps": substeps})
        error: FieldError = caught.value.errors()[0]["ctx"]["error"]
        assert (error.field, error.code) == ("substeps", "out_of_range")
        return error

    fewest = int(refusal(1).suggestion)
    coarse = Vessel.model_validate({**given, "substeps": fewest})
    fine = coarse.model_copy(update={"substeps": 10 * fewest})
    assert int(refusal(fewest - 1).suggestion) == fewest
    command = rows((50, 0), (-50, 0), (50, math.radians(coarse.max_rudder_deg)))
    ends = [
        simulate(VesselModel(v), np.zeros((3, 3)), np.zeros((3, 3)), command, 200)[1] for v in (coarse, fine)
    ]
    assert ends[0] == pytest.approx(ends[1], rel=1e-3, abs=1e-9)


def test_a_row_does_not_depend_on_the_others_and_inputs_are_unchanged() -> None:
    rng = np.random.default_rng(0)
    model = VesselModel(THESIS)
    eta, nu = rng.normal(size=(9, 3)), rng.normal(size=(9, 3)) * 0.2
    command = rng.uniform([-50, -0.5], [50, 0.5], (9, 2))
    before = eta.copy(), nu.copy(), command.copy()
    together = model.step(eta, nu, command)
    for row in range(9):
        alone = model.step(eta[[row]], nu[[row]], command[[row]])
        assert np.array_equal(alone[0][0], together[0][row])
        assert np.array_equal(alone[1][0], together[1][row])
    assert all(np.array_equal(old, new) for old, new in zip(before, (eta, nu, command), strict=True))
