"""Run a model from ``dockctl export --onnx`` with ONNX Runtime, which is imported when a model is opened.

Such a model takes observations in physical units, scales them, and returns action values and the action. Its
metadata contains the description that `dockctl.pilot` reads.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

DESCRIPTION = "description"
"""Name of the JSON text in the metadata of a model, and among the arrays of a pilot file."""
Q_VALUES, ACTION = "q_values", "action"
"""Names of the outputs."""


def open_session(model: bytes | str) -> Any:
    """Return an ONNX Runtime session for a model, given as content, or as path if it has further files.

    Raises:
        ImportError: ONNX Runtime is not installed.
        ValueError: it is not a model.
    """
    import onnxruntime

    with _errors():
        return onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])


def description(session: Any) -> str:
    """Return the description of a model; empty for a model from another library."""
    text: str = session.get_modelmeta().custom_metadata_map.get(DESCRIPTION, "")
    return text


class OnnxNetworks:
    """The networks in a model, with the interface of `dockctl.dueling.Ensemble`: scaled observations.

    Args:
        session: result of `open_session`.
        facts: its description, which contains the scale of each column.

    Raises:
        ValueError: the model has a different number of observation columns, or different outputs.
    """

    def __init__(self, session: Any, facts: Mapping[str, Any]) -> None:
        self._session = session
        self._scale = np.array([column["scale"] for column in facts["observation"]], float)
        blank = np.zeros((1, len(self._scale)), np.float32)
        with _errors():  # a first run; later inputs have the same shape
            self.sizes = (blank.shape[1], self.q_values(blank).shape[1])
            self.greedy(blank, blank)

    def q_values(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the action values (n, actions) of observations (n, observation_size)."""
        return self._run(Q_VALUES, observation)

    def greedy(self, observation: NDArray[np.float32], q_values: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return the actions (n,) of observations; the model computes the action values itself."""
        return self._run(ACTION, observation)

    def _run(self, output: str, observation: NDArray[np.float32]) -> NDArray[Any]:
        raw = (observation * self._scale).astype(np.float32)
        values: NDArray[Any] = self._session.run([output], {"observation": raw})[0]
        return values


@contextmanager
def _errors() -> Iterator[None]:
    """Raise a ValueError for each exception of ONNX Runtime, which have no common base class."""
    try:
        yield
    except Exception as error:
        raise ValueError(" ".join(str(error).split())) from None
