"""Videos of a replay: the boats from above and their commands (``dockctl view --gif`` and ``--mp4``)."""

from __future__ import annotations

import importlib
import io
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon, Wedge
from numpy.typing import NDArray
from PIL import Image

from dockctl.drawing import palette
from dockctl.drawing.scene import Scene
from dockctl.errors import DockctlError
from dockctl.geometry import Floats, sector_edges_deg, to_world, wrap
from dockctl.reports import plan_view
from dockctl.reports.style import HALO, figure_style
from dockctl.reports.trajectory import MEAN_STEPS
from dockctl.runs.files import write_atomically

Frame = NDArray[np.uint8]
SIZE_IN, DPI = (10.4, 6.0), 100
"""Size of a frame; width and height in pixels are even, as video formats require."""
SPEED = 5.0
"""Seconds of the episode per second of the video."""
GIF_FPS, MP4_FPS = 10, 30
HOLD_S = 1.5
"""Duration for which the last frame is shown [s]."""
SHOWN_RANGE_M = 12.0
MAX_ENTRIES = 24
"""Maximum number of legend entries; with more episodes, the last entry is the number of the others."""
COLUMN_CHARACTERS = {3: 44, 2: 70}
"""Characters of an entry that fit into a column, by the number of columns."""
PANELS = (
    ("Distance to the goal [m]", "distance"),
    ("Propeller force [N]", "force"),
    ("Rudder angle [°]", "rudder"),
)
"""Titles of the curves, and their keys in `Boat.curves`."""
LEAST_STEP_PT = 2.0
"""Below this width of a control period, commands would merge into a block: drawn thin, with their mean."""


@dataclass(frozen=True, eq=False)
class Boat:
    """One episode: poses (k, 3) [m, m, rad] and commands by step, and how it is drawn.

    Attributes:
        ranges: (k, sectors) nearest LiDAR return of each sector [m].
        range_m: maximum range of its LiDAR [m].
        curves: by key of `PANELS`, (k,).
        goals: x, y [m], heading [rad] and tolerance [m] of each goal.
        flows: velocities (k, 2) [m/s] of the current and of the wind, by name, if there are any.
    """

    label: str
    color: str
    ending: str
    pose: Floats
    ranges: Floats
    range_m: float
    curves: Mapping[str, Floats]
    goals: Sequence[Sequence[float]]
    flows: Mapping[str, Floats]


def boats(data: Mapping[str, Any]) -> list[Boat]:
    """Return the episodes in the data of `dockctl.evaluation.replay.page_data`."""
    return [
        Boat(
            label=episode["label"],
            color=episode["color"],
            ending=episode["text"],
            pose=np.asarray(arrays["pose"], float),
            ranges=np.asarray(arrays["ranges"], float),
            range_m=episode["range_m"],
            curves={
                "distance": _with_gap(arrays["distance_m"], arrays["phase"]),
                "force": np.asarray(arrays["command"], float)[:, 0],
                "rudder": np.degrees(np.asarray(arrays["command"], float)[:, 1]),
            },
            goals=[goal[:4] for goal in episode["goals"]],
            flows={name: np.asarray(arrays[name], float) for name in episode["flow"]},
        )
        for episode in data["episodes"]
        for arrays in [episode["arrays"]]
    ]


def _with_gap(distance: Floats, phase: NDArray[np.uint8]) -> Floats:
    """Return the distance with a gap at the step where the goal changes."""
    changes = np.flatnonzero(np.diff(np.asarray(phase, int))) + 1
    whole = np.array(distance, float)
    whole[changes] = np.nan
    return whole


def frames(scene: Scene, data: Mapping[str, Any], fps: float) -> Iterator[Frame]:
    """Yield the frames of a video, (height, width, 3) RGB.

    Args:
        scene: plan view of the harbor.
        data: result of `dockctl.evaluation.replay.page_data`.
        fps: frames per second.
    """
    period_s, shown = data["period_s"], boats(data)
    last = max(len(boat.pose) for boat in shown) - 1
    with figure_style():
        video = _Video(scene, shown, data["title"], period_s)
        count = int(np.ceil(last * period_s * fps / SPEED))
        for i in range(count + 1):
            frame = video.draw(min(i * SPEED / (fps * period_s), last))
            yield frame
        yield from [frame] * round(HOLD_S * fps)


def write_gif(path: Path, scene: Scene, data: Mapping[str, Any]) -> Path:
    """Write an animated GIF that loops.

    Raises:
        DockctlError: the file cannot be written.
    """
    images = (Image.fromarray(frame) for frame in frames(scene, data, GIF_FPS))
    first = next(images).quantize(256, dither=Image.Dither.NONE)
    others = (image.quantize(palette=first, dither=Image.Dither.NONE) for image in images)
    content = io.BytesIO()
    first.save(content, "GIF", save_all=True, append_images=others, duration=1000 // GIF_FPS, loop=0)
    return write_atomically(path, content.getvalue())


def write_mp4(path: Path, scene: Scene, data: Mapping[str, Any]) -> Path:
    """Write an H.264 video.

    Raises:
        DockctlError: there is no ffmpeg, it fails, or the file cannot be written.
    """
    width, height = (round(side * DPI) for side in SIZE_IN)
    raw = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(MP4_FPS), "-i", "-")
    coded = ("-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-movflags", "+faststart")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "video.mp4"
        with (Path(folder) / "errors").open("w+b") as errors:
            command = [ffmpeg(), "-y", "-loglevel", "error", *raw, "-an", *coded, str(file)]
            process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=errors)
            assert process.stdin
            with suppress(BrokenPipeError), process.stdin:  # it ended early: the exit status has the reason
                for frame in frames(scene, data, MP4_FPS):
                    process.stdin.write(frame.tobytes())
            if process.wait():
                errors.seek(0)
                reason = errors.read().decode("utf-8", "replace").strip().splitlines()[-1:]
                raise DockctlError(f"{path}: ffmpeg failed: {''.join(reason)}", code="not_writable")
        return write_atomically(path, file.read_bytes())


def ffmpeg() -> str:
    """Return the path of ffmpeg, from the package imageio-ffmpeg or on the search path.

    Raises:
        DockctlError: there is none.
    """
    try:
        return str(importlib.import_module("imageio_ffmpeg").get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        if found := shutil.which("ffmpeg"):
            return found
    message = "an MP4 needs ffmpeg: pip install 'dockctl[video]', or install ffmpeg; --gif needs neither"
    raise DockctlError(message, code="not_found")


class _Video:
    """Draws static content once, and the rest for each frame."""

    def __init__(self, scene: Scene, shown: Sequence[Boat], title: str, period_s: float) -> None:
        self._boats, self._hull, self._period_s = shown, scene.hull, period_s
        self._figure = Figure(figsize=SIZE_IN, dpi=DPI)
        canvas: Any = FigureCanvasAgg(self._figure)  # its methods have no types
        self._figure.text(0.02, 0.965, title, fontsize=12.5, fontweight="bold", va="top")
        grid = self._figure.add_gridspec(
            len(PANELS), 2, left=0.055, right=0.985, top=self._legend(), bottom=0.075,
            hspace=0.5, wspace=0.13, width_ratios=(1.75, 1.0),
        )  # fmt: skip
        self._moving: list[Artist] = []
        self._clock = self._add(self._figure.text(0.985, 0.965, "", fontsize=12.5, ha="right", va="top"))
        self._plan, self._flows = self._figure.add_subplot(grid[:, 0]), list[Artist]()
        self._harbor(self._plan, scene)
        self._curves: list[tuple[Line2D, Floats]] = []
        for row, (text, key) in enumerate(PANELS):
            self._panel(self._figure.add_subplot(grid[row, 1]), text, key)
        canvas.draw()
        self._canvas, self._background = canvas, canvas.copy_from_bbox(self._figure.bbox)

    def _add(self, artist: Any) -> Any:
        """Redraw an artist in every frame."""
        artist.set_animated(True)
        self._moving.append(artist)
        return artist

    def _harbor(self, ax: Axes, scene: Scene) -> None:
        points = np.concatenate([boat.pose[:, :2] for boat in self._boats])
        goals = np.unique(np.concatenate([boat.goals for boat in self._boats]), axis=0)
        points = np.concatenate([points, goals[:, :2]])
        plan = plan_view.extended(scene, points)
        box = ax.get_position()
        aspect = box.width * SIZE_IN[0] / (box.height * SIZE_IN[1])
        view = plan_view.close_view(plan, points, aspect=(aspect, aspect))
        plan_view.draw_harbor(ax, plan, view)
        ax.set(xlabel="", ylabel="")
        plan_view.draw_compass(ax, view)
        for x, y, heading, radius in goals:
            style: dict[str, Any] = {"radius": radius, "ec": palette.GOAL, "zorder": 3}
            ax.add_patch(Circle((x, y), fc="none", lw=0.9, ls=(0, (1, 1.6)), **style))
            plan_view.draw_boat(ax, scene.hull, np.array([x, y, heading]), palette.GOAL, dashed=True)
        self._sectors: list[list[Wedge]] = []
        self._trails: list[Line2D] = []
        self._hulls: list[Polygon] = []
        for boat in self._boats:
            count = boat.ranges.shape[1] if len(self._boats) == 1 else 0
            self._sectors.append([self._add(_sector(ax)) for _ in range(count)])
            (trail,) = ax.plot([], [], color=boat.color, lw=1.8, zorder=6, path_effects=HALO)
            self._trails.append(self._add(trail))
            alpha = 1.0 if len(self._boats) == 1 else 0.8
            hull = Polygon(scene.hull, fc=boat.color, ec="white", lw=1.0, alpha=alpha, zorder=8)
            self._hulls.append(self._add(ax.add_patch(hull)))

    def _legend(self) -> float:
        """Write the legend in columns below the title; return the remaining height of the figure."""
        labels = [f"{boat.label}: {boat.ending}" for boat in self._boats]
        handles = [Line2D([], [], color=boat.color, lw=2.2) for boat in self._boats]
        if len(labels) > MAX_ENTRIES:
            labels[MAX_ENTRIES - 1 :] = [f"and {len(labels) - MAX_ENTRIES + 1} more"]
            handles[MAX_ENTRIES - 1 :] = [Line2D([], [], lw=0)]
        longest = max(map(len, labels))
        columns = next((n for n in COLUMN_CHARACTERS if longest <= COLUMN_CHARACTERS[n]), 2)
        texts = [_shortened(text, COLUMN_CHARACTERS[columns]) for text in labels]
        style: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (0.015, 0.925), "borderaxespad": 0}
        self._figure.legend(handles, texts, ncols=columns, fontsize=8, borderpad=0, **style)
        return 0.89 - 0.03 * -(-len(labels) // columns)

    def _panel(self, ax: Axes, title: str, key: str) -> None:
        """Draw the axes of a panel, and add a growing line for each boat."""
        ax.set_title(title, loc="left", fontsize=9, fontweight="bold", pad=4)
        curves = [boat.curves[key] for boat in self._boats]
        low = min(0.0, *(np.nanmin(c) for c in curves))
        high = max(0.0, *(np.nanmax(c) for c in curves))
        margin = 0.08 * (high - low or 1.0)
        steps = max(len(c) - 1 for c in curves) or 1
        ax.set(xlim=(0, self._period_s * steps))
        ax.set_ylim(low - margin, high + margin)
        ax.axhline(0, color=palette.RULE, lw=0.8, zorder=1)
        if key == PANELS[-1][1]:
            ax.set_xlabel("Time [s]", labelpad=2)
        else:
            ax.tick_params(labelbottom=False)
        step_pt = ax.get_window_extent().width * 72 / DPI / steps
        if key == "distance":
            self._grow(ax, curves, lw=1.4)
        elif step_pt >= LEAST_STEP_PT:
            self._grow(ax, curves, lw=1.4, drawstyle="steps-pre")
        else:
            self._grow(ax, curves, lw=0.4, alpha=0.4, drawstyle="steps-pre")
            self._grow(ax, [_mean(curve) for curve in curves], lw=1.6)
            note = f"thick: mean over {MEAN_STEPS} past steps"
            ax.set_title(note, loc="right", fontsize=7.5, color=palette.INK_SOFT, pad=4)

    def _grow(self, ax: Axes, curves: Sequence[Floats], **style: Any) -> None:
        """Add a line for each boat that grows over time."""
        for boat, curve in zip(self._boats, curves, strict=True):
            self._curves.append((self._add(ax.plot([], [], color=boat.color, **style)[0]), curve))

    def draw(self, step: float) -> Frame:
        """Return the frame at a time, in control steps."""
        self._clock.set_text(f"{step * self._period_s:.1f} s   {SPEED:g}×")
        for i, boat in enumerate(self._boats):
            at = min(step, len(boat.pose) - 1)
            row = int(at)
            pose = _between(boat.pose, at)
            self._hulls[i].set_xy(to_world(self._hull, pose))
            self._trails[i].set_data(*np.concatenate([boat.pose[: row + 1, :2], pose[None, :2]]).T)
            for number, wedge in enumerate(self._sectors[i]):
                _place(wedge, pose, number, boat.ranges[row], boat.range_m)
        for line, curve in self._curves:
            past = curve[: int(step) + 1]
            line.set_data(self._period_s * np.arange(len(past)), past)
        self._draw_flows(step)
        self._canvas.restore_region(self._background)
        for artist in sorted(self._moving, key=lambda artist: artist.get_zorder()):
            self._figure.draw_artist(artist)
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()

    def _draw_flows(self, step: float) -> None:
        """Replace the arrows of the current and the wind; none are drawn for several boats."""
        if len(self._boats) > 1:
            return
        for artist in self._flows:
            self._moving.remove(artist)
            artist.remove()
        flows = self._boats[0].flows
        now = {name: velocity[min(int(step), len(velocity) - 1)] for name, velocity in flows.items()}
        self._flows = [self._add(artist) for artist in plan_view.draw_flows(self._plan, now)]


def _shortened(text: str, length: int) -> str:
    """Shorten the text to at most `length` characters by omitting a part of the name at its beginning."""
    head = length // 3
    return text if len(text) <= length else f"{text[:head]}…{text[head + 1 - length :]}"


def _mean(curve: Floats) -> Floats:
    """Return the mean over the last steps, which are known at that point in the video."""
    return pd.Series(curve).rolling(MEAN_STEPS, min_periods=1).mean().to_numpy()


def _sector(ax: Axes) -> Wedge:
    wedge = Wedge((0, 0), 1.0, 0, 1, fc=palette.BLUE, ec="white", lw=0.8, alpha=0.22, zorder=5)
    ax.add_patch(wedge)
    return wedge


def _place(wedge: Wedge, pose: Floats, number: int, ranges: Floats, range_m: float) -> None:
    """Move a LiDAR sector with the boat, and size it by its nearest return."""
    start, end = np.degrees(pose[2]) + sector_edges_deg(len(ranges))[number : number + 2]
    wedge.set_center((float(pose[0]), float(pose[1])))
    wedge.set_theta1(start)
    wedge.set_theta2(end)
    wedge.set_radius(min(float(ranges[number]), SHOWN_RANGE_M))
    wedge.set_visible(bool(ranges[number] < range_m))


def _between(poses: Floats, step: float) -> Floats:
    """Return the pose between two steps, turning by the smaller angle."""
    row = min(int(step), max(len(poses) - 2, 0))
    change = poses[min(row + 1, len(poses) - 1)] - poses[row]
    change[2] = wrap(change[2])
    return np.asarray(poses[row] + (step - row) * change)
