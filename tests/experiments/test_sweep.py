"""Sweeps: which combinations several values give, how they are named, and what is refused."""

from __future__ import annotations

import pytest

from dockctl.errors import DockctlError
from dockctl.experiments.sweep import experiments, values


@pytest.mark.parametrize(
    ("setting", "found"),
    [
        ("a=1", ["a=1"]),
        ("a=1,2", ["a=1", "a=2"]),
        ("a=[1,2]", ["a=[1,2]"]),
        ("a=[1,2], [3,[4,5]]", ["a=[1,2]", "a=[3,[4,5]]"]),
        ("a={x: 1, y: 2}", ["a={x: 1, y: 2}"]),
        ('a="1,2"', ['a="1,2"']),
        ("a='x,y',z", ["a='x,y'", "a=z"]),
        ("a=don't,b", ["a=don't", "a=b"]),
    ],
)
def test_only_commas_outside_of_brackets_and_quotes_separate_values(setting: str, found: list[str]) -> None:
    assert values(setting) == found


def test_every_combination_is_an_experiment_of_its_own_name() -> None:
    chosen = experiments("s1", ["training.boats=2,4", "training.n_step=1", "training.gamma=0.9,0.99"], 3)
    assert [experiment.name for experiment in chosen] == [
        "boats-2_gamma-0.9", "boats-2_gamma-0.99", "boats-4_gamma-0.9", "boats-4_gamma-0.99",
    ]  # fmt: skip
    assert chosen[1].set == ("training.boats=2", "training.n_step=1", "training.gamma=0.99")
    assert {experiment.seeds for experiment in chosen} == {3}
    (single,) = experiments("s1", ["training.boats=2"], 2)
    assert single.name == "all"


def test_names_that_would_be_the_same_are_numbered() -> None:
    names = [experiment.name for experiment in experiments("s1", ["task.x=[1,2],[1 2],3"], 1)]
    assert len({*names}) == 3


def test_names_are_those_of_folders() -> None:
    """A name has letters, digits, dots, dashes and underscores of ASCII."""
    names = [experiment.name for experiment in experiments("s1", ["harbor=bahía.yaml,küste.yaml"], 1)]
    assert names == ["harbor-bah-a.yaml", "harbor-k-ste.yaml"]


@pytest.mark.parametrize("setting", ["a=1,", "a=1,1", f"a={','.join(map(str, range(1001)))}"])
def test_lists_that_are_refused(setting: str) -> None:
    with pytest.raises(DockctlError) as caught:
        experiments("s1", [setting], 1)
    assert str(caught.value).startswith("--set")
