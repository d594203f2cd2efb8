"""The wind: forces by hand, gusts by their moments, the motion against an ODE solver, notes, and tables."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dockctl.envs.vector import DockingVectorEnv
from dockctl.evaluation.rollout import Rollout, trajectories_csv
from dockctl.geometry import Floats
from dockctl.scenarios.loader import dump, load, load_vessel
from dockctl.sim.checks import notes
from dockctl.sim.conditions.authority import ControlAuthority
from dockctl.sim.conditions.wind import UniformWind, Wind, wind_force
from dockctl.sim.disturbances import Disturbances
from dockctl.sim.simulator import Simulator
from dockctl.sim.starts import given_start, own_site
from dockctl.sim.vessel import VesselModel
from tests.sim.conditions.conditions import scenario, simulator

VESSEL = load_vessel("eilbrecht")
WIND = Wind(speed_mps=(0.0,), direction_deg=(0.0,)).fitted(VESSEL)


def force(along: float, across: float, wind: Wind = WIND) -> list[float]:
    (row,) = wind_force(wind, np.array([along]), np.array([across]))
    return [float(value) for value in row]


def test_forces_by_hand() -> None:
    """A_L 1.5 m2, A_F 0.5 m2, 10 m/s: the dynamic pressure is 61.2 Pa."""
    assert force(-10, 0) == pytest.approx([-61.2 * 0.5 * 0.55, 0, 0])  # ahead: 16.83 N astern
    assert force(10, 0) == pytest.approx([61.2 * 0.5 * 0.60, 0, 0])  # astern: 18.36 N ahead
    assert force(0, 10) == pytest.approx([0, 61.2 * 1.5 * 0.9, 0], abs=1e-12)  # 82.62 N to port
    # 45 degrees on the bow from starboard: C_l = 0.55 / 3, D = 1 - 0.3 (1 - 0.55 / 2.7) = 0.7611111
    half = 10 / math.sqrt(2)
    sway = 82.62 / math.sqrt(2) / 0.7611111
    assert force(-half, half) == pytest.approx(
        [-16.83 / math.sqrt(2) / 0.7611111, sway, 0.18 * 3 * math.pi / 4 * sway], rel=1e-6
    )
    # from astern: C_l = 0.6 / 3, D = 1 - 0.3 (1 - 0.2 / 0.9) = 0.7666667; the moment is the other way
    sway = 82.62 / math.sqrt(2) / 0.7666667
    assert force(half, half)[1:] == pytest.approx([sway, -0.18 * 3 * math.pi / 4 * sway], rel=1e-6)
    assert force(0, 0) == [0, 0, 0]


@pytest.mark.parametrize(("speed", "push"), [(3, 7), (5, 21), (8, 53), (10, 83)])
def test_the_beam_wind_of_the_literature(speed: float, push: float) -> None:
    assert force(0, speed)[1] == pytest.approx(push, abs=0.5)


def test_forces_are_symmetric_and_grow_with_the_square_and_the_areas() -> None:
    rng = np.random.default_rng(0)
    along, across = rng.normal(0, 5, (2, 200))
    forces = wind_force(WIND, along, across)
    np.testing.assert_allclose(wind_force(WIND, along, -across), forces * [1, -1, -1], atol=1e-12)
    np.testing.assert_allclose(wind_force(WIND, 3 * along, 3 * across), 9 * forces, rtol=1e-9)
    larger = WIND.model_copy(update={"lateral_area_m2": 3.0, "frontal_area_m2": 1.0})
    np.testing.assert_allclose(wind_force(larger, along, across), 2 * forces, rtol=1e-12)


def test_a_boat_in_steady_wind_follows_the_equations_of_motion() -> None:
    """The force is held over the control period; with a short one the motion is that of an ODE solver."""
    short = ("vessel.control_period_s=0.01", "vessel.substeps=2")
    sim = simulator("wind: {speed_mps: 6, direction_deg: 70}", *short)
    model, command = VesselModel(VESSEL), np.array([[30.0, 0.3]])
    air = 6 * np.array([math.cos(math.radians(70)), math.sin(math.radians(70))])

    def rate(_: float, state: np.ndarray) -> np.ndarray:
        c, s = math.cos(state[2]), math.sin(state[2])
        u, v, _ = nu = state[3:]
        pushed = wind_force(WIND, *np.array([[c * air[0] + s * air[1] - u], [-s * air[0] + c * air[1] - v]]))
        nu_dot = model.nu_dot(nu[None], model.tau(command) + pushed)[0]
        return np.concatenate([model.eta_dot(state[None, :3], nu[None])[0], nu_dot])

    begin = np.concatenate([sim.eta[0], sim.nu[0]])
    truth = solve_ivp(rate, (0, 10), begin, rtol=1e-9, atol=1e-9).y[:, -1]
    for _ in range(1000):
        sim.step(command)
    assert np.concatenate([sim.eta[0], sim.nu[0]]) == pytest.approx(truth, abs=2e-3)


def test_gusts_have_the_variance_and_the_correlation_of_the_process() -> None:
    boats, sigma = 4000, 1.5
    sim = simulator(f"wind: {{speed_mps: 5, direction_deg: 0, gust_mps: {sigma}}}", boats=boats)
    (wind,) = sim.disturbances
    speeds = []
    for _ in range(9):
        speeds.append(wind.air_velocity()[:, 0])  # type: ignore[index]
        wind.advance(0.5)
    gusts = np.array(speeds) - 5
    assert gusts.mean() == pytest.approx(0, abs=4 * sigma / math.sqrt(boats))
    for lag in (0, 1, 4, 8):
        expected = sigma**2 * math.exp(-0.5 * lag / 2.0)
        assert (gusts[0] * gusts[lag]).mean() == pytest.approx(
            expected, abs=4 * sigma**2 * math.sqrt(2 / boats)
        )
    assert gusts[-1].std() == pytest.approx(sigma, rel=0.05)  # stationary


def test_the_wind_does_not_depend_on_the_policy_or_the_number_of_boats() -> None:
    text = "wind: {speed_mps: [0, 5], direction_deg: [0, 360], gust_mps: [0, 1.5]}"
    many, few = simulator(text, boats=5), simulator(text, boats=2)
    for step in range(20):
        many.step(np.full((5, 2), 10.0 * (step % 2)))
        few.step(np.zeros((2, 2)))
        assert np.array_equal(many.wind()[:2], few.wind())
    assert len(np.unique(many.wind(), axis=0)) == 5


def test_info_and_tables_have_the_wind_only_where_there_is_one() -> None:
    loaded = scenario("wind: {speed_mps: 2, direction_deg: 90}", "task.max_steps=3")
    env = DockingVectorEnv(loaded, 2)
    _, info = env.reset(seed=0)
    np.testing.assert_allclose(info["wind"], [[0, 2]] * 2, atol=1e-12)
    assert info["conditions"]["wind_speed_mps"].tolist() == [2.0, 2.0]
    assert "current" not in info
    rollout = Rollout(loaded)
    model = loaded.scenario
    start = given_start(own_site(model), model.task, np.array([20.0, 2.0, 2.7]), 0)

    class Idle:
        def reset(self, rows: object, info: object) -> None: ...

        def act(self, observation: np.ndarray, info: object) -> np.ndarray:
            return np.full(len(observation), 38)

    (episode,) = rollout.run(Idle(), [start])
    assert episode.row()["wind_speed_mps"] == 2.0
    header, first, *_ = trajectories_csv([episode], 0.5).splitlines()
    assert header.endswith("range_8_m,wind_x_mps,wind_y_mps")
    assert first.endswith(",2")


def test_wind_beyond_the_control_authority_is_noted_with_its_place() -> None:
    calm, strong = (scenario(f"wind: {{speed_mps: [0, {top}], direction_deg: 0}}") for top in (5, 10))
    assert notes(calm) == []
    (note,) = notes(strong)
    for figure in ("conditions.wind.speed_mps", "83 N", "25 N", "0.177 m/s", "87%"):
        assert figure in note
    wide = "wind: {speed_mps: 5, direction_deg: 0, lateral_area_m2: 1, frontal_area_m2: 8}"
    (note,) = notes(scenario(wide))  # pressure 15.3 N/m2, times 0.60 from astern
    assert "73 N" in note and "50 N" in note
    (note,) = notes(scenario("current: {speed_mps: 0.2, direction_deg: 0}"))
    assert "29°" in note
    assert notes(scenario("current: {speed_mps: 0, direction_deg: 0, variation_mps: 0.02}")) == []
    (note,) = notes(scenario("current: {speed_mps: 0, direction_deg: 0, variation_mps: [0, 0.1]}"))
    assert "29°" in note


def test_wind_and_current_that_exceed_the_control_authority_only_together_are_noted() -> None:
    """The wind pushes with 20.7 N; the drag of Table 3.1 is 20.8 N."""
    wind, current = "wind: {speed_mps: 5, direction_deg: 0}", "current: {speed_mps: 0.05, direction_deg: 0}"
    assert notes(scenario(wind)) == notes(scenario(current)) == []
    (note,) = notes(scenario(f"{wind}, {current}"))
    drag = (VESSEL.Y_v_kgps + VESSEL.Y_vv_kgpm * 0.05) * 0.05
    assert f"{1.224 / 2 * 25 * 1.5 * 0.9 + drag:.0f} N" in note and "25 N" in note


def test_control_authority_of_the_thesis_boat() -> None:
    authority = ControlAuthority.of(VESSEL)
    assert authority.top_speed_mps == pytest.approx(0.4119, abs=1e-4)
    assert (authority.side_force_n, authority.yaw_moment_nm) == pytest.approx((25.0, 37.5))
    assert [authority.drift(force(0, speed)[1]) for speed in (3, 5, 8, 10)] == pytest.approx(
        [0.018, 0.050, 0.119, 0.177], abs=5e-4
    )


def test_a_variable_current_has_its_variance_and_time() -> None:
    boats = 3000
    text = "current: {speed_mps: 0.1, direction_deg: 90, variation_mps: 0.02, variation_time_s: 10}"
    sim: Simulator = simulator(text, boats=boats)
    (current,) = sim.disturbances
    flows = []
    for _ in range(21):
        flows.append(sim.current() - [0, 0.1])
        current.advance(0.5)
    for lag in (0, 10, 20):
        products = flows[0] * flows[lag]
        expected = 0.02**2 * math.exp(-0.5 * lag / 10)
        assert products.mean() == pytest.approx(expected, abs=5 * 0.02**2 / math.sqrt(boats))
    assert (flows[20] ** 2).mean() == pytest.approx(0.02**2, abs=5 * 0.02**2 / math.sqrt(boats))
    crossed = flows[0][:, 0] * flows[0][:, 1]
    assert abs(crossed.mean()) < 4 * 0.02**2 / math.sqrt(boats)


def test_a_stored_scenario_has_the_areas_of_the_vessel_that_it_is_used_with(tmp_path: Path) -> None:
    file = tmp_path / "stored.yaml"
    file.write_text(dump(scenario("wind: {speed_mps: 5, direction_deg: 0}").scenario))
    for freeboard_m, lateral_m2, frontal_m2 in ((0.5, 1.5, 0.5), (1.0, 3.0, 1.0)):
        loaded = load(file, overrides=[f"vessel.hull.freeboard_m={freeboard_m}"])
        (built,) = Disturbances(loaded.scenario, 1)
        assert isinstance(built, UniformWind)
        assert (built.wind.lateral_area_m2, built.wind.frontal_area_m2) == (lateral_m2, frontal_m2)


def test_the_condition_is_built_for_many_boats() -> None:
    assert UniformWind(WIND, 3).air_velocity().shape == (3, 2)


def test_a_force_that_changes_its_arguments_does_not_move_the_boat(monkeypatch: pytest.MonkeyPatch) -> None:
    still, changed = (simulator("wind: {speed_mps: 0, direction_deg: 90}") for _ in range(2))
    (disturbance,) = changed.disturbances

    def force(eta: Floats, nu: Floats) -> float:
        eta[:] = nu[:] = 0.0
        return 0.0

    monkeypatch.setattr(disturbance, "force", force)
    for sim in (still, changed):
        sim.step(np.array([[20.0, 0.1]]))
    assert np.array_equal(changed.eta, still.eta)
