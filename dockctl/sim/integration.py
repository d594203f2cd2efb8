"""The equations of motion of `dockctl.sim.vessel`, written out by element and compiled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dockctl.compute import compiled

# pi / 2 as a sum of three: the first two have trailing zeros, so that small multiples of them are exact.
HALF_PI = (1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
TO_INTEGER = 1.5 * 2.0**52  # a double plus this, minus this, is rounded to an integer


@compiled(inline="always")
def cos_sin(angle: float) -> Any:
    """Return cosine and sine of an angle [rad] without calls and branches.

    A loop over boats with them becomes vector instructions. They are accurate to 2.1e-16 for angles up to
    100,000, but do not have the same bits as those of the C library. Polynomials and parts of pi / 2 as in
    fdlibm 5.3 (Sun Microsystems 1993: k_sin.c, k_cos.c, e_rem_pio2.c).
    """
    quarters = angle * (2 / math.pi) + TO_INTEGER - TO_INTEGER
    x = angle - quarters * HALF_PI[0] - quarters * HALF_PI[1] - quarters * HALF_PI[2]
    z = x * x
    tail = 2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)
    tail = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * tail)
    sine = x + x * z * (-1.66666666666666324348e-01 + z * tail)
    tail = -2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)
    tail = -1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + z * tail)
    cosine = 1 - z / 2 + z * z * (4.16666666666666019037e-02 + z * tail)
    halves = quarters / 2 - 0.25 + TO_INTEGER - TO_INTEGER  # rounded down, like the turns
    turns = halves / 2 - 0.25 + TO_INTEGER - TO_INTEGER
    sign = 1 - 2 * (halves - 2 * turns)
    odd = quarters != 2 * halves
    return sign * (-sine if odd else cosine), sign * (cosine if odd else sine)


@compiled(inline="always")
def rate(psi: float, u: float, v: float, r: float, tau: Any, coefficients: Any, simd: bool) -> Any:
    """Return the time derivatives of x, y, psi, u, v, r of one boat (thesis eqs. 2.5, 2.8).

    With `simd`, cosine and sine are those of `cos_sin`.
    """
    i00, i11, i12, i21, i22, m, Xud, Yvd, Yrd, Xu, Xuu, Yv, Yvv, Yr, Nv, Nr, Nrr = coefficients
    added = Yvd * v + Yrd * r
    X = tau[0] + m * r * v - added * r - (Xu + Xuu * abs(u)) * u
    Y = tau[1] - m * r * u + Xud * u * r - (Yv + Yvv * abs(v)) * v - Yr * r
    N = tau[2] + added * u - Xud * u * v - Nv * v - (Nr + Nrr * abs(r)) * r
    c, s = cos_sin(psi) if simd else (np.cos(psi), np.sin(psi))
    return c * u - s * v, s * u + c * v, r, i00 * X, i11 * Y + i12 * N, i21 * Y + i22 * N


@compiled(inline="always")
def runge_kutta(
    p: float, u: float, v: float, r: float, tau: Any, coefficients: Any, h: float, simd: bool
) -> Any:
    """Return the changes of x, y, psi, u, v, r in one Runge-Kutta step of h seconds; see `rate`."""
    a, b = h / 2, h / 6
    x1, y1, p1, u1, v1, r1 = rate(p, u, v, r, tau, coefficients, simd)
    x2, y2, p2, u2, v2, r2 = rate(p + a * p1, u + a * u1, v + a * v1, r + a * r1, tau, coefficients, simd)
    x3, y3, p3, u3, v3, r3 = rate(p + a * p2, u + a * u2, v + a * v2, r + a * r2, tau, coefficients, simd)
    x4, y4, p4, u4, v4, r4 = rate(p + h * p3, u + h * u3, v + h * v3, r + h * r3, tau, coefficients, simd)
    return (
        b * (x1 + 2 * x2 + 2 * x3 + x4),
        b * (y1 + 2 * y2 + 2 * y3 + y4),
        b * (p1 + 2 * p2 + 2 * p3 + p4),
        b * (u1 + 2 * u2 + 2 * u3 + u4),
        b * (v1 + 2 * v2 + 2 * v3 + v4),
        b * (r1 + 2 * r2 + 2 * r3 + r4),
    )


@compiled(inline="always")
def propeller(force: float, rudder: float, arm_m: float) -> tuple[float, float, float]:
    """Return surge force, sway force and yaw moment [N, N, N m] of a propeller (thesis eq. 2.23)."""
    c, s = cos_sin(rudder)
    sideways = force * s
    return force * c, -sideways, arm_m * sideways


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
    travel = 0.0
    for j in range(substeps):
        part = j * tau.shape[1] // substeps
        f = (tau[i, part, 0], tau[i, part, 1], tau[i, part, 2])
        if len(states):
            _write(states[i, j], (x, y, p, u, v, r))
        dx, dy, dp, du, dv, dr = runge_kutta(p, u, v, r, f, c, h, False)
        x0, y0, p0 = x, y, p
        x, y, p, u, v, r = x + dx, y + dy, p + dp, u + du, v + dv, r + dr
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
