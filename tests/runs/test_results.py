"""Results of a command: a file that is torn, stale or of other results is found."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from dockctl.errors import DockctlError
from dockctl.runs.results import (
    file_stem,
    is_outdated,
    read_results,
    require_same_policy,
    result_stem,
    write_measurement,
    write_results,
)


def code_of(path: Path) -> str:
    with pytest.raises(DockctlError) as caught:
        read_results(path)
    return caught.value.code


def test_long_settings_that_differ_have_different_names() -> None:
    settings = [f"conditions.wind.speed_mps={speed}" for speed in range(4)]
    stems = {result_stem("evaluation", "s1", [*settings, f"task.max_steps={last}"]) for last in (3, 30, 300)}
    assert len(stems) == 3
    assert all(stem.startswith("evaluation-s1-conditions.wind.speed_mps=0-") for stem in stems)
    folder = file_stem(["s1"], settings * 9)
    assert max(map(len, [folder, *stems])) <= 150
    assert result_stem("evaluation", "", ["task.max_steps=5"]) == "evaluation-task.max_steps=5"


def test_a_table_and_its_facts_belong_together(tmp_path: Path) -> None:
    stem = tmp_path / "evaluation-s1-task.max_steps=5"
    csv, facts = write_measurement(stem, "a\n1\n", {"seed": 1})
    assert {path.name for path in tmp_path.iterdir()} == {f"{stem.name}.csv", f"{stem.name}.json"}
    assert read_results(facts)["seed"] == 1
    first = facts.read_bytes()
    write_measurement(stem, "a\n2\n", {"seed": 2})
    assert read_results(facts)["seed"] == 2
    facts.write_bytes(first)  # as if the second command was killed between its two files
    assert code_of(facts) == "mismatch"
    csv.unlink()
    assert code_of(facts) == "not_found"
    facts.write_text("{}")
    assert code_of(facts) == "missing_key"
    facts.write_text('{"files"')
    assert code_of(facts) == "not_readable"


def test_results_move_with_their_files(tmp_path: Path) -> None:
    run = tmp_path / "run"
    (run / "figures").mkdir(parents=True)
    (run / "episodes.csv").touch()
    write_results(run / "figures" / "figures.json", {}, {run / "episodes.csv": "0"})
    assert set(json.loads((run / "figures" / "figures.json").read_text())["files"]) == {"../episodes.csv"}


@pytest.mark.parametrize(
    ("policy", "same"),
    [
        ({"file": "x", "sha256": "1"}, True),  # moved
        ({"file": "a", "sha256": "2"}, True),  # trained further
        ({"file": "x", "sha256": "2"}, False),
        ({"name": "a.py:make"}, False),
    ],
)
def test_only_results_of_the_same_policy_are_replaced(
    tmp_path: Path, policy: dict[str, str], same: bool
) -> None:
    require_same_policy(tmp_path / "map.json", policy)
    _, facts = write_measurement(tmp_path / "map", "", {"policy": {"file": "a", "sha256": "1"}})
    if same:
        require_same_policy(facts, policy)
    else:
        with pytest.raises(DockctlError) as caught:
            require_same_policy(facts, policy)
        assert caught.value.code == "mismatch"


def test_damaged_facts_of_results_are_an_error(tmp_path: Path) -> None:
    assert not is_outdated(tmp_path, "evaluation.json")
    (tmp_path / "evaluation.json").write_text('{"policy": ')
    with pytest.raises(DockctlError) as caught:
        is_outdated(tmp_path, "evaluation.json")
    assert caught.value.code == "not_readable"
    assert str(tmp_path / "evaluation.json") in caught.value.message
