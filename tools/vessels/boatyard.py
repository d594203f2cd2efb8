"""Parts of boats: hulls lofted from their lines, deckhouses, rigs, rails, engines.

The frame has x from the transom forward, y to port, z up from the waterline; meters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dockctl.sim.harbor.solids import Mesh, Points, Solid, box, loft, tube

Floats = NDArray[np.float64]

Section = tuple[tuple[float, float], ...]
"""Half a cross-section from keel to sheer: (fraction of the half-breadth, fraction of the depth)."""
ROUND: Section = ((0, 0), (0.42, 0.06), (0.72, 0.22), (0.88, 0.45), (0.96, 0.72), (1, 1))
CHINE: Section = ((0, 0), (0.5, 0.17), (0.86, 0.33), (0.89, 0.36), (0.96, 0.7), (1, 1))
FLAT: Section = ((0, 0), (0.62, 0.06), (0.8, 0.12), (0.88, 0.45), (0.95, 0.75), (1, 1))

WIDEST = 0.42
"""Position of the greatest breadth, as a fraction of the length from the transom."""
STEM_BREADTH = 0.03
"""Half-breadth of the stem, as a fraction of the greatest."""


@dataclass(frozen=True)
class Well:
    """A recess in the deck from x0 to x1, `margin` inside the sheer, its sole at the height `sole` [m]."""

    x0: float
    x1: float
    sole: float
    margin: float = 0.12


@dataclass(frozen=True)
class Lines:
    """The lines of a hull [m].

    Attributes:
        sheer: height of the deck edge at the transom, at the greatest breadth, and at the stem.
        transom: breadth of the transom as a fraction of the beam.
        fullness: how bluff the bow is in plan; 2 is fine, 3 is full.
        rake, stern_rake: forward lean of the stem, and aft lean of the transom, from keel to sheer.
        rise: rise of the keel towards the transom.
    """

    length: float
    beam: float
    draft: float
    sheer: tuple[float, float, float]
    section: Section = ROUND
    transom: float = 0.8
    fullness: float = 2.2
    rake: float = 0.6
    stern_rake: float = 0.0
    rise: float = 0.0
    camber: float = 0.06

    def half_breadth(self, x: ArrayLike) -> Floats:
        """Half the breadth at the sheer."""
        t = np.asarray(x, dtype=np.float64) / self.length
        aft = 1 - (1 - self.transom) * np.clip((WIDEST - t) / WIDEST, 0, None) ** 2
        forward = 1 - (1 - STEM_BREADTH) * np.clip((t - WIDEST) / (1 - WIDEST), 0, 1) ** self.fullness
        return np.asarray(self.beam / 2 * np.where(t < WIDEST, aft, forward))

    def deck(self, x: ArrayLike, y: ArrayLike = 0.0) -> Floats:
        """Height of the cambered deck."""
        t = np.asarray(x, dtype=np.float64) / self.length
        sheer = np.polyval(np.polyfit((0, WIDEST, 1), self.sheer, 2), t)
        return np.asarray(sheer + self.camber * (1 - (np.asarray(y) / self.half_breadth(x)) ** 2))

    def keel(self, x: float) -> float:
        t = x / self.length
        return float(-self.draft + (self.draft + 0.05) * t**5 + self.rise * (1 - t) ** 2)

    def ring(self, x: float, well: Well | None) -> Floats:
        """Return the closed section at a station: keel, port side, deck or sole, starboard side."""
        t, half = x / self.length, float(self.half_breadth(x))
        low, high = self.keel(x), float(self.deck(x, half))
        part, level = np.transpose(self.section)
        y, z = half * part ** (1 + 0.6 * t**3), low + (high - low) * level
        rim = max(half - (well.margin if well else 0.12), 0.5 * half)
        if well is None:
            floor = 0.9 * rim
            inside = [float(self.deck(x, floor)), float(self.deck(x))]
        else:  # the sole ends inside of the planking
            floor = min(rim - 0.02, float(np.interp(well.sole, z, y)) - 0.05)
            inside = [well.sole, well.sole + 0.01]
        y = np.array([*y, rim, floor, 0.0])
        z = np.array([*z, float(self.deck(x, rim)), *inside])
        below = np.clip((high - z) / (high + self.draft), 0, None)
        xs = x - self.rake * below * t**4 + self.stern_rake * below * (1 - t) ** 8
        port = np.stack((xs, y, z), axis=1)
        return np.concatenate((port, port[-2:0:-1] * (1, -1, 1)))

    def sheet(self, x0: float, x1: float, inset: float, z: float | None = None, stations: int = 9) -> Mesh:
        """Return a thin sheet, `inset` from the sheer: laid on the deck, or level at the height `z`."""
        rings = []
        for x in np.linspace(x0, x1, stations):
            half = max(float(self.half_breadth(x)) - inset, 0.03)
            y = np.array([-half, -0.5 * half, 0.0, 0.5 * half, half])
            top = self.deck(x, y) + 0.012 if z is None else z + np.array([0, 0.002, 0.003, 0.002, 0])
            top = np.stack((np.full(5, x), y, top), axis=1)
            rings.append(np.concatenate((top, top[[-1, 0]] - (0, 0, 0.05))))
        return loft(np.array(rings))

    def floor(self, well: Well, z: float) -> Mesh:
        """Return floorboards at the height `z` in a well."""
        return self.sheet(well.x0 + 0.06, well.x1 - 0.06, well.margin + 0.14, z)

    def edge(self, x0: float, x1: float, inset: float = 0.05, lift: float = 0.0, points: int = 7) -> Floats:
        """Return a (points, 3) line over the port edge of the deck."""
        x = np.linspace(x0, x1, points)
        y = np.maximum(self.half_breadth(x) - inset, 0.02)
        return np.stack((x, y, self.deck(x, y) + lift), axis=1)


def hull(lines: Lines, *wells: Well, stations: int = 17) -> Solid:
    """Return the hull with its deck and the recesses in it."""
    xs = list(np.linspace(0, lines.length, stations))
    for well in wells:
        xs = [x for x in xs if min(abs(x - well.x0), abs(x - well.x1)) > 0.08]
        xs += [well.x0, well.x0 + 0.03, well.x1 - 0.03, well.x1]
    inside = [next((w for w in wells if w.x0 < x < w.x1), None) for x in sorted(xs)]
    return Solid("hull", loft([lines.ring(x, well) for x, well in zip(sorted(xs), inside, strict=True)]))


@dataclass(frozen=True)
class House:
    """A cabin, console or seat: x0 to x1 at its foot, half-breadths `aft` and `fore`, leaning in [m]."""

    x0: float
    x1: float
    aft: float
    fore: float
    z0: float
    z1: float
    rake_aft: float = 0.05
    rake_fore: float = 0.3
    tumble: float = 0.06
    corners: float = 5.0
    sides: int = 20

    def ring(self, part: float, grow: float = 0.0) -> Floats:
        """Return the outline at a fraction of the height, `grow` meters outside of the wall."""
        x0, x1 = self.x0 + part * self.rake_aft, self.x1 - part * self.rake_fore
        xy = rounded(1.0, 1.0, self.corners, self.sides)
        half = self.aft + (self.fore - self.aft) * (xy[:, 0] + 1) / 2 - part * self.tumble + grow
        x = (x0 + x1) / 2 + ((x1 - x0) / 2 + grow) * xy[:, 0]
        return np.column_stack((x, half * xy[:, 1], np.full(len(xy), self.z0 + part * (self.z1 - self.z0))))

    def walls(self, kind: str = "cabin") -> Solid:
        return Solid(kind, loft([self.ring(0), self.ring(1)]))

    def windows(self, low: float = 0.4, high: float = 0.82) -> Solid:
        """Return a dark band around the walls."""
        return Solid("window", loft([self.ring(low, 0.01), self.ring(high, 0.01)]))

    def roof(self, overhang: float = 0.06, thickness: float = 0.07, kind: str = "roof") -> Solid:
        edge, crown = self.ring(1, overhang), self.ring(1, overhang - 0.16)
        up = np.array([0, 0, thickness])
        return Solid(kind, loft([edge, edge + 0.6 * up, crown + up]))

    def floor(self, inset: float) -> Solid:
        """Return a dark sheet over an open top, so that it looks like a cockpit."""
        top = self.ring(1, -inset)
        return Solid("cockpit", loft([top, top + np.array([0, 0, 0.01])]))

    def all(
        self, low: float = 0.4, high: float = 0.82, overhang: float = 0.06, *, canvas: bool = False
    ) -> list[Solid]:
        """Walls, windows and roof; of cloth if `canvas`."""
        wall, roof = ("canvas", "canvas") if canvas else ("cabin", "roof")
        return [self.walls(wall), self.windows(low, high), self.roof(overhang, kind=roof)]


def rounded(half_length: float, half_width: float, corners: float = 5.0, sides: int = 16) -> Floats:
    """Return a (sides, 2) superellipse around the origin; `corners` 2 is an ellipse, larger is squarer."""
    angles = np.arange(sides) * (2 * np.pi / sides)
    cosine, sine = np.cos(angles), np.sin(angles)
    xy = np.column_stack((cosine, sine))
    xy = np.sign(xy) * np.abs(xy) ** (2 / corners)
    return np.asarray(np.where(np.abs(xy) < 1e-9, 0.0, xy) * (half_length, half_width))


def bar(kind: str, path: Points, radius: ArrayLike = 0.015, sides: int = 4) -> Solid:
    """Return a bar along a path."""
    return Solid(kind, tube(path, radius, sides))


def pair(kind: str, path: Points, radius: ArrayLike = 0.015, sides: int = 4) -> list[Solid]:
    """Return a bar and its mirror image on starboard."""
    points = np.asarray(path, dtype=np.float64)
    return [bar(kind, points, radius, sides), bar(kind, points * (1, -1, 1), radius, sides)]


def block(kind: str, low: Sequence[float], high: Sequence[float]) -> Solid:
    return Solid(kind, box(low, high))


def rig(
    lines: Lines,
    x: float,
    top: float,
    boom: float,
    foot: float,
    *,
    jib: bool = True,
    shrouds: float | None = None,
    stem: Sequence[float] | None = None,
    backstay: bool = True,
) -> list[Solid]:
    """Return the mast at `x`, boom with mainsail, spreaders, stays, and a jib rolled around the forestay [m].

    `top` and `foot` are the heights of the ends of the mast, `boom` is the length of the boom. By default the
    shrouds end at the deck edge and the forestay at the bow; `shrouds` is another distance from the center
    line, `stem` another point.
    """
    radius = 0.006 * top + 0.02
    gooseneck = foot + 1.0
    head, cross = np.array([x, 0, top]), foot + 0.56 * (top - foot)
    bow = np.array(stem or (lines.length - 0.12, 0, lines.deck(lines.length - 0.12)), dtype=np.float64)
    half = lines.half_breadth(x)
    chain = np.array([x - 0.15, shrouds or half - 0.08, lines.deck(x, half)])
    spread = np.array([x - 0.08, 0.6 * chain[1], cross])
    hoist = head - (0, 0, 0.06 * (top - foot))
    sail = np.linspace((x - 0.18, 0, gooseneck + 0.16), (x - 0.96 * boom, 0, gooseneck + 0.14), 6)
    solids = [
        bar("mast", [(x, 0, foot), (x, 0, cross), head], (radius, radius, 0.6 * radius), 8),
        bar("mast", [(x - 0.05, 0, gooseneck), (x - boom, 0, gooseneck + 0.04)], 0.055, 6),
        bar("sail", sail, 0.035 * boom * np.array([0.5, 1.0, 0.95, 0.8, 0.6, 0.3]), 8),
        bar("mast", [spread * (1, -1, 1), spread], 0.025),
        *pair("mast", [head - (0, 0, 0.1), spread, chain], 0.01, 3),
    ]
    if jib:
        roll = bow + np.linspace(0.05, 0.95, 6)[:, None] * (hoist - bow)
        solids.append(bar("sail", roll, (0.03, 0.07, 0.07, 0.06, 0.045, 0.02), 6))
    if backstay:
        solids.append(bar("mast", [head, (0.1, 0, float(lines.deck(0.1)))], 0.01, 3))
    return [*solids, bar("mast", [bow, hoist], 0.012, 3)]


def rudder(lines: Lines, tiller: float) -> list[Solid]:
    """Return a rudder blade on the transom and its tiller."""
    top = float(lines.deck(0.0)) + 0.08
    return [
        block("deck", (-0.16, -0.025, -0.4), (0.0, 0.025, top)),
        bar("deck", [(-0.1, 0, top), (tiller - 0.1, 0, top + 0.12)], 0.02),
    ]


def canopy(x0: float, x1: float, half: float, z: float, legs: float, kind: str = "canvas") -> list[Solid]:
    """Return a cambered roof at the height `z` on four poles, `legs` long."""
    across = np.linspace(-half, half, 7)
    arch = np.column_stack((across, z + 0.14 * (1 - (across / half) ** 2)))
    outline = np.concatenate((arch, [(half, z - 0.04), (-half, z - 0.04)]))
    rings = [np.insert(outline, 0, x, axis=1) for x in (x0, (x0 + x1) / 2, x1)]
    top, y = z - 0.01, half - 0.06
    poles = [p for x in (x0 + 0.15, x1 - 0.15) for p in pair("rail", [(x, y, top - legs), (x, y, top)], 0.02)]
    return [*poles, Solid(kind, loft(rings))]


def pulpit(lines: Lines, x0: float, height: float = 0.6) -> list[Solid]:
    """Return the rail around the bow from `x0`, on legs."""
    port = lines.edge(x0, lines.length - 0.06, 0.06, height, 6)
    over = np.concatenate((port, port[::-1] * (1, -1, 1)))
    legs = [leg for p in port[[0, 3]] for leg in pair("rail", [p - (0, 0, height), p], 0.016)]
    return [bar("rail", over, 0.018), *legs]


def lifelines(lines: Lines, x0: float, x1: float, height: float = 0.6, posts: int = 4) -> list[Solid]:
    """Return stanchions along both sides with a wire on top."""
    top = lines.edge(x0, x1, 0.06, height, posts)
    legs = [leg for p in top for leg in pair("rail", [p - (0, 0, height), p], 0.014)]
    return [*pair("rail", top, 0.008, 3), *legs]


def fenders(lines: Lines, xs: Sequence[float], radius: float = 0.09) -> list[Solid]:
    """Return fenders on both sides."""
    solids = []
    for x in xs:
        y = float(lines.half_breadth(x)) + 0.8 * radius
        top = float(lines.deck(x, lines.half_breadth(x))) - 0.05
        path = [(x, y, top - dz) for dz in (0.0, 0.06, 0.44, 0.5)]
        solids += pair("fender", path, radius * np.array([0.4, 1, 1, 0.4]), 6)
    return solids


def outboard(x: float, z: float, size: float = 1.0, y: float = 0.0) -> list[Solid]:
    """Return an outboard engine on a transom at `x`, its clamp at the height `z`."""
    foot = rounded(0.24 * size, 0.17 * size, 3.0, 12) + np.array([x - 0.16 * size, y])
    head = (foot - foot.mean(axis=0)) * (0.86, 0.8) + foot.mean(axis=0)
    heights = np.array([0.02, 0.14, 0.42, 0.5]) * size + z
    rings = [np.insert(xy, 2, h, axis=1) for xy, h in zip((head, foot, foot, head), heights, strict=True)]
    leg = [(x - 0.18 * size, y, z + 0.1), (x - 0.16 * size, y, -0.5)]
    return [Solid("engine", loft(rings)), bar("engine", leg, 0.07 * size, 6)]
