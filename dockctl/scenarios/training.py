"""Configuration of training and evaluation (thesis sections 3.2.4-3.2.6)."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from dockctl.plugins import ALGORITHMS, CONDITIONS
from dockctl.scenarios.base import (
    Count,
    FieldError,
    Flag,
    Fraction,
    Model,
    NonNegative,
    Pose,
    Positive,
    Speed,
    Turn,
)
from dockctl.scenarios.extensions import Condition, Kind
from dockctl.scenarios.kinds import Kinds

ALGORITHM = Kinds(ALGORITHMS, default="dqn")
Layer = Annotated[Count, Field(le=8192)]


def _conditions_by_name(given: Any) -> Any:
    """Use the key as the kind of a condition that has no `kind`; null removes a condition."""
    if not isinstance(given, dict):
        return given
    return {
        name: {"kind": name, **body} if isinstance(body, dict) else body
        for name, body in given.items()
        if body is not None
    }


Conditions = Annotated[
    dict[str, Annotated[Condition, Kinds(CONDITIONS)]], BeforeValidator(_conditions_by_name)
]
"""Conditions by name."""


def _linear(start: float, end: float, fraction: float) -> float:
    """Interpolate from `start` at 0 to `end` at 1, constant afterwards."""
    return start + (end - start) * min(fraction, 1.0)


class Epsilon(Model):
    """Linear decay of the probability of a random action (eqs. 4.1, 4.2), in environment steps."""

    start: Fraction = 1.0
    end: Fraction = 0.03
    decay_steps: Count = 25_000

    def at(self, env_steps: float) -> float:
        """Return the probability after `env_steps`."""
        return _linear(self.start, self.end, env_steps / self.decay_steps)


class ExploringStarts(Model):
    """Training episodes that start at random between two successive poses of the task."""

    fraction: Fraction = 0.5
    position_noise_m: tuple[NonNegative, NonNegative] = (0.3, 2.3)
    heading_noise_deg: tuple[Turn, Turn] = (6.0, 26.0)
    max_surge_mps: Speed = 0.35
    steps: Count = 200


class CloseStarts(Model):
    """Initial starts in training that are redrawn until an obstacle is near the hull.

    Such starts are rare among uniform draws, and they are the hardest.
    """

    fraction: Fraction = 0.5
    within_m: Positive = 1.0


class RetriedStarts(Model):
    """Training episodes that start where an earlier one failed."""

    fraction: Fraction = 0.3


class ValidationStarts(Model):
    """Random starts whose greedy episodes select the checkpoint `best`.

    They are drawn like the starts of `evaluation.random_starts`, but with other random numbers.
    """

    starts: Count = Field(default=100, le=100_000)
    every_steps: Count = Field(default=100_000, description="environment steps between validations")


class StopRule(Model):
    """Training ends when `docked` of the last `episodes` episodes docked and the greedy policy docks as well.

    The greedy policy must dock from every evaluation pose and from the same share of the validation starts,
    or for a task with berths from every validation start.
    """

    docked: Count = 95
    episodes: Count = 100

    @model_validator(mode="after")
    def _docked_at_most_episodes(self) -> Self:
        if self.docked > self.episodes:
            raise FieldError(
                "docked", f"{self.docked} is more than episodes, {self.episodes}", "out_of_range"
            )
        return self


class Ensemble(Model):
    """The policy acts on the mean Q-values of the network at several times during training.

    With ``mirrored``, the mean includes the mirror image of the observation. After averaged DQN (Anschel et
    al. 2017) and snapshot ensembles (Huang et al. 2017).

    With ``restarts``, the training has equal parts. In each the network begins with its first parameters and
    the first learning rate, and learns from all episodes, also those of earlier parts; the policy acts on the
    mean over the last networks of every part. After resets (Nikishin et al. 2022).
    """

    networks: int = Field(default=4, ge=1, le=64, strict=True, description="the current one and earlier ones")
    every_steps: Count = Field(default=100_000, description="environment steps between two networks")
    restarts: int = Field(default=0, ge=0, le=16, strict=True, description="how often learning starts over")


THESIS: dict[str, Any] = {
    "total_steps": 2_000_000,
    "max_episodes": 4000,
    "boats": 1,
    "batch_size": 32,
    "steps_per_update": 1,
    "n_step": 1,
    "optimizer": "rmsprop",
    "learning_rate": 1e-4,
    "final_learning_rate": 1e-4,
    "huber_delta": None,
    "gradient_clip": None,
    "target_update_interval": 500,
    "averaged_copies": None,
    "ensemble": None,
    "hysteresis": None,
    "action_repeat": 1,
    "epsilon": {"start": 1.0, "end": 0.01, "decay_steps": 500_000},
    "warmup_steps": 32,
    "reward_scale": 1.0,
    "exploring_starts": None,
    "stop": None,
}
PRESETS: dict[str, dict[str, Any]] = {"default": {}, "thesis": THESIS}


class Training(Model):
    """The algorithm and its hyperparameters (sections 3.2.4-3.2.6); the defaults are the preset `default`."""

    preset: Literal["default", "thesis"] = "default"
    seed: int = Field(default=0, ge=0, strict=True)
    algorithm: Annotated[Kind, ALGORITHM] = Field(default_factory=ALGORITHM.make_default)
    total_steps: Count = Field(default=500_000, description="environment steps, summed over all boats")
    max_episodes: Count | None = None
    boats: Count = Field(default=16, le=4096, description="boats in parallel")
    action_repeat: Count = Field(
        default=2, le=100, description="control periods for which an action is held, in training only"
    )
    hidden_sizes: tuple[Layer, ...] = Field(default=(256, 128, 64), min_length=1, max_length=16)
    gamma: Fraction = 0.99
    n_step: Count = Field(default=10, le=1000)
    replay_capacity: Count = Field(default=500_000, le=1_000_000_000)
    warmup_steps: Count = Field(default=5_000, description="environment steps before the first update")
    batch_size: Count = Field(default=128, le=65_536)
    steps_per_update: Count = Field(default=4, description="environment steps per update")
    target_update_interval: Count = Field(default=100, description="updates between target copies")
    averaged_copies: Count | None = Field(
        default=20, description="target copies that the saved policy averages; null for the online network"
    )
    ensemble: Ensemble | None = None
    hysteresis: Positive | None = Field(
        default=None,
        description="margin [reward] by which another action must be better than the last one to replace it",
    )
    optimizer: Literal["adam", "rmsprop"] = "adam"
    learning_rate: Positive = 5e-4
    final_learning_rate: Positive = Field(
        default=5e-5, description="reached linearly at the end of each part"
    )
    huber_delta: Positive | None = Field(default=10.0, description="null for the squared error")
    gradient_clip: Positive | None = Field(default=10.0, description="maximum L2 norm; null for none")
    reward_scale: Positive = 1e-3
    largest_return: Positive | None = Field(
        default=None, description="upper bound on the TD targets; null for none"
    )
    conditions: Conditions = Field(
        default={}, description="conditions of training alone: added, or instead of those of the same name"
    )
    epsilon: Epsilon = Epsilon()
    exploring_starts: ExploringStarts | None = ExploringStarts()
    close_starts: CloseStarts | None = None
    retried_starts: RetriedStarts | None = None
    stop: StopRule | None = StopRule()
    mirrored: Flag = Field(default=False, description="replace half of each batch with mirror images")
    on_divergence: Literal["stop", "rollback", "continue"] = "stop"
    evaluate_every_steps: Count = 10_000
    validation: ValidationStarts = ValidationStarts()

    @property
    def copies_between_snapshots(self) -> int:
        """Target copies between two networks of the ensemble."""
        steps = self.steps_per_update * self.target_update_interval
        return 1 if self.ensemble is None else max(1, round(self.ensemble.every_steps / steps))

    @property
    def largest_target(self) -> float:
        """Upper bound on the TD targets of scaled rewards; infinite without `largest_return`."""
        return math.inf if self.largest_return is None else self.largest_return * self.reward_scale

    @property
    def largest_gradient(self) -> float:
        """Norm to which gradients are clipped; infinite without `gradient_clip`."""
        return math.inf if self.gradient_clip is None else self.gradient_clip

    @property
    def parts(self) -> int:
        """Number of parts of the training, in each of which learning starts over."""
        return 1 if self.ensemble is None else self.ensemble.restarts + 1

    def part_at(self, env_steps: float) -> int:
        """Return the number of the part of the training after `env_steps`, from 0."""
        return min(int(env_steps * self.parts / self.total_steps), self.parts - 1)

    def learning_rate_at(self, env_steps: float) -> float:
        """Return the learning rate after `env_steps`."""
        progress = env_steps * self.parts / self.total_steps - self.part_at(env_steps)
        return _linear(self.learning_rate, self.final_learning_rate, progress)

    def updates_due(self, env_steps: int) -> int:
        """Return the number of updates after `env_steps`; the first one is due when the warm-up ends."""
        after_warmup = env_steps - self.warmup_steps
        return after_warmup // self.steps_per_update + 1 if after_warmup >= 0 else 0

    @model_validator(mode="before")
    @classmethod
    def _fill_from_preset(cls, given: Any) -> Any:
        if isinstance(given, dict):
            return {**PRESETS.get(str(given.get("preset", "default")), {}), **given}
        return given


class RandomStarts(Model):
    """Test starts drawn uniformly around the initial poses, at the held-out berths if there are any."""

    episodes: int = Field(default=100, ge=0, le=100_000, strict=True)
    seed: int = Field(default=12345, ge=0, strict=True)
    position_m: NonNegative = 1.0
    heading_deg: Turn = 10.0


class Evaluation(Model):
    """The greedy episodes that test a policy."""

    poses: tuple[Pose, ...] = Field(default=(), description="evaluation poses; if empty, the initial poses")
    supervisor: Flag | None = Field(
        default=None,
        description="replace actions that lead to contact, and make waiting boats move, with a map of the"
        " harbor; null to do as in the scenario that the policy was trained in",
    )
    planner: Flag | None = Field(
        default=None,
        description="follow plans near the final pose, and replace actions that lead to contact, with"
        " a map of the harbor; null to do as in the scenario that the policy was trained in",
    )
    max_steps: Count | None = Field(
        default=None,
        description="control steps before an episode is truncated, also in validations; null for"
        " `task.max_steps`",
    )
    random_starts: RandomStarts = RandomStarts()
    conditions_seed: int = Field(
        default=0,
        ge=0,
        lt=2**32,
        strict=True,
        description="seed of the conditions of the first episode; that of each other one is larger by 1",
    )
    trained_berths: Count = Field(
        default=64, le=100_000, description="random starts at trained berths, for a task with berths"
    )
