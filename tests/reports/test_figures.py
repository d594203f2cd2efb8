"""Which figures a run has."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from dockctl.reports.figures import figures
from dockctl.reports.style import STYLE, figure_style, save
from dockctl.runs.reader import read_run
from tests.reports.synthetic import episodes, updates, write_run

ALL = {
    *("training-reward", "training-duration", "training-epsilon", "training-outcomes"),
    *("training-reward-terms", "training-updates", "training-evaluations", "overview"),
    *("docking-poses", "docking-distance", "docking-heading-error", "docking-velocity"),
    *("docking-yaw-rate", "docking-propeller", "docking-rudder"),
}


def drawn(folder: Path) -> dict[str, Figure]:
    with figure_style():
        return dict(figures(read_run(folder)))


def test_a_run_without_intermediate_pose_has_no_phase_plot(tmp_path: Path) -> None:
    assert set(drawn(write_run(tmp_path / "run", count=60))) == ALL


def test_a_run_with_intermediate_pose_has_one(tmp_path: Path) -> None:
    assert set(drawn(write_run(tmp_path / "run", count=60, intermediate=True))) == {*ALL, "training-phase"}


def test_commands_have_one_row_of_axes_per_pose(tmp_path: Path) -> None:
    found = drawn(write_run(tmp_path / "run", count=60, poses=5))
    assert len(found["docking-propeller"].axes) == 5
    assert len(found["docking-distance"].axes) == 1


@pytest.mark.parametrize(
    ("removed", "expected"),
    [
        ("trajectories.csv", {name for name in ALL if name.startswith("training")}),
        (
            "episodes.csv",
            {name for name in ALL if name.startswith("docking")}
            | {"training-evaluations", "training-updates"},
        ),
    ],
)
def test_figures_without_a_table_are_left_out(tmp_path: Path, removed: str, expected: set[str]) -> None:
    folder = write_run(tmp_path / "run", count=60)
    (folder / removed).unlink()
    assert set(drawn(folder)) == expected


@pytest.mark.thorough
def test_a_run_of_one_episode_can_be_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(STYLE, "savefig.dpi", 50)
    folder = write_run(tmp_path / "run", count=1)
    with figure_style():
        written = save(dict(figures(read_run(folder))), tmp_path / "figures")
    assert len(written) == 2 * len(ALL)
    assert all(path.stat().st_size > 5000 for path in written)


def test_updates_are_drawn_for_the_metrics_that_there_are(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", count=20)
    updates(30).drop(columns=["td_error"]).assign(loss=np.nan).to_csv(folder / "updates.csv", index=False)
    axes = [ax for ax in drawn(folder)["training-updates"].axes if ax.get_visible()]
    assert len(axes) == 2
    updates(30)[["update", "env_steps"]].to_csv(folder / "updates.csv", index=False)
    assert "training-updates" not in drawn(folder)


def test_an_algorithm_without_epsilon_has_no_figure_of_it(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", count=20)
    episodes(20).assign(epsilon=np.nan).to_csv(folder / "episodes.csv", index=False)
    assert set(drawn(folder)) == ALL - {"training-epsilon"}
