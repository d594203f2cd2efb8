"""The command ``dockctl``: registers the commands and prints errors."""

from __future__ import annotations

import atexit
import errno
import gc
import importlib
import io
import logging
import os
import signal
import sys
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Annotated, Any

import typer
from rich.console import Console
from typer.core import TyperCommand, TyperGroup

from dockctl import __version__
from dockctl.console import SafeStream, print_text, printable
from dockctl.errors import DockctlError
from dockctl.experiments.interrupt import INTERRUPTED

GROUPS = {
    "Train": {"train": "train", "reproduce": "reproduce"},
    "Evaluate": {
        "evaluate": "evaluate",
        "compare": "compare",
        "map": "map_",
        "envelope": "envelope",
        "returns": "returns",
        "latency": "latency",
        "verify": "verify",
    },
    "Look": {"view": "view", "report": "report", "plot": "plot", "show": "show", "list": "list_registered"},
    "Manage": {
        "init": "init",
        "validate": "validate",
        "config": "config",
        "schema": "schema",
        "runs": "runs",
        "doctor": "doctor",
        "export": "export",
    },
}
"""Commands by heading of the help; the value is the function in the module ``dockctl.commands.<command>``."""
COMMANDS = {name: function for group in GROUPS.values() for name, function in group.items()}


class _OnDemand(Mapping[str, Any]):
    """`COMMANDS` by name, each imported on access, because an invocation needs only one of them."""

    def __iter__(self) -> Iterator[str]:
        return iter(COMMANDS)

    def __len__(self) -> int:
        return len(COMMANDS)

    def __getitem__(self, name: str) -> Any:
        function = COMMANDS[name]
        single = typer.Typer(add_completion=False, rich_markup_mode=None)
        single.command(name, cls=_Command)(
            getattr(importlib.import_module(f"dockctl.commands.{name}"), function)
        )
        return typer.main.get_command(single)


class _Commands(TyperGroup):
    """Prints errors that a user can fix, and errors of plugins, without a traceback."""

    def __init__(self, *, commands: Any, **settings: Any) -> None:
        on_demand: Any = _OnDemand()  # a mapping is enough
        super().__init__(commands=commands or on_demand, **settings)

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise typer.Exit(INTERRUPTED) from None
        except Exception as error:
            # Compiled code turns a KeyboardInterrupt into a SystemError.
            if isinstance(error, SystemError) and isinstance(error.__cause__, KeyboardInterrupt):
                raise typer.Exit(INTERRUPTED) from None
            known = _known_error(error)
            if known is None:
                raise
            for line in str(known).splitlines():
                print_text(Console(stderr=True), f"error: {line}", "red")
            raise typer.Exit(known.exit_code) from known

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the first sentence of every command, under the headings of `GROUPS`."""
        width = max(map(len, COMMANDS))
        for heading, group in GROUPS.items():
            with formatter.section(heading):
                rows = [(f"{name:{width}}", self.commands[name].get_short_help_str(200)) for name in group]
                formatter.write_dl(rows)


class _Command(TyperCommand):
    """Allows options whose metavar is in brackets without a value, which is then the empty string.

    The help does not wrap the example.
    """

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        self.help = (self.help or "").replace("\n\nExample:", "\n\n\b\nExample:")
        super().format_help_text(ctx, formatter)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        optional = {name for each in self.params if str(each.metavar).startswith("[") for name in each.opts}
        words = []
        for word, following in pairwise([*args, "-"]):
            words += [word, ""] if word in optional and following.startswith("-") else [word]
        return super().parse_args(ctx, words)


class _Notes(logging.Handler):
    """Prints the progress of long preparations.

    A spinner on the terminal replaces standard error while it is shown, so that messages appear above it.
    The stream handler of `logging` would keep the stream that it was created with.
    """

    def emit(self, record: logging.LogRecord) -> None:
        print(printable(self.format(record)), file=sys.stderr)


def _known_error(error: Exception) -> DockctlError | None:
    if isinstance(error, DockctlError):
        return error
    from dockctl.plugins import runtime_error  # not before it is needed: the command starts faster

    known = runtime_error(error)
    if known is None and isinstance(error, OSError) and error.filename is not None:  # e.g., name too long
        return DockctlError(f"{error.filename}: {error.strerror}", code="unavailable")
    return known


app = typer.Typer(
    name="dockctl",
    cls=_Commands,
    help="Train a small boat to dock in reverse, and evaluate the result. Start with: dockctl train s3",
    no_args_is_help=True,
    rich_markup_mode=None,  # Rich would read units such as [m] as markup and omit them
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"dockctl {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line."""
    # BLAS threads, started when numpy is imported, wait in busy loops; nothing here uses them.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Imported modules (a million objects with torch) are never freed. Scanning them for garbage, mostly at
    # exit, took a quarter of the CPU time of a short evaluation.
    gc.set_threshold(10_000)
    atexit.register(gc.freeze)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name) or open(os.devnull, "w")  # noqa: PTH123, SIM115  # the shell closed it
        if isinstance(stream, io.TextIOWrapper):
            setattr(sys, name, SafeStream.wrap(stream))
    logger = logging.getLogger("dockctl")
    logger.addHandler(_Notes())
    logger.setLevel(logging.INFO)
    try:
        app(prog_name="dockctl")
    except SystemExit as end:
        if end.code == INTERRUPTED:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # another Ctrl-C would print a traceback
        sys.exit(end.code or _output_status())


def _output_status() -> int:
    """Return the exit status of a finished command; a reader may close the pipe early."""
    if not isinstance(sys.stdout, SafeStream):
        return 0
    sys.stdout.flush()
    failure = sys.stdout.failure
    if failure is None or failure.errno == errno.EPIPE:
        return 0
    typer.secho(f"error: standard output: cannot be written: {failure.strerror}", fg="red", err=True)
    return DockctlError.exit_code
