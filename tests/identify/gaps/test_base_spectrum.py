"""An unmeasured base motion is what its pattern over the sensors says; other motion in a band is not taken for it."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from identify.gaps.decision.prepare import prepare_recording
from identify.gaps.residual.likelihood import misfit
from identify.gaps.search.base_spectrum import fit_base_spectrum
from identify.gaps.search.candidates import candidates, effect_range_scale
from identify.gaps.search.hypothesis import MIN_GAIN
from identify.gaps.search.nominal import fit_nuisance
from rig.effects.base_motion import ShakingBase
from rig.model.components import Contact, Station
from rig.model.contact_laws.dead_zone import symmetric_dead_zone
from rig.model.tolerances import LABORATORY
from rig.recording import read
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle

SETTINGS = BarrelCradle(sensors="acceleration", noise_density=1e-3, duration_s=16.0, seed=78)
BAND_HZ = (70.0, 110.0)


def fitted_base(recording):
    record = prepare_recording(recording, LABORATORY).record
    linearization, residual = fit_nuisance(record, recording.rig)
    effects = candidates(effect_range_scale(record, recording.rig), [s.name for s in recording.rig.sensors], False)
    (base,) = [candidate for candidate in effects if candidate.kind.stochastic]
    return fit_base_spectrum(linearization, residual, base, MIN_GAIN)


def test_a_base_motion_is_found_with_its_band(recorded_machine):
    shaking = ShakingBase(acceleration_rms_m_per_s2=0.15, low_hz=BAND_HZ[0], high_hz=BAND_HZ[1])
    values, standard_errors = fitted_base(recorded_machine(SETTINGS, shaking))
    assert values == pytest.approx([0.15, *BAND_HZ], abs=1.0)
    assert values[0] == pytest.approx(0.15, abs=4 * standard_errors[0])


def test_lateral_motion_that_the_sensors_show_is_no_base_motion(recorded_machine):
    recording = recorded_machine(SETTINGS)
    signals, rng = recording.signals["acceleration"], np.random.default_rng(5)
    band = butter(4, BAND_HZ, "bandpass", fs=recording.rig.sample_rate_hz, output="sos")
    lateral_m_per_s2 = sosfiltfilt(band, rng.standard_normal(signals.values.shape[1]))
    shares = 0.3 * rng.standard_normal(len(signals.values))
    disturbed = replace(signals, values=signals.values + np.outer(shares, lateral_m_per_s2))
    assert fitted_base(replace(recording, signals={**recording.signals, "acceleration": disturbed})) is None


def test_a_stop_on_the_ground_moves_with_an_unmeasured_base(tmp_path):
    """The displacement of the base, a tenth of the clearance, makes up a fifth of the force of the stop."""
    beams = SETTINGS.rig()
    stop = Contact(name="tip", at=Station("cradle", 1.0), law=symmetric_dead_zone(1e-3, 5e4))
    nominal = msgspec.structs.replace(
        beams,
        bodies=(beams.body("cradle"),),
        contacts=(stop,),
        force_at=Station("cradle", 0.55),
        sensors=tuple(sensor for sensor in beams.sensors if sensor.station.body == "cradle"),
    )
    shaken = ShakingBase(acceleration_rms_m_per_s2=1.0, low_hz=8.0, high_hz=20.0).applied_to(nominal)
    times = {"duration_s": SETTINGS.duration_s, "step_s": SETTINGS.step_s}
    path = tmp_path / "r.mcap"
    record(nominal, SETTINGS.force(), plant=modal.simulate, path=path, actual=shaken, progress=lambda _: None, **times)
    prepared = prepare_recording(read(path), LABORATORY)
    residuals = (fit_nuisance(prepared.record, rig)[1] for rig in (nominal, shaken))
    misfits = (misfit(prepared.record, prepared.nominal_variances, residual) for residual in residuals)
    shares = [rig_misfit.unexplained_contact_shares[0] for rig_misfit in misfits]
    assert shares[0] > 0.15
    assert shares[1] < 0.01
