"""The mesh files of the moored vessels: what a vessel must be, how they are read, how they are generated."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dockctl.drawing.palette import SOLIDS
from dockctl.errors import InputError
from dockctl.scenarios.content import first_difference, mesh_files, with_paths
from dockctl.scenarios.harbor import DEFAULT_MODELS, VESSEL_MODELS
from dockctl.scenarios.loader import dump, load
from dockctl.sim.checks import load_checked
from dockctl.sim.harbor.build import build_harbor
from dockctl.sim.harbor.mesh_files import MooredModel, moored_model, read_model
from tests.sim.meshes import peer

ROOT = Path(__file__).parents[3]
BOX = """# barge
o 01-cabin.001
v 1 -0.5 0
v 3 -0.5 0
v 3 0.5 0
v 1 0.5 0
v 2 0 1
f 4 3 2 1
f 1 2 5
f 2/1 3/2 5/3
f 3 4 5
f 4 1 5
o 00-hull
v 0.5 0 0
v 4 0 0
v 4 1 0
v 4 0 1
f 6 8 7
f 6 7 9
f 7 8 9
f 8 6 9
"""


@pytest.fixture(params=DEFAULT_MODELS)
def model(request: pytest.FixtureRequest) -> MooredModel:
    return moored_model(request.param)


def test_every_piece_is_a_closed_solid_facing_outwards(model: MooredModel) -> None:
    for solid in model.solids:
        assert solid.mesh.is_watertight and peer(solid.mesh).is_watertight
        assert peer(solid.mesh).is_winding_consistent
        assert peer(solid.mesh).volume > 0
        assert solid.kind in SOLIDS
    assert model.mesh.is_watertight


def test_models_have_the_size_of_their_class(model: MooredModel) -> None:
    assert 500 <= len(model.mesh.faces) <= 3000
    assert 5.0 <= model.mesh.extents[0] <= 10.0
    assert 1.6 <= model.beam_m <= 3.4
    assert model.mesh.bounds[1, 2] <= 12.0


def test_models_float_upright_around_their_center_line_with_the_stern_at_zero(model: MooredModel) -> None:
    low, high = model.mesh.bounds
    assert low[0] == pytest.approx(0.0, abs=1e-12)
    assert low[1] == pytest.approx(-high[1], abs=1e-3)
    assert low[2] < 0.0 < high[2]


@pytest.mark.parametrize(
    ("vessel_class", "count"), [("open boat", 3), ("sailing boat", 4), ("motor yacht", 3)]
)
def test_classes_of_the_appendix(vessel_class: str, count: int) -> None:
    classes = [moored_model(name).vessel_class for name in DEFAULT_MODELS]
    assert classes.count(vessel_class) == count


def test_only_sailing_boats_have_masts() -> None:
    tall = {name for name in DEFAULT_MODELS if moored_model(name).mesh.bounds[1, 2] > 7.0}
    assert tall == {"dinghy", "daysailer", "sloop", "cruiser", "catamaran"}


def test_the_files_are_those_of_the_generator(tmp_path: Path) -> None:
    """Bit for bit where NumPy's power uses AVX-512; others round some last bits differently."""
    rounding_m = 0.0 if "avx512vl" in Path("/proc/cpuinfo").read_text() else 1e-14
    script = ROOT / "tools" / "vessels" / "generate.py"
    subprocess.run([sys.executable, script, tmp_path], check=True, env={"PYTHONPATH": str(ROOT)})
    assert {file.name for file in tmp_path.iterdir()} == {file.name for file in VESSEL_MODELS.iterdir()}
    for file in tmp_path.iterdir():
        generated, packaged = read_model(file), read_model(VESSEL_MODELS / file.name)
        assert generated.vessel_class == packaged.vessel_class
        for ours, theirs in zip(generated.solids, packaged.solids, strict=True):
            assert ours.kind == theirs.kind
            np.testing.assert_array_equal(ours.mesh.faces, theirs.mesh.faces)
            np.testing.assert_allclose(ours.mesh.vertices, theirs.mesh.vertices, rtol=0, atol=rounding_m)


def test_a_file_from_another_program(tmp_path: Path) -> None:
    file = tmp_path / "barge.obj"
    file.write_text(BOX)
    model = read_model(file)
    assert model.vessel_class == "barge"
    assert [solid.kind for solid in model.solids] == ["hull", "cabin"]
    hull, cabin = (peer(solid.mesh) for solid in model.solids)
    assert cabin.volume == pytest.approx(2 / 3)  # a pyramid with a quadrilateral as its base
    assert hull.volume == pytest.approx(3.5 / 6)
    assert model.mesh.bounds[:, 0].tolist() == [0.0, 3.5]
    assert model.beam_m == 1.5


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("v 2 0 1\n", "v 2 0\n", 7),
        ("v 2 0 1\n", "v 2 0 nan\n", 7),
        ("v 2 0 1\n", "v 2 0 high\n", 7),
        ("f 1 2 5\n", "f 1 2 6\n", 9),
        ("f 1 2 5\n", "f 1 2 0\n", 9),
        ("f 1 2 5\n", "f 1 2\n", 9),
        ("o 00-hull\n", "o\n", 13),
        ("f 6 8 7\nf 6 7 9\nf 7 8 9\nf 8 6 9\n", "", 0),
        (BOX, "", 0),
    ],
)
def test_a_damaged_file_is_reported_with_its_line(tmp_path: Path, old: str, new: str, line: int) -> None:
    assert old in BOX
    file = tmp_path / "barge.obj"
    file.write_text(BOX.replace(old, new))
    with pytest.raises(InputError) as error:
        read_model(file)
    (problem,) = error.value.problems
    assert (problem.file, problem.line, problem.code) == (str(file), line, "not_readable")


def test_a_file_in_the_folder_is_a_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dockctl.scenarios.harbor.VESSEL_MODELS", tmp_path)
    monkeypatch.setattr("dockctl.sim.harbor.mesh_files.VESSEL_MODELS", tmp_path)
    (tmp_path / "barge.obj").write_text(BOX)
    load("s1", overrides=["harbor.fleet.models=[barge]"])
    assert moored_model("barge").vessel_class == "barge"


def test_a_fleet_of_a_local_file_is_self_contained(tmp_path: Path) -> None:
    """The file is found relative to the scenario, listed for copying, and compared by its content."""
    (tmp_path / "barge.obj").write_text(BOX)
    (tmp_path / "mine.yaml").write_text("extends: s1\nharbor: {fleet: {models: [./barge.obj, skiff]}}\n")
    loaded = load_checked(tmp_path / "mine.yaml")
    assert mesh_files(loaded.scenario) == (tmp_path / "barge.obj",)
    harbor = build_harbor(loaded.scenario.harbor, loaded.base_dir)
    assert {part.name.split(",")[0] for part in harbor.parts if part.kind == "vessel"} == {
        "moored barge",
        "moored open boat",
    }
    (tmp_path / "copy").mkdir()
    (tmp_path / "copy" / "00-barge.obj").write_text(BOX)
    (tmp_path / "copy.yaml").write_text(dump(with_paths(loaded.scenario, (), ["copy/00-barge.obj"])))
    copied = load(tmp_path / "copy.yaml").scenario
    assert mesh_files(copied) == (tmp_path / "copy" / "00-barge.obj",)
    assert first_difference(loaded.scenario, copied) is None
    (tmp_path / "copy" / "00-barge.obj").write_text(BOX.replace("v 2 0 1", "v 2 0 2"))
    assert first_difference(loaded.scenario, copied) is not None


@pytest.mark.parametrize(
    ("text", "code"), [(None, "not_found"), (BOX.replace("f 1 2 5", "f 1 2 6"), "not_readable")]
)
def test_a_local_file_that_cannot_be_read_is_reported_in_its_place(
    tmp_path: Path, text: str | None, code: str
) -> None:
    if text is not None:
        (tmp_path / f"{code}.obj").write_text(text)
    file = tmp_path / "mine.yaml"
    file.write_text(f"extends: s1\nharbor:\n  fleet:\n    models: [skiff, ./{code}.obj]\n")
    with pytest.raises(InputError) as error:
        load_checked(file)
    (problem,) = error.value.problems
    assert (problem.line, problem.field, problem.code) == (4, "harbor.fleet.models.1", code)


def test_an_unknown_model_is_reported_in_its_place() -> None:
    with pytest.raises(InputError) as error:
        load("s1", overrides=["harbor.fleet.models=[skiff, slop]"])
    (problem,) = error.value.problems
    assert (problem.field, problem.code, problem.suggestion) == (
        "harbor.fleet.models.1",
        "unknown_name",
        "sloop",
    )
