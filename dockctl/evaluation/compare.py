"""Compare policies from the same starts: paired differences from the first one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from dockctl.analysis.contrast import Contrast, contrasts
from dockctl.errors import DockctlError
from dockctl.evaluation.evaluate import Evaluation, evaluate
from dockctl.evaluation.policies import LoadedPolicy, load_policy
from dockctl.runs.tables import Value


@dataclass(frozen=True, eq=False)
class Comparison:
    """Evaluations of several policies from the same starts, by the name of the policy."""

    evaluations: dict[str, Evaluation]

    @property
    def first(self) -> Evaluation:
        """The evaluation that the others are compared with."""
        return next(iter(self.evaluations.values()))

    @property
    def table(self) -> pd.DataFrame:
        """One row per episode: ``policy``, and columns `dockctl.runs.tables.EVALUATION`."""
        return pd.DataFrame(self.rows())

    def rows(self) -> list[dict[str, Value]]:
        """Return the rows of `table`."""
        return [
            {"policy": name, **row}
            for name, evaluation in self.evaluations.items()
            for row in evaluation.rows()
        ]

    @cached_property
    def contrasts(self) -> list[Contrast]:
        """Differences of each policy from the first, by kind of start."""
        return list(contrasts(self.table))

    def as_json(self) -> dict[str, Any]:
        """Return all results except the single episodes."""
        return {
            "scenario": self.first.scenario.name,
            "set": list(self.first.overrides),
            "random_seed": self.first.seed,
            "policies": {
                name: {"policy": evaluation.policy.facts(), **evaluation.summaries}
                for name, evaluation in self.evaluations.items()
            },
            "differences": [
                {
                    "starts": contrast.kind,
                    "first": contrast.first,
                    "second": contrast.second,
                    "only_first_docks": contrast.only_first,
                    "only_second_docks": contrast.only_second,
                    "mcnemar_p": contrast.p,
                    **{
                        measure.column: {
                            "first": compared.first,
                            "second": compared.second,
                            **asdict(compared.difference),
                        }
                        for measure, compared in contrast.compared.items()
                    },
                }
                for contrast in self.contrasts
            ],
        }


def compare(
    policies: Sequence[str | Path | LoadedPolicy],
    scenario: str | Path | None = None,
    *,
    episodes: int | None = None,
    seed: int | None = None,
    overrides: Sequence[str] = (),
) -> Comparison:
    """Run policies from the same starts.

    Args:
        policies: two or more; see `dockctl.evaluation.policies.load_policy`.
        scenario: file or name; that of the first policy by default.
        episodes, seed: of the random starts; see `evaluate`.
        overrides: changed values of the scenario, ``key=value``.

    Raises:
        DockctlError: fewer than two policies, or one does not exist or does not fit the scenario.
    """
    if len(policies) < 2:
        raise DockctlError("a comparison needs two or more policies", code="missing_key")
    loaded = [load_policy(policy) for policy in policies]
    source = scenario or loaded[0].own_scenario
    results = [
        evaluate(policy, source, episodes=episodes, seed=seed, overrides=overrides) for policy in loaded
    ]
    return Comparison(dict(zip(_names(loaded), results, strict=True)))


def _names(policies: Sequence[LoadedPolicy]) -> list[str]:
    """Return a short and unique name for each policy."""
    names = [policy.name for policy in policies]
    longer = [
        policy.long_name if names.count(name) > 1 else name
        for policy, name in zip(policies, names, strict=True)
    ]
    return [
        f"{name} ({longer[: i + 1].count(name)})" if longer.count(name) > 1 else name
        for i, name in enumerate(longer)
    ]
