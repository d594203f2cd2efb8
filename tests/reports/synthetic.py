"""A synthetic marina and run, to test reports without simulator and learner."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Set as AbstractSet
from pathlib import Path

import numpy as np
import pandas as pd
import yaml

from dockctl.analysis.returns import AT_START, BEFORE_INTERMEDIATE, DOCKING
from dockctl.drawing.scene import Polygon, Scene

PERIOD_S = 0.5
FINAL = {"x_m": 36.0, "y_m": 0.0, "heading_deg": 180.0}
INTERMEDIATE = {"x_m": 18.0, "y_m": 3.0, "heading_deg": 150.0}


def rectangle(kind: str, name: str, x0: float, y0: float, x1: float, y1: float, height_m: float) -> Polygon:
    return Polygon(kind, name, np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]), height_m)


def marina() -> Scene:
    """Two quays, with fingers and boats at the east one, from boxes."""
    parts = [
        rectangle("quay", "east quay", 38.5, -43, 42, 43, 1.0),
        rectangle("quay", "west quay", 1, -43, 4.5, 43, 1.0),
    ]
    for k in range(-3, 4):
        y = -2.5 + 9 * k
        parts.append(rectangle("finger", f"east finger {k}", 30.5, y - 0.5, 38.5, y + 0.5, 0.6))
        if k:
            bow = np.array([[37.8, -1.2], [31.5, -1.2], [29.8, 0.0], [31.5, 1.2], [37.8, 1.2]]) + (0, 9 * k)
            parts.append(Polygon("hull", f"boat {k}", bow, 1.1))
            parts.append(rectangle("cabin", f"boat {k}", 33, 9 * k - 0.7, 36, 9 * k + 0.7, 1.8))
    hull = np.array([[-1.5, -0.5], [0.6, -0.5], [1.5, 0.0], [0.6, 0.5], [-1.5, 0.5]])
    return Scene("made up", tuple(parts), hull, (4.5, -40.0, 38.5, 40.0))


def episodes(count: int = 900, seed: int = 0) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    skill = 1 / (1 + np.exp(-(np.arange(count) - 0.5 * count) / (0.08 * count)))
    drawn = rng.random(count)
    outcome = np.where(
        drawn < 0.98 * skill,
        "docked",
        np.where(drawn < 0.98 * skill + 0.5 * (1 - skill), "timeout", "collision"),
    )
    exploring = rng.random(count) < 0.5
    steps = np.select(
        [outcome == "docked", outcome == "timeout"],
        [rng.integers(80, 200, count), 500],
        rng.integers(30, 400, count),
    )
    steps = np.where(exploring & (outcome == "timeout"), 200, steps)
    table = pd.DataFrame(
        {
            "episode": np.arange(count) + 1,
            "env_steps": np.cumsum(steps),
            "boat": np.arange(count) % 16,
            "start_kind": np.where(exploring, "exploring", "pose"),
            "start_index": 0,
            "return": 0.0,
            "steps": steps,
            "outcome": outcome,
            "collided_with": np.where(outcome == "collision", "east finger 1", ""),
            "phase": np.where((outcome == "docked") | (rng.random(count) < skill), 1, 0),
            "epsilon": np.clip(1 - 0.97 * np.arange(count) / (0.6 * count), 0.03, 1),
            "distance_m": rng.uniform(0.2, 12, count),
            "heading_error_deg": rng.uniform(-20, 20, count),
            "speed_mps": rng.uniform(0, 0.3, count),
            "reward_collision": np.where(outcome == "collision", -30000.0, 0.0),
            "reward_intermediate": 0.0,
            "reward_final": np.where(outcome == "docked", 30000.0, 0.0),
            "reward_distance": -steps * rng.uniform(30, 70, count),
            "reward_orientation": -steps * rng.uniform(5, 30, count),
            "reward_speed": -steps * rng.uniform(2, 9, count),
        }
    )
    table["reward_intermediate"] = np.where(table["phase"] == 1, 30000.0, 0.0)
    table["return"] = table.filter(like="reward_").sum(axis=1)
    return table


def track(
    pose: int, start: tuple[float, float, float], *, intermediate: bool = False, steps: int = 110
) -> pd.DataFrame:
    """A smooth trajectory into the berth, in one phase or two."""
    goals = [INTERMEDIATE, FINAL] if intermediate else [FINAL]
    rows, here, speed = [], np.array([*start[:2], math.radians(start[2])]), 0.0
    for phase, goal in enumerate(goals, start=2 - len(goals)):
        there = np.array([goal["x_m"], goal["y_m"], math.radians(goal["heading_deg"])])
        for step in range(steps):
            part = step / (steps - 1)
            eased = part * part * (3 - 2 * part)
            pose_now = here + (there - here) * eased
            pose_now[2] += 0.15 * math.sin(2 * math.pi * part)
            off = pose_now - there
            speed = 0.4 * math.sin(math.pi * part) * (-1 if phase else 1)
            rows.append(
                {
                    "pose": pose,
                    "step": len(rows),
                    "outcome": "docked",
                    "time_s": PERIOD_S * len(rows),
                    "x_m": pose_now[0],
                    "y_m": pose_now[1],
                    "heading_deg": math.degrees(pose_now[2]),
                    "u_mps": speed,
                    "v_mps": 0.04 * math.sin(5 * part),
                    "r_degps": 2.5 * math.cos(4 * math.pi * part),
                    "propeller_n": 10.0 * round(5 * math.cos(3 * math.pi * part)) * (-1 if phase else 1),
                    "rudder_deg": 10.0 * round(3 * math.sin(9 * part + pose)),
                    "distance_m": math.hypot(off[0], off[1]),
                    "heading_error_deg": math.degrees((off[2] + math.pi) % (2 * math.pi) - math.pi),
                    "phase": phase,
                    "reward": -50.0,
                }
            )
        here = there
    return pd.DataFrame(rows)


def evaluations(poses: int = 1, count: int = 12) -> pd.DataFrame:
    rows = []
    for k in range(count):
        for pose in range(poses):
            good = k > 5 + pose % 3
            rows.append(
                {
                    "env_steps": 10_000 * (k + 1),
                    "start_kind": "pose",
                    "pose": pose,
                    "outcome": "docked" if good else ("timeout" if (k + pose) % 3 else "collision"),
                    "return": 0.0,
                    "steps": 100,
                    "best": int(k in (6, 9)),
                }
            )
    return pd.DataFrame(rows)


def updates(count: int = 60) -> pd.DataFrame:
    decay = np.exp(-np.arange(count) / 20)
    return pd.DataFrame(
        {
            "update": np.arange(1, count + 1) * 50,
            "env_steps": np.arange(1, count + 1) * 800,
            "loss": 0.05 * decay,
            "td_error": 0.2 * decay + 0.01,
            "q_mean": 3 * (1 - decay) - 1,
            "gradient_norm": 0.5 * decay + 0.05,
            "learning_rate": 1e-3,
        }
    )


def write_run(folder: Path, *, intermediate: bool = False, poses: int = 1, count: int = 900) -> Path:
    """Write a run folder with everything that reports read, and return it."""
    folder.mkdir(parents=True)
    starts = [
        (20.0, 2.0, 160.0),
        (20.0, 3.0, 150.0),
        (20.0, 1.0, 170.0),
        (20.0, 0.0, 180.0),
        (20.0, -1.0, 190.0),
    ]
    if intermediate:
        starts = [(23.0, -10.0, 90.0)]
    starts = starts[:poses]
    task = {
        "initial": [{"x_m": x, "y_m": y, "heading_deg": h} for x, y, h in starts],
        "intermediate": INTERMEDIATE if intermediate else None,
        "final": FINAL,
    }
    scenario = {"name": "made-up", "task": task, "training": {"seed": 3}}
    (folder / "scenario.yaml").write_text(yaml.safe_dump(scenario))
    (folder / "scene.json").write_text(json.dumps(marina().to_json()))
    episodes(count).to_csv(folder / "episodes.csv", index=False)
    updates().to_csv(folder / "updates.csv", index=False)
    evaluations(poses).to_csv(folder / "evaluations.csv", index=False)
    tracks = [track(i, start, intermediate=intermediate) for i, start in enumerate(starts)]
    pd.concat(tracks).to_csv(folder / "trajectories.csv", index=False)
    return folder


def returns(unit_m: float = 1.0, *, intermediate: bool = True) -> pd.DataFrame:
    """Returns of four behaviors.

    Docking costs 900 and gets 0.4 of the 250 that the intermediate pose pays; loitering before it costs 700.
    """
    rows = {
        DOCKING: ("docked", {"reward_distance": -900.0, "reward_intermediate": 0.4 * 250}),
        AT_START: ("timeout", {"reward_distance": -1900.0, "reward_mine": -100.0}),
        BEFORE_INTERMEDIATE: ("timeout", {"reward_distance": -700.0}),
        "full astern": ("collision", {"reward_distance": -800.0, "reward_mine": -50.0}),
    }
    table = pd.DataFrame(
        {
            "behavior": name,
            "outcome": outcome,
            "steps": 100,
            "time_s": 50.0,
            "distance_unit_m": unit_m,
            "intermediate_discount": 0.4 if name == DOCKING else 0.0,
            "reward_distance": 0.0,
            "reward_mine": 0.0,
            **terms,
        }
        for name, (outcome, terms) in rows.items()
        if intermediate or name != BEFORE_INTERMEDIATE
    ).fillna(0.0)
    if not intermediate:
        table = table.drop(columns="reward_intermediate")
    return table.assign(**{"return": table.filter(like="reward_").sum(axis=1)})


OFFSETS = [(dx, dy) for dx in (-4.0, -2.0, 0.0, 2.0, 4.0) for dy in (-4.0, -2.0, 0.0, 2.0, 4.0)]
"""Position offsets of `success_map` [m]."""


def success_map(
    failing: AbstractSet[tuple[float, float]] = frozenset(),
    blocked: AbstractSet[tuple[float, float]] = frozenset(),
    headings: tuple[float, ...] = (0.0,),
) -> pd.DataFrame:
    """A success map where all but some starts dock, the same ones for each heading offset."""
    return pd.DataFrame(
        {
            "dx_m": dx,
            "dy_m": dy,
            "dheading_deg": heading,
            "x_m": 20 + dx,
            "y_m": 2 + dy,
            "heading_deg": 160 + heading,
            "blocked": int((dx, dy) in blocked),
            "outcome": np.nan if (dx, dy) in blocked else "timeout" if (dx, dy) in failing else "docked",
        }
        for heading, (dx, dy) in itertools.product(headings, OFFSETS)
    )
