"""Write docs/results.md and its figures from run folders alone: no number in it is typed by hand.

for s in s1 s2 s3; do for k in 0 1 2 3 4; do dockctl train $s --seed $k; done; done
for run in runs/s?/*; do dockctl evaluate --ckpt $run; dockctl plot $run; done
python docs/make_results.py runs
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd
from PIL import Image

HERE = Path(__file__).parent
WIDTH_PX = 1240
SCENARIOS = {
    "s1": "one start, aligned with the berth",
    "s2": "three starts, tested from the five poses of Table 4.3",
    "s3": "start along the fairway, by way of the intermediate pose",
}


@dataclass(frozen=True)
class Run:
    """One run folder that has been evaluated and plotted."""

    folder: Path

    @cached_property
    def provenance(self) -> dict[str, Any]:
        return dict(json.loads((self.folder / "provenance.json").read_text()))

    @cached_property
    def evaluation(self) -> dict[str, Any]:
        return dict(json.loads((self.folder / "evaluation.json").read_text()))

    @property
    def seed(self) -> int:
        return int(self.provenance["seed"])

    def row(self) -> dict[str, str]:
        """Return the run's line of the table."""
        episodes = pd.read_csv(self.folder / "episodes.csv", keep_default_na=False)
        greedy = pd.read_csv(self.folder / "evaluations.csv", keep_default_na=False)
        docks_all = greedy.groupby("env_steps")["outcome"].agg(lambda ends: (ends == "docked").all())
        timing = pd.read_csv(self.folder / "timing.csv").iloc[-1]
        poses, starts = self.evaluation["test_poses"], self.evaluation["random_starts"]
        docked = poses["mean_of_docked"]
        return {
            "seed": str(self.seed),
            "greedy docks first at": f"{docks_all[docks_all].index.min():,} steps",
            "training ends at": f"{int(timing.env_steps):,} steps",
            "episodes": f"{len(episodes):,}",
            "minutes": f"{timing.wall_s / 60:.1f}",
            "docked of the last 100": str((episodes.outcome.tail(100) == "docked").sum()),
            "test poses docked": f"{poses['docked']} of {poses['episodes']}",
            "mean time": f"{docked['time_s']:.1f} s",
            "mean path": f"{docked['path_length_m']:.1f} m",
            "least clearance": f"{poses['least_clearance_m']:.2f} m",
            "random starts docked": f"{starts['docked']} of {starts['episodes']}",
        }

    def picture(self) -> str:
        """Copy the overview, small enough for a page, and return its path from the page."""
        target = HERE / "figures" / f"{self.folder.parent.name}-seed{self.seed}.png"
        target.parent.mkdir(exist_ok=True)
        with Image.open(self.folder / "figures" / "overview.png") as image:
            small = image.convert("RGB").resize(
                (WIDTH_PX, image.height * WIDTH_PX // image.width), Image.LANCZOS
            )
            small.quantize(128).save(target, optimize=True)
        return target.relative_to(HERE).as_posix()


def table(rows: list[dict[str, str]]) -> str:
    lines = [list(rows[0]), ["---"] * len(rows[0]), *(list(row.values()) for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def section(scenario: str, runs: list[Run]) -> str:
    steps = [int(pd.read_csv(run.folder / "timing.csv").env_steps.iloc[-1]) for run in runs]
    mastered = sum(run.provenance["stop_reason"] == "mastered" for run in runs)
    pictures = "\n\n".join(f"![seed {run.seed}]({run.picture()})" for run in runs)
    return f"""## {scenario}: {SCENARIOS[scenario]}

{mastered} of {len(runs)} seeds mastered it, after {min(steps):,} to {max(steps):,} environment steps.

{table([run.row() for run in runs])}

{pictures}
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", type=Path, help="folder with <scenario>/<run>")
    folder = parser.parse_args().runs
    groups = {
        name: sorted((Run(path) for path in (folder / name).iterdir()), key=lambda run: run.seed)
        for name in SCENARIOS
    }
    every = [run for runs in groups.values() for run in runs]
    about = every[0].provenance
    libraries = ", ".join(f"{name} {version}" for name, version in about["libraries"].items())
    hardware = about["hardware"]
    machine = f"{hardware['processor']}, {hardware['cores']} cores, Python {about['python']}, {libraries}"
    commits = ", ".join(sorted({run.provenance["git_commit"][:7] for run in every}))
    page = f"""# Results

The default training of the three scenarios, five seeds each: full VLP-16 resolution, the terms and weights
of Table 3.5 as they stand (equations 3.10 and 3.13, δd in units of 20 m), no `progress` term. This page is
written by `docs/make_results.py` from the run folders alone:

```sh
for s in s1 s2 s3; do for k in 0 1 2 3 4; do dockctl train $s --seed $k; done; done
for run in runs/s?/*; do dockctl evaluate --ckpt $run; dockctl plot $run; done
python docs/make_results.py runs
```

A training ends when the scenario is mastered: of the last 100 training episodes at least 95 docked, exploring
starts among them, of those from the scenario's own initial poses at least as large a share, and the greedy
policy docks from every test pose. The policy is the best one by greedy evaluation, not the last one. `random
starts` begin up to 1 m and 10° off the initial poses, where these policies were not trained: a policy that
learned one start carries little beyond it.

Seconds depend on the machine; everything else repeats bit for bit on the same one. Here: {machine}, two
trainings side by side with one core each, beside other work; commit {commits}.

"""
    page += "\n".join(section(name, runs) for name, runs in groups.items() if runs)
    (HERE / "results.md").write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
