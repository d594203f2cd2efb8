"""The current: against the full equations of motion, drift, draws, and where problems are reported."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import InputError
from dockctl.scenarios.loader import LoadedScenario, dump, load
from dockctl.sim.simulator import Simulator
from dockctl.sim.starts import given_start, own_site
from dockctl.sim.vessel import VesselModel
from tests.sim.worlds import walled


def scenario(current: str = "{speed_mps: 0.15, direction_deg: 70}", **overrides: Any) -> LoadedScenario:
    changed = [f"{key}={value}" for key, value in overrides.items()]
    return load("s1", overrides=[f"conditions.current={current}", *changed])


def simulator(loaded: LoadedScenario, boats: int = 1) -> Simulator:
    model, sim = loaded.scenario, Simulator(loaded.scenario, [walled()], boats)
    start = replace(given_start(own_site(model), model.task, np.array([20.0, 2.0, 2.7]), 0), max_steps=10_000)
    sim.reset(np.arange(boats), [start] * boats, [np.random.default_rng(row) for row in range(boats)])
    return sim


def solved(
    sim: Simulator, command: np.ndarray, flow: np.ndarray, time_s: float, state: np.ndarray
) -> np.ndarray:
    """Return eta and nu after a time in a constant current (2,), from the full equations of motion.

    nu' = d/dt(R^T V_c) + M^-1 (tau - C(nu_r) nu_r - D(nu_r) nu_r), d/dt(R^T V_c) = [r v_c, -r u_c, 0].
    """
    model = VesselModel(sim.vessel.vessel)

    def rate(_: float, state: np.ndarray) -> np.ndarray:
        psi, nu = state[2], state[3:]
        u_c = math.cos(psi) * flow[0] + math.sin(psi) * flow[1]
        v_c = -math.sin(psi) * flow[0] + math.cos(psi) * flow[1]
        accelerating = nu[2] * np.array([v_c, -u_c, 0.0])
        nu_dot = model.nu_dot((nu - [u_c, v_c, 0.0])[None], model.tau(command))[0] + accelerating
        return np.concatenate([model.eta_dot(state[None, :3], nu[None])[0], nu_dot])

    end: np.ndarray = solve_ivp(rate, (0, time_s), state, rtol=1e-10, atol=1e-10, method="DOP853").y[:, -1]
    return end


def test_it_solves_the_full_equations_of_motion() -> None:
    sim = simulator(scenario(**{"vessel.substeps": 100}))
    command = np.array([[40.0, 0.4]])
    flow = 0.15 * np.array([math.cos(math.radians(70)), math.sin(math.radians(70))])
    truth = solved(sim, command, flow, 20.0, np.concatenate([sim.eta[0], sim.nu[0]]))
    for _ in range(40):
        sim.step(command)
    assert sim.eta[0] == pytest.approx(truth[:3], abs=1e-8)
    assert sim.nu[0] == pytest.approx(truth[3:], abs=1e-8)


def test_the_velocity_over_ground_is_continuous_when_the_current_changes() -> None:
    """So the equations hold from the state at the end of each period, with the current of the next one."""
    current = "{speed_mps: 0, direction_deg: 0, variation_mps: 0.2, variation_time_s: 0.5}"
    sim, command = simulator(scenario(current, **{"vessel.substeps": 100})), np.array([[40.0, 0.4]])
    truth, flows = np.concatenate([sim.eta[0], sim.nu[0]]), []
    for _ in range(6):
        flows.append(sim.current()[0])
        truth = solved(sim, command, flows[-1], 0.5, truth)
        sim.step(command)
        assert np.concatenate([sim.eta[0], sim.nu[0]]) == pytest.approx(truth, abs=1e-8)
    assert np.abs(np.diff(flows, axis=0)).max() > 0.1


def test_a_boat_without_thrust_ends_up_moving_with_the_water() -> None:
    sim = simulator(scenario("{speed_mps: 0.2, direction_deg: -30}"))
    assert not sim.nu.any()
    for _ in range(400):
        sim.step(np.zeros((1, 2)))
    before = sim.eta[0, :2].copy()
    status = sim.step(np.zeros((1, 2)))
    assert (sim.eta[0, :2] - before) / 0.5 == pytest.approx([0.2 * math.cos(math.pi / 6), -0.1], abs=1e-4)
    assert status.speed_mps == pytest.approx([0.2], abs=1e-4)
    assert before[0] > 20 + 0.9 * 200 * 0.2 * math.cos(math.pi / 6)


def test_a_current_of_no_speed_changes_nothing() -> None:
    calm, still = (simulator(s) for s in (load("s1"), scenario("{speed_mps: 0, direction_deg: 0}")))
    for _ in range(20):
        for sim in (calm, still):
            sim.step(np.array([[50.0, -0.3]]))
    assert np.array_equal(calm.eta, still.eta)
    assert np.array_equal(calm.nu, still.nu)


RANGES = "{speed_mps: [0.05, 0.1], direction_deg: [0, 360]}"


def flows(env: DockingVectorEnv) -> np.ndarray:
    return np.concatenate([disturbance.water_velocity() for disturbance in env.simulator.disturbances])


def test_a_current_that_only_varies_has_the_direction_that_was_drawn() -> None:
    current = "{speed_mps: 0, direction_deg: 120, variation_mps: 0.02}"
    drawn = simulator(scenario(current)).disturbances.episode()
    assert drawn["current_speed_mps"] == [0]
    assert drawn["current_direction_deg"] == pytest.approx([120])


def test_each_boat_draws_its_own_current_for_each_episode() -> None:
    loaded = scenario(RANGES)
    eight, three = (DockingVectorEnv(loaded, n, worlds=[walled()]) for n in (8, 3))
    eight.reset(seed=4)
    three.reset(seed=4)
    first = flows(eight).copy()
    assert np.array_equal(first[:3], flows(three))
    assert len(np.unique(first, axis=0)) == 8
    speed = np.hypot(*first.T)
    assert (speed >= 0.05).all()
    assert (speed <= 0.1).all()
    eight.reset(options={"reset_mask": np.arange(8) == 2})
    assert (flows(eight) != first).any(axis=1).tolist() == [row == 2 for row in range(8)]


def test_a_start_with_a_seed_has_the_same_current_in_every_row() -> None:
    env = DockingVectorEnv(scenario(RANGES), 2, worlds=[walled()])
    site, task = own_site(env.scenario), env.scenario.task
    starts = [replace(given_start(site, task, site.initial[0], 0), seed=seed) for seed in (5, 6)]
    env.reset(seed=0, options={"starts": starts})
    there = flows(env).copy()
    env.reset(seed=1, options={"starts": starts[::-1]})
    assert np.array_equal(flows(env), there[::-1])


def test_conditions_are_merged_by_key_and_removed_by_null(tmp_path: Path) -> None:
    (tmp_path / "windy.yaml").write_text(
        "extends: s1\nconditions:\n  current: {speed_mps: 0.1, direction_deg: 90}\n"
        "  tide: {kind: current, speed_mps: [0, 0.1], direction_deg: 0}\n"
    )
    (tmp_path / "other.yaml").write_text(
        "extends: windy.yaml\nconditions:\n  current: {speed_mps: 0.2}\n  tide: null\n"
    )
    other = load(tmp_path / "other.yaml").scenario
    assert other.conditions == scenario("{speed_mps: 0.2, direction_deg: 90}").scenario.conditions
    both = load(tmp_path / "windy.yaml").scenario
    assert list(both.conditions) == ["current", "tide"]
    (tmp_path / "again.yaml").write_text(dump(both))
    assert load(tmp_path / "again.yaml").scenario == both.model_copy(update={"name": both.name})


@pytest.mark.parametrize(
    ("text", "field", "column"),
    [
        ("curent: {speed_mps: 1}", "conditions.curent", 14),
        ("current: {speed_mps: -1, direction_deg: 0}", "conditions.current.speed_mps", 35),
        ("current: {speed_mps: [0.2, 0.1], direction_deg: 0}", "conditions.current.speed_mps", 35),
        ("current: {speed_mps: [0, a], direction_deg: 0}", "conditions.current.speed_mps.1", 39),
        ("current: {speed_mps: [0, 1, 2], direction_deg: 0}", "conditions.current.speed_mps", 35),
        ("current: {speed_mps: 0.1}", "conditions.current.direction_deg", 14),
        ("current: {speed: 0.1, speed_mps: 1, direction_deg: 1}", "conditions.current.speed", 24),
        ("current: 3", "conditions.current", 23),
    ],
)
def test_a_problem_has_its_place(tmp_path: Path, text: str, field: str, column: int) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(f"extends: s1\nconditions: {{{text}}}\n")
    with pytest.raises(InputError) as caught:
        load(file)
    (problem,) = caught.value.problems
    assert (problem.line, problem.column, problem.field) == (2, column, field), problem


def test_info_and_trajectories_have_the_current_of_each_boat() -> None:
    loaded = scenario("{speed_mps: [0.05, 0.2], direction_deg: 70}")
    env = DockingVectorEnv(loaded, 3)
    _, info = env.reset(seed=4)
    heading = np.degrees(np.arctan2(info["current"][:, 1], info["current"][:, 0]))
    speed = np.hypot(*info["current"].T)
    assert heading == pytest.approx([70.0] * 3)
    assert len(set(speed)) == 3
    assert ((speed >= 0.05) & (speed <= 0.2)).all()
    _, _, _, _, later = env.step(np.zeros(3, int))
    np.testing.assert_array_equal(later["current"], info["current"])
    assert "current" not in DockingVectorEnv("s1", 1).reset(seed=4)[1]


def test_info_has_a_drawn_variation() -> None:
    env = DockingVectorEnv(scenario("{speed_mps: 0.1, direction_deg: 0, variation_mps: [0.01, 0.02]}"), 3)
    drawn = env.reset(seed=4)[1]["conditions"]["current_variation_mps"]
    assert len(set(drawn)) == 3
    assert ((drawn >= 0.01) & (drawn <= 0.02)).all()
