"""The plans of benchmarks/planning.py: the symbolic model is dockctl's, and a known optimum is found."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dockctl.scenarios.loader import load
from dockctl.sim.starts import given_start, own_site
from dockctl.sim.world import build_worlds

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
WEATHER = (
    "conditions.wind={speed_mps: 6, direction_deg: 70}",
    "conditions.current={speed_mps: 0.2, direction_deg: 200}",
)

pytestmark = pytest.mark.thorough  # loads CasADi, and solves


@pytest.fixture(scope="module")
def planning() -> Iterator[Any]:
    pytest.importorskip("casadi", reason="the plans need CasADi, of the extra 'peers'")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(BENCHMARKS))
        import planning

        patch.setattr(planning, "LIMIT_S", 300.0)  # slow machines find the same plans
        yield planning
    del sys.modules["planning"]


def docking(planning: Any, overrides: Sequence[str] = ()) -> Any:
    """Return the docking of scenario 1."""
    loaded = load("s1", overrides=overrides)
    site, worlds = own_site(loaded.scenario), build_worlds(loaded.scenario, loaded.base_dir)
    return planning.Docking(loaded, worlds, given_start(site, loaded.scenario.task, site.initial[0], 0))


def random_states(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return poses in the fairway (n, 3), velocities (n, 3) and commands (n, 2)."""
    rng = np.random.default_rng(0)
    eta = rng.uniform((18, -5, -3), (24, 5, 3), (count, 3))
    nu = rng.uniform((-0.5, -0.2, -0.1), (0.5, 0.2, 0.1), (count, 3))
    return eta, nu, rng.uniform((-50, -0.5), (50, 0.5), (count, 2))


def test_the_symbolic_rate_is_that_of_the_matrices(planning: Any) -> None:
    import casadi as ca

    model = docking(planning).model
    state, command = ca.SX.sym("state", 6), ca.SX.sym("command", 2)
    tau = planning.thrust(model, command)
    symbolic = ca.Function("rate", [state, command], [planning.rate(model, state, tau)])
    eta, nu, commands = random_states(50)
    expected = np.hstack([model.eta_dot(eta, nu), model.nu_dot(nu, model.tau(commands))])
    got = np.array(symbolic(np.hstack([eta, nu]).T, commands.T)).T
    np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("overrides", [(), WEATHER], ids=["calm", "weather"])
def test_a_symbolic_period_is_a_step_of_the_simulator(planning: Any, overrides: Sequence[str]) -> None:
    task = docking(planning, overrides)
    step, simulator = planning.control_step(task), task.simulator()
    for eta, nu, command in zip(*random_states(10), strict=True):
        simulator.reset(np.array([0]), [replace(task.start, eta=eta, nu=nu, seed=0)])
        simulator.step(command[None])
        got = np.ravel(step(np.array([*eta, *task.relative(eta, nu)]), command, task.control_period_s))
        after = [*simulator.eta[0], *task.relative(simulator.eta[0], simulator.nu[0])]
        np.testing.assert_allclose(got, after, rtol=1e-9, atol=1e-9)


def test_the_optimum_of_scenario_1_is_known_and_docks_in_the_simulator(planning: Any) -> None:
    task = docking(planning)
    found = planning.optimum(task, planning.straight(task, 0.3))
    assert found.time_s == pytest.approx(38.7, abs=1.0)  # of another program, with a narrower berth
    assert found.run.docked and found.run.steps * task.control_period_s < found.time_s + 1.5
    assert found.run.off_m < 1e-6


def test_a_plan_keeps_clear_of_what_is_in_its_way(planning: Any) -> None:
    task = docking(planning)
    free = planning.optimum(task, planning.straight(task, 0.3))
    x, y = free.plan.states[len(free.plan.states) // 2, :2]
    box = np.array([(x - 0.5, y - 0.5), (x + 0.5, y - 0.5), (x + 0.5, y + 0.5), (x - 0.5, y + 0.5)])
    guess = planning.straight(task, 0.15)
    guess.states[1:-1, 1] += 2.0  # past it
    plan = planning.solve(task, guess, [box])
    assert plan.time_s > free.time_s
    corners = np.linspace(box, np.roll(box, -1, axis=0), 20).reshape(-1, 2)
    for x, y, heading in plan.states[:, :3]:
        c, s = np.cos(heading), np.sin(heading)
        along, across = ((corners - (x, y)) @ [[c, -s], [s, c]]).T
        assert not ((np.abs(along + 0.525) < 0.975) & (np.abs(across) < 0.5)).any()  # aft of the bow
