"""Names of the files of a run folder, ``runs/<scenario>/<timestamp>-seed<N>/``.

A run folder is self-contained: it can be moved, copied and read without the scenario that it came from.

Written by training:

========================  =============================================================================
``scenario.yaml``         the fully resolved scenario; loads as an equal scenario
``provenance.json``       commit, seed, command, library versions, hardware, start, end, stop reason
``scene.json``            plan view of the harbor and outline of the boat, for drawings
``plugins/, meshes/``     copies of the local files that the scenario uses
``initial/``              copy of the policy that training started from, if any
``episodes.csv``          training episodes
``updates.csv``           loss, TD error, Q and gradient norm, averaged over updates
``evaluations.csv``       greedy episodes during training
``timing.csv``            wall-clock seconds, apart from the other tables, which repeat byte for byte
``trajectories.csv``      greedy episodes of the best policy, step by step
``tensorboard/, wandb/``  logs of ``--log``, with the same numbers as the tables
``checkpoints/best``      policy that docks from the most validation starts; ``best-1``, ``best-2`` are older
``checkpoints/last``      complete training state, for resuming; ``last-1``, ``last-2`` are older
``checkpoints/blocks``    large arrays of these states, such as the replay buffer, in shared blocks
========================  =============================================================================

Written by the commands that measure the policy:

========================  =============================================================================
``evaluation.csv/json``   episodes and summary of ``dockctl evaluate``
``map.csv/json``          outcome by start pose, of ``dockctl map``
``envelope.csv/json``     outcomes by weather, start, noise and delay, of ``dockctl envelope``
``returns.csv/json``      discounted returns of behaviors, of ``dockctl returns``
``transfer/``             recordings, of ``dockctl evaluate --record``
``figures/``              figures, and ``latency.csv/json`` of ``dockctl latency``
``last/``                 the same for the checkpoint ``last``, if that was measured
========================  =============================================================================

The JSON files contain the hashes of the files that belong to them (`dockctl.runs.results`).
For other scenarios, the scenario's name is appended: ``evaluation-marina.csv``. Columns are described in
`dockctl.runs.tables`.
"""

from __future__ import annotations

from pathlib import Path

RUNS = Path("runs")
"""Default folder of training runs."""
SCENARIO = "scenario.yaml"
PROVENANCE = "provenance.json"
SCENE = "scene.json"
EPISODES_CSV, UPDATES_CSV, EVALUATIONS_CSV = "episodes.csv", "updates.csv", "evaluations.csv"
TIMING_CSV, TRAJECTORIES_CSV = "timing.csv", "trajectories.csv"
EVALUATION, MAP, ENVELOPE = "evaluation", "map", "envelope"
RETURNS, LATENCY = "returns", "figures/latency"
"""Measurements of the policy: a table (.csv), and a .json file with the policy's hash."""
DRAWN = "figures/figures.json"
"""Hashes of the figures of ``dockctl plot`` and of the tables that they were drawn from."""
RECORDING = "recording.json"
STUDY, SCENES = "study.json", "scenes"
"""The study of archived runs, and the scenes that they share, in the folder of their experiments."""
TRANSFER, FAILURES = "transfer", "failures"
"""Folder of the recordings, and its subfolder for a study's nearest failures."""
ARCHIVED_AS = "archived_as"
"""Key in the scene file of an archived run: relative path of the compressed scene that several runs share."""
FIGURES, CHECKPOINTS, PLUGINS, MESHES = "figures", "checkpoints", "plugins", "meshes"
INITIAL = "initial"
BEST, LAST, BLOCKS = "best", "last", "blocks"
POLICY, LEARNER = "policy", "learner"
"""Stems of the files of a checkpoint: the policy, and the rest of the state for resuming."""
POLICY_JSON, POLICY_TENSORS, LEARNER_JSON = f"{POLICY}.json", f"{POLICY}.safetensors", f"{LEARNER}.json"
GENERATIONS = 3
"""Number of checkpoints that are kept under one name."""


def run_name(time: str, seed: int) -> str:
    """Return the name of a run's folder; a second run of the same time has ``-2`` appended."""
    return f"{time}-seed{seed}"


def runs_of_seed(seed: int) -> tuple[str, str]:
    """Return glob patterns for the names of all run folders of a seed."""
    return run_name("*", seed), f"{run_name('*', seed)}-*"


def archived_name(seed: int | str) -> str:
    """Return the name of an archived run's folder in its experiment's folder; ``*`` gives a pattern."""
    return f"seed{seed}"


def generations(checkpoint: str) -> list[str]:
    """Return the names of the folders of the checkpoint `BEST` or `LAST`, newest first."""
    return [checkpoint, *(f"{checkpoint}-{i}" for i in range(1, GENERATIONS))]
