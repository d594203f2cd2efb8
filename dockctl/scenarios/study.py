"""A study: which scenarios are trained, with how many seeds and which settings, and what is measured."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, ValidationError, model_validator

from dockctl.errors import DockctlError, InputError, nearest
from dockctl.scenarios import translate
from dockctl.scenarios.base import NAME, Count, FieldError, Model, Name
from dockctl.scenarios.catalog import SUFFIXES, display_path, packaged_folder
from dockctl.scenarios.yaml_tree import input_error, read_file

Probe = Literal["map", "latency", "returns"]


class Experiment(Model):
    """One scenario, trained with the seeds 0 to `seeds` - 1.

    Attributes:
        group: name that selects several experiments together.
        title: short description.
        set: overrides, ``key=value`` as after ``--set``.
        evaluate_on: other scenarios to evaluate the trained policies on.
        probes: further measurements of every policy.
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
        """Overrides that turn the scenario into that of one training."""
        return [*self.set, f"training.seed={seed}"]


class Study(Model):
    """Experiments in the order in which they run.

    Attributes:
        name: folder of its runs and results; by default the name of the file.
    """

    name: Name = "study"
    title: str = ""
    experiments: tuple[Experiment, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _unique_names(self) -> Self:
        names: set[str] = set()
        for index, experiment in enumerate(self.experiments):
            if experiment.name in names:
                field = f"experiments.{index}.name"
                raise FieldError(field, f"another experiment is named {experiment.name}", "duplicate")
            names.add(experiment.name)
        return self

    def chosen(self, names: Sequence[str]) -> tuple[Experiment, ...]:
        """Return the experiments that `names` select by name or group; all where it is empty.

        Raises:
            DockctlError: a name is unknown.
        """
        known = {name for experiment in self.experiments for name in (experiment.name, experiment.group)}
        for name in names:
            if name not in known:
                message = f"the study has no experiment or group '{name}' (known: {', '.join(sorted(known))})"
                raise DockctlError(message, code="unknown_name", suggestion=nearest(name, known))
        return tuple(e for e in self.experiments if not names or {e.name, e.group} & {*names})


def load_study(source: str) -> Study:
    """Load a study file, or a packaged study by name.

    Raises:
        InputError: every problem of the file, each with its location.
        DockctlError: the study is unknown, or its name cannot be used.
    """
    path = Path(source)
    known = {file.parent.name: file for file in packaged_folder("studies", "studies").glob("*/study.yaml")}
    if path.suffix not in SUFFIXES and not os.path.isfile(path):
        if source not in known:
            message = f"there is no study '{source}' (known: {', '.join(sorted(known))})"
            raise DockctlError(message, code="unknown_name", suggestion=nearest(source, known))
        path = known[source]
    tree = read_file(path, display_path(path))
    try:
        study = Study.model_validate(tree.plain())
    except ValidationError as error:
        raise InputError(translate.problems(error, tree, Study)) from None
    name = study.name if "name" in study.model_fields_set else path.stem
    location = (tree.get("name") or tree).location
    if not re.fullmatch(NAME, name):
        message = f"'{name}' cannot be a folder name; set letters, digits, dots, dashes and underscores"
        raise input_error(location, message, "name")
    if name in known and path.resolve() != known[name].resolve():
        message = f"'{name}' is a packaged study, whose results would be replaced; set another name"
        raise input_error(location, message, "name", "duplicate")
    return study.model_copy(update={"name": name})
