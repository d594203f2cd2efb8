"""Read a policy exported by ``dockctl export --pilot`` or ``--onnx``, with NumPy alone.

A file contains the networks and their description as JSON (docs/deployment.md). A model of ``--onnx`` needs
ONNX Runtime.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dockctl.dueling import Ensemble
from dockctl.errors import DockctlError
from dockctl.onnx_networks import DESCRIPTION, OnnxNetworks, description, open_session
from dockctl.reading import FOREIGN, parse_json, read_bytes

FORMAT = 1
MAX_FILE_BYTES = 2**31
"""Exceptions caused by a description that is incomplete or inconsistent."""


class Networks(Protocol):
    """Computes action values: an `Ensemble`, or an ONNX model."""

    @property
    def sizes(self) -> tuple[int, int]:
        """Length of an observation, and number of actions."""

    def q_values(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the action values (n, actions) of observations (n, observation_size)."""

    def greedy(self, observation: NDArray[np.float32], q_values: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return the actions (n,) of observations and their action values."""


def read_policy_file(file: Path) -> tuple[dict[str, Any], Networks]:
    """Return the description of the policy in a file, and its networks.

    Raises:
        DockctlError: the file is missing, damaged, or of another kind; ONNX Runtime is not installed.
    """
    option, read = ("--onnx", _onnx_model) if file.suffix == ".onnx" else ("--pilot", _ensemble)
    try:
        text, networks_of = read(read_bytes(file, MAX_FILE_BYTES))
    except ImportError:
        message = f"{file}: needs ONNX Runtime; install it with: pip install onnxruntime"
        raise DockctlError(message, code="unavailable") from None
    except (*FOREIGN, MemoryError, RuntimeError, zipfile.BadZipFile) as error:
        message = f"{file}: not a file of 'dockctl export {option}', or damaged: {error}"
        raise DockctlError(message, code="not_readable") from None
    try:
        facts = parse_json(text)
        if facts["format"] != FORMAT:
            raise ValueError(f"format {facts['format']}, expected {FORMAT}")
        networks = networks_of(facts)
        described = len(facts["observation"]), len(facts["commands"])
        if networks.sizes != described:
            raise ValueError(f"the network has sizes {networks.sizes}, its description {described}")
    except FOREIGN as error:
        raise not_a_policy(file, error) from None
    return facts, networks


def not_a_policy(file: str | Path, error: Exception) -> DockctlError:
    """Return the error for a description that raised one of `FOREIGN`."""
    message = f"{file}: does not describe a policy: {type(error).__name__}: {error}"
    return DockctlError(message, code="not_readable")


NetworksOf = Callable[[Mapping[str, Any]], Networks]
"""Creates the networks of a file from its description."""


def _ensemble(content: bytes) -> tuple[str, NetworksOf]:
    """Return the description in a file of ``--pilot``, and a function that creates its networks."""
    arrays = _arrays(content)
    text = str(arrays.pop(DESCRIPTION))

    def networks(_: Mapping[str, Any]) -> Ensemble:
        if not all(np.isfinite(array).all() for array in arrays.values()):
            raise ValueError("the weights contain NaN or infinity")
        return Ensemble.of(arrays)

    return text, networks


def _onnx_model(content: bytes) -> tuple[str, NetworksOf]:
    """Return the description in a file of ``--onnx``, and a function that creates its networks."""
    session = open_session(content)
    return description(session), partial(OnnxNetworks, session)


def _arrays(content: bytes) -> dict[str, NDArray[Any]]:
    """Return the arrays of an uncompressed .npz file, which takes no more memory than its bytes."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        if sum(member.file_size for member in archive.infolist()) > len(content):
            raise ValueError("it is compressed")
    with np.load(io.BytesIO(content)) as file:
        return {name: file[name] for name in file.files}
