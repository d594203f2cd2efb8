"""Base classes of the sections of a scenario that are selected by a registered name under the key `kind`.

    actions: {kind: continuous}

A registered value is a subclass of `Kind`: a model whose fields are the keys of the section. It is validated
before anything runs (`dockctl.scenarios.kinds`), and its methods build what the section describes.

To add one, write a subclass of `ActionType`, `RangeSensorSpec`, `Condition`, or
`dockctl.agents.algorithms.AlgorithmSpec` in a module of your own, name it in ``kind``, declare its keys as
fields, and decorate it with `register`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, GetJsonSchemaHandler, PlainSerializer
from pydantic_core import CoreSchema

from dockctl.errors import PluginError
from dockctl.geometry import MAX_SECTORS, Floats, Ints
from dockctl.registry import Entry, Registry
from dockctl.scenarios.base import Count, Heading, Length, Model
from dockctl.scenarios.vessel import Vessel
from dockctl.scenarios.yaml_tree import describe

if TYPE_CHECKING:
    import gymnasium

T = TypeVar("T", bound=float)
K = TypeVar("K", bound="type[Kind]")


Sectors = Annotated[Count, Field(le=MAX_SECTORS)]


class Kind(Model):
    """A section selected by `kind`.

    A subclass declares its name, ``kind: Literal["grid"] = "grid"``, its keys as fields, and methods that
    build what it describes.

    Attributes:
        examples: keys of valid sections, which the contract tests of a subclass use; at least one.
    """

    examples: ClassVar[tuple[dict[str, Any], ...]] = ({},)
    kind: str


def register(registry: Registry[type[Any]], *, group: str = "", source: str = "") -> Callable[[K], K]:
    """Return a decorator that registers a subclass of `Kind` under the default of its field `kind`.

    Args:
        registry: for example `dockctl.plugins.ACTIONS`.
        group: group within the registry, for listings.
        source: equation, table, paper or data sheet.

    Raises:
        DuplicateNameError: the name is taken.
        PluginError: the class has no name.
    """

    def add(model: K) -> K:
        name = model.__pydantic_fields__["kind"].default
        if not isinstance(name, str):
            place = Entry("", model, group, source, "").place
            raise PluginError(f"{model.__qualname__}: the field 'kind' needs a name as its default{place}")
        registry.register(name, model, kind=group, source=source)
        return model

    return add


class ActionType(Kind, ABC):
    """Action space of a policy and its mapping to actuator commands; registered in `ACTIONS`."""

    @abstractmethod
    def describe(self) -> str:
        """Return a one-line description of the actions, for model cards."""

    @abstractmethod
    def space(self, vessel: Vessel) -> gymnasium.Space[Any]:
        """Return the action space of one boat."""

    @abstractmethod
    def commands(self, actions: NDArray[Any], vessel: Vessel) -> Floats:
        """Return propeller force [N] and rudder angle [rad], (n, 2), for n actions of the space."""

    def next_commands(self, actions: NDArray[Any], vessel: Vessel, previous: Floats) -> Floats:
        """Return the commands (n, 2), given those of the last step, `previous` (n, 2), zero at a start.

        By default these are `commands`, which do not depend on the last step.
        """
        return self.commands(actions, vessel)

    def command_table(self, vessel: Vessel) -> Floats | None:
        """Return the command of each action, (actions, 2) [N, rad].

        None if actions are not numbers from 0, or their commands depend on the last step.
        """
        from gymnasium.spaces import Discrete  # slow to import, and not needed to check a scenario

        space = self.space(vessel)
        if self.has_memory or not isinstance(space, Discrete) or space.start != 0:
            return None
        return np.asarray(self.commands(np.arange(space.n), vessel), float)

    @property
    def grid(self) -> dict[str, tuple[float, ...]] | None:
        """``propeller_n`` and ``rudder_deg`` if the actions are all pairs of them; the angle varies fastest.

        Replays draw Q-values over this grid. None, the default, for other actions.
        """
        return None

    @property
    def has_memory(self) -> bool:
        """Whether the command of an action depends on the previous command."""
        return type(self).next_commands is not ActionType.next_commands

    def fitted(self, vessel: Vessel) -> ActionType:
        """Return the actions with defaults that depend on the vessel filled in; by default unchanged."""
        return self

    def require_within_limits(self, vessel: Vessel) -> None:
        """Check that no command exceeds the limits of the vessel.

        Raises:
            FieldError: one does; the field begins with ``actions.``.
        """
        return


@dataclass(frozen=True)
class RangeNoise:
    """Noise of one scan of n boats, each (n,).

    Attributes:
        seeds: seeds of the scan, uint64.
        sigma_m: standard deviation of each return [m].
        lost_returns: fraction of the returns that are lost.
        lost_sectors: fraction of the sectors that are lost.
    """

    seeds: NDArray[np.uint64]
    sigma_m: Floats
    lost_returns: Floats
    lost_sectors: Floats

    def of(self, rows: Ints) -> RangeNoise:
        """Return the noise of these boats (k,)."""
        return RangeNoise(*(values[rows] for values in vars(self).values()))


class RangeSensor(Protocol):
    """A range sensor in one harbor. Poses are x, y [m] and heading [rad] in the world frame."""

    @property
    def table_bytes(self) -> int:
        """Memory of the sensor in use [bytes], without what it shares with those in other harbors."""
        ...

    def sector_ranges(self, eta: Floats) -> Floats:
        """Return the range of the nearest return in each sector (n, sectors) [m] from the poses (n, 3).

        It is the horizontal distance from the body's origin, or `range_m` without a return; sectors
        are numbered as in `dockctl.geometry.sector_index`. Row i depends on pose i alone.

        Called in several threads at once, each for a different harbor.
        """
        ...

    def points(self, pose: Floats, every: int = 1) -> Floats:
        """Return the returns (k, 3) [m] of every n-th ray in the body frame, from one pose (3,)."""
        ...


@runtime_checkable
class NoisyRangeSensor(RangeSensor, Protocol):
    """A range sensor that can scan with noise."""

    def noisy_sector_ranges(self, eta: Floats, noise: RangeNoise) -> Floats:
        """Return `sector_ranges` (n, sectors) [m] with errors of the returns and without lost returns.

        The noise of row i depends on its seed alone. The simulator applies lost sectors.
        """
        ...


class RangeSensorSpec(Kind, ABC):
    """Configuration of a range sensor on the boat; registered in `RANGE_SENSORS`.

    Equal specs must have equal hashes, so use tuples for lists: the sensor is built once for each harbor.
    """

    range_m: Length = 100.0
    sectors: Sectors = 8

    @property
    def is_symmetric(self) -> bool:
        """Whether port and starboard of the sensor are mirror images; required by ``training.mirrored``."""
        return False

    @property
    def origins(self) -> tuple[tuple[float, float, float], ...]:
        """Origins of its rays, x, y, z in the body frame [m], for drawings; by default none are drawn."""
        return ()

    @property
    def shared_bytes(self) -> int:
        """Memory that its sensors in all harbors share [bytes], for the estimate before training."""
        return 0

    @abstractmethod
    def build(self, triangles: Floats) -> RangeSensor:
        """Return the sensor in a harbor with these surface triangles (m, 3, 3) [m], in the world frame."""


class Disturbance:
    """Run-time state of a condition for n boats; the hooks do nothing by default.

    `reset` draws the values of an episode. In every step the simulator calls the hooks, and `advance` last.
    The results of hooks change only in `reset` and `advance`, except for `actuate`, which is called once per
    step. A velocity, force or error may be the number 0.
    """

    def reset(self, rows: Ints, rngs: Sequence[np.random.Generator]) -> None:
        """Draw the values of the episodes that start in `rows` (k,), each from a generator of its own."""

    def advance(self, period_s: float) -> None:
        """Advance by one control period; a boat may draw only from seeds that `reset` drew for it."""

    def water_velocity(self) -> Floats | float:
        """Return the velocity of the water over ground (n, 2) [m/s], in the world frame.

        It is constant during a control period, over which the equations of motion hold for the velocity
        relative to the water. A change of it does not change the boat's velocity over ground.
        """
        return 0.0

    def air_velocity(self) -> Floats | float:
        """Return the velocity of the air over ground (n, 2) [m/s], in the world frame."""
        return 0.0

    def force(self, eta: Floats, nu: Floats) -> Floats | float:
        """Return surge force, sway force and yaw moment (n, 3) [N, N, N m] for the next control period.

        Args:
            eta: (n, 3) x, y [m] and heading [rad].
            nu: (n, 3) u, v [m/s] and r [rad/s] over ground.
        """
        return 0.0

    def range_noise(self) -> RangeNoise | None:
        """Return the noise of the range sensor's next scan."""
        return None

    def reported_ranges(self, ranges: Floats, rows: Ints, range_m: float) -> Floats:
        """Return the ranges that the sensors of the boats in `rows` (k,) report instead of `ranges`.

        Args:
            ranges: (k, sectors) of a scan, with noise [m]; must not be modified.
            range_m: maximum range of the sensor, which a sector without a return reads.
        """
        return ranges

    def coefficient_factors(self) -> dict[str, Floats]:
        """Return factors (n,) of the vessel's coefficients, by their key in the vessel's file.

        They are read at the start of an episode; the factors of several conditions are multiplied.
        """
        return {}

    def actuate(self, commands: Floats, substep_s: float) -> Floats:
        """Return the actual propeller force [N] and rudder angle [rad], (n, k, 2), for the commands.

        Called once in every control step; conditions are applied in the scenario's order.

        Args:
            commands: (n, k, 2) [N, rad] in the k substeps of the control period.
            substep_s: length of a substep [s]; the results are means over substeps.
        """
        return commands

    def pose_error(self) -> Floats | float:
        """Return the error (n, 3) [m, m, rad] of the measured pose."""
        return 0.0

    def velocity_error(self) -> Floats | float:
        """Return the error (n, 3) [m/s, m/s, rad/s] of the measured velocity, in the body frame."""
        return 0.0

    def episode(self) -> dict[str, Floats]:
        """Return the values of each boat's episode (n,) by name with unit, for `info` and tables."""
        return {}

    def state(self) -> dict[str, Any]:
        """Return everything that changes after `build`, for checkpoints; by default all but models.

        Values are numbers, strings, None, arrays of numbers, NumPy generators, and lists, tuples and
        dictionaries of them. Override it if an attribute has a different type.
        """
        return {name: value for name, value in vars(self).items() if not isinstance(value, Model)}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from what `state` returned; the condition was built for the same number of boats."""
        vars(self).update(state)


class Condition(Kind, ABC):
    """An environmental disturbance, or an error of sensors or actuators; registered in `CONDITIONS`.

    Register it with a group: water, air, sensing, actuation or vessel. A key may be `Drawn`: a number, or a
    range from which each episode draws.

    Attributes:
        is_single: whether a scenario may have only one of this kind, because two do not add up.
    """

    is_single: ClassVar[bool] = False
    model_config = ConfigDict(validate_default=True)  # a number is a valid default of a `Drawn` key

    @abstractmethod
    def build(self, num_boats: int) -> Disturbance:
        """Return the condition for `num_boats` boats."""

    def fitted(self, vessel: Vessel) -> Condition:
        """Return the condition with values that depend on the vessel filled in; by default unchanged.

        Raises:
            FieldError: it is not possible for this vessel; the field is a key of the condition.
        """
        return self

    def extreme_factors(self) -> Sequence[Mapping[str, float]]:
        """Return the most extreme factors of the vessel's coefficients by name, in every combination.

        With those of the other conditions they must leave a valid vessel; called on what `fitted` returned.
        """
        return ()

    def notes(self, vessel: Vessel) -> list[tuple[str, str]]:
        """Return a field and a message for each key that exceeds the vessel's control authority."""
        return []

    def side_force_n(self, vessel: Vessel) -> float:
        """Return the side force needed to hold the boat across the strongest flow [N], for the notes."""
        return 0.0


class _NumberOrBounds(BeforeValidator):
    """Accepts a number as a range; a class, because the JSON schema must describe both."""

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        bounds = handler(schema)
        return {"anyOf": [bounds["items"], bounds]}


def _as_bounds(given: Any) -> Any:
    if given is None or isinstance(given, str | dict):
        raise ValueError(f"found {describe(given)}, expected a number or [low, high]")
    return (given,) if isinstance(given, int | float) else given


def _ordered(bounds: tuple[T, ...]) -> tuple[T, ...]:
    if list(bounds) != sorted(bounds):
        raise ValueError(f"found {list(bounds)}, expected the lower bound first")
    return bounds


def _shortest(bounds: tuple[T, ...]) -> T | list[T]:
    return bounds[0] if len(bounds) == 1 else list(bounds)


Drawn = Annotated[
    tuple[T, ...],
    Field(min_length=1, max_length=2),
    _NumberOrBounds(_as_bounds),
    AfterValidator(_ordered),
    PlainSerializer(_shortest),
]
"""A number, or a range [low, high] from which each episode draws with `draw`."""


def _through_zero(given: Any) -> Any:
    match given:
        case [int() | float() as low, int() | float() as high] if low > high:
            hint = "a range through 0° is like [-10, 10] or [350, 370]"
            raise ValueError(f"found {given}, expected the lower bound first; {hint}")
    return given


Directions = Annotated[Drawn[Heading], BeforeValidator(_through_zero)]
"""A direction [°], or a range of directions from which each episode draws."""


OFF = (0.0,)
"""The `Drawn` number zero."""


def draw_integer(bounds: tuple[int, ...], rng: np.random.Generator) -> int:
    """Return the integer, or one drawn uniformly from the range, bounds included."""
    return bounds[0] if len(bounds) == 1 else int(rng.integers(bounds[0], bounds[1], endpoint=True))


def draw(bounds: tuple[float, ...], rng: np.random.Generator) -> float:
    """Return the number, or one drawn uniformly from the range; a single number does not advance `rng`."""
    return bounds[0] if len(bounds) == 1 else rng.uniform(bounds[0], bounds[1])
