"""Figure style, and reproducible files."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import pytest

from dockctl.errors import DockctlError
from dockctl.reports.style import figure_style, legend_above, make_axes, save, thousands


def draw(folder: Path) -> list[Path]:
    with figure_style():
        figure, ax = make_axes("Title", "subtitle")
        ax.plot([0, 1000, 2000], [3, -2, 5], label="line")
        legend_above(ax, [("one", "red"), ("two", "blue", ":")])
        thousands(ax)
        return save({"figure": figure}, folder)


def test_files_are_reproducible(tmp_path: Path) -> None:
    first, second = draw(tmp_path / "a"), draw(tmp_path / "b")
    assert [path.name for path in first] == ["figure.png", "figure.svg"]
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes()


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
