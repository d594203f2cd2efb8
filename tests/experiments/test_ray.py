"""Studies and evaluations on Ray give what they give without it, also if a worker is killed.

``DOCKCTL_RAY=1`` adds the trainings, which take a minute.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import tempfile
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import psutil
import pytest

from dockctl import cluster
from dockctl.errors import DockctlError
from dockctl.evaluation import evaluate
from dockctl.evaluation.envelope import envelope
from dockctl.experiments.runner import JobRunner
from dockctl.experiments.study import Experiment, Stage, make_jobs
from dockctl.run_files import PROVENANCE
from tests.commands.conftest import QUICK, dockctl, only_run, quick_train

TABLES = ("episodes.csv", "updates.csv", "evaluations.csv", "trajectories.csv")
needs_ray = pytest.mark.skipif(find_spec("ray") is None, reason="dockctl[ray] is not installed")


@pytest.mark.slow
@pytest.mark.thorough  # Ray takes long to start
@needs_ray
def test_an_evaluation_on_ray_is_that_of_one_process(tmp_path: Path) -> None:
    assert quick_train(tmp_path, "s1", "--steps", 100).code == 0
    run = only_run(tmp_path)
    here, there = evaluate(run, episodes=60), evaluate(run, episodes=60, on="ray")
    assert len(here.rows()) > 60
    assert here.rows() == there.rows()
    assert here.as_json() == there.as_json()
    grown_here, grown_there = (
        envelope(run, factors=("current", "delay"), episodes=40, on=on) for on in (None, "ray")
    )
    assert grown_here.rows == grown_there.rows


@pytest.mark.slow
@needs_ray
@pytest.mark.skipif(not os.environ.get("DOCKCTL_RAY"), reason="takes minutes; run with DOCKCTL_RAY=1")
@pytest.mark.parametrize("victim", ["ray::Worker", "dockctl train"])
def test_a_training_whose_worker_is_killed_ends_like_one_on_this_machine(tmp_path: Path, victim: str) -> None:
    assert quick_train(tmp_path / "here", "s1", "--seed", 0, "--steps", 600).code == 0
    settings = (*QUICK, "training.total_steps=600")
    experiment = {"name": "tiny", "group": "g", "scenario": "s1", "set": settings}
    (job,) = make_jobs([Experiment.model_validate(experiment)], tmp_path / "there")
    started = job.training()
    assert started is not None
    killed: list[int] = []

    def kill() -> None:
        """Kill the worker once, when the head has a checkpoint."""
        if not killed and [*job.folder.glob("*/*/checkpoints/last/learner.json")] and not job.finished():
            for process in psutil.Process().children(recursive=True):
                with suppress(psutil.NoSuchProcess):
                    if not killed and victim in " ".join(process.cmdline()):
                        process.kill()
                        killed.append(process.pid)

    with cluster.connected("ray"):
        from dockctl.experiments.ray_jobs import RayJob

        runner = JobRunner([job], 1, lambda progress: None, RayJob)
        runner.work(kill)
    (progress,) = runner.progress
    assert progress.state == "done", progress.reason
    log = job.log.read_text()
    assert killed
    assert log.count("$ dockctl train --resume") == 1
    found, expected = job.finished(), only_run(tmp_path / "here")
    assert found is not None
    assert [*job.measurements()] == []
    for name in TABLES:
        assert (found / name).read_bytes() == (expected / name).read_bytes(), name
    facts = json.loads((found / PROVENANCE).read_text())
    assert facts["command"][1:] == [*started.arguments]
    assert [call["command"][1:] for call in facts["resumed"]] == [["train", "--resume", str(found)]]


@needs_ray
def test_the_recorded_command_is_that_of_a_job_on_this_machine() -> None:
    from dockctl.experiments.ray_jobs import with_command, with_log_line

    here, local = Stage("train", ("train", "scenario.yaml")), Stage("train", ("train", "s1", "--set", "a=1"))
    log = b"$ dockctl train scenario.yaml\nrun folder: runs/a\n"
    assert with_log_line(log, here, local) == b"$ dockctl train s1 --set a=1\nrun folder: runs/a\n"
    first, other = ["dockctl", *here.arguments], ["dockctl", "train", "--resume", "/runs/a"]
    facts = {"seed": 0, "command": first, "resumed": [{"command": other}]}
    found = json.loads(with_command(json.dumps(facts).encode(), here, local))
    assert found == {**facts, "command": ["dockctl", *local.arguments]}
    resumed = Stage("resume", ("train", "--resume", "runs/a"))
    facts = {"command": first, "resumed": [{"command": other}, {"command": ["x", *resumed.arguments]}]}
    there = Stage("resume", ("train", "--resume", "/runs/a"))
    found = json.loads(with_command(json.dumps(facts).encode(), resumed, there))
    assert found == {"command": first, "resumed": [{"command": other}, {"command": ["x", *other[1:]]}]}


@needs_ray
def test_runs_of_a_worker_are_written_in_one_step_and_replace_no_others(tmp_path: Path) -> None:
    from dockctl.experiments.ray_jobs import receive

    first = {"s1/a/table.csv": b"1", "s1/a/checkpoints/last/x": b"2"}
    receive(tmp_path, frozenset(first), first, set())
    receive(tmp_path, frozenset({"s1/a/table.csv", "s1/a/y"}), {"s1/a/y": b"3"}, {*first})
    files = {str(p.relative_to(tmp_path)): p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    assert files == {"s1/a/table.csv": b"1", "s1/a/y": b"3"}
    with pytest.raises(DockctlError) as caught:
        receive(tmp_path, frozenset(first), first, set())
    assert caught.value.code == "duplicate"
    assert (tmp_path / "s1" / "a" / "y").read_bytes() == b"3"


@needs_ray
def test_folders_of_killed_workers_are_removed_and_those_at_work_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from dockctl.experiments.ray_jobs import temporary_folder

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    script = "import sys, tempfile; tempfile.tempdir = sys.argv[1]\n"
    script += "from dockctl.experiments.ray_jobs import temporary_folder as folder\n"
    script += "with folder() as path: print(path, flush=True); input()"
    command = [sys.executable, "-c", script, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as worker:
        assert worker.stdout
        killed = Path(worker.stdout.readline().strip())
        with temporary_folder() as first:
            assert {*tmp_path.iterdir()} == {killed, first}
            worker.kill()
            worker.wait()
            with temporary_folder() as second:
                assert {*tmp_path.iterdir()} == {first, second}
    assert not [*tmp_path.iterdir()]


def refused(on: str) -> DockctlError:
    with pytest.raises(DockctlError) as caught, cluster.connected(on):
        pass
    return caught.value


@pytest.mark.parametrize("on", ["rya", "ray:", "local"])
def test_unknown_places_are_errors(on: str) -> None:
    outcome = dockctl("evaluate", "s1", "--episodes", 0, "--on", on)
    assert outcome.code == 2
    assert "ray:ADDRESS" in outcome.err


@needs_ray
def test_an_address_that_cannot_be_reached_is_an_error_at_once() -> None:
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{closed.getsockname()[1]}"
        for given in (address, f"ray://{address}", "no-port", "host:port"):
            with (
                pytest.raises(DockctlError) as caught,
                cluster.connected(f"ray:{given}"),
            ):
                pass
            assert caught.value.code == "unavailable"
            assert f"ray:{given}" in str(caught.value)


@needs_ray
@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("to_cluster", [False, True])
def test_a_missing_token_is_an_error(to_cluster: bool, tmp_path: Path) -> None:
    """Ray reads its environment once, so this runs in another process."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        place = f"ray:127.0.0.1:{server.getsockname()[1]}" if to_cluster else "ray"
        token = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(tmp_path / "missing")}
        command = [sys.executable, "-m", "dockctl", "evaluate", "s1", "--episodes", "0", "--on", place]
        ended = subprocess.run(command, env=os.environ | token, capture_output=True, text=True, check=False)
    assert ended.returncode == DockctlError.exit_code
    assert f"--on {place}: " in ended.stderr and "RAY_AUTH_TOKEN" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_without_ray_the_error_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with (
        pytest.raises(DockctlError, match=r"pip install 'dockctl\[ray\]'") as caught,
        cluster.connected("ray"),
    ):
        pass
    assert caught.value.code == "unavailable"


@needs_ray
@pytest.mark.parametrize("reason", ["The current node timed out during startup.\nMore.", ""])
def test_a_machine_that_is_too_slow_for_ray_is_an_error(reason: str, monkeypatch: pytest.MonkeyPatch) -> None:
    import ray

    def init(*_: object, **__: object) -> None:
        raise Exception(reason)  # what Ray raises then

    monkeypatch.setattr(ray, "init", init)
    caught = refused("ray")
    assert caught.code == "unavailable"
    assert len(str(caught).splitlines()) == 1 and reason.split("\n")[0] in str(caught)


def test_another_version_on_a_worker_is_an_error() -> None:
    with pytest.raises(DockctlError, match=r"0\.0\.7") as caught:
        cluster.require_version("0.0.7")
    assert caught.value.code == "mismatch"
