"""``dockctl show``: drawings, distances and invalid poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from dockctl.commands.options import parse_pose
from dockctl.commands.show import sector_table
from dockctl.errors import DockctlError
from dockctl.experiments.show import berths, show
from dockctl.geometry import pose_array
from dockctl.reports import style
from dockctl.reports.show import Scan, harbor_figure
from dockctl.reports.style import figure_style
from dockctl.scenarios.loader import load
from dockctl.sim.harbor.build import build_harbor
from dockctl.sim.lidar.spinning_sensor import SpinningSensor
from dockctl.sim.starts import own_site
from dockctl.sim.world import build_worlds
from tests.commands.conftest import SAVEFIG, dockctl
from tests.reports.synthetic import marina

PONTOON = Path(__file__).parents[2] / "examples" / "custom-harbor" / "s1-pontoon.yaml"
DRAWINGS = ("harbor", "marina-3d", "point-cloud", "sectors")


def test_the_berths_of_a_task_by_kind() -> None:
    """Poses of the berths that the file lists: x of the east and west berths, y as in the list."""
    found = berths(load("marina").scenario)
    expected = {
        "trained": {
            36.0: [-27, -18, -14, -5, 4, 13, 18, 22, 31],
            7.0: [-33, -24, -20, -11, -6, 3, 12, 21, 25],
        },
        "held_out": {36.0: [-23, -9, 0, 9, 27], 7.0: [-29, -15, -2, 7, 16]},
    }
    for kind, columns in expected.items():
        for x, y in columns.items():
            poses = found[kind][np.isclose(found[kind][:, 0], x)]
            np.testing.assert_allclose(np.sort(poses[:, 1]), y, atol=1e-9)
    assert berths(load("s3").scenario) == {}


def test_poses_are_free_as_in_an_evaluation() -> None:
    """Where other boats of the marina are moored depends on the berth of the task."""
    loaded = load("marina")
    world = build_worlds(loaded.scenario, loaded.base_dir)[own_site(loaded.scenario).harbor]
    for pose in ("36,-23,180", "7,7,0"):
        assert not world.obstacles.blocked(pose_array(show(loaded, parse_pose(pose)).pose)[None])
    blocked = parse_pose("7,-2,0")
    assert world.obstacles.blocked(pose_array(blocked)[None])
    with pytest.raises(DockctlError, match=r"--pose: .* is blocked by the moored sailing boat"):
        show(loaded, blocked)


def test_berths_are_drawn_with_a_legend() -> None:
    scenario = load("marina").scenario
    with figure_style():
        ax = harbor_figure(marina(), scenario, berths(scenario)).axes[0]
    drawn = {line.get_label(): len(np.asarray(line.get_xdata())) for line in ax.lines}
    assert drawn == {"trained berths": 18, "held-out berths": 10}
    legend = ax.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["trained berths", "held-out berths"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "source",
    [pytest.param("s3", marks=pytest.mark.thorough), str(PONTOON)],
    ids=["s3", "s1-pontoon"],
)
def test_four_drawings_and_the_distances(
    source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Figure, "savefig", SAVEFIG)
    monkeypatch.setitem(style.STYLE, "savefig.dpi", style.DPI)
    outcome = dockctl("show", source, "--pose", "25,1.5,170")
    assert outcome.code == 0
    folder = tmp_path / "figures" / "show" / Path(source).stem
    written = [folder / f"{name}.{kind}" for name in DRAWINGS for kind in ("png", "svg")]
    assert all(path.stat().st_size > 10_000 for path in written)
    assert all(path.stat().st_size < 2_000_000 for path in written)
    loaded = load(source)
    harbor = build_harbor(loaded.scenario.harbor, loaded.base_dir)
    lidar = SpinningSensor(loaded.scenario.sensors.lidar, harbor.triangles)
    pose = np.array([25.0, 1.5, np.radians(170)])
    for distance in lidar.sector_ranges_by_full_scan(pose[None])[0]:
        assert (f"{distance:.3f} m" if distance < 100 else " 100 m") in outcome.out
    assert "(25, 1.5, 170°)" in outcome.out


@pytest.mark.parametrize(
    ("pose", "code"), [("20,2", "wrong_type"), ("here", "wrong_type"), ("20,nan,0", "out_of_range")]
)
def test_text_that_is_no_pose(pose: str, code: str) -> None:
    with pytest.raises(DockctlError) as caught:
        parse_pose(pose)
    assert caught.value.code == code
    assert "--pose" in caught.value.message


@pytest.mark.parametrize(("pose", "obstacle"), [("40,0,0", "east quay"), ("9000,0,0", "basin")])
def test_poses_that_are_not_free(tmp_path: Path, pose: str, obstacle: str) -> None:
    outcome = dockctl("show", "s1", "--pose", pose, "--out", tmp_path / "out")
    assert outcome.code == 2
    assert "--pose" in outcome.err
    assert obstacle in outcome.err
    assert not (tmp_path / "out").exists()


def test_an_unknown_scenario() -> None:
    outcome = dockctl("show", "s33")
    assert outcome.code == 2
    assert outcome.error is not None
    assert (outcome.error.code, outcome.error.suggestion) == ("unknown_name", "s3")


def test_an_output_folder_that_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    outcome = dockctl("show", "s1", "--out", tmp_path / "file")
    assert outcome.code == 2
    assert str(tmp_path / "file") in outcome.err
    assert outcome.error_code == "not_writable"


def test_a_sector_without_return() -> None:
    table = sector_table(Scan(np.zeros(3), np.empty((0, 3)), np.array([100.0, 3.0]), 100.0))
    far, near = table.columns[3].cells
    assert str(far).endswith(" 100 m") and near == "3.000 m"
    assert list(table.columns[1].cells) == ["-180°", "0°"]


def test_a_planar_scanner_is_drawn_too(tmp_path: Path) -> None:
    scenario = tmp_path / "ring.yaml"
    scenario.write_text(f"extends: {PONTOON}\nsensors: {{lidar: {{kind: planar, rays: 90}}}}\n")
    outcome = dockctl("show", scenario, "--out", tmp_path / "out")
    assert outcome.code == 0
    assert {path.stem for path in (tmp_path / "out").glob("*.png")} == set(DRAWINGS)
