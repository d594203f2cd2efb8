"""What this package registers fulfills the contracts of dockctl."""

from dockctl.testing import check_observation_part, check_reward_term, check_scenario, check_vessel


def test_reward_terms() -> None:
    check_reward_term("smooth_propeller")
    check_reward_term("smooth_rudder", scale_deg=30.0)


def test_observation_part() -> None:
    check_observation_part("nearest_obstacle", cap_m=10.0)


def test_vessel() -> None:
    check_vessel("heavy-launch")


def test_scenario() -> None:
    check_scenario("s1-smooth")
