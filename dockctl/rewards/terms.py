"""The reward terms of the thesis (eqs. 3.10 and 3.13), and others.

A term is a function of the `StepStatus` of n boats, and of keyword-only parameters, that returns a measure
(n,). Its kind determines when it applies: `collision`, `intermediate` and `final` in the step of that event,
`dense` in every other step. The weights, with their signs, are in the scenario. A parameter `distance_unit_m`
defaults to the unit of the scenario's reward.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, get_args

import numpy as np

from dockctl.errors import DockctlError, nearest
from dockctl.geometry import Floats
from dockctl.plugins import REWARD_TERMS
from dockctl.scenarios.base import Number, Positive
from dockctl.sim.goal import StepStatus

Kind = Literal["collision", "intermediate", "final", "dense"]
Term = Callable[..., Floats]


def reward_term(name: str, *, kind: Kind, source: str = "") -> Callable[[Term], Term]:
    """Register the function below as a reward term.

    Args:
        name: its name in scenarios.
        kind: when it applies.
        source: equation or table.

    Raises:
        DuplicateNameError: the name is taken.
        DockctlError: there is no such kind.
    """
    if kind not in get_args(Kind):
        raise DockctlError(
            f"reward term '{name}': unknown kind '{kind}' (known: {', '.join(get_args(Kind))})",
            code="unknown_name",
            suggestion=nearest(kind, get_args(Kind)),
        )
    return lambda function: REWARD_TERMS.register(name, function, kind=kind, source=source)


@reward_term("collision", kind="collision", source="eqs. 3.10, 3.13")
def collision(status: StepStatus) -> Floats:
    """Return 1 for a boat that collided."""
    return status.collided.astype(float)


@reward_term("intermediate", kind="intermediate", source="eq. 3.13")
def intermediate(status: StepStatus) -> Floats:
    """Return 1 for a boat that reached the intermediate pose."""
    return status.reached_intermediate.astype(float)


@reward_term("final", kind="final", source="eqs. 3.10, 3.13")
def final(status: StepStatus) -> Floats:
    """Return 1 for a boat that reached the final pose."""
    return status.reached_final.astype(float)


@reward_term("distance", kind="dense", source="eqs. 3.10, 3.13")
def distance(status: StepStatus, *, distance_unit_m: Positive = 1.0) -> Floats:
    """Return the distance to the goal, delta d, in units of `distance_unit_m`."""
    return status.distance_m / distance_unit_m


@reward_term("orientation", kind="dense", source="eqs. 3.10, 3.13")
def orientation(status: StepStatus) -> Floats:
    """Return the absolute heading error, |delta psi| [rad]."""
    return np.abs(status.heading_error_rad)


@reward_term("speed", kind="dense", source="eqs. 3.10, 3.13")
def speed(
    status: StepStatus,
    *,
    distance_unit_m: Positive = 1.0,
    floor_m: Positive = 0.4,
    floor: Positive | None = None,
) -> Floats:
    """Return sqrt(u^2 + v^2) / delta d [m/s], delta d at least `floor_m` and in units of `distance_unit_m`.

    `floor`, in these units, is the equivalent in runs of earlier versions.
    """
    least = floor_m / distance_unit_m if floor is None else floor
    return status.speed_mps / np.maximum(status.distance_m / distance_unit_m, least)


@reward_term("progress", kind="dense", source="potential difference; not in the thesis")
def progress(status: StepStatus, *, per_m: Number = 150.0, per_rad: Number = 100.0) -> Floats:
    """Return D before minus D after the step, D = per_m * delta d [m] + per_rad * |delta psi| [rad].

    It replaces `distance` and `orientation`. In the step of an event the dense terms do not apply, so the
    last difference is dropped, and the optimal policy may differ from that of the penalties.
    """
    closer = status.previous_distance_m - status.distance_m
    better_aligned = np.abs(status.previous_heading_error_rad) - np.abs(status.heading_error_rad)
    return per_m * closer + per_rad * better_aligned


@reward_term("clearance", kind="dense", source="not in the thesis")
def clearance(status: StepStatus, *, margin_m: Positive = 0.5) -> Floats:
    """Return max(0, 1 - c / margin_m) with the distance c between hull and harbor [m]; 1 at contact."""
    return 1 - status.clearance_below(margin_m) / margin_m


@reward_term("command_change", kind="dense", source="not in the thesis; its section 4.4 asks for it")
def command_change(status: StepStatus, *, per_n: Positive = 50.0, per_deg: Positive = 30.0) -> Floats:
    """Return |P - P'| / per_n + |phi - phi'| / per_deg between the command and the previous one.

    By default in units of the thesis's limits, 50 N and 30 degrees, so that a reversal of both gives 4.
    """
    force, angle = np.abs(status.command - status.previous_command).T
    change: Floats = force / per_n + np.degrees(angle) / per_deg
    return change


@reward_term("overspeed", kind="dense", source="not in the thesis; its section 4.3.1 asks for it")
def overspeed(status: StepStatus, *, deceleration_mps2: Positive = 0.01, floor_mps: Positive = 0.1) -> Floats:
    """Return max(0, V - v) [m/s], with the speed limit v = max(floor_mps, sqrt(2 a delta d)).

    At the limit, a boat that decelerates by a = `deceleration_mps2` stops at the goal. With the defaults, the
    limit is above the top speed of the thesis's boat, 0.41 m/s, beyond 8.5 m.
    """
    limit = np.maximum(np.sqrt(2 * deceleration_mps2 * status.distance_m), floor_mps)
    return np.maximum(status.speed_mps - limit, 0.0)
