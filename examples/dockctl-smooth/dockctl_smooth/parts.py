"""An observation part with one column."""

from __future__ import annotations

from dockctl.envs.observation import Columns, View, observation_part


@observation_part("nearest_obstacle", source="dockctl-smooth")
def nearest_obstacle(view: View, *, cap_m: float = 20.0) -> Columns:
    """Return the least range of all sectors over `cap_m`, (n, 1)."""
    nearest = view.sector_ranges_m.min(axis=1, keepdims=True)
    return Columns(["nearest_obstacle"], nearest / cap_m, 0, 1)
