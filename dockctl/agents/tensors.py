"""Torch parameters and optimizers as arrays, and torch devices."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from numpy.typing import NDArray

from dockctl.agents.interface import Tensors
from dockctl.errors import DockctlError


def numpy_tensors(tensors: Mapping[str, torch.Tensor]) -> dict[str, NDArray[Any]]:
    """Copy named tensors into arrays."""
    return {name: tensor.detach().cpu().numpy().copy() for name, tensor in tensors.items()}


def load_parameters(network: torch.nn.Module, tensors: Tensors) -> None:
    """Copy named arrays into the parameters of `network`.

    Raises:
        RuntimeError: a parameter is missing, has the wrong shape, or does not belong to the network.
    """
    network.load_state_dict({name: torch.from_numpy(array) for name, array in tensors.items()})


def optimizer_tensors(optimizer: torch.optim.Optimizer) -> dict[str, NDArray[Any]]:
    """Return the optimizer's moments as arrays named ``<number of the parameter>.<moment>``."""
    state = optimizer.state_dict()["state"]
    named = {f"{i}.{key}": value for i, moments in state.items() for key, value in moments.items()}
    return numpy_tensors(named)


def load_optimizer(optimizer: torch.optim.Optimizer, tensors: Tensors) -> None:
    """Continue with the moments that `optimizer_tensors` returned.

    Raises:
        ValueError: a moment differs from its parameter in shape or type.
    """
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    state: dict[int, dict[str, torch.Tensor]] = {}
    for name, array in tensors.items():
        number, key = name.split(".")
        parameter, moment = parameters[int(number)], torch.from_numpy(array)
        if (moment.dtype, moment.shape) != (parameter.dtype, () if key == "step" else parameter.shape):
            raise ValueError(f"the moment '{name}' does not match its parameter")  # torch does not check
        state.setdefault(int(number), {})[key] = moment
    optimizer.load_state_dict({**optimizer.state_dict(), "state": state})


def torch_device(name: str) -> torch.device:
    """Return the torch device `name`, for example ``cpu`` or ``cuda``.

    Raises:
        DockctlError: the device is not available.
    """
    try:
        device = torch.device(name)
        torch.zeros(1, device=device).cpu()  # fails for `meta`, which has no data
    except (RuntimeError, AssertionError):  # without CUDA support torch raises AssertionError
        message = f"device '{name}' cannot be used; this machine has {', '.join(devices())}"
        raise DockctlError(message, code="unavailable") from None
    return device


def devices() -> list[str]:
    """Return the torch devices of this machine; GPUs with their names."""
    gpus = [f"cuda:{i} ({torch.cuda.get_device_name(i)})" for i in range(torch.cuda.device_count())]
    return ["cpu", *gpus, *(["mps"] if torch.backends.mps.is_available() else [])]
