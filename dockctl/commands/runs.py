"""``dockctl runs``: list run folders, and delete what is not needed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Column
from rich.text import Text

from dockctl.commands.options import Json
from dockctl.console import make_table, numeric, print_table, print_text
from dockctl.errors import DockctlError, nearest
from dockctl.run_files import RUNS

if TYPE_CHECKING:
    from dockctl.runs.listing import RunSummary

ACTIONS = ("list", "clean")


def runs(
    action: Annotated[
        str, typer.Argument(metavar="|".join(ACTIONS), help="What to do.", autocompletion=lambda: [*ACTIONS])
    ] = ACTIONS[0],
    root: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder of the runs.")] = RUNS,
    yes: Annotated[bool, typer.Option("--yes", help="With clean: delete instead of only listing.")] = False,
    json_: Json = None,
) -> None:
    """List the runs with their state, or what can be deleted.

    `clean` lists unfinished runs without a checkpoint, and the older checkpoints of finished runs, which are
    backups of the newest; --yes deletes them. Runs in progress are skipped. The tables and results of
    finished runs, and of runs with a checkpoint, are kept.

    Example: dockctl runs clean --root runs
    """
    if action not in ACTIONS:
        message = f"'{action}': expected one of {', '.join(ACTIONS)}"
        raise DockctlError(message, code="unknown_name", suggestion=nearest(action, ACTIONS))
    if not root.is_dir() and root != RUNS:
        raise DockctlError(
            f"{root}: no such folder; `dockctl train` writes runs to ./{RUNS}", code="not_found"
        )
    if action == "clean":
        _clean(root, yes, json_)
    elif yes:
        raise DockctlError("--yes: only `dockctl runs clean` deletes")
    else:
        _list(root, json_)


def _list(root: Path, json_: Json) -> None:
    from dockctl.runs.directory import RunDirectory
    from dockctl.runs.listing import summarize

    found = [summarize(run) for run in RunDirectory.below(root)]
    if json_:
        json_.write([run.to_json() for run in found])
        return
    if not found:
        print_text(Console(), f"no runs in {root}; `dockctl train` creates one")
        return
    steps, success, size = numeric("steps", "success", "MB")
    name, scenario, tags = (
        Column(each, overflow="fold", min_width=15) for each in ("name", "scenario", "tags")
    )
    table = make_table(Column("run", overflow="fold"), name, scenario, "state", steps, success, tags, size)
    for run in found:
        table.add_row(*map(Text, _cells(run, root)))  # a name may look like markup
    table.columns = [column for column in table.columns if any(column.cells)]
    print_table(Console(), table)


def _cells(run: RunSummary, root: Path) -> tuple[str, ...]:
    steps = "" if run.env_steps is None else f"{run.env_steps:,}"
    success = "" if run.success is None else f"{run.success:.0%}"
    where = str(run.path.relative_to(root))  # contains the seed
    return where, run.name, run.scenario, run.state, steps, success, " ".join(run.tags), _mb(run.size)


def _clean(root: Path, yes: bool, json_: Json) -> None:
    from dockctl.experiments.clean import delete, garbage_below

    found = list(garbage_below(root))
    if yes:
        for garbage in found:
            delete(garbage)
    if json_:
        json_.write({"deleted": yes, "found": [garbage.to_json() for garbage in found]})
        return
    table = make_table(Column("run", overflow="fold"), "what", *numeric("items", "MB"))
    for garbage in found:
        table.add_row(
            Text(str(garbage.run.relative_to(root))),
            garbage.reason,
            str(len(garbage.paths)),
            _mb(garbage.size),
        )
    print_table(Console(), table)
    total = f"{_mb(sum(garbage.size for garbage in found))} MB"
    print_text(Console(), f"Deleted: {total}." if yes else f"{total}; nothing is deleted without --yes.")


def _mb(size: int) -> str:
    return f"{size / 1e6:,.1f}"
