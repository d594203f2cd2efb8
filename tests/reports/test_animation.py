"""Videos: number, size and content of the frames, and the files."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb
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
        "arrays": {
            "pose": np.stack([x, zeros, zeros], axis=1),
            "command": np.stack([50 + zeros, zeros], axis=1),
            "ranges": np.full((STEPS + 1, 8), 100.0),
            "distance_m": 30 - x,
            "phase": np.ones(STEPS + 1, np.uint8),
        },
    }
    return {"title": "A video", "period_s": PERIOD_S, "range_m": 100.0, "episodes": [episode]}


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
