"""A damper that acts at once as the stop closes, where rig.json lets it grow over 10 um: seen through a displacement
sensor whose delay is uncertain, nothing but that moment tells delay and damping apart."""

import numpy as np
import pytest

from identify.contacts.joint_fit import fit_joint
from identify.pages.wording import COVERED
from identify.signals.drift import spline
from tests.identify.contacts.contact_records import contact_record

RATE_HZ, FINER, DURATION_S = 2048.0, 32, 20.0
CLEARANCE_M, STIFFNESS, DAMPING = 4e-4, 7e4, 10.0
DELAY_S = 1e-5
"""Its standard deviation; the sensor is as late as that."""


def recorded(seed):
    """Relative displacement of a random motion, late by the delay, and the force of a damper that acts at once."""
    rng, finer_count = np.random.default_rng(seed), round(RATE_HZ * DURATION_S) * FINER
    hz = np.fft.rfftfreq(finer_count, 1 / (RATE_HZ * FINER))
    lines = (hz > 3) & (hz < 60)
    spectrum = lines / np.maximum(hz, 1.0) ** 1.5 * ([1, 1j] @ rng.standard_normal((2, hz.size)))
    eta_m = np.fft.irfft(spectrum, finer_count)
    scale = 1.3 * CLEARANCE_M / eta_m.std()
    eta_m *= scale
    rate_m_per_s = scale * np.fft.irfft(2j * np.pi * hz * spectrum, finer_count)
    depth_m = eta_m - np.clip(eta_m, -CLEARANCE_M, CLEARANCE_M)
    force_n = STIFFNESS * depth_m + DAMPING * rate_m_per_s * (depth_m != 0)
    force_n = np.fft.irfft(np.fft.rfft(force_n) * (hz <= 0.4 * RATE_HZ), finer_count)[::FINER]
    late_m = np.fft.irfft(spectrum * scale * np.exp(-2j * np.pi * hz * DELAY_S), finer_count)[::FINER]
    force_n += 0.002 * rng.standard_normal(force_n.size)
    velocity_m_per_s = np.gradient(late_m, 1 / RATE_HZ)
    return contact_record(
        force_n,
        np.zeros((1, force_n.size)),
        eta_m=late_m,
        velocity_m_per_s=velocity_m_per_s,
        sample_rate_hz=RATE_HZ,
        drift_spline=spline(force_n.size, RATE_HZ, None),
        nuisance_m=-DELAY_S * velocity_m_per_s[None].astype(np.float32),
        shifts_eta=np.array([True]),
        eta_noise_multiple=np.zeros(1),
        noise_n=0.002,
        unmodelled_share=1e-3,
    )


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_damping_of_a_damper_that_acts_at_once_is_within_its_interval(seed):
    nominal_laws = np.array([[CLEARANCE_M, CLEARANCE_M, STIFFNESS, 0.0]])
    (estimate,) = fit_joint(recorded(seed), nominal_laws, np.array([[True, True]]))
    damping, error = estimate.values[3], estimate.errors[3]
    assert abs(damping - DAMPING) < COVERED * error
    assert error < 0.15 * DAMPING
