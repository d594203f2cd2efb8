"""Ray casting: ray-triangle intersection, and a tracer with a bounding volume hierarchy.

The tracer is the reference implementation of the LiDAR scan, without shells or grids. The fast scan in
`dockctl.sim.lidar.scan` uses the same `hit_triangle`, so that the results are identical to the last bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dockctl.compute import compiled
from dockctl.geometry import Floats

Ints = NDArray[np.int32]

LEAF_TRIANGLES = 4
MISS = np.inf


# For functions that allocate nothing: skips reference counting of the arrays in their tuples, which takes a
# third of the time in the inner loops of a scan.
compiled_bare = compiled(_nrt=False)


@compiled(inline="always")
def hit_triangle(triangle: Floats, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> float:
    """Return the ray parameter of the intersection with a triangle, from either side, or infinity.

    Moeller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997.

    Args:
        triangle: (9,) one corner and the two edges from it [m].
        ox, oy, oz, dx, dy, dz: origin [m] and direction of the ray.
    """
    ax, ay, az = triangle[3], triangle[4], triangle[5]
    bx, by, bz = triangle[6], triangle[7], triangle[8]
    px = dy * bz - dz * by
    py = dz * bx - dx * bz
    pz = dx * by - dy * bx
    determinant = ax * px + ay * py + az * pz
    if determinant == 0.0:
        return MISS
    inverse = 1.0 / determinant
    sx, sy, sz = ox - triangle[0], oy - triangle[1], oz - triangle[2]
    u = (sx * px + sy * py + sz * pz) * inverse
    if u < 0.0 or u > 1.0:
        return MISS
    qx = sy * az - sz * ay
    qy = sz * ax - sx * az
    qz = sx * ay - sy * ax
    v = (dx * qx + dy * qy + dz * qz) * inverse
    if v < 0.0 or u + v > 1.0:
        return MISS
    t = (bx * qx + by * qy + bz * qz) * inverse
    return t if t >= 0.0 else MISS


def corner_and_edges(triangles: Floats) -> Floats:
    """Convert (m, 3, 3) corners to (m, 9): one corner and the two edges from it."""
    corner = triangles[:, 0]
    return np.ascontiguousarray(
        np.concatenate([corner, triangles[:, 1] - corner, triangles[:, 2] - corner], axis=1)
    )


@dataclass(frozen=True, eq=False)
class BoundingVolumes:
    """A binary tree of axis-aligned bounding boxes, split at the median of the longest side.

    Attributes:
        boxes: (nodes, 6) lower and upper corner [m].
        children: (nodes, 2) the two children of a node; for a leaf, (-first - 1, count) in `triangles`.
        triangles: (m, 9) in the order of the leaves.
    """

    boxes: Floats
    children: Ints
    triangles: Floats

    @classmethod
    def build(cls, triangles: Floats) -> BoundingVolumes:
        """Build the tree over (m, 3, 3) triangles [m]."""
        low, high = triangles.min(axis=1), triangles.max(axis=1)
        centers = (low + high) / 2
        boxes: list[Floats] = []
        children: list[tuple[int, int]] = []
        order: list[Ints] = []
        placed = 0

        def add(members: NDArray[np.int64]) -> int:
            nonlocal placed
            node = len(boxes)
            box = np.concatenate([low[members].min(axis=0), high[members].max(axis=0)])
            # Margin: rounding in the slab test must not lose a triangle in a face of the box.
            boxes.append(box + np.repeat([-1e-9, 1e-9], 3))
            children.append((-placed - 1, len(members)))
            if len(members) <= LEAF_TRIANGLES:
                order.append(members.astype(np.int32))
                placed += len(members)
                return node
            axis = int(np.argmax(np.ptp(centers[members], axis=0)))
            ranked = members[np.argsort(centers[members, axis], kind="stable")]
            middle = len(ranked) // 2
            children[node] = (add(ranked[:middle]), add(ranked[middle:]))
            return node

        if len(triangles):
            add(np.arange(len(triangles)))
        ranks = np.concatenate(order) if order else np.empty(0, np.int32)
        return cls(
            np.array(boxes, np.float64).reshape(-1, 6),
            np.array(children, np.int32).reshape(-1, 2),
            corner_and_edges(triangles[ranks]),
        )

    def trace(self, pose: Floats, origins: Floats, directions: Floats, reach: Floats) -> Floats:
        """Return the distance to the closest hit of each ray [m], infinity for a miss.

        Args:
            pose: (3,) of the body in the world frame.
            origins, directions: (k, 3) of the rays in the body frame [m].
            reach: (k,) length of the rays [m].
        """
        x, y, heading = pose
        c, s = math.cos(heading), math.sin(heading)
        starts = _rotated(origins, c, s)
        starts[:, 0] += x
        starts[:, 1] += y
        return closest_hits(
            self.boxes, self.children, self.triangles, starts, _rotated(directions, c, s), reach
        )


def _rotated(vectors: Floats, c: float, s: float) -> Floats:
    """Rotate (k, 3) vectors about z by the angle with cosine c and sine s."""
    x, y, z = vectors.T
    return np.stack([c * x - s * y, s * x + c * y, z], axis=1)


@compiled()
def closest_hits(
    boxes: Floats, children: Ints, triangles: Floats, origins: Floats, directions: Floats, reach: Floats
) -> Floats:
    """Return the ray parameters (k,) of the closest hits within `reach` (k,), infinity for a miss."""
    hits = np.full(len(origins), MISS)
    if len(boxes) == 0:
        return hits
    stack = np.empty(128, np.int32)
    for ray in range(len(origins)):
        ox, oy, oz = origins[ray]
        dx, dy, dz = directions[ray]
        best = MISS
        stack[0] = 0
        depth = 1
        while depth > 0:
            depth -= 1
            node = stack[depth]
            near, far = 0.0, min(best, reach[ray])
            for axis in range(3):
                o = origins[ray, axis]
                d = directions[ray, axis]
                if d != 0.0:
                    a = (boxes[node, axis] - o) / d
                    b = (boxes[node, axis + 3] - o) / d
                    near = max(near, min(a, b))
                    far = min(far, max(a, b))
                elif o < boxes[node, axis] or o > boxes[node, axis + 3]:
                    far = -1.0
            if near > far:
                continue
            left, right = children[node]
            if left >= 0:
                stack[depth] = left
                stack[depth + 1] = right
                depth += 2
                continue
            for index in range(-left - 1, -left - 1 + right):
                t = hit_triangle(triangles[index], ox, oy, oz, dx, dy, dz)
                if t <= reach[ray] and t < best:
                    best = t
        hits[ray] = best
    return hits
