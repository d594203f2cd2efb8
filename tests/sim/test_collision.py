"""Collisions against plane geometry and brute force over triangles, and containment without contact."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import assume, given
from hypothesis import strategies as st

from dockctl.scenarios.harbor import MeshFile, MeshHarbor
from dockctl.scenarios.vessel import Hull
from dockctl.sim.collision import CollisionChecker
from dockctl.sim.harbor.build import assemble, build_harbor
from dockctl.sim.harbor.solids import Mesh, Part, Solid, box, hull_mesh, hull_outline, prism
from tests.sim.harbor.harbors import reference_harbor
from tests.sim.meshes import peer

HULL = Hull()


def checker(*solids: Mesh | trimesh.Trimesh, hull: Hull = HULL) -> CollisionChecker:
    parts = [Part(f"solid {i}", "mesh", (Solid("mesh", mesh),)) for i, mesh in enumerate(solids)]
    return CollisionChecker(assemble("test", parts), hull)


def pose(x: float, y: float, heading_deg: float) -> np.ndarray:
    return np.array([[x, y, np.radians(heading_deg)]])


# Upright prisms at the height of the boat touch it if their outlines touch: the reference is plane geometry.


def placed(outline: np.ndarray, eta: np.ndarray) -> np.ndarray:
    cosine, sine = np.cos(eta[2]), np.sin(eta[2])
    return outline @ np.array([[cosine, sine], [-sine, cosine]]) + eta[:2]


def separation(a: np.ndarray, b: np.ndarray) -> float:
    """Largest gap between two convex polygons along the normals of their edges; negative if they overlap."""
    gaps = []
    for p, q in ((a, b), (b, a)):
        along = np.roll(p, -1, axis=0) - p
        normals = np.stack((along[:, 1], -along[:, 0]), axis=1) / np.linalg.norm(along, axis=1)[:, None]
        gaps.append(((q @ normals.T).min(axis=0) - np.einsum("ij,ij->i", p, normals)).max())
    return max(gaps)


def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Distance of two disjoint polygons: from a corner of one to an edge of the other."""
    best = np.inf
    for p, q in ((a, b), (b, a)):
        for start, end in zip(q, np.roll(q, -1, axis=0), strict=True):
            part = np.clip((p - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
            best = min(best, np.linalg.norm(p - start - part[:, None] * (end - start), axis=1).min())
    return best


coordinates = st.floats(-5, 5)
headings = st.floats(-np.pi, np.pi)
sizes = st.floats(0.2, 4)


@given(coordinates, coordinates, headings, sizes, sizes)
def test_boat_and_box_as_in_the_plane(x: float, y: float, heading: float, a: float, b: float) -> None:
    eta = np.array([x, y, heading])
    block = np.array([(-a, -b), (a, -b), (a, b), (-a, b)])
    outline = placed(hull_outline(HULL), eta)
    gap = separation(outline, block)
    assume(abs(gap) > 1e-6)
    boat = checker(prism(block, -1.0, 1.0))
    assert boat.blocked(eta[None])[0] == (gap < 0)
    if gap > 0:
        assert boat.clearance(eta[None])[0] == pytest.approx(distance(outline, block), abs=1e-6)


def test_contact_limits_of_a_wall_ahead() -> None:
    wall = checker(box((10, -5, -1), (12, 5, 1)))
    bow = 10 - HULL.length_m / 2
    ahead = np.array([[bow - 1e-6, 0, 0], [bow + 1e-6, 0, 0], [bow - 4, 0, 0]])
    assert wall.collides(ahead).tolist() == [False, True, False]
    assert wall.clearance(ahead) == pytest.approx([1e-6, 0.0, 4.0], abs=1e-9)
    for limit_m in (0.5, 3.9999, 4.0001, 50.0):
        expected = np.minimum([1e-6, 0.0, 4.0], limit_m)
        assert wall.clearance_below(ahead, limit_m) == pytest.approx(expected, abs=1e-9)


def test_solids_above_or_below_the_boat_are_no_obstacles() -> None:
    eta = pose(0, 0, 30)
    bridge = box((-5, -5, HULL.freeboard_m + 0.1), (5, 5, 3))
    rock = box((-5, -5, -3), (5, 5, -HULL.draft_m - 0.2))
    boat = checker(bridge, rock)
    assert not boat.blocked(eta)[0]
    assert boat.clearance(eta)[0] == pytest.approx(0.1)
    assert boat.clearance_below(eta, 0.3)[0] == pytest.approx(0.1)


# Containment without contact of surfaces


def test_boat_inside_a_closed_solid_is_blocked_without_contact() -> None:
    land = checker(box((-20, -20, -5), (20, 20, 5)))
    eta = np.concatenate((pose(0, 0, 0), pose(7, -3, 77), pose(30, 0, 0)))
    assert not land.collides(eta).any()
    assert land.blocked(eta).tolist() == [True, True, False]
    assert land.clearance_below(eta, 0.5).tolist() == [0, 0, 0.5]
    assert land.collided_part(eta[0]) == "solid 0"
    assert land.collided_part(eta[2]) is None


def test_solid_inside_the_boat_is_blocked_without_contact() -> None:
    buoy = checker(box((4.9, -0.1, -0.1), (5.1, 0.1, 0.2)))
    eta = np.concatenate((pose(5, 0, 0), pose(4.6, 0.1, 20), pose(0, 0, 0)))
    assert not buoy.collides(eta).any()
    assert buoy.blocked(eta).tolist() == [True, True, False]
    assert buoy.collided_part(eta[0]) == "solid 0"


def test_boat_in_a_basin_enclosed_by_a_solid_is_free() -> None:
    ring = trimesh.creation.annulus(r_min=6.0, r_max=9.0, height=2.0, sections=17)
    for eta, blocked in ((pose(0, 0, 0), False), (pose(4, 0, 90), False), (pose(7.5, 0, 90), True)):
        assert checker(ring).blocked(eta)[0] == blocked


def test_open_surface_has_no_inside() -> None:
    shell = peer(box((-20, -20, -5), (20, 20, 5)))
    shell.update_faces(np.arange(len(shell.faces)) > 0)
    assert not checker(shell).blocked(pose(0, 0, 0))[0]


def test_an_inverted_solid_blocks_too() -> None:
    land = peer(box((-20, -20, -5), (20, 20, 5)))
    land.invert()
    assert checker(land).blocked(pose(0, 0, 0))[0]


@given(st.integers(-8, 8), st.integers(-8, 8), st.integers(3, 24))
def test_corners_level_with_the_boat_count_once(x: int, y: int, corners: int) -> None:
    angles = 2 * np.pi * np.arange(corners) / corners
    level = (HULL.freeboard_m - HULL.draft_m) / 2
    outline = np.round(20 * np.stack((np.cos(angles), np.sin(angles)), axis=1))
    disc = prism(outline, -5.0, 5.0)
    double = prism(outline, -5.0, level)  # its top is at the height of the cross-section
    normals = np.roll(outline, -1, axis=0) - outline
    dx, dy = normals.T
    depth = (dx * (y - outline[:, 1]) - dy * (x - outline[:, 0])) / np.hypot(dx, dy)
    assume(depth.min() > 2.0)  # the whole boat is inside
    assert checker(disc).blocked(pose(x, y, 0))[0]
    assert checker(disc, double).blocked(pose(x, y, 0))[0]


# The reference marina, by brute force over triangles.


def pierced(segments: np.ndarray, triangles: np.ndarray) -> bool:
    """Whether a segment (k, 2, 3) passes through a triangle (m, 3, 3)."""
    start, along = segments[:, None, 0], segments[:, None, 1] - segments[:, None, 0]
    a, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(u, v)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = ((a - start) * normal).sum(-1) / (along * normal).sum(-1)
        offset = start + t[..., None] * along - a
        across = np.cross(offset, v)
        beside = np.cross(u, offset)
        p, q = ((w * normal).sum(-1) / (normal * normal).sum(-1) for w in (across, beside))
        hit = (t >= 0) & (t <= 1) & (p >= 0) & (q >= 0) & (p + q <= 1)
    return bool(hit.any())


def edges(triangles: np.ndarray) -> np.ndarray:
    return np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)])


def test_contacts_in_the_marina_equal_brute_force() -> None:
    harbor = reference_harbor()
    rng = np.random.default_rng(3)
    eta = np.column_stack(
        (rng.uniform(5, 38, 150), rng.uniform(-38, 38, 150), rng.uniform(-np.pi, np.pi, 150))
    )
    found = CollisionChecker(harbor, HULL).collides(eta)
    assert 20 < found.sum() < 130
    low, high = harbor.triangles.min(axis=1), harbor.triangles.max(axis=1)
    for row, (x, y, heading) in enumerate(eta):
        boat = peer(hull_mesh(HULL))
        boat.apply_transform(
            trimesh.transformations.compose_matrix(angles=(0, 0, heading), translate=(x, y, 0))
        )
        near = ((low <= boat.bounds[1]) & (high >= boat.bounds[0])).all(axis=1)
        solids = harbor.triangles[near]
        touching = pierced(edges(boat.triangles), solids) or pierced(edges(solids), boat.triangles)
        assert found[row] == touching


def test_clearance_in_the_marina_equals_brute_force() -> None:
    harbor = reference_harbor()
    boat = CollisionChecker(harbor, HULL)
    for eta in (pose(20, 2, 160), pose(36, 0, 180), pose(23, -10, 90), pose(7, -2, 0), pose(33, 1, 140)):
        moved = peer(hull_mesh(HULL))
        moved.apply_transform(
            trimesh.transformations.compose_matrix(angles=(0, 0, eta[0, 2]), translate=(*eta[0, :2], 0))
        )
        clearance = boat.clearance(eta)[0]
        gap = np.maximum(
            harbor.triangles.min(axis=1) - moved.bounds[1], moved.bounds[0] - harbor.triangles.max(axis=1)
        )
        near = harbor.triangles[np.linalg.norm(np.maximum(gap, 0), axis=1) <= clearance + 0.2]
        assert triangle_distance(moved.triangles, near) == pytest.approx(clearance, abs=1e-6)


def triangle_distance(a: np.ndarray, b: np.ndarray) -> float:
    """Distance of two disjoint sets of triangles: corner to triangle or edge to edge."""
    best = np.inf
    for p, q in ((a, b), (b, a)):
        for corner in np.unique(p.reshape(-1, 3), axis=0):
            nearest = trimesh.triangles.closest_point(q, np.tile(corner, (len(q), 1)))
            best = min(best, np.linalg.norm(nearest - corner, axis=1).min())
    for start, end in edges(a):
        best = min(best, segment_distances(start, end, edges(b)).min())
    return best


def segment_distances(start: np.ndarray, end: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Distance of one segment to each of (k, 2, 3) others if both feet are inside; else infinity."""
    u, v, w = end - start, others[:, 1] - others[:, 0], start - others[:, 0]
    a, b, c, d, e = u @ u, v @ u, (v * v).sum(-1), w @ u, (w * v).sum(-1)
    det = a * c - b * b
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = (b * e - c * d) / det, (a * e - b * d) / det
        inner = (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
        gaps = np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=1)
    return np.where(inner, gaps, np.inf)


@pytest.mark.parametrize(
    ("eta", "name"),
    [
        (pose(38, 0, 180), "east quay"),
        (pose(45, 0, 180), "east quay"),
        (pose(34, -2.5, 180), "finger pier east y=-2.5"),
        (pose(36, 9, 180), "moored motor yacht, east berth y=9"),
        (pose(20, 39.5, 0), "north quay"),
        (pose(20, 0, 0), None),
    ],
)
def test_the_name_of_the_part_that_is_hit(eta: np.ndarray, name: str | None) -> None:
    found = CollisionChecker(reference_harbor(), HULL).collided_part(eta[0])
    assert found == name


def test_poses_do_not_influence_each_other() -> None:
    rng = np.random.default_rng(5)
    eta = np.column_stack((rng.uniform(5, 38, 60), rng.uniform(-38, 38, 60), rng.uniform(-3, 3, 60)))
    boat = CollisionChecker(reference_harbor(), HULL)
    together = boat.blocked(eta)
    assert together.tolist() == [boat.blocked(row[None])[0] for row in eta]
    assert together.tolist() == boat.blocked(eta[::-1])[::-1].tolist()
    with ThreadPoolExecutor(4) as pool:
        assert all(np.array_equal(result, together) for result in pool.map(boat.blocked, [eta] * 16))


@pytest.mark.thorough
def test_surfaces_that_are_built_again_give_the_same_results(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(6)
    eta = np.column_stack((rng.uniform(5, 38, 20), rng.uniform(-38, 38, 20), rng.uniform(-3, 3, 20)))
    boat, other = (CollisionChecker(reference_harbor(), HULL) for _ in range(2))
    expected = boat.clearance_below(eta, 3.0)
    other.clearance_below(eta, 3.0)
    monkeypatch.setattr("dockctl.sim.collision.KEPT_TRIANGLES", 500)
    monkeypatch.setattr("dockctl.sim.collision._Surfaces._built", 1000)
    other._low.of_part(other._low._objects.popitem()[0])  # the first build beyond the limit
    kept = [surfaces for checker in (boat, other) for surfaces in (checker._low, checker._high)]
    assert sum(len(surfaces._objects) for surfaces in kept) == 1
    np.testing.assert_array_equal(other.clearance_below(eta, 3.0), expected)
    with ThreadPoolExecutor(4) as pool:
        assert all(
            np.array_equal(result, expected)
            for result in pool.map(lambda poses: boat.clearance_below(poses, 3.0), [eta] * 8)
        )


def test_bounds_overlap_where_their_gap_is_zero() -> None:
    surfaces, rng = CollisionChecker(reference_harbor(), HULL)._low, np.random.default_rng(7)
    corners = rng.uniform((0, -40), (40, 40), (200, 2, 2))
    drawn = np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)
    beside = np.concatenate([surfaces._high, surfaces._high + 1.0], axis=1)  # touch a part in one point
    boxes = np.concatenate([drawn, beside[np.isfinite(beside).all(axis=1)]])
    gaps = surfaces.gaps(boxes)
    assert np.array_equal(surfaces.overlaps(boxes), gaps == 0)
    assert 0 < (gaps == 0).sum() < gaps.size


def test_no_poses_give_empty_results() -> None:
    boat = CollisionChecker(reference_harbor(), HULL)
    for answer in (boat.collides, boat.blocked, boat.clearance):
        assert answer(np.empty((0, 3))).shape == (0,)


def test_a_mesh_file_blocks_like_its_solid(tmp_path: Path) -> None:
    peer(box((2, -3, -1), (4, 3, 2))).export(tmp_path / "pier.ply")
    spec = MeshHarbor(kind="meshes", meshes=(MeshFile(path="pier.ply"),))
    boat = CollisionChecker(build_harbor(spec, tmp_path), HULL)
    assert boat.blocked(np.concatenate((pose(0, 0, 0), pose(0, 0, 90)))).tolist() == [False, False]
    assert boat.clearance(pose(0, 0, 0))[0] == pytest.approx(0.5)
    assert boat.collided_part(pose(1, 0, 0)[0]) == "pier.ply"
