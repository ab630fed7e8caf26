"""The fit of values of each record's own: steps that make the records less likely are halved."""

import numpy as np
import pytest

from identify.gaps.decision.differences import comparable_candidates
from identify.gaps.decision.record_values import EffectValues, RecordSet, VaryingParameters
from identify.gaps.search.candidates import candidates
from identify.gaps.search.pooled import PooledEstimate
from rig.effects.base import Scale
from rig.simulation.reference import BarrelCradle


class PlainValues(VaryingParameters):
    """Values of two records, one each, of no effect, without bounds."""

    bounds = (np.array([-np.inf]), np.array([np.inf]))

    def with_record_values(self, values):
        return PlainValues(EffectValues((), (), values), self.columns)


class Bent(RecordSet):
    """-2 ln p = sum ln cosh(x - c), whose full Gauss-Newton steps diverge where |x - c| > 1.09."""

    CENTRES = np.array([[1.0], [-3.0]])

    def _cost_and_estimate(self, varied):
        distance = varied.record_values - self.CENTRES
        curvature = 1 / np.cosh(distance) ** 2
        estimate = PooledEstimate(
            (varied.record_values - np.tanh(distance) / curvature).ravel(), np.diag(1e-4 / curvature.ravel()), 0.0
        )
        return float(np.sum(np.log(np.cosh(distance)))), estimate


@pytest.mark.parametrize("start", [[0.5, -2.5], [2.4, -1.5]])
def test_steps_that_overshoot_are_halved(start):
    fitted, estimate = Bent((), ()).joint_fit(PlainValues(EffectValues((), (), np.array(start)[:, None]), [0]))
    np.testing.assert_allclose(fitted.record_values, Bent.CENTRES, atol=5e-3)
    np.testing.assert_allclose(estimate.values, Bent.CENTRES.ravel(), atol=5e-3)


def test_at_several_levels_what_follows_the_level_is_not_compared():
    rig = BarrelCradle(sensors="acceleration").rig()
    library = candidates(Scale(rig, 15.0, 30.0), [sensor.name for sensor in rig.sensors], zero_known=False)
    compared = {levels: {c.kind.name for c in comparable_candidates(library, levels)} for levels in (False, True)}
    assert compared[False] - compared[True] == {"hardening_spring", "ground_friction"}
    assert {"linear_spring", "structural_damping", "contact_clearance"} < compared[True]
    assert not compared[False] & {"base_motion", "tone"}
