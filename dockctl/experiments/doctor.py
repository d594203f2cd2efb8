"""Describe this installation for a bug report, and find problems with it."""

from __future__ import annotations

import os
import shutil
import sys
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import platformdirs
from packaging.requirements import Requirement

import dockctl
from dockctl.agents.tensors import devices
from dockctl.compute import cache_folder
from dockctl.run_files import RUNS
from dockctl.runs import provenance
from dockctl.runs.listing import size_of
from dockctl.sim.devices import gpu_problem
from dockctl.trust import state_folder

FREE_BYTES = 2_000_000_000
"""Free space below which a typical training run may fill the disk."""


@dataclass(frozen=True)
class Report:
    """Facts by section, and the problems found, each with a fix."""

    sections: dict[str, dict[str, str]]
    problems: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Return plain data."""
        return {**self.sections, "problems": list(self.problems)}

    def markdown(self) -> str:
        """Return a page for a bug report."""
        lines = ["# dockctl doctor"]
        for title, facts in self.sections.items():
            lines += ["", f"## {title}", "", "| | |", "| --- | --- |"]
            lines += [f"| {name} | {value} |" for name, value in facts.items()]
        lines += ["", "## Problems", "", *(f"- {problem}" for problem in self.problems or ("none found",))]
        return "\n".join(lines) + "\n"


def examine() -> Report:
    """Examine versions, machine, folders and extras."""
    hardware, problems = provenance.hardware(), list[str]()
    machine = {name.replace("_", " "): str(value) for name, value in hardware.items()}
    names = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
    threads = {"threads": f"{hardware['usable_cores']}, one for each usable core"}
    threads |= {name: os.environ[name] for name in names if name in os.environ}
    machine |= {"devices": ", ".join(devices()), **threads}
    machine["simulation on a GPU"] = gpu_problem() or "yes"
    sections = {
        "Versions": _versions(),
        "Machine": machine,
        "Folders": _folders(problems),
        "Extras": _extras(),
    }
    if hardware["usable_cores"] < 2:
        problems.append("one usable core: training takes about twice as long; give the process two cores")
    return Report(sections, tuple(problems))


def _versions() -> dict[str, str]:
    commit = provenance.git_commit()
    libraries = {name: version for name in provenance.LIBRARIES if (version := _version(name))}
    return {
        "dockctl": f"{dockctl.__version__} ({commit})" if commit else dockctl.__version__,
        "installed in": str(Path(dockctl.__file__).parent),
        "Python": sys.version.split()[0],
        **libraries,
    }


def _folders(problems: list[str]) -> dict[str, str]:
    """Return the folders in use, with their size; append their problems."""
    package = Path(dockctl.__file__).parent
    beside = package if os.access(package, os.W_OK) else platformdirs.user_cache_path("numba")
    compiled = Path(os.environ.get("NUMBA_CACHE_DIR", beside))
    checked = {
        "cache of tables": (cache_folder(), "set XDG_CACHE_HOME to a writable folder"),
        "cache of compiled code": (compiled, "set NUMBA_CACHE_DIR to a writable folder"),
        "trusted code": (state_folder(), "set XDG_STATE_HOME to a writable folder"),
        "runs": (RUNS.absolute(), "change to another folder, or train with --out"),
    }
    found = {}
    for name, (folder, fix) in checked.items():
        place = next(path for path in (folder, *folder.parents) if os.path.exists(path))
        writable = os.path.isdir(place) and os.access(place, os.W_OK | os.X_OK)
        if not writable:
            problems.append(f"{name}: {folder} cannot be written: {fix}")
        free = shutil.disk_usage(place).free
        if writable and free < FREE_BYTES:
            problems.append(f"{name}: {free / 1e9:.1f} GB left on the disk of {folder}: free some space")
        used = sum(map(size_of, folder.rglob("*.nb[ci]"))) if folder == compiled else size_of(folder)
        size = f"{used / 1e6:,.1f} MB" if folder.is_dir() else "does not exist yet"
        found[name] = f"{folder}: {size}, {'writable' if writable else 'NOT writable'}"
    return found


def _extras() -> dict[str, str]:
    """Return, for each extra of the package, its installed libraries or how to install it."""
    try:
        distribution = metadata.distribution("dockctl")
    except metadata.PackageNotFoundError:
        return {"dockctl": "not installed as a package: extras are unknown"}
    requirements = [Requirement(text) for text in distribution.requires or ()]
    found = {}
    for extra in distribution.metadata.get_all("Provides-Extra") or ():
        needed = [r for r in requirements if r.marker and r.marker.evaluate({"extra": extra})]
        others = [r for r in needed if r.name != "dockctl"]
        missing = [r.name for r in others if _version(r.name) is None]
        install = f"missing {', '.join(missing)}: pip install 'dockctl[{extra}]'"
        found[extra] = install if missing else ", ".join(f"{r.name} {_version(r.name)}" for r in others)
    return found


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
