"""Which parts of its observation does a policy use?

    python benchmarks/parts.py marinas-weather
    python benchmarks/parts.py marinas-weather apparent_wind course

The test starts run as in ``dockctl evaluate``, but without planner and supervisor, which replace actions.
In every step each boat gets the values of one part from another boat: the permutation importance of Breiman
(2001, Machine Learning 45, 5-32). It shows what a policy relies on; another, trained without the part, may
do without it.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import bench  # before numpy
import numpy as np
from escape import evaluated_starts
from numpy.typing import NDArray

from dockctl.agents.interface import Info, Policy
from dockctl.evaluation import Rollout, load_policy
from dockctl.geometry import Bools, Ints

ALONE = ("evaluation.planner=false", "evaluation.supervisor=null")


class Swapped(Policy):
    """A policy that gets some columns (k,) of the observations (n, k) from the next of the n boats."""

    def __init__(self, policy: Policy, columns: Bools) -> None:
        self._policy, self._columns = policy, columns

    def reset(self, rows: Ints, info: Info) -> None:
        self._policy.reset(rows, info)

    def act(self, observation: NDArray[np.float32], info: Info) -> NDArray[np.int64]:
        return self._policy.act(np.where(self._columns, np.roll(observation, 1, axis=0), observation), info)


def main(policy: str, parts: Sequence[str]) -> None:
    """Print from how many starts the policy docks: undisturbed, and with each part from another boat."""
    given = load_policy(policy)
    rollout = Rollout(given.scenario(overrides=ALONE))
    starts = evaluated_starts(rollout)
    env = rollout.env()
    own = np.array(env.observation_parts)
    if unknown := set(parts) - set(own.tolist()):
        raise SystemExit(f"not in the observation of {policy}: {', '.join(sorted(unknown))}")
    for part in ["nothing", *(parts or dict.fromkeys(own.tolist()))]:
        episodes = rollout.run(Swapped(given.make(env), own == part), starts, clearance=False)
        docked = sum(episode.docked for episode in episodes)
        bench.console.print(f"{part}: docked from {docked} of {len(starts)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("policy")
    parser.add_argument("parts", nargs="*", help="all by default")
    main(**vars(parser.parse_args()))
