"""The example of a ROS 2 node, with stubs of rclpy and its messages: clouds and odometry become commands."""

from __future__ import annotations

import math
import re
import shlex
import struct
import sys
from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from dockctl.experiments.portable import export_files
from dockctl.pilot import Pilot, Reading

NODE = Path(__file__).parents[1] / "examples" / "ros2" / "docking_node.py"
POINTS = [(8.0, 1.0, 0.5), (-4.0, -3.0, 1.0), (0.5, 6.0, 0.2)]
DROPPED = [(math.nan, 0.0, 0.0), (0.5, 0.2, 1.0), (5.0, 0.0, -0.2), (150.0, 0.0, 1.0)]
"""No return, the own boat, the water, and beyond the range."""


class Node:
    """What the example uses of rclpy.node.Node."""

    given: dict[str, Any] = {}

    def __init__(self, name: str) -> None:
        self.now_ns, self.published, self.warnings = 0, {}, []
        self.callbacks: dict[str, Callable[[Any], None]] = {}
        self.timer: tuple[float, Callable[[], None]]

    def declare_parameter(self, name: str, default: Any) -> Any:
        return SimpleNamespace(value=self.given.get(name, default))

    def create_publisher(self, kind: type, topic: str, depth: int) -> Any:
        def publish(message: Any) -> None:
            assert isinstance(message, kind)
            self.published[topic] = message.data

        return SimpleNamespace(publish=publish)

    def create_subscription(self, kind: type, topic: str, callback: Any, qos: Any) -> None:
        self.callbacks[topic] = callback

    def create_timer(self, period_s: float, callback: Callable[[], None]) -> None:
        self.timer = period_s, callback

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=self.now_ns))

    def get_logger(self) -> Any:
        return SimpleNamespace(warning=lambda text, **_: self.warnings.append(text))

    def destroy_node(self) -> None:
        pass


def stub(name: str, **content: Any) -> dict[str, ModuleType]:
    module = ModuleType(name)
    vars(module).update(content)
    return {name: module}


@pytest.fixture
def node(s3_pilot: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    messages = {
        name: type(name, (SimpleNamespace,), {})
        for name in ("Odometry", "PointCloud2", "Vector3Stamped", "Float64", "String")
    }
    modules = {
        **stub("rclpy", init=lambda **_: None, spin=lambda node: None, shutdown=lambda: None),
        **stub("rclpy.node", Node=Node),
        **stub("rclpy.qos", qos_profile_sensor_data="sensor data"),
        **stub("rclpy.signals", SignalHandlerOptions=SimpleNamespace(NO=0)),
        **stub("geometry_msgs.msg", Vector3Stamped=messages["Vector3Stamped"]),
        **stub("nav_msgs.msg", Odometry=messages["Odometry"]),
        **stub("sensor_msgs.msg", PointCloud2=messages["PointCloud2"]),
        **stub("std_msgs.msg", Float64=messages["Float64"], String=messages["String"]),
        **{name: ModuleType(name) for name in ("geometry_msgs", "nav_msgs", "sensor_msgs", "std_msgs")},
    }
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(Node, "given", {"policy": str(s3_pilot), "clouds": ["/bow", "/stern"]})
    spec = spec_from_file_location("docking_node", NODE)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    made = module.DockingNode()
    made.module = module
    return made


def header(time_s: float, frame: str) -> Any:
    whole = math.floor(time_s)
    return SimpleNamespace(
        frame_id=frame, stamp=SimpleNamespace(sec=whole, nanosec=round((time_s - whole) * 1e9))
    )


def odometry(time_s: float, frame: str = "base_link") -> Any:
    """At (23, -10) m, heading 90°, at 0.2 m/s ahead."""
    half = math.pi / 4
    return SimpleNamespace(
        header=header(time_s, "map"),
        child_frame_id=frame,
        pose=SimpleNamespace(
            pose=SimpleNamespace(
                position=SimpleNamespace(x=23.0, y=-10.0, z=0.0),
                orientation=SimpleNamespace(x=0.0, y=0.0, z=math.sin(half), w=math.cos(half)),
            )
        ),
        twist=SimpleNamespace(
            twist=SimpleNamespace(
                linear=SimpleNamespace(x=0.2, y=-0.05, z=0.0), angular=SimpleNamespace(x=0.0, y=0.0, z=0.01)
            )
        ),
    )


def vector(time_s: float, x: float, y: float, frame: str = "base_link") -> Any:
    return SimpleNamespace(header=header(time_s, frame), vector=SimpleNamespace(x=x, y=y, z=0.0))


def cloud(time_s: float, points: list[tuple[float, ...]], frame: str = "base_link") -> Any:
    """Two rows, padded at their ends, with an intensity between the coordinates."""
    half = -(-len(points) // 2)
    points = points + [(math.nan,) * 3] * (2 * half - len(points))
    rows = [
        b"".join(struct.pack("<ffHxxf", x, y, 7, z) for x, y, z in row) + bytes(5)
        for row in (points[:half], points[half:])
    ]
    fields = [
        SimpleNamespace(name=name, offset=offset, datatype=kind)
        for name, offset, kind in (("x", 0, 7), ("y", 4, 7), ("intensity", 8, 4), ("z", 12, 7))
    ]
    return SimpleNamespace(
        header=header(time_s, frame),
        fields=fields,
        is_bigendian=False,
        point_step=16,
        row_step=16 * half + 5,
        width=half,
        height=2,
        data=b"".join(rows),
    )


def tick(node: Any, time_s: float) -> dict[str, Any]:
    node.now_ns = round(time_s * 1e9)
    node.timer[1]()
    return dict(node.published)


def test_clouds_and_odometry_become_commands(node: Any, s3_pilot: Path) -> None:
    assert node.timer[0] == 0.5
    before = tick(node, 1.0)
    assert (before["~/propeller"], before["~/rudder"]) == (0, 0)
    assert before["~/status"].startswith("stop: pose")
    node.callbacks["/odometry"](odometry(1.2))
    node.callbacks["/bow"](cloud(1.3, POINTS[:2] + DROPPED))
    assert tick(node, 1.5)["~/status"].startswith("stop: cloud '/stern'")
    node.callbacks["/stern"](cloud(1.4, POINTS[2:]))
    after = tick(node, 1.6)
    alone = Pilot.load(s3_pilot)
    expected = alone.decide(
        0.0,
        Reading(0.0, (23.0, -10.0, math.pi / 2)),
        Reading(0.0, (0.2, -0.05, 0.01)),
        {"all": Reading(0.0, np.array(POINTS, np.float32))},
    )
    assert after == {
        "~/propeller": expected.propeller_n,
        "~/rudder": expected.rudder_rad,
        "~/status": f"action {expected.action}",
    }


def test_a_policy_that_observes_wind_and_current(
    node: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "/apparent_wind" not in node.callbacks  # the policy of scenario 3 has no use for it
    policy, goals = (
        tmp_path / "weather.npz",
        {"final": [36.0, 0.0, math.pi], "intermediate": [18.0, 3.0, 2.6]},
    )
    export_files([Path("marinas-weather")], None, policy)
    monkeypatch.setattr(Node, "given", {**Node.given, "policy": str(policy), **goals})
    sailor = node.module.DockingNode()
    flows = {"apparent_wind": (-3.0, 1.0), "through_water": (0.3, -0.05)}
    for topic, make in (("/odometry", odometry), ("/bow", cloud), ("/stern", cloud)):
        sailor.callbacks[topic](make(1.0, *([POINTS] if make is cloud else [])))
    sailor.callbacks["/apparent_wind"](vector(1.0, *flows["apparent_wind"]))
    sailor.callbacks["/through_water"](vector(1.0, *flows["through_water"], frame="log"))
    assert len(sailor.warnings) == 1
    assert tick(sailor, 1.1)["~/status"].startswith("stop: through_water")
    sailor.callbacks["/through_water"](vector(1.2, *flows["through_water"]))
    expected = Pilot.load(policy, **goals).decide(
        1.2,
        Reading(1.0, (23.0, -10.0, math.pi / 2)),
        Reading(1.0, (0.2, -0.05, 0.01)),
        {"all": Reading(1.0, np.array(POINTS, np.float32))},
        **{name: Reading(1.2, value) for name, value in flows.items()},
    )
    assert tick(sailor, 1.2)["~/status"] == f"action {expected.action}"


def test_the_command_of_the_page_gives_parameters_that_the_node_has(
    node: Any, s3_pilot: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (NODE.parent / "README.md").read_text(encoding="utf-8")
    (line,) = re.findall(r"^python3 docking_node\.py --ros-args (.+)$", page, re.M)
    given = dict(word.split(":=") for word in shlex.split(line) if word != "-p")
    values = {name: yaml.safe_load(value) for name, value in given.items()}
    assert values.pop("policy") == "s3.npz"
    monkeypatch.setattr(Node, "given", {"policy": str(s3_pilot), **values})
    assert {*values} <= {*node.module.PARAMETERS}
    assert {*node.module.DockingNode().callbacks} == {*values["clouds"], values["odometry"]}


def test_old_messages_stop_the_boat(node: Any) -> None:
    for time_s, late, stops in (
        (1.0, "", ""),
        (2.0, "/bow", "cloud '/bow'"),
        (3.0, "/odometry", "pose"),
        (4.0, "", ""),
    ):
        for topic, make in (("/odometry", odometry), ("/bow", cloud), ("/stern", cloud)):
            if topic != late:
                node.callbacks[topic](make(time_s, *([POINTS] if make is cloud else [])))
        published = tick(node, time_s + 0.1)
        assert published["~/status"].startswith(f"stop: {stops}" if stops else "action")
        assert not stops or (published["~/propeller"], published["~/rudder"]) == (0, 0)


def test_messages_in_another_frame_are_not_used(node: Any) -> None:
    node.callbacks["/odometry"](odometry(1.0, frame="gps"))
    node.callbacks["/bow"](cloud(1.0, POINTS, frame="velodyne"))
    assert len(node.warnings) == 2
    assert (node.pose, node.clouds["/bow"]) == (None, None)


@pytest.mark.parametrize("flaw", ["data", "field", "datatype", "row_step", "point_step"])
def test_a_malformed_cloud_stops_the_boat(node: Any, flaw: str) -> None:
    node.callbacks["/odometry"](odometry(1.0))
    node.callbacks["/bow"](cloud(1.0, POINTS))
    broken = cloud(1.0, POINTS)
    if flaw == "data":
        broken.data = broken.data[:-7]
    elif flaw == "field":
        broken.fields.pop()
    elif flaw == "datatype":
        broken.fields[0].datatype = 3
    else:
        setattr(broken, flaw, 8 * (flaw == "point_step"))
    node.callbacks["/bow"](broken)
    assert node.warnings[-1].startswith("/bow")
    published = tick(node, 1.1)
    assert published["~/status"].startswith("stop: ")
    assert (published["~/propeller"], published["~/rudder"]) == (0, 0)


def test_odometry_without_an_orientation_stops_the_boat(node: Any) -> None:
    node.callbacks["/odometry"](odometry(1.0))
    node.callbacks["/bow"](cloud(1.0, POINTS))
    blank = odometry(1.0)
    blank.pose.pose.orientation = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=0.0)
    node.callbacks["/odometry"](blank)
    assert tick(node, 1.1)["~/status"].startswith("stop: pose")


def test_the_node_stops_the_boat_when_it_ends(node: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node.module, "DockingNode", lambda: node)
    node.published.update({"~/propeller": 50.0})

    def interrupt(node: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(node.module.rclpy, "spin", interrupt)
    node.module.main()
    assert (node.published["~/propeller"], node.published["~/rudder"]) == (0, 0)
