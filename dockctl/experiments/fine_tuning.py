"""Fine-tuning: training that starts from the parameters of a trained policy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dockctl.agents.checkpoint import PolicyCard, read_policy, rebuild_policy, save_policy
from dockctl.agents.interface import Algorithm, FineTunable, Tensors
from dockctl.envs.observation import ObservationEncoder
from dockctl.errors import DockctlError
from dockctl.run_files import INITIAL
from dockctl.runs.directory import RunDirectory
from dockctl.runs.files import make_folder
from dockctl.scenarios.schema import PolicyInterface, Scenario


@dataclass(frozen=True, eq=False)
class InitialPolicy:
    """The policy that training starts from.

    Attributes:
        source: where it was read from, for messages.
        tensors, card: its parameters and description.
    """

    source: str
    tensors: Tensors
    card: PolicyCard

    @classmethod
    def load(cls, source: str | Path, *, trust: bool = False) -> InitialPolicy:
        """Load the policy of a run folder or of a checkpoint, by path or name.

        Raises:
            DockctlError: there is none, or it is damaged.
        """
        file, tensors, facts = read_policy(Path(source))
        _, card = rebuild_policy(file, tensors, facts, trust=trust)
        return cls(str(source), tensors, card)

    @classmethod
    def of_run(cls, run: RunDirectory) -> InitialPolicy | None:
        """Return the policy that `run` started from, or None.

        Raises:
            DockctlError: it is damaged.
        """
        folder = run.path / INITIAL
        return cls.load(folder) if folder.is_dir() else None

    def save(self, run: RunDirectory) -> None:
        """Keep a copy in the run folder, so that the run can be repeated.

        Raises:
            DockctlError: it cannot be written.
        """
        folder = run.path / INITIAL
        make_folder(folder)
        save_policy(folder, self.tensors, self.card)

    def require_fit(self, scenario: Scenario) -> None:
        """Check that training in the scenario can start from the policy.

        Raises:
            DockctlError: the algorithm, network, actions or range sensor differ, or the policy observes what
                the scenario does not.
        """
        card, training, new = self.card, scenario.training, PolicyInterface.of(scenario)
        own = self._interface
        if card.algorithm["kind"] != training.algorithm.kind:
            raise self._wrong_algorithm(training.algorithm.kind)
        sizes, wanted = card.hidden_sizes, training.hidden_sizes
        if len(sizes) != len(wanted) or any(size > wide for size, wide in zip(sizes, wanted, strict=True)):
            least = f"training: {{hidden_sizes: {list(sizes)}}}"
            raise self._mismatch(
                f"its network does not fit into {list(wanted)}; set {least}, or wider layers"
            )
        for name, field in (
            ("actions", "actions"),
            ("lidar_sectors", "sensors.lidar.sectors"),
            ("lidar", "sensors.lidar"),
        ):
            if getattr(own, name) not in (None, getattr(new, name)):
                raise self._mismatch(f"{field} of the scenario differs from that of the policy")
        lacking = [part.part for part in own.observation if part not in new.observation]
        if lacking:
            raise self._mismatch(f"the scenario does not observe {', '.join(lacking)} as the policy does")

    def start(self, algorithm: Algorithm, scenario: Scenario) -> None:
        """Initialize a new algorithm with the parameters of the policy, which must be compatible.

        The scenario may have more observations than the policy and wider layers: at first, the policy acts as
        before, regardless of the new inputs.

        Raises:
            DockctlError: the algorithm cannot start from a policy.
        """
        if not isinstance(algorithm, FineTunable):
            raise self._wrong_algorithm(scenario.training.algorithm.kind)
        algorithm.start_from(self.tensors, self._inputs(self._interface, PolicyInterface.of(scenario)))

    @property
    def _interface(self) -> PolicyInterface:
        if self.card.interface is None:
            raise self._mismatch("its card does not list what it observes; it is from an earlier version")
        return self.card.interface

    def _inputs(self, own: PolicyInterface, new: PolicyInterface) -> NDArray[np.int64]:
        """Return, for each column of the new observation, its index in the policy's observation, or -1."""
        before, now = (ObservationEncoder(i.observation, i.lidar_sectors).names for i in (own, new))
        return np.array([before.index(name) if name in before else -1 for name in now])

    def _wrong_algorithm(self, kind: str) -> DockctlError:
        kinds = f"'{self.card.algorithm['kind']}', but training uses '{kind}'"
        return self._mismatch(f"its algorithm is {kinds}; fine-tuning is possible with 'dqn'")

    def _mismatch(self, reason: str) -> DockctlError:
        return DockctlError(f"--from {self.source}: {reason}", code="mismatch")

    @property
    def facts(self) -> dict[str, Any]:
        """Return the entry in the provenance of the run."""
        return {"policy": self.source, "scenario": self.card.scenario, "sha256": self.card.sha256}
