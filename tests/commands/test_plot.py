"""``dockctl plot``: figures, output folders and damaged input."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from tests.commands.conftest import Outcome, dockctl

Trained = tuple[Path, Outcome]


@pytest.fixture
def run(trained: Trained, tmp_path: Path) -> Path:
    folder = tmp_path / "runs" / "s1" / "20250101-000000-seed3"
    shutil.copytree(trained[0], folder)
    return folder


@pytest.fixture
def not_rendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made, and their files are empty; tests/reports/test_figures.py renders them."""
    monkeypatch.setattr(Figure, "savefig", lambda *_, **options: None)


@pytest.mark.usefixtures("not_rendered")
def test_the_latest_run_is_drawn_into_its_folder(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(run.parent.parent.parent)
    outcome = dockctl("plot")
    assert outcome.code == 0
    printed = outcome.out.split()
    assert sorted(printed) == sorted(
        str(path.relative_to(Path.cwd())) for path in (run / "figures").iterdir()
    )
    assert {"overview.png", "overview.svg", "docking-poses.png", "training-reward.svg"} <= {
        Path(path).name for path in printed
    }


@pytest.mark.usefixtures("not_rendered")
@pytest.mark.thorough
def test_without_a_run_a_recording_of_a_shipped_policy_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for _ in range(2):  # the second time it replaces the recording
        outcome = dockctl("plot")
        assert outcome.code == 0, outcome.err
        recording = Path("figures/evaluate/s3-s3")
        assert str(recording / "figures" / "docking-poses.png") in outcome.out.split()
        assert (recording / "trajectories.csv").is_file()
        assert len((recording / "evaluation.csv").read_text(encoding="utf-8").splitlines()) == 1 + 1 + 100


@pytest.mark.usefixtures("not_rendered")
def test_only_the_run_folder_is_read(run: Path, tmp_path: Path) -> None:
    shutil.rmtree(run / "checkpoints")
    (run / "trajectories.csv").unlink()
    outcome = dockctl("plot", run, "--out", tmp_path / "figures")
    assert outcome.code == 0
    assert "trajectories.csv" in outcome.err
    names = {path.stem for path in (tmp_path / "figures").glob("*.svg")}
    assert names
    assert all(name.startswith("training-") for name in names)
    assert not (run / "figures").exists()


@pytest.mark.parametrize("exists", [True, False])
def test_a_folder_without_run(tmp_path: Path, exists: bool) -> None:
    folder = tmp_path / "nothing"
    if exists:
        folder.mkdir()
    outcome = dockctl("plot", folder)
    assert outcome.code == 2
    assert str(folder) in outcome.err
    assert "Traceback" not in outcome.err


@pytest.mark.parametrize(
    ("name", "old", "new", "location"),
    [
        ("trajectories.csv", ",0.5,", ",x0.5,", "trajectories.csv:3: time_s"),
        ("scene.json", '"hull_m": [', '"hull_m": [], "was": [', "scene.json"),
        ("scene.json", '"bounds_m": [', '"bounds_m": [0, 0, NaN, 1], "was": [', "scene.json"),
    ],
)
def test_a_damaged_file(run: Path, name: str, old: str, new: str, location: str) -> None:
    text = (run / name).read_text()
    assert old in text
    (run / name).write_text(text.replace(old, new, 1))
    outcome = dockctl("plot", run)
    assert outcome.code == 2
    assert location in outcome.err
    assert not (run / "figures").exists()
