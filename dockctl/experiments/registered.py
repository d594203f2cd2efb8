"""What is registered, and by whom, as rows of a table."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dockctl import plugins
from dockctl.console import count
from dockctl.errors import DockctlError
from dockctl.reading import reading

if TYPE_CHECKING:
    from dockctl.registry import Entry
    from dockctl.scenarios.harbor import HarborSpec
    from dockctl.scenarios.schema import Scenario

COLUMNS = ("listing", "name", "kind", "description", "parameters", "source", "origin")
CHECKPOINTS = "checkpoints"
LISTINGS = (*(group.removeprefix("dockctl.") for group in (*plugins.DATA, *plugins.CODE)), CHECKPOINTS)

Row = tuple[str, ...]
"""Values of `COLUMNS` except the first."""


def rows_of(listing: str) -> list[Row]:
    """Return the rows of one of `LISTINGS`, sorted by name; an entry that cannot be loaded is ``broken``."""
    return list(_checkpoints() if listing == CHECKPOINTS else _registered(listing))


def _registered(listing: str) -> Iterator[Row]:
    group = f"dockctl.{listing}"
    registry = plugins.GROUPS[group]
    for name in sorted(registry.names()):
        origin = registry.origin(name)
        try:
            entry = registry.get(name)
            described = _describe_file(entry.value, listing) if group in plugins.DATA else _describe(entry)
            yield name, *described, origin
        except DockctlError as error:
            yield name, "broken", str(error), "", "", origin


def _checkpoints() -> Iterator[Row]:
    from dockctl.run_files import POLICY_JSON, SCENARIO
    from dockctl.runs.directory import RunDirectory, named_checkpoints, shipped
    from dockctl.scenarios import loader

    for name, folder in named_checkpoints().items():
        origin = "dockctl" if name in shipped() else f"folder {folder}"
        try:
            facts = RunDirectory(folder).read_json(POLICY_JSON)
            with reading(folder / POLICY_JSON):
                training = f"seed {facts['seed']}, {facts['env_steps']:,} steps"
                size = f"{facts['observation_size']} numbers to {facts['actions']} actions"
        except DockctlError as error:
            yield name, "broken", str(error), "", "", origin
            continue
        try:
            title = loader.load(folder / SCENARIO).scenario.title
        except DockctlError as error:  # for example because it has plugins that may not run
            title = str(error).splitlines()[0]
        yield name, "policy", title, f"{training}, {size}", "", origin


def _describe(entry: Entry[Any]) -> tuple[str, str, str, str]:
    """Return kind, description, parameters and source of a function or a model."""
    parameters = [
        name if default is inspect.Parameter.empty else f"{name}={_short(default)}"
        for name, default in entry.parameters.items()
        if name != "kind"
    ]
    documentation = inspect.cleandoc(entry.value.__doc__ or "")  # not that of a base class
    return entry.kind, documentation.partition("\n")[0], ", ".join(parameters), entry.source


def _short(default: Any) -> str:
    text = str(default)
    return f"({len(default)} values)" if isinstance(default, tuple) and len(text) > 40 else text


def _describe_file(path: Path, listing: str) -> tuple[str, str, str, str]:
    from dockctl.scenarios import catalog, loader

    shown = catalog.display_path(path)
    if listing == "scenarios":
        scenario = loader.load(path).scenario
        return phases(scenario), scenario.title, _place(scenario), shown
    if listing == "vessels":
        vessel = loader.load_vessel(path)
        size = f"{vessel.hull.length_m:g} x {vessel.hull.beam_m:g} m, {vessel.mass_kg:g} kg"
        return "3-DOF", size, "", shown
    harbor = loader.load_harbor(path)
    return harbor.kind, _size(harbor), "", shown


def _size(harbor: HarborSpec) -> str:
    """Return a one-line description of a harbor."""
    from dockctl.scenarios.harbor import Generated, Marina

    if isinstance(harbor, Marina):
        basin, berths = harbor.basin, count(len(harbor.berths), "berth")
        sides = basin.x_max_m - basin.x_min_m, basin.y_max_m - basin.y_min_m
        return f"{sides[0]:g} x {sides[1]:g} m, {count(len(harbor.rows), 'row')}, {berths}"
    if isinstance(harbor, Generated):
        return f"{count(harbor.layouts, 'layout')} for training, {harbor.held_out_layouts} held out"
    return count(len(harbor.meshes), "mesh file")


def phases(scenario: Scenario) -> str:
    """Return the number of phases in words: two with an intermediate pose."""
    return "two phases" if scenario.task.intermediate else "one phase"


def summary(scenario: Scenario) -> str:
    """Return a one-line summary of a scenario."""
    starts = count(len(scenario.task.initial), "start")
    parts = count(len(scenario.observation), "observation part")
    terms = count(len(scenario.reward.terms), "reward term")
    boats = count(scenario.training.boats, "boat")
    return f"{starts}, {parts}, {terms}; {_place(scenario)}, {boats} in training"


def _place(scenario: Scenario) -> str:
    return f"{scenario.vessel.name} in {scenario.harbor.name}"
