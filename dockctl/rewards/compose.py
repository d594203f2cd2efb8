"""The reward of a scenario: equations 3.10 and 3.13 as cases over registered terms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import dockctl.rewards.terms  # noqa: F401 - registers the terms
from dockctl.errors import require_shape
from dockctl.geometry import Bools, Floats
from dockctl.plugins import REWARD_TERMS, Guard
from dockctl.scenarios.schema import SHARED_BY_TERMS, Reward, WeightedTerm
from dockctl.sim.goal import StepStatus


class RewardFunction:
    """The reward of a control step: that of its event, otherwise the sum of the dense terms.

    Args:
        reward: terms, weights and parameters of the scenario.

    Raises:
        DockctlError: a term or one of its parameters is unknown, or a parameter is missing.
    """

    def __init__(self, reward: Reward) -> None:
        self._terms = tuple(
            (
                Guard(REWARD_TERMS, weighted.term),
                weighted.term,
                REWARD_TERMS.get(weighted.term).kind,
                weighted.weight,
                _bind(weighted, reward),
            )
            for weighted in reward.terms
        )
        self.names = tuple(dict.fromkeys(name for _, name, *_ in self._terms))

    def __call__(self, status: StepStatus) -> tuple[Floats, dict[str, Floats]]:
        """Return the reward (n,) and the contribution of each term by name, (n,) each.

        Raises:
            DockctlError: a term failed, or returned a shape other than (n,).
        """
        applies = _cases(status)
        breakdown = {name: np.zeros(len(status.phase)) for name in self.names}
        for guard, name, kind, weight, measure in self._terms:
            with guard:
                value = np.asarray(measure(status)).astype(float, casting="same_kind")
                require_shape(f"reward term '{name}'", value.shape, status.phase.shape)
            breakdown[name] += np.where(applies[kind], weight * value, 0.0)
        return sum(breakdown.values(), np.zeros(len(status.phase))), breakdown  # eq. 3.10 or 3.13


def _cases(status: StepStatus) -> dict[str, Bools]:
    """Return the case of eqs. 3.10 and 3.13 for each boat: by kind of term, the boats (n,) it applies to.

    Exactly one kind applies to a boat, since a step has at most one event. Eq. 3.10 has no intermediate pose.
    """
    return {
        "collision": status.collided,  # eqs. 3.10, 3.13: r_collision
        "final": status.reached_final,  # eqs. 3.10, 3.13: r_final
        "intermediate": status.reached_intermediate,  # eq. 3.13: r_pre-final
        "dense": ~(status.terminated | status.reached_intermediate),  # eqs. 3.10, 3.13: otherwise
    }


def _bind(weighted: WeightedTerm, reward: Reward) -> Callable[[StepStatus], Floats]:
    """Return the term with its parameters bound."""
    entry = REWARD_TERMS.get(weighted.term)
    shared = {name: getattr(reward, name) for name in SHARED_BY_TERMS if name in entry.parameters}
    return entry.bind({**shared, **weighted.params})
