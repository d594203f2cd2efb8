"""The reading of the reward, the thesis' own learner, and what each part of ours buys."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from dockctl.analysis.learning import RECENT
from dockctl.analysis.returns import unit_words, verdicts
from dockctl.reports.returns import returns_figure
from dockctl.scenarios.loader import load
from dockctl.scenarios.study import Experiment, Study
from studies.thesis import curves
from studies.thesis.kept import Kept, Kepts
from studies.thesis.markdown import picture, share, spread, steps, table
from studies.thesis.measures import change_share, change_size, slowing_m
from studies.thesis.page import Draw, Page, mastered, middle, missing, text_of
from studies.thesis.thesis import EPISODES, TRAINING, WEIGHTS

READINGS = (("s1", "s1-meters"), ("s3", "s3-meters"))
UNITS = ("units of 20 m", "meters")
BASE, FASTER = "s3", "s3-velocity-20"


def reward_page(kept: Kepts) -> Page:
    """What Table 3.5 means, and the weight of the speed."""
    blocks = [
        "# The reading of the reward",
        "The thesis does not say in which unit its reward takes δd. It asks that a collision cost more than"
        " the penalties of an episode that never arrives (section 3.2.3); how far the weights of Table 3.5"
        " keep to that hangs on the unit. Below, behaviors are played and judged under both: meters, and the"
        " units of 20 m that are used here.",
        "## Weights",
        table([_weight_row(term, kept) for term in WEIGHTS]),
        "## What behaviors are worth",
    ]
    draws: dict[str, Draw] = {}
    for name, _ in READINGS:
        with_returns = [run for run in kept[name] if run.returns is not None]
        blocks.append(f"### Scenario {name[1:]}")
        if not with_returns:
            blocks.append(missing([name]))
            continue
        run = with_returns[0]
        assert run.returns is not None
        draws[f"{name}-returns"] = _returns(run, run.returns)
        blocks.append(picture(f"{name}-returns", f"discounted returns of behaviors, scenario {name[1:]}"))
        blocks.append(_verdicts(run.returns))
    blocks.append("## Training under both readings")
    pairs = {
        f"scenario {base[1:]}": {UNITS[0]: kept[base], UNITS[1]: kept[meters]}
        for base, meters in READINGS
        if kept[base] and kept[meters]
    }
    if pairs:
        draws["readings"] = lambda: curves.compared_figure(
            "Our learner under both readings",
            "thin: seeds; thick: interquartile mean with its interval",
            pairs,
        )
        blocks.append(picture("readings", "our learner under both readings"))
    blocks.append(table([row for pair in READINGS for row in _reading_rows(pair, kept)]))
    blocks.append("The thesis' own learner under both: [thesis learner](thesis-learner.md).")
    blocks += _velocity(kept)
    return Page("results/reward.md", text_of(*blocks), draws)


def _weight_row(term: str, kept: Kepts) -> dict[str, str]:
    """One weight of Table 3.5, and ours as the kept runs have it; ours carry their signs."""
    symbol, early, late = WEIGHTS[term]
    row = {"term": f"`{term}`", "Table 3.5": symbol, "scenarios 1, 2": early, "scenario 3 (§4.3)": late}
    for name, _ in READINGS:
        if kept[name]:
            weight = kept[name][0].resolved["reward"]["terms"].get(term, "")
            weight = weight["weight"] if isinstance(weight, dict) else weight
            row[f"here, {name}"] = f"{weight:,g}" if weight != "" else ""
    return row


def _returns(run: Kept, returns: pd.DataFrame) -> Draw:
    caption = (
        f"scenario {run.run.scenario}, docking by the policy of seed {run.seed};"
        f" discounted by {run.training['gamma']:g} a step"
    )
    return lambda: returns_figure(returns, caption)


def _verdicts(returns: pd.DataFrame) -> str:
    lines = []
    for unit, rows in returns.groupby("distance_unit_m", sort=False):
        said = " ".join(verdicts(rows))
        lines.append(f"- δd in {unit_words(float(str(unit)))}: {said}")
    return "\n".join(lines)


def _reading_rows(pair: tuple[str, str], kept: Kepts) -> list[dict[str, str]]:
    return [
        {"scenario": pair[0][1:], "δd in": unit, **_outcomes(kept[name])}
        for name, unit in zip(pair, UNITS, strict=True)
    ]


def _outcomes(runs: Sequence[Kept]) -> dict[str, str]:
    """How the trainings of one experiment went, seed by seed."""
    if not runs:
        return {"seeds": "not run"}
    ends = [run.episodes["outcome"].tail(RECENT).value_counts() for run in runs]
    return {
        "seeds": str(len(runs)) + ("" if all(run.finished for run in runs) else ", under way"),
        "mastered": mastered(runs),
        "greedy docks first at": ", ".join(steps(run.first_docked) for run in runs),
        "training": ", ".join(f"{run.steps:,}" for run in runs),
        f"docked of the last {RECENT}": ", ".join(str(end.get("docked", 0)) for end in ends),
        "collisions": ", ".join(str(end.get("collision", 0)) for end in ends),
        "timeouts": ", ".join(str(end.get("timeout", 0)) for end in ends),
    }


def _velocity(kept: Kepts) -> list[str]:
    """r_velocity of 20 and 10 in scenario 3 (section 4.3)."""
    head = (
        "## r_velocity: 20 or 10\n\nSection 4.3 halves it for scenario 3 and sees sudden changes of the"
        " propeller all but vanish, those of the rudder stay, and the boat slow down late."
    )
    if not (kept[BASE] and kept[FASTER]):
        return [head, missing([BASE, FASTER])]
    return [head, table([_controls("10", kept[BASE]), _controls("20", kept[FASTER])])]


def _controls(weight: str, runs: Sequence[Kept]) -> dict[str, str]:
    tracks = [track for run in runs for track in run.tracks]
    row = {"r_velocity": weight, "seeds": str(len(runs))}
    for name, column, unit in (("propeller", "propeller_n", "N"), ("rudder", "rudder_deg", "°")):
        row[f"{name} changes, % of the steps"] = middle([100 * change_share(t, column) for t in tracks])
        row[f"mean change of the {name} a step [{unit}]"] = middle(
            [change_size(track, column) for track in tracks], "{:.1f}"
        )
    row["last at top speed [m off]"] = middle([slowing_m(track) for track in tracks], "{:.1f}")
    return row


def ablation_page(study: Study, kept: Kepts) -> Page:
    """What each part of the default learner buys."""
    rows = [experiment for experiment in study.experiments if experiment.group == "ablation"]
    head = "# What each part of the learner buys"
    if not rows:
        return Page("results/ablation.md", text_of(head, missing(["ablation"])))
    base, *others = rows
    there = {e.title: {"default": kept[base.name], "changed": kept[e.name]} for e in others if kept[e.name]}
    draws: dict[str, Draw] = {}
    if there and kept[base.name]:
        draws["ablation"] = lambda: curves.compared_figure(
            "What each part of the learner buys",
            f"scenario {base.scenario[1:]}; thin: seeds; thick: interquartile mean with its interval",
            there,
        )
    text = text_of(
        head,
        f"Scenario {base.scenario[1:]} with {_settings(base)}, one thing changed at a time; values seed by"
        " seed.",
        "```sh\ndockctl reproduce ablation\n```",
        table([_ablation_row(e, base, kept[e.name]) for e in rows]),
        "*Docked over the training*: the share of docked episodes, averaged over all the steps that were"
        " there; a training that ended earlier goes on with its last value. Interquartile mean of the seeds,"
        " 95 % interval.",
        picture("ablation", "share of docked episodes of every ablation") if draws else "",
    )
    return Page("results/ablation.md", text, draws)


def _ablation_row(experiment: Experiment, base: Experiment, runs: Sequence[Kept]) -> dict[str, str]:
    row = {"change": experiment.title, "set": _settings(experiment, base)}
    if runs:
        shares = [100 * curves.docked_over(run, int(run.training["total_steps"])) for run in runs]
        row["docked over the training, %"] = middle(shares)
    return row | _outcomes(runs)


def _settings(experiment: Experiment, base: Experiment | None = None) -> str:
    """What an experiment sets, without what `base` sets, too."""
    shared = base.set if base else ()
    return ", ".join(f"`{setting}`" for setting in experiment.set if setting not in shared)


def thesis_page(study: Study, kept: Kepts) -> Page:
    """The thesis' learner to its full number of episodes, under both readings."""
    experiments = [experiment for experiment in study.experiments if experiment.group == "thesis"]
    head = (
        "# The thesis' own learner\n\nOne boat, batches of 32, one-step targets, RMSProp, squared error, no"
        " exploring starts (preset `thesis`), to the thesis' number of episodes: "
        + ", ".join(f"{count:,} in scenario {name[1:]}" for name, count in EPISODES.items())
        + ". Every setting, ε (Table 4.1) among them: [training](../scenario.md#training)."
    )
    runs = [
        (f"scenario {e.scenario[1:]}, δd in {_unit(e)}", run) for e in experiments for run in kept[e.name]
    ]
    if not runs:
        return Page("results/thesis-learner.md", text_of(head, missing(["thesis"])))
    draws: dict[str, Draw] = {
        "thesis-endings": lambda: curves.endings_figure("The thesis' learner: how the episodes ended", runs),
        "thesis-losses": lambda: curves.losses_figure("The thesis' learner: errors and values", runs),
    }
    text = text_of(
        head,
        "```sh\ndockctl reproduce thesis\n```",
        table([_thesis_row(experiment, kept[experiment.name]) for experiment in experiments]),
        _thesis_reading([run for _, run in runs]),
        picture("thesis-endings", "how the episodes ended"),
        picture("thesis-losses", "errors and values"),
    )
    return Page("results/thesis-learner.md", text, draws)


def _unit(experiment: Experiment) -> str:
    return unit_words(load(experiment.scenario, overrides=experiment.set).scenario.reward.distance_unit_m)


def _thesis_reading(runs: Sequence[Kept]) -> str:
    """What became of all the trainings, and why they do not settle."""
    docked = share((sum(run.recent_docked == RECENT for run in runs), len(runs)))
    growth = spread([errors[2] / errors[0] for errors in map(_errors, runs)], "{:.0f}", " times")
    return (
        f"Trainings that dock in all of their last {RECENT} episodes, as the thesis': {docked}. At the end"
        f" the mean error is {growth} its least. The likely reason: the error is squared and the reward"
        " neither scaled nor clipped, so that one bonus or collision moves the network far more than all the"
        " steps on the way to it."
    )


def _errors(run: Kept) -> tuple[float, float, float]:
    """Mean absolute TD error of the updates in units of the reward: least, largest, last."""
    error = run.updates["td_error"].abs() / run.training["reward_scale"]
    return float(error.min()), float(error.max()), float(error.iloc[-1])


def _thesis_row(experiment: Experiment, runs: Sequence[Kept]) -> dict[str, str]:
    row = {"scenario": experiment.scenario[1:], "δd in": _unit(experiment)}
    if not runs:
        return row | {"episodes": "not run"}
    (run, *_) = runs
    ended = run.episodes["outcome"].eq("docked")
    best = ended.rolling(RECENT).sum()
    greedy = run.run.evaluations
    return row | {
        "episodes": f"{len(run.episodes):,}" + ("" if run.finished else ", under way"),
        "steps": f"{run.steps:,}",
        "hours": f"{run.minutes / 60:.1f}",
        "greedy docks first at": f"{steps(run.first_docked)} steps" if run.first_docked else "never",
        "greedy evaluations that dock": share(
            None if greedy is None else (int((greedy["outcome"] == "docked").sum()), len(greedy))
        ),
        f"most docked of {RECENT}": f"{best.max():.0f} (to episode {int(best.argmax()) + 1:,})"
        if best.max()
        else "0",
        f"docked of the last {RECENT}": str(run.recent_docked),
        "mean abs. TD error: least, largest, last": ", ".join(f"{error:,.0f}" for error in _errors(run)),
        "the thesis": TRAINING[experiment.scenario][0].seen,
    }
