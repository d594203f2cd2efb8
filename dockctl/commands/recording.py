"""Record greedy episodes step by step, in a folder that reports read like a run."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

from dockctl.agents.summary import ending
from dockctl.commands.drawing import pose_of
from dockctl.commands.policies import find
from dockctl.commands.rooms import player, shown_starts, trajectory_rows
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.runs.directory import SCENARIO, require_writable
from dockctl.runs.files import new_folder
from dockctl.runs.keep import ELSEWHERE
from dockctl.runs.tables import TRAJECTORIES, to_csv
from dockctl.scenarios.berths import layouts
from dockctl.scenarios.loader import dump
from dockctl.sim.checks import PoseCheck
from dockctl.sim.harbor import build_harbor
from dockctl.sim.simulator import build_worlds
from dockctl.sim.sites import own_site, pose_array
from dockctl.sim.starts import given_start


def record(ckpt: Path | None, source: str | None, poses: Sequence[str], out: Path | None) -> None:
    """Play an episode of the policy `ckpt` from every pose, or every test pose, and write its steps.

    Raises:
        DockctlError: there is no such policy or scenario, they do not fit, a pose is not free, or the folder
            cannot be written.
    """
    trained = find(ckpt)
    loaded = trained.scenario(source)
    scenario = loaded.scenario
    folder = out or (trained.run.path if trained.run else Path()) / ELSEWHERE / scenario.name
    require_writable(folder)
    worlds = build_worlds(scenario, loaded.base_dir)
    trained.require_fit(DockingVectorEnv(loaded, 1, worlds=worlds))
    site = own_site(scenario)
    starts = shown_starts(scenario, worlds)
    if poses:
        given = [pose_of(text) for text in poses]
        layout = layouts(scenario.harbor, scenario.task.berths)[site.harbor]
        check = PoseCheck.of(scenario, build_harbor(layout.harbor, loaded.base_dir))
        if flaws := [flaw for pose in given if (flaw := check.flaw(pose))]:
            raise DockctlError("\n".join(f"--pose: {flaw}" for flaw in flaws))
        starts = [given_start(site, scenario.task, pose_array(p), i) for i, p in enumerate(given)]
        tests = scenario.evaluation.model_copy(update={"poses": tuple(given)})
        scenario = scenario.model_copy(update={"evaluation": tests})
    episodes = player(loaded, worlds, starts)(trained.policy)
    rows = list(trajectory_rows(episodes, scenario.vessel.control_period_s))
    ranges = [name for name in rows[0] if name not in TRAJECTORIES]
    with new_folder(folder) as new:
        (new / SCENARIO).write_text(dump(scenario), encoding="utf-8")
        (new / "scene.json").write_text(json.dumps(worlds[site.harbor].scene().to_json()), encoding="utf-8")
        (new / "trajectories.csv").write_text(to_csv(rows, [*TRAJECTORIES, *ranges]), encoding="utf-8")
    for episode in episodes:
        x, y, heading = episode.start.eta
        print(f"from {x:g}, {y:g}, {math.degrees(heading):.4g}°: {ending(episode)}")
    print(folder)
