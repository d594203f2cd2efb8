"""Record greedy episodes step by step, in a folder with the format of a run folder."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dockctl.drawing.scene import Scene
from dockctl.errors import DockctlError
from dockctl.evaluation.policies import LoadedPolicy, load_policy
from dockctl.evaluation.rollout import Episode, Rollout, trajectories_csv
from dockctl.evaluation.starts import pose_check, trajectory_starts
from dockctl.geometry import pose_array
from dockctl.runs.directory import RECORDING, SCENARIO, SCENE, TRAJECTORIES_CSV
from dockctl.runs.files import new_folder
from dockctl.runs.results import sha256_of, write_results
from dockctl.scenarios.base import Pose
from dockctl.scenarios.loader import dump
from dockctl.scenarios.schema import Scenario
from dockctl.sim.starts import given_start, own_site

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
            hashes = {new / name: sha256_of(new / name) for name in FILES}
            write_results(new / RECORDING, {"policy": self.policy.facts()}, hashes)


def record(
    policy: str | Path | LoadedPolicy | None = None,
    scenario: str | Path | None = None,
    poses: Sequence[Pose] = (),
) -> Recording:
    """Run a policy from each pose; by default from the trajectory starts of the training.

    Args:
        policy: see `dockctl.evaluation.policies.load_policy`; the latest run by default.
        scenario: file or name; the policy's own by default.

    Raises:
        DockctlError: there is no such policy or scenario, they do not fit, or a pose is not free.
    """
    loaded_policy = load_policy(policy)
    loaded = loaded_policy.scenario(scenario)
    resolved, site = loaded.scenario, own_site(loaded.scenario)
    rollout = Rollout(loaded)
    starts = trajectory_starts(resolved, rollout.worlds)
    if poses:
        check = pose_check(loaded)
        if problems := [problem for pose in poses if (problem := check.problem(pose))]:
            raise DockctlError("\n".join(f"--pose: {problem}" for problem in problems))
        starts = [given_start(site, resolved.task, pose_array(pose), i) for i, pose in enumerate(poses)]
        tests = resolved.evaluation.model_copy(update={"poses": tuple(poses)})
        resolved = resolved.model_copy(update={"evaluation": tests})
    episodes = rollout.run(loaded_policy.make(rollout.env()), starts)
    return Recording(loaded_policy, resolved, rollout.worlds[site.harbor].scene(), episodes)
