"""The scenarios and the vessel of the thesis, with its numbers."""

from __future__ import annotations

from typing import Any

from dockctl.scenarios import loader
from tests.scenarios.test_loader import weights


def poses(given: Any) -> list[tuple[float, float, float]]:
    return [(pose.x_m, pose.y_m, pose.heading_deg) for pose in given]


def test_scenario_1_is_the_thesis() -> None:
    scenario = loader.load("s1").scenario
    assert poses(scenario.task.initial) == [(20, 2, 160)]
    assert scenario.task.intermediate is None
    assert poses([scenario.task.final]) == [(36, 0, 180)]
    tolerance = scenario.task.final_tolerance
    assert (tolerance.distance_m, tolerance.heading, tolerance.speed_mps) == (1.0, 0.07, 0.1)
    assert scenario.reward.distance_unit_m == 20
    assert weights(scenario) == {
        "collision": -30_000,
        "final": 30_000,
        "distance": -150,
        "orientation": -100,
        "speed": -20,
    }
    assert [part.part for part in scenario.observation] == [
        "distance",
        "heading_error",
        "velocity",
        "command",
        "lidar",
    ]


def test_scenario_2_starts_from_table_3_6_and_is_tested_from_table_4_3() -> None:
    scenario = loader.load("s2").scenario
    table_4_3 = [(20, 3, 150), (20, 2, 160), (20, 1, 170), (20, 0, 180), (20, -1, 190)]
    assert poses(scenario.task.initial) == [(20, 2, 160), (20, 0, 180), (20, -2, 200)]
    assert poses(scenario.evaluation.poses) == table_4_3
    assert poses(loader.load("s2-poses").scenario.task.initial) == table_4_3


def test_scenario_3_has_two_phases() -> None:
    scenario = loader.load("s3").scenario
    assert poses([*scenario.task.initial, scenario.task.intermediate, scenario.task.final]) == [
        (23, -10, 90),
        (18, 3, 150),
        (36, 0, 180),
    ]
    assert weights(scenario) == {**weights(loader.load("s1").scenario), "intermediate": 30_000, "speed": -10}
    assert [term.params for term in scenario.reward.terms if term.term == "speed"] == [{"floor_m": 0.4}]
    assert scenario.observation[0].part == "phase"
    opposite = loader.load("s3-opposite").scenario.task
    assert poses([*opposite.initial, opposite.intermediate, opposite.final]) == [
        (21, -11, 90),
        (25, 0, 50),
        (7, -2, 0),
    ]


def test_eilbrecht_is_table_3_1() -> None:
    vessel = loader.load_vessel("eilbrecht")
    assert (vessel.mass_kg, vessel.yaw_inertia_kgm2, vessel.propeller_arm_m) == (150, 68.2, 1.5)
    assert (vessel.X_udot_kg, vessel.Y_vdot_kg, vessel.Y_rdot_kgm, vessel.N_rdot_kgm2) == (
        -18.3,
        -120.6,
        0,
        -31.8,
    )
    assert (vessel.X_u_kgps, vessel.X_uu_kgpm, vessel.Y_v_kgps, vessel.Y_vv_kgpm) == (94.2, 66, 395.8, 395.8)
    assert (vessel.N_r_kgm2ps, vessel.N_rr_kgm2, vessel.Y_r_kgmps, vessel.N_v_kgmps) == (
        942.5,
        245.1,
        245.1,
        0,
    )
    assert (vessel.hull.length_m, vessel.hull.beam_m, vessel.hull.draft_m) == (3, 1, 0.3)
