"""Output paths of the measurement commands, and their figures."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from dockctl.console import print_text
from dockctl.errors import DockctlError
from dockctl.runs.directory import FIGURES
from dockctl.runs.files import require_writable, require_writable_file, write_atomically, write_json, writing

if TYPE_CHECKING:
    from dockctl.evaluation.policies import LoadedPolicy
    from dockctl.reports.style import Draw


@dataclass(frozen=True)
class Outputs:
    """Paths of a table and a figure with the same name, and of a copy of the table."""

    tables: Path
    figures: Path
    stem: str
    csv: Path | None
    policy: LoadedPolicy

    @classmethod
    def select(
        cls, what: str, policy: LoadedPolicy, scenario: str | None, out: Path | None, csv: Path | None
    ) -> Outputs:
        """Select the run folder of the policy, or `out`, or a folder under ``figures/``.

        Args:
            what: stem of the files; the scenario's name is appended where it is not the policy's own.
            scenario: the scenario that the user asked for, if any.
            out: the folder that the user asked for, if any.
            csv: the copy of the table, if any.

        Raises:
            DockctlError: a path cannot be written, or there is no such scenario.
        """
        run = policy.run.path if policy.run else None
        if out is None and run and not os.access(run, os.W_OK):
            raise DockctlError(f"{run}: cannot be written; give a folder with --out", code="not_writable")
        tables = out or run or Path(FIGURES) / Path(what).name
        figures = run / FIGURES if run and not out else tables
        for folder in (tables, figures):
            require_writable(folder)
        if csv:
            require_writable_file(csv)
        resolved = policy.scenario(scenario).scenario
        is_own = scenario is None or not policy.is_transfer(resolved)
        stem = what if run and is_own else f"{what}-{resolved.name}"
        return cls(tables, figures, stem, csv, policy)

    def write(self, table: str, draw: Draw) -> None:
        """Draw and write the figures, the table (CSV) and the policy's identity (JSON); print the paths.

        Raises:
            DockctlError: a file cannot be written.
        """
        with writing(self.tables):
            self.tables.mkdir(parents=True, exist_ok=True)
        save_figures(draw, self.figures)
        for path in filter(None, (self.tables / f"{self.stem}.csv", self.csv)):
            print_text(Console(), str(write_atomically(path, table.encode())))
        facts = {"policy": self.policy.facts()}
        print_text(Console(), str(write_json(self.tables / f"{self.stem}.json", facts)))


def save_figures(draw: Draw, folder: Path) -> None:
    """Draw figures in the style of the package, write them as PNG and SVG, and print the paths.

    Raises:
        DockctlError: the folder cannot be written.
    """
    from dockctl.reports.style import figure_style, save

    with figure_style():
        written = save(dict(draw()), folder)
    for path in written:
        print_text(Console(), str(path))
