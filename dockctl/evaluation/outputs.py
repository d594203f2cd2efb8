"""Where the commands that measure a policy leave what they found."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from dockctl.console import say
from dockctl.errors import DockctlError
from dockctl.runs.directory import require_writable
from dockctl.runs.files import write_atomically, writing

if TYPE_CHECKING:
    from dockctl.evaluation.policies import Trained
    from dockctl.scenarios.schema import Scenario


@dataclass(frozen=True)
class Places:
    """A table and a figure of one name, and a second place for the table.

    Attributes:
        policy: hash of the policy that is measured.
    """

    tables: Path
    figures: Path
    stem: str
    csv: Path | None
    policy: str

    @classmethod
    def of(
        cls,
        what: str,
        trained: Trained,
        scenario: Scenario,
        source: str | None,
        out: Path | None,
        csv: Path | None,
    ) -> Places:
        """Choose the run folder of the policy, or `out`, or a folder of its own under ``figures/``.

        Args:
            what: names the files, together with the scenario where that is not the policy's own.
            source: the scenario that was asked for, if one was.

        Raises:
            DockctlError: a place cannot be written.
        """
        run = trained.run.path if trained.run else None
        if out is None and run and not os.access(run, os.W_OK):
            raise DockctlError(f"{run}: cannot write here; give a folder with --out")
        tables = out or run or Path("figures") / what
        figures = run / "figures" if run and not out else tables
        for folder in (tables, figures):
            require_writable(folder)
        if csv:
            require_place(csv)
        elsewhere = source is not None and trained.is_elsewhere(scenario)
        stem = f"{what}-{scenario.name}" if elsewhere or not run else what
        return cls(tables, figures, stem, csv, trained.card.sha256)

    def store(self, table: str, figures: Sequence[Path]) -> None:
        """Write the table as CSV, after its figures, and of which policy it is as JSON; print all paths.

        Raises:
            DockctlError: the table cannot be written.
        """
        with writing(self.tables):
            self.tables.mkdir(parents=True, exist_ok=True)
        tables = [path for path in (self.tables / f"{self.stem}.csv", self.csv) if path]
        for path in [*figures, *(write_atomically(path, table.encode()) for path in tables)]:
            say(Console(), str(path))
        facts = json.dumps({"policy": {"sha256": self.policy}}, indent=2) + "\n"
        say(Console(), str(write_atomically(self.tables / f"{self.stem}.json", facts.encode())))


def require_place(file: Path) -> None:
    """Check that a file can be written, before any work is done for it.

    Raises:
        DockctlError: its folder does not exist or cannot be written, or it is a folder itself.
    """
    if not os.path.isdir(file.absolute().parent) or os.path.isdir(file):
        raise DockctlError(f"{file}: cannot be written: not a file name in an existing folder")
    require_writable(file.absolute().parent)
