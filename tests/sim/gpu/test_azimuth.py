"""Sectors on a GPU against arctangents of many digits (mpmath)."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import mpmath
import numpy as np
import pytest

from dockctl.sim.gpu import azimuth


@pytest.mark.parametrize("sectors", [1, 3, 8, 16])
@pytest.mark.parametrize("ulps", [-3, 0, 3])
def test_near_an_edge_the_azimuth_is_correctly_rounded_whatever_the_arctangent(
    sectors: int, ulps: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def inexact(y: float, x: float) -> float:
        value = math.atan2(y, x)
        return float(np.clip(value + ulps * np.spacing(value), -math.pi, math.pi))

    monkeypatch.setattr(azimuth, "math", SimpleNamespace(atan2=inexact, pi=math.pi))
    compiled: Any = azimuth
    monkeypatch.setattr(azimuth, "product", compiled.product.py_func)
    edges, rng = azimuth.edges_of(sectors), np.random.default_rng(sectors)
    for edge in np.linspace(-math.pi, math.pi, sectors + 1):
        for _ in range(50):
            radius, off = rng.uniform(0.1, 100), rng.choice([0.0, 1e-16, -1e-16, 5e-16, -5e-16])
            x, y = radius * math.cos(edge + off), radius * math.sin(edge + off)
            found = compiled.azimuth_of.py_func(x, y, edges)
            with mpmath.workdps(40):
                truth = float(mpmath.atan2(mpmath.mpf(y), mpmath.mpf(x)))
            assert found == truth or abs(found - truth) < 1e-30  # near 0, an ulp is that small
