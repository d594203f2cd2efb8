"""Record greedy episodes step by step, in a folder that reports read like a run."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

from dockctl.analysis.episodes import ending
from dockctl.commands.options import parse_pose
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.evaluation.policies import find
from dockctl.evaluation.starts import player, pose_check, shown_starts, trajectories_csv
from dockctl.geometry import pose_array
from dockctl.runs.directory import SCENARIO, TRANSFER, require_replaceable
from dockctl.runs.files import new_folder
from dockctl.scenarios.loader import dump
from dockctl.sim.starts import given_start, own_site
from dockctl.sim.world import build_worlds

SCENE, TRAJECTORIES = "scene.json", "trajectories.csv"


def record(ckpt: Path | None, source: str | None, poses: Sequence[str], out: Path | None) -> None:
    """Play an episode of the policy `ckpt` from every pose, or every test pose, and write its steps.

    Raises:
        DockctlError: there is no such policy or scenario, they do not fit, a pose is not free, or the folder
            cannot be written or holds something else.
    """
    trained = find(ckpt)
    loaded = trained.scenario(source)
    scenario = loaded.scenario
    folder = out or (trained.run.path if trained.run else Path()) / TRANSFER / scenario.name
    require_replaceable(folder, (SCENARIO, SCENE, TRAJECTORIES), ("figures",), "earlier recording")
    worlds = build_worlds(scenario, loaded.base_dir)
    trained.require_fit(DockingVectorEnv(loaded, 1, worlds=worlds))
    site = own_site(scenario)
    starts = shown_starts(scenario, worlds)
    if poses:
        given = [parse_pose(text) for text in poses]
        check = pose_check(loaded)
        if flaws := [flaw for pose in given if (flaw := check.flaw(pose))]:
            raise DockctlError("\n".join(f"--pose: {flaw}" for flaw in flaws))
        starts = [given_start(site, scenario.task, pose_array(p), i) for i, p in enumerate(given)]
        tests = scenario.evaluation.model_copy(update={"poses": tuple(given)})
        scenario = scenario.model_copy(update={"evaluation": tests})
    episodes = player(loaded, worlds, starts)(trained.policy)
    with new_folder(folder.resolve()) as new:
        (new / SCENARIO).write_text(dump(scenario), encoding="utf-8")
        (new / SCENE).write_text(json.dumps(worlds[site.harbor].scene().to_json()), encoding="utf-8")
        text = trajectories_csv(episodes, scenario.vessel.control_period_s)
        (new / TRAJECTORIES).write_text(text, encoding="utf-8")
    for episode in episodes:
        x, y, heading = episode.start.eta
        print(f"from {x:g}, {y:g}, {math.degrees(heading):.4g}°: {ending(episode.row())}")
    print(folder)
