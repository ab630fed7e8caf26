"""The tangent of a law against differences of its low-passed force."""

import numpy as np
import pytest
from scipy.signal import firwin, lfilter

from identify.signals.drift import DriftPrior, spline
from identify.signals.law_evaluation import (
    TANGENT_MARGIN_SAMPLES,
    LawTangent,
    evaluated_on_batches,
    finer_signal_batches,
    product_rate_multiple,
)
from rig.model.contact_laws import penetration_m

RATE_HZ, FACTOR, SAMPLES = 4096.0, 12, 12 * 1000 + 1
CLEARANCE_M, STIFFNESS_N_PER_M = 1e-3, 1e5
MULTIPLE = product_rate_multiple(RATE_HZ, FACTOR)


def band_limited(seed, high_hz):
    noise = np.random.default_rng(seed).standard_normal(SAMPLES + 4000)
    slow = lfilter(firwin(2001, high_hz, fs=RATE_HZ), 1.0, noise)[3000 : 3000 + SAMPLES]
    return slow / slow.std()


def force_n(eta_m):
    return STIFFNESS_N_PER_M * penetration_m(eta_m, CLEARANCE_M, CLEARANCE_M)


def stiffness_n_per_m(eta_m):
    return STIFFNESS_N_PER_M * (np.abs(eta_m) > CLEARANCE_M)


def evaluated_finer(law, signals, rate_hz, decimation, multiple):
    """Law at `multiple` times the rate of every `decimation`-th sample."""
    batches = finer_signal_batches(signals, rate_hz)
    return evaluated_on_batches(law, batches, signals.shape[1], rate_hz, decimation, multiple)


@pytest.fixture(scope="module")
def motion():
    """Relative displacement of twice the clearance, and the law's tangent along it."""
    eta_m = 2e-3 * band_limited(1, 60.0)
    finer = evaluated_finer(stiffness_n_per_m, eta_m[None], RATE_HZ, FACTOR, MULTIPLE)
    return eta_m, LawTangent(finer[: MULTIPLE * (SAMPLES // FACTOR) + 1], MULTIPLE)


def force_change_n(eta_m, change_m):
    """Central difference of the low-passed force."""
    above, below = (
        evaluated_finer(force_n, (eta_m + sign * 1e-4 * change_m)[None], RATE_HZ, FACTOR, 1) for sign in (1, -1)
    )
    return (above - below) / 2e-4


def inside(row):
    """Row without its ends, which the low-pass smooths."""
    return row[40:-40]


def relative_error(row, reference):
    return np.linalg.norm(inside(row - reference)) / np.linalg.norm(inside(reference))


def test_a_change_within_a_closure_is_low_passed_as_a_product(motion):
    eta_m, tangent = motion
    change_m = 1e-3 * band_limited(2, 100.0)
    reference = force_change_n(eta_m, change_m)
    finer_m = change_m[:: FACTOR // MULTIPLE]
    assert relative_error(tangent.force_change_n(finer_m), reference) < 0.01
    separate = tangent.force_change_n(np.ones(finer_m.size)) * change_m[::FACTOR]
    assert relative_error(separate, reference) > 0.1


def test_columns_of_a_spline_are_changes_by_its_coefficients(motion):
    eta_m, tangent = motion
    curve = spline(
        SAMPLES // FACTOR + 1, RATE_HZ / FACTOR, DriftPrior(np.zeros(SAMPLES // FACTOR + 1), 1e-3, 1e-3, 0.0)
    )
    columns = tangent.force_change_by_coefficient(curve.value)
    assert columns.shape == curve.value.shape
    coefficients = np.random.default_rng(3).standard_normal(curve.knot_count)
    drift_m = curve.value @ coefficients
    fine_m = np.interp(np.arange(SAMPLES), FACTOR * np.arange(drift_m.size), drift_m)
    assert relative_error(columns @ coefficients, force_change_n(eta_m, 1e-3 * fine_m) / 1e-3) < 0.02
    assert np.max(np.diff(columns.indptr)) < TANGENT_MARGIN_SAMPLES * 2 + 200


@pytest.mark.parametrize(
    ("rate_hz", "factor", "multiple"), [(4096.0, 12, 2), (4096.0, 9, 2), (512.0, 1, 2), (3e4, 9, 3), (3e4, 1, 1)]
)
def test_products_are_made_at_a_multiple_that_divides(rate_hz, factor, multiple):
    assert product_rate_multiple(rate_hz, factor) == multiple
    rows = evaluated_finer(lambda eta: eta, np.ones((1, 9 * factor + 1)), rate_hz, factor, multiple)
    assert rows.size >= 9 * multiple + 1
