"""The dry run finds broken plugins in every registered part, at the line that failed, before a run folder."""

from __future__ import annotations

from pathlib import Path

import pytest
from gymnasium.spaces import Box, Discrete

from dockctl.agents.interface import Spaces
from dockctl.errors import InputError, PluginError
from dockctl.experiments.dry_run import build_algorithm, dry_run
from dockctl.scenarios.loader import load
from tests.commands.conftest import dockctl, quick_train
from tests.experiments.broken_plugins import DEFINITION, FAULTS, KIND, SELECTED, WORKING, plugin


@pytest.mark.parametrize("part", WORKING)
def test_a_plugin_that_works_passes(part: str, tmp_path: Path) -> None:
    plugin(tmp_path / "mine.py", part)
    dry_run(load("s1", overrides=[SELECTED[part]], plugin_files=[tmp_path / "mine.py"]))


@pytest.mark.parametrize(("part", "changes", "fault"), FAULTS)
def test_a_fault_is_located(part: str, changes: dict[str, str], fault: str | None, tmp_path: Path) -> None:
    """At the line that failed, or where the part is defined if its result cannot be used."""
    path = tmp_path / "mine.py"
    lines = plugin(path, part, **changes)
    wanted = fault or DEFINITION.get(part, "@register")
    (number,) = [i for i, line in enumerate(lines, start=1) if wanted in line]
    loaded = load("s1", overrides=[SELECTED[part]], plugin_files=[path])
    with pytest.raises(PluginError) as caught:
        dry_run(loaded)
    assert f"({path}:{number})" in str(caught.value)


def test_a_sensor_with_keys_that_have_no_hash_is_located(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    lines = plugin(path, "sensor")
    path.write_text(path.read_text().replace("= 'mine'\n", "= 'mine'\n    heights: list[float] = [1.0]\n"))
    loaded = load("s1", overrides=[SELECTED["sensor"]], plugin_files=[path])
    number = 1 + lines.index("@register(RANGE_SENSORS)")
    with pytest.raises(PluginError, match=rf"mine\.py:{number}\)"):
        dry_run(loaded)


@pytest.mark.parametrize(("method", "result"), [("describe", "1 / 0"), ("build", "None")])
def test_a_fault_of_an_algorithm_that_extends_dqn_is_located(
    method: str, result: str, tmp_path: Path
) -> None:
    path, fault = tmp_path / "mine.py", f"    def {method}(self, *given): return {result}"
    text = f"{KIND}@register(ALGORITHMS)\nclass Mine(Dqn):\n    kind: Literal['mine'] = 'mine'\n{fault}\n"
    path.write_text(text)
    wanted = fault if "/" in result else "@register(ALGORITHMS)"
    number = 1 + text.splitlines().index(wanted)
    loaded = load("s1", overrides=[SELECTED["algorithm"]], plugin_files=[path])
    with pytest.raises(PluginError, match=rf"mine\.py:{number}\)"):
        dry_run(loaded)


@pytest.mark.parametrize("part", ["actions", "condition", "sensor", "algorithm"])
@pytest.mark.parametrize("field", ["kind: Literal['mine']", "kind: str", "name: str = 'mine'"])
def test_a_class_without_a_default_of_kind_is_located(field: str, part: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    plugin(path, part)
    path.write_text(path.read_text().replace("kind: Literal['mine'] = 'mine'", field))
    (decorator,) = [line for line in path.read_text().splitlines() if line.startswith("@register")]
    number = 1 + path.read_text().splitlines().index(decorator)
    with pytest.raises(PluginError, match=rf"mine\.py:{number}\)"):
        load("s1", overrides=[SELECTED[part]], plugin_files=[path])


@pytest.mark.parametrize(
    ("part", "after"), [("condition", "= 'mine'\n"), ("actions", "def describe(self): return ''\n")]
)
def test_fitted_that_returns_something_else_is_located(part: str, after: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    plugin(path, part)
    path.write_text(path.read_text().replace(after, f"{after}    def fitted(self, vessel): pass\n"))
    (decorator,) = [line for line in path.read_text().splitlines() if line.startswith("@register")]
    number = 1 + path.read_text().splitlines().index(decorator)
    with pytest.raises(PluginError, match=rf"mine\.py:{number}\)"):
        load("s1", overrides=[SELECTED[part]], plugin_files=[path])


@pytest.mark.parametrize("error", ["ValueError", "AssertionError"])
@pytest.mark.parametrize(
    ("part", "after"), [("condition", "= 'mine'\n"), ("actions", "def describe(self): return ''\n")]
)
def test_an_exception_while_a_part_is_fitted_is_not_one_of_the_user(
    part: str, after: str, error: str, tmp_path: Path
) -> None:
    path = tmp_path / "mine.py"
    plugin(path, part)
    text = path.read_text()
    path.write_text(text.replace(after, f"{after}    def fitted(self, vessel): raise {error}\n"))
    number = 1 + path.read_text().splitlines().index(f"    def fitted(self, vessel): raise {error}")
    with pytest.raises(PluginError, match=rf"mine\.py:{number}\)"):
        load("s1", overrides=[SELECTED[part]], plugin_files=[path])


@pytest.mark.parametrize("algorithm", ["dqn", "mine"])
@pytest.mark.parametrize("space", ["Discrete(7, start=-3)", "Box(-1, 1, (2,), np.float64)"])
def test_actions_of_which_no_policy_can_be_saved_are_located(
    space: str, algorithm: str, tmp_path: Path
) -> None:
    own = [tmp_path / "space.py", tmp_path / "learner.py"]
    plugin(own[0], "actions", space=space)
    own[0].write_text(own[0].read_text().replace("import Discrete", "import Box, Discrete"))
    plugin(own[1], "algorithm", act="np.zeros(len(observation), int) - 2")
    overrides = [SELECTED["actions"], f"training.algorithm={{kind: {algorithm}}}"]
    with pytest.raises(InputError) as caught:
        dry_run(load("s1", overrides=overrides, plugin_files=own))
    (problem,) = caught.value.problems
    assert (problem.file, problem.code) == ("--set actions", "mismatch")


def test_the_unit_of_distances_is_that_of_the_reward(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    plugin(path, "term", value="status.distance_m / distance_unit_m")
    path.write_text(path.read_text().replace("mine(status)", "mine(status, *, distance_unit_m: float)"))
    dry_run(load("s1", overrides=[SELECTED["term"]], plugin_files=[path]))


def test_an_exception_of_several_lines_is_one_error(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    plugin(path, "term", value="exec(\"raise AssertionError('one' + chr(10) + 'two')\")")
    loaded = load("s1", overrides=[SELECTED["term"]], plugin_files=[path])
    with pytest.raises(PluginError, match="one two"):
        dry_run(loaded)


@pytest.mark.filterwarnings("error")
def test_conditions_in_which_the_integration_diverges_are_located(tmp_path: Path) -> None:
    scenario = tmp_path / "storm.yaml"
    wind = "{speed_mps: 100, direction_deg: 90, lateral_area_m2: 20000}"
    scenario.write_text(f"extends: s1\nconditions:\n  wind: {wind}\n")
    with pytest.raises(InputError) as caught:
        dry_run(load(str(scenario)))
    (problem,) = caught.value.problems
    assert (problem.line, problem.field, problem.code) == (3, "conditions", "out_of_range")


def test_draws_of_a_condition_in_which_the_integration_diverges_are_located(tmp_path: Path) -> None:
    """Hardly one boat in ten meets a current with which it diverges."""
    scenario = tmp_path / "stream.yaml"
    current = "{speed_mps: [0, 10], direction_deg: [0, 360], variation_mps: 3}"
    scenario.write_text(f"extends: s1\nconditions:\n  current: {current}\n")
    with pytest.raises(InputError) as caught:
        dry_run(load(str(scenario)))
    (problem,) = caught.value.problems
    assert (problem.line, problem.field, problem.code) == (3, "conditions", "out_of_range")


def test_validate_and_train_report_the_fault_and_leave_no_run_folder(tmp_path: Path) -> None:
    path, runs = tmp_path / "mine.py", tmp_path / "runs"
    plugin(path, "term", value="1 / 0")
    selected = ("s1", "--set", SELECTED["term"], "--plugin", path)
    for outcome in (dockctl("validate", *selected), quick_train(runs, *selected)):
        assert outcome.code == 2
        assert f"({path}:5)" in outcome.err
        assert len(outcome.err.splitlines()) == 1
    assert not runs.exists()


@pytest.mark.parametrize(
    "fault",
    [
        {"points": "np.empty((5, 2))"},
        {"points": "None"},
        {"points": "np.full((5, 3), np.nan)"},
        {"ranges": "None"},
        {"ranges": "np.ones((len(eta), 3))"},
        {"ranges": "np.full((len(eta), 8), np.nan)"},
    ],
)
def test_a_sensor_whose_scan_cannot_be_drawn(fault: dict[str, str], tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    lines = plugin(path, "sensor", **fault)
    outcome = dockctl("show", "s1", "--set", SELECTED["sensor"], "--plugin", path, "--out", tmp_path / "out")
    assert outcome.code == 2
    assert f"({path}:{1 + lines.index('@register(RANGE_SENSORS)')})" in outcome.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("hook", "code"),
    [
        ("water_velocity", "def water_velocity(self): return np.inf"),
        ("air_velocity", "def air_velocity(self): return np.nan"),
        ("force", "def force(self, eta, nu): return nu * np.nan"),
        ("pose_error", "def pose_error(self): return np.nan"),
        ("velocity_error", "def velocity_error(self): return np.nan"),
        ("actuate", "def actuate(self, commands, substep_s): return commands * np.nan"),
        ("coefficient_factors", "def coefficient_factors(self): return {'mass_kg': np.full(4, np.inf)}"),
        ("reported_ranges", "def reported_ranges(self, ranges, rows, range_m): return ranges * np.nan"),
        ("water_velocity", "def water_velocity(self): return 0.3"),  # only 0 stands for an array
        ("force", "def force(self, eta, nu): return 1"),
        ("coefficient_factors", "def coefficient_factors(self): return {'max_propeller_n': np.ones(4)}"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_the_hook_whose_value_is_invalid_is_named(hook: str, code: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    plugin(path, "condition")
    path.write_text(path.read_text().replace("@register(CONDITIONS", f"    {code}\n@register(CONDITIONS"))
    with pytest.raises(PluginError, match=f"{hook}.*mine.py:"):
        dry_run(load("s1", overrides=[SELECTED["condition"]], plugin_files=[path]))


def test_a_condition_that_fails_after_the_dry_run_is_named(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    plugin(path, "condition")
    late = (
        "    def advance(self, period_s): self.t = getattr(self, 't', 0) + 1\n"
        "    def force(self, eta, nu): return nu * (np.nan if getattr(self, 't', 0) >= 100 else 0)\n"
    )
    path.write_text(path.read_text().replace("@register(CONDITIONS", f"{late}@register(CONDITIONS"))
    changes = (SELECTED["condition"], "training.stop=null", "training.total_steps=4000")
    settings = [argument for change in changes for argument in ("--set", change)]
    outcome = quick_train(tmp_path / "runs", "s1", *settings, "--plugin", path)
    assert outcome.code == 2
    assert "Water.force returned a value that is not finite" in outcome.err
    assert f"{path}:" in outcome.err


def test_a_condition_may_report_more_than_the_range_of_the_sensor(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    plugin(path, "condition")
    bias = "    def reported_ranges(self, ranges, rows, range_m): return ranges + 0.1\n"
    path.write_text(
        path.read_text().replace("class Water(Disturbance):\n", f"class Water(Disturbance):\n{bias}")
    )
    dry_run(load("s1", overrides=[SELECTED["condition"]], plugin_files=[path]))


def test_an_algorithm_that_fails_later_is_one_error_that_names_it(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    lines = plugin(path, "algorithm", learn="yield {'loss': 1.0} if env_steps < 40 else {}")
    outcome = quick_train(tmp_path / "runs", "s1", "--set", SELECTED["algorithm"], "--plugin", path)
    assert outcome.code == 2
    assert f"({path}:{1 + lines.index('@register(ALGORITHMS)')})" in outcome.err
    assert len(outcome.err.splitlines()) == 1


@pytest.mark.parametrize(
    ("algorithm", "actions", "field", "suggestion"),
    [
        ("{kind: dqn}", "continuous", "actions", None),
        ("{kind: sb3, model: SAC}", "grid", "training.algorithm", None),
        ("{kind: sb3, model: DQM}", "grid", "training.algorithm.model", "DQN"),
        (
            "{kind: sb3, hyperparameters: {lerning_starts: 1}}",
            "grid",
            "training.algorithm.hyperparameters.lerning_starts",
            "learning_starts",
        ),
    ],
)
def test_an_algorithm_that_does_not_fit_is_located(
    tmp_path: Path, algorithm: str, actions: str, field: str, suggestion: str | None
) -> None:
    if "sb3" in algorithm:
        pytest.importorskip("stable_baselines3")
    scenario = tmp_path / "mine.yaml"
    scenario.write_text(f"extends: s1\nactions: {actions}\ntraining:\n  algorithm: {algorithm}\n")
    with pytest.raises(InputError) as caught:
        dry_run(load(str(scenario)))
    (problem,) = caught.value.problems
    assert (problem.line, problem.field) == (2 if field == "actions" else 4, field)
    assert suggestion in (None, problem.suggestion)


def test_an_algorithm_that_cannot_learn_from_mirror_images() -> None:
    changes = ["training.algorithm.kind=sb3", "training.mirrored=true", "training.replay_capacity=1000"]
    loaded = load("s1", overrides=changes)
    spaces = Spaces(Box(-1, 1, (15,)), Discrete(77))
    with pytest.raises(InputError) as caught:
        build_algorithm(loaded, spaces, 1, "cpu")
    assert caught.value.problems[0].file == "--set training.mirrored"


def test_a_replay_that_cannot_be_allocated_is_located(monkeypatch: pytest.MonkeyPatch) -> None:
    def allocate(*_: object) -> None:
        raise MemoryError("Unable to allocate 127 GiB")

    monkeypatch.setattr("dockctl.agents.dqn.algorithm.Replay", allocate)
    loaded = load("s1", overrides=["training.replay_capacity=999999999"])
    spaces = Spaces(Box(-1, 1, (2,)), Discrete(3))
    with pytest.raises(InputError) as caught:
        build_algorithm(loaded, spaces, 2, "cpu")
    (problem,) = caught.value.problems
    assert (problem.file, problem.code) == ("--set training.replay_capacity", "unavailable")
