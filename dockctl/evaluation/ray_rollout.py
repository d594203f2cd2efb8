"""Episodes on Ray: the starts are divided among the workers, and the results are those of one process.

Head and workers share no files: a worker gets the scenario with its local files, and the files of the policy.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import ray
from ray.exceptions import RayError, RayTaskError

from dockctl import __version__
from dockctl.agents.interface import Policy
from dockctl.cluster import require_version, write_files
from dockctl.errors import DockctlError
from dockctl.evaluation.loading import load_policy
from dockctl.evaluation.policies import LoadedPolicy
from dockctl.evaluation.rollout import Episode, Rollout
from dockctl.run_files import SCENARIO
from dockctl.scenarios.content import self_contained
from dockctl.scenarios.loader import load
from dockctl.sim.starts import Start

LEAST_STARTS = 16
"""Minimum number of starts in a part, which run as one batch."""
PARTS_PER_CORE = 4
"""Parts per core: episodes differ in length, and a worker that finishes takes another part."""


@dataclass(frozen=True)
class Setup:
    """Policy and scenario as plain data, with their files by path."""

    version: str
    files: tuple[tuple[str, bytes], ...]
    policy: str
    params: tuple[tuple[str, Any], ...]


class RayRollout:
    """Runs a policy as `Rollout.run` does, on the cluster that is connected.

    The policy must treat each boat independently; otherwise it acts differently in batches of other sizes.

    Args:
        rollout: provides the scenario to run.
        policy: loaded again by every worker.
        cores: number of workers among which the starts are divided.

    Raises:
        DockctlError: a file of the policy or scenario cannot be read.
    """

    def __init__(self, rollout: Rollout, policy: LoadedPolicy, cores: int) -> None:
        source, files, params = policy.portable()
        files = {f"policy/{name}": content for name, content in files.items()}
        files |= {f"scenario/{name}": data for name, data in self_contained(rollout.scenario).items()}
        setup = Setup(__version__, tuple(files.items()), source, tuple(params.items()))
        self._setup, self._parts = ray.put(setup), PARTS_PER_CORE * cores
        self._seeded = rollout.seeded

    def run(self, starts: Sequence[Start]) -> list[Episode]:
        """Run one episode from each start, in their order; if a worker is lost, its part is run again.

        Raises:
            DockctlError: the policy fails, or workers are lost repeatedly.
        """
        starts = self._seeded(starts)
        count = max(1, min(self._parts, len(starts) // LEAST_STARTS))
        task: Any = ray.remote(num_cpus=1, max_retries=3)(_run)
        bounds = [len(starts) * part // count for part in range(count + 1)]
        parts = [task.remote(self._setup, starts[a:b]) for a, b in pairwise(bounds)]
        try:
            return [episode for part in ray.get(parts) for episode in part]
        except RayTaskError as error:
            if isinstance(error.cause, DockctlError):
                raise DockctlError(error.cause.message, code=error.cause.code) from None
            raise
        except RayError as error:
            reason = str(error).strip().splitlines()[-1].strip()
            raise DockctlError(f"workers were lost, most recently: {reason}", code="unavailable") from None


def _run(setup: Setup, starts: Sequence[Start]) -> list[Episode]:
    """Run episodes on a worker.

    Raises:
        DockctlError: the policy fails, or this machine has a different version of dockctl.
    """
    try:
        rollout, policy = _prepared(setup)
        return rollout.run(policy, starts)
    except DockctlError as error:  # subclasses with other constructor arguments cannot be pickled
        raise DockctlError(str(error), code=error.code) from None


@lru_cache(maxsize=1)
def _prepared(setup: Setup) -> tuple[Rollout, Policy]:
    require_version(setup.version)
    with tempfile.TemporaryDirectory(prefix="dockctl-") as name:
        folder = Path(name)
        write_files(folder, dict(setup.files))
        rollout = Rollout(load(folder / "scenario" / SCENARIO))
        source = setup.policy.replace(LoadedPolicy.FILES, str(folder / "policy"))
        loaded = load_policy(source, trust=True, **dict(setup.params))
        return rollout, loaded.make(rollout.env())
