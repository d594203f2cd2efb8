"""Propeller and rudder that do not follow their commands at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, Strict

from dockctl.geometry import Floats, Ints
from dockctl.plugins import CONDITIONS
from dockctl.scenarios.base import NonNegative, Positive
from dockctl.scenarios.extensions import OFF, Condition, Disturbance, Drawn, draw, draw_integer, register
from dockctl.scenarios.vessel import Vessel
from dockctl.sim.conditions.authority import ControlAuthority

Steps = Annotated[int, Strict(), Field(ge=0, le=100)]
Factor = Annotated[Positive, Field(le=2)]
NOTED_ASTERN = 0.1
"""Astern factor below which a note warns that the propeller has hardly any thrust astern."""


@register(CONDITIONS, group="actuation", source="not in the thesis; Fossen 2021, sections 9.5 and 15.3")
class Actuators(Condition):
    """Delay in whole control steps, propeller lag, rudder rate limit, and weaker astern thrust.

    The delay acts first. If a key is missing, the actuators are ideal in that respect.
    """

    examples = ({"delay_steps": [0, 2], "propeller_lag_s": 0.1, "rudder_rate_degps": [20, 40]},)
    is_single = True  # the planner's forecast assumes it
    kind: Literal["actuators"] = "actuators"
    delay_steps: Drawn[Steps] = (0,)
    propeller_lag_s: Drawn[Annotated[NonNegative, Field(le=60)]] = OFF
    rudder_rate_degps: Drawn[Annotated[Positive, Field(ge=0.1)]] | None = None
    astern_factor: Drawn[Factor] = (1.0,)

    def build(self, num_boats: int) -> Disturbance:
        return RealActuators(self, num_boats)

    def notes(self, vessel: Vessel) -> list[tuple[str, str]]:
        authority, length = ControlAuthority.of(vessel), vessel.hull.length_m
        top_mps, thrust_n = authority.top_speed_mps, vessel.max_propeller_n
        times_s = {
            "delay_steps": ("act", self.delay_steps[-1] * vessel.control_period_s),
            "propeller_lag_s": ("reach 63 % of a thrust change", self.propeller_lag_s[-1]),
        }
        if self.rudder_rate_degps is not None:
            turn_s = vessel.max_rudder_deg / self.rudder_rate_degps[0]
            times_s["rudder_rate_degps"] = ("turn the rudder from amidships to its limit", turn_s)
        messages = [
            (
                field,
                f"the actuators take up to {time_s:.3g} s to {action}; meanwhile the boat moves"
                f" {time_s * top_mps:,.1f} m at its top speed of {top_mps:.2f} m/s, more than its length of"
                f" {length:g} m",
            )
            for field, (action, time_s) in times_s.items()
            if time_s * top_mps > length
        ]
        if self.astern_factor[0] < NOTED_ASTERN:
            least_n = self.astern_factor[0] * thrust_n
            message = (
                f"the propeller has {thrust_n:g} N ahead, but astern as little as {least_n:.2g} N, with which"
                f" the boat reaches {authority.speed(least_n):.2g} m/s"
            )
            messages.append(("astern_factor", message))
        return messages


class RealActuators(Disturbance):
    """Propeller and rudder of n boats."""

    def __init__(self, actuators: Actuators, num_boats: int) -> None:
        self.actuators = actuators
        self.delay = np.zeros(num_boats, np.int64)
        self.lag, self.thrust, self.angle = np.zeros((3, num_boats))
        self.rate, self.astern = np.full(num_boats, np.inf), np.ones(num_boats)
        self.past = np.zeros((num_boats, actuators.delay_steps[-1] + 1, 1, 2))

    def reset(self, rows: Ints, rngs: Sequence[np.random.Generator]) -> None:
        given = self.actuators
        for row, rng in zip(rows, rngs, strict=True):
            self.delay[row] = draw_integer(given.delay_steps, rng)
            self.lag[row] = draw(given.propeller_lag_s, rng)
            if given.rudder_rate_degps is not None:
                self.rate[row] = np.radians(draw(given.rudder_rate_degps, rng))
            self.astern[row] = draw(given.astern_factor, rng)
        self.thrust[rows] = self.angle[rows] = 0.0
        self.past[rows] = 0.0

    def actuate(self, commands: Floats, substep_s: float) -> Floats:
        from dockctl.sim.actuation import respond  # compiles on import: not for a dry run

        boats, substeps, _ = commands.shape
        if self.past.shape[2] != substeps:  # the first step
            self.past = np.zeros((*self.past.shape[:2], substeps, 2))
        self.past = np.concatenate([commands[:, None], self.past[:, :-1]], axis=1)
        wanted, actual = self.past[np.arange(boats), self.delay], np.empty_like(commands)
        respond(wanted, self.thrust, self.angle, self.lag, self.rate, self.astern, substep_s, actual)
        return actual

    def episode(self) -> dict[str, Floats]:
        values = {"delay_steps": self.delay.astype(float), "propeller_lag_s": self.lag}
        if self.actuators.rudder_rate_degps is not None:
            values["rudder_rate_degps"] = np.degrees(self.rate)
        return {**values, "astern_factor": self.astern}
