"""The equations of motion of `dockctl.sim.vessel`, written out by element and compiled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dockctl.compute import compiled


@compiled(inline="always")
def rate(psi: float, u: float, v: float, r: float, tau: Any, coefficients: Any) -> Any:
    """Return the time derivatives of x, y, psi, u, v, r of one boat (thesis eqs. 2.5, 2.8)."""
    i00, i11, i12, i21, i22, m, Xud, Yvd, Yrd, Xu, Xuu, Yv, Yvv, Yr, Nv, Nr, Nrr = coefficients
    added = Yvd * v + Yrd * r
    X = tau[0] + m * r * v - added * r - (Xu + Xuu * abs(u)) * u
    Y = tau[1] - m * r * u + Xud * u * r - (Yv + Yvv * abs(v)) * v - Yr * r
    N = tau[2] + added * u - Xud * u * v - Nv * v - (Nr + Nrr * abs(r)) * r
    c, s = np.cos(psi), np.sin(psi)
    return c * u - s * v, s * u + c * v, r, i00 * X, i11 * Y + i12 * N, i21 * Y + i22 * N


@compiled(inline="always")
def propeller(force: float, rudder: float, arm_m: float) -> tuple[float, float, float]:
    """Return surge force, sway force and yaw moment [N, N, N m] of a propeller (thesis eq. 2.23)."""
    sideways = force * np.sin(rudder)
    return force * np.cos(rudder), -sideways, arm_m * sideways


@compiled(inline="always")
def _write(row: Any, values: Any) -> None:
    """Assign each value; for `row[:] = values`, numba would spend seconds compiling an error message."""
    for i, value in enumerate(values):
        row[i] = value


@compiled(inline="always")
def advance(
    i: int,
    eta: Any,
    nu: Any,
    tau: Any,
    coefficients: Any,
    h: float,
    substeps: int,
    reach: float,
    states: Any,
) -> float:
    """Take the Runge-Kutta steps of row i, in place; return its upper bound on the path length [m].

    The arguments are those of `integrate`.
    """
    x, y, p = eta[i, 0], eta[i, 1], eta[i, 2]
    u, v, r = nu[i, 0], nu[i, 1], nu[i, 2]
    c = coefficients[min(i, len(coefficients) - 1)]
    a, b, travel = h / 2, h / 6, 0.0
    for j in range(substeps):
        part = j * tau.shape[1] // substeps
        f = (tau[i, part, 0], tau[i, part, 1], tau[i, part, 2])
        if len(states):
            _write(states[i, j], (x, y, p, u, v, r))
        x0, y0, p0 = x, y, p
        x1, y1, p1, u1, v1, r1 = rate(p, u, v, r, f, c)
        x2, y2, p2, u2, v2, r2 = rate(p + a * p1, u + a * u1, v + a * v1, r + a * r1, f, c)
        x3, y3, p3, u3, v3, r3 = rate(p + a * p2, u + a * u2, v + a * v2, r + a * r2, f, c)
        x4, y4, p4, u4, v4, r4 = rate(p + h * p3, u + h * u3, v + h * v3, r + h * r3, f, c)
        x += b * (x1 + 2 * x2 + 2 * x3 + x4)
        y += b * (y1 + 2 * y2 + 2 * y3 + y4)
        p += b * (p1 + 2 * p2 + 2 * p3 + p4)
        u += b * (u1 + 2 * u2 + 2 * u3 + u4)
        v += b * (v1 + 2 * v2 + 2 * v3 + v4)
        r += b * (r1 + 2 * r2 + 2 * r3 + r4)
        travel += math.hypot(x - x0, y - y0) + reach * abs(p - p0)
    eta[i, 0], eta[i, 1], eta[i, 2] = x, y, p
    nu[i, 0], nu[i, 1], nu[i, 2] = u, v, r
    if len(states):
        _write(states[i, substeps], (x, y, p, u, v, r))
    return travel


@compiled()
def integrate(
    eta: Any, nu: Any, tau: Any, coefficients: Any, h: float, substeps: int, reach: float, states: Any
) -> Any:
    """Take `substeps` Runge-Kutta steps of h seconds for every row; returns new arrays.

    `tau` is (n, k, 3), one row for every substeps / k steps; `coefficients` are (n, 17), or (1, 17) for all
    boats, in the order of `dockctl.sim.vessel.Coefficients`. The third result, (n,) [m], is an upper bound on
    the path length of the outermost point, at `reach` [m]. All states are written to `states`
    (n, substeps + 1, 6), unless it is empty.
    """
    eta, nu, travel = eta.copy(), nu.copy(), np.zeros(len(eta))
    for i in range(len(eta)):
        travel[i] = advance(i, eta, nu, tau, coefficients, h, substeps, reach, states)
    return eta, nu, travel
