"""Record greedy episodes step by step, in a folder with the format of a run folder."""

from __future__ import annotations

import json
from dataclasses import dataclass
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
        """Write `FILES` and `RECORDING`, replacing the folder.

        Raises:
            DockctlError: the folder cannot be written.
        """
        text = trajectories_csv(self.episodes, self.scenario.vessel.control_period_s)
        with new_folder(folder.resolve()) as new:
            (new / SCENARIO).write_text(dump(self.scenario), encoding="utf-8")
            (new / SCENE).write_text(json.dumps(self.scene.to_json()), encoding="utf-8")
            (new / TRAJECTORIES_CSV).write_text(text, encoding="utf-8")
            hashes = hashes_of(new / name for name in FILES)
            write_results(new / RECORDING, {"policy": self.policy.facts()}, hashes)
