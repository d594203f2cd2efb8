"""The conditions of a scenario for n boats, combined for `Simulator`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any
from zlib import crc32

import numpy as np

from dockctl.errors import Code, DockctlError, require_shape
from dockctl.geometry import Floats, Ints
from dockctl.plugins import CONDITIONS, Guard
from dockctl.runs.tables import EVALUATION, EVALUATIONS, MAP
from dockctl.scenarios.base import FieldError
from dockctl.scenarios.extensions import Disturbance, RangeNoise
from dockctl.scenarios.schema import Scenario
from dockctl.scenarios.vessel import SCALABLE
from dockctl.sim.starts import Start

RESULTS = frozenset({*EVALUATION, *EVALUATIONS, *MAP})
"""Columns that no value of a condition may have."""


class ConditionError(DockctlError):
    """A condition does not match the rest of its scenario, which shows only when it runs.

    Attributes:
        field: dotted path of its field in the scenario.
        reason: what was found and what is allowed, without the field.
    """

    def __init__(self, field: str, reason: str, code: Code) -> None:
        super().__init__(f"{field}: {reason}", code=code)
        self.field, self.reason = field, reason


class Disturbances:
    """All conditions of a scenario, in the order of the scenario; errors name the condition.

    Raises:
        PluginError: a condition cannot be built.
        ConditionError: two conditions cannot be combined.
    """

    def __init__(self, scenario: Scenario, num_boats: int) -> None:
        self._boats = num_boats
        self._all: dict[str, tuple[Guard, Disturbance]] = {}
        for name, condition in scenario.conditions.items():
            with (guard := Guard(CONDITIONS, condition.kind)):
                built = condition.fitted(scenario.vessel).build(num_boats)
                if not isinstance(built, Disturbance):
                    raise TypeError(f"build returned {built!r}, not a Disturbance")
                self._all[name] = guard, built
        first: dict[str, str] = {}  # the name of the first condition, by what it does
        for name, condition in scenario.conditions.items():
            does = f"is a condition of kind {condition.kind}" if condition.is_single else ""
            if type(self._all[name][1]).range_noise is not Disturbance.range_noise:
                does = "adds noise to the range sensor"
            if does and first.setdefault(does, name) != name:
                message = f"{does}, like '{first[does]}', and the two do not add up; leave one of them out"
                raise ConditionError(f"conditions.{name}", message, "mismatch")

    def __iter__(self) -> Iterator[Disturbance]:
        return (disturbance for _, disturbance in self._all.values())

    def __len__(self) -> int:
        return len(self._all)

    def define(self, hook: str) -> bool:
        """Return whether a condition overrides this hook of `Disturbance`."""
        return any(getattr(type(each), hook) is not getattr(Disturbance, hook) for each in self)

    def reset(self, rows: Ints, starts: Sequence[Start], rngs: Sequence[np.random.Generator]) -> None:
        """Begin an episode in each of the rows (k,); the seed of its start replaces its generator.

        Each condition draws from generators of its own, which depend on its name: without it, or with other
        values, the others are the same.
        """
        if not self._all:
            return
        seeds = [
            int(rngs[i].integers(2**63)) if start.seed is None else start.seed
            for i, start in enumerate(starts)
        ]
        for name, (guard, disturbance) in self._all.items():
            own = crc32(name.encode())
            with guard:
                disturbance.reset(rows, [np.random.default_rng([seed, own]) for seed in seeds])

    def advance(self, period_s: float) -> None:
        """Advance to the next control period."""
        for guard, disturbance in self._all.values():
            with guard:
                disturbance.advance(period_s)

    def state(self) -> list[Any]:
        """Return the states of the conditions in their order."""
        states = []
        for guard, disturbance in self._all.values():
            with guard:
                states.append(disturbance.state())
        return states

    def restore(self, states: Sequence[Any]) -> None:
        """Continue from what `state` returned."""
        for (guard, disturbance), own in zip(self._all.values(), states, strict=True):
            with guard:
                disturbance.restore(own)

    def sum(self, hook: str, columns: int, *arguments: Any) -> Floats:
        """Return the sum (n, columns) of a hook over all conditions.

        Raises:
            DockctlError: a condition failed, or returned another shape or a value that is not finite.
        """
        total = np.zeros((self._boats, columns))
        for guard, disturbance in self._all.values():
            with guard:
                value = np.asarray(getattr(disturbance, hook)(*arguments))
                if value.ndim or value:  # the default is the scalar 0
                    _require_valid(disturbance, hook, value, total.shape)
                total += value
        return total

    def actuate(self, commands: Floats, substep_s: float) -> Floats:
        """Return the forces and angles of the actuators, (n, substeps, 2), at commands of the same shape.

        Raises:
            DockctlError: a condition failed, or returned another shape or a value that is not finite.
        """
        actual = commands
        for guard, disturbance in self._all.values():
            with guard:
                actual = disturbance.actuate(actual, substep_s)
                _require_valid(disturbance, "actuate", actual, commands.shape)
        return actual

    def coefficient_factors(self) -> Mapping[str, Floats]:
        """Return the factors (n,) of the vessel's coefficients by name.

        Raises:
            DockctlError: the vessel has no such coefficient, or a factor is not a positive number.
        """
        factors = dict[str, Floats]()
        for guard, disturbance in self._all.values():
            with guard:
                for name, factor in disturbance.coefficient_factors().items():
                    if name not in SCALABLE:
                        reason = f"'{name}' is not one of the coefficients {', '.join(SCALABLE)}"
                        raise ValueError(f"coefficient_factors: {reason}")
                    require_shape("coefficient_factors", np.shape(factor), (self._boats,))
                    if not ((np.asarray(factor) > 0) & np.isfinite(factor)).all():
                        reason = f"a factor of '{name}' is not a positive number"
                        raise ValueError(f"coefficient_factors: {reason}")
                    factors[name] = factors.get(name, 1.0) * factor
        return factors

    def range_noise(self) -> RangeNoise | None:
        """Return the noise of the next scan, if a condition defines it."""
        for guard, disturbance in self._all.values():
            with guard:
                if (noise := disturbance.range_noise()) is not None:
                    if not isinstance(noise, RangeNoise):
                        raise TypeError(f"range_noise returned {noise!r}, not a RangeNoise")
                    return noise
        return None

    def reported_ranges(self, ranges: Floats, rows: Ints, range_m: float) -> Floats:
        """Return what the sensor reports of the ranges (k, sectors) [m] that the boats `rows` (k,) scan.

        Raises:
            ConditionError: a condition does not match the sensor.
        """
        for name, (guard, disturbance) in self._all.items():
            try:
                with guard:
                    reported = disturbance.reported_ranges(ranges, rows, range_m)
                    _require_valid(disturbance, "reported_ranges", reported, ranges.shape)
                    ranges = reported
            except FieldError as error:
                raise ConditionError(f"conditions.{name}.{error.field}", error.message, error.code) from None
        return ranges

    def episode(self) -> dict[str, Floats]:
        """Return what the conditions drew for each boat's episode (n,), by ``<condition>_<value>``.

        Raises:
            ConditionError: a result or another condition already has this name.
        """
        drawn = dict[str, Floats]()
        for name, (guard, disturbance) in self._all.items():
            with guard:
                for key, value in disturbance.episode().items():
                    require_shape(f"{type(disturbance).__name__}.episode", np.shape(value), (self._boats,))
                    column = f"{name}_{key}"
                    if column in RESULTS or column in drawn:
                        reason = f"its '{key}' needs the column {column}, which is taken; use another name"
                        raise ConditionError(f"conditions.{name}", reason, "duplicate")
                    drawn[column] = np.array(value, float)
        return drawn


def _require_valid(disturbance: Disturbance, hook: str, values: Floats, shape: tuple[int, ...]) -> None:
    """Check what a hook returned.

    Raises:
        DockctlError: another shape.
        ValueError: a value that is not finite.
    """
    who = f"{type(disturbance).__name__}.{hook}"
    require_shape(who, values.shape, shape)
    if not np.isfinite(values).all():
        raise ValueError(f"{who} returned a value that is not finite")
