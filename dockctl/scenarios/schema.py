"""The scenario: the complete input of a run, immutable and validated; and the interface of its policies."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product
from typing import Annotated, Any, ClassVar, Self, TypeVar

from pydantic import Field, ValidationError, model_validator

from dockctl.errors import DockctlError
from dockctl.plugins import ACTIONS, CONDITIONS, RANGE_SENSORS, Guard
from dockctl.registry import Registry
from dockctl.scenarios.base import (
    MAX_COORDINATE_M,
    Count,
    FieldError,
    Model,
    Name,
    NonNegative,
    Number,
    Pose,
    Positive,
    Turn,
)
from dockctl.scenarios.berths import Berths, require_berths
from dockctl.scenarios.extensions import ActionType, Condition, RangeSensorSpec, Sectors
from dockctl.scenarios.harbor import Generated, HarborSpec
from dockctl.scenarios.kinds import Kinds
from dockctl.scenarios.training import Conditions, Evaluation, Training
from dockctl.scenarios.vessel import SCALABLE, Vessel

Part = TypeVar("Part", ActionType, Condition)
TRAINING_CONDITIONS = "training.conditions"
BERTH_MARGIN_M = 1.0
"""Total clearance beside the boat in the narrowest generated berth, and when it turns in a fairway."""


class SpreadPose(Pose):
    """A pose; in training it is drawn within ±position_offset_m in x and y, and ±heading_offset_deg."""

    position_offset_m: Annotated[NonNegative, Field(le=MAX_COORDINATE_M)] = 0.0
    heading_offset_deg: Turn = 0.0


class Tolerance(Model):
    """Limits at which a pose counts as reached. Give the heading in degrees or in radians, not both."""

    distance_m: Positive
    heading_deg: Positive | None = None
    heading_rad: Positive | None = None
    speed_mps: Positive

    @model_validator(mode="after")
    def _one_heading(self) -> Self:
        if (self.heading_deg is None) == (self.heading_rad is None):
            raise ValueError("give exactly one of heading_deg and heading_rad")
        return self

    @property
    def heading(self) -> float:
        """Heading tolerance [rad]."""
        if self.heading_rad is not None:
            return self.heading_rad
        assert self.heading_deg is not None  # by the validator
        return math.radians(self.heading_deg)


class Task(Model):
    """Start, intermediate and final poses of an episode (thesis Table 3.6, sections 3.2.3 and 4.3)."""

    initial: tuple[SpreadPose, ...] = Field(min_length=1)
    intermediate: SpreadPose | None = None
    final: Pose
    final_tolerance: Tolerance = Tolerance(distance_m=1.0, heading_rad=0.07, speed_mps=0.1)
    intermediate_tolerance: Tolerance = Tolerance(distance_m=1.5, heading_deg=5.0, speed_mps=0.1)
    max_steps: Count = 500
    berths: Berths | None = Field(default=None, description="move the poses above to many berths")


ACTION_KINDS = Kinds(ACTIONS, default="grid")
SENSOR_KINDS = Kinds(RANGE_SENSORS, default="spinning")


class Sensors(Model):
    """The range sensor of the boat."""

    lidar: Annotated[RangeSensorSpec, SENSOR_KINDS] = Field(default_factory=SENSOR_KINDS.make_default)


class WeightedTerm(Model):
    """A reward term, its weight and its parameters.

    `term` is the registered name; in a mapping it defaults to the key.
    """

    term: str
    weight: Number
    params: dict[str, Any] = {}


SHARED_BY_TERMS = ("distance_unit_m",)
"""Fields of `Reward` that are defaults of the terms' parameters with the same name."""


class Reward(Model):
    """Equations 3.10 and 3.13 as cases: only the term of the event, otherwise the sum of the dense terms.

    `distance_unit_m` is the unit of the distance in the dense terms; 1 for meters.
    """

    distance_unit_m: Positive
    terms: tuple[WeightedTerm, ...] = Field(min_length=1)

    @model_validator(mode="before")
    @classmethod
    def _terms_by_name(cls, given: Any) -> Any:
        """Turn ``{distance: -150, mine: {term: speed, weight: -10}}`` into a list; null removes a term."""
        if isinstance(given, dict) and isinstance(terms := given.get("terms"), dict):
            listed = [long_term(name, value) for name, value in terms.items() if value is not None]
            return {**given, "terms": listed}
        return given


def long_term(name: str, value: Any) -> dict[str, Any]:
    """Return the long form of an item ``name: weight`` or ``name: {...}`` of the reward's terms."""
    return {"term": name, **(value if isinstance(value, dict) else {"weight": value})}


class ObservationPart(Model):
    """A part of the observation and its parameters; in YAML a name or ``{name: {parameters}}``."""

    part: str
    params: dict[str, Any] = {}

    @model_validator(mode="before")
    @classmethod
    def _from_short_form(cls, given: Any) -> Any:
        return long_part(given)


def long_part(given: Any) -> Any:
    """Return the long form of an item ``name`` or ``{name: {parameters}}`` of the observation."""
    if isinstance(given, str):
        return {"part": given}
    if isinstance(given, dict) and len(given) == 1 and "part" not in given:
        ((name, params),) = given.items()
        return {"part": name, "params": params or {}}
    return given


class Scenario(Model):
    """A docking task: vessel, harbor, sensors, conditions, actions, observation, task, reward, training."""

    file_keys: ClassVar = ("extends", "berth")
    name: Name
    title: str = ""
    description: str = ""
    plugins: tuple[str, ...] = Field(default=(), description="local .py files, relative to the scenario file")
    vessel: Vessel
    harbor: HarborSpec
    sensors: Sensors = Field(default_factory=Sensors)
    conditions: Conditions = {}
    actions: Annotated[ActionType, ACTION_KINDS] = Field(default_factory=ACTION_KINDS.make_default)
    observation: tuple[ObservationPart, ...] = Field(min_length=1)
    task: Task
    reward: Reward
    training: Training = Field(default_factory=Training)
    evaluation: Evaluation = Evaluation()

    @model_validator(mode="after")
    def _commands_within_limits(self) -> Self:
        self.__dict__["actions"] = _fitted(self.actions, ACTIONS, self.vessel)  # frozen only after this
        self.actions.require_within_limits(self.vessel)
        return self

    @model_validator(mode="after")
    def _conditions_fit(self) -> Self:
        """Check them. Values that depend on the vessel stay unset, so that another vessel has its own."""
        self._require_fitting(self.conditions, "conditions")
        self._require_fitting(self.training.conditions, TRAINING_CONDITIONS)
        untrained = self._extreme_factors(self.conditions)
        self._require_stable(untrained, "conditions")
        if (trained := self._extreme_factors(self.with_training_conditions().conditions)) != untrained:
            self._require_stable(trained, TRAINING_CONDITIONS)
        return self

    def _extreme_factors(self, given: Conditions) -> list[list[dict[str, float]]]:
        """Return the extreme factors of the vessel's coefficients for each condition that has some."""
        every = []
        for condition in given.values():
            fitted = _fitted(condition, CONDITIONS, self.vessel)
            with Guard(CONDITIONS, condition.kind):
                if factors := fitted.extreme_factors():
                    every.append([{**dict.fromkeys(SCALABLE, 1.0), **each} for each in factors])
        return every

    def _require_stable(self, every: list[list[dict[str, float]]], field: str) -> None:
        """Check the vessel with the factors of several conditions, which multiply."""
        if len(every) > 1:
            for factors in product(*every):
                combined = {name: math.prod(each[name] for each in factors) for name in SCALABLE}
                self.vessel.require_scalable(combined, field)

    def _require_fitting(self, given: Conditions, field: str) -> None:
        for name, condition in given.items():
            if not name.isidentifier():  # it becomes part of column names
                message = f"'{name}' is not a name: expected letters, digits and underscores"
                raise FieldError(field, message)
            try:
                _fitted(condition, CONDITIONS, self.vessel)
            except FieldError as error:
                where = f"{field}.{name}.{error.field}"
                raise FieldError(where, error.message, error.code, error.suggestion) from None

    @model_validator(mode="after")
    def _berths_exist(self) -> Self:
        require_berths(self.harbor, self.task.berths, is_given="berths" in self.task.model_fields_set)
        return self

    @property
    def evaluated_task(self) -> Task:
        """The task with the step limit of evaluations."""
        steps = self.evaluation.max_steps
        return self.task if steps is None else self.task.model_copy(update={"max_steps": steps})

    def with_training_conditions(self) -> Self:
        """Return the scenario with the conditions of its training."""
        return self.model_copy(update={"conditions": {**self.conditions, **self.training.conditions}})

    def poses(self) -> Iterator[tuple[tuple[str | int, ...], Pose]]:
        """Yield the keys of every pose, and the pose."""
        yield from ((("task", "initial", i), pose) for i, pose in enumerate(self.task.initial))
        if self.task.intermediate is not None:
            yield ("task", "intermediate"), self.task.intermediate
        yield ("task", "final"), self.task.final
        yield from ((("evaluation", "poses", i), pose) for i, pose in enumerate(self.evaluation.poses))

    def in_training(self) -> Self:
        """Return the scenario of the training environment.

        It has the conditions of the training, neither supervisor nor planner, and a control period that is
        longer by a factor of `training.action_repeat`. Its step limits are reduced by the same factor.
        """
        repeat, vessel, task, exploring = (
            self.training.action_repeat, self.vessel, self.task, self.training.exploring_starts
        )  # fmt: skip
        period = {"control_period_s": repeat * vessel.control_period_s, "substeps": repeat * vessel.substeps}
        training = {}
        if exploring is not None:
            steps = -(-exploring.steps // repeat)
            training["exploring_starts"] = exploring.model_copy(update={"steps": steps})
        return self.with_training_conditions().model_copy(
            update={
                "vessel": vessel.model_copy(update=period),
                "task": task.model_copy(update={"max_steps": -(-task.max_steps // repeat)}),
                "training": self.training.model_copy(update=training),
                "evaluation": self.evaluation.model_copy(update=dict.fromkeys(HELPERS)),
            }
        )

    @model_validator(mode="after")
    def _boat_fits_generated_berths(self) -> Self:
        hull = self.vessel.hull
        if isinstance(self.harbor, Generated):
            for field, needed in (
                ("berth_width_m", hull.beam_m + BERTH_MARGIN_M),
                ("entrance_m", hull.beam_m + BERTH_MARGIN_M),
                ("fairway_m", 2 * hull.reach_m + BERTH_MARGIN_M),
            ):
                least = getattr(self.harbor, field)[0]
                if least < needed:
                    message = f"{least:g} is too narrow for the vessel, which needs {needed:.4g} m"
                    raise FieldError(f"harbor.{field}", message, "out_of_range")
        return self


def _fitted(part: Part, registry: Registry[type[Any]], vessel: Vessel) -> Part:
    """Return a part of a scenario with defaults that depend on the vessel filled in.

    Raises:
        FieldError: the part does not suit the vessel.
        PluginError: it failed; pydantic would report some exceptions as the user's errors.
    """
    try:
        fitted = part.fitted(vessel)
        if not isinstance(fitted, ActionType | Condition):
            raise TypeError(f"fitted returned {fitted!r}, expected the {registry.noun}")
        return fitted
    except FieldError:
        raise
    except Exception as error:
        raise Guard(registry, part.kind).locate(error) from error


INTERFACE = ("observation", "sensors", "actions")
"""Sections of the scenario that a policy keeps."""
HELPERS = ("supervisor", "planner")
"""Keys of the evaluation that a policy keeps."""


class PolicyInterface(Model):
    """The parts of a scenario that a policy keeps in every scenario: observation, range sensor and actions.

    Whether it has a supervisor and plans landings is also kept, where a scenario does not say it. Cards of
    older policies have only the number of sectors; the scenario defines the rest of the sensor.
    """

    observation: tuple[ObservationPart, ...] = Field(min_length=1)
    lidar_sectors: Sectors
    actions: Annotated[ActionType, ACTION_KINDS]
    lidar: Annotated[RangeSensorSpec, SENSOR_KINDS] | None = None
    supervisor: bool | None = None
    planner: bool | None = None

    @classmethod
    def of(cls, scenario: Scenario) -> Self:
        """Return the interface of policies trained on `scenario`."""
        return cls(
            observation=scenario.observation,
            lidar_sectors=scenario.sensors.lidar.sectors,
            actions=scenario.actions,
            lidar=scenario.sensors.lidar,
            **{name: getattr(scenario.evaluation, name) for name in HELPERS},
        )

    def agrees(self, scenario: Scenario, other: Scenario) -> bool:
        """Return whether the scenarios are equal in observation, range sensor and actions."""
        one, two = self.of(scenario), self.of(other)
        given = [name for name, value in self if value is not None and name not in HELPERS]
        return all(getattr(one, name) == getattr(two, name) for name in given)

    def on(self, scenario: Scenario) -> Scenario:
        """Return `scenario` with the parts of the policy.

        Raises:
            DockctlError: the policy's actions exceed the limits of the vessel.
        """
        lidar = self.lidar or scenario.sensors.lidar.model_copy(update={"sectors": self.lidar_sectors})
        evaluation = scenario.evaluation
        own = {name: getattr(self, name) for name in HELPERS if getattr(evaluation, name) is None}
        changed = {
            "observation": self.observation,
            "actions": self.actions.model_copy(update=dict(self.actions)),  # all keys count as given
            "sensors": scenario.sensors.model_copy(update={"lidar": lidar}),
            "evaluation": evaluation.model_copy(update=own),
        }
        try:
            return Scenario.model_validate({**dict(scenario), **changed})
        except ValidationError as error:
            reasons = "; ".join(str(detail.get("ctx", {}).get("error")) for detail in error.errors())
            message = f"the policy's actions exceed the limits of the vessel of '{scenario.name}': {reasons}"
            raise DockctlError(message, code="mismatch") from None
