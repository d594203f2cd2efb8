"""A study: which scenarios are trained, how often, with what changed, and what is measured afterwards."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, ValidationError, model_validator

from dockctl.errors import DockctlError, InputError, nearest
from dockctl.scenarios import translate
from dockctl.scenarios.base import Count, Model, Name
from dockctl.scenarios.catalog import SUFFIXES, packaged, shown
from dockctl.scenarios.yaml_tree import read_file

Probe = Literal["map", "latency", "returns"]


class Experiment(Model):
    """One scenario, trained with the seeds 0 to `seeds` - 1.

    Attributes:
        group: experiments that are asked for, and shown, together.
        title: what is special about it, in a few words.
        set: values that are changed, ``key=value`` as after ``--set``.
        evaluate_on: other scenarios that the trained policies are tried on.
        probes: what else is measured of every policy.
    """

    name: Name
    group: Name
    title: str = ""
    scenario: str
    seeds: Annotated[Count, Field(le=1000)] = 1
    set: tuple[str, ...] = ()
    evaluate_on: tuple[str, ...] = ()
    probes: tuple[Probe, ...] = ()

    def overrides(self, seed: int) -> list[str]:
        """What makes the scenario that of one training."""
        return [*self.set, f"training.seed={seed}"]


class Study(Model):
    """Experiments in the order in which they are made and shown."""

    title: str = ""
    experiments: tuple[Experiment, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _own_names(self) -> Self:
        names = [experiment.name for experiment in self.experiments]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"several experiments are called {', '.join(twice)}")
        return self

    def chosen(self, names: Sequence[str]) -> tuple[Experiment, ...]:
        """Return the experiments called, or in a group called, one of `names`; all where there are none.

        Raises:
            DockctlError: nothing is called so.
        """
        known = {name for experiment in self.experiments for name in (experiment.name, experiment.group)}
        for name in names:
            if name not in known:
                message = f"the study has no experiment or group '{name}' (known: {', '.join(sorted(known))})"
                raise DockctlError(message, code="unknown_name", suggestion=nearest(name, known))
        return tuple(e for e in self.experiments if not names or {e.name, e.group} & {*names})


def load_study(source: str) -> Study:
    """Load the study file `source`, or the packaged study of that name.

    Raises:
        InputError: every problem of the file, each with its place.
        DockctlError: there is no such study.
    """
    path = Path(source)
    if path.suffix not in SUFFIXES and not os.path.isfile(path):
        known = {file.stem: file for file in packaged("studies", "studies").glob("*.yaml")}
        if source not in known:
            message = f"there is no study '{source}' (known: {', '.join(sorted(known))})"
            raise DockctlError(message, code="unknown_name", suggestion=nearest(source, known))
        path = known[source]
    tree = read_file(path, shown(path))
    try:
        return Study.model_validate(tree.plain())
    except ValidationError as error:
        raise InputError(translate.problems(error, tree, Study)) from None
