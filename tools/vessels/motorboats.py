"""Open boats, motor yachts and the inflatable."""

from __future__ import annotations

import numpy as np
from boatyard import (
    CHINE,
    FLAT,
    House,
    Lines,
    Well,
    bar,
    block,
    canopy,
    fenders,
    hull,
    lifelines,
    outboard,
    pair,
    pulpit,
)

from dockctl.sim.harbor.solids import Solid


def skiff() -> list[Solid]:
    """A rowing boat with thwarts and oars."""
    lines = Lines(5.2, 1.7, 0.15, (0.52, 0.42, 0.74), FLAT, transom=0.68, rake=0.45, stern_rake=0.15)
    well = Well(0.12, 4.5, 0.08, 0.07)
    oar = [(1.0, 0.28, 0.42), (3.0, 0.36, 0.42), (3.3, 0.37, 0.42), (3.6, 0.38, 0.42)]
    return [
        hull(lines, well, stations=20),
        Solid("cockpit", lines.floor(well, 0.11)),
        *(
            block("seat", (x, -w, 0.27), (x + 0.26, w, 0.31))
            for x, w in ((0.25, 0.52), (1.5, 0.68), (2.9, 0.68))
        ),
        block("seat", (4.1, -0.3, 0.3), (4.5, 0.3, 0.34)),
        *pair("rail", oar, (0.025, 0.025, 0.07, 0.06), 6),
        *pair("rail", lines.edge(0.05, 5.1, 0.0, -0.04, 10), 0.03, 6),
    ]


def console() -> list[Solid]:
    """A fishing boat with a center console under a hard top."""
    lines = Lines(6.5, 2.3, 0.35, (0.75, 0.8, 1.15), CHINE, transom=0.9, rake=0.8, fullness=2.6)
    well = Well(0.55, 4.9, 0.3, 0.16)
    post = House(2.7, 3.6, 0.42, 0.4, 0.3, 1.25, rake_fore=0.25, tumble=0.04)
    shield = House(3.05, 3.42, 0.4, 0.36, 1.2, 1.65, rake_aft=0.12, rake_fore=0.2, tumble=0.04)
    return [
        hull(lines, well),
        Solid("deck", lines.sheet(4.95, 6.3, 0.12)),
        Solid("cockpit", lines.floor(well, 0.34)),
        block("seat", (0.6, -0.75, 0.34), (0.95, 0.75, 0.7)),
        *post.all(2.0, 2.1, 0.0),
        shield.walls("window"),
        House(1.7, 2.3, 0.45, 0.45, 0.3, 0.95).walls("seat"),
        House(3.65, 4.2, 0.36, 0.3, 0.3, 0.75).walls("seat"),
        *canopy(1.75, 3.9, 0.85, 2.35, 2.0, kind="roof"),
        *pulpit(lines, 4.2, 0.3),
        *fenders(lines, (2.0, 4.0), 0.08),
        *outboard(0.0, 0.6, 1.15),
    ]


def cuddy() -> list[Solid]:
    """A small fishing boat with the wheelhouse forward."""
    lines = Lines(5.8, 2.2, 0.35, (0.75, 0.78, 1.15), CHINE, transom=0.9, rake=0.6, fullness=2.8)
    well = Well(0.4, 2.9, 0.28, 0.16)
    house = House(2.85, 4.55, 0.8, 0.6, 0.72, 2.15, rake_aft=-0.1, rake_fore=0.35, tumble=0.1, corners=6)
    return [
        hull(lines, well),
        Solid("deck", lines.sheet(2.95, 5.6, 0.1)),
        Solid("cockpit", lines.floor(well, 0.32)),
        block("seat", (0.5, -0.75, 0.32), (0.85, 0.75, 0.65)),
        block("engine", (1.5, -0.35, 0.32), (2.1, 0.35, 0.62)),
        *house.all(0.5, 0.88),
        bar("mast", [(3.5, 0, 2.2), (3.5, 0, 3.2)], 0.03, 6),
        *pulpit(lines, 4.6, 0.45),
        *fenders(lines, (1.3, 3.2), 0.1),
        *outboard(0.0, 0.55, 1.0),
    ]


def sedan() -> list[Solid]:
    """A hard-top cruiser with side decks."""
    lines = Lines(8.2, 2.85, 0.5, (0.9, 0.98, 1.4), CHINE, transom=0.9, rake=1.0, fullness=2.7)
    well = Well(0.35, 2.4, 0.5, 0.2)
    trunk = House(4.9, 7.0, 0.95, 0.55, 1.0, 1.6, rake_aft=0.0, rake_fore=0.9, tumble=0.12, corners=3.5)
    house = House(2.45, 5.7, 1.1, 0.9, 0.9, 2.4, rake_aft=-0.25, rake_fore=1.1, tumble=0.2)
    return [
        block("deck", (-0.55, -1.0, 0.22), (0.1, 1.0, 0.3)),
        hull(lines, well),
        Solid("deck", lines.sheet(2.45, 8.0, 0.1)),
        Solid("cockpit", lines.floor(well, 0.54)),
        House(0.45, 0.95, 1.05, 1.05, 0.5, 0.95).walls("seat"),
        *trunk.all(0.25, 0.65, 0.0),
        *house.all(0.48, 0.88, 0.08),
        block("window", (3.3, -0.4, 2.46), (4.0, 0.4, 2.5)),
        bar("mast", [(3.0, 0, 2.45), (2.8, 0, 3.5)], 0.03, 6),
        *pulpit(lines, 4.6, 0.5),
        *lifelines(lines, 2.6, 4.6, 0.5, 3),
        *fenders(lines, (1.2, 3.4)),
    ]


def express() -> list[Solid]:
    """A sporty open yacht: long foredeck, raked screen, arch over the cockpit."""
    lines = Lines(9.0, 3.0, 0.5, (0.95, 1.05, 1.35), CHINE, transom=0.86, rake=1.4, fullness=2.3)
    well = Well(0.4, 3.9, 0.55, 0.24)
    trunk = House(3.95, 7.7, 1.05, 0.45, 1.05, 1.5, rake_aft=0.0, rake_fore=1.7, tumble=0.2, corners=3)
    screen = House(3.3, 5.0, 1.12, 0.85, 1.2, 1.95, rake_aft=0.75, rake_fore=0.85, tumble=0.16, corners=4)
    arch = [(1.4, 1.25, 1.0), (1.1, 1.2, 1.9), (0.95, 0.95, 2.3)]
    over = np.array([*arch, *((x, -y, z) for x, y, z in reversed(arch))])
    return [
        block("deck", (-0.7, -1.05, 0.25), (0.1, 1.05, 0.33)),
        hull(lines, well, stations=19),
        Solid("deck", lines.sheet(3.95, 8.75, 0.12)),
        Solid("cockpit", lines.floor(well, 0.6)),
        House(0.45, 1.25, 1.0, 1.0, 0.55, 1.0).walls("seat"),
        House(2.9, 3.3, 0.28, 0.28, 0.55, 1.4).walls("seat").shifted((0.0, -0.5, 0.0)),
        House(2.9, 3.3, 0.28, 0.28, 0.55, 1.4).walls("seat").shifted((0.0, 0.5, 0.0)),
        *trunk.all(0.3, 0.68, 0.0),
        Solid("seat", lines.sheet(5.6, 7.2, 0.75, 1.53)),
        screen.walls("window"),
        bar("roof", over, 0.1, 8),
        *canopy(0.9, 3.6, 0.95, 2.36, 2.2),
        *pulpit(lines, 4.8, 0.5),
        *fenders(lines, (1.6, 4.0)),
    ]


def flybridge() -> list[Solid]:
    """A motor yacht with two decks."""
    lines = Lines(9.3, 3.0, 0.6, (1.05, 1.2, 1.75), CHINE, transom=0.92, rake=1.1, fullness=2.8)
    well = Well(0.35, 2.3, 0.65, 0.2)
    trunk = House(5.6, 8.0, 1.0, 0.55, 1.25, 1.95, rake_aft=0.0, rake_fore=1.1, tumble=0.14, corners=3.5)
    house = House(2.35, 6.5, 1.22, 0.95, 1.1, 2.65, rake_aft=-0.1, rake_fore=1.2, tumble=0.14)
    bulwark = House(1.5, 4.9, 1.05, 0.85, 2.72, 3.2, rake_aft=0.0, rake_fore=-0.15, tumble=-0.03)
    shield = House(4.2, 4.95, 0.8, 0.75, 3.15, 3.55, rake_aft=-0.2, rake_fore=0.4, tumble=0.1)
    return [
        block("deck", (-0.6, -1.1, 0.25), (0.1, 1.1, 0.33)),
        hull(lines, well, stations=19),
        Solid("deck", lines.sheet(2.35, 9.05, 0.1)),
        Solid("cockpit", lines.floor(well, 0.69)),
        House(0.45, 0.95, 1.1, 1.1, 0.65, 1.1).walls("seat"),
        *trunk.all(0.25, 0.65, 0.0),
        *house.all(0.42, 0.85, 0.1),
        block("roof", (0.8, -1.15, 2.64), (2.5, 1.15, 2.72)),
        *pair("rail", [(0.95, 1.08, 1.1), (0.95, 1.08, 2.66)], 0.04, 6),
        bulwark.walls("cabin"),
        bulwark.floor(0.12),
        House(1.7, 2.2, 0.85, 0.85, 3.15, 3.45).walls("seat"),
        House(3.5, 3.9, 0.6, 0.6, 3.15, 3.5).walls("seat"),
        shield.walls("window"),
        *pair("roof", [(1.8, 0.92, 2.8), (1.3, 0.85, 3.9)], 0.07, 6),
        bar("roof", [(1.3, -0.9, 3.9), (1.3, 0.9, 3.9)], 0.09, 8),
        bar("rail", [(1.3, 0, 3.9), (1.3, 0, 4.9)], 0.025, 6),
        *pulpit(lines, 5.4, 0.55),
        *fenders(lines, (1.6, 3.6, 5.6)),
    ]


def inflatable() -> list[Solid]:
    """A rigid inflatable: tubes around a small hull, console, engine on the transom."""
    radius, half = 0.25, 0.8
    side = np.array([(x, half, 0.42) for x in (-0.25, 0.0, 0.8, 1.6, 2.4, 3.2)])
    turn = np.radians([8, 22, 38, 55, 74])
    bow = np.column_stack(
        (3.2 + 1.5 * np.sin(turn), half * np.cos(turn) ** 1.1, 0.42 + 0.22 * np.sin(turn) ** 2)
    )
    port = np.concatenate((side, bow))
    path = np.concatenate((port, [(4.74, 0.0, 0.645)], port[::-1] * (1, -1, 1)))
    radii = np.full(len(path), radius)
    radii[[0, -1]], radii[[1, -2]] = 0.08, radius
    lines = Lines(4.5, 1.3, 0.3, (0.3, 0.3, 0.5), CHINE, transom=0.95, rake=0.6, fullness=2.6, camber=0.02)
    post = House(1.75, 2.3, 0.3, 0.28, 0.3, 1.05, rake_fore=0.15, tumble=0.03)
    frame = [(0.35, 0.5, 0.3), (0.2, 0.48, 1.5), (0.2, 0.3, 1.75)]
    return [
        hull(lines, stations=13),
        Solid("cockpit", lines.sheet(0.1, 3.9, 0.1, 0.4)),
        bar("tube", path, radii, 10),
        block("hull", (0.0, -0.6, 0.2), (0.08, 0.6, 0.62)),
        post.walls("cabin"),
        post.roof(0.0, 0.05, "cabin"),
        House(1.98, 2.2, 0.27, 0.25, 1.04, 1.4, rake_aft=0.1, rake_fore=0.08).walls("window"),
        House(0.95, 1.5, 0.3, 0.3, 0.35, 0.8).walls("seat"),
        House(2.6, 3.1, 0.3, 0.25, 0.35, 0.65).walls("seat"),
        bar("rail", np.array([*frame, *((x, -y, z) for x, y, z in reversed(frame))]), 0.03, 6),
        *outboard(0.0, 0.58, 0.95),
    ]
