"""Record greedy episodes step by step, in a folder with the format of a run folder."""

from __future__ import annotations

import json
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from dockctl.drawing.scene import Scene
from dockctl.evaluation.policies import LoadedPolicy
from dockctl.evaluation.rollout import Episode, trajectories_csv
from dockctl.run_files import RECORDING, SCENARIO, SCENE, TRAJECTORIES_CSV
from dockctl.runs.files import new_folder
from dockctl.runs.results import hashes_of, write_results
from dockctl.scenarios.loader import dump
from dockctl.scenarios.schema import Scenario

FILES = (SCENARIO, SCENE, TRAJECTORIES_CSV)


@dataclass(frozen=True, eq=False)
class Recording:
    """Greedy episodes of a policy with their scenario and the plan view of its harbor."""

    policy: LoadedPolicy
    scenario: Scenario
    scene: Scene
    episodes: list[Episode]

    def write(self, folder: Path) -> None:
        """Write `FILES` and `RECORDING`, replacing the folder unless it already has the same `FILES`.

        Figures drawn from identical files are kept.

        Raises:
            DockctlError: the folder cannot be written.
        """
        contents = {
            SCENARIO: dump(self.scenario),
            SCENE: json.dumps(self.scene.to_json()),
            TRAJECTORIES_CSV: trajectories_csv(self.episodes, self.scenario.vessel.control_period_s),
        }
        folder = folder.resolve()
        wanted = {folder / name: sha256(text.encode()).hexdigest() for name, text in contents.items()}
        if hashes_of(wanted) == wanted:
            self._describe(folder)
            return
        with new_folder(folder) as new:
            for name, text in contents.items():
                (new / name).write_text(text, encoding="utf-8")
            self._describe(new)

    def _describe(self, folder: Path) -> None:
        hashes = hashes_of(folder / name for name in FILES)
        write_results(folder / RECORDING, {"policy": self.policy.facts()}, hashes)
