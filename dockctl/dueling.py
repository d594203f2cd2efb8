"""The dueling network (thesis section 3.2.5, Fig. 3.12; eq. 2.56) with NumPy alone, from its tensors.

`dockctl.agents.dqn.network` defines it in torch, for training. Running it needs no torch, which is slow to
import.

A policy can be an ensemble of such networks. Then the names of their tensors start with the number of the
network. Tensors named ``mirror.<name>`` define how observations and actions are mirrored, and tensors named
``hysteresis.<name>`` define how the last action is kept.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Tensors = Mapping[str, NDArray[Any]]
Layer = tuple[NDArray[Any], NDArray[Any]]


LEAST_UNITS = 32
"""Minimum width of the advantage stream's hidden layer: if it has only two or three units, all can die."""
SAME_COMMAND = 1e-4
"""Observed commands that differ by less are equal."""


def advantage_units(actions: int) -> int:
    """Return the width of the advantage hidden layer: `actions` (thesis Fig. 3.12) or more."""
    return max(actions, LEAST_UNITS)


def shapes(observation_size: int, actions: int, hidden_sizes: Sequence[int]) -> dict[str, tuple[int, ...]]:
    """Return the shapes of all tensors of a network by name, as in a checkpoint."""
    width = hidden_sizes[-1]
    streams = {
        "shared": (observation_size, *hidden_sizes),
        "value": (width, width, 1),
        "advantage": (width, advantage_units(actions), actions),
    }
    return {
        f"{stream}.{2 * number}.{name}": shape  # every second module is an activation
        for stream, sizes in streams.items()
        for number, (inputs, outputs) in enumerate(pairwise(sizes))
        for name, shape in (("weight", (outputs, inputs)), ("bias", (outputs,)))
    }


def network_size(observation_size: int, actions: int, hidden_sizes: Sequence[int]) -> tuple[int, int]:
    """Return the numbers of parameters and of layer outputs of a network."""
    found = shapes(observation_size, actions, hidden_sizes).values()
    return sum(map(math.prod, found)), sum(shape[0] for shape in found if len(shape) == 1)


class Mirror(NamedTuple):
    """Mirror images of observations and actions, in which port and starboard are swapped.

    Attributes:
        columns, signs: (observation_size,) see `observations`.
        actions: (actions,) index of the image of each action.
    """

    columns: NDArray[np.int64]
    signs: NDArray[np.float32]
    actions: NDArray[np.int64]

    def observations(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the images of observations (n, observation_size)."""
        return observation[:, self.columns] * self.signs


class Hysteresis(NamedTuple):
    """Keeps the last action until the value of another action is higher by a margin.

    Attributes:
        columns: (2,) columns of the last command in an observation.
        commands: (actions, 2) the command of each action, as observed.
        margin: (actions,) amount added to the value of an action if it was the last one.
    """

    columns: NDArray[np.int64]
    commands: NDArray[np.float32]
    margin: NDArray[np.float32]

    def bonus(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return what to add to the action values (n, actions) of observations (n, observation_size)."""
        last = observation[:, None, self.columns]
        return np.where(np.abs(last - self.commands).max(axis=2) < SAME_COMMAND, self.margin, np.float32(0))


class Layers(NamedTuple):
    """Weights (outputs, inputs) and biases of a dueling network: shared layers and the two streams."""

    shared: list[Layer]
    value: list[Layer]
    advantage: list[Layer]

    @classmethod
    def of(cls, tensors: Tensors) -> Layers:
        """Return the layers from the tensors of a checkpoint.

        Raises:
            ValueError: the tensors are not those of a dueling network.
        """
        kinds = {str(array.dtype) for array in tensors.values() if array.dtype.kind != "f"}
        if kinds:
            raise ValueError(f"weights of {', '.join(sorted(kinds))}, expected floating-point numbers")
        own = {name: np.asarray(array, np.float32) for name, array in tensors.items()}
        streams: list[list[Layer]] = []
        for name in cls._fields:
            found = {key for key in tensors if key.startswith(f"{name}.")}
            numbers = range(0, len(found), 2)  # every second module is an activation
            streams.append([(own[f"{name}.{i}.weight"], own[f"{name}.{i}.bias"]) for i in numbers])
        layers = cls(*streams)
        if sum(2 * len(stream) for stream in layers) != len(tensors) or not all(layers):
            raise ValueError("expected the tensors of a dueling network: shared, value and advantage")
        width = len(layers.shared[-1][1])
        for inputs, stream in ((None, layers.shared), (width, layers.value), (width, layers.advantage)):
            sizes = [inputs or stream[0][0].shape[1], *(len(bias) for _, bias in stream)]
            shapes = [weight.shape for weight, _ in stream]
            if shapes != [(outputs, inputs) for inputs, outputs in pairwise(sizes)]:
                raise ValueError(f"the layers of shapes {shapes} do not match each other")
        if len(layers.value[-1][1]) != 1:
            raise ValueError("the value stream has more than one output")
        return layers

    @property
    def sizes(self) -> tuple[int, int]:
        """Length of an observation, and number of actions."""
        return self.shared[0][0].shape[1], len(self.advantage[-1][1])

    def q_values(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the action values (n, actions) of observations (n, k), ``V + A - mean A`` (eq. 2.56)."""
        features = _forward(self.shared, observation, activate_last=True)
        value, advantage = (_forward(stream, features) for stream in (self.value, self.advantage))
        return np.asarray(value + advantage - advantage.mean(axis=1, keepdims=True))


class Ensemble(NamedTuple):
    """Networks whose mean Q-values are used; with a mirror, the mean includes mirrored observations.

    Attributes:
        networks: newest first.
    """

    networks: tuple[Layers, ...]
    mirror: Mirror | None
    hysteresis: Hysteresis | None = None

    @classmethod
    def of(cls, tensors: Tensors) -> Ensemble:
        """Return the networks, possibly only one, from the tensors of a checkpoint.

        Raises:
            KeyError, ValueError: the tensors are not those of dueling networks of the same size.
        """
        parts, mirror, hysteresis = split(tensors)
        ensemble = cls(tuple(map(Layers.of, parts)), mirror, hysteresis)
        if len({network.sizes for network in ensemble.networks}) != 1:
            raise ValueError("expected one network, or several of the same size")
        inputs, actions = ensemble.sizes
        if mirror is not None:
            for images, count in ((mirror.columns, inputs), (mirror.actions, actions)):
                if images.dtype.kind != "i" or sorted(images.tolist()) != list(range(count)):
                    raise ValueError(f"the mirror images {images} are not a permutation of {count} numbers")
            if mirror.signs.shape != (inputs,):
                raise ValueError(f"signs of shape {mirror.signs.shape} for {inputs} inputs")
        if hysteresis is not None:
            given = tuple(array.shape for array in hysteresis)
            if given != (expected := ((2,), (actions, 2), (actions,))):
                raise ValueError(f"the hysteresis has shapes {given}, expected {expected}")
            columns = hysteresis.columns
            if columns.dtype.kind != "i" or not 0 <= columns.min() <= columns.max() < inputs:
                raise ValueError(f"the hysteresis reads the columns {columns} of {inputs}")
        return ensemble

    @property
    def sizes(self) -> tuple[int, int]:
        """Length of an observation, and number of actions."""
        return self.networks[0].sizes

    def q_values(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the action values (n, actions) of observations (n, k)."""
        values = [network.q_values(observation) for network in self.networks]
        if self.mirror is not None:
            images = self.mirror.observations(observation)
            values += [network.q_values(images)[:, self.mirror.actions] for network in self.networks]
        return np.asarray(sum(values[1:], values[0]) / np.float32(len(values)))

    def greedy(self, observation: NDArray[np.float32], q_values: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return the actions (n,) for observations (n, k) and their values (n, actions)."""
        if self.hysteresis is not None:
            q_values = q_values + self.hysteresis.bonus(observation)
        actions: NDArray[np.int64] = q_values.argmax(axis=1)
        return actions


def split(tensors: Tensors) -> tuple[list[Tensors], Mirror | None, Hysteresis | None]:
    """Return the tensors of each network of a checkpoint, newest first; mirror and hysteresis, if any.

    Raises:
        ValueError: the arrays of the mirror or the hysteresis are not the expected ones.
    """
    groups: dict[str, dict[str, NDArray[Any]]] = {}
    for name, array in tensors.items():
        group, _, rest = name.partition(".")
        groups.setdefault(group, {})[rest] = array
    images, keeping = _extra(groups, "mirror", Mirror), _extra(groups, "hysteresis", Hysteresis)
    mirror = None if images is None else Mirror(**images)
    hysteresis = None if keeping is None else Hysteresis(**keeping)
    numbered: list[Tensors] = [groups[name] for name in map(str, range(len(groups))) if name in groups]
    return (numbered if len(numbered) == len(groups) else [tensors]), mirror, hysteresis


def _extra(
    groups: dict[str, dict[str, NDArray[Any]]], name: str, kind: type[Mirror | Hysteresis]
) -> dict[str, NDArray[Any]] | None:
    """Remove and return the arrays of a mirror or of hysteresis, if there are any."""
    arrays = groups.pop(name, None)
    if arrays is not None and arrays.keys() != {*kind._fields}:
        raise ValueError(f"the {name} has the arrays {', '.join(arrays)}, not {', '.join(kind._fields)}")
    return arrays


def join(
    networks: Sequence[Tensors], mirror: Mirror | None = None, hysteresis: Hysteresis | None = None
) -> Tensors:
    """Return the tensors of a checkpoint of these networks, newest first; see `split`."""
    if len(networks) == 1 and mirror is None and hysteresis is None:
        return networks[0]
    groups = {str(number): network for number, network in enumerate(networks)}
    for name, extra in (("mirror", mirror), ("hysteresis", hysteresis)):
        if extra is not None:
            groups[name] = extra._asdict()
    return {f"{group}.{name}": array for group, part in groups.items() for name, array in part.items()}


def _forward(layers: Sequence[Layer], x: NDArray[Any], *, activate_last: bool = False) -> NDArray[Any]:
    for number, (weight, bias) in enumerate(layers, start=1):
        x = x @ weight.T + bias
        if activate_last or number < len(layers):
            x = np.maximum(x, 0)
    return x
