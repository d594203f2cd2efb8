"""Figure style, and reproducible files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from dockctl.errors import DockctlError
from dockctl.reports.style import (
    figure_style,
    legend_above,
    log_scale,
    make_axes,
    make_figure,
    save,
    thousands,
)


def draw(folder: Path) -> list[Path]:
    with figure_style():
        figure, ax = make_axes("Title", "subtitle")
        ax.plot([0, 1000, 2000], [3, -2, 5], label="line")
        legend_above(ax, [("one", "red"), ("two", "blue", ":")])
        thousands(ax)
        return save({"figure": figure}, folder)


@pytest.mark.parametrize("width", [4.3, 8.6])
def test_a_long_subtitle_continues_on_further_lines(width: float) -> None:
    subtitle = (
        "policy trained on s3, seed 0; 20 random starts for each value, with 95 % intervals; one at a time"
    )
    with figure_style():
        figure, short = (make_figure("Title", text, (width, 3.6)) for text in (subtitle, "subtitle"))
        figure.add_subplot()
        short.add_subplot()
        for each in (figure, short):
            each.draw_without_rendering()
        heights = [each.axes[0].get_window_extent().height for each in (figure, short)]
        extents = [text.get_window_extent() for text in figure.texts]
    assert " ".join(figure.texts[1].get_text().split("\n")) == subtitle
    assert all(extent.x0 >= 0 and extent.x1 <= figure.bbox.x1 for extent in extents)
    assert extents[1].y1 < extents[0].y0
    assert figure.axes[0].get_window_extent().y1 < extents[1].y0
    assert heights[0] == pytest.approx(heights[1], rel=0.05)


def test_files_are_reproducible(tmp_path: Path) -> None:
    first, second = draw(tmp_path / "a"), draw(tmp_path / "b")
    assert [path.name for path in first] == ["figure.png", "figure.svg"]
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes()


def test_names_with_dollar_signs_are_no_formulas(tmp_path: Path) -> None:
    with figure_style():
        figure, ax = make_axes("$\\frac{a}{$", "$x_{$")
        ax.plot([1, 2], [1, 2], label="_a$\\b$")
        save({"figure": figure}, tmp_path)


def test_a_logarithmic_axis_has_plain_labels() -> None:
    with figure_style():
        figure, ax = make_axes("Title", "subtitle")
        log_scale(ax)
        ax.set_ylim(5, 2000)
        figure.canvas.draw()
        labels = {label.get_text() for label in ax.get_yticklabels()}
    assert {"10", "100", "1000"} <= labels
    assert not any("$" in label for label in labels)


def test_noise_of_the_layout_solver_is_rounded_away(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its results differ by about 1e-15 from run to run."""

    def layout(figure: Figure, noise: float) -> Any:
        figure.add_subfigure(figure.add_gridspec(1, 1)[0]).subplots(1, 2)
        solve = ConstrainedLayoutEngine.execute

        def execute(engine: ConstrainedLayoutEngine, fig: Figure) -> Any:
            grids = solve(engine, fig)
            for ax in fig.axes:
                ax._set_position(np.array(ax.get_position(original=True).bounds) + noise)
            for part in fig.subfigs:
                part.bbox_relative.set_points(part.bbox_relative.get_points() + noise)
            return grids

        with monkeypatch.context() as patch:
            patch.setattr(ConstrainedLayoutEngine, "execute", execute)
            figure.draw_without_rendering()
            figure.draw_without_rendering()
        return [ax.get_window_extent().bounds for ax in figure.axes]

    with figure_style():
        exact, noisy = (layout(make_figure("Title", "subtitle"), noise) for noise in (0.0, 1e-13))
    assert exact == noisy


def test_resolution(tmp_path: Path) -> None:
    from PIL import Image

    png, _ = draw(tmp_path)
    assert Image.open(png).size == (round(7.6 * 200), round(4.3 * 200))


def test_settings_are_restored() -> None:
    before = dict(mpl.rcParams)
    with figure_style():
        assert mpl.rcParams["svg.hashsalt"] == "dockctl"
    assert dict(mpl.rcParams) == before


def test_an_output_folder_that_cannot_be_created(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DockctlError, check=lambda error: error.code == "not_writable"):
        draw(tmp_path / "file" / "figures")


def test_thousands() -> None:
    with figure_style():
        _, ax = make_axes("", "")
        thousands(ax, "y")
        assert ax.yaxis.get_major_formatter()(-12000.0, None) == "−12,000"
