"""Videos: number, size and content of the frames, and the files."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from dockctl.errors import DockctlError
from dockctl.reports import animation
from dockctl.reports.animation import GIF_FPS, HOLD_S, SPEED, ffmpeg, frames, write_gif, write_mp4
from tests.reports.synthetic import marina

STEPS = 6
PERIOD_S = 0.5
COLOR = "#00ff40"


@pytest.fixture
def data() -> dict[str, Any]:
    """A boat that drives along x, with the heading along +x, over `STEPS` control steps."""
    x = np.linspace(20.0, 26.0, STEPS + 1)
    zeros = np.zeros(STEPS + 1)
    episode = {
        "label": "a",
        "color": COLOR,
        "text": "docked",
        "goals": [[30.0, 0.0, 0.0, 1.0, 0.1]],
        "flow": [],
        "range_m": 100.0,
        "arrays": {
            "pose": np.stack([x, zeros, zeros], axis=1),
            "command": np.stack([50 + zeros, zeros], axis=1),
            "ranges": np.full((STEPS + 1, 8), 100.0),
            "distance_m": 30 - x,
            "phase": np.ones(STEPS + 1, np.uint8),
        },
    }
    return {"title": "A video", "period_s": PERIOD_S, "episodes": [episode]}


def boat_columns(frame: animation.Frame) -> np.ndarray:
    """Columns of the frame with the color of the boat, in the plan view."""
    near = (
        np.abs(frame[100:, : int(0.6 * frame.shape[1])].astype(int) - 255 * np.array(to_rgb(COLOR))).max(
            axis=2
        )
        < 40
    )
    _, columns = np.nonzero(near)
    return columns


def test_the_boat_moves_through_the_frames(data: dict[str, Any]) -> None:
    shown = list(frames(marina(), data, 20.0))
    assert len(shown) == 1 + STEPS * PERIOD_S * 20 / SPEED + HOLD_S * 20
    assert {frame.shape for frame in shown} == {(600, 1040, 3)}
    tips = [boat_columns(frame).max() for frame in shown]
    assert all(np.diff(tips) >= 0)
    moving = tips[: 1 + int(STEPS * PERIOD_S * 20 / SPEED)]
    np.testing.assert_allclose(np.diff(moving), np.diff(moving).mean(), atol=1.5)  # at a constant speed
    np.testing.assert_array_equal(shown[-1], shown[-2])


@pytest.mark.thorough
def test_the_wind_turns_with_the_time(data: dict[str, Any]) -> None:
    """Its arrow differs from frame to frame, where without wind nothing does."""
    still = np.tile(data["episodes"][0]["arrays"]["pose"][:1], (STEPS + 1, 1))
    data["episodes"][0]["arrays"]["pose"] = still

    def corners() -> list[np.ndarray]:
        return [frame[80:130, 60:130] for frame in frames(marina(), data, 5.0)]

    assert all((corner == corners()[0]).all() for corner in corners())
    turning = np.linspace(0, np.pi, STEPS + 1)
    data["episodes"][0]["flow"] = ["wind"]
    data["episodes"][0]["arrays"]["wind"] = 5 * np.column_stack([np.cos(turning), np.sin(turning)])
    first, *_, last = corners()
    assert (first != last).any()


@pytest.mark.parametrize("steps", [60, 200])
def test_alternating_commands_stay_lines_and_have_their_mean_when_steps_are_narrow(
    steps: int, data: dict[str, Any]
) -> None:
    """Less than half of the area between the two values is covered, however many steps there are."""
    time, zeros = np.arange(steps + 1), np.zeros(steps + 1)
    data["episodes"][0]["arrays"] |= {
        "pose": np.stack([20 + 6 * time / steps, zeros, zeros], axis=1),
        "command": np.stack([np.where(time % 2, 50.0, -50.0), zeros], axis=1),
        "ranges": np.full((steps + 1, 8), 100.0),
        "distance_m": 10 - 6 * time / steps,
        "phase": np.ones(steps + 1, np.uint8),
    }
    *_, last = frames(marina(), data, 0.5)
    panel = last[285:355, 700:1020].astype(int)  # within the force's, away from its two values
    faintness = np.abs(panel - 255 * np.array(to_rgb(COLOR))).max(axis=2)
    assert (faintness < 80).mean() < 0.5
    strong_rows = (faintness < 80).mean(axis=1) > 0.6
    assert strong_rows.any() == (steps == 200)  # the mean, 0 N


@pytest.mark.parametrize(
    ("count", "name"), [(1, "s3"), (7, "s3"), (8, "marinas" * 20), (40, "marina-smooth")]
)
def test_the_legend_names_the_episodes_and_covers_nothing(
    count: int, name: str, data: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    figures: list[Figure] = []
    monkeypatch.setattr(animation, "Figure", lambda **given: figures.append(Figure(**given)) or figures[0])
    data["episodes"] = [
        data["episodes"][0] | {"label": f"{name} ({i}, 0, 175°)", "color": f"#{i:02x}ff40"}
        for i in range(count)
    ]
    next(frames(marina(), data, 5.0))
    (legend,) = figures[0].legends
    texts = [text.get_text() for text in legend.get_texts()]
    named = min(count, animation.MAX_ENTRIES - (count > animation.MAX_ENTRIES))
    assert all(f"({i}, 0, 175°): docked" in texts[i] for i in range(named))
    assert all(text.startswith(name[:10]) for text in texts[:named])
    colors = [line.get_color() for line in legend.get_lines()]
    assert colors[:named] == [episode["color"] for episode in data["episodes"]][:named]
    box, whole = legend.get_window_extent(), figures[0].bbox
    assert box.x0 >= 0 and box.x1 <= whole.x1
    below = [title for ax in figures[0].axes for title in (ax._left_title, ax)]  # type: ignore[attr-defined]
    assert all(part.get_window_extent().y1 < box.y0 for part in below)
    assert all(text.get_window_extent().y0 > box.y1 for text in figures[0].texts)


def test_a_gif_repeats_all_frames(data: dict[str, Any], tmp_path: Path) -> None:
    path = write_gif(tmp_path / "video.gif", marina(), data)
    with Image.open(path) as video:
        total_ms = 0
        for number in range(video.n_frames):  # type: ignore[attr-defined]  # of GIFs
            video.seek(number)
            total_ms += video.info["duration"]
        assert video.info["loop"] == 0
        assert video.size == (1040, 600)
    assert total_ms == 1000 / GIF_FPS * (1 + STEPS * PERIOD_S * GIF_FPS / SPEED + HOLD_S * GIF_FPS)


@pytest.mark.slow
def test_a_video(data: dict[str, Any], tmp_path: Path) -> None:
    reader = pytest.importorskip("imageio_ffmpeg")
    path = write_mp4(tmp_path / "video.mp4", marina(), data)
    count, seconds = reader.count_frames_and_secs(str(path))
    assert count == 1 + STEPS * PERIOD_S * 30 / SPEED + HOLD_S * 30
    assert seconds == pytest.approx(count / 30, abs=0.05)


def test_without_ffmpeg_the_error_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Any:
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    monkeypatch.setenv("PATH", "")
    with pytest.raises(DockctlError) as error:
        ffmpeg()
    assert "dockctl[video]" in str(error.value)
