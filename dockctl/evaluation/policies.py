"""Find the policy that a user names, and the scenario that it is to sail in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from gymnasium.spaces import flatdim

from dockctl.agents.checkpoint import PolicyCard, find_policy, load_policy, require_shape
from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.agents.policy import GreedyPolicy
from dockctl.commands.options import RUNS
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.plugins import OBSERVATION_PARTS
from dockctl.runs.directory import SCENARIO, RunDirectory
from dockctl.scenarios.content import first_difference
from dockctl.scenarios.interface import PolicyInterface
from dockctl.scenarios.loader import LoadedScenario, load
from dockctl.scenarios.schema import Scenario
from dockctl.sim.checks import load_checked


@dataclass(frozen=True, eq=False)
class Trained:
    """A policy on disk.

    Attributes:
        file: its JSON file.
        run: the run folder that it lies in, if it does.
    """

    file: Path
    network: DuelingQNetwork
    card: PolicyCard
    run: RunDirectory | None

    @property
    def policy(self) -> GreedyPolicy:
        return GreedyPolicy(self.network)

    @property
    def own_scenario(self) -> str:
        """The scenario of the training: beside the policy, in its run folder, else by its name."""
        places = [self.file.parent, *([self.run.path] if self.run else [])]
        files = [place / SCENARIO for place in places if (place / SCENARIO).is_file()]
        return str(files[0]) if files else self.card.scenario

    def scenario(self, source: str | None, overrides: Sequence[str] = ()) -> LoadedScenario:
        """Load a scenario, the policy's own by default, with the observation and the actions of the policy.

        Args:
            overrides: values that are changed in it, ``key=value``.

        Raises:
            DockctlError: there is none, the policy cannot sail in it, or an override is of what it observes
                or does.
        """
        source = source or self.own_scenario
        loaded = load_checked(source, overrides=overrides)
        given = PolicyInterface.of(loaded.scenario)
        if overrides and self.card.interface and PolicyInterface.of(load(source).scenario) != given:
            raise DockctlError(
                "--set: observation, actions and sensors.lidar.sectors are the policy's own; leave them out"
            )
        return replace(loaded, scenario=self.on(loaded.scenario))

    def is_elsewhere(self, scenario: Scenario) -> bool:
        """Whether `scenario` is another than the policy's own; how one trains in it does not count."""
        try:
            own = self.on(load(self.own_scenario).scenario)
            return first_difference(own, scenario, ignore=("training",)) is not None
        except (DockctlError, OSError):  # its own is not there
            return True

    def on(self, scenario: Scenario) -> Scenario:
        """Return `scenario` with the policy's observation and actions, where its card tells them.

        Raises:
            DockctlError: the vessel has not the power or the rudder for the policy's actions.
        """
        interface = self.card.interface
        if interface is None:
            return scenario
        if any(part.part not in OBSERVATION_PARTS for part in interface.observation):
            load(self.own_scenario)  # its local files bring the part
        return interface.on(scenario)

    def require_fit(self, env: DockingVectorEnv) -> None:
        """Check that the policy takes the environment's observations and gives its actions.

        Raises:
            CheckpointError: it does not.
        """
        require_shape(
            self.card,
            len(env.observation_names),
            flatdim(env.single_action_space),
            where=self.file,
            scenario=env.scenario.name,
        )


def find(ckpt: Path | None) -> Trained:
    """Load the policy of a run folder, a checkpoint or a shipped name; that of the latest run without one.

    Raises:
        DockctlError: there is none, or it is damaged.
    """
    path = RunDirectory.latest(RUNS).path if ckpt is None else ckpt
    network, card = load_policy(path)
    file = find_policy(path)
    return Trained(file, network, card, RunDirectory.containing(file))
