"""Screening by a selection of lines: only of rigs whose forces to the ground mix no frequencies."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.residual.residual import linearized
from identify.gaps.search.candidates import candidates, effect_range_scale
from identify.gaps.search.screening import grid_screening
from rig.model.description import PointDamper, PointSpring, Station
from rig.simulation.reference import Sdof
from tests.identify.gaps.residual.simulated_records import simulated_record

SETTINGS = Sdof(sensors="displacement", duration_s=16.0)
PLAIN = SETTINGS.rig()
RUBS = replace(PLAIN, dampers=(PointDamper(station=Station("mass"), friction_n=0.05),))
BENDS = replace(PLAIN, springs=(PointSpring(station=Station("mass"), cubic_n_per_m3=1e6),))


@pytest.mark.parametrize(("rig", "screened"), [(PLAIN, True), (RUBS, False), (BENDS, False)])
def test_of_a_rig_that_rubs_or_bends_on_the_ground_none_is_screened(rig, screened):
    record = simulated_record(SETTINGS, rig)
    known = candidates(effect_range_scale(record, rig), [s.name for s in record.sensors], record.zero_known)
    found = grid_screening(linearized(record, rig), known)
    assert bool(found) == screened
    assert all(np.isfinite(s.cost_decrease) for s in found)
