"""Load policies from any supported source, with the scenario that each one runs in.

Sources:

- a checkpoint: a run folder, a checkpoint folder or file, or its name (`named_checkpoints`);
- the name of a registered policy (`dockctl.plugins.policy`);
- a factory ``(scenario) -> Policy``: ``file.py:factory`` or ``module:factory``;
- a file from another library: ``model.zip:DQN`` (Stable-Baselines3) or ``policy.onnx`` (ONNX Runtime).
"""

from __future__ import annotations

import hashlib
import inspect
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from dockctl import plugins
from dockctl.agents import checkpoint
from dockctl.agents.checkpoint import PolicyCard, require_spaces
from dockctl.agents.interface import Policy, Spaces, Tensors
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError, nearest, plugin_errors
from dockctl.evaluation.libraries import CheckedPolicy, factory_of, imported, onnx_policy, sb3_policy
from dockctl.plugins import OBSERVATION_PARTS, POLICIES, Entry
from dockctl.reading import read_bytes
from dockctl.run_files import POLICY, POLICY_JSON, RUNS, SCENARIO
from dockctl.runs.directory import RunDirectory, named_checkpoints, shipped
from dockctl.runs.listing import given_name
from dockctl.scenarios import catalog
from dockctl.scenarios.catalog import SUFFIXES, display_path
from dockctl.scenarios.content import first_difference
from dockctl.scenarios.loader import LoadedScenario, load
from dockctl.scenarios.schema import Scenario
from dockctl.sim.checks import load_checked
from dockctl.trust import file_digest, require

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

    @property
    def caption(self) -> str:
        """Text for a figure."""
        return f"policy {self.name}"

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
                message = "--set: observation, actions and range sensor belong to the policy"
                raise DockctlError(f"{message}; leave them out", code="mismatch")
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


def load_policy(
    policy: str | Path | LoadedPolicy | None = None,
    *,
    plugin_files: Sequence[str | Path] = (),
    trust: bool = False,
    **params: Any,
) -> LoadedPolicy:
    """Load a policy from any source in the module docstring.

    Args:
        policy: the source; None for the latest run in ``runs/``.
        plugin_files: local plugins to load first; they replace those in a checkpoint.
        trust: run the code in a checkpoint even if it is not yet trusted on this machine.
        params: keyword parameters of a factory.

    Raises:
        UntrustedError: it contains code that is not trusted; none of it has run.
        DockctlError: there is no such policy, or it cannot be loaded.
    """
    if isinstance(policy, LoadedPolicy):
        return policy
    files = tuple(map(Path, plugin_files))
    for file in files:
        plugins.load_file(file)
    loaded = None if policy is None else _from_code(str(policy), params, trust=trust)
    if loaded is None:
        path = None if policy is None else Path(policy)
        return load_checkpoint(path, plugin_files=files, trust=trust)
    return replace(loaded, plugin_files=files, trust=trust)


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


def is_scenario(given: str) -> bool:
    """Return whether this is a scenario file, or the name of a scenario without a policy of that name."""
    if Path(given).suffix in SUFFIXES:
        return True
    if os.path.exists(given) or given in named_checkpoints():
        return False
    plugins.discover()
    if given in POLICIES:
        return False
    catalog.fill()
    return given in plugins.SCENARIOS


def _from_code(given: str, params: Mapping[str, Any], *, trust: bool) -> BuiltPolicy | None:
    """Return the policy of a factory or from another library; None if a checkpoint is given."""
    source, colon, attribute = given.rpartition(":")
    suffix = Path(source if colon else given).suffix
    if suffix in (".py", ".zip") and not colon:
        example = {".py": "my_factory", ".zip": "DQN"}[suffix]
        suggestion = f"{given}:{example}"
        raise DockctlError(
            f"{given}: also name what to load from it", code="missing_key", suggestion=suggestion
        )
    if suffix == ".onnx":
        file = _existing(given)
        return _built(given, partial(onnx_policy, file), file)
    if suffix == ".zip":
        file = _existing(source)
        require([(f"{file}, an archive with pickles", file_digest(file), "")], trust=trust)
        return _built(given, partial(sb3_policy, file, attribute), file)
    if suffix == ".py":
        return _from_factory(given, factory_of(plugins.load_file(Path(source)), attribute, given), params)
    if is_scenario(given):
        message = f"{given}: a scenario for which there is no policy; give a policy, and --scenario {given}"
        raise DockctlError(message, code="wrong_type")
    if os.path.exists(given) or given in named_checkpoints():
        return None
    if colon and source:
        return _from_factory(given, factory_of(imported(source, given), attribute, given), params)
    plugins.discover()
    if given in POLICIES:
        return _from_factory(given, POLICIES.get(given).value, params)
    known = [*named_checkpoints(), *POLICIES.names()]
    raise DockctlError(
        f"{given}: no such run folder, checkpoint or policy (known: {', '.join(known)}); a controller is"
        " given as file.py:factory or module:factory",
        code="not_found",
        suggestion=nearest(given, known),
    )


def load_checkpoint(
    path: Path | None = None, *, plugin_files: Sequence[Path] = (), trust: bool = False
) -> CheckpointPolicy:
    """Load the policy of a run folder, a checkpoint or its name; by default of the latest run.

    Args:
        plugin_files, trust: see `load_policy`.

    Raises:
        UntrustedError: it contains code that is not trusted; none of it has run.
        DockctlError: there is none, or it is damaged.
    """
    for plugin in plugin_files:
        plugins.load_file(plugin)
    path = RunDirectory.latest(RUNS).path if path is None else path
    file, tensors, facts = checkpoint.read_policy(path)
    run = RunDirectory.containing(file)
    places = [file.parent, *([run.path] if run else [])]
    scenarios = [str(place / SCENARIO) for place in places if (place / SCENARIO).is_file()]
    try:
        policy, card = checkpoint.rebuild_policy(file, tensors, facts, trust=trust)
    except checkpoint.CheckpointError as error:
        if not scenarios or error.code != "unknown_name":
            raise
        # The local plugins of the scenario may register what the card names.
        load(scenarios[0], plugin_files=plugin_files, received=True, trust=trust)
        policy, card = checkpoint.rebuild_policy(file, tensors, facts, trust=trust)
    return CheckpointPolicy(
        name=f"{card.scenario} seed {card.seed}" if path.exists() else str(path),
        long_name=path.resolve().name,
        own_scenario=scenarios[0] if scenarios else card.scenario,
        run=run,
        plugin_files=tuple(plugin_files),
        trust=trust,
        file=file,
        tensors=tensors,
        policy=policy,
        card=card,
    )


def _existing(file: str) -> Path:
    if not os.path.isfile(file):
        raise DockctlError(f"{file}: no such file", code="not_found")
    return Path(file)


def _from_factory(given: str, factory: Factory, params: Mapping[str, Any]) -> BuiltPolicy:
    """Return the policy of a factory, with its parameters checked."""
    bound = Entry(given, factory, "", "", "").bind(params)
    try:
        source = inspect.getsourcefile(inspect.unwrap(factory))
    except TypeError:  # neither a function nor a class
        source = None
    return _built(given, lambda env: bound(env.scenario), Path(source) if source else None, params)


def _built(
    given: str, build: Build, file: Path | None, params: Mapping[str, Any] | None = None
) -> BuiltPolicy:
    short = given.rpartition("/")[2]
    return BuiltPolicy(name=short, long_name=given, build=build, file=file, params=params or {})
