"""What the thesis shows and says, as facts with the place where it does, and why ours may differ."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Fact:
    """One figure of the thesis.

    Attributes:
        figure: its number.
        measure: what is measured here, a key of `studies.thesis.measures`.
        seen: what the thesis reads in it.
        why: where a difference comes from.
    """

    figure: str
    measure: str
    seen: str
    why: str


SHOWN = "shown, not discussed"
LEARNER = "16 boats, five-step targets and exploring starts for one boat and one step"
STOPS = "our training ends once the task is mastered"
SCENE = "another harbor and hull; the best network, not the last"
EPSILON = "ours falls to 0.03 over 150,000 steps, theirs to 0.01 over 500,000"
PENALTY = "the speed term outweighs the distance's only in the last meters, and slowing down adds steps"
STRAIGHT = "top speed for most of the way"
TOLERANCE = "it is done within 0.07 rad (4°)"
YAW = "hard over, the yaw rate follows the rudder at once"
UNTRAINED = "one start and one berth teach ours no other; the marina's see many, and the bearing"
RUDDER = "nothing in the reward asks for calm controls"

TRAINING = {
    "s1": (
        Fact(
            "4.1",
            "reward",
            "docks near episode 200, then mostly collides until about 2,000; docked in all of the last 400",
            LEARNER,
        ),
        Fact("4.2", "duration", "500 steps until about episode 200, constant at the end", STOPS),
        Fact("4.3", "epsilon", "0.01 from about episode 2,500 on", EPSILON),
    ),
    "s2": (
        Fact(
            "4.11",
            "reward",
            "docks near episode 200, then collides; rises from about 1,600; docked in all of the last 200",
            LEARNER,
        ),
        Fact("4.12", "duration", "500 steps until about episode 200, constant at the end", STOPS),
        Fact("4.13", "epsilon", "0.01 from about episode 2,000 on", EPSILON),
    ),
    "s3": (
        Fact(
            "4.21",
            "reward",
            "high peaks, lower ones (intermediate pose) and pits; stable from about episode 3,000",
            LEARNER,
        ),
        Fact(
            "4.22",
            "duration",
            "500 steps at first, and mostly again from about 1,200 to 2,200; constant at the end",
            STOPS,
        ),
        Fact(
            "4.23",
            "phase",
            "often 1 from about episode 200, less from 500 to 750, mostly 0 from 1,200 to 2,200",
            LEARNER,
        ),
    ),
}
"""The figures of the trainings."""

COURSES = {
    "s1": (
        Fact("4.4", "pose", "docks safely, in reverse", SCENE),
        Fact("4.5", "distance", "approaches gradually", STRAIGHT),
        Fact("4.6", "heading", "approaches gradually", TOLERANCE),
        Fact("4.7", "velocity", "top speed, then slower from second 15 on, 10 m off", PENALTY),
        Fact("4.8", "yaw", SHOWN, YAW),
        Fact("4.9", "propeller", "some sudden changes", RUDDER),
        Fact("4.10", "rudder", "some sudden changes", RUDDER),
    ),
    "s2": (
        Fact("4.14", "pose", "docks from all five poses, three of them untrained", SCENE),
        Fact("4.15", "distance", "approaches gradually", STRAIGHT),
        Fact("4.16", "heading", "approaches gradually", TOLERANCE),
        Fact("4.17", "velocity", "top speed, then gradually slower", PENALTY),
        Fact("4.18", "yaw", SHOWN, YAW),
        Fact(
            "4.19", "propeller", "somewhat sudden where it slows down, less abrupt than in scenario 1", RUDDER
        ),
        Fact("4.20", "rudder", "less abrupt than in scenario 1", RUDDER),
    ),
    "s3": (
        Fact("4.24", "pose", "docks by way of the intermediate pose", SCENE),
        Fact("4.25", "gate", "intermediate pose at about second 40", "the same way at the same top speed"),
        Fact("4.26", "turn", "turned before the intermediate pose is reached, then constant", TOLERANCE),
        Fact("4.27", "stop", "top speed until close, then suddenly from astern to ahead", PENALTY),
        Fact("4.28", "yaw", SHOWN, YAW),
        Fact("4.29", "propeller", "sudden changes have practically ceased", RUDDER),
        Fact(
            "4.30", "rudder", "hard over at once; steeper when the second phase begins, then slower", RUDDER
        ),
    ),
    "s3-opposite": (
        Fact("4.31", "pose", "docks at the untrained berth on the other side", UNTRAINED),
        Fact("4.32", "gate", "first away from the berth, then back to it, as at the trained one", UNTRAINED),
        Fact("4.33", "heading", "gradual, as at the trained berth", UNTRAINED),
        Fact("4.34", "velocity", "top speed until close", PENALTY),
        Fact("4.35", "yaw", SHOWN, YAW),
        Fact(
            "4.36",
            "stop",
            "suddenly from astern to ahead at the end",
            "ahead is what stops a boat that comes astern",
        ),
        Fact(
            "4.37",
            "rudder",
            "much less abrupt than at the trained berth, more frequent changes only at the end",
            RUDDER,
        ),
    ),
    "s3-appendix-b": (
        Fact("B.1", "pose", "docks at one more untrained berth", UNTRAINED),
        Fact("B.2", "gate", SHOWN, UNTRAINED),
        Fact("B.3", "heading", SHOWN, UNTRAINED),
        Fact("B.4", "velocity", SHOWN, PENALTY),
        Fact("B.5", "yaw", SHOWN, YAW),
        Fact("B.6", "propeller", SHOWN, RUDDER),
        Fact("B.7", "rudder", SHOWN, RUDDER),
    ),
}
"""The figures of single maneuvers."""

WEIGHTS = {
    "collision": ("r_collision", "30,000", "30,000"),
    "final": ("r_final", "30,000", "30,000"),
    "intermediate": ("r_pre-final", "", "not printed"),
    "distance": ("r_distance", "150", "150"),
    "orientation": ("r_orientation", "100", "100"),
    "speed": ("r_velocity", "20", "10"),
}
"""Table 3.5 and section 4.3, by our name of the term: symbol, value in scenarios 1 and 2, value in 3."""
SECONDS_A_STEP = 0.2
HOURS_A_SCENARIO = 48.0
EPISODES = {"s1": 4000, "s2": 4700, "s3": 4000}


@dataclass(frozen=True)
class Entry:
    """One line of the index: figures or tables of the thesis, where ours stand, and how they differ."""

    numbers: str
    shows: str
    page: str
    command: str
    differs: str


SHOW, ALL = "dockctl show", "dockctl reproduce"
SCENARIO_1, SCENARIO_2, SCENARIO_3 = (f"results/scenario-{number}.md" for number in (1, 2, 3))
ELSEWHERE = "results/generalization.md"
SEEDS = "five seeds and their middle for one training"
INDEX = (
    Entry(
        "Fig. 3.6", "one scan as a point cloud", "figures/point-cloud.png", f"{SHOW} s3", "another marina",
    ),
    Entry(
        "Fig. 3.9", "the scan in eight sectors", "figures/sectors.png", f"{SHOW} s3",
        "fixed sectors; theirs span the points at hand",
    ),
    Entry(
        "Fig. 3.10", "surge at full force", "results/scenarios.md#surge", ALL, "the same top speed",
    ),
    Entry(
        "Figs. 3.13-3.15, Table 3.6", "the poses of the scenarios", "results/scenarios.md", ALL,
        "the same poses, another harbor",
    ),
    Entry(
        "Table 3.5", "the reward's weights", "results/reward.md", f"{ALL} s1 s3 reading",
        "the same weights; δd in units of 20 m",
    ),
    Entry(
        "Table 4.1", "ε", "results/thesis-learner.md", f"{ALL} thesis",
        "the same in the preset `thesis`; by default 0.03 after 150,000 steps",
    ),
    Entry("Figs. 4.1-4.3", "scenario 1, training", f"{SCENARIO_1}#training", f"{ALL} s1", SEEDS),
    Entry(
        "Figs. 4.4-4.10", "scenario 1, maneuver", f"{SCENARIO_1}#maneuver", f"{ALL} s1",
        "slows down later, where the speed term begins to count",
    ),
    Entry("Figs. 4.11-4.13", "scenario 2, training", f"{SCENARIO_2}#training", f"{ALL} s2", SEEDS),
    Entry(
        "Figs. 4.14-4.20, Tables 4.2, 4.3", "scenario 2, five poses", f"{SCENARIO_2}#maneuver", f"{ALL} s2",
        "another harbor; otherwise alike",
    ),
    Entry("Figs. 4.21-4.23", "scenario 3, training", f"{SCENARIO_3}#training", f"{ALL} s3", SEEDS),
    Entry(
        "Figs. 4.24-4.30", "scenario 3, maneuver", f"{SCENARIO_3}#maneuver", f"{ALL} s3",
        "distances are those to the goal of the phase, not to the final pose",
    ),
    Entry(
        "Figs. 4.31-4.37, Table 4.4", "the berth on the other side",
        f"{ELSEWHERE}#the-berth-on-the-other-side", f"{ALL} s3 marina", "beside it the marina's policies",
    ),
    Entry(
        "Fig. 4.38", "duration of a forward pass", "results/time.md", f"{ALL} s3", "also of whole decisions",
    ),
    Entry(
        "Figs. 4.39, 4.40", "failures far from the trained start",
        f"{ELSEWHERE}#how-far-from-the-trained-start", f"{ALL} s3", "the nearest failures of a whole grid",
    ),
    Entry(
        "Figs. B.1-B.7", "one more berth", f"{ELSEWHERE}#the-berth-of-appendix-b", f"{ALL} s3 marina",
        "poses of our own: theirs are only in pictures",
    ),
)  # fmt: skip
