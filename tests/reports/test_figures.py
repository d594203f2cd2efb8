"""All the figures of a run."""

from __future__ import annotations

from pathlib import Path

import pytest
from matplotlib.figure import Figure

from dockctl.reports.figures import figures
from dockctl.reports.style import house_style, save
from dockctl.runs.reader import read_run
from tests.reports.synthetic import write_run

EVERY = {
    *("training-reward", "training-duration", "training-epsilon", "training-outcomes"),
    *("training-reward-terms", "training-evaluations", "overview"),
    *("docking-poses", "docking-distance", "docking-heading-error", "docking-velocity"),
    *("docking-yaw-rate", "docking-propeller", "docking-rudder"),
}


def drawn(folder: Path) -> dict[str, Figure]:
    with house_style():
        return dict(figures(read_run(folder)))


def test_a_run_without_intermediate_pose_has_no_phase_plot(tmp_path: Path) -> None:
    assert set(drawn(write_run(tmp_path / "run", count=60))) == EVERY


def test_a_run_with_intermediate_pose_has_one(tmp_path: Path) -> None:
    assert set(drawn(write_run(tmp_path / "run", count=60, intermediate=True))) == {*EVERY, "training-phase"}


def test_controls_have_a_row_a_pose(tmp_path: Path) -> None:
    book = drawn(write_run(tmp_path / "run", count=60, poses=5))
    assert len(book["docking-propeller"].axes) == 5
    assert len(book["docking-distance"].axes) == 1


@pytest.mark.parametrize(
    ("gone", "kept"),
    [
        ("trajectories.csv", {name for name in EVERY if name.startswith("training")}),
        ("episodes.csv", {name for name in EVERY if name.startswith("docking")} | {"training-evaluations"}),
    ],
)
def test_what_the_tables_do_not_tell_is_left_out(tmp_path: Path, gone: str, kept: set[str]) -> None:
    folder = write_run(tmp_path / "run", count=60)
    (folder / gone).unlink()
    assert set(drawn(folder)) == kept


def test_a_run_of_one_episode_can_be_drawn(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", count=1)
    with house_style():
        written = save(dict(figures(read_run(folder))), tmp_path / "figures")
    assert len(written) == 2 * len(EVERY)
    assert all(path.stat().st_size > 5000 for path in written)
