"""Random vessels: any that the schema accepts, with the fewest substeps that it accepts."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from hypothesis import assume
from hypothesis import strategies as st
from pydantic import ValidationError

from dockctl.scenarios.loader import load
from dockctl.scenarios.vessel import Hull, Vessel

THESIS = load("s1").scenario.vessel
THESIS_HULL = st.just(THESIS.hull)
MOST_SUBSTEPS = 300  # more only take time

DAMPING = ("X_u_kgps", "X_uu_kgpm", "Y_v_kgps", "Y_vv_kgpm", "N_r_kgm2ps", "N_rr_kgm2")
SCALED = (
    *("mass_kg", "yaw_inertia_kgm2", "X_udot_kg", "Y_vdot_kg", "N_rdot_kgm2", "propeller_arm_m"),
    *("max_propeller_n", "control_period_s", *DAMPING),
)


def fewest_substeps(given: dict[str, Any]) -> Vessel | None:
    """The vessel with the fewest substeps that the schema accepts; None if `MOST_SUBSTEPS` are too few."""

    def accepted(substeps: int) -> Vessel | None:
        with suppress(ValidationError):
            return Vessel.model_validate({**given, "substeps": substeps})
        return None

    if (vessel := accepted(MOST_SUBSTEPS)) is None:
        return None
    low, high = 0, MOST_SUBSTEPS
    while high - low > 1:
        middle = (low + high) // 2
        if (finer := accepted(middle)) is not None:
            vessel, high = finer, middle
        else:
            low = middle
    return vessel


@st.composite
def vessels(draw: st.DrawFn, hulls: st.SearchStrategy[Hull] = THESIS_HULL) -> Vessel:
    """Vessels from a tenth to ten times the thesis' coefficients, with strong to hardly any damping."""
    powers = st.floats(-1, 1).map(lambda power: 10.0**power)
    given = THESIS.model_dump()
    given |= {key: given[key] * draw(powers) for key in SCALED}
    weaker = draw(st.sampled_from((1.0, 1.0, 0.1, 0.001)))
    given |= {key: given[key] * weaker for key in DAMPING}
    given |= dict.fromkeys(draw(st.sets(st.sampled_from(DAMPING), max_size=2)), 0.0)
    given |= {
        "max_propeller_n": given["max_propeller_n"] * draw(st.sampled_from((1.0, 10.0, 100.0))),
        "max_rudder_deg": draw(st.floats(5, 90)),
        "Y_rdot_kgm": draw(st.floats(-20, 20)),
        "Y_r_kgmps": draw(st.floats(-400, 400)) * weaker,
        "N_v_kgmps": draw(st.floats(-400, 400)) * weaker,
        "hull": draw(hulls).model_dump(),
    }
    vessel = fewest_substeps(given)
    assume(vessel is not None)
    assert vessel is not None
    return vessel
