"""Where the networks live."""

from __future__ import annotations

import torch

from dockctl.errors import DockctlError


def device_named(name: str) -> torch.device:
    """Return the torch device called `name`, for example ``cpu`` or ``cuda``.

    Raises:
        DockctlError: there is no such device here.
    """
    try:
        device = torch.device(name)
        torch.zeros(1, device=device).cpu()  # there is one that computes nothing, `meta`
    except (RuntimeError, AssertionError) as error:  # torch asserts that it was built with CUDA
        reason = str(error).partition("\n")[0]
        raise DockctlError(f"device '{name}' cannot be used: {reason}", code="unavailable") from None
    return device
