"""Configuration of spinning LiDARs (thesis Tables 3.2 and 3.3)."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from dockctl.geometry import Floats
from dockctl.plugins import RANGE_SENSORS
from dockctl.scenarios.base import Count, FieldError, Model, NonNegative, Number
from dockctl.scenarios.extensions import RangeSensor, RangeSensorSpec, register

MAX_ARM_M = 20.0
"""Maximum lever arm of a LiDAR; the scan tables grow with the square of its distance from the origin."""
MAX_RAYS = 2_000_000
"""Maximum number of rays of a scan; building their tables takes up to 0.6 GB."""
Arm = Annotated[Number, Field(ge=-MAX_ARM_M, le=MAX_ARM_M)]


class LidarMount(Model):
    """Where a LiDAR is mounted in the body frame: ``R = Rz(yaw) Ry(pitch) Rx(roll)`` (eq. 3.2).

    Pitch > 0 looks down.
    """

    roll_deg: Number = 0.0
    pitch_deg: Number
    yaw_deg: Number
    x_m: Arm
    y_m: Arm
    z_m: Annotated[NonNegative, Field(le=MAX_ARM_M)]


# Of the table of rays; measured.
RAY_BYTES = 40  # per ray of a scan
RUN_BYTES = 29_000  # per channel and sector, for the cells in which it has rays

THESIS_MOUNTS = (
    LidarMount(pitch_deg=27.0, yaw_deg=0.0, x_m=1.0, y_m=0.0, z_m=3.0),
    LidarMount(pitch_deg=50.0, yaw_deg=90.0, x_m=0.0, y_m=0.5, z_m=3.0),
    LidarMount(pitch_deg=35.0, yaw_deg=180.0, x_m=-1.0, y_m=0.0, z_m=3.0),
    LidarMount(pitch_deg=50.0, yaw_deg=270.0, x_m=0.0, y_m=-0.5, z_m=3.0),
)


@register(RANGE_SENSORS, source="Tables 3.2, 3.3")
class SpinningLidars(RangeSensorSpec):
    """Identical spinning LiDARs, by default four VLP-16, with points reduced to sectors (eqs. 3.7, 3.8)."""

    examples = ({"azimuth_steps": 90},)
    kind: Literal["spinning"] = "spinning"
    channels: Count = Field(default=16, le=1024)
    lowest_channel_deg: Number = -15.0
    highest_channel_deg: Number = 15.0
    azimuth_steps: Count = Field(
        default=1800, le=50_000, description="firings per revolution; 1800: every 0.2°"
    )
    mounts: tuple[LidarMount, ...] = Field(default=THESIS_MOUNTS, min_length=1, max_length=64)

    @model_validator(mode="after")
    def _few_rays(self) -> Self:
        if self.rays > MAX_RAYS:
            message = f"{self.rays:,} rays of mounts x channels x azimuth_steps, at most {MAX_RAYS:,}"
            raise FieldError("azimuth_steps", message, "out_of_range")
        return self

    @property
    def is_symmetric(self) -> bool:
        return {_key(m, 1) for m in self.mounts} == {_key(m, -1) for m in self.mounts}

    @property
    def origins(self) -> tuple[tuple[float, float, float], ...]:
        return tuple((mount.x_m, mount.y_m, mount.z_m) for mount in self.mounts)

    @property
    def rays(self) -> int:
        """Number of rays of a scan."""
        return len(self.mounts) * self.channels * self.azimuth_steps

    @property
    def shared_bytes(self) -> int:
        return RAY_BYTES * self.rays + RUN_BYTES * len(self.mounts) * self.channels * self.sectors

    def build(self, triangles: Floats) -> RangeSensor:
        from dockctl.sim.lidar.spinning_sensor import (
            SpinningSensor,  # compiles on import: not for checking a scenario
        )

        return SpinningSensor(self, triangles)


def _key(mount: LidarMount, side: int) -> tuple[float, ...]:
    """Return the values of a mount, or with `side` -1 those of its mirror image."""
    roll, pitch, yaw = (
        angle % 360 for angle in (side * mount.roll_deg, mount.pitch_deg, side * mount.yaw_deg)
    )
    return roll, pitch, yaw, mount.x_m, side * mount.y_m, mount.z_m
