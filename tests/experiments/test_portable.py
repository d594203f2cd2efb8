"""ONNX models and pilot files: the same decisions, the same description, and what cannot be exported."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dockctl.dueling import Ensemble
from dockctl.envs.observation import Columns, ObservationEncoder, View, observation_part
from dockctl.errors import DockctlError
from dockctl.evaluation import load_policy
from dockctl.evaluation.policies import CheckpointPolicy
from dockctl.experiments.portable import description, export_files, onnx_model, pilot_file
from dockctl.pilot import Pilot, Reading
from dockctl.runs.directory import shipped
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import ObservationPart
from tests.commands.conftest import dockctl


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    pytest.importorskip("onnx")
    folder = tmp_path_factory.mktemp("portable")
    assert dockctl("export", "s3", "--onnx", folder / "s3.onnx", "--pilot", folder / "s3.npz").code == 0
    return folder / "s3.onnx", folder / "s3.npz"


def view(n: int, sectors: int, past: int) -> View:
    """Random states, within and beyond the bounds of the observation, each with earlier ones."""
    rng = np.random.default_rng(past)
    return View(
        phase=rng.integers(0, 2, n),
        distance_m=rng.uniform(0, 120, n),
        heading_error_rad=rng.uniform(-np.pi, np.pi, n),
        eta=rng.uniform(-3, 3, (n, 3)),
        goal=rng.uniform(-3, 3, (n, 3)),
        nu=rng.normal(size=(n, 3)) * [0.4, 0.1, 0.04],
        command=np.column_stack([rng.integers(-5, 6, n) * 10, np.radians(rng.integers(-3, 4, n) * 10)]),
        command_limit=np.array([50, np.radians(30)]),
        sector_ranges_m=rng.uniform(0, 30, (n, sectors)),
        apparent_wind=rng.normal(size=(n, 2)) * 5,
        through_water=rng.normal(size=(n, 2)) * [0.4, 0.1],
        past=tuple(view(n, sectors, earlier) for earlier in range(past)),
    )


@pytest.mark.parametrize("name", ["s3", "marina", "marinas", "marinas-weather"])
def test_an_onnx_model_takes_units_and_gives_the_command(name: str) -> None:
    """One network, one with its mirror image, ensembles, and one with hysteresis."""
    runtime = pytest.importorskip("onnxruntime")
    policy = load_policy(name)
    assert isinstance(policy, CheckpointPolicy)
    assert (len(Ensemble.of(policy.tensors).networks) > 1) == name.startswith("marinas")
    scenario = load(policy.own_scenario).scenario
    session = runtime.InferenceSession(onnx_model(policy, scenario), providers=["CPUExecutionProvider"])
    encoder = ObservationEncoder(scenario.observation, scenario.sensors.lidar.sectors)
    states = view(300, scenario.sensors.lidar.sectors, encoder.past_steps)
    raw = np.hstack([columns.values for columns in encoder.columns(states)]).astype(np.float32)
    names = [output.name for output in session.get_outputs()]
    outputs = dict(zip(names, session.run(None, {"observation": raw}), strict=True))
    networks, observed = Ensemble.of(policy.tensors), encoder(states)
    assert outputs["q_values"] == pytest.approx(networks.q_values(observed), rel=1e-4, abs=2e-3)
    assert (outputs["action"] == networks.greedy(observed, outputs["q_values"])).all()
    kept = outputs["action"] != outputs["q_values"].argmax(axis=1)
    assert kept.any() == (name == "marinas")
    facts = json.loads(session.get_modelmeta().custom_metadata_map["description"])
    assert facts == description(policy, scenario)
    commands = np.array(facts["commands"])[outputs["action"]]
    found = np.stack([outputs["propeller_n"], outputs["rudder_rad"]], axis=1)
    assert found == pytest.approx(commands, rel=1e-6)
    assert [column["name"] for column in facts["observation"]] == list(encoder.names)


@pytest.mark.parametrize("name", sorted(shipped()))
def test_every_shipped_policy_runs_on_a_pilot(name: str, tmp_path: Path) -> None:
    export_files([Path(name)], None, tmp_path / "policy.npz")
    pilot = Pilot.load(tmp_path / "policy.npz")
    now = {
        key: Reading(0.0, value)
        for key, value in (("pose", pilot.goals[1] + [3, 0, 0]), ("velocity", np.zeros(3)))
    }
    flows = {flow: Reading(0.0, (0.1, 0.0)) for flow in pilot.flows}
    clouds = {"all": Reading(0.0, [[5.0, 1.0, 0.5]])}
    assert pilot.decide(0.0, **now, clouds=clouds, **flows).action is not None


@pytest.mark.slow
def test_an_exported_model_docks_like_its_policy(files: tuple[Path, Path], tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    tables = []
    for number, policy in enumerate((files[0], "s3")):
        csv = tmp_path / f"{number}.csv"
        outcome = dockctl("evaluate", policy, "--scenario", "s3", "--episodes", 0, "--csv", csv)
        assert outcome.code == 0, outcome.err
        tables.append(csv.read_text())
    assert tables[0] == tables[1]


def test_the_same_policy_is_the_same_file(files: tuple[Path, Path], tmp_path: Path) -> None:
    export_files([Path("s3")], tmp_path / "again.onnx", tmp_path / "again.npz")
    assert (tmp_path / "again.onnx").read_bytes() == files[0].read_bytes()
    assert (tmp_path / "again.npz").read_bytes() == files[1].read_bytes()


def test_what_cannot_be_exported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def code_of(*names: str, onnx: str = "", pilot: str = "") -> str:
        files = [tmp_path / name if name else None for name in (onnx, pilot)]
        with pytest.raises(DockctlError) as caught:
            export_files([Path(name) for name in names], *files)
        assert list(tmp_path.iterdir()) == []
        return caught.value.code

    assert code_of("s1", "s2", pilot="both.npz") == "invalid"
    assert code_of("s1", pilot="policy.onnx") == "invalid"
    assert code_of("nowhere", pilot="policy.npz") == "not_found"
    assert code_of("s1", pilot="none/policy.npz") == "not_writable"
    monkeypatch.setitem(sys.modules, "onnx", None)
    assert code_of("s1", onnx="policy.onnx", pilot="policy.npz") == "unavailable"
    outcome = dockctl("export", "s1", "--pilot", tmp_path / "policy.npz", "--name", "mine")
    assert (outcome.code, outcome.error_code) == (2, "invalid")


def test_an_observation_that_the_pilot_does_not_compute() -> None:
    @observation_part("knots")
    def knots(view: View) -> Columns:
        return Columns(["knots"], view.nu[:, :1], -10, 10, 0.5144, ["m/s"])

    policy = load_policy("s1")
    assert isinstance(policy, CheckpointPolicy)
    earlier = ObservationPart(part="history", params={"parts": ("velocity", "knots")})
    for part in (earlier, ObservationPart(part="knots")):
        scenario = load("s1").scenario.model_copy(update={"observation": (part,)})
        with pytest.raises(DockctlError) as caught:
            pilot_file(policy, scenario)
        assert caught.value.code == "unavailable"
        assert "knots" in str(caught.value)
    (column,) = description(policy, scenario)["observation"]
    assert column == {"name": "knots", "unit": "m/s", "scale": 0.5144, "low": -10.0, "high": 10.0}


def test_another_algorithm_cannot_be_exported() -> None:
    policy = load_policy("s1")
    assert isinstance(policy, CheckpointPolicy)
    other = replace(
        policy,
        tensors={f"q_net.{name}": array for name, array in policy.tensors.items()},
        card=policy.card.model_copy(update={"algorithm": {"kind": "sb3"}}),
    )
    for encode in (onnx_model, pilot_file):
        with pytest.raises(DockctlError, match="'sb3'") as caught:
            encode(other, policy.scenario().scenario)
        assert caught.value.code == "unavailable"
