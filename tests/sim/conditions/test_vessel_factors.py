"""Uncertain coefficients and shallow water: the motion is that of a vessel with these coefficients."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dockctl.errors import InputError
from dockctl.scenarios.loader import load, load_vessel
from dockctl.scenarios.vessel import SCALABLE, Vessel
from dockctl.sim.checks import load_checked
from dockctl.sim.conditions.shallow_water import ShallowWater, depth_factors
from dockctl.sim.conditions.uncertainty import DAMPING, MASSES
from dockctl.sim.simulator import Simulator
from dockctl.sim.vessel import NONZERO, Coefficients, ReferenceVesselModel
from tests.sim.conditions.conditions import simulator

VESSEL = load_vessel("eilbrecht")


def factors_of(sim: Simulator, row: int) -> dict[str, float]:
    (condition,) = sim.disturbances
    return {name: float(factor[row]) for name, factor in condition.coefficient_factors().items()}


@pytest.mark.parametrize(
    "text", ["uncertainty: {masses: 0.2, damping: 0.3}", "shallow_water: {depth_m: [0.4, 3]}"]
)
def test_each_boat_moves_as_a_vessel_with_its_coefficients(text: str) -> None:
    sim = simulator(text, boats=4)
    eta, nu = sim.eta.copy(), sim.nu.copy()
    for command in np.random.default_rng(0).uniform(-1, 1, (30, 4, 2)) * [50, 0.5]:
        sim.step(command)
        for row in range(4):
            scaled = {name: getattr(VESSEL, name) * factor for name, factor in factors_of(sim, row).items()}
            model = ReferenceVesselModel(Vessel.model_validate({**dict(VESSEL), **scaled}))
            own = model.step(eta[[row]], nu[[row]], command[[row]])
            eta[row], nu[row] = own[0][0], own[1][0]
    np.testing.assert_allclose(np.hstack([sim.eta, sim.nu]), np.hstack([eta, nu]), atol=1e-9)
    assert len(np.unique(sim.eta, axis=0)) == 4


def test_factors_are_uniform_in_their_range_and_drawn_per_episode() -> None:
    sim = simulator("uncertainty: {masses: 0.2, damping: 0.1}", boats=500)
    drawn = sim.disturbances.episode()
    for names, width in ((MASSES, 0.2), (DAMPING, 0.1)):
        values = np.array([drawn[f"uncertainty_{name}_factor"] for name in names])
        assert (np.abs(values - 1) <= width).all()
        assert values.std() == pytest.approx(width / np.sqrt(3), rel=0.1)
        assert np.abs(np.corrcoef(values) - np.eye(len(names))).max() < 0.25


def test_deep_water_changes_nothing_and_shallower_water_more() -> None:
    water = ShallowWater(depth_m=(1.0,)).fitted(VESSEL)
    assert isinstance(water, ShallowWater)
    deep = depth_factors(water, np.array([3000.0]))
    assert all(factor[0] == pytest.approx(1, abs=2e-3) for factor in deep.values())
    depths = np.array([0.36, 0.45, 0.6, 0.9, 1.5, 3.0])
    for factor in depth_factors(water, depths).values():
        assert (np.diff(factor) < 0).all()
        assert (factor > 0.99).all()


def test_factors_by_hand() -> None:
    """L 3, B 1, T 0.3 m, C_b 150 / 900 = 1/6; at h = 2 T: gap 1, b = 0.98765."""
    water = ShallowWater(depth_m=(0.6,)).fitted(VESSEL)
    assert isinstance(water, ShallowWater)
    assert water.block_coefficient == pytest.approx(1 / 6)
    factors = {name: factor[0] for name, factor in depth_factors(water, np.array([0.6])).items()}
    k0, k1, k2, b = 1.066568, -0.0031233, 0.0342, 0.987654
    assert factors["Y_vdot_kg"] == pytest.approx(k0 + 2 / 3 * k1 * b + 8 / 15 * k2 * b * b, rel=1e-6)
    assert factors["N_rdot_kgm2"] == pytest.approx(k0 + 8 / 15 * k1 * b + 8 / 21 * k2 * b * b, rel=1e-6)
    assert factors["Y_v_kgps"] == pytest.approx(1.5 * (k0 + k1 * b / 2 + k2 * b * b / 3) - 0.5, rel=1e-6)
    assert factors["N_r_kgm2ps"] == factors["N_rdot_kgm2"]


def test_factors_are_continuous_in_the_beam() -> None:
    """K2 has another formula above B/T = 4."""
    narrow, wide = (
        depth_factors(
            ShallowWater(depth_m=(0.6,), length_m=3, beam_m=beam_m, draft_m=0.3, block_coefficient=1 / 6),
            np.array([0.6]),
        )
        for beam_m in (1.2, 1.2001)
    )
    for name, factor in narrow.items():
        assert wide[name] == pytest.approx(factor, rel=1e-3)


def test_the_conditions_that_scale_coefficients_are_valid_alone() -> None:
    """Together they are not: their factors multiply, see below."""
    for text in ("uncertainty={masses: 0.2, damping: 0.5}", "shallow_water={depth_m: 0.4}"):
        load("s1", overrides=[f"conditions.{text}"])


def test_factors_of_conditions_of_training_multiply_with_the_others(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(
        "extends: s1\nconditions: {uncertainty: {masses: 0.2, damping: 0.5}}\n"
        "training:\n  conditions: {shallow_water: {depth_m: 0.4}}\n"
    )
    with pytest.raises(InputError) as caught:
        load(file)
    (problem,) = caught.value.problems
    assert (problem.line, problem.field) == (4, "training.conditions")


def test_all_coefficients_of_the_equations_of_motion_may_be_scaled() -> None:
    """The others act through the inertia matrix."""
    inertia = {"yaw_inertia_kgm2", "N_rdot_kgm2"}
    assert {*SCALABLE} == {*Coefficients._fields[len(NONZERO) :], *inertia}


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("shallow_water: {depth_m: 0.3}", "conditions.shallow_water.depth_m"),
        ("uncertainty: {damping: 0.95}", "conditions.uncertainty.damping"),
        ("uncertainty: {masses: 0.9, damping: 0.9}", "conditions.uncertainty.damping"),
        ("a: {kind: uncertainty, masses: 0.5}, b: {kind: uncertainty, damping: 0.75}", "conditions"),
        ("uncertainty: {masses: 0.2, damping: 0.5}, shallow_water: {depth_m: 0.4}", "conditions"),
        ("actuators: {delay_steps: 0.5}", "conditions.actuators.delay_steps.0"),
        ("wind: {speed_mps: 3}", "conditions.wind.direction_deg"),
        ("current: {speed_mps: 0, direction_deg: 0, variation_mps: 5}", "conditions.current.variation_mps"),
        ("tide: {kind: 5}", "conditions.tide.kind"),
        ("a.b: {kind: lidar_noise}", "conditions"),
    ],
)
def test_a_problem_has_its_place(tmp_path: Path, text: str, field: str) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(f"extends: s1\nconditions: {{{text}}}\n")
    with pytest.raises(InputError) as caught:
        load(file)
    (problem,) = caught.value.problems
    assert (problem.line, problem.field.removesuffix(".0")) == (2, field.removesuffix(".0"))


def test_the_number_of_substeps_that_is_expected_is_the_smallest(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("extends: s1\nconditions: {uncertainty: {masses: 0.9}}\n")
    with pytest.raises(InputError) as caught:
        load(file)
    needed = int(str(caught.value).split("expected at least ")[1])
    load(file, overrides=[f"vessel.substeps={needed}"])
    with pytest.raises(InputError):
        load(file, overrides=[f"vessel.substeps={needed - 1}"])


@pytest.mark.parametrize(("section", "line"), [("conditions", 2), ("training.conditions", 3)])
def test_one_condition_adds_noise_to_the_range_sensor(tmp_path: Path, section: str, line: int) -> None:
    file, other = tmp_path / "mine.yaml", "n: {kind: lidar_noise}"
    own, trained = (f", {other}", "") if section == "conditions" else ("", other)
    file.write_text(
        f"extends: s1\nconditions: {{lidar_noise: {{}}{own}}}\ntraining: {{conditions: {{{trained}}}}}\n"
    )
    with pytest.raises(InputError) as caught:
        load_checked(file)
    (problem,) = caught.value.problems
    assert (problem.line, problem.field) == (line, f"{section}.n")
    assert "'lidar_noise'" in problem.message
