"""Corner of the integration: noise of accelerometers below it must not bias a law of the displacement."""

import numpy as np
import pytest

from identify.gaps.residual.likelihood import nominal_variances_of
from identify.gaps.residual.residual import linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.candidates import candidates, effect_range_scale
from identify.gaps.search.hypothesis import Search, fit_effects
from identify.gaps.search.nominal import fit_nuisance
from identify.signals.kinematics import CORNER_HZ
from rig.effects import effect_named
from rig.model.beam import Beam
from rig.model.description import Rig, Sensor, Station
from rig.simulation.excitation import BandLimitedGaussian, force_history
from rig.simulation.replay import modal

pytestmark = pytest.mark.long

BEAM = Beam(name="beam", ends="clamped-free", length_m=0.9, width_m=0.045, thickness_m=0.0116, damping_ratio=0.01)
NOISE = {"acceleration": 2e-3, "displacement": 5e-8}
RATE_HZ, DURATION_S = 512.0, 20.0


def rig(quantity):
    sensors = tuple(
        Sensor(name=f"s{k}", station=Station("beam", x), quantity=quantity, noise_density=NOISE[quantity])
        for k, x in enumerate((0.3, 0.55, 0.75, 0.9), 1)
    )
    return Rig(
        name="cantilever",
        bodies=(BEAM,),
        contacts=(),
        force_at=Station("beam", 0.9),
        sensors=sensors,
        sample_rate_hz=RATE_HZ,
    )


def recorded(quantity, effect=None):
    nominal = rig(quantity)
    actual = effect_named(effect).applied_to(nominal) if effect else nominal
    force_n = force_history(BandLimitedGaussian(rms_n=4.0, low_hz=0.5, high_hz=100.0, seed=4), DURATION_S, 1 / RATE_HZ)
    return record_of(modal(nominal, actual, force_n, 5))


def test_the_corner_is_raised_where_accelerometers_show_noise_alone():
    first_hz = float(BEAM.frequencies_hz(1)[0])
    assert CORNER_HZ < recorded("acceleration").corner_hz < first_hz / 4
    assert recorded("displacement").corner_hz == CORNER_HZ


def test_a_softening_spring_is_found_from_accelerations():
    cubic = -2e7
    record = recorded("acceleration", f"hardening_spring:cubic_n_per_m3={cubic},relative_position=0.75,body=beam")
    search = Search(nominal_variances_of(linearized(record, record.rig)), *fit_nuisance(record, record.rig), ())
    known = candidates(effect_range_scale(record, record.rig), (), record.zero_known)
    spring = next(candidate for candidate in known if candidate.kind.name == "hardening_spring")
    hypothesis = fit_effects(search, (spring,), np.array([cubic / 3, 0.9]), search.nominal_residual).hypothesis
    errors = np.sqrt(np.diag(hypothesis.covariance))
    assert np.all(np.abs(hypothesis.values - [cubic, 0.75]) < 3 * errors)
    assert errors[0] < 0.1 * abs(cubic)
