"""Load policies from any supported source, with the scenario that each one runs in.

Sources:

- a checkpoint: a run folder, a checkpoint folder or file, or its name (`named_checkpoints`);
- the name of a registered policy (`dockctl.plugins.policy`);
- a factory ``(scenario) -> Policy``: ``file.py:factory`` or ``module:factory``;
- a file from another library: ``model.zip:DQN`` (Stable-Baselines3) or ``policy.onnx`` (ONNX Runtime).
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from dockctl import plugins
from dockctl.agents import checkpoint
from dockctl.errors import DockctlError, nearest
from dockctl.evaluation.libraries import factory_of, imported, onnx_policy, sb3_policy
from dockctl.evaluation.policies import Build, BuiltPolicy, CheckpointPolicy, Factory, LoadedPolicy
from dockctl.plugins import POLICIES
from dockctl.registry import Entry
from dockctl.run_files import RUNS, SCENARIO
from dockctl.runs.directory import RunDirectory, named_checkpoints
from dockctl.scenarios import catalog
from dockctl.scenarios.catalog import SUFFIXES
from dockctl.scenarios.loader import load
from dockctl.trust import file_digest, require


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
        DockctlError: there is no such policy, it cannot be loaded, or it takes no parameters.
    """
    if isinstance(policy, LoadedPolicy):
        _require_none(params, policy.name)
        return policy
    files = tuple(map(Path, plugin_files))
    for file in files:
        plugins.load_file(file)
    loaded = None if policy is None else _from_code(str(policy), params, trust=trust)
    if loaded is None or not loaded.params:
        _require_none(params, "the latest run" if policy is None else policy)
    if loaded is None:
        path = None if policy is None else Path(policy)
        return load_checkpoint(path, plugin_files=files, trust=trust)
    return replace(loaded, plugin_files=files, trust=trust)


def _require_none(params: Mapping[str, Any], policy: str | Path) -> None:
    if params:
        message = f"{policy}: only a factory takes parameters, found {', '.join(params)}"
        raise DockctlError(message, code="unknown_key")


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
