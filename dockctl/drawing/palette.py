"""Colors of all drawings: rendered frames and figures show the same marina."""

from __future__ import annotations

import zlib

# Type and rules
INK = "#1B2A38"
INK_SOFT = "#51616F"
RULE = "#A9B4BD"
GRID = "#E6EBEE"

# Series: the thesis names its five test poses red, green, blue, purple, yellow (Table 4.3). Color-blind
# readers can distinguish these tones, which are visible on water and on white.
RED, GREEN, BLUE, PURPLE, YELLOW = "#C9303A", "#16A085", "#3F86CB", "#662A78", "#DBA70F"
SINGLE = "#1F62AE"
SERIES = (RED, GREEN, BLUE, PURPLE, YELLOW)

# Training: raw episodes light, mean dark
RAW, MEAN = "#A9CBE3", "#14507F"
SECOND_RAW, SECOND_MEAN = "#F2CFA3", "#B4630C"

# Outcomes
DOCKED, TIMEOUT, COLLISION = "#2FAA90", "#EBC04E", "#B03540"
OUTCOMES = {"docked": DOCKED, "timeout": TIMEOUT, "collision": COLLISION}

# Marina
WATER, WATER_SHADE, WATER_DEEP = "#D9EAF1", "#B9D3DF", "#8FB6C8"
NIGHT_WATER, NIGHT_LAND, NIGHT_RULE = "#12293A", "#1D3B4F", "#3E6379"  # background of point clouds
GOAL = "#E4572E"
OWN_HULL = "#D1383F"
SOLIDS = {
    "quay": ("#D6D0C3", "#A39B8B"),  # land around the basin
    "finger": ("#D8BE94", "#A88A5D"),
    "pile": ("#6E5A45", "#4A3B2C"),
    "hull": ("#FBFAF6", "#75838E"),  # topsides; from here on, parts of moored vessels
    "tube": ("#C3C9CD", "#8D979E"),  # of an inflatable
    "deck": ("#EFE7D6", "#CDBE9F"),
    "cockpit": ("#CDB185", "#A68B60"),  # sole of a recess in the deck
    "seat": ("#E3D3B4", "#BCA880"),
    "cabin": ("#F6F5F1", "#9AA6AE"),
    "window": ("#5B7A8F", "#46586A"),
    "roof": ("#E4E8EA", "#AEB8BE"),
    "canvas": ("#34587D", "#27425E"),  # sprayhood, bimini, trampoline
    "engine": ("#39444D", "#262E35"),
    "fender": ("#EDEDE6", "#7D8890"),
    "rail": ("#9AA7B0", "#9AA7B0"),
    "mast": ("#55646F", "#3E4C58"),  # with boom, spreaders and stays
    "sail": ("#2A4B6C", "#1C3650"),
    "red light": ("#B8433C", "#8E322D"),  # at the entrance
    "green light": ("#2F8A57", "#236741"),
    "mesh": ("#BFC4C6", "#8C9396"),  # a solid of a mesh file
    "own": (OWN_HULL, "#8C9396"),
}
"""Fill and edge of each kind of solid; other kinds, in a user's file, are drawn as "mesh"."""
PLANK = "#C4A678"
# Moored hulls: mostly white, a few in color
HULLS = (
    "#FBFAF6",
    "#FBFAF6",
    "#F3EFE4",
    "#24405E",
    "#FBFAF6",
    "#DDE5EA",
    "#7A2E33",
    "#FBFAF6",
    "#F7F3E8",
    "#2F5D5A",
)


def solid_colors(kind: str, name: str) -> tuple[str, str]:
    """Return fill and edge of a solid of one kind in the part `name`; hull colors vary between boats."""
    fill, edge = SOLIDS.get(kind, SOLIDS["mesh"])
    return (HULLS[zlib.crc32(name.encode()) % len(HULLS)] if kind == "hull" else fill), edge
