"""Policies from any supported source, with the scenario that each one runs in."""

from __future__ import annotations

import hashlib
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

from dockctl.agents import checkpoint
from dockctl.agents.checkpoint import PolicyCard, require_spaces
from dockctl.agents.interface import Policy, Spaces, Tensors
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError, InputError, plugin_errors
from dockctl.evaluation.libraries import CheckedPolicy
from dockctl.plugins import OBSERVATION_PARTS
from dockctl.reading import read_bytes
from dockctl.run_files import POLICY, POLICY_JSON
from dockctl.runs.directory import RunDirectory, shipped
from dockctl.runs.listing import given_name
from dockctl.scenarios.catalog import display_path
from dockctl.scenarios.content import first_difference
from dockctl.scenarios.loader import LoadedScenario, load
from dockctl.scenarios.schema import INTERFACE, Scenario
from dockctl.scenarios.yaml_tree import Location
from dockctl.sim.checks import beyond_authority, load_checked, unused_authority

Factory = Callable[[Scenario], Any]
Build = Callable[[DockingVectorEnv], Any]


@dataclass(frozen=True, eq=False, kw_only=True)
class LoadedPolicy(ABC):
    """A policy and where it comes from; `make` builds it for an environment.

    Attributes:
        name: short name, for tables and figures.
        long_name: distinguishes policies with the same short name.
        own_scenario: its scenario, file or name; None if it has none.
        run: the run folder that contains it, if any.
        plugin_files: the user's local plugins.
        trust: whether the plugins of a received scenario may run.
    """

    FILES: ClassVar[str] = "{files}"

    name: str
    long_name: str
    own_scenario: str | None = None
    run: RunDirectory | None = None
    plugin_files: tuple[Path, ...] = ()
    trust: bool = False

    @property
    def description(self) -> str:
        """Text for the first line of a report."""
        return self.long_name

    def title_on(self, scenario: Scenario, overrides: Sequence[str]) -> str:
        """First line of a report, with the scenario and its changed values."""
        return ", ".join([f"Policy {self.description} on scenario '{scenario.name}'", *overrides])

    @property
    def caption(self) -> str:
        """Text for a figure."""
        return f"policy {self.name}"

    def caption_on(self, scenario: Scenario, overrides: Sequence[str]) -> str:
        """Text for a figure, with the scenario and its changed values; a checkpoint's own is left out."""
        return ", ".join([self.caption, f"scenario {scenario.name}", *overrides])

    @property
    def results(self) -> Path | None:
        """Folder for its results in the run folder that contains it, if any."""
        return None

    @property
    def file_name(self) -> str:
        """Name of the policy for files and folders."""
        return re.sub(r"[^\w.=-]+", "_", self.name)

    @abstractmethod
    def make(self, env: DockingVectorEnv) -> Policy:
        """Build the policy for an environment.

        Raises:
            DockctlError: its observations or actions do not match the environment, or its code fails.
        """

    def portable(self) -> tuple[str, dict[str, bytes], Mapping[str, Any]]:
        """Return what `load_policy` needs on another machine: source, files by name, and parameters.

        In the source, `FILES` stands for the folder of the files.

        Raises:
            DockctlError: a file cannot be read.
        """
        return self.long_name, {}, {}

    @abstractmethod
    def facts(self) -> dict[str, Any]:
        """Return the identity of the policy, as plain data for JSON."""

    def scenario(self, source: str | Path | None = None, overrides: Sequence[str] = ()) -> LoadedScenario:
        """Load the scenario to run in, by default the policy's own.

        Args:
            overrides: ``key=value``.

        Raises:
            DockctlError: there is no such scenario, or the policy cannot run in it.
        """
        source = source or self.own_scenario
        if source is None:
            raise DockctlError(
                f"{self.long_name}: has no scenario of its own; give one with --scenario", code="missing_key"
            )
        return load_checked(source, overrides=overrides, **self._plugins(source))

    def _plugins(self, source: str | Path) -> dict[str, Any]:
        """Return the arguments of `load` that say which plugins of a scenario may run."""
        received = source == self.own_scenario and isinstance(self, CheckpointPolicy)
        return {"plugin_files": self.plugin_files, "received": received, "trust": self.trust}

    def is_transfer(self, scenario: Scenario) -> bool:
        """Whether `scenario` differs from the policy's own in more than the training section."""
        return False

    def is_own(self, scenario: Scenario, overrides: Sequence[str]) -> bool:
        """Whether `scenario`, resolved with these changed values, is the policy's own, unchanged."""
        return not overrides and not self.is_transfer(scenario)

    def notes_on(self, scenario: Scenario, overrides: Sequence[str]) -> list[str]:
        """Return what the user should know about a scenario, if it is not the policy's own, unchanged.

        These are conditions beyond the vessel's control authority, and authority that no action uses.
        """
        if self.own_scenario is not None and self.is_own(scenario, overrides):
            return []
        found = [*beyond_authority(scenario), *unused_authority(scenario)]
        return [f"{field}: {message}" for field, message in found if not field.startswith("training.")]


@dataclass(frozen=True, eq=False, kw_only=True)
class CheckpointPolicy(LoadedPolicy):
    """A trained policy on disk. Its `PolicyInterface` replaces that of every scenario it runs in.

    Attributes:
        file: its JSON file, which a training run in progress may replace.
        tensors: its parameters.
    """

    file: Path
    tensors: Tensors
    policy: Policy
    card: PolicyCard
    own_scenario: str

    @property
    def description(self) -> str:
        card, folder = self.card, self.file.parent
        name = folder.name if folder in shipped().values() else display_path(self.file)
        return f"{name} (trained on '{card.scenario}', seed {card.seed}, {card.env_steps:,} steps)"

    @property
    def caption(self) -> str:
        return f"policy trained on {self.card.scenario}, seed {self.card.seed}"

    def caption_on(self, scenario: Scenario, overrides: Sequence[str]) -> str:
        return super().caption_on(scenario, overrides) if self.is_transfer(scenario) else self.caption

    @property
    def results(self) -> Path | None:
        """The run folder, or a subfolder for a checkpoint other than the best."""
        if self.run is None:
            return None
        is_best = self.file.resolve() == checkpoint.find_policy(self.run.path).resolve()
        return self.run.path if is_best else self.run.path / self.file.parent.name

    @property
    def file_name(self) -> str:
        folder = (self.results or self.file.parent).resolve()
        above = self.run.path.resolve().parent if self.run else folder.parent
        return "-".join(folder.relative_to(above).parts)

    def make(self, env: DockingVectorEnv) -> Policy:
        require_spaces(self.card, Spaces.from_env(env), where=self.file, scenario=env.scenario.name)
        return self.policy

    def portable(self) -> tuple[str, dict[str, bytes], Mapping[str, Any]]:
        files = (self.file, self.file.with_suffix(".safetensors"))
        pair = {f"{POLICY}{file.suffix}": read_bytes(file) for file in files}
        return f"{self.FILES}/{POLICY_JSON}", pair, {}

    def facts(self) -> dict[str, Any]:
        return {"file": str(self.file), **self.card.model_dump(mode="json")}

    def scenario(self, source: str | Path | None = None, overrides: Sequence[str] = ()) -> LoadedScenario:
        """Load the scenario, with the observation and the actions of the policy; see `LoadedPolicy`.

        Raises:
            DockctlError: the scenario is invalid, the actions exceed the limits of its vessel, or `overrides`
                change the observation, actions or range sensor, which belong to the policy.
        """
        source = source or self.own_scenario
        loaded = super().scenario(source, overrides)
        if overrides and (interface := self.card.interface):
            unchanged = load(source, **self._plugins(source)).scenario
            if not interface.agrees(unchanged, loaded.scenario):
                keys = [change.partition("=")[0] for change in overrides]
                changed = [key for key in keys if key.partition(".")[0] in INTERFACE] or keys
                message = "observation, actions and range sensor belong to the policy; leave this out"
                raise InputError(Location(f"--set {key}").problem(message, "", "mismatch") for key in changed)
        return replace(loaded, scenario=self._with_interface(loaded.scenario))

    def is_transfer(self, scenario: Scenario) -> bool:
        try:
            own = self._with_interface(load(self.own_scenario, **self._plugins(self.own_scenario)).scenario)
            return first_difference(own, scenario, ignore=("training",)) is not None
        except (DockctlError, OSError):  # the policy's own scenario no longer exists
            return True

    def _with_interface(self, scenario: Scenario) -> Scenario:
        """Return `scenario` with the observation and the actions of the policy's card.

        Raises:
            DockctlError: the actions exceed the limits of the vessel.
        """
        interface = self.card.interface
        if interface is None:
            return scenario
        if any(part.part not in OBSERVATION_PARTS for part in interface.observation):
            load(self.own_scenario, **self._plugins(self.own_scenario))  # registers the part
        return interface.on(scenario)


@dataclass(frozen=True, eq=False, kw_only=True)
class BuiltPolicy(LoadedPolicy):
    """A policy that code builds for an environment: a controller, or a model from another library.

    Attributes:
        build: returns the policy for an environment.
        file: its source file, for the hash and for line numbers in errors.
        params: parameters of the factory.
    """

    build: Build
    file: Path | None = None
    params: Mapping[str, Any] = field(default_factory=dict)

    def make(self, env: DockingVectorEnv) -> Policy:
        with plugin_errors(f"policy {self.long_name} cannot be built", self.file):
            policy = self.build(env)
        for method in ("reset", "act"):
            if not callable(getattr(policy, method, None)):
                raise DockctlError(
                    f"policy {self.long_name}: the factory returned a {type(policy).__name__} without the"
                    f" method '{method}'; a policy has reset(rows, info) and act(observation, info)",
                    code="plugin",
                )
        return CheckedPolicy(policy, self.long_name, self.file, env.single_action_space)

    def portable(self) -> tuple[str, dict[str, bytes], Mapping[str, Any]]:
        source, colon, attribute = self.long_name.rpartition(":")
        file = Path(source if colon else self.long_name)
        if file.suffix not in (".py", ".zip", ".onnx"):
            return self.long_name, {}, self.params
        moved = f"{self.FILES}/{file.name}" + (f":{attribute}" if colon else "")
        return moved, {file.name: read_bytes(file)}, self.params

    def facts(self) -> dict[str, Any]:
        facts: dict[str, Any] = {"name": self.long_name}
        if self.file is not None:
            content = self.file.read_bytes()
            facts |= {"file": str(self.file), "sha256": hashlib.sha256(content).hexdigest()}
        return facts | ({"params": dict(self.params)} if self.params else {})


def distinct_names(policies: Sequence[LoadedPolicy]) -> list[str]:
    """Return a short and unique name for each policy.

    If short names are equal, those of runs are replaced by the names given with ``train --name``, or else by
    the folders in which their paths differ.
    """
    names = [policy.name for policy in policies]
    longer = [
        name
        if names.count(name) == 1
        else _longer_name(policy, [one for one in policies if one.name == name])
        for policy, name in zip(policies, names, strict=True)
    ]
    return [
        f"{name} ({longer[: i + 1].count(name)})" if longer.count(name) > 1 else name
        for i, name in enumerate(longer)
    ]


def _longer_name(policy: LoadedPolicy, equal: Sequence[LoadedPolicy]) -> str:
    """Return a longer name for one of several policies whose short names are equal."""
    given = [given_name(one.run) if one.run is not None else "" for one in equal]
    own = given[equal.index(policy)]
    if own and given.count(own) == 1:
        return own
    paths = [one.run.path.resolve().parts for one in equal if one.run is not None]
    if len(paths) == len(equal):
        for folders in zip(*paths, strict=False):
            if len(set(folders)) == len(folders):
                name: str = folders[equal.index(policy)]
                return name
    return policy.long_name
