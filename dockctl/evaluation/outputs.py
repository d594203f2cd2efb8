"""Where measurements of a policy are stored: in its run folder, or under ``figures/``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dockctl.errors import DockctlError
from dockctl.evaluation.evaluate import Evaluation, evaluate
from dockctl.evaluation.policies import LoadedPolicy
from dockctl.evaluation.record import FILES as RECORDING_FILES
from dockctl.run_files import EVALUATION, FIGURES, RECORDING, TRANSFER
from dockctl.runs.files import (
    make_folder,
    require_replaceable,
    require_writable,
    require_writable_file,
    write_atomically,
    writing,
)
from dockctl.runs.results import file_stem, require_same_policy, result_stem, write_measurement


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
        cls,
        what: str,
        policy: LoadedPolicy,
        scenario: str | None,
        overrides: Sequence[str],
        out: Path | None,
        csv: Path | None = None,
    ) -> Outputs:
        """Select the run folder of the policy, or `out`, or a folder under ``figures/``.

        Args:
            what: stem of the files; the scenario's name is appended if it is not the policy's own, and the
                policy's name outside its run folder.
            scenario: the scenario that the user asked for, if any.
            overrides: changed values of the scenario, which become part of the file names.
            out: the folder that the user asked for, if any.
            csv: the copy of the table, if any.

        Raises:
            DockctlError: a path cannot be written or contains results of a different policy, or there is no
                such scenario.
        """
        run = policy.results
        if out is None and policy.run and not os.access(policy.run.path, os.W_OK):
            message = f"{policy.run.path}: cannot be written; give a folder with --out"
            raise DockctlError(message, code="not_writable")
        tables = out or run or Path(FIGURES) / Path(what).name
        figures = run / FIGURES if run and not out else tables
        for folder in (tables, figures):
            require_writable(folder)
        if csv:
            require_writable_file(csv, ".csv")
        resolved = policy.scenario(scenario, overrides).scenario
        is_own = policy.is_own(resolved, overrides)
        stem = result_stem(what, "" if run and not out and is_own else resolved.name, overrides)
        if out or run is None:
            stem = f"{stem}-{policy.file_name}"
            require_same_policy(tables / f"{stem}.json", policy.facts())
        return cls(tables, figures, stem, csv, policy)

    def write(self, table: str) -> list[Path]:
        """Write the table (CSV), its copy, and the policy's identity (JSON), and return the paths.

        Raises:
            DockctlError: a file cannot be written.
        """
        with writing(self.tables):
            make_folder(self.tables)
        copies = [write_atomically(self.csv, table.encode())] if self.csv else []
        return [*copies, *write_measurement(self.tables / self.stem, table, {"policy": self.policy.facts()})]


def store(result: Evaluation, table: str) -> bool:
    """Write an evaluation to the run folder of its policy; return whether there is a writable one.

    Args:
        table: its episodes, CSV.

    Raises:
        DockctlError: a file cannot be written.
    """
    policy = result.policy
    if not (policy.run and policy.results and os.access(policy.run.path, os.W_OK)):
        return False
    with writing(policy.results):
        make_folder(policy.results)
    write_measurement(policy.results / result.stem, table, result.as_json())
    return True


def recording_folder(
    given: str, policy: LoadedPolicy, scenario: str | None, overrides: Sequence[str]
) -> Path:
    """Return the folder of a recording: `given`, one in the run folder of the policy, or one in figures/.

    Raises:
        DockctlError: it contains something else, or the recording of a different policy.
    """
    name = file_stem([policy.scenario(scenario, overrides).scenario.name], overrides)
    if policy.results and not given:
        folder = policy.results / TRANSFER / name
    else:
        folder = Path(given) if given else Path(FIGURES) / "evaluate" / f"{name}-{policy.file_name}"
        require_same_policy(folder / RECORDING, policy.facts())
    evaluation = (f"{EVALUATION}.csv", f"{EVALUATION}.json")
    require_replaceable(folder, RECORDING_FILES, (FIGURES, RECORDING, *evaluation), "earlier recording")
    return folder


def record(policy: LoadedPolicy) -> Path:
    """Evaluate a policy in its own scenario, and return the folder of the recording and the evaluation.

    Raises:
        DockctlError: the policy has no scenario of its own, or the folder cannot be written.
    """
    folder = recording_folder("", policy, None, ())
    result = evaluate(policy, record=True)
    if result.recording:
        result.recording.write(folder)
    write_measurement(folder / EVALUATION, result.csv(), result.as_json())
    return folder
