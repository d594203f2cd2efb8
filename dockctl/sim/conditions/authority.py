"""Control authority of a vessel: its side force, yaw moment and top speed, and its drift under a force."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dockctl.scenarios.vessel import Vessel


@dataclass(frozen=True)
class ControlAuthority:
    """Steady limits of a vessel, from its coefficients (thesis Table 3.1, eq. 2.23).

    Attributes:
        side_force_n, yaw_moment_nm: maximum sway force and yaw moment of the propeller.
        top_speed_mps: terminal surge speed at the maximum propeller force.
    """

    vessel: Vessel
    side_force_n: float
    yaw_moment_nm: float
    top_speed_mps: float

    @classmethod
    def of(cls, vessel: Vessel) -> ControlAuthority:
        side = vessel.max_side_n
        top = _terminal_speed(vessel.X_u_kgps, vessel.X_uu_kgpm, vessel.max_propeller_n)
        return cls(vessel, side, vessel.propeller_arm_m * side, top)

    def side_drag(self, speed_mps: float) -> float:
        """Return the sway damping [N] at a speed through the water."""
        return (self.vessel.Y_v_kgps + self.vessel.Y_vv_kgpm * speed_mps) * speed_mps

    def drift(self, side_force_n: float) -> float:
        """Return the terminal sway speed [m/s] under a side force."""
        return _terminal_speed(self.vessel.Y_v_kgps, self.vessel.Y_vv_kgpm, side_force_n)

    def speed(self, force_n: float) -> float:
        """Return the terminal surge speed [m/s] under a force."""
        return _terminal_speed(self.vessel.X_u_kgps, self.vessel.X_uu_kgpm, force_n)

    def crab(self, drift_mps: float) -> str:
        """Describe the crab angle between heading and track at top speed, with a drift across the track."""
        top_speed = f"at its top speed of {self.top_speed_mps:.2f} m/s"
        if drift_mps >= self.top_speed_mps:
            return f"cannot keep its track {top_speed}"
        angle = math.degrees(math.asin(drift_mps / self.top_speed_mps))
        return f"keeps its track with {angle:.0f}° of crab {top_speed}"


def _terminal_speed(linear: float, quadratic: float, force: float) -> float:
    """Return the root of quadratic s^2 + linear s = force; infinite without damping."""
    both = linear + math.sqrt(linear**2 + 4 * quadratic * force)
    return 2 * force / both if both else math.inf
