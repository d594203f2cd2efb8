"""Run policies and measure them; the Python API for scripts and notebooks.

from dockctl.evaluation import evaluate
print(evaluate("s1", episodes=20).table)
"""

from dockctl.evaluation.compare import compare
from dockctl.evaluation.envelope import envelope
from dockctl.evaluation.evaluate import evaluate
from dockctl.evaluation.loading import load_policy
from dockctl.evaluation.rollout import Rollout
from dockctl.evaluation.success_map import Grid, success_map

__all__ = ["Grid", "Rollout", "compare", "envelope", "evaluate", "load_policy", "success_map"]
