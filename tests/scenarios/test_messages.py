"""One test for each mistake that a user can make in a scenario: location, field, code and suggestion."""

from __future__ import annotations

from pathlib import Path

import pytest

from dockctl.errors import InputError
from dockctl.scenarios import loader

# Text after `extends: s1` in line 1; for each problem "line:column field code suggestion".
WRONG: dict[str, tuple[str, list[str]]] = {
    "unknown key": (
        "tolerence: 3\ntask: {final_tolerence: {}}\n",
        ["2:1 tolerence unknown_key", "3:8 task.final_tolerence unknown_key final_tolerance"],
    ),
    "unknown key of a list's item": (
        "task:\n  initial:\n    - {x_m: 1, y_m: 2, heading: 3}\n",
        ["4:7 task.initial.0.heading_deg missing_key", "4:24 task.initial.0.heading unknown_key heading_deg"],
    ),
    "a key that only files have": ("bert: west 12\n", ["2:1 bert unknown_key berth"]),
    "a text for a number": ("task: {max_steps: many}\n", ["2:19 task.max_steps wrong_type"]),
    "a number for a text": ("title: 3\n", ["2:8 title wrong_type"]),
    "a broken number": ("task: {max_steps: 2.5}\n", ["2:19 task.max_steps wrong_type"]),
    "a boolean for a number": ("vessel: {mass_kg: true}\n", ["2:19 vessel.mass_kg wrong_type"]),
    "a list for a mapping": ("task: [1]\n", ["2:7 task wrong_type"]),
    "a mapping for a list": ("observation: {lidar: {}}\n", ["2:14 observation wrong_type"]),
    "too small": ("vessel: {substeps: 0}\n", ["2:20 vessel.substeps out_of_range"]),
    "too large": ("vessel: {max_rudder_deg: 91}\n", ["2:26 vessel.max_rudder_deg out_of_range"]),
    "not a fraction": ("training: {gamma: 1.5}\n", ["2:19 training.gamma out_of_range"]),
    "no item": ("task: {initial: []}\n", ["2:17 task.initial out_of_range"]),
    "unreachable tolerance": (
        "task:\n  final_tolerance: {distance_m: 0}\n",
        ["3:33 task.final_tolerance.distance_m out_of_range"],
    ),
    "two headings in one tolerance": (
        "task:\n  final_tolerance: {heading_deg: 4}\n",
        ["3:20 task.final_tolerance invalid"],
    ),
    "no final pose": ("task: {final: null}\n", ["2:15 task.final missing_key"]),
    "half a pose": (
        "task: {intermediate: {x_m: 1}}\n",
        ["2:8 task.intermediate.y_m missing_key", "2:8 task.intermediate.heading_deg missing_key"],
    ),
    "not numbers": (
        "task: {final: {x_m: .nan, y_m: 1e999}}\ntraining: {gamma: -.inf}\n",
        [
            "2:21 task.final.x_m out_of_range",
            "2:32 task.final.y_m out_of_range",
            "3:19 training.gamma out_of_range",
        ],
    ),
    "headings of billions of turns": (
        "task: {final: {heading_deg: 1.0e+12}}\n"
        "training: {exploring_starts: {heading_noise_deg: [6, 40000]}}\n",
        [
            "2:29 task.final.heading_deg out_of_range",
            "3:54 training.exploring_starts.heading_noise_deg.1 out_of_range",
        ],
    ),
    "too few substeps to be stable": ("vessel: {substeps: 1}\n", ["2:20 vessel.substeps out_of_range 3"]),
    "too few substeps for turning at speed": (
        "vessel: {max_propeller_n: 1000, Y_r_kgmps: 0, N_r_kgm2ps: 100, N_rr_kgm2: 25, substeps: 1}\n",
        ["2:89 vessel.substeps out_of_range 4"],
    ),
    "damping that adds energy": ("vessel: {Y_r_kgmps: 1500.0}\n", ["2:21 vessel.Y_r_kgmps out_of_range"]),
    "damping that adds energy, in yaw": (
        "vessel: {N_v_kgmps: -1500.0}\n",
        ["2:21 vessel.N_v_kgmps out_of_range"],
    ),
    "no damping in surge": (
        "vessel: {X_u_kgps: 0.0, X_uu_kgpm: 0.0}\n",
        ["2:20 vessel.X_u_kgps out_of_range"],
    ),
    "no damping in sway": (
        "vessel: {Y_v_kgps: 0.0, Y_vv_kgpm: 0.0, Y_r_kgmps: 0.0}\n",
        ["2:20 vessel.Y_v_kgps out_of_range"],
    ),
    "more boats than fit anywhere": (
        "training: {boats: 1_000_000_000}\n",
        ["2:19 training.boats out_of_range"],
    ),
    "no known choice": ("training: {optimizer: adma}\n", ["2:23 training.optimizer unknown_name adam"]),
    "no known preset": ("training: {preset: theses}\n", ["2:20 training.preset unknown_name thesis"]),
    "no known condition": (
        "conditions:\n  curent: {speed_mps: 0.1}\n",
        ["3:3 conditions.curent unknown_name current"],
    ),
    "no known vessel": ("vessel: eilbrect\n", ["2:9 vessel unknown_name eilbrecht"]),
    "no known harbor": ("harbor: refrence\n", ["2:9 harbor unknown_name reference"]),
    "no such harbor file": ("harbor: gone.yaml\n", ["2:9 harbor not_found"]),
    "unknown key of a mesh file, in a harbor whose kind is the name of the key": (
        "harbor: {kind: meshes, meshes: [{path: x.glb, scal: 2, scale: -1}]}\n",
        [
            "2:47 harbor.meshes.0.scal unknown_key scale",
            "2:63 harbor.meshes.0.scale out_of_range",
        ],
    ),
    "harbor without meshes": ("harbor: {kind: meshes, meshes: []}\n", ["2:32 harbor.meshes out_of_range"]),
    "unknown kind of harbor": ("harbor: {kind: mesh}\n", ["2:16 harbor.kind unknown_name meshes"]),
    "unknown side of a row": (
        "harbor: {rows: [{side: esat, berth_y_m: [0]}]}\n",
        ["2:24 harbor.rows.0.side unknown_name east"],
    ),
    "a row without a side": ("harbor: {rows: [{berth_y_m: [0]}]}\n", ["2:17 harbor.rows.0 missing_key"]),
    "a key of another kind of row": (
        "harbor:\n  rows:\n    - {side: east, berth_y_m: [0], berth_x_m: [1]}\n",
        ["4:36 harbor.rows.0.berth_x_m unknown_key berth_y_m"],
    ),
    "a basin inside out": ("harbor:\n  basin: {x_min_m: 90}\n", ["3:20 harbor.basin.x_min_m out_of_range"]),
    "commands beyond the vessel": (
        "actions: {propeller_n: [-60, 60]}\n",
        ["2:24 actions.propeller_n mismatch"],
    ),
    "a pose beyond ten kilometers": (
        "task: {final: {x_m: 1e9}}\n",
        ["2:21 task.final.x_m out_of_range"],
    ),
    "a finger pier beyond ten kilometers": (
        "harbor:\n  rows:\n    - {side: east, berth_y_m: [0], finger_y_m: [1, 1e9]}\n",
        ["4:52 harbor.rows.0.finger_y_m.1 out_of_range"],
    ),
    "a LiDAR that is not on the boat": (
        "sensors: {lidar: {mounts: [{pitch_deg: 0, yaw_deg: 0, x_m: 1e9, y_m: 21, z_m: 3}]}}\n",
        [
            "2:60 sensors.lidar.mounts.0.x_m out_of_range",
            "2:70 sensors.lidar.mounts.0.y_m out_of_range",
        ],
    ),
    "more rays than fit into memory": (
        "sensors:\n  lidar: {azimuth_steps: 50000, channels: 16}\n",
        ["3:26 sensors.lidar.azimuth_steps out_of_range"],
    ),
    "a range beyond ten kilometers": (
        "sensors: {lidar: {kind: planar, range_m: 1e9}}\n",
        ["2:42 sensors.lidar.range_m out_of_range"],
    ),
    "more actions than fit into memory": (
        f"actions: {{rudder_deg: {[0] * 1001}}}\n",
        ["2:23 actions.rudder_deg out_of_range"],
    ),
    "more harbors than fit into memory": (
        f"task: {{berths: {{trained: {{east: {[*range(33)]}}}, vacant: 1}}}}\n",
        ["2:166 task.berths.vacant out_of_range"],
    ),
    "numbers without a meaning in SI units": (
        "reward: {distance_unit_m: 1e-13, terms: {final: 1e13}}\n",
        ["2:27 reward.distance_unit_m out_of_range", "2:49 reward.terms.final.weight out_of_range"],
    ),
    "an impossible vessel": ("vessel: {X_udot_kg: 200}\n", ["2:9 vessel invalid"]),
    "unknown reward term": (
        "reward:\n  terms:\n    distence: -1\n",
        ["4:5 reward.terms.distence unknown_name distance"],
    ),
    "a parameter of a reward term beside its weight": (
        "reward: {terms: {speed: {weight: -20, flor: 0.1}}}\n",
        ["2:39 reward.terms.speed.flor unknown_key params.floor"],
    ),
    "a misspelled condition to remove": (
        "conditions: {wnd: null, wind: null, current: {speed_mps: 0, direction_deg: 0}}\n"
        "training: {conditions: {wind: null}}\n",
        ["2:19 conditions.wnd unknown_name", "3:31 training.conditions.wind unknown_name"],
    ),
    "conditions beyond any boat": (
        "conditions:\n"
        "  lidar_noise: {sigma_m: 11}\n"
        "  navigation: {heading_deg: [0, 181]}\n"
        "  actuators: {astern_factor: 2.1, propeller_lag_s: 61, rudder_rate_degps: 0.01}\n"
        "  current: {speed_mps: 0.1, direction_deg: 36001}\n",
        [
            "3:26 conditions.lidar_noise.sigma_m out_of_range",
            "4:33 conditions.navigation.heading_deg.1 out_of_range",
            "5:30 conditions.actuators.astern_factor out_of_range",
            "5:52 conditions.actuators.propeller_lag_s out_of_range",
            "5:75 conditions.actuators.rudder_rate_degps out_of_range",
            "6:44 conditions.current.direction_deg out_of_range",
        ],
    ),
    "removing an unknown reward term": (
        "reward: {terms: {sped: null}}\n",
        ["2:18 reward.terms.sped unknown_name speed"],
    ),
    "unknown parameter of a term": (
        "reward: {terms: {speed: {params: {flor: 1}}}}\n",
        ["2:35 reward.terms.speed.params.flor unknown_key floor"],
    ),
    "wrong type of a parameter": (
        "reward: {terms: {speed: {params: {floor: low}}}}\n",
        ["2:42 reward.terms.speed.params.floor wrong_type"],
    ),
    "a parameter out of range": (
        "reward: {terms: {speed: {weight: -1, params: {floor: 0}}}}\nobservation: [{lidar: {cap_m: -5}}]\n",
        ["2:54 reward.terms.speed.params.floor out_of_range", "3:31 observation.0.lidar.cap_m out_of_range"],
    ),
    "a vessel that is a folder": ("vessel: .\n", ["2:9 vessel not_readable"]),
    "a term without weight": (
        "reward: {terms: {progress: {params: {}}}}\n",
        ["2:18 reward.terms.progress.weight missing_key"],
    ),
    "a weight that is no number": (
        "reward: {terms: {speed: fast}}\n",
        ["2:25 reward.terms.speed wrong_type"],
    ),
    "a term twice": (
        "reward: {terms: {mine: {term: speed, weight: -1}}}\n",
        ["2:24 reward.terms.mine duplicate"],
    ),
    "unknown observation part": (
        "observation:\n  - distance\n  - ladar\n",
        ["4:5 observation.1 unknown_name lidar"],
    ),
    "unknown parameter of a part": (
        "observation: [{lidar: {cap: 3}}]\n",
        ["2:24 observation.0.lidar.cap unknown_key cap_m"],
    ),
    "a part with a wrong parameter": (
        "observation:\n  - {part: lidar, params: {cap_m: [3]}}\n",
        ["3:35 observation.0.params.cap_m wrong_type"],
    ),
    "a name that is no folder's": ("name: ../up\n", ["2:7 name invalid"]),
    "more docked than episodes": (
        "training: {stop: {docked: 20, episodes: 10}}\n",
        ["2:27 training.stop.docked out_of_range"],
    ),
    "all at once, in order": (
        "training: {seed: -1, boats: 0}\ntask: {max_steps: x}\nobservation: [nothing_like_it]\n",
        [
            "2:18 training.seed out_of_range",
            "2:29 training.boats out_of_range",
            "3:19 task.max_steps wrong_type",
            "4:15 observation.0 unknown_name",
        ],
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_every_problem_has_location_code_and_suggestion(tmp_path: Path, case: str) -> None:
    text, expected = WRONG[case]
    path = tmp_path / "x.yaml"
    path.write_text(f"extends: s1\n{text}")
    with pytest.raises(InputError) as caught:
        loader.load(path)
    found = caught.value.problems
    assert {problem.file for problem in found} == {str(path)}
    assert [f"{p.line}:{p.column} {p.field} {p.code} {p.suggestion}".strip() for p in found] == expected


WIND = "conditions: {wind: {speed_mps: 1, direction_deg: %s}}\n"
GENERATED = "harbor: {kind: generated, %s}\n"
WORDS = {
    "a berth twice": (
        "task: {berths: {trained: {west: [12, 4, 12]}}}\n",
        "task.berths.trained.west.0: the west berth at 12 is listed twice",
    ),
    "empty name": (
        "harbor: {name: ''}\n",
        "harbor.name: found the text '', expected a text that is not empty",
    ),
    "a range of directions through 0°": (
        WIND % "[350, 10]",
        "conditions.wind.direction_deg: found [350, 10], expected the lower bound first; a range through 0°"
        " is like [-10, 10] or [350, 370]",
    ),
    "no direction": (
        WIND % "null",
        "conditions.wind.direction_deg: found nothing, expected a number or [low, high]",
    ),
    "a number for a range": (
        GENERATED % "basin_length_m: 44",
        "harbor.basin_length_m: found 44, expected [low, high]",
    ),
    "a fraction for a whole number": (
        GENERATED % "piers: [0.5, 1]",
        "harbor.piers.0: found 0.5, expected a whole number",
    ),
    "a text for a whole number": (
        GENERATED % "free_berths: ['3', 8]",
        "harbor.free_berths.0: found the text '3', expected a whole number",
    ),
    "a default that does not suit the vessel": (
        GENERATED % "seed: 3" + "vessel: {hull: {beam_m: 2.2}}\n",
        "harbor.berth_width_m: 2.6 is too narrow for the vessel, which needs 3.2 m",
    ),
    "several layouts and berths that are null": (
        GENERATED % "layouts: 3" + "task: {berths: null}\n",
        "task.berths: several layouts need 'task: {berths: {}}', so that episodes use the free berths of all",
    ),
}


@pytest.mark.parametrize("case", WORDS)
def test_a_message_names_the_field_and_what_is_expected(tmp_path: Path, case: str) -> None:
    text, expected = WORDS[case]
    (tmp_path / "x.yaml").write_text(f"extends: s1\n{text}")
    with pytest.raises(InputError) as caught:
        loader.load(tmp_path / "x.yaml")
    (problem,) = caught.value.problems
    assert f"{problem.field}: {problem.message}" == expected
    assert problem.file == str(tmp_path / "x.yaml") and problem.line >= 2


def test_an_error_of_a_range_is_that_of_the_change_of_its_bound() -> None:
    with pytest.raises(InputError) as caught:
        loader.load("s1-weather", overrides=["conditions.wind.speed_mps.0=9"])
    (problem,) = caught.value.problems
    assert (problem.file, problem.line) == ("--set conditions.wind.speed_mps.0", 0)
    assert problem.field == "conditions.wind.speed_mps"


def test_every_missing_section_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("title: nothing else\n")
    with pytest.raises(InputError) as caught:
        loader.load(path)
    found = {problem.field: problem for problem in caught.value.problems}
    assert set(found) == {"vessel", "harbor", "observation", "task", "reward"}
    assert {problem.code for problem in found.values()} == {"missing_key"}


def test_an_error_in_a_vessel_file_names_that_file(tmp_path: Path) -> None:
    (tmp_path / "boat.yaml").write_text("extends: eilbrecht\nmass: 3\n")
    (tmp_path / "x.yaml").write_text("extends: s1\nvessel: boat.yaml\n")
    for load in (
        lambda: loader.load(tmp_path / "x.yaml"),
        lambda: loader.load_vessel(tmp_path / "boat.yaml"),
    ):
        with pytest.raises(InputError) as caught:
            load()
        (found,) = caught.value.problems
        assert (found.file, found.line, found.column) == (f"{tmp_path}/boat.yaml", 2, 1)
        assert (found.field, found.code, found.suggestion) == ("vessel.mass", "unknown_key", "mass_kg")


@pytest.mark.parametrize("terms", ["3", "", "speed", "true"])
def test_what_reward_terms_should_be(terms: str, tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text(f"extends: s1\nreward: {{terms: {terms}}}\n")
    with pytest.raises(InputError) as caught:
        loader.load(path)
    (problem,) = caught.value.problems
    assert (problem.line, problem.field, problem.code) == (2, "reward.terms", "wrong_type")


@pytest.mark.parametrize(("value", "found"), [("!x s1", "!x"), (".nan", ".nan")])
def test_a_value_that_cannot_be_read_is_quoted(value: str, found: str, tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text(f"extends: {value}\n")
    with pytest.raises(InputError) as caught:
        loader.load(path)
    (problem,) = caught.value.problems
    assert (problem.line, problem.column, problem.field) == (1, 10, "extends")
    assert found in problem.message


def test_the_printed_text_is_one_line_per_problem(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("extends: s1\ntitel: x\ntask: {max_steps: 0}\n")
    with pytest.raises(InputError) as caught:
        loader.load(path)
    first, second = str(caught.value).splitlines()
    assert first.startswith(f"{path}:2:1: titel: ")
    assert "'title'" in first
    assert second.startswith(f"{path}:3:19: task.max_steps: ")


def test_a_list_that_is_too_short_needs_another_item(tmp_path: Path) -> None:
    path = tmp_path / "short.yaml"
    path.write_text("extends: s1\nharbor: {kind: meshes, meshes: [{path: x.stl, shift_m: [1, 2]}]}\n")
    with pytest.raises(InputError) as caught:
        loader.load(str(path))
    (problem,) = caught.value.problems
    assert (problem.line, problem.column) == (2, 47)
    assert (problem.field, problem.code) == ("harbor.meshes.0.shift_m.2", "missing_key")
