"""Labels, colors and phases of recorded trajectories."""

from __future__ import annotations

import pandas as pd
import pytest

from dockctl.analysis.trajectories import pose_label, tracks_of
from dockctl.drawing import palette
from tests.reports import synthetic

STARTS = [(20.0, 3.0, 150.0), (20.0, 2.0, 160.0), (20.0, -1.5, 190.0)]


def test_labels_and_colors_of_tracks() -> None:
    three = pd.concat([synthetic.track(i, start) for i, start in enumerate(STARTS)])
    tracks = tracks_of(three)
    assert [track.label for track in tracks] == ["(20, 3, 150°)", "(20, 2, 160°)", "(20, −1.5, 190°)"]
    assert [track.color for track in tracks] == [palette.RED, palette.GREEN, palette.BLUE]
    assert all(len(track.table) == len(three) / 3 for track in tracks)


def test_a_single_track() -> None:
    (track,) = tracks_of(synthetic.track(0, (23.0, -10.0, 90.0), intermediate=True, steps=20))
    assert track.docked
    assert track.color == palette.SINGLE
    assert track.switch == 20


@pytest.mark.parametrize(
    ("pose", "text"),
    [
        ((20, 2, -200), "(20, 2, 160°)"),
        ((-0.004, -1.25, 360), "(0, −1.25, 0°)"),
        ((1, 1, 359.999), "(1, 1, 0°)"),
    ],
)
def test_pose_labels(pose: tuple[float, float, float], text: str) -> None:
    assert pose_label(*pose) == text
