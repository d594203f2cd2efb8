"""Common style of all figures: fonts, lines, colors, titles, and reproducible files."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, FigureBase
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.textpath import TextPath
from matplotlib.ticker import FuncFormatter, LogFormatter, PercentFormatter

from dockctl.analysis.statistics import wilson_interval
from dockctl.drawing import palette
from dockctl.runs.files import write_atomically, writing

Draw = Callable[[], Mapping[str, Figure]]
"""Draws figures; returns them by file name, without suffix."""

DPI = 200
SUBTITLE_PT = 8.5
HINTED = 1.03
"""Hinting makes drawn text wider than its outline, by up to this factor."""
HALO = [withStroke(linewidth=2.6, foreground="white", alpha=0.85)]
"""Outline of text and lines, for contrast on any background."""
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so figures are the same on every machine
    "font.size": 9.5,
    "text.color": palette.INK,
    "text.parse_math": False,  # names given by users may contain dollar signs
    "axes.edgecolor": palette.RULE,
    "axes.labelcolor": palette.INK_SOFT,
    "axes.labelsize": 9.5,
    "axes.labelpad": 6.0,
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.xmargin": 0.0,
    "axes.prop_cycle": cycler(color=palette.SERIES),
    "grid.color": palette.GRID,
    "grid.linewidth": 0.6,
    "xtick.color": palette.RULE,
    "ytick.color": palette.RULE,
    "xtick.labelcolor": palette.INK_SOFT,
    "ytick.labelcolor": palette.INK_SOFT,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "xtick.major.size": 3.0,
    "ytick.major.size": 0.0,
    "lines.linewidth": 1.8,
    "lines.solid_capstyle": "round",
    "lines.solid_joinstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.facecolor": "white",
    "axes.facecolor": "white",
    "svg.hashsalt": "dockctl",  # reproducible element ids
    "svg.fonttype": "path",
    "savefig.dpi": DPI,
}
METADATA: dict[str, dict[str, str | None]] = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": "dockctl"},
}
"""File formats and their metadata, without dates and versions, so that the files are reproducible."""
Entry = tuple[str, str] | tuple[str, str, str]
"""Legend entry: name, color and, optionally, line style."""


class RoundedLayout(ConstrainedLayoutEngine):
    """Constrained layout, rounded, because the last digits of its solver differ from run to run."""

    DIGITS = 5

    def execute(self, fig: Figure) -> Any:
        grids = super().execute(fig)
        self._round_subfigures(fig)
        for ax in fig.axes:
            in_layout = ax.get_in_layout()
            ax.set_position(tuple(np.round(ax.get_position(original=True).bounds, self.DIGITS)))
            ax.set_in_layout(in_layout)  # setting the position takes the axes out of the layout
        return grids

    def _round_subfigures(self, figure: FigureBase) -> None:
        for part in figure.subfigs:
            part.bbox_relative.set_points(np.round(part.bbox_relative.get_points(), self.DIGITS))
            self._round_subfigures(part)


@contextmanager
def figure_style() -> Iterator[None]:
    """Set the style in which figures are drawn and saved; restore matplotlib's settings afterwards."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(STYLE)
        yield


def make_figure(title: str, subtitle: str, size_in: tuple[float, float] = (7.6, 4.3)) -> Figure:
    """Return an empty figure with a bold title and a subtitle, left-aligned.

    A subtitle that is too long for the width continues on further lines, which make the figure taller.
    """
    width, height = size_in
    lines = _lines(subtitle, width - 0.22 - 0.1)
    below = (len(lines) - 1) * SUBTITLE_PT * 1.2 / 72
    height += below
    head = (0.62 + below) / height  # the title and one line of the subtitle take 0.62 inches
    figure = Figure(figsize=(width, height), layout=RoundedLayout(rect=(0.02, 0.02, 0.96, 0.97 - head)))
    FigureCanvasAgg(figure)
    left, color = 0.22 / width, palette.INK_SOFT
    figure.text(left, 1 - 0.16 / height, title, fontsize=12.5, fontweight="bold", va="top")
    figure.text(left, 1 - 0.42 / height, "\n".join(lines), fontsize=SUBTITLE_PT, color=color, va="top")
    return figure


def _lines(subtitle: str, width_in: float) -> list[str]:
    """Return the subtitle wrapped at this width, between words."""
    lines = [subtitle]
    while _width_in(lines[-1]) > width_in and " " in lines[-1]:
        words = lines.pop().split(" ")
        fitting = [n for n in range(1, len(words)) if _width_in(" ".join(words[:n])) <= width_in]
        kept = max(fitting, default=1)
        lines += [" ".join(words[:kept]), " ".join(words[kept:])]
    return lines


def _width_in(text: str) -> float:
    outline_pt = TextPath((0, 0), text, size=SUBTITLE_PT).get_extents().width if text else 0.0
    return float(outline_pt) / 72 * HINTED


def make_axes(title: str, subtitle: str, size_in: tuple[float, float] = (7.6, 4.3)) -> tuple[Figure, Axes]:
    """Return a titled figure with one pair of axes."""
    figure = make_figure(title, subtitle, size_in)
    return figure, figure.add_subplot()


def panels(figure: FigureBase, count: int, columns: int, **subplots: Any) -> list[Axes]:
    """Return `count` axes in rows of `columns`, with the rest of the last row hidden."""
    axes = figure.subplots(-(-count // columns), columns, squeeze=False, **subplots).ravel().tolist()
    for ax in axes[count:]:
        ax.set_visible(False)
    return list(axes[:count])


def panel_title(ax: Axes, text: str, **style: Any) -> None:
    """Write a bold title above the axes, by default above their left corner."""
    ax.set_title(text, **{"loc": "left", "fontsize": 9, "fontweight": "bold", **style})


def percent(axis: Axis) -> None:
    """Format the ticks of an axis of shares as percentages."""
    axis.set_major_formatter(PercentFormatter(1, symbol=" %"))


def draw_share(ax: Axes, values: pd.Series, successes: pd.Series, trials: pd.Series, color: str) -> None:
    """Draw a share over values, with its 95 % Wilson intervals."""
    bounds = [wilson_interval(int(k), int(n)) for k, n in zip(successes, trials, strict=True)]
    low, high = np.array(bounds).T
    ax.fill_between(values, low, high, color=color, alpha=0.1, lw=0)
    ax.plot(values, successes / trials, color=color, marker="o", ms=4, mec="white", mew=0.7, zorder=3)


def legend_above(ax: Axes, entries: Sequence[Entry], columns: int = 5) -> None:
    """Put a legend above the axes, unless it has a single entry."""
    if len(entries) < 2:
        return
    handles = [
        Line2D([], [], color=color, lw=2.2, ls=style[0] if style else "-", label=name)
        for name, color, *style in entries
    ]
    legend = ax.legend(
        handles=handles,
        loc="lower left",
        bbox_to_anchor=(-0.01, 1.0),
        ncols=min(columns, len(entries)),
        handlelength=1.3,
        handletextpad=0.5,
        columnspacing=1.5,
        borderaxespad=0.3,
    )
    # The layout would shrink the axes for a long legend: it sees an empty title of the same height instead.
    legend.set_in_layout(False)
    ax.set_title("\n" * ((len(entries) - 1) // columns) + " ", fontsize=8.5, pad=7)


def label(
    ax: Axes, text: str, xy: tuple[float, float], offset: tuple[float, float] = (0, 0), **style: Any
) -> None:
    """Write text in 8 pt with a halo, shifted by `offset` [pt] from a point of the axes.

    Args:
        xy: in data coordinates, unless `style` has other ``xycoords``.
        style: other arguments of `matplotlib.axes.Axes.annotate`.
    """
    style = {"fontsize": 8, "path_effects": HALO, **style}
    ax.annotate(text, xy, xytext=offset, textcoords="offset points", **style)


def log_scale(ax: Axes) -> None:
    """Give the y axis a logarithmic scale with plain number labels, because math text is not parsed."""
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter(_PlainLogFormatter())
    ax.yaxis.set_minor_formatter(_PlainLogFormatter())


class _PlainLogFormatter(LogFormatter):
    """Labels the ticks that matplotlib selects with plain numbers."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""


def thousands(ax: Axes, which: str = "x") -> None:
    """Format the ticks of an axis with thousands separators."""
    axis = ax.xaxis if which == "x" else ax.yaxis
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}".replace("-", "−")))


def save(figures: dict[str, Figure], folder: Path) -> list[Path]:
    """Write each figure as PNG (200 dpi) and SVG, byte for byte reproducible, and return the paths.

    Raises:
        DockctlError: the folder cannot be written.
    """
    written = []
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    for name, figure in figures.items():
        for suffix, metadata in METADATA.items():
            content = io.BytesIO()
            figure.savefig(content, format=suffix, metadata=metadata)
            written.append(write_atomically(folder / f"{name}.{suffix}", content.getvalue()))
    return written
