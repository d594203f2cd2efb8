"""A ROS 2 node that docks the boat: point clouds and odometry in, propeller force and rudder angle out.

    python3 docking_node.py --ros-args -p policy:=s3.npz -p clouds:="[/lidar/bow, /lidar/stern]"

Subscribes to
    clouds        sensor_msgs/PointCloud2 in the body frame, one topic per LiDAR or one merged cloud
    odometry      nav_msgs/Odometry: pose in the world frame of the goals, twist in the body frame
and, if the policy observes them, in the body frame to
    apparent_wind  geometry_msgs/Vector3Stamped, velocity of the air relative to the boat
    through_water  geometry_msgs/Vector3Stamped, velocity of the boat relative to the water
Publishes, once per control period,
    ~/propeller   std_msgs/Float64, force [N]
    ~/rudder      std_msgs/Float64, angle [rad]
    ~/status      std_msgs/String: the action, or why the boat is stopped

The body frame of the policy is the one of REP 103 at the center of gravity: x forward, y to port, z up; the
water is at z = 0.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import Vector3Stamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64, String

from dockctl.pilot import Checks, Decision, Pilot, Reading

FLOAT32, FLOAT64 = 7, 8  # of sensor_msgs/PointField
PARAMETERS = {
    "policy": "policy.npz",
    "clouds": ["/points"],
    "odometry": "/odometry",
    "apparent_wind": "/apparent_wind",
    "through_water": "/through_water",
    "body_frame": "base_link",
    "max_age_s": 0.5,
    "final": [math.nan] * 3,  # x, y [m], heading [rad]; those of the policy by default
    "intermediate": [math.nan] * 3,
    "hull": [
        3.0,
        1.0,
        3.2,
    ],  # length, beam and height [m] of the box around the boat: points inside are returns from itself
    "water_m": 0.1,  # points below this are returns from the water [m]
}


class DockingNode(Node):
    def __init__(self) -> None:
        super().__init__("docking")
        given = {name: self.declare_parameter(name, value).value for name, value in PARAMETERS.items()}
        final, intermediate = (
            None if np.isnan(given[name]).any() else given[name] for name in ("final", "intermediate")
        )
        self.pilot = Pilot.load(
            given["policy"],
            final=final,
            intermediate=intermediate,
            checks=Checks(max_age_s=given["max_age_s"]),
        )
        self.body_frame, self.hull, self.water_m = given["body_frame"], given["hull"], given["water_m"]
        self.range_m = self.pilot.description["lidar"]["range_m"]
        self.pose: Reading | None = None
        self.velocity: Reading | None = None
        self.clouds: dict[str, Reading | None] = dict.fromkeys(given["clouds"])
        self.flows: dict[str, Reading | None] = dict.fromkeys(self.pilot.flows)
        self.propeller = self.create_publisher(Float64, "~/propeller", 1)
        self.rudder = self.create_publisher(Float64, "~/rudder", 1)
        self.status = self.create_publisher(String, "~/status", 1)
        self.create_subscription(Odometry, given["odometry"], self.on_odometry, qos_profile_sensor_data)
        for topic in self.clouds:
            self.create_subscription(
                PointCloud2,
                topic,
                lambda cloud, topic=topic: self.on_cloud(topic, cloud),
                qos_profile_sensor_data,
            )
        for name in self.flows:
            self.create_subscription(
                Vector3Stamped,
                given[name],
                lambda vector, name=name: self.on_flow(name, vector),
                qos_profile_sensor_data,
            )
        self.create_timer(self.pilot.control_period_s, self.on_timer)

    def on_odometry(self, odometry: Any) -> None:
        if odometry.child_frame_id != self.body_frame:
            self.warn(f"odometry of '{odometry.child_frame_id}', expected '{self.body_frame}'")
            return
        time_s = seconds(odometry.header.stamp)
        position, q = odometry.pose.pose.position, odometry.pose.pose.orientation
        if abs(math.hypot(q.x, q.y, q.z, q.w) - 1) > 0.01:
            self.warn("odometry without an orientation: its quaternion is not of unit length")
            self.pose = None
            return
        heading = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
        twist = odometry.twist.twist
        self.pose = Reading(time_s, (position.x, position.y, heading))
        self.velocity = Reading(time_s, (twist.linear.x, twist.linear.y, twist.angular.z))

    def on_cloud(self, topic: str, cloud: Any) -> None:
        if cloud.header.frame_id != self.body_frame:
            self.warn(f"{topic}: frame '{cloud.header.frame_id}', expected '{self.body_frame}'")
            return
        try:
            points = points_of(cloud)
        except (KeyError, ValueError) as error:
            self.warn(f"{topic}: not x, y and z as FLOAT32 or FLOAT64: {type(error).__name__}: {error}")
            self.clouds[topic] = None
            return
        self.clouds[topic] = Reading(seconds(cloud.header.stamp), self.obstacles(points))

    def on_flow(self, name: str, stamped: Any) -> None:
        if stamped.header.frame_id != self.body_frame:
            self.warn(f"{name}: frame '{stamped.header.frame_id}', expected '{self.body_frame}'")
            return
        self.flows[name] = Reading(seconds(stamped.header.stamp), (stamped.vector.x, stamped.vector.y))

    def obstacles(self, points: np.ndarray) -> np.ndarray:
        """Return the points [m] other than missing returns and those from the boat itself or the water."""
        points = points[np.isfinite(points).all(axis=1)]  # NaN is how drivers mark rays without a return
        length, beam, height = self.hull
        own = (
            (np.abs(points[:, 0]) <= length / 2)
            & (np.abs(points[:, 1]) <= beam / 2)
            & (points[:, 2] <= height)
        )
        far = np.hypot(points[:, 0], points[:, 1]) > self.range_m
        return points[~own & ~far & (points[:, 2] > self.water_m)]

    def on_timer(self) -> None:
        now_s = self.get_clock().now().nanoseconds / 1e9
        self.publish(self.pilot.decide(now_s, self.pose, self.velocity, self.clouds, **self.flows))

    def publish(self, decision: Decision) -> None:
        self.propeller.publish(Float64(data=decision.propeller_n))
        self.rudder.publish(Float64(data=decision.rudder_rad))
        self.status.publish(
            String(data=f"stop: {decision.stop}" if decision.stop else f"action {decision.action}")
        )

    def stop(self) -> None:
        """Command zero thrust."""
        self.publish(Decision(0.0, 0.0, "the node ends", False, self.pilot.phase))

    def warn(self, text: str) -> None:
        self.get_logger().warning(text, throttle_duration_sec=5.0)


def seconds(stamp: Any) -> float:
    return stamp.sec + stamp.nanosec / 1e9


def points_of(cloud: Any) -> np.ndarray:
    """Return x, y and z (k, 3) [m] of a PointCloud2.

    Raises:
        KeyError, ValueError: it has no such fields, or its data do not match its layout.
    """
    fields = {field.name: field for field in cloud.fields}
    order = ">" if cloud.is_bigendian else "<"
    kinds = {FLOAT32: "f4", FLOAT64: "f8"}
    layout = np.dtype(
        {
            "names": ["x", "y", "z"],
            "formats": [order + kinds[fields[name].datatype] for name in "xyz"],
            "offsets": [fields[name].offset for name in "xyz"],
            "itemsize": cloud.point_step,
        }
    )
    rows = np.frombuffer(bytes(cloud.data), np.uint8).reshape(cloud.height, cloud.row_step)
    used = np.ascontiguousarray(rows[:, : cloud.width * cloud.point_step])
    points = used.reshape(-1).view(layout)
    return np.stack([points[name] for name in "xyz"], axis=1).astype(float)


def main() -> None:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # the node can still publish after Ctrl-C
    node = DockingNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.stop()
        node.destroy_node()
        rclpy.shutdown()


if __name__ == "__main__":
    main()
