"""What belongs to a policy wherever it sails: what it observes, and what it can do."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, ValidationError

from dockctl.errors import DockctlError
from dockctl.scenarios.base import Count, Model
from dockctl.scenarios.extensions import ActionType
from dockctl.scenarios.schema import ACTION_KINDS, ObservationPart, Scenario


class PolicyInterface(Model):
    """The parts of a policy's observation, into how many sectors its LiDARs' points fall, and its actions."""

    observation: tuple[ObservationPart, ...] = Field(min_length=1)
    lidar_sectors: Count
    actions: Annotated[ActionType, ACTION_KINDS]

    @classmethod
    def of(cls, scenario: Scenario) -> Self:
        """Return the interface of the policies that are trained on `scenario`."""
        return cls(
            observation=scenario.observation,
            lidar_sectors=scenario.sensors.lidar.sectors,
            actions=scenario.actions,
        )

    def on(self, scenario: Scenario) -> Scenario:
        """Return `scenario`, its task, harbor and vessel, as seen and sailed by the policy.

        Raises:
            DockctlError: the vessel has not the power or the rudder for the policy's actions.
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
            raise DockctlError(
                f"a policy cannot sail the vessel of '{scenario.name}' as it learned to: {reasons}"
            ) from None
