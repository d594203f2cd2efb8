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


@compiled()
def respond(
    wanted: Any, thrust: Any, angle: Any, lag_s: Any, rate: Any, astern: Any, period_s: float, actual: Any
) -> None:
    """Compute the mean response of n actuators in each of k successive periods.

    Args:
        wanted: (n, k, 2) commands [N, rad].
        thrust, angle: (n,) state before astern thrust is reduced, updated in place [N], [rad].
        lag_s, rate, astern: (n,) propeller lag [s], rudder rate [rad/s] and astern factor.
        period_s: length of a period.
        actual: (n, k, 2), receives the mean force and angle [N, rad].
    """
    for i in range(len(wanted)):
        for part in range(wanted.shape[1]):
            force, thrust[i] = lagged(thrust[i], wanted[i, part, 0], lag_s[i], period_s)
            actual[i, part, 0] = astern[i] * force if force < 0 else force
            actual[i, part, 1], angle[i] = limited(angle[i], wanted[i, part, 1], rate[i] * period_s)
