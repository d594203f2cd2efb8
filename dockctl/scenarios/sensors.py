"""LiDARs as data (thesis Tables 3.2 and 3.3)."""

from __future__ import annotations

from pydantic import Field

from dockctl.scenarios.base import Count, Model, NonNegative, Number, Positive


class LidarMount(Model):
    """Where a LiDAR sits in the body frame: ``R = Rz(yaw) Ry(pitch) Rx(roll)`` (eq. 3.2).

    Pitch > 0 looks down.
    """

    roll_deg: Number = 0.0
    pitch_deg: Number
    yaw_deg: Number
    x_m: Number
    y_m: Number
    z_m: NonNegative


THESIS_MOUNTS = (
    LidarMount(pitch_deg=27.0, yaw_deg=0.0, x_m=1.0, y_m=0.0, z_m=3.0),
    LidarMount(pitch_deg=50.0, yaw_deg=90.0, x_m=0.0, y_m=0.5, z_m=3.0),
    LidarMount(pitch_deg=35.0, yaw_deg=180.0, x_m=-1.0, y_m=0.0, z_m=3.0),
    LidarMount(pitch_deg=50.0, yaw_deg=270.0, x_m=0.0, y_m=-0.5, z_m=3.0),
)


class Lidar(Model):
    """A set of equal spinning LiDARs and the sectors that their points are reduced to (eqs. 3.7, 3.8)."""

    channels: Count = Field(default=16, le=1024)
    lowest_channel_deg: Number = -15.0
    highest_channel_deg: Number = 15.0
    azimuth_steps: Count = Field(default=1800, le=50_000, description="firings a turn; 1800: every 0.2°")
    range_m: Positive = 100.0
    sectors: Count = Field(default=8, le=1024)
    mounts: tuple[LidarMount, ...] = Field(default=THESIS_MOUNTS, min_length=1, max_length=64)


class Sensors(Model):
    lidar: Lidar = Lidar()
