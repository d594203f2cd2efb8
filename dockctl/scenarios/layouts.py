"""The harbors of a scenario: its own, copies of it with different vacant berths, or generated layouts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from dockctl.scenarios.berths import BerthKind, Berths
from dockctl.scenarios.harbor import (
    Basin,
    BerthPlace,
    EndRow,
    Entrance,
    Fleet,
    Generated,
    HarborSpec,
    Interval,
    Marina,
    Rectangle,
    Side,
    SideRow,
)

LONGEST_CM = ((264, 550), (335, 720), (347, 870), (362, 890), (10**9, 1000))
"""Length of the longest of the default models in a berth narrower than this [cm]."""
STERN_GAP_CM = (50, 90)
REFERENCE_CM = (3850, 0)
"""The east quay, and the free berth nearest to its middle: in every layout its pose is (36, 0, 180°)."""
END_MARGIN_CM = (150, 600)
"""Range of the distance from an end of the basin to the first finger pier."""
PASSAGE_CM = (1000, 1500)
"""Range of the distance between the head of a walkway and the end of the basin."""
PIER_WIDTH_CM = (160, 260)
WEST_ROW, BACK_ROW, OPEN_BAY = 0.8, 0.5, 0.35
"""Probabilities of berths at the west quay, of berths at the inner end, and of a missing last finger."""


class Layout(NamedTuple):
    """A harbor of a scenario and the free berths in it to which the task can be moved."""

    harbor: HarborSpec
    kind: BerthKind | None
    berths: tuple[BerthPlace, ...]


def layouts(harbor: HarborSpec, berths: Berths | None) -> tuple[Layout, ...]:
    """Return the harbors of a scenario.

    They are its own harbor, or one for each group of berths that are vacant together, or the generated
    layouts. A group has every k-th berth of the list, so that the neighbors of a free berth are occupied.
    """
    if isinstance(harbor, Generated) and berths is not None:
        trained = range(harbor.seed, harbor.seed + harbor.layouts)
        held_out = range(harbor.held_out_seed, harbor.held_out_seed + harbor.held_out_layouts)
        return tuple(_generated(harbor, seed, "trained") for seed in trained) + tuple(
            _generated(harbor, seed, "held_out") for seed in held_out
        )
    if berths is None:
        return (Layout(harbor, None, ()),)
    assert isinstance(harbor, Marina)  # checked by the scenario's validator
    kinds: tuple[BerthKind, ...] = ("trained", "held_out")
    groups = []
    for kind in kinds:
        places = berths.places(kind)
        count = -(-len(places) // berths.vacant)
        groups += [(kind, places[first::count]) for first in range(count)]
    return tuple(Layout(_with_vacant_berths(harbor, places), kind, places) for kind, places in groups)


def _generated(spec: Generated, seed: int, kind: BerthKind) -> Layout:
    marina = generate(spec, seed)
    return Layout(marina, kind, tuple(BerthPlace(row.side, at) for row in marina.rows for at in row.free))


def _with_vacant_berths(marina: Marina, places: tuple[BerthPlace, ...]) -> Marina:
    """Return the marina with only these berths free."""
    rows = [
        row.model_copy(
            update={
                f"free_{row.axis}_m": tuple(
                    at for side, at in places if side == row.side and at in row.berths
                )
            }
        )
        for row in marina.rows
    ]
    return marina.model_copy(update={"rows": tuple(rows)})


class _Draws:
    """Random numbers derived only from uniform ones, so that a seed gives the same layout everywhere."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.Generator(np.random.PCG64(seed))

    def chance(self, probability: float) -> bool:
        return bool(self._rng.random() < probability)

    def integer(self, low: int, high: int, step: int = 1) -> int:
        """Draw one of low, low + step, ... up to `high`."""
        return low + step * int(self._rng.random() * ((high - low) // step + 1))

    def length(self, interval: Interval) -> int:
        """Draw a multiple of 10 cm [cm] from an interval in meters."""
        low, high = (round(100 * bound) for bound in interval)
        return min(self.integer(low, max(low, high), 10), high)

    def order(self, count: int) -> list[int]:
        """Return the numbers from 0 in random order."""
        return [int(index) for index in np.argsort(self._rng.random(count), kind="stable")]


@dataclass(frozen=True)
class _Style:
    """How the berths of one row are divided, lengths in cm; a row without fingers has `finger` 0."""

    berth: int
    finger: int
    between: int
    finger_length: int

    @classmethod
    def draw(cls, spec: Generated, draws: _Draws) -> _Style:
        berth, finger = draws.length(spec.berth_width_m), draws.length(spec.finger_width_m)
        between = draws.integer(*spec.berths_between_fingers)
        if spec.without_fingers and draws.chance(spec.without_fingers):
            return cls(berth, 0, 1, 0)
        longest = _longest(berth)
        return cls(berth, finger, between, draws.integer(longest * 7 // 10 // 50 * 50, longest, 50))

    @property
    def depth(self) -> int:
        """From the edge to the farthest bow or finger head."""
        return max(self.finger_length, _longest(self.berth) + STERN_GAP_CM[1])


def _longest(berth: int) -> int:
    return next(length for below, length in LONGEST_CM if berth < below)


@dataclass(frozen=True)
class _Row:
    """A row before it is placed: positions along and across it in cm."""

    side: Side
    style: _Style
    fingers: tuple[int, ...]
    berths: tuple[int, ...]
    edge: int | None = None


@dataclass(frozen=True)
class _Plan:
    """A layout with its origin at the corner of the basin: x to the east, y to the north [cm].

    The first row is at the east quay.
    """

    width: int
    length: int
    rows: list[_Row]
    piers: list[tuple[int, int, int, int]]
    entrance: tuple[int, int]
    entrance_south: bool


@cache
def generate(spec: Generated, seed: int) -> Marina:
    """Return the layout of one seed.

    Berths are along the east quay, usually along the west quay, on both sides of walkways that start at the
    inner end, or at the inner end itself; the entrance is at the other end, facing a fairway. All water is
    connected, because walkways leave a passage at their heads, and there is a fairway in front of all berths.
    """
    draws = _Draws(seed)
    plan = _plan(spec, draws)
    at_quay = plan.rows[0].berths
    reference = min(at_quay, key=lambda at: (abs(2 * at - at_quay[0] - at_quay[-1]), at))
    free = _drawn_free(spec, draws, plan.rows, reference)
    dx, dy = REFERENCE_CM[0] - plan.width, REFERENCE_CM[1] - reference

    def rectangle(x0: int, y0: int, x1: int, y1: int) -> dict[str, float]:
        corners = {"x_min_m": x0 + dx, "y_min_m": y0 + dy, "x_max_m": x1 + dx, "y_max_m": y1 + dy}
        return {key: value / 100 for key, value in corners.items()}

    return Marina(
        kind="marina",
        name=f"{spec.name}-{seed}",
        basin=Basin(**rectangle(0, 0, plan.width, plan.length)),
        entrance=Entrance(
            side="south" if plan.entrance_south else "north",
            from_m=(plan.entrance[0] + dx) / 100,
            to_m=(plan.entrance[1] + dx) / 100,
        ),
        piers=tuple(Rectangle(**rectangle(*pier)) for pier in plan.piers),
        rows=tuple(_placed(row, free[index], dx, dy) for index, row in enumerate(plan.rows)),
        fleet=Fleet(seed=draws.integer(0, 10**6), stern_gap_m=draws.integer(*STERN_GAP_CM, 10) / 100),
    )


def _plan(spec: Generated, draws: _Draws) -> _Plan:
    """Draw a layout from east to west: a row, a fairway, walkways with rows and a fairway, a row."""
    length, count = draws.length(spec.basin_length_m), draws.integer(*spec.piers)
    east = _Style.draw(spec, draws)
    sides = [(_Style.draw(spec, draws), _Style.draw(spec, draws)) for _ in range(count)]
    west = _Style.draw(spec, draws) if draws.chance(WEST_ROW) else None
    back = _Style.draw(spec, draws) if count == 0 and draws.chance(BACK_ROW) else None
    fairways = [draws.length(spec.fairway_m) for _ in range(count + 1)]
    widths = [draws.integer(*PIER_WIDTH_CM, 20) for _ in range(count)]
    depths = [sum(style.depth for style in pair) for pair in sides]
    west_depth = west.depth if west else 0
    width = east.depth + sum(fairways) + sum(widths) + sum(depths) + west_depth
    # The entrance is at the south end here; half of the layouts are mirrored afterwards.
    near, inner = draws.integer(*END_MARGIN_CM, 10), length - draws.integer(*END_MARGIN_CM, 10)
    passage = draws.integer(*PASSAGE_CM, 10)
    inner_row = _row(draws, "north", back, west_depth + 100, width - east.depth - 100) if back else None
    if back and inner_row:
        before_back = length - back.depth - round(100 * spec.fairway_m[0]) // 2
        inner, inner_row = (min(inner, before_back), inner_row) if before_back > length / 2 else (inner, None)
    rows = [_row(draws, "east", east, near, inner)]
    piers, channels = [], []
    x = width - east.depth
    for fairway, (facing_east, facing_west), across in zip(fairways, sides, widths, strict=False):
        channels.append((x - fairway, x))
        x_max = x - fairway - facing_east.depth
        x_min = x_max - across
        piers.append((x_min, passage, x_max, length))
        rows.append(_row(draws, "west", facing_east, passage, inner, x_max))
        rows.append(_row(draws, "east", facing_west, passage, inner, x_min))
        x = x_min - facing_west.depth
    channels.append((x - fairways[-1], x))
    rows += [_row(draws, "west", west, near, inner) if west else None, inner_row]
    low, high = channels[draws.integer(0, count)]
    opening = min(draws.length(spec.entrance_m), high - low)
    start = draws.integer(low, high - opening, 10)
    there = _distinct([row for row in rows if row])
    plan = _Plan(width, length, there, piers, (start, start + opening), entrance_south=True)
    return _mirrored(plan) if draws.chance(0.5) else plan


def _row(
    draws: _Draws, side: Side, style: _Style, low: int, high: int, edge: int | None = None
) -> _Row | None:
    """Fill the edge between two positions with bays; None if there is no space for a berth."""
    between = min(style.between, (high - low - 2 * style.finger) // style.berth)
    if between < 1:
        return None
    bay = between * style.berth + style.finger
    bays = (high - low - style.finger) // bay
    slack = high - low - style.finger - bays * bay
    start = low + (slack if edge is not None and draws.chance(0.5) else draws.integer(0, slack, 10))
    fingers = [start + style.finger // 2 + bay * i for i in range(bays + 1)] if style.finger else []
    if bays > 1 and between > 1 and draws.chance(OPEN_BAY):
        fingers = fingers[1:]
    first = start + style.finger + style.berth // 2
    berths = [first + bay * i + style.berth * j for i in range(bays) for j in range(between)]
    return _Row(side, style, tuple(fingers), tuple(berths), edge)


def _distinct(rows: list[_Row]) -> list[_Row]:
    """Shift rows by centimeters, so that no two berths of one side have the same position along it."""
    taken: set[tuple[Side, int]] = set()
    moved = []
    for row in rows:
        by = next(by for by in range(1000) if not {(row.side, at + by) for at in row.berths} & taken)
        fingers, berths = (tuple(at + by for at in places) for places in (row.fingers, row.berths))
        taken |= {(row.side, at) for at in berths}
        moved.append(_Row(row.side, row.style, fingers, berths, row.edge))
    return moved


def _mirrored(plan: _Plan) -> _Plan:
    """Return the plan with north and south exchanged."""
    length = plan.length

    def flip(row: _Row) -> _Row:
        if row.side in ("north", "south"):
            return _Row("south" if row.side == "north" else "north", row.style, row.fingers, row.berths)
        fingers, berths = (tuple(length - at for at in reversed(p)) for p in (row.fingers, row.berths))
        return _Row(row.side, row.style, fingers, berths, row.edge)

    piers = [(x0, length - y1, x1, length - y0) for x0, y0, x1, y1 in plan.piers]
    return _Plan(plan.width, length, [flip(row) for row in plan.rows], piers, plan.entrance, False)


def _drawn_free(spec: Generated, draws: _Draws, rows: list[_Row], reference: int) -> list[set[int]]:
    """Return the free berths of each row: the reference berth of the first row, and others."""
    others = [(i, at) for i, row in enumerate(rows) for at in row.berths if (i, at) != (0, reference)]
    chosen = [others[k] for k in draws.order(len(others))[: draws.integer(*spec.free_berths) - 1]]
    free: list[set[int]] = [{reference}, *(set() for _ in rows[1:])]
    for index, at in chosen:
        free[index].add(at)
    return free


def _placed(row: _Row, free: set[int], dx: int, dy: int) -> SideRow | EndRow:
    along, across = (dy, dx) if row.side in ("east", "west") else (dx, dy)
    axis = "y" if row.side in ("east", "west") else "x"
    positions = {"finger": row.fingers, "berth": row.berths, "free": sorted(free)}
    data: dict[str, Any] = {
        f"{name}_{axis}_m": tuple((at + along) / 100 for at in places) for name, places in positions.items()
    }
    data |= {
        "side": row.side,
        "edge_m": None if row.edge is None else (row.edge + across) / 100,
    }
    if row.fingers:
        data |= {
            "finger_length_m": row.style.finger_length / 100,
            "finger_width_m": row.style.finger / 100,
        }
    return (SideRow if axis == "y" else EndRow).model_validate(data)
