"""Range sensors that break a rule are rejected."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pytest

from dockctl import testing
from dockctl.plugins import RANGE_SENSORS
from dockctl.scenarios.extensions import RangeSensorSpec, register
from dockctl.sim.lidar.planar import PlanarScanner, PlanarSensor
from dockctl.testing.contract import Rule
from tests.conftest import own_registries
from tests.testing.rejection import assert_rejected


def test_a_sensor_whose_points_do_not_agree_is_rejected() -> None:
    class Long(PlanarSensor):
        def points(self, pose: Any, every: int = 1) -> Any:
            return 2 * super().points(pose, every)

    class Clockwise(PlanarSensor):
        def sector_ranges(self, eta: Any) -> Any:
            return super().sector_ranges(eta)[:, ::-1]

    @register(RANGE_SENSORS)
    class LongScanner(PlanarScanner):
        kind: Literal["long"] = "long"  # type: ignore[assignment]

        def build(self, triangles: Any) -> Any:
            return Long(self, triangles)

    @register(RANGE_SENSORS)
    class ClockwiseScanner(PlanarScanner):
        kind: Literal["clockwise"] = "clockwise"  # type: ignore[assignment]

        def build(self, triangles: Any) -> Any:
            return Clockwise(self, triangles)

    for scanner in (LongScanner, ClockwiseScanner):
        assert issubclass(scanner, RangeSensorSpec)
        kind = scanner.model_fields["kind"].default
        assert_rejected(lambda kind=kind: testing.check_range_sensor(kind), "consistent")  # type: ignore[misc]


class Fixed(PlanarSensor):
    """Does not turn with the boat."""

    def sector_ranges(self, eta: Any) -> Any:
        return super().sector_ranges(eta * [1, 1, 0] + [0, 0, 0.1])

    def noisy_sector_ranges(self, eta: Any, noise: Any) -> Any:
        return super().noisy_sector_ranges(eta * [1, 1, 0] + [0, 0, 0.1], noise)

    def points(self, pose: Any, every: int = 1) -> Any:
        return super().points(pose * [1, 1, 0] + [0, 0, 0.1], every)


class Far(PlanarSensor):
    """Scans farther than its range."""

    def __init__(self, spec: Any, triangles: Any) -> None:
        super().__init__(spec.model_copy(update={"range_m": 100.0}), triangles)


class Everywhere(PlanarSensor):
    """Has a point for a ray that returns nothing."""

    def points(self, pose: Any, every: int = 1) -> Any:
        points = super().points(pose, every)
        return points if len(points) else np.array([[self.spec.range_m, 0.0, 1.0]])


class ChangesSurface(PlanarSensor):
    """Moves the harbor that it is built in."""

    def __init__(self, spec: Any, triangles: Any) -> None:
        triangles += 1.0
        super().__init__(spec, triangles)


@pytest.mark.parametrize(
    ("sensor", "rule"),
    [(Fixed, "consistent"), (Far, "in_range"), (Everywhere, "consistent"), (ChangesSurface, "pure")],
)
def test_sensors_that_break_a_rule_are_rejected(sensor: type[PlanarSensor], rule: Rule) -> None:
    class Scanner(PlanarScanner):
        kind: Literal["wrong"] = "wrong"  # type: ignore[assignment]

        def build(self, triangles: Any) -> Any:
            return sensor(self, triangles)

    with own_registries():
        register(RANGE_SENSORS)(Scanner)
        assert_rejected(lambda: testing.check_range_sensor("wrong"), rule)


def test_a_sensor_with_a_list_is_rejected() -> None:
    class Scanner(PlanarScanner):
        kind: Literal["listed"] = "listed"  # type: ignore[assignment]
        heights_m: list[float] = [1.0]

    with own_registries():
        register(RANGE_SENSORS)(Scanner)
        assert_rejected(lambda: testing.check_range_sensor("listed"), "valid")


def test_a_sensor_whose_noise_does_not_follow_the_seeds_is_rejected() -> None:
    common = np.random.default_rng(0)

    class Noisy(PlanarSensor):
        def noisy_sector_ranges(self, eta: Any, noise: Any) -> Any:
            ranges = self.sector_ranges(eta)
            return ranges * common.uniform(0.9, 1.0, ranges.shape)

    @register(RANGE_SENSORS)
    class NoisyScanner(PlanarScanner):
        kind: Literal["noisy"] = "noisy"  # type: ignore[assignment]

        def build(self, triangles: Any) -> Any:
            return Noisy(self, triangles)

    assert issubclass(NoisyScanner, RangeSensorSpec)
    assert_rejected(lambda: testing.check_range_sensor("noisy"), "independent_rows")
