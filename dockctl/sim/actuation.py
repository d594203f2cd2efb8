"""Response of a propeller and a rudder to their commands, compiled."""

from __future__ import annotations

import math
from typing import Any

from dockctl.compute import compiled


@compiled(inline="always")
def lagged(start: float, target: float, lag_s: float, period_s: float) -> tuple[float, float]:
    """Return mean and final value of a first-order lag over a period with a constant target."""
    if lag_s == 0:
        return target, target
    ratio = period_s / lag_s
    left = math.exp(-ratio)
    return target + (start - target) * (1 - left) / ratio, target + (start - target) * left


@compiled(inline="always")
def limited(start: float, target: float, reach: float) -> tuple[float, float]:
    """Return mean and final value over a period of a value that changes by at most `reach`."""
    change = target - start
    if abs(change) <= reach:
        return target - change * abs(change) / (2 * reach), target
    moved = math.copysign(reach, change)
    return start + moved / 2, start + moved


@compiled(inline="always")
def response(
    force: float,
    rudder: float,
    thrust: float,
    angle: float,
    lag_s: float,
    rate: float,
    astern: float,
    h: float,
) -> Any:
    """Return mean force and angle over a period of h seconds, and thrust and angle at its end.

    Args:
        force, rudder: command [N], [rad].
        thrust, angle: at the start, before astern thrust is reduced.
        lag_s, rate, astern: propeller lag [s], rudder rate [rad/s] and astern factor.
    """
    mean_thrust, thrust = lagged(thrust, force, lag_s, h)
    mean_angle, angle = limited(angle, rudder, rate * h)
    return astern * mean_thrust if mean_thrust < 0 else mean_thrust, mean_angle, thrust, angle


@compiled()
def respond(
    wanted: Any, thrust: Any, angle: Any, lag_s: Any, rate: Any, astern: Any, period_s: float, actual: Any
) -> None:
    """Compute the mean response of n actuators in each of k successive periods.

    Args:
        wanted: (n, k, 2) commands [N, rad].
        thrust, angle: (n,) state before astern thrust is reduced, updated in place [N], [rad].
        lag_s, rate, astern: (n,), as in `response`.
        period_s: length of a period.
        actual: (n, k, 2), receives the mean force and angle [N, rad].
    """
    for i in range(len(wanted)):
        for part in range(wanted.shape[1]):
            actual[i, part, 0], actual[i, part, 1], thrust[i], angle[i] = response(
                wanted[i, part, 0],
                wanted[i, part, 1],
                thrust[i],
                angle[i],
                lag_s[i],
                rate[i],
                astern[i],
                period_s,
            )
