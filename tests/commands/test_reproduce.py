"""``dockctl reproduce``: finished work is not repeated, the rest is done, and Ctrl-C leaves it resumable."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from rich.console import Console

import dockctl as package
from dockctl.errors import DockctlError
from dockctl.experiments import jobs as jobs_module
from dockctl.experiments.runner import Display, JobRunner, Progress
from dockctl.experiments.study import (
    Experiment,
    Job,
    Stage,
    Study,
    make_jobs,
    nearest_failures,
    require_own_results,
    with_archived,
)
from dockctl.scenarios.content import with_paths
from dockctl.scenarios.loader import dump, load
from tests.commands.conftest import QUICK, Outcome, dockctl

Trained = tuple[Path, Outcome]
EXAMPLES = Path(__file__).parents[2] / "examples"
SET = (*QUICK, "training.total_steps=300")


def tiny(**given: object) -> Experiment:
    facts = {"name": "tiny", "group": "g", "scenario": "s1", "seeds": 4, "set": SET, **given}
    return Experiment.model_validate(facts)


def write_study(folder: Path, experiment: Experiment) -> Path:
    path = folder / "mine.yaml"
    path.write_text(json.dumps({"experiments": [experiment.model_dump(mode="json")]}))
    return path


@pytest.fixture
def out(trained: Trained, tmp_path: Path) -> Path:
    """Run folders of the study `mine`, with the finished training of seed 3."""
    folder = tmp_path / "runs" / "mine"
    run = folder / "tiny" / "s1" / trained[0].name
    shutil.copytree(trained[0], run, ignore=shutil.ignore_patterns("figures", "evaluation*"))
    return folder


def the_run(out: Path) -> Path:
    (run,) = (out / "tiny").glob("*/*")
    return run


def jobs(out: Path, **given: object) -> list[Job]:
    return make_jobs([tiny(**given)], out)


def change_facts(run: Path, **facts: object) -> None:
    path = run / "provenance.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | facts))


def test_finished_training_is_not_repeated(out: Path) -> None:
    *others, third = jobs(out)
    assert third.training() is None
    assert third.finished() == the_run(out)
    assert [stage.name for stage in third.measurements()] == ["evaluate", "plot"]
    for job in others:
        stage = job.training()
        assert stage is not None
        assert stage.arguments[:3] == ("train", "s1", "--seed")
        assert [*stage.arguments].count("--set") == len(SET)


def test_run_is_recognized_by_its_scenario_not_its_folder_name(out: Path) -> None:
    the_run(out).rename(the_run(out).parent / "renamed")
    assert jobs(out)[3].training() is None


def test_mismatched_run_is_reported_and_not_used(out: Path) -> None:
    job = jobs(out, set=(*SET, "reward.terms.speed=-5"))[3]
    stage = job.training()
    assert stage is not None
    assert stage.name == "train"
    ((run, difference),) = job.mismatched_runs()
    assert run == the_run(out)
    assert difference.startswith("reward.terms")


def test_run_of_a_seed_that_begins_with_the_same_digit_is_not_mismatched(out: Path) -> None:
    other = shutil.copytree(the_run(out), the_run(out).with_name("20250101-000000-seed30"))
    scenario = other / "scenario.yaml"
    scenario.write_text(scenario.read_text().replace("seed: 3\n", "seed: 30\n"))
    assert load(scenario).scenario.training.seed == 30
    assert [*jobs(out)[3].mismatched_runs()] == []


def test_mesh_is_compared_by_content(out: Path) -> None:
    source = EXAMPLES / "custom-harbor" / "s1-pontoon.yaml"
    job = jobs(out, scenario=str(source))[3]
    run, mesh = the_run(out), the_run(out) / "meshes" / "00-pontoon.obj"
    mesh.parent.mkdir()
    shutil.copy(source.with_name("pontoon.obj"), mesh)
    (run / "scenario.yaml").write_text(dump(with_paths(job.scenario, (), ["meshes/00-pontoon.obj"])))
    assert job.training() is None
    mesh.write_text(mesh.read_text() + "# changed\n")
    ((_, difference),) = job.mismatched_runs()
    assert difference.startswith("harbor.meshes")


def test_interrupted_training_is_resumed(out: Path) -> None:
    change_facts(the_run(out), finished=None, stop_reason="interrupted")
    stage = jobs(out)[3].training()
    assert stage is not None
    assert stage.arguments == ("train", "--resume", str(the_run(out)))
    given = make_jobs(
        [tiny()], out, ["--device", "cpu", "--log", "tensorboard"], ["--tag", "first"], trust=True
    )
    stage = given[3].training()
    assert stage is not None
    assert stage.arguments[3:] == ("--device", "cpu", "--log", "tensorboard", "--trust")
    shutil.rmtree(the_run(out) / "checkpoints")
    stage = jobs(out)[3].training()
    assert stage is not None
    assert stage.name == "train"


def test_measurements_follow_the_experiment(out: Path) -> None:
    job = jobs(out, evaluate_on=["s2"], probes=["latency", "returns"])[3]
    names = ["evaluate", "evaluate on s2", "plot", "latency", "returns"]
    assert [stage.name for stage in job.measurements()] == names
    assert (
        dockctl("evaluate", "--ckpt", the_run(out), "--scenario", "s2", "--episodes", 0, "--record").code == 0
    )
    assert [stage.name for stage in job.measurements()] == [n for n in names if n != "evaluate on s2"]


@pytest.mark.usefixtures("one_figure")
def test_a_result_that_is_torn_stale_or_of_another_policy_is_made_again(out: Path) -> None:
    (job,), run = jobs(out)[3:], the_run(out)

    def left() -> list[str]:
        return [stage.name for stage in job.measurements()]

    assert dockctl("evaluate", "--ckpt", run, "--episodes", 0).code == 0
    assert left() == ["plot"]
    assert dockctl("plot", run).code == 0
    assert left() == []
    (figure,) = run.glob("figures/*.png")
    for name in (f"figures/{figure.name}", "episodes.csv", "evaluation.csv"):
        content = (run / name).read_bytes()
        (run / name).write_bytes(content[:-9])
        assert left() == ["evaluate" if name == "evaluation.csv" else "plot"]
        (run / name).write_bytes(content)
    facts = json.loads((run / "evaluation.json").read_text())
    facts["policy"]["sha256"] = "0" * 64
    (run / "evaluation.json").write_text(json.dumps(facts))
    assert left() == ["evaluate"]


@pytest.mark.usefixtures("one_figure")
def test_a_run_without_a_finished_episode_is_plotted(out: Path) -> None:
    (job,), run = jobs(out)[3:], the_run(out)
    (run / "episodes.csv").unlink()
    assert dockctl("plot", run).code == 0
    assert [stage.name for stage in job.measurements()] == ["evaluate"]


def test_a_full_disk_behind_a_log_is_a_failure_of_its_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (job,) = jobs(tmp_path, seeds=1)
    job.folder.mkdir(parents=True)
    job.log.symlink_to("/dev/full")
    ended = work([job], {0: [Stage("good", ("--version",))]}, monkeypatch)[0]
    assert ended.state == "failed"
    assert str(job.log) in ended.reason


def test_jobs_that_were_not_started_are_not_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stage = Stage("good", ("--version",))
    monkeypatch.setattr(jobs_module, "remaining", lambda job: iter([stage, stage]))
    runner = JobRunner(jobs(tmp_path, seeds=3), 1, lambda progress: runner.stop())
    runner.work(lambda: None)
    assert [progress.state for progress in runner.progress] == ["stopped", "waiting", "waiting"]
    assert [progress.job.log.exists() for progress in runner.progress] == [True, False, False]


def test_the_nearest_failures_are_one_of_each_kind(tmp_path: Path) -> None:
    table = tmp_path / "map.csv"
    table.write_text(
        "dx_m,dy_m,dheading_deg,x_m,y_m,heading_deg,blocked,outcome,phase\n"
        "1,0,0,24,-10,90,0,collision,0\n"
        "1,0,90,24,-10,180,0,collision,1\n"
        "4,0,0,27,-10,90,0,collision,1\n"
        "5,0,20,28,-10,110,0,timeout,0\n"
        "2,0,0,25,-10,90,0,timeout,1\n"
        "3,0,0,26,-10,90,1,,\n"
    )
    assert nearest_failures(table) == ["27,-10,90", "28,-10,110"]
    lines = table.read_text().splitlines(keepends=True)
    table.write_text("".join(line for line in lines if "collision,1" not in line))
    assert nearest_failures(table) == ["24,-10,90", "28,-10,110"]


def work(
    jobs: list[Job], stages: dict[int, list[Stage]], monkeypatch: pytest.MonkeyPatch
) -> dict[int, Progress]:
    monkeypatch.setattr(jobs_module, "remaining", lambda job: iter(stages.get(job.seed, [])))
    runner = JobRunner(jobs, 2, lambda progress: None)
    runner.work(lambda: None)
    return {progress.job.seed: progress for progress in runner.progress}


@pytest.mark.slow
def test_failure_stops_only_its_own_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good, bad = Stage("good", ("--version",)), Stage("bad", ("validate", "s9"))
    ended = work(jobs(tmp_path, seeds=3), {0: [good, good], 1: [bad, good]}, monkeypatch)
    assert [ended[seed].state for seed in range(3)] == ["done", "failed", "done"]
    assert ended[1].reason.startswith("error: ") and "'s9'" in ended[1].reason
    assert ended[0].job.log.read_text().count("$ dockctl --version\ndockctl ") == 2


@pytest.mark.parametrize("stage", ["", "plot"])
def test_failure_is_one_line(tmp_path: Path, stage: str) -> None:
    (job,) = jobs(tmp_path, seeds=1)
    console = Console(file=io.StringIO())
    board = Display(console, JobRunner([job], 1, lambda progress: None))
    board.report(Progress(job, state="failed", stage=stage, reason="no  failed [x]"))
    assert isinstance(console.file, io.StringIO)
    (line,) = console.file.getvalue().splitlines()
    assert all(words in line for words in ("tiny seed 0: ", stage, "no  failed [x]", str(job.log)))


def test_stage_without_its_file_has_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stage = Stage("empty", ("--version",), outputs=(tmp_path / "nowhere",))
    assert work(jobs(tmp_path, seeds=1), {0: [stage]}, monkeypatch)[0].state == "failed"


@pytest.mark.slow
@pytest.mark.thorough  # tests/commands/test_train.py interrupts a training in this process
def test_ctrl_c_leaves_a_resumable_training(tmp_path: Path) -> None:
    endless = tiny(seeds=1, set=(*QUICK, "training.total_steps=1000000"))
    command = [
        *(sys.executable, "-m", "dockctl", "reproduce", "--study", str(write_study(tmp_path, endless))),
        *("--out", "out", "--results", "results"),
    ]
    paths = {"PYTHONPATH": str(Path(package.__file__).parent.parent)}
    process = subprocess.Popen(
        command, cwd=tmp_path, env=os.environ | paths, stdout=subprocess.PIPE, text=True, process_group=0
    )
    try:
        while not list(tmp_path.glob("out/mine/tiny/s1/*/checkpoints/last/learner.json")):
            assert process.poll() is None
            time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        printed, _ = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130
    assert "dockctl reproduce --study" in printed
    (job,) = make_jobs([endless], tmp_path / "out" / "mine")
    stage = job.training()
    assert stage is not None
    assert stage.name == "resume"
    assert not (tmp_path / "results").exists()


def snapshot(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


@pytest.mark.usefixtures("in_process")
def test_study_writes_only_its_own_runs_and_results(
    trained: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = write_study(tmp_path, tiny(seeds=1))
    monkeypatch.setattr(Experiment, "overrides", lambda self, seed: [*self.set, "training.seed=3"])
    shutil.copytree(trained[0], tmp_path / "runs" / "reproduce" / "mine" / "tiny" / "s1" / trained[0].name)
    for name in ("docs/results.md", "docs/figures/results/other.png", "results/thesis/s1/seed0/scene.json"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_text("of another study")
    before = snapshot(tmp_path)
    monkeypatch.chdir(tmp_path)
    outcome = dockctl("reproduce", "--study", source)
    assert outcome.code == 0, outcome.err
    after = snapshot(tmp_path)
    assert "results/mine/tiny/seed0/episodes.csv.gz" in after
    assert before.items() <= after.items()
    own = ("results/mine/", "runs/reproduce/mine/")
    assert [name for name in after if name not in before and not name.startswith(own)] == []


def test_results_of_another_study_of_the_same_name_are_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, results = write_study(tmp_path, tiny(seeds=1)), tmp_path / "results" / "mine"
    (results / "tiny" / "seed0").mkdir(parents=True)
    (results / "study.json").write_text(
        json.dumps({"experiments": [tiny(set=["training.gamma=0.9"])]}, default=vars)
    )
    before = snapshot(tmp_path)
    monkeypatch.chdir(tmp_path)
    outcome = dockctl("reproduce", "--study", source)
    assert outcome.code == 2
    assert isinstance(outcome.error, DockctlError) and outcome.error.code == "mismatch"
    assert str(Path("results") / "mine" / "tiny") in outcome.err
    assert snapshot(tmp_path) == before
    shutil.rmtree(results / "tiny")
    monkeypatch.setattr("dockctl.experiments.runner.run_jobs", lambda *given: ("done", []))
    assert dockctl("reproduce", "--study", source).code == 0


def test_a_study_of_the_same_name_keeps_what_is_archived_of_other_experiments(tmp_path: Path) -> None:
    results, first = tmp_path / "results", Study(experiments=(tiny(), tiny(name="removed")))
    (results / "tiny").mkdir(parents=True)
    (results / "study.json").write_text(first.model_dump_json())
    merged = with_archived(Study(experiments=(tiny(name="second"),)), results)
    assert [experiment.name for experiment in merged.experiments] == ["tiny", "second"]
    (results / "study.json").write_text(merged.model_dump_json())
    with pytest.raises(DockctlError):
        require_own_results(Study(experiments=(tiny(set=("training.gamma=0.9",)),)), results)
    assert with_archived(first, results) == first


def test_errors_come_before_anything_is_written(tmp_path: Path) -> None:
    outcome = dockctl("reproduce", "s7", "--out", tmp_path / "out")
    assert (outcome.code, (tmp_path / "out").exists()) == (2, False)
    assert "'s7'" in outcome.err
    source = write_study(tmp_path, tiny(set=("training.bots=2",)))
    outcome = dockctl("reproduce", "--study", source, "--out", tmp_path / "out")
    assert (outcome.code, (tmp_path / "out").exists()) == (2, False)
    assert "experiment tiny: --set training.bots: " in outcome.err
    assert "'boats'" in outcome.err
    mine = write_study(tmp_path, tiny())
    mine.rename(tmp_path / "thesis.yaml")
    outcome = dockctl("reproduce", "--study", tmp_path / "thesis.yaml", "--out", tmp_path / "out")
    assert (outcome.code, (tmp_path / "out").exists()) == (2, False)
    assert re.search(r"thesis\.yaml:\d+:\d+: name: ", outcome.err)
