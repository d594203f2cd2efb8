"""The interface of a policy: what it observes, and its actions."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, ValidationError

from dockctl.errors import DockctlError
from dockctl.scenarios.base import Count, Model
from dockctl.scenarios.extensions import ActionType
from dockctl.scenarios.schema import ACTION_KINDS, ObservationPart, Scenario


class PolicyInterface(Model):
    """The parts of a policy's observation, the number of sectors of its range sensor, and its actions."""

    observation: tuple[ObservationPart, ...] = Field(min_length=1)
    lidar_sectors: Count
    actions: Annotated[ActionType, ACTION_KINDS]

    @classmethod
    def of(cls, scenario: Scenario) -> Self:
        """Return the interface of policies trained on `scenario`."""
        return cls(
            observation=scenario.observation,
            lidar_sectors=scenario.sensors.lidar.sectors,
            actions=scenario.actions,
        )

    def on(self, scenario: Scenario) -> Scenario:
        """Return `scenario` with the observation, sectors and actions of the policy.

        Raises:
            DockctlError: the policy's actions exceed the limits of the vessel.
        """
        lidar = scenario.sensors.lidar.model_copy(update={"sectors": self.lidar_sectors})
        changed = {
            "observation": self.observation,
            "actions": self.actions,
            "sensors": scenario.sensors.model_copy(update={"lidar": lidar}),
        }
        try:
            return Scenario.model_validate({**dict(scenario), **changed})
        except ValidationError as error:
            reasons = "; ".join(str(detail.get("ctx", {}).get("error")) for detail in error.errors())
            message = f"the policy's actions exceed the limits of the vessel of '{scenario.name}': {reasons}"
            raise DockctlError(message, code="mismatch") from None
