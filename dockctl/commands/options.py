"""Options and outputs that several commands share."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from dockctl.console import print_text
from dockctl.errors import DockctlError
from dockctl.run_files import RUNS
from dockctl.runs.directory import RunDirectory, default_policy
from dockctl.runs.files import json_text, require_writable_file, write_json

if TYPE_CHECKING:
    from dockctl.evaluation.policies import LoadedPolicy
    from dockctl.reports.style import Draw
    from dockctl.scenarios.base import Pose


def finite(value: float | None) -> float | None:
    """Reject NaN and infinity, which the ranges of some versions of Click accept.

    Raises:
        typer.BadParameter: the value is not finite.
    """
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"{value} is not a finite number")
    return value


class JsonOutput:
    """Where ``--json`` writes: a file, or standard output, to which nothing else is then printed.

    Args:
        target: path that ends in ``.json``, or ``-``.

    Raises:
        DockctlError: the file cannot be written.
    """

    def __init__(self, target: str) -> None:
        self._stdout = sys.stdout if target == "-" else None
        self._file = Path(target)
        if self._stdout is None:
            require_writable_file(self._file, ".json")

    def write(self, value: Any) -> None:
        """Write plain data; NaN and infinity, which JSON does not support, become null.

        Raises:
            DockctlError: the file cannot be written.
        """
        if self._stdout is None:
            write_json(self._file, value)
        else:
            self._stdout.write(json_text(value))

    @staticmethod
    def reserve(context: typer.Context, output: JsonOutput | None) -> JsonOutput | None:
        """Print all other text on standard error until the command ends, if `output` is standard output."""
        if output is not None and output._stdout is not None:
            context.with_resource(redirect_stdout(sys.stderr))
        return output


Json = Annotated[
    JsonOutput | None,
    typer.Option(
        "--json",
        metavar="FILE",
        parser=JsonOutput,
        callback=JsonOutput.reserve,
        help="Write the result to this file; - is standard output, and other text goes to standard error.",
    ),
]


PolicyArgument = Annotated[
    str | None,
    typer.Argument(
        metavar="POLICY",
        help="Run folder, checkpoint, name of a checkpoint (shipped or in ./checkpoints), registered name,"
        " file.py:factory, module:factory, model.zip:DQN (Stable-Baselines3) or policy.onnx; the latest run"
        " in ./runs by default, or a shipped policy if there is no run.",
    ),
]
Ckpt = Annotated[
    list[str] | None, typer.Option("--ckpt", "--policy", metavar="POLICY", help="The same as POLICY.")
]
ScenarioOption = Annotated[
    str | None, typer.Option(help="Scenario to dock in, file or name; the policy's own by default.")
]
Poses = Annotated[
    list[str] | None,
    typer.Option(
        metavar="X,Y,HEADING",
        help="Start pose [m, m, °]; can be repeated; the evaluation poses by default.",
    ),
]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override a value of the scenario.")
]
Plugins = Annotated[
    list[Path] | None, typer.Option(metavar="FILE", help="Local plugin file (.py) to load first.")
]
Trust = Annotated[
    bool,
    typer.Option("--trust", help="Run the code in a checkpoint or run folder from someone else."),
]
Episodes = Annotated[
    int | None,
    typer.Option(min=0, max=100_000, help="Number of random starts; by default the scenario's."),
]
On = Annotated[
    str | None,
    typer.Option(
        metavar="ray[:ADDRESS]",
        help="Run on all cores of this machine with Ray, or on the cluster at this address.",
    ),
]
StartSeed = Annotated[int | None, typer.Option(min=0, help="Seed of the random starts.")]


def latest_run(*, unsaved: bool = False) -> Path:
    """Return the latest run in ./runs, and print which one it is.

    Args:
        unsaved: see `RunDirectory.latest`.

    Raises:
        DockctlError: there is none.
    """
    return _noted(RunDirectory.latest(RUNS, unsaved=unsaved))


def _noted(run: RunDirectory) -> Path:
    print_text(Console(stderr=True), f"note: using the latest run, {run.path}")
    return run.path


def choose_policy(policy: str | None, ckpt: Sequence[str] | None, scenario: str | None = None) -> str:
    """Return the policy named on the command line, or else `default_policy`, and print which one it is.

    Args:
        policy: argument of the command.
        ckpt: values of the option with the same meaning.
        scenario: the scenario that it will run in.

    Raises:
        DockctlError: several are given.
    """
    given = [*([] if policy is None else [policy]), *(ckpt or ())]
    if len(given) > 1:
        message = f"{' and '.join(given)}: POLICY, --ckpt and --policy mean the same: give one of them"
        raise DockctlError(message)
    if given:
        return given[0]
    return str(_default_policy(scenario))


def _default_policy(scenario: str | None = None) -> Path | str:
    chosen = default_policy(scenario)
    if isinstance(chosen, RunDirectory):
        return _noted(chosen)
    note = f"note: no run with a checkpoint in ./{RUNS} yet; using the shipped policy {chosen}"
    print_text(Console(stderr=True), note)
    return chosen


def latest_run_or_recording() -> tuple[Path, LoadedPolicy | None]:
    """Return the latest run in ./runs, or if there is none a recording of a shipped policy, and that policy.

    Raises:
        DockctlError: the recording cannot be written.
    """
    chosen = _default_policy()
    if isinstance(chosen, Path):
        return chosen, None
    from dockctl.evaluation.loading import load_policy
    from dockctl.evaluation.outputs import record

    policy = load_policy(chosen)
    with Console(stderr=True).status("running episodes"):
        return record(policy), policy


def select_policy(
    policy: str | None,
    ckpt: Sequence[str] | None,
    plugin: Sequence[Path] | None,
    trust: bool,
    scenario: str | None = None,
) -> LoadedPolicy:
    """Load the policy that `choose_policy` returns.

    Args:
        scenario: the scenario that it will run in.

    Raises:
        DockctlError: there is no such scenario or policy, several policies are given, or the policy cannot be
            loaded.
    """
    from dockctl import plugins
    from dockctl.evaluation.loading import load_policy
    from dockctl.scenarios import catalog

    for path in plugin or ():
        plugins.load_file(path)
    if scenario is not None:
        catalog.find(plugins.SCENARIOS, scenario, Path())
    return load_policy(choose_policy(policy, ckpt, scenario), plugin_files=plugin or (), trust=trust)


def parse_numbers(option: str, text: str, expected: str) -> tuple[float, ...]:
    """Parse numbers that are separated by commas.

    Args:
        option: name of the option, for the message.
        expected: description of its value, with an example.

    Raises:
        DockctlError: the text has a different form.
    """
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise DockctlError(f"{option} '{text}': expected {expected}", code="wrong_type") from None


def parse_pose(text: str) -> Pose:
    """Parse ``x,y,heading`` [m, m, degrees].

    Raises:
        DockctlError: the text has a different form, or a number is too large.
    """
    from dockctl.scenarios.base import MAX_COORDINATE_M, MAX_TURN_DEG, Pose

    expected = "three numbers, x,y,heading in m, m and degrees, like 20,2,160"
    numbers = parse_numbers("--pose", text, expected)
    if len(numbers) != 3:
        raise DockctlError(f"--pose '{text}': expected {expected}", code="wrong_type")
    x, y, heading = numbers
    if not (abs(x) <= MAX_COORDINATE_M and abs(y) <= MAX_COORDINATE_M and abs(heading) <= MAX_TURN_DEG):
        limits = f"x and y must be within ±{MAX_COORDINATE_M:,.0f}, the heading within ±{MAX_TURN_DEG:,.0f}"
        raise DockctlError(f"--pose '{text}': {limits}", code="out_of_range")
    return Pose(x_m=x, y_m=y, heading_deg=heading)


def save_figures(draw: Draw, folder: Path) -> list[Path]:
    """Draw figures in the style of the package, write them as PNG and SVG, and print and return the paths.

    Raises:
        DockctlError: the folder cannot be written.
    """
    from dockctl.reports.style import figure_style, save

    with Console(stderr=True).status("drawing the figures"), figure_style():
        written = save(dict(draw()), folder)
    print_paths(written)
    return written


def print_paths(paths: Iterable[Path]) -> None:
    """Print the paths of written files, one per line, in the form of `display_path`."""
    from dockctl.scenarios.catalog import display_path

    for path in paths:
        typer.echo(display_path(path))
