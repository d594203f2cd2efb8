"""Prediction of the planner's random plans, together and as a fleet in the simulator's own equations.

    python benchmarks/prediction.py               # seconds; not part of `make bench`

The fleet is as many boats with the actuators and the integration of `Simulator`, without harbor and sensors.
"""

from __future__ import annotations

import argparse

import bench  # before numpy
import numpy as np

from dockctl.control.planner import PLAN_S, RANDOM
from dockctl.control.plans import RandomPlans
from dockctl.geometry import Floats
from dockctl.scenarios.loader import load
from dockctl.sim.actuation import respond
from dockctl.sim.prediction import predict
from dockctl.sim.vessel import VesselModel

STATE = np.array([0.0, 0.0, 0.3, 0.5, 0.1, 0.02])
ACTUATORS = np.array([0.0, 0.0, 0.5, 0.3, 0.8])
"""Thrust [N] and rudder angle [rad] at the start, propeller lag [s], rudder rate [rad/s], astern factor."""
SUBSTEPS = 6  # of 1 s, as in the planner


def fleet(model: VesselModel, wanted: Floats) -> Floats:
    """Return the last poses (m, 3) of boats with these commands (m, k, 2), in still air and water."""
    boats, (eta, nu) = len(wanted), (np.tile(half, (len(wanted), 1)) for half in (STATE[:3], STATE[3:]))
    thrust, angle, lag, rate, astern = np.tile(ACTUATORS[:, None], boats)
    actual = np.empty((boats, SUBSTEPS, 2))
    for step in range(wanted.shape[1]):
        held = np.repeat(wanted[:, step, None], SUBSTEPS, axis=1)
        respond(held, thrust, angle, lag, rate, astern, 1 / SUBSTEPS, actual)
        path = model.path(eta, nu, model.tau(actual))
        eta, nu = path[:, -1, :3].copy(), path[:, -1, 3:].copy()
    return eta


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=9)
    arguments = parser.parse_args()
    scenario = load("marinas-weather").scenario
    vessel = scenario.vessel.model_copy(update={"control_period_s": 1.0, "substeps": SUBSTEPS})
    commands, model, steps = scenario.actions.command_table(vessel), VesselModel(vessel), round(PLAN_S)
    assert commands is not None
    wanted = commands[RandomPlans(commands, steps, 1.0).draw(np.random.default_rng(0), RANDOM)]
    calm, own, arm_m = np.zeros((steps, 3)), tuple(model.coefficients[0]), vessel.propeller_arm_m

    def together() -> Floats:
        poses, _ = predict(STATE, wanted, ACTUATORS, np.zeros(2), calm, own, arm_m, 1.0, SUBSTEPS)
        return np.asarray(poses[:, -1])

    report = bench.Report("prediction", f"Prediction of {RANDOM} plans of {steps} control steps")
    off = float(np.abs(together() - fleet(model, wanted)).max())
    cases = {
        "together": bench.Case(together, RANDOM * steps, 1),
        "as a fleet": bench.Case(lambda: fleet(model, wanted), RANDOM * steps, 1),
    }
    report.seconds = bench.alternate(cases, arguments.rounds, "prediction")
    report.facts = {"largest_difference": off}
    report.targets = [
        bench.Target("largest difference of a pose [m, rad]", off, at_most=1e-9),
        bench.Target(
            "time of a fleet, relative",
            bench.ratio(report.seconds, "as a fleet", "together"),
            at_least=3,
            unit="×",
        ),
    ]
    report.write()


if __name__ == "__main__":
    main()
