"""How long a decision and a training take, beside the thesis' (Fig. 4.38, section 4.3.3)."""

from __future__ import annotations

import pandas as pd

from dockctl.analysis.latency import PARTS, THESIS_FORWARD_MS
from dockctl.reports.latency import latency_figure
from studies.thesis.kept import Kept, Kepts
from studies.thesis.markdown import picture, spread, table
from studies.thesis.page import Draw, Page, missing, text_of
from studies.thesis.thesis import EPISODES, HOURS_A_SCENARIO, SECONDS_A_STEP

TIMED = "s3"


def time_page(kept: Kepts) -> Page:
    """Fig. 4.38 and the time of training."""
    draws: dict[str, Draw] = {}
    timed = [run for run in kept[TIMED] if run.latency and run.samples is not None]
    blocks = [
        "# Time",
        "Seconds depend on the machine and on what else it does. The thesis' is a six-core i5-8400; ours is"
        " named in the [overview](../results.md), and several trainings ran on it side by side.",
        "## A decision",
        f"Fig. 4.38: a forward pass takes {THESIS_FORWARD_MS:g} ms on average. Here, in milliseconds:",
    ]
    if timed:
        blocks.append(
            table([_decision_row(run, name, part) for run in timed for part, name in PARTS.items()])
        )
        first = timed[0]
        assert first.latency is not None
        assert first.samples is not None
        draws["latency"] = _latency(first.samples, first.latency)
        blocks.append(picture("latency", "time of a decision"))
    else:
        blocks.append(missing([TIMED]))
    blocks += [
        "## A training",
        f"Section 4.3.3: {SECONDS_A_STEP:g} s a step, {HOURS_A_SCENARIO:g} hours a scenario.",
        table([_training_row(name, runs) for name in EPISODES for runs in [kept[name]] if runs])
        if any(kept[name] for name in EPISODES)
        else missing(EPISODES),
    ]
    return Page("results/time.md", text_of(*blocks), draws)


def _latency(samples: pd.DataFrame, facts: dict[str, object]) -> Draw:
    subtitle = f"{facts['subject']}; {len(samples):,} decisions"
    return lambda: latency_figure(samples, subtitle, float(str(facts["control_period_ms"])))


def _decision_row(run: Kept, name: str, part: str) -> dict[str, str]:
    assert run.samples is not None  # the caller has asked
    values = run.samples[part]
    return {
        "seed": str(run.seed),
        "part": name,
        "mean": f"{values.mean():.3f}",
        "median": f"{values.median():.3f}",
        "99 %": f"{values.quantile(0.99):.3f}",
        "slowest": f"{values.max():.2f}",
    }


def milliseconds_a_step(run: Kept) -> float:
    """Wall time of an environment step in training, learning and evaluations included."""
    return 1000 * float(run.timing["wall_s"].iloc[-1]) / run.steps


def _training_row(name: str, runs: list[Kept]) -> dict[str, str]:
    return {
        "scenario": name[1:],
        "ms a step": spread([milliseconds_a_step(run) for run in runs], "{:.2f}"),
        "minutes a training": spread([run.minutes for run in runs]),
        "steps a training": spread([run.steps for run in runs], "{:,}"),
    }
