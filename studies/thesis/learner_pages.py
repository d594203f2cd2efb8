"""Pages of the reward and the learner: the unit of δd, the thesis' learner, ablations, time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import pandas as pd
from matplotlib.figure import Figure

from dockctl.analysis.latency import PARTS, REQUIRED
from dockctl.analysis.returns import AT_START, DOCKING, format_unit, value, verdicts
from dockctl.drawing import palette
from dockctl.experiments.study import Experiment
from dockctl.reports.latency import label_line, latency_figure
from dockctl.reports.returns import returns_figure
from dockctl.runs.tables import RECENT
from studies.thesis import curves
from studies.thesis.claims import collision_share
from studies.thesis.data import SELECTION, TEST, Archive, ArchivedRun, Facts, ScenarioFact, count_outcomes
from studies.thesis.measures import Row, change_share, change_size, slowing_m
from studies.thesis.page import Draw, Page, mastered, training_outcomes
from studies.thesis.text import docked_share, listed, middle, outcome_counts, share, spread, steps

UNITS = {"units of 20 m": "", "meters": "-meters"}
"""Units of δd, and the suffix of their experiments."""


def reward_page(facts: Facts, archive: Archive) -> Page:
    """Table 3.5, the unit of δd, and the weight of the speed."""
    names = ("s1", "s3")
    figures: dict[str, Draw] = {
        "units": lambda: curves.compared_figure(
            "Our learner with both units of δd",
            "thin: seeds; thick: interquartile mean and its interval",
            {
                f"scenario {name[1:]}": {unit: archive[name + suffix] for unit, suffix in UNITS.items()}
                for name in names
            },
        )
    }
    returns, collisions = [], []
    for name in names:
        run = archive[name][0]
        caption = (
            f"scenario {run.run.scenario}, docking by the policy of seed {run.seed};"
            f" discounted by {run.training['gamma']:g} per step"
        )
        figures[f"{name}-returns"] = partial(returns_figure, run.returns, caption)
        lines = []
        for unit, rows in run.returns.groupby("distance_unit_m", sort=False):
            words = format_unit(float(str(unit)))
            lines.append(f"δd in {words}: {' '.join(verdicts(rows))}")
            collisions.append(_collision_row(name, words, rows))
        returns.append({"number": name[1:], "lines": lines})
    s3_units = archive["s3"][0].returns
    s3_units = s3_units[s3_units["distance_unit_m"] == 20]
    early = {
        suffix: [collision_share(archive[f"thesis-{name}{suffix}"][0], facts) for name in ("s1", "s2")]
        for suffix in UNITS.values()
    }
    values = {
        "weights": [_weight_row(weight.model_dump(), archive, names) for weight in facts.weights],
        "returns": returns,
        "collisions": collisions,
        "collision_costs_more": _where("collision costs more than waiting", collisions),
        "docking_returns_more": _where("docking returns more than the collision", collisions),
        "mastered_units": mastered([run for name in names for run in archive[name]]),
        "mastered_meters": mastered([run for name in names for run in archive[f"{name}-meters"]]),
        "trainings": [
            {"scenario": name[1:], "δd in": unit, **training_outcomes(archive[name + suffix])}
            for name in names
            for unit, suffix in UNITS.items()
        ],
        "window": facts.mostly_colliding,
        "collisions_meters": _percent(early["-meters"]),
        "collisions_units": _percent(early[""]),
        "best_collision": f"{_best_collision(s3_units):,.0f}",
        "waiting": f"{value(s3_units, AT_START, 'return'):,.0f}",
        "early": list(_early_rows(facts, archive)),
        "velocity": [
            _controls_row("10", archive["s3"]),
            _controls_row("20", archive["s3-velocity-20"]),
        ],
    }
    return Page("results/reward.md", "reward.md", values, figures)


def _best_collision(rows: pd.DataFrame) -> float:
    return float(rows.loc[rows["outcome"] == "collision", "return"].max())


def _collision_row(name: str, unit: str, rows: pd.DataFrame) -> Row:
    best, waiting = _best_collision(rows), value(rows, AT_START, "return")
    docking = value(rows, DOCKING, "return")
    return {
        "scenario": name[1:],
        "δd in": unit,
        "docking": f"{docking:,.0f}",
        "best collision": f"{best:,.0f}",
        "waiting at the start": f"{waiting:,.0f}",
        "collision costs more than waiting": "yes" if best < waiting else "no",
        "docking returns more than the collision": "yes" if docking > best else "no",
    }


def _where(column: str, rows: Sequence[Row]) -> str:
    """Scenarios and units for which a column is "yes"."""
    return listed(f"scenario {row['scenario']} in {row['δd in']}" for row in rows if row[column] == "yes")


def _percent(shares: Sequence[float]) -> str:
    return spread([100 * value for value in shares], "{:.0f}", " %")


def _early_rows(facts: Facts, archive: Archive) -> Iterator[Row]:
    first, last = facts.mostly_colliding
    for name in facts.episodes:
        for unit, suffix in UNITS.items():
            episodes = archive[f"thesis-{name}{suffix}"][0].episodes
            rows = episodes[episodes["episode"].between(first, last)]
            counts = count_outcomes(rows)
            yield {
                "scenario": name[1:],
                "δd in": unit,
                **{outcome: f"{100 * count / len(rows):.0f} %" for outcome, count in counts.items()},
            }


def _weight_row(weight: Mapping[str, str], archive: Archive, names: Sequence[str]) -> Row:
    """One weight of Table 3.5 and ours; ours have the sign of their term."""
    row = {
        "term": f"`{weight['term']}`",
        "Table 3.5": weight["symbol"],
        "scenarios 1, 2": weight["scenarios_1_2"],
        "scenario 3 (§4.3)": weight["scenario_3"],
    }
    for name in names:
        ours = archive[name][0].resolved["reward"]["terms"].get(weight["term"], "")
        ours = ours["weight"] if isinstance(ours, dict) else ours
        row[f"here, {name}"] = f"{ours:,g}" if ours != "" else ""
    return row


def _controls_row(weight: str, runs: Sequence[ArchivedRun]) -> Row:
    tracks = [track for run in runs for track in run.tracks]
    row = {"r_velocity": weight, "seeds": str(len(runs))}
    for name, column, unit in (("propeller", "propeller_n", "N"), ("rudder", "rudder_deg", "°")):
        row[f"{name} changes, % of the steps"] = middle([100 * change_share(t, column) for t in tracks])
        row[f"mean {name} change per step [{unit}]"] = middle(
            [change_size(track, column) for track in tracks], "{:.1f}"
        )
    row["last at top speed [m from the goal]"] = middle([slowing_m(track) for track in tracks], "{:.1f}")
    return row


def thesis_learner_page(facts: Facts, archive: Archive) -> Page:
    """The thesis' learner with both units of δd."""
    experiments = archive.group("thesis")
    runs = [
        (f"scenario {e.scenario[1:]}, δd in {_unit(archive[e.name][0])}", archive[e.name][0])
        for e in experiments
    ]
    figures: dict[str, Draw] = {
        "thesis-endings": lambda: curves.endings_figure(
            "The thesis' learner: outcomes of the episodes", runs
        ),
        "thesis-losses": lambda: curves.losses_figure("The thesis' learner: errors and values", runs),
    }
    errors = [_td_errors(run) for _, run in runs]
    values = {
        "episodes": ", ".join(f"{count:,} in scenario {name[1:]}" for name, count in facts.episodes.items()),
        "trainings": [_thesis_row(e, archive[e.name][0]) for e in experiments],
        "thesis": {name[1:]: facts.training[name][0].thesis for name in facts.episodes},
        "full": share(sum(run.recent_docked == RECENT for _, run in runs), len(runs)),
        "recent": RECENT,
        "growth": spread([last / least for least, _, last in errors], "{:.0f}", " times"),
        "scale": mastered(archive["ablation-reward-scale"]),
        "squared": mastered(archive["ablation-huber"]),
    }
    return Page("results/thesis-learner.md", "thesis-learner.md", values, figures)


def _unit(run: ArchivedRun) -> str:
    return format_unit(float(run.resolved["reward"]["distance_unit_m"]))


def _td_errors(run: ArchivedRun) -> tuple[float, float, float]:
    """Mean absolute TD error of the updates in units of the reward: minimum, maximum, last."""
    error = run.updates["td_error"].abs() / run.training["reward_scale"]
    return float(error.min()), float(error.max()), float(error.iloc[-1])


def _thesis_row(experiment: Experiment, run: ArchivedRun) -> Row:
    best = run.episodes["outcome"].eq("docked").rolling(RECENT).sum()
    greedy = run.greedy
    assert greedy is not None  # every archived run has evaluations
    return {
        "scenario": experiment.scenario[1:],
        "δd in": _unit(run),
        "episodes": f"{len(run.episodes):,}",
        "steps": f"{run.steps:,}",
        "hours": f"{run.minutes / 60:.1f}",
        "first docked from every evaluation pose at": f"{steps(run.first_docked)} steps"
        if run.first_docked
        else "never",
        "greedy episodes that dock": share(int((greedy["outcome"] == "docked").sum()), len(greedy)),
        f"most docked of {RECENT}": f"{best.max():.0f} (to episode {int(best.argmax()) + 1:,})"
        if best.max()
        else "0",
        f"docked of the last {RECENT}": str(run.recent_docked),
        "selection episodes docked": docked_share(run.outcomes(SELECTION)),
        "test starts": outcome_counts(run.outcomes(TEST)),
        "mean abs. TD error: minimum, maximum, last": ", ".join(f"{error:,.0f}" for error in _td_errors(run)),
    }


def ablation_page(facts: Facts, archive: Archive) -> Page:
    """Effect of each part of the default learner."""
    base, *others = archive.group("ablation")
    groups = {e.title: {"default": archive[base.name], "changed": archive[e.name]} for e in others}
    scenario = base.scenario[1:]
    figures: dict[str, Draw] = {
        "ablation": lambda: curves.compared_figure(
            "Ablation of the learner",
            f"scenario {scenario}; thin: seeds; thick: interquartile mean and its interval",
            groups,
        )
    }
    values = {
        "scenario": scenario,
        "settings": _settings(base),
        "steps": f"{int(archive[base.name][0].training['total_steps']):,}",
        "rows": [_ablation_row(e, base, archive[e.name]) for e in (base, *others)],
    }
    return Page("results/ablation.md", "ablation.md", values, figures)


def _ablation_row(experiment: Experiment, base: Experiment, runs: Sequence[ArchivedRun]) -> Row:
    shares = [100 * curves.docked_over(run, int(run.training["total_steps"])) for run in runs]
    return {
        "change": experiment.title,
        "set": _settings(experiment, base),
        "docked during training, %": middle(shares),
        **training_outcomes(runs),
    }


def _settings(experiment: Experiment, base: Experiment | None = None) -> str:
    """Overrides of an experiment, without those that `base` has too."""
    shared = base.set if base else ()
    return ", ".join(f"`{setting}`" for setting in experiment.set if setting not in shared)


def time_page(facts: Facts, archive: Archive) -> Page:
    """Fig. 4.38 and the duration of training."""
    first = archive["s3"][0]
    figures: dict[str, Draw] = {"latency": partial(_latency_figure, first, facts.forward_pass_ms)}
    values = {
        "forward_ms": f"{facts.forward_pass_ms:g}",
        "decisions": [_decision_row(run, part) for run in archive["s3"] for part in REQUIRED],
        "seconds_per_step": f"{facts.seconds_per_step:g}",
        "hours": f"{facts.hours_per_scenario:g}",
        "trainings": [_time_row(scenario, archive[scenario.name]) for scenario in facts.scenarios],
    }
    return Page("results/time.md", "time.md", values, figures)


def _latency_figure(run: ArchivedRun, forward_pass_ms: float) -> Figure:
    """Histograms of the parts of a decision, with the thesis' forward pass."""
    samples, latency = run.latency_samples, run.latency
    subtitle = f"{latency['subject']}; {len(samples):,} decisions"
    figure = latency_figure(samples, subtitle, float(latency["control_period_ms"]))
    ax = figure.axes[[*PARTS].index("forward_ms")]
    ax.axvline(forward_pass_ms, color=palette.YELLOW, lw=1.6)
    label_line(ax, forward_pass_ms, f"thesis {forward_pass_ms:g} ms", palette.YELLOW)
    return figure


def _decision_row(run: ArchivedRun, part: str) -> Row:
    times = run.latency_samples[part]
    return {
        "seed": str(run.seed),
        "part": PARTS[part],
        "mean": f"{times.mean():.3f}",
        "median": f"{times.median():.3f}",
        "99 %": f"{times.quantile(0.99):.3f}",
        "slowest": f"{times.max():.2f}",
    }


def _time_row(scenario: ScenarioFact, runs: Sequence[ArchivedRun]) -> Row:
    return {
        "scenario": str(scenario.number),
        "ms per step": spread([run.milliseconds_per_step for run in runs], "{:.2f}"),
        "minutes per run": spread([run.minutes for run in runs]),
        "steps per run": spread([run.steps for run in runs], "{:,}"),
    }
