"""A marina from its description: quays, land, walkways, finger piers on piles, and moored vessels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dockctl.errors import Code, InputError, Problem
from dockctl.scenarios.harbor import (
    INTO_BASIN,
    QUAYS,
    BerthPlace,
    EndRow,
    Fleet,
    HarborSpec,
    Marina,
    Rectangle,
    Side,
    SideRow,
    point_off_quay,
)
from dockctl.sim.harbor.mesh_files import MooredModel, moored_model
from dockctl.sim.harbor.solids import Mesh, Part, Solid, box, tube

Corners = tuple[tuple[float, float], tuple[float, float]]

QUAY_HEIGHT_M = 1.0
QUAY_WIDTH_M = 12.0
COPING_WIDTH_M = 0.6
FINGER_HEIGHT_M = 0.5
LIGHT_INLAND_M = 1.2
"""Distance of the axis of a light from the entrance."""
PIER_POST_M = 0.45
"""Distance of the axis of a supply post from the edge of its pier."""
PILE_SPACING_M = 8.0
DEPTH_M = 1.0
"""Depth of quays and piles below the waterline; greater than the draft of hulls."""
SIDE_CLEARANCE_M = 0.3
"""Minimum width of the water beside a moored vessel, both sides together."""


@dataclass(frozen=True, eq=False)
class Berth:
    """A berth of a marina, and whether a vessel is moored there."""

    name: str
    place: BerthPlace
    occupied: bool


def marina_berths(spec: Marina) -> Iterator[Berth]:
    """Yield the berths of a marina, row by row."""
    for row in spec.rows:
        for at in row.berths:
            name = f"{row.side} berth {row.axis}={at:g}"
            yield Berth(name, BerthPlace(row.side, at), at not in row.free)


def marina_parts(spec: Marina, berths: Sequence[Berth], problems: list[Problem]) -> Iterator[Part]:
    """Yield the parts of a marina, and add the reasons for what is missing to `problems`."""
    yield from _quays(spec)
    yield from _land(spec)
    yield from _piers(spec)
    for row in spec.rows:
        yield from _fingers(spec, row)
    flaws = list(_model_problems(spec.fleet))
    problems += flaws
    if not flaws:
        yield from _moored(spec, berths, problems)


def harbor_problem(spec: HarborSpec, field: str, message: str, code: Code) -> Problem:
    """Return a problem in a field of a harbor."""
    return Problem(f"harbor '{spec.name}'", 0, 0, field, message, code)


def _quays(spec: Marina) -> Iterator[Part]:
    """Yield the four quays around the basin, with copings and furniture."""
    water = spec.basin
    x0, x1, y0, y1 = water.x_min_m, water.x_max_m, water.y_min_m, water.y_max_m
    w, c = QUAY_WIDTH_M, COPING_WIDTH_M
    footprints: dict[Side, tuple[Corners, Corners]] = {  # quay, and coping along its edge
        "east": (((x1, y0 - w), (x1 + w, y1 + w)), ((x1, y0), (x1 + c, y1))),
        "west": (((x0 - w, y0 - w), (x0, y1 + w)), ((x0 - c, y0), (x0, y1))),
        "north": (((x0, y1), (x1, y1 + w)), ((x0, y1), (x1, y1 + c))),
        "south": (((x0, y0 - w), (x1, y0)), ((x0, y0 - c), (x1, y0))),
    }
    for side, (whole, edge) in footprints.items():
        bodies = [
            solid
            for (low, high), (edge_low, edge_high) in _without_entrance(spec, side, whole, edge)
            for solid in (
                Solid("quay", box((*low, -DEPTH_M), (*high, QUAY_HEIGHT_M))),
                Solid("quay", box((*edge_low, QUAY_HEIGHT_M - 0.1), (*edge_high, QUAY_HEIGHT_M + 0.06))),
            )
        ]
        rows = [row for row in spec.rows if row.side == side and row.edge_m is None]
        furniture = [solid for row in rows for solid in _furniture(spec, row, QUAY_HEIGHT_M)]
        yield Part(f"{side} quay", "quay", (*bodies, *furniture))
    yield from _lights(spec)


def _without_entrance(
    spec: Marina, side: Side, whole: Corners, edge: Corners
) -> list[tuple[Corners, Corners]]:
    """Return a quay and its coping, or those on both sides of the entrance."""
    gap = spec.entrance
    if gap is None or gap.side != side:
        return [(whole, edge)]
    axis = 1 if side in ("east", "west") else 0

    def clipped(corners: Corners, low: float, high: float) -> Corners | None:
        ends = [list(corner) for corner in corners]
        ends[0][axis], ends[1][axis] = max(ends[0][axis], low), min(ends[1][axis], high)
        if ends[0][axis] >= ends[1][axis]:
            return None
        return (ends[0][0], ends[0][1]), (ends[1][0], ends[1][1])

    parts = []
    for low, high in ((-np.inf, gap.from_m), (gap.to_m, np.inf)):
        quay, coping = clipped(whole, low, high), clipped(edge, low, high)
        if quay and coping:
            parts.append((quay, coping))
    return parts


def _lights(spec: Marina) -> Iterator[Part]:
    """Yield a light on each side of the entrance, red to port of an entering boat (IALA region A)."""
    if (gap := spec.entrance) is None:
        return
    z = QUAY_HEIGHT_M
    tower = [(1.0, 0.0, z), (1.0, 0.0, z + 2.6), (1.0, 0.0, z + 3.1), (1.0, 0.0, z + 3.4)]
    edge = getattr(spec.basin, QUAYS[gap.side])
    for at in (gap.from_m - LIGHT_INLAND_M, gap.to_m + LIGHT_INLAND_M):
        frame = QuayFrame.at(gap.side, edge, at, gap=-2.0)
        to_port = frame.along(at) > frame.along((gap.from_m + gap.to_m) / 2)
        color = "red" if to_port else "green"
        light = Solid(f"{color} light", tube(tower, (0.35, 0.22, 0.3, 0.12), sides=12))
        yield Part(f"{color} light of the entrance", "quay", (frame.to_world(light),))


def _land(spec: Marina) -> Iterator[Part]:
    """Yield quays inside the basin, with copings on all sides and furniture."""
    c, z = COPING_WIDTH_M, QUAY_HEIGHT_M
    for index, area in enumerate(spec.land):
        low, high = (area.x_min_m, area.y_min_m), (area.x_max_m, area.y_max_m)
        strips = [
            (low, (low[0] + c, high[1])),
            ((high[0] - c, low[1]), high),
            ((low[0] + c, low[1]), (high[0] - c, low[1] + c)),
            ((low[0] + c, high[1] - c), (high[0] - c, high[1])),
        ]
        solids = [Solid("quay", box((*low, -DEPTH_M), (*high, z)))]
        if min(high[0] - low[0], high[1] - low[1]) > 2 * c:
            solids += [Solid("quay", box((*a, z - 0.1), (*b, z + 0.06))) for a, b in strips]
        yield Part(f"land {index + 1}", "quay", (*solids, *_furniture_on(spec, area, z)))


def _piers(spec: Marina) -> Iterator[Part]:
    """Yield walkways, with piles along both edges."""
    for index, area in enumerate(spec.piers):
        low, high = (area.x_min_m, area.y_min_m), (area.x_max_m, area.y_max_m)
        deck = Solid("finger", box((*low, FINGER_HEIGHT_M - 0.3), (*high, FINGER_HEIGHT_M)))
        furniture = _furniture_on(spec, area, FINGER_HEIGHT_M)
        yield Part(f"pier {index + 1}", "finger", (deck, *furniture))
        along = 0 if high[0] - low[0] > high[1] - low[1] else 1
        count = max(round((high[along] - low[along]) / PILE_SPACING_M), 1) + 1
        stations = np.linspace(low[along] + 0.3, high[along] - 0.3, count)
        edges = (low[1 - along] + 0.17, high[1 - along] - 0.17)
        places = [(at, edge) if along == 0 else (edge, at) for at in stations for edge in edges]
        piles = tuple(pile(x, y, 1.7, radius=0.16) for x, y in places)
        yield Part(f"piles of the pier {index + 1}", "pile", piles)


def _furniture_on(spec: Marina, area: Rectangle, z: float) -> list[Solid]:
    rows = [row for row in spec.rows if spec.under(row) is area]
    return [solid for row in rows for solid in _furniture(spec, row, z)]


def _furniture(spec: Marina, row: SideRow | EndRow, z: float) -> Iterator[Solid]:
    """Yield a supply post at every finger and a bollard at every berth, on a deck at height `z` [m]."""
    inland = 1.0 if z == QUAY_HEIGHT_M else PIER_POST_M
    post = Solid("roof", box((-inland - 0.15, -0.14, z), (0.15 - inland, 0.14, z + 1.1)))
    path = [(-0.3, 0.0, z), (-0.3, 0.0, z + 0.3), (-0.3, 0.0, z + 0.42)]
    bollard = Solid("engine", tube(path, (0.1, 0.1, 0.16), sides=8))
    for kind, places in ((post, row.fingers), (bollard, row.berths)):
        yield from (QuayFrame.of_row(spec, row, at).to_world(kind) for at in places)


def _fingers(spec: Marina, row: SideRow | EndRow) -> Iterator[Part]:
    """Yield finger decks and their piles, with a mooring pile at the head of each finger."""
    length, half = row.finger_length_m, row.finger_width_m / 2
    deck = Solid("finger", box((0.0, -half, FINGER_HEIGHT_M - 0.3), (length, half, FINGER_HEIGHT_M)))
    cleats = [
        Solid("rail", box((x, y - 0.04, FINGER_HEIGHT_M), (x + 0.3, y + 0.04, FINGER_HEIGHT_M + 0.1)))
        for x in (0.3 * length, 0.78 * length)
        for y in (half - 0.12, 0.12 - half)
    ]
    piles = [pile(x, y, 1.3) for x in (0.12 * length, 0.55 * length) for y in (half - 0.14, 0.14 - half)]
    piles.append(pile(length - 0.2, 0.0, 1.9, radius=0.17))
    for at in row.fingers:
        frame = QuayFrame.of_row(spec, row, at)
        where = f"{row.side} {row.axis}={at:g}"
        yield Part(f"finger pier {where}", "finger", tuple(map(frame.to_world, (deck, *cleats))))
        yield Part(f"piles of the finger pier {where}", "pile", tuple(map(frame.to_world, piles)))


def pile(x: float, y: float, height: float, radius: float = 0.13) -> Solid:
    """Return a round pile with a pointed cap, from below the water to `height` [m]."""
    heights = (-DEPTH_M, height - 0.15, height)
    return Solid("pile", tube([(x, y, z) for z in heights], (radius, radius, 0.2 * radius), sides=12))


def _moored(spec: Marina, berths: Sequence[Berth], problems: list[Problem]) -> Iterator[Part]:
    """Yield one vessel per occupied berth, and add the berths that are too narrow to `problems`.

    A model is drawn for a free berth as well, so that freeing a berth does not change the other vessels.
    """
    rng = np.random.Generator(np.random.PCG64(spec.fleet.seed))
    slots = [(i, j, row, at) for i, row in enumerate(spec.rows) for j, at in enumerate(row.berths)]
    pool: list[str] = []
    for (i, j, row, at), berth in zip(slots, berths, strict=True):
        width = _berth_width(row, at, spec) - SIDE_CLEARANCE_M
        model = _draw(pool, spec.fleet.models, width, rng)
        if not berth.occupied:
            continue
        if model is None:
            narrowest = min(moored_model(name).beam_m for name in spec.fleet.models)
            message = (
                f"the {berth.name} has space for a beam of {width:.2f} m, but the narrowest model of the"
                f" fleet has {narrowest:.2f} m; make the berth wider or free"
            )
            problems.append(
                harbor_problem(spec, f"harbor.rows.{i}.berth_{row.axis}_m.{j}", message, "mismatch")
            )
            continue
        frame = QuayFrame.of_row(spec, row, at, gap=spec.fleet.stern_gap_m)
        name = f"moored {model.vessel_class}, {berth.name}"
        yield Part(name, "vessel", tuple(map(frame.to_world, model.solids)))


def _model_problems(fleet: Fleet) -> Iterator[Problem]:
    """Yield the problems in the files of the fleet's models."""
    for index, name in enumerate(fleet.models):
        try:
            moored_model(name)
        except InputError as error:
            yield from (replace(problem, field=f"harbor.fleet.models.{index}") for problem in error.problems)


def _draw(
    pool: list[str], names: Sequence[str], width: float, rng: np.random.Generator
) -> MooredModel | None:
    """Take the first model not wider than `width` [m] from a shuffled pool, refilled when none fits."""
    for _ in range(2):
        for name in pool:
            if moored_model(name).beam_m <= width:
                pool.remove(name)
                return moored_model(name)
        pool += [names[i] for i in np.argsort(rng.random(len(names)))]
    return None


def _berth_width(row: SideRow | EndRow, at: float, spec: Marina) -> float:
    """Return the width of a berth: to the fingers, the quays, and half the distance to its neighbors [m]."""
    basin = spec.basin
    low, high = (basin.y_min_m, basin.y_max_m) if row.axis == "y" else (basin.x_min_m, basin.x_max_m)
    to_fingers = [abs(at - finger) - row.finger_width_m / 2 for finger in row.fingers]
    to_neighbors = [abs(at - berth) / 2 for berth in row.berths if berth != at]
    return 2 * min([at - low, high - at, *to_fingers, *to_neighbors])


@dataclass(frozen=True)
class QuayFrame:
    """A frame at the edge of a quay or pier: x toward the water, y to port of a boat moored stern-to."""

    x: float
    y: float
    cosine: int
    sine: int

    @classmethod
    def of_row(cls, spec: Marina, row: SideRow | EndRow, at: float, gap: float = 0.0) -> QuayFrame:
        """Return the frame `gap` meters off the edge of a row, at the coordinate `at` along it."""
        return cls.at(row.side, spec.edge_of(row), at, gap)

    @classmethod
    def at(cls, side: Side, edge: float, at: float, gap: float = 0.0) -> QuayFrame:
        """Return the frame `gap` meters off the coordinate `edge`, at the coordinate `at` along it."""
        return cls(*point_off_quay(side, edge, at, gap), *INTO_BASIN[side])

    def along(self, at: float) -> float:
        """Return the coordinate to port of a point along the quay [m]."""
        return (at - self.y) * self.cosine - (at - self.x) * self.sine

    def to_world(self, solid: Solid) -> Solid:
        """Return the solid transformed from this frame to the world frame."""
        turn = np.array(
            [[self.cosine, -self.sine, 0], [self.sine, self.cosine, 0], [0, 0, 1]], dtype=np.float64
        )
        vertices = solid.mesh.vertices @ turn.T + (self.x, self.y, 0.0)
        return Solid(solid.kind, Mesh(vertices, solid.mesh.faces))
