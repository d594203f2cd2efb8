"""Spatially uniform wind with gusts, and its force on the boat after Blendermann (1994)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from dockctl.geometry import Floats, Ints, rotate
from dockctl.plugins import CONDITIONS
from dockctl.scenarios.base import NonNegative, Number, Positive
from dockctl.scenarios.extensions import OFF, Condition, Directions, Disturbance, Drawn, draw, register
from dockctl.scenarios.vessel import Vessel
from dockctl.sim.conditions.authority import ControlAuthority
from dockctl.sim.conditions.draws import draw_seed, gauss_markov, normals

AIR_KGPM3 = 1.224
TRANSVERSE, AHEAD, ASTERN, CROSS_FORCE = 0.90, 0.55, 0.60, 0.60
"""CD_t, CD_lAF at 0 and at 180 degrees, and delta, of Blendermann's speed boat."""

Area = Annotated[Positive, Field(le=20_000)]


@register(CONDITIONS, group="air", source="not in the thesis; Blendermann 1994, MSS blendermann94.m")
class Wind(Condition):
    """Mean speed of the air, the direction in which it flows, counterclockwise from +x, gusts, and areas.

    Gusts are added to the speed: first-order Gauss-Markov with this standard deviation and time constant. A
    negative speed blows the other way. By default the areas are those of the hull above the water.
    """

    examples = ({"speed_mps": [0, 5], "direction_deg": [0, 360], "gust_mps": [0, 1.5]},)
    is_single = True  # forces of two winds are not the force of both
    kind: Literal["wind"] = "wind"
    speed_mps: Drawn[Annotated[NonNegative, Field(le=100)]]  # a tropical cyclone has up to 95 m/s
    direction_deg: Directions
    gust_mps: Drawn[Annotated[NonNegative, Field(le=30)]] = OFF
    gust_time_s: Positive = 2.0
    lateral_area_m2: Area | None = None
    frontal_area_m2: Area | None = None
    length_m: Annotated[Positive, Field(le=500)] | None = None
    centroid_m: Annotated[Number, Field(ge=-500, le=500)] = 0.0

    def fitted(self, vessel: Vessel) -> Wind:
        hull = vessel.hull
        own = {
            "lateral_area_m2": hull.length_m * hull.freeboard_m,
            "frontal_area_m2": hull.beam_m * hull.freeboard_m,
            "length_m": hull.length_m,
        }
        return self.model_copy(
            update={key: value for key, value in own.items() if getattr(self, key) is None}
        )

    def build(self, num_boats: int) -> Disturbance:
        return UniformWind(self, num_boats)

    @property
    def _strongest_mps(self) -> float:
        return self.speed_mps[-1] + 2 * self.gust_mps[-1]

    def side_force_n(self, vessel: Vessel) -> float:
        return float(wind_force(self.fitted(vessel), np.zeros(1), np.array([self._strongest_mps]))[0, 1])

    def notes(self, vessel: Vessel) -> list[tuple[str, str]]:
        authority, speed, push = ControlAuthority.of(vessel), self._strongest_mps, self.side_force_n(vessel)
        angle = np.linspace(0, np.pi, 181)
        forces = wind_force(self.fitted(vessel), -speed * np.cos(angle), speed * np.sin(angle))
        along, _, moment = np.abs(forces).max(axis=0)
        gusts = " (the mean and two standard deviations of the gusts)" if self.gust_mps != OFF else ""
        messages = []
        if push > authority.side_force_n or moment > authority.yaw_moment_nm:
            drift = authority.drift(push)
            messages.append(
                f"wind of {speed:g} m/s{gusts} on the beam pushes with {push:.0f} N; the vessel has"
                f" {authority.side_force_n:.0f} N sideways. It drifts at {drift:.3f} m/s,"
                f" {authority.crab(drift)}, and the wind takes {moment / authority.yaw_moment_nm:.0%}"
                " of the yaw moment"
            )
        if along > vessel.max_propeller_n:
            messages.append(
                f"wind of {speed:g} m/s{gusts} pushes ahead or astern with up to {along:.0f} N; the propeller"
                f" has {vessel.max_propeller_n:g} N"
            )
        return [("speed_mps", message) for message in messages]


class UniformWind(Disturbance):
    """The wind of n boats."""

    def __init__(self, wind: Wind, num_boats: int) -> None:
        self.wind = wind
        self.speed, self.sigma, self.gust = np.zeros((3, num_boats))
        self.direction = np.zeros((num_boats, 2))
        self.seed, self.drawn = np.zeros(num_boats, np.uint64), np.zeros(num_boats, np.int64)

    def reset(self, rows: Ints, rngs: Sequence[np.random.Generator]) -> None:
        for row, rng in zip(rows, rngs, strict=True):
            self.speed[row] = draw(self.wind.speed_mps, rng)
            direction = math.radians(draw(self.wind.direction_deg, rng))
            self.direction[row] = math.cos(direction), math.sin(direction)
            self.sigma[row] = draw(self.wind.gust_mps, rng)
            self.seed[row] = draw_seed(rng)
        self.drawn[rows] = 1
        self.gust[rows] = self.sigma[rows] * normals(self.seed[rows], 0 * rows, 1)[:, 0]

    def advance(self, period_s: float) -> None:
        noise = self.sigma * normals(self.seed, self.drawn, 1)[:, 0]
        self.gust = gauss_markov(self.gust, noise, period_s, self.wind.gust_time_s)
        self.drawn += 1

    def air_velocity(self) -> Floats:
        return (self.speed + self.gust)[:, None] * self.direction

    def force(self, eta: Floats, nu: Floats) -> Floats:
        x, y = self.air_velocity().T
        along, across = rotate(x, y, -eta[:, 2])
        return wind_force(self.wind, along - nu[:, 0], across - nu[:, 1])

    def episode(self) -> dict[str, Floats]:
        x, y = self.direction.T
        return {
            "speed_mps": self.speed,
            "direction_deg": np.degrees(np.arctan2(y, x)),
            "gust_mps": self.sigma,
        }


def wind_force(wind: Wind, along: Floats, across: Floats) -> Floats:
    """Return surge force, sway force and yaw moment (n, 3) [N, N, N m] of the wind on the boat.

    Blendermann (1994, J. Wind Eng. Ind. Aerodyn. 51, 339-351), speed boat; z up, sway to port.

    Args:
        wind: areas and length; fitted to the vessel.
        along, across: (n,) velocity of the air relative to the boat in the body frame [m/s].
    """
    lateral, frontal, length = wind.lateral_area_m2, wind.frontal_area_m2, wind.length_m
    assert lateral is not None and frontal is not None and length is not None  # by `fitted`
    speed = np.hypot(along, across)
    safe = np.where(speed > 0, speed, 1.0)
    cosine = np.clip(-along / safe, -1.0, 1.0)
    angle = np.arccos(cosine)  # 0 is a head wind
    ahead = np.where(cosine >= 0, AHEAD, ASTERN)
    ratio = ahead * frontal / lateral / TRANSVERSE
    divisor = 1 - CROSS_FORCE / 2 * (1 - ratio) * np.sin(2 * angle) ** 2
    pressure = AIR_KGPM3 / 2 * speed**2
    surge = pressure * frontal * ahead * (along / safe) / divisor
    sway = pressure * lateral * TRANSVERSE * (across / safe) / divisor
    moment = (wind.centroid_m - 0.18 * length * (angle - np.pi / 2)) * sway
    return np.column_stack([surge, sway, moment])
