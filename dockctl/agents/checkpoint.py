"""Checkpoints: tensors as safetensors, everything else as JSON, nothing pickled."""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
import psutil
from gymnasium.spaces import Box, Discrete, Space
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, Strict, ValidationError
from safetensors import SafetensorError
from safetensors.numpy import load as parse_tensors
from safetensors.numpy import save as save_tensors

import dockctl
from dockctl import plugins
from dockctl.agents.algorithms import AlgorithmSpec
from dockctl.agents.interface import Policy, Spaces, Tensors
from dockctl.errors import Code, DockctlError, UnknownNameError, nearest
from dockctl.plugins import ALGORITHMS, Guard
from dockctl.reading import read_bytes, read_json
from dockctl.run_files import BEST, LAST, POLICY, POLICY_JSON, POLICY_TENSORS
from dockctl.runs.directory import RunDirectory, named_checkpoints
from dockctl.runs.files import write_atomically, write_json
from dockctl.scenarios.base import Model, Name
from dockctl.scenarios.schema import PolicyInterface
from dockctl.trust import require, text_digest

FORMAT = 2
"""Version of the file format; in version 1 the JSON file has no hash of its own."""
COPIES = 4
"""Maximum number of copies of the tensors in memory while a checkpoint is loaded."""
READS = 3
"""Attempts to read a policy that seems damaged: a training run may have replaced it during the first read."""
MAX_SIZE = 1_000_000
"""Maximum size of observations and actions: a larger one is a mistake or an attempt to exhaust memory."""
FOREIGN = (
    *(ArithmeticError, AssertionError, AttributeError, LookupError, MemoryError),
    *(OSError, RuntimeError, TypeError, ValueError),
)
"""Exceptions that building a policy raises for invalid metadata or tensors."""
log = logging.getLogger(__name__)


class CheckpointError(DockctlError):
    """A checkpoint that is missing, damaged, or incompatible."""

    code: Code = "not_readable"


Size = Annotated[int, Strict(), Field(ge=1, le=MAX_SIZE)]
NotNegative = Annotated[int, Strict(), Field(ge=0)]


class PolicyCard(Model):
    """What a policy is and how it was trained.

    Attributes:
        scenario: name of the scenario that it was trained on.
        observation_size: length of an observation.
        actions: number of discrete actions, or length of a continuous action vector.
        hidden_sizes: ``training.hidden_sizes``.
        env_steps: environment steps of its training, summed over all boats.
        seed: of its training.
        interface: its observation and actions; None in cards from early versions.
        algorithm: ``training.algorithm``, which rebuilds the policy.
        action_bounds: lowest and highest continuous action; None for discrete ones.
        sha256: hash of its tensor file; empty before it is saved.
    """

    model_config = ConfigDict(extra="ignore")

    scenario: Name
    observation_size: Size
    actions: Size
    hidden_sizes: tuple[Size, ...] = Field(default=(), max_length=16)
    env_steps: NotNegative
    seed: NotNegative
    interface: PolicyInterface | None = None
    algorithm: dict[str, Any] = {"kind": "dqn"}
    action_bounds: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    sha256: str = ""

    @classmethod
    def for_spaces(cls, spaces: Spaces, **fields: Any) -> Self:
        """Return the card of a new policy for these spaces and with these other fields.

        Raises:
            CheckpointError: observations are not vectors, or actions are neither discrete from 0 nor vectors
                of float32.
        """
        observation, action = spaces
        if isinstance(observation, Box) and len(observation.shape) == 1:
            fields |= {"observation_size": observation.shape[0], "env_steps": 0}
            if isinstance(action, Discrete) and action.start == 0:
                return cls(**fields, actions=int(action.n))
            if isinstance(action, Box) and len(action.shape) == 1 and action.dtype == np.float32:
                low, high = (tuple(bound.tolist()) for bound in (action.low, action.high))
                return cls(**fields, actions=len(low), action_bounds=(low, high))
        raise CheckpointError(
            "checkpoints need vector observations, and actions that are discrete from 0 or vectors"
            f" of float32; the observations are {_line(observation)}, the actions {_line(action)}"
        )

    @property
    def spaces(self) -> Spaces:
        observation = Box(-np.inf, np.inf, (self.observation_size,), np.float32)
        if self.action_bounds is None:
            return Spaces(observation, Discrete(self.actions))
        low, high = self.action_bounds
        return Spaces(observation, Box(np.array(low, np.float32), np.array(high, np.float32)))


def _line(space: Space[Any]) -> str:
    return " ".join(str(space).split())


def save_pair(folder: Path, name: str, tensors: Tensors, facts: Mapping[str, Any]) -> None:
    """Write ``<name>.safetensors``, and ``<name>.json`` with the metadata and the hashes of both files.

    Raises:
        DockctlError: a file cannot be written.
    """
    content = save_tensors({key: np.array(value, order="C") for key, value in tensors.items()})
    write_atomically(folder / f"{name}.safetensors", content)
    card = {
        "format": FORMAT,
        "dockctl": dockctl.__version__,
        **facts,
        "sha256": hashlib.sha256(content).hexdigest(),
    }
    write_json(folder / f"{name}.json", {**card, "facts_sha256": _facts_hash(card)})


def _facts_hash(facts: Mapping[str, Any]) -> str:
    """Return the hash of JSON metadata, independent of formatting and key order."""
    written = json.loads(json.dumps({key: facts[key] for key in facts if key != "facts_sha256"}))
    return hashlib.sha256(json.dumps(written, sort_keys=True).encode()).hexdigest()


def load_pair(facts_file: Path) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Read what `save_pair` wrote, by the path of its JSON file.

    Raises:
        CheckpointError: a file is missing, damaged, or in another format.
    """
    tensors_file = facts_file.with_suffix(".safetensors")
    for file in (facts_file, tensors_file):
        if not os.path.isfile(file):
            raise CheckpointError(
                f"{file}: no such file; a checkpoint is a .safetensors and a .json file with the same name",
                code="not_found",
            )
    try:
        facts = read_json(facts_file)
    except DockctlError as error:
        raise CheckpointError(error.message, code=error.code) from None
    if not isinstance(facts, dict) or facts.get("format") not in (1, FORMAT):
        raise CheckpointError(f"{facts_file}: not a checkpoint of format 1 or {FORMAT}")
    if facts["format"] == FORMAT and facts.get("facts_sha256") != _facts_hash(facts):
        raise CheckpointError(f"{facts_file}: damaged or changed: its content does not match its hash")
    tensors, digest = load_tensors(tensors_file)
    if digest != facts.get("sha256"):
        raise CheckpointError(
            f"{tensors_file}: damaged or incomplete: its hash is not the one in {facts_file.name}"
        )
    return tensors, facts


def load_tensors(file: Path) -> tuple[dict[str, NDArray[Any]], str]:
    """Return the tensors of a file, and the hash of the file.

    Raises:
        CheckpointError: it is missing or damaged.
    """
    try:
        content = read_bytes(file, psutil.virtual_memory().available // COPIES)
        return parse_tensors(content), hashlib.sha256(content).hexdigest()
    except DockctlError as error:
        raise CheckpointError(error.message, code=error.code) from None
    except KeyError as error:
        raise CheckpointError(f"{file}: has numbers of type {error}, which NumPy does not support") from None
    except (SafetensorError, *FOREIGN) as error:
        message = f"{file}: damaged or incomplete: {type(error).__name__}: {error}"
        raise CheckpointError(message) from None


def save_policy(folder: Path, tensors: Tensors, card: PolicyCard) -> None:
    """Write a policy's tensors and its card into `folder`."""
    save_pair(folder, POLICY, tensors, card.model_dump(mode="json"))


def load_policy(path: str | Path) -> tuple[Policy, PolicyCard]:
    """Load a policy from a run folder, a checkpoint folder or file, or by name (`named_checkpoints`).

    Raises:
        CheckpointError: there is none, or it is damaged.
        DockctlError: the library that it was trained with is missing.
    """
    return rebuild_policy(*read_policy(Path(path)))


def read_policy(path: Path) -> tuple[Path, dict[str, NDArray[Any]], dict[str, Any]]:
    """Return the JSON file of the policy at `path` (see `find_policy`), its tensors and its metadata.

    Raises:
        CheckpointError: there is none, or it is damaged.
    """
    for _ in range(READS - 1):
        with suppress(CheckpointError):
            file = find_policy(path)
            return file, *load_pair(file)
    file = find_policy(path)
    return file, *load_pair(file)


def rebuild_policy(
    file: Path, tensors: Tensors, facts: Mapping[str, Any], *, trust: bool = False
) -> tuple[Policy, PolicyCard]:
    """Rebuild a policy from what `load_pair` read from `file`.

    Raises:
        CheckpointError: it is not a policy; with the code ``unknown_name``, it is from a plugin that is not
            loaded.
        UntrustedError: it needs a module that may not be imported.
        PluginError: the algorithm is from a plugin, which failed.
        DockctlError: the library that it was trained with is missing.
    """
    try:
        for name, array in tensors.items():
            if not np.isfinite(array).all():
                raise ValueError(f"the weights '{name}' contain NaN or infinity")
        card = PolicyCard.model_validate(facts)
        plugins.discover()
        kind = str(card.algorithm["kind"])
        spec = ALGORITHMS.get(kind).value.model_validate(card.algorithm)
        require_imports(spec, trust=trust)
        with Guard(ALGORITHMS, kind):
            policy: Policy = spec.load_policy(tensors, card.spaces, card.hidden_sizes)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(map(str, first["loc"]))
        code = getattr(first.get("ctx", {}).get("error"), "code", None)
        message = f"{file}: does not describe a policy: {field}: {first['msg']}"
        raise CheckpointError(message, code="unknown_name" if code == "unknown_name" else None) from None
    except UnknownNameError as error:
        raise CheckpointError(f"{file}: does not describe a policy: {error}", code=error.code) from None
    except FOREIGN as error:
        reason = " ".join(str(error).split())
        raise CheckpointError(f"{file}: does not describe a policy: {reason}") from None
    return policy, card


def require_imports(spec: AlgorithmSpec, *, trust: bool) -> None:
    """Check that the modules that an algorithm from a received file imports by name may run.

    Raises:
        UntrustedError: one may not.
    """
    require(((f"module '{module}'", text_digest(module), "") for module in spec.imports), trust=trust)


def flatten(groups: Mapping[str, Tensors], separator: str = ".") -> dict[str, NDArray[Any]]:
    """Return the tensors of all groups, named ``<group><separator><name>``."""
    return {
        f"{group}{separator}{name}": array
        for group, tensors in groups.items()
        for name, array in tensors.items()
    }


def nest(tensors: Tensors, separator: str = ".") -> Mapping[str, dict[str, NDArray[Any]]]:
    """Return the groups that `flatten` joined; a missing group reads as empty."""
    groups: dict[str, dict[str, NDArray[Any]]] = defaultdict(dict)
    for name, array in tensors.items():
        group, _, rest = name.partition(separator)
        groups[group][rest] = array
    return groups


def find_policy(path: Path) -> Path:
    """Return the JSON file of the policy at `path`; for a run folder, of the best policy, else of the last.

    Existing files take precedence over a checkpoint of the same name (`named_checkpoints`). If one in
    a run folder is damaged, the previous one is used, with a warning.

    Raises:
        CheckpointError: there is none.
    """
    names = named_checkpoints()
    if not os.path.exists(path) and str(path) in names:
        path = names[str(path)]
    if not os.path.exists(path):
        listed = ", ".join(names) or "none"
        message = f"{path}: no such run folder or checkpoint of a trained policy (known: {listed})"
        raise CheckpointError(message, code="not_found", suggestion=nearest(str(path), names))
    if os.path.isfile(path):
        if path.suffix not in (".json", ".safetensors"):
            raise CheckpointError(
                f"{path}: not a checkpoint: expected a folder, a .safetensors or a .json file"
            )
        return path.with_suffix(".json")
    for saved in ([path], *map(RunDirectory(path).checkpoints, (BEST, LAST))):
        files = (folder / name for folder in saved[:1] for name in (POLICY_JSON, POLICY_TENSORS))
        if any(map(os.path.isfile, files)):
            return _intact([folder / POLICY_JSON for folder in saved])
    also = f"; the checkpoint '{path}' is in {names[str(path)]}" if str(path) in names else ""
    message = f"{path}: contains no checkpoint; a run has one after its first validation{also}"
    raise CheckpointError(message, code="not_found")


def saved_steps(folder: Path) -> int:
    """Return the environment steps of the policy in a checkpoint; 0 if it is damaged."""
    try:
        return int(load_pair(folder / POLICY_JSON)[1]["env_steps"])
    except (CheckpointError, KeyError, TypeError, ValueError):
        return 0


def _intact(files: Sequence[Path]) -> Path:
    """Return the first checkpoint that is not damaged; if all are, the first, whose error is reported."""
    for file in files:
        try:
            load_pair(file)
        except CheckpointError as error:
            damage = error
            continue
        if file != files[0]:
            log.warning("%s; %s is used instead", damage, file.parent)
        return file
    return files[0]


def require_spaces(card: PolicyCard, spaces: Spaces, *, where: Path, scenario: str) -> None:
    """Check that a policy fits the spaces of one boat of a scenario.

    Raises:
        CheckpointError: its observation length or its actions differ.
    """
    for what, trained, given in (
        ("observations of length", card.observation_size, (spaces.observation.shape or (0,))[0]),
        ("actions", card.spaces.action, spaces.action),
    ):
        if trained != given:
            raise CheckpointError(
                f"{where}: trained on '{card.scenario}' with {what} {trained}, but '{scenario}' has {given}",
                code="mismatch",
            )
