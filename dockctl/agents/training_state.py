"""The training state on disk: a save writes what has changed, a resume reads the newest intact state.

Large tensors, such as the replay buffer, are split into blocks of rows. A block is a file named by the hash
of its rows, so a save writes only the blocks that are new, and the checkpoints share the others.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pydantic.dataclasses
from numpy.typing import NDArray
from pydantic import NonNegativeInt
from safetensors.numpy import save as save_tensors

from dockctl.agents.checkpoint import (
    FORMAT,
    CheckpointError,
    PolicyCard,
    load_pair,
    load_tensors,
    save_pair,
    save_policy,
)
from dockctl.agents.interface import Tensors
from dockctl.errors import DockctlError
from dockctl.reading import read_json
from dockctl.run_files import BLOCKS, CHECKPOINTS, LAST, LEARNER, LEARNER_JSON, POLICY, POLICY_JSON
from dockctl.runs.directory import RunDirectory
from dockctl.runs.files import make_folder, write_atomically, writing

BLOCK_BYTES = 2**22
"""Size of a block; smaller tensors are not split."""


@dataclass(frozen=True, eq=False)
class TrainingState:
    """What `save_state` was given.

    Attributes:
        damaged: why newer checkpoints of the run could not be used, one message for each.
    """

    folder: Path
    policy: Tensors
    tensors: Tensors
    facts: Mapping[str, Any]
    damaged: tuple[str, ...]

    @property
    def env_steps(self) -> int:
        """Environment steps at the save.

        Raises:
            CheckpointError: they are missing.
        """
        try:
            return int(self.facts["progress"]["env_steps"])
        except (LookupError, TypeError, ValueError):
            raise CheckpointError(f"{self.folder}: cannot be resumed: it has no step count") from None

    @property
    def blocks(self) -> set[str]:
        """Names of the blocks that were read."""
        return _names(self.facts, self.folder / LEARNER_JSON)


def save_state(
    run: RunDirectory,
    policy: Tensors,
    card: PolicyCard,
    tensors: Tensors,
    facts: Mapping[str, Any],
    intact: Collection[str],
) -> set[str]:
    """Save the state as the newest checkpoint `LAST`, and return the names of its blocks.

    Args:
        policy: parameters of the policy.
        tensors: everything else.
        facts: values for JSON.
        intact: names of blocks that this process has read or written, which are not written again. Other
            blocks on disk may be damaged.

    Raises:
        DockctlError: a file cannot be written.
    """
    large = {name: tensor for name, tensor in tensors.items() if tensor.nbytes > BLOCK_BYTES}
    blocks = {
        name: [_save_block(run, rows, intact) for rows in _split(tensor)] for name, tensor in large.items()
    }
    small = {name: tensor for name, tensor in tensors.items() if name not in large}
    with run.new_checkpoint(LAST) as folder:
        save_policy(folder, policy, card)
        of_policy = read_json(folder / POLICY_JSON)["facts_sha256"]
        save_pair(folder, LEARNER, small, {**facts, "blocks": blocks, "policy_facts_sha256": of_policy})
    for file in unused_blocks(run, run.checkpoints(LAST)):
        with suppress(OSError):  # an unused block only takes space
            file.unlink()
    return {name for names in blocks.values() for name in names}


def load_state(run: RunDirectory) -> TrainingState:
    """Load the newest intact checkpoint `LAST`.

    Raises:
        CheckpointError: there is none.
    """
    damaged: dict[str, CheckpointError] = {}  # by text: checkpoints may share a damaged block
    for folder in run.checkpoints(LAST) or [run.checkpoint(LAST)]:
        try:
            policy, card = load_pair(folder / POLICY_JSON)
            tensors, facts = load_pair(folder / LEARNER_JSON)
            if facts["format"] != FORMAT:
                message = f"{folder}: saved by an earlier version, without all that resuming needs"
                raise CheckpointError(message)
            of_policy = card.get("facts_sha256")
            if facts.get("policy_facts_sha256", of_policy) != of_policy:
                raise CheckpointError(f"{folder}: {POLICY} and {LEARNER} are from different saves")
            blocks = _blocks(facts, folder / LEARNER_JSON)
            _require_memory(run, blocks, folder / LEARNER_JSON)
            tensors |= {name: _load_blocks(run, names) for name, names in blocks.items()}
        except CheckpointError as error:
            damaged[str(error)] = error
        else:
            return TrainingState(folder, policy, tensors, facts, tuple(damaged))
    raise CheckpointError("\n".join(damaged), code=next(iter(damaged.values())).code)


def _split(tensor: NDArray[Any]) -> Iterator[NDArray[Any]]:
    rows = max(1, BLOCK_BYTES // (tensor.nbytes // len(tensor)))
    return (tensor[first : first + rows] for first in range(0, len(tensor), rows))


@pydantic.dataclasses.dataclass
class _SavedTable:
    """What `dockctl.runs.tables.Table.save` returns."""

    lines: NonNegativeInt
    bytes: NonNegativeInt
    sha256: str


def checked_table(saved: Any) -> dict[str, Any] | None:
    """Return the result of `Table.save` from a file; None in checkpoints from early versions.

    Raises:
        TypeError, ValueError: it is not such a result.
    """
    return None if saved is None else asdict(_SavedTable(**saved))


def _save_block(run: RunDirectory, rows: NDArray[Any], intact: Collection[str]) -> str:
    """Write a block unless it exists and is intact, and return its name."""
    name = _name(rows)
    file = _block_file(run, name)
    if name not in intact or not os.path.exists(file):
        with writing(file):
            make_folder(file.parent)
        write_atomically(file, save_tensors({"rows": np.ascontiguousarray(rows)}))
    return name


def _name(rows: NDArray[Any]) -> str:
    """Return the hash of an array, by which an unchanged block is recognized."""
    digest = hashlib.sha256(f"{rows.dtype.str} {rows.shape}".encode())
    digest.update(np.ascontiguousarray(rows).view(np.uint8).reshape(-1).data)
    return digest.hexdigest()


def _require_memory(run: RunDirectory, blocks: Mapping[str, list[str]], file: Path) -> None:
    """Check that the blocks that a file lists, repeats included, fit into memory.

    Raises:
        CheckpointError: they do not.
    """
    listed = Counter(_block_file(run, name) for names in blocks.values() for name in names)
    total = sum(times * path.stat().st_size for path, times in listed.items() if path.is_file())
    if total > psutil.virtual_memory().available / 2:
        message = f"{file}: lists blocks of {total / 1e9:.1f} GB in total, too large for the available memory"
        raise CheckpointError(message, code="out_of_range")


def _load_blocks(run: RunDirectory, names: list[str]) -> NDArray[Any]:
    """Return the tensor that was split into these blocks.

    Raises:
        CheckpointError: a block is missing or damaged.
    """
    rows: list[NDArray[Any]] = []
    for name in names:
        tensors, _ = load_tensors(_block_file(run, name))
        if [_name(tensor) for tensor in tensors.values()] != [name]:
            raise CheckpointError(f"{_block_file(run, name)}: damaged: its hash is not its name")
        rows += tensors.values()
    try:
        return np.concatenate(rows)
    except ValueError as error:
        raise CheckpointError(f"{_block_file(run, names[0])}: the blocks do not match: {error}") from None


def _blocks(facts: Mapping[str, Any], file: Path) -> dict[str, list[str]]:
    """Return the names of the blocks of each large tensor, from the content of a file.

    Raises:
        CheckpointError: they are not hashes.
    """
    with suppress(AttributeError, TypeError):  # not a dictionary of lists of strings
        blocks: dict[str, list[str]] = facts.get("blocks", {})
        if all(
            names and all(re.fullmatch("[0-9a-f]{64}", name) for name in names) for names in blocks.values()
        ):
            return blocks
    raise CheckpointError(f"{file}: 'blocks' must list hashes")


def _names(facts: Mapping[str, Any], file: Path) -> set[str]:
    """Return the names of all blocks, from the content of a file.

    Raises:
        CheckpointError: they are not hashes.
    """
    return {name for names in _blocks(facts, file).values() for name in names}


def _block_file(run: RunDirectory, name: str) -> Path:
    return run.path / CHECKPOINTS / BLOCKS / f"{name}.safetensors"


def unused_blocks(run: RunDirectory, folders: Iterable[Path]) -> list[Path]:
    """Return the block files that no checkpoint in `folders` lists."""
    used: set[str] = set()
    for folder in folders:
        file = folder / LEARNER_JSON
        with suppress(DockctlError):
            used |= _names(read_json(file), file)
    return [file for file in (run.path / CHECKPOINTS / BLOCKS).glob("*") if file.stem not in used]
