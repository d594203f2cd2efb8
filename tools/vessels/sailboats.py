"""Sailing boats and the catamaran."""

from __future__ import annotations

from boatyard import (
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
    pair,
    pulpit,
    rig,
    rudder,
)

from dockctl.sim.harbor.solids import Solid


def dinghy() -> list[Solid]:
    """An open sailing dinghy with thwarts and a bare mast."""
    lines = Lines(5.1, 1.9, 0.2, (0.5, 0.46, 0.66), FLAT, transom=0.72, rake=0.25)
    well = Well(0.25, 3.5, 0.1, 0.2)
    return [
        hull(lines, well),
        Solid("deck", lines.sheet(3.55, 4.95, 0.08)),
        Solid("cockpit", lines.floor(well, 0.13)),
        *(block("seat", (x, -0.62, 0.3), (x + 0.28, 0.62, 0.35)) for x in (0.55, 2.2)),
        *pair("seat", [(0.6, 0.56, 0.33), (2.3, 0.6, 0.33)], 0.06),
        *rudder(lines, tiller=1.0),
        *rig(lines, 3.3, 7.4, 2.7, 0.15, jib=False),
    ]


def daysailer() -> list[Solid]:
    """A small keelboat with a long cockpit and a low coachroof."""
    lines = Lines(6.9, 2.35, 0.5, (0.72, 0.66, 0.86), transom=0.66, stern_rake=0.25, rake=0.7, rise=0.3)
    well = Well(0.4, 2.9, 0.3, 0.32)
    house = House(2.95, 5.0, 0.72, 0.42, 0.62, 1.0, rake_aft=0.02, rake_fore=0.5, tumble=0.1, corners=4)
    return [
        hull(lines, well),
        Solid("deck", lines.sheet(2.95, 6.7, 0.07)),
        Solid("cockpit", lines.floor(well, 0.34)),
        *house.all(0.3, 0.75, 0.0),
        *rudder(lines, tiller=1.1),
        *pulpit(lines, 5.9, 0.5),
        *rig(lines, 4.2, 9.3, 2.9, 0.9),
    ]


def sloop() -> list[Solid]:
    """A family cruiser with sprayhood and lifelines."""
    lines = Lines(8.3, 2.8, 0.6, (0.9, 0.84, 1.12), transom=0.78, stern_rake=-0.3, rake=0.6, rise=0.3)
    well = Well(0.35, 2.5, 0.45, 0.42)
    house = House(2.55, 6.1, 0.9, 0.5, 0.8, 1.36, rake_aft=0.03, rake_fore=0.9, tumble=0.13, corners=4)
    hood = House(2.05, 3.2, 0.86, 0.8, 1.0, 1.75, rake_aft=0.05, rake_fore=0.6, tumble=0.2, corners=4)
    return [
        hull(lines, well),
        Solid("deck", lines.sheet(2.55, 8.1, 0.08)),
        Solid("cockpit", lines.floor(well, 0.49)),
        *house.all(0.3, 0.72, 0.0),
        *hood.all(0.25, 0.7, 0.0, canvas=True),
        block("roof", (5.0, -0.25, 1.38), (5.5, 0.25, 1.47)),
        *rudder(lines, tiller=1.2),
        *lifelines(lines, 0.3, 6.8),
        *pulpit(lines, 6.8),
        *fenders(lines, (2.2, 4.4)),
        *rig(lines, 4.9, 11.0, 3.3, 1.36),
    ]


def cruiser() -> list[Solid]:
    """A cruising yacht with wheel, bimini and a broad stern."""
    lines = Lines(
        9.6, 3.05, 0.7, (1.05, 1.0, 1.25), transom=0.88, stern_rake=-0.3, rake=0.35, rise=0.35, fullness=2.0
    )
    well = Well(0.3, 2.9, 0.55, 0.5)
    house = House(2.95, 7.2, 1.0, 0.45, 0.95, 1.55, rake_aft=0.03, rake_fore=1.5, tumble=0.16, corners=3.5)
    hood = House(2.4, 3.7, 0.98, 0.9, 1.15, 1.95, rake_aft=0.05, rake_fore=0.7, tumble=0.22, corners=4)
    return [
        hull(lines, well, stations=19),
        Solid("deck", lines.sheet(2.95, 9.35, 0.09)),
        Solid("cockpit", lines.floor(well, 0.6)),
        block("seat", (1.3, -0.08, 0.6), (2.3, 0.08, 0.95)),
        *pair("rail", [(0.85, 0.45, 0.6), (0.85, 0.45, 1.4)], 0.08, 6),
        *house.all(0.3, 0.7, 0.0),
        *hood.all(0.25, 0.7, 0.0, canvas=True),
        *canopy(0.35, 1.9, 1.05, 2.75, 1.05),
        block("roof", (5.9, -0.27, 1.58), (6.45, 0.27, 1.66)),
        *lifelines(lines, 0.2, 8.0, posts=5),
        *pulpit(lines, 8.0),
        *fenders(lines, (2.4, 4.2, 6.0)),
        *rig(lines, 5.5, 11.9, 3.6, 1.56),
    ]


def catamaran() -> list[Solid]:
    """Two slender hulls, a bridge deck with a house, and a net between the bows."""
    lines = Lines(
        8.6, 0.9, 0.4, (0.75, 0.95, 1.05), FLAT, transom=0.8, stern_rake=-0.5, rake=0.15, fullness=2.6
    )
    house = House(2.2, 5.6, 1.25, 1.0, 1.1, 1.85, rake_aft=0.05, rake_fore=1.1, tumble=0.15, corners=4)
    side = 1.25
    floats = [hull(lines, stations=14), Solid("deck", lines.sheet(0.3, 8.4, 0.06))]
    return [
        block("hull", (0.8, -side, 0.55), (5.6, side, 1.0)),
        *(solid.shifted((0.0, y, 0.0)) for y in (-side, side) for solid in floats),
        block("deck", (2.1, -side, 0.95), (5.6, side, 1.08)),
        block("cockpit", (0.95, -0.95, 0.98), (2.15, 0.95, 1.03)),
        block("seat", (0.85, -0.95, 1.0), (1.2, 0.95, 1.35)),
        block("canvas", (5.6, -side + 0.2, 0.8), (7.6, side - 0.2, 0.83)),
        bar("mast", [(7.65, -side, 0.95), (7.65, side, 0.95)], 0.06, 8),
        *house.all(0.35, 0.8, 0.0),
        *canopy(0.8, 2.35, 1.15, 2.6, 1.0),
        *pair("rail", [(x, 1.56, 1.55) for x in (1.0, 3.2, 5.4)] + [(7.3, 1.42, 1.6)], 0.012),
        *(leg for x in (1.0, 3.2, 5.4) for leg in pair("rail", [(x, 1.56, 0.9), (x, 1.56, 1.56)])),
        *pair("rail", [(7.3, 1.42, 0.9), (7.3, 1.42, 1.6)]),
        *rig(lines, 4.6, 11.6, 3.2, 1.8, shrouds=1.45, stem=(7.65, 0.0, 1.0), backstay=False),
    ]
