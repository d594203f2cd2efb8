"""Action types: from the actions of a policy to propeller and rudder commands.

`grid` is the set of discrete commands of the thesis (Table 3.4, Fig. 3.11); `continuous` is a box for
continuous-action learners; `incremental` changes the last command by one step. A scenario selects one with
``actions: {kind: ...}``.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dockctl.geometry import Floats
from dockctl.plugins import ACTIONS
from dockctl.scenarios.base import FieldError, Number, Positive
from dockctl.scenarios.extensions import ActionType, register
from dockctl.scenarios.vessel import Vessel

if TYPE_CHECKING:
    import gymnasium


@register(ACTIONS, source="Table 3.4, Fig. 3.11")
class GridActions(ActionType):
    """Every propeller force with every rudder angle, by default up to the limits of the vessel.

    Action ``i`` is force ``i // len(rudder_deg)`` with angle ``i % len(rudder_deg)``.
    """

    kind: Literal["grid"] = "grid"
    propeller_n: tuple[Number, ...] = Field(default=tuple(range(-50, 51, 10)), min_length=1, max_length=1000)
    rudder_deg: tuple[Number, ...] = Field(default=tuple(range(-30, 31, 10)), min_length=1, max_length=1000)

    @property
    def grid(self) -> dict[str, tuple[float, ...]]:
        return {"propeller_n": self.propeller_n, "rudder_deg": self.rudder_deg}

    def fitted(self, vessel: Vessel) -> ActionType:
        """Scale the default forces and angles to the limits of the vessel."""
        limits = {"propeller_n": vessel.max_propeller_n, "rudder_deg": vessel.max_rudder_deg}
        scaled = {
            name: tuple(np.linspace(-limit, limit, len(getattr(self, name))).tolist())
            for name, limit in limits.items()
            if name not in self.model_fields_set and limit != max(getattr(self, name))
        }
        return self.model_copy(update=scaled)

    def describe(self) -> str:
        forces, angles = self.propeller_n, self.rudder_deg
        return (
            f"{len(forces) * len(angles)} commands: propeller {min(forces):g} to {max(forces):g} N,"
            f" rudder {min(angles):g}° to {max(angles):g}°"
        )

    def space(self, vessel: Vessel) -> gymnasium.Space[Any]:
        from gymnasium.spaces import Discrete

        return Discrete(len(self.propeller_n) * len(self.rudder_deg))

    def commands(self, actions: NDArray[Any], vessel: Vessel) -> Floats:
        table = _table(self.propeller_n, self.rudder_deg)
        return table.take(actions, axis=0)

    def require_within_limits(self, vessel: Vessel) -> None:
        for actuator in ("propeller_n", "rudder_deg"):
            limit = getattr(vessel, f"max_{actuator}")
            if max(map(abs, getattr(self, actuator))) > limit:
                message = f"exceeds the vessel's max_{actuator}, {limit:g}"
                raise FieldError(f"actions.{actuator}", message, "mismatch")


@register(ACTIONS, source="not in the thesis")
class ContinuousActions(ActionType):
    """Propeller force and rudder angle as fractions of the vessel's limits, each from -1 to 1."""

    kind: Literal["continuous"] = "continuous"

    def describe(self) -> str:
        return "propeller force and rudder angle, continuous, as fractions of the vessel's limits"

    def space(self, vessel: Vessel) -> gymnasium.Space[Any]:
        from gymnasium.spaces import Box

        return Box(-1.0, 1.0, (2,), np.float32)

    def commands(self, actions: NDArray[Any], vessel: Vessel) -> Floats:
        limit = vessel.command_limit
        return np.asarray(actions * limit, float)


@register(ACTIONS, source="not in the thesis; its section 5.2 asks for smoother commands")
class IncrementalActions(ActionType):
    """Lower, hold or raise the propeller force and the rudder angle by one step, within the vessel's limits.

    Action ``i`` changes the force by ``i // 3 - 1`` steps and the angle by ``i % 3 - 1``; 4 holds both. The
    observation part `command` shows the command that it changes.
    """

    kind: Literal["incremental"] = "incremental"
    propeller_step_n: Positive = 10.0
    rudder_step_deg: Positive = 10.0

    def describe(self) -> str:
        return (
            f"9 changes of the command: propeller by {self.propeller_step_n:g} N, rudder by"
            f" {self.rudder_step_deg:g}°, or neither"
        )

    def space(self, vessel: Vessel) -> gymnasium.Space[Any]:
        from gymnasium.spaces import Discrete

        return Discrete(9)

    def commands(self, actions: NDArray[Any], vessel: Vessel) -> Floats:
        return self.next_commands(actions, vessel, np.zeros((len(actions), 2)))

    def next_commands(self, actions: NDArray[Any], vessel: Vessel, previous: Floats) -> Floats:
        signs = np.column_stack(np.divmod(actions, 3)) - 1
        limit = vessel.command_limit
        steps = np.array([self.propeller_step_n, np.radians(self.rudder_step_deg)])
        changed: Floats = np.clip(previous + signs * steps, -limit, limit)
        return changed


@lru_cache(maxsize=16)
def _table(propeller_n: tuple[float, ...], rudder_deg: tuple[float, ...]) -> Floats:
    """Return the command (k, 2) [N, rad] of each action; the rudder angle varies fastest."""
    force, rudder = np.meshgrid(propeller_n, np.radians(rudder_deg), indexing="ij")
    table = np.column_stack([force.ravel(), rudder.ravel()])
    table.flags.writeable = False
    return table
