"""The command line: help without heavy imports, errors without a traceback, exit codes."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from dockctl import __version__, cli
from dockctl.console import command_line
from dockctl.errors import DockctlError

HEAVY = (
    "torch",
    "trimesh",
    "numba",
    "fcl",
    "matplotlib",
    "gymnasium",
    "numpy",
    "pandas",
    "pydantic",
    "yaml",
    "scipy",
)
ANALYSIS = ("pandas", "matplotlib", "jinja2", "scipy.stats")

runner = CliRunner()


def after(expression: str, *commands: str) -> list[list[str]]:
    """Return the words of a list that is evaluated when each of the commands in one process ends."""
    script = "import sys\nfrom dockctl.cli import main\n" + "".join(
        f"sys.argv = {['dockctl', *shlex.split(command)]}\n"
        "try:\n    main()\nexcept SystemExit as end:\n    assert not end.code\n"
        f"print('after:', *{expression}, ':end')\n"
        for command in commands
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return [words.split() for words in re.findall(r"after:(.*):end", done.stdout)]


def test_help_imports_nothing_heavy() -> None:
    assert after(f"[name for name in {HEAVY} if name in sys.modules]", "--help") == [[]]


@pytest.mark.slow
def test_validation_evaluation_and_training_load_no_more_than_they_need(tmp_path: Path) -> None:
    """No tables or drawing, statistics only for intervals, no compiler for validation; torch for training."""
    modules = (*ANALYSIS, "numba", "torch", "trimesh", "torch._dynamo", "sympy")
    loaded = f"[name for name in {modules} if name in sys.modules]"
    short = "--steps 16 --set training.validation.starts=1 --set task.max_steps=2"
    by_validation, by_evaluation = after(loaded, "validate s3", "evaluate s1 --episodes 0")
    (by_training,) = after(loaded, f"train s1 --out {shlex.quote(str(tmp_path))} {short}")
    assert by_validation == []
    assert by_evaluation == ["scipy.stats", "numba"]
    assert {*by_training} <= {"numba", "torch", "trimesh"}


@pytest.mark.parametrize("arguments", [["report"], ["runs", "clean", "--root"], ["train", "--out"]])
def test_a_name_that_the_system_refuses_is_one_error(arguments: list[str]) -> None:
    outcome = runner.invoke(cli.app, [*arguments, 300 * "x"])
    assert outcome.exit_code == 2
    assert len(outcome.stderr.splitlines()) == 1


def test_blas_starts_no_threads() -> None:
    pools = "[pool['num_threads'] for pool in __import__('threadpoolctl').threadpool_info()]"
    (threads,) = after(pools, "config s3")
    assert {*threads} == {"1"}


def test_version() -> None:
    result = runner.invoke(cli.app, ["--version"])
    assert (result.exit_code, result.output) == (0, f"dockctl {__version__}\n")


def test_no_argument_shows_the_help() -> None:
    assert "validate" in runner.invoke(cli.app, []).output


@pytest.mark.parametrize("command", sorted(cli.COMMANDS))
def test_every_command_has_a_help_with_an_example(command: str) -> None:
    """Units in brackets are shown; the example has valid options and needs no file of a checkout."""
    result = runner.invoke(cli.app, [command, "--help"])
    assert result.exit_code == 0, result.output
    shown = "".join(result.output.split())
    parsed = typer.main.get_command(cli.app).commands[command]
    for parameter in parsed.params:
        assert "".join((parameter.help or "").split()) in shown
    (example,) = re.findall(rf"Example: dockctl {command} (.*(?:\n.+)*)", parsed.help)
    arguments = shlex.split(example)
    with parsed.make_context(command, list(arguments)):
        pass
    assert "runs/" not in example  # the names of run folders differ
    assert not any("/" in word and word.endswith((".yaml", ".py")) for word in arguments)  # not installed


def test_the_help_groups_the_commands() -> None:
    output = runner.invoke(cli.app, ["--help"]).output
    words = [line.split()[0] for line in output[output.index("Train:") :].splitlines() if line[:3].strip()]
    assert words == [word for heading, group in cli.GROUPS.items() for word in (f"{heading}:", *group)]


def invoke(error: BaseException) -> tuple[int, str]:
    app = typer.Typer(cls=cli._Commands)

    @app.callback()
    def group() -> None:
        pass

    @app.command()
    def fail() -> None:
        raise error

    result = runner.invoke(app, ["fail"])
    assert result.stdout == ""
    return result.exit_code, result.stderr


def test_an_error_of_the_user_has_no_traceback() -> None:
    assert invoke(DockctlError("no such boat\nno such berth")) == (
        2,
        "error: no such boat\nerror: no such berth\n",
    )


def test_an_interruption_exits_130() -> None:
    assert invoke(KeyboardInterrupt()) == (130, "")


def test_an_interruption_in_compiled_code_exits_130() -> None:
    error = SystemError("returned a result with an exception set")
    error.__cause__ = KeyboardInterrupt()
    assert invoke(error) == (130, "")


def test_ctrl_c_during_the_exit_of_an_interrupted_command_has_no_traceback() -> None:
    code = """
import atexit, os, signal
from dockctl import cli
atexit.register(lambda: os.kill(os.getpid(), signal.SIGINT))
def interrupted(prog_name):
    raise SystemExit(130)
cli.app = interrupted
cli.main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "")


def version(stdout: int, stderr: int) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "dockctl", "--version"]
    return subprocess.run(command, stdout=stdout, stderr=stderr, text=True, timeout=60)


def test_a_full_disk_behind_the_output_is_one_error() -> None:
    with open("/dev/full", "w") as full:  # noqa: PTH123
        done = version(full.fileno(), subprocess.PIPE)
        assert done.returncode == 2
        (line,) = done.stderr.splitlines()
        assert line.startswith("error: ")
        assert version(full.fileno(), full.fileno()).returncode == 2


def test_a_reader_may_close_the_pipe_early() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = version(writer, subprocess.PIPE)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_output_may_be_closed() -> None:
    for closed in (">&-", ">&- 2>&-"):
        command = f"{shlex.quote(sys.executable)} -m dockctl list scenarios {closed}"
        done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60)
        assert (done.returncode, done.stderr) == (0, "")


def test_a_command_can_be_pasted_into_a_shell() -> None:
    words = ("plot", Path("my runs/it's"))
    assert shlex.split(command_line(*words)) == ["dockctl", *map(str, words)]


def test_an_unknown_option_exits_2() -> None:
    assert runner.invoke(cli.app, ["validate", "--nothing-like-it"]).exit_code == 2


def test_works_from_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = runner.invoke(cli.app, ["validate", "s1"])
    assert (result.exit_code, result.output[:6]) == (0, "ok s1:")


def error_of(*arguments: str) -> DockctlError:
    error: BaseException | None = runner.invoke(cli.app, arguments).exception
    while error and not isinstance(error, DockctlError):
        error = error.__cause__ or error.__context__
    assert error
    return error


@pytest.mark.parametrize(
    "command", ["returns --scenario", "evaluate --scenario", "map --scenario", "latency --scenario"]
)
def test_a_scenario_that_does_not_exist_is_reported_before_a_run_that_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert error_of(*command.split(), "s11").suggestion == "s1"


@pytest.mark.parametrize(
    ("policy", "code"), [(":x", "not_found"), (":", "not_found"), ("no_module:x", "plugin")]
)
def test_a_policy_that_cannot_be_imported_names_no_file_of_dockctl(policy: str, code: str) -> None:
    error = error_of("evaluate", "--policy", policy, "--scenario", "s1")
    assert error.code == code
    assert not re.search(r"\.py:\d", str(error))


@pytest.mark.parametrize("module", ["typer", "dockctl.cli"])
def test_ctrl_c_during_the_imports_ends_quietly(module: str) -> None:
    script = (
        "import signal, sys\n"
        "from dockctl.__main__ import main\n"
        "class Finder:\n"
        "    @staticmethod\n"
        "    def find_spec(name, *_):\n"
        f"        if name == {module!r}: signal.raise_signal(signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder)\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")
