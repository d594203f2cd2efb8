"""The figure that compares policies."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text

from dockctl.analysis.contrast import SUCCESS, contrasts
from dockctl.reports.compare import compare_figure
from dockctl.reports.style import figure_style, save
from tests.analysis.test_contrast import DOCKED, two_policies

KINDS = {"random": "random starts", "pose": "evaluation poses"}


def test_outcome_shares_and_differences() -> None:
    table = two_policies()
    with figure_style():
        figure = compare_figure(table, KINDS, "caption")
    outcomes, success = figure.axes[:2]
    docked = [bar.get_width() for bar in outcomes.patches if bar.get_x() == 0 and bar.get_width()]
    assert docked == pytest.approx([np.mean(DOCKED["random"][name]) for name in ("old", "new")])
    (found,) = contrasts(table)
    difference = found.compared[SUCCESS].difference
    low_high, dot = success.lines[1:3]
    assert np.asarray(low_high.get_xdata()) == pytest.approx(
        100 * np.array([difference.low, difference.high])
    )
    assert dot.get_xdata()[0] == pytest.approx(100 * difference.value)


def test_tables_without_pairs_or_without_random_starts_are_drawn() -> None:
    table = two_policies()
    with figure_style():
        for other in (table.assign(outcome="timeout"), table[table["start_kind"] == "pose"]):
            compare_figure(other, KINDS, "caption").draw_without_rendering()


def test_titles_do_not_overlap_however_long_the_names_are() -> None:
    table = two_policies()
    long = "a policy, conditions.lidar_faults={sectors: [1, 2, 3, 4, 5, 6, 7, 8], mode: frozen}"
    with figure_style():
        figure = compare_figure(table.replace({"policy": {"new": long}}), KINDS, "caption")
        figure.draw_without_rendering()
    titles = {ax.get_title(loc="left") for ax in figure.axes}
    boxes = [text.get_window_extent() for text in figure.findobj(Text) if text.get_text() in titles]
    assert len(boxes) == len(figure.axes)
    assert all(box.x1 < after.x0 for box, after in itertools.pairwise(sorted(boxes, key=lambda box: box.x0)))


@pytest.mark.thorough
def test_files_are_reproducible(tmp_path: Path) -> None:
    with figure_style():
        save({name: compare_figure(two_policies(), KINDS, "caption") for name in ("one", "same")}, tmp_path)
    for suffix in ("svg", "png"):
        assert (tmp_path / f"one.{suffix}").read_bytes() == (tmp_path / f"same.{suffix}").read_bytes()
