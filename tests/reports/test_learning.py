"""Training figures show the numbers of the tables."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex

from dockctl.drawing import palette
from dockctl.reports import learning
from dockctl.reports.figures import DrawEpisodes
from dockctl.reports.style import figure_style, make_axes
from tests.reports import synthetic


@pytest.fixture
def ax() -> Iterator[Axes]:
    with figure_style():
        yield make_axes("", "")[1]


@pytest.fixture
def episodes() -> pd.DataFrame:
    return synthetic.episodes(400)


def line(ax: Axes, label: str) -> tuple[np.ndarray, np.ndarray]:
    (found,) = [line for line in ax.lines if line.get_label() == label]
    return np.asarray(found.get_xdata(), float), np.asarray(found.get_ydata(), float)


def brute_mean(values: np.ndarray, window: int) -> list[float]:
    return [values[max(0, i + 1 - window) : i + 1].mean() for i in range(len(values))]


@pytest.mark.parametrize(
    ("draw", "column"), [(learning.draw_reward, "return"), (learning.draw_duration, "steps")]
)
def test_dots_are_episodes_and_lines_their_means(
    ax: Axes, episodes: pd.DataFrame, draw: DrawEpisodes, column: str
) -> None:
    draw(ax, episodes)
    for kind, name in (("pose", "from an initial pose"), ("exploring", "exploring start")):
        rows = episodes[episodes["start_kind"] == kind]
        x, y = line(ax, f"{name}, episodes")
        assert np.array_equal(x, rows["episode"])
        assert np.array_equal(y, rows[column])
        _, smooth = line(ax, f"{name}, mean of 10")
        assert smooth == pytest.approx(brute_mean(rows[column].to_numpy(float), 10))
    assert ax.get_xlabel() == "Episode"


def test_a_run_without_exploring_starts_has_one_line(ax: Axes, episodes: pd.DataFrame) -> None:
    learning.draw_reward(ax, episodes[episodes["start_kind"] == "pose"])
    assert len(ax.lines) == 2


def test_epsilon(ax: Axes, episodes: pd.DataFrame) -> None:
    learning.draw_epsilon(ax, episodes)
    assert np.array_equal(ax.lines[0].get_ydata(), episodes["epsilon"])


def test_phase_without_exploring_starts(ax: Axes, episodes: pd.DataFrame) -> None:
    learning.draw_phase(ax, episodes)
    selected = episodes[episodes["start_kind"] == "pose"]
    x, y = line(ax, "episodes")
    assert np.array_equal(x, selected["episode"])
    assert np.array_equal(np.round(y), selected["phase"])
    assert line(ax, "mean of 10 episodes")[1] == pytest.approx(
        brute_mean(selected["phase"].to_numpy(float), 10)
    )


def test_outcome_shares_sum_to_one(ax: Axes, episodes: pd.DataFrame) -> None:
    learning.draw_outcomes(ax, episodes)
    docked, timeout, collision = (np.asarray(area.get_paths()[0].vertices) for area in ax.collections)
    assert docked[:, 1].min() == 0
    assert collision[:, 1].max() == pytest.approx(1)
    last = np.mean(episodes["outcome"].tail(10) == "docked")
    assert docked[docked[:, 0] == 400][:, 1].max() == pytest.approx(last)
    assert timeout[:, 1].max() <= 1 + 1e-12


def test_reward_terms_sum_to_the_return(ax: Axes, episodes: pd.DataFrame) -> None:
    learning.draw_terms(ax, episodes)
    (total,) = [line for line in ax.lines if len(np.asarray(line.get_ydata())) == len(episodes)]
    assert np.asarray(total.get_ydata()) == pytest.approx(brute_mean(episodes["return"].to_numpy(), 10))
    ends = [np.asarray(area.get_paths()[0].vertices) for area in ax.collections]
    at_end = [vertices[vertices[:, 0] == 400][:, 1] for vertices in ends]
    stacked = max(y.max() for y in at_end) + min(y.min() for y in at_end)
    assert stacked == pytest.approx(total.get_ydata()[-1])


def test_evaluations_have_one_bar_per_pose_and_time(ax: Axes) -> None:
    table = synthetic.evaluations(poses=2, count=4)
    learning.draw_evaluations(ax, table, ["first"])
    assert [text.get_text() for text in ax.get_yticklabels()] == ["first", "pose 1"]
    drawn = {
        (round(bar.get_x() + bar.get_width() / 2), round(bar.get_y() + bar.get_height() / 2)): to_hex(
            bar.get_facecolor()
        )
        for bar in ax.patches
    }
    for _, row in table.iterrows():
        assert drawn[row["env_steps"] // 10_000 - 1, row["pose"]] == palette.OUTCOMES[row["outcome"]].lower()


def test_the_shares_of_the_validation_starts_are_below_the_poses(ax: Axes) -> None:
    poses = synthetic.evaluations(poses=2, count=4)
    outcomes = ["docked"] * 5 + ["collision"] * 3 + ["timeout"] * 2
    last = pd.DataFrame({"env_steps": 40_000, "start_kind": "validation", "pose": range(10), "best": 1})
    learning.draw_evaluations(ax, pd.concat([poses, last.assign(outcome=outcomes)]), ["a", "b"])
    assert len(ax.get_yticklabels()) == 3
    bars = {to_hex(bar.get_facecolor()): bar for bar in ax.patches if round(bar.get_y() + 0.43) == 2}
    for outcome, share in (("docked", 0.5), ("collision", 0.3), ("timeout", 0.2)):
        assert bars[palette.OUTCOMES[outcome].lower()].get_width() == pytest.approx(0.9 * share)
    ends = sorted((bar.get_x(), bar.get_x() + bar.get_width()) for bar in bars.values())
    assert [left for left, _ in ends] == pytest.approx([2.55, *(right for _, right in ends[:-1])])


def test_updates(ax: Axes) -> None:
    table = synthetic.updates()
    learning.draw_updates([ax], table, ["loss"])
    x, y = line(ax, "loss")
    assert np.array_equal(x, table["env_steps"])
    assert np.array_equal(y, table["loss"])
    assert line(ax, "loss, mean of 10")[1] == pytest.approx(brute_mean(table["loss"].to_numpy(), 10))
    assert ax.get_yscale() == "log"


@pytest.mark.parametrize(("column", "value"), [("loss", 0.0), ("q_mean", 5.0)])
def test_updates_that_may_be_zero_or_negative_have_a_linear_axis(ax: Axes, column: str, value: float) -> None:
    table = synthetic.updates().assign(**{column: value})
    learning.draw_updates([ax], table, [column])
    assert ax.get_yscale() == "linear"
