"""Linear schedules over environment steps."""

from __future__ import annotations

from dockctl.scenarios.training import Training


def linear(start: float, end: float, fraction: float) -> float:
    """From `start` at 0 to `end` at 1, constant after it."""
    return start + (end - start) * min(fraction, 1.0)


def epsilon(training: Training, env_steps: int) -> float:
    """Probability of a random action (eqs. 4.1, 4.2)."""
    rule = training.epsilon
    return linear(rule.start, rule.end, env_steps / rule.decay_steps)


def learning_rate(training: Training, env_steps: int) -> float:
    return linear(training.learning_rate, training.final_learning_rate, env_steps / training.total_steps)


def updates_due(training: Training, env_steps: int) -> int:
    """Updates that belong to the first `env_steps` steps: the first one when the warm-up is over."""
    after_warmup = env_steps - training.warmup_steps
    return after_warmup // training.steps_per_update + 1 if after_warmup >= 0 else 0
