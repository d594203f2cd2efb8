"""Contact between the ends of control periods: against plane geometry, and boats that cannot leave a ring."""

from __future__ import annotations

import math
import os
from dataclasses import replace

import numpy as np
import psutil
import pytest
import trimesh
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dockctl.errors import DockctlError
from dockctl.geometry import Floats
from dockctl.scenarios.loader import load
from dockctl.scenarios.vessel import Hull, Vessel
from dockctl.sim.collision import CollisionChecker
from dockctl.sim.harbor.solids import box, hull_outline, prism
from dockctl.sim.simulator import Simulator
from dockctl.sim.starts import Start, given_start, own_site
from dockctl.sim.swept import first_contact
from dockctl.sim.vessel import VesselModel
from tests.sim.harbor.harbors import reference_harbor
from tests.sim.test_collision import checker, placed, separation
from tests.sim.vessels import THESIS, fewest_substeps, vessels
from tests.sim.worlds import walled

EXAMPLES = int(os.environ.get("DOCKCTL_EXAMPLES", "40"))
SCENARIO = load("s1", overrides=["conditions.current={speed_mps: 0, direction_deg: 0}"]).scenario


def simulator(obstacles: CollisionChecker, vessel: Vessel, starts: list[Start]) -> Simulator:
    scenario = SCENARIO.model_copy(update={"vessel": vessel})
    sim = Simulator(scenario, [replace(walled(), obstacles=obstacles)], len(starts))
    sim.reset(np.arange(len(starts)), starts, [np.random.default_rng(row) for row in range(len(starts))])
    return sim


def start(x: float, y: float, heading: float = 0.0, nu: tuple[float, float, float] = (0, 0, 0)) -> Start:
    begin = given_start(own_site(SCENARIO), SCENARIO.task, np.array([x, y, heading]), 0)
    return replace(begin, nu=np.array(nu, float))


def coasting(hull: Hull) -> Vessel:
    """A vessel that hardly slows down."""
    light = {"X_u_kgps": 1.0, "X_uu_kgpm": 0.5, "max_propeller_n": 50.0, "hull": hull.model_dump()}
    vessel = fewest_substeps({**THESIS.model_dump(), **light})
    assert vessel is not None
    return vessel


# Cases


@pytest.mark.parametrize(
    ("speed", "length"),
    [(5.0, 1.5), *(pytest.param(*fast, marks=pytest.mark.thorough) for fast in ((8.0, 3.0), (30.0, 0.3)))],
)
def test_fast_boats_do_not_cross_a_block(speed: float, length: float) -> None:
    hull = Hull(length_m=length, beam_m=length / 3)
    block = checker(box((10, -50, -1), (30, 50, 1)), hull=hull)
    starts = [start(x, 0, nu=(speed, 0, 0)) for x in np.linspace(0, 5, 64)]
    sim = simulator(block, coasting(hull), starts)
    collided = np.zeros(64, bool)
    for _ in range(20):
        collided |= sim.step(np.tile([50.0, 0.0], (64, 1))).collided
        assert (collided | (sim.eta[:, 0] < 10)).all()
    assert collided.all()


def test_a_boat_stays_where_it_touched_on_the_way() -> None:
    """A pile of 1 cm, 0.4 m ahead of the bow of a boat that moves 4 m in a period."""
    pile = checker(box((1.9, -0.005, -1), (1.91, 0.005, 1)))
    sim = simulator(pile, coasting(Hull()), [start(0, 0, nu=(8, 0, 0))])
    status = sim.step(np.zeros((1, 2)))
    assert status.collided.tolist() == [True]
    assert sim.eta[0] == pytest.approx([0.4, 0, 0], abs=0.002)
    assert status.nu[0] == pytest.approx([8, 0, 0], abs=0.1)
    assert status.distance_m == pytest.approx(np.hypot(*(sim.eta - sim.goal)[0, :2]))
    assert pile.collided_part(sim.eta[0]) == "solid 0"
    assert pile.clearance(sim.eta).tolist() == [0.0]


def test_a_boat_that_touches_at_the_end_of_the_period_is_there() -> None:
    wall = checker(box((3, -5, -1), (9, 5, 1)))
    vessel, command = coasting(Hull()), np.array([[50.0, 0.3]])
    sim = simulator(wall, vessel, [start(0, 0, nu=(5, 0, 0))])
    eta, nu = VesselModel(vessel).step(sim.eta, sim.nu, command)
    assert sim.step(command).collided.tolist() == [True]
    assert np.array_equal(sim.eta, eta)
    assert np.array_equal(sim.nu, nu)


def test_a_turning_stern_touches_between_the_ends() -> None:
    """The boat turns by half a turn, to where its outline is the same but for the bow."""
    pile = checker(box((-0.01, 1.2, -1), (0.01, 1.3, 1)))
    path = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, math.pi]])
    contact = first_contact(path, pile, Hull())
    assert contact is not None
    assert not pile.blocked(path).any()
    corner = math.atan2(1.3, 0.01) - math.atan2(0.5, 1.5)  # the stem comes first, and is farther out
    assert corner < contact[2] < math.pi / 2


def test_a_current_carries_a_boat_into_a_pile() -> None:
    scenario = load("s1", overrides=["conditions.current={speed_mps: 8, direction_deg: 90}"]).scenario
    pile = checker(box((-0.1, 1.9, -1), (0.1, 2.0, 1)))
    sim = Simulator(scenario, [replace(walled(), obstacles=pile)], 1)
    sim.reset(np.arange(1), [start(0, 0, nu=(0, 8, 0))], [np.random.default_rng(0)])
    assert sim.step(np.zeros((1, 2))).collided.tolist() == [True]
    assert sim.eta[0] == pytest.approx([0, 1.4, 0], abs=0.003)
    assert sim.nu[0] == pytest.approx([0, 8, 0], abs=1e-6)


def test_a_start_inside_a_solid_is_a_collision_in_the_first_step() -> None:
    land = checker(box((-20, -20, -5), (20, 20, 5)))
    sim = simulator(land, THESIS, [start(0, 0), start(30, 0)])
    assert sim.step(np.zeros((2, 2))).collided.tolist() == [True, False]


def test_clearance_is_zero_inside() -> None:
    land, buoy = box((-20, -20, -5), (20, 20, 5)), box((30.4, -0.1, -0.1), (30.6, 0.1, 0.2))
    eta = np.array([[0.0, 0, 0], [7, -3, 1.3], [30, 0, 0], [24, 0, 0]])
    assert checker(land, buoy).clearance(eta) == pytest.approx([0, 0, 0, 2.5])


@pytest.mark.thorough
def test_checks_leave_no_memory_behind() -> None:
    """python-fcl never frees 32 bytes of an object that is made for each check."""
    block = checker(box((10, -50, -1), (30, 50, 1)))
    path = np.array([[5.0, 0, 0], [9.0, 0, 0.3]])

    def check(times: int) -> None:
        for _ in range(times):
            assert first_contact(path, block, THESIS.hull) is not None

    check(10)
    before = psutil.heap_info().heap_used
    check(1000)
    assert psutil.heap_info().heap_used - before < 1000 * 32


def test_a_small_open_mesh_inside_the_hull_blocks() -> None:
    flake = trimesh.Trimesh([(0.1, 0, 0), (0.2, 0, 0), (0.1, 0.1, 0.1)], [(0, 1, 2)], process=False)
    assert checker(flake).blocked(np.array([[0.0, 0, 0], [3, 0, 0]])).tolist() == [True, False]


@pytest.mark.parametrize("nu", [(1e8, 1e8, 1e8), (math.nan, 0, 0)])
def test_a_diverged_integration_is_reported(nu: tuple[float, float, float]) -> None:
    sim = simulator(checker(box((90, 0, 0), (91, 1, 1))), THESIS, [start(0, 0), start(0, 0, nu=nu)])
    with pytest.raises(DockctlError, match="boat 1, step 1", check=lambda e: e.code == "out_of_range"):
        sim.step(np.zeros((2, 2)))


# Properties

hulls = st.builds(Hull, length_m=st.floats(0.3, 6), beam_m=st.floats(0.1, 3))


@st.composite
def polygons(draw: st.DrawFn) -> Floats:
    """Convex outlines around the origin, from thin piles to blocks."""
    size = draw(st.sampled_from((0.005, 0.05, 0.5, 3.0)))
    corners, turn = draw(st.integers(3, 8)), draw(st.floats(0, 6))
    angle = turn + 2 * np.pi * np.arange(corners) / corners
    return np.column_stack([np.cos(angle), draw(st.floats(0.1, 1)) * np.sin(angle)]) * size


@st.composite
def paths(draw: st.DrawFn) -> Floats:
    """Straight and curved ways of up to 12 m past the origin, with up to a turn."""
    count = draw(st.integers(2, 6))
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    ends = rng.uniform([-6, -6, -7], [6, 6, 7], (2, 3))
    ends[1, 2] = ends[0, 2] + draw(st.sampled_from((0, 0.3, 3))) * rng.uniform(-1, 1)
    path = np.linspace(*ends, count)
    path[1:-1] += rng.normal(size=(count - 2, 3)) * [0.3, 0.3, 0.1]
    return path


def deepest_contact(path: Floats, body: Floats, outline: Floats) -> float:
    """Greatest depth on the way [m], negative for a gap: by many poses, and more around the deepest."""
    low, high, deepest = 0.0, len(path) - 1.0, -math.inf
    for samples in (200, 60, 60):
        at = np.linspace(low, high, samples)
        poses = np.column_stack([np.interp(at, np.arange(len(path)), column) for column in path.T])
        depth = [-separation(placed(body, eta), outline) for eta in poses]
        best = int(np.argmax(depth))
        low, high, deepest = at[max(best - 1, 0)], at[min(best + 1, samples - 1)], max(deepest, depth[best])
    return deepest


@settings(max_examples=EXAMPLES)
@given(path=paths(), outline=polygons(), hull=hulls)
def test_a_contact_on_the_way_is_found_as_by_brute_force(path: Floats, outline: Floats, hull: Hull) -> None:
    boat, body = checker(prism(outline, -1.0, 1.0), hull=hull), hull_outline(hull)
    deepest = deepest_contact(path, body, outline)
    contact = first_contact(path, boat, hull)
    if contact is None:
        assert deepest < 0.002  # the hull moves this far between two tests
    else:
        assert deepest > -0.01  # between two of the samples
        assert separation(placed(body, contact), outline) < 1e-6


@settings(max_examples=EXAMPLES)
@given(eta=paths(), outline=polygons(), hull=hulls, within=st.floats(0, 5), seed=st.integers(0, 1000))
def test_nothing_is_touched_if_nothing_is_near(
    eta: Floats, outline: Floats, hull: Hull, within: float, seed: int
) -> None:
    boat, rng = checker(prism(outline, -1.0, 1.0), hull=hull), np.random.default_rng(seed)
    pose = eta[0]
    turn = rng.uniform(-1, 1, 20) * min(within / hull.reach_m, np.pi)
    way = rng.uniform(0, 1, 20) * (within - hull.reach_m * np.abs(turn))
    angle = rng.uniform(0, 7, 20)
    moved = pose + np.column_stack([way * np.cos(angle), way * np.sin(angle), turn])
    touching = [separation(placed(hull_outline(hull), other), outline) < 0 for other in moved]
    assert boat.near(pose[None], within)[0] or not any(touching)


@pytest.mark.thorough
@settings(max_examples=EXAMPLES)
@given(
    path=paths(),
    outline=polygons(),
    turn=st.floats(-4, 4),
    shift=st.floats(-50, 50),
    mirrored=st.booleans(),
)
def test_contacts_are_the_same_elsewhere_turned_and_mirrored(
    path: Floats, outline: Floats, turn: float, shift: float, mirrored: bool
) -> None:
    side = -1.0 if mirrored else 1.0
    c, s = math.cos(turn), math.sin(turn)

    def moved(points: Floats) -> Floats:
        x, y = points[:, 0], side * points[:, 1]
        rest = side * points[:, 2:] + turn
        return np.column_stack([c * x - s * y + shift, s * x + c * y - shift, rest])

    other = moved(outline)[:: -1 if mirrored else 1]
    here, there = checker(prism(outline, -1.0, 1.0)), checker(prism(other, -1.0, 1.0))
    gaps = [separation(placed(hull_outline(Hull()), eta), outline) for eta in path]
    assume(min(map(abs, gaps)) > 1e-6)
    assert here.blocked(path).tolist() == there.blocked(moved(path)).tolist()
    assert there.clearance(moved(path)) == pytest.approx(here.clearance(path), abs=1e-6)
    found, same = (first_contact(way, boat, Hull()) for way, boat in ((path, here), (moved(path), there)))
    deepest = deepest_contact(path, hull_outline(Hull()), outline)
    assert (found is None) == (same is None) or deepest < 0.01
    if found is not None and same is not None and deepest > 0.01:
        assert np.hypot(*(moved(found[None])[0] - same)[:2]) < 0.05


RING_M = 12.0


def ring(thick: bool) -> trimesh.Trimesh:
    """A wall around the origin: closed and 1 mm thick, or a single sheet."""
    if thick:
        return trimesh.creation.annulus(r_min=RING_M, r_max=RING_M + 0.001, height=2.0, sections=48)
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    foot = np.column_stack([RING_M * np.cos(angle), RING_M * np.sin(angle), np.full(48, -1.0)])
    k = np.arange(48)
    n = (k + 1) % 48
    faces = np.concatenate([np.column_stack([k, n, n + 48]), np.column_stack([k, n + 48, k + 48])])
    return trimesh.Trimesh(np.concatenate([foot, foot + [0, 0, 2]]), faces, process=False)


@pytest.mark.thorough
@settings(max_examples=EXAMPLES)
@given(
    vessel=vessels(st.builds(Hull, length_m=st.floats(0.05, 6), beam_m=st.floats(0.02, 3))),
    thick=st.booleans(),
    current=st.sampled_from((0.0, 0.0, 0.5, 5.0)),
    seed=st.integers(0, 1000),
)
def test_no_boat_leaves_a_ring_without_a_collision(
    vessel: Vessel, thick: bool, current: float, seed: int
) -> None:
    boats, rng = 6, np.random.default_rng(seed)
    drifting = [start(0, 0, h, (current * math.cos(h), -current * math.sin(h), 0)) for h in range(boats)]
    sim = simulator(checker(ring(thick), hull=vessel.hull), vessel, drifting)
    (flow,) = sim.disturbances
    flow.speed[:], flow.direction[:] = current, [1, 0]  # type: ignore[attr-defined]
    inside = np.ones(boats, bool)
    hold, command = rng.integers(1, 30, boats), np.zeros((boats, 2))
    force, angle = sim.vessel.command_limit
    for step in range(80):
        new = step % hold == 0
        command[new] = rng.choice([-1, 1], (boats, 2))[new] * [force, angle]
        inside &= ~sim.step(command).collided
        assert (np.hypot(sim.eta[inside, 0], sim.eta[inside, 1]) < RING_M).all()
        if not inside.any():
            break


def test_random_boats_in_the_marina_do_not_enter_anything() -> None:
    """Twelve boats at up to 6 m/s through the reference marina: no origin gets into a solid unnoticed."""
    harbor, hull = reference_harbor(), Hull(length_m=1.0, beam_m=0.4)
    obstacles, rng = CollisionChecker(harbor, hull), np.random.default_rng(2)
    solids = [solid.mesh for part in harbor.parts for solid in part.solids if solid.mesh.is_watertight]
    begin = [start(20, y, h, (6, 0, 0)) for y, h in rng.uniform([-30, -3], [30, 3], (12, 2))]
    sim = simulator(obstacles, coasting(hull), begin)
    free = np.ones(12, bool)
    for _ in range(16):
        free &= ~sim.step(rng.choice([-1, 1], (12, 2)) * sim.vessel.command_limit).collided
        for x, y, _ in sim.eta[free]:
            point = np.array([[x, y, (hull.freeboard_m - hull.draft_m) / 2]])
            close = [m for m in solids if ((m.bounds[0] <= point[0]) & (m.bounds[1] >= point[0])).all()]
            assert not any(abs(winding(mesh, point[0])) > 0.5 for mesh in close)
    assert not free.all()


def winding(mesh: trimesh.Trimesh, point: Floats) -> float:
    """Winding number of a closed mesh around a point, by the solid angles of its triangles."""
    a, b, c = np.moveaxis(mesh.triangles - point, 1, 0)
    la, lb, lc = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    flat = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
    return float(2 * np.arctan2(volume, flat).sum() / (4 * np.pi))
