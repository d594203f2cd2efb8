"""Compare policies from the same starts: paired differences from the first policy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dockctl.analysis.contrast import Contrast, contrasts
from dockctl.errors import DockctlError, InputError
from dockctl.evaluation.evaluate import Evaluation, evaluate
from dockctl.evaluation.loading import load_policy
from dockctl.evaluation.policies import LoadedPolicy, distinct_names
from dockctl.runs.tables import Value

if TYPE_CHECKING:
    import pandas as pd


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
        import pandas as pd  # slow to import

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
        """Return all results except the individual episodes."""
        return {
            "scenario": self.first.scenario.name,
            "set": list(self.first.overrides),
            "random_seed": self.first.seed,
            "policies": {
                name: {
                    "policy": evaluation.policy.facts(),
                    "set": list(evaluation.overrides),
                    **evaluation.summaries,
                }
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
    vary: Sequence[str] = (),
) -> Comparison:
    """Run policies from the same starts.

    Args:
        policies: two or more, or one with `vary`; see `dockctl.evaluation.loading.load_policy`.
        scenario: file or name; by default the scenario of the first policy.
        episodes: number of random starts; see `evaluate`.
        seed: of the random starts.
        overrides: changed values of the scenario, ``key=value``.
        vary: further changed values; each policy also runs with each of them on its own.

    Raises:
        DockctlError: there is one policy and nothing to vary, a policy does not exist or does not match the
            scenario, or a changed value changes the starts.
    """
    if len(policies) * (1 + len(vary)) < 2:
        raise DockctlError("a comparison needs two or more policies, or --vary", code="missing_key")
    loaded = [load_policy(policy) for policy in policies]
    source = scenario or loaded[0].own_scenario
    variants = {change: [*overrides, *([change] if change else [])] for change in ("", *vary)}
    for policy in loaded:
        for changed in variants.values():
            with _named_vary(vary):
                policy.scenario(source, changed)  # reports errors of all policies before the first episode
    results = {
        f"{name}, {change}" if change else name: evaluate(
            policy, source, episodes=episodes, seed=seed, overrides=changed
        )
        for name, policy in zip(distinct_names(loaded), loaded, strict=True)
        for change, changed in variants.items()
    }
    _require_same_starts(results)
    return Comparison(results)


@contextmanager
def _named_vary(vary: Sequence[str]) -> Iterator[None]:
    """Name the option ``--vary`` instead of ``--set`` in errors of these changes."""
    given = {f"--set {change}" for change in vary} | {f"--set {change.partition('=')[0]}" for change in vary}
    try:
        yield
    except InputError as error:
        raise InputError(
            [
                replace(each, file=each.file.replace("--set", "--vary", 1)) if each.file in given else each
                for each in error.problems
            ]
        ) from None


def _require_same_starts(results: Mapping[str, Evaluation]) -> None:
    """Check that the evaluations have the same starts, so that their episodes are pairs."""
    first, *others = results.items()
    columns = ["start_kind", "start", "x_m", "y_m", "heading_deg"]
    for name, evaluation in others:
        if not evaluation.table[columns].equals(first[1].table[columns]):
            message = f"'{name}' does not start from the same poses as '{first[0]}': they cannot be paired"
            raise DockctlError(message, code="mismatch")
