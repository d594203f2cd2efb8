"""Reward terms for the change of the controls from one step to the next."""

from __future__ import annotations

import numpy as np

from dockctl.geometry import Floats
from dockctl.rewards.terms import reward_term
from dockctl.sim.goal import StepStatus


@reward_term("smooth_propeller", kind="dense", source="dockctl-smooth")
def smooth_propeller(status: StepStatus, *, scale_n: float = 100.0) -> Floats:
    """Return the change of the propeller force over `scale_n`, (n,)."""
    return np.abs(status.command[:, 0] - status.previous_command[:, 0]) / scale_n


@reward_term("smooth_rudder", kind="dense", source="dockctl-smooth")
def smooth_rudder(status: StepStatus, *, scale_deg: float = 60.0) -> Floats:
    """Return the change of the rudder angle over `scale_deg`, (n,)."""
    return np.degrees(np.abs(status.command[:, 1] - status.previous_command[:, 1])) / scale_deg
