"""The statistic that decides, on residuals whose size is known."""

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.signal import lfilter

from identify.gaps.decision.comparison import (
    explained_share,
    explained_share_interval,
    mismatch_size,
    probabilities,
    removed_share,
)
from identify.gaps.decision.null_reference import NullReference, NullSimulation, p_value, p_value_combined_with_bound
from identify.gaps.decision.null_simulations import phase_randomized
from identify.gaps.residual.likelihood import Misfit, NominalVariances
from identify.gaps.residual.lines import (
    outstanding_line_cost,
    outstanding_line_frequencies,
    sharpest_line_frequencies,
    without_lines,
)
from identify.gaps.residual.scales import (
    estimated_scales,
    posterior_variance,
    prior_scales,
    residual_mean_squares_by_band,
)
from identify.gaps.results import Matters
from rig.simulation.reference import BarrelCradle
from tests.identify.gaps.residual.simulated_records import simulated_record

SECONDS, BANDS, SENSORS, CONTACTS = 20, 40, 6, 2
ONES = np.ones((BANDS, SENSORS))
REFERENCE = NominalVariances(
    expected_variance=ONES,
    noise_variance=0.5 * ONES,
    acceleration_power=1e4 * ONES,
    line_counts=np.full(BANDS, 50.0),
    observations=(),
)


def misfit_of_level(level: float, contact_n: float = 0.0, pulls: float = 0.0) -> Misfit:
    """A linear residual of this level everywhere, a contact residual of so many newtons beside a force of 10 N."""
    contacts = np.ones((SECONDS, CONTACTS))
    return Misfit(
        nominal_variances=REFERENCE,
        variance_by_second=np.full((SECONDS, BANDS, SENSORS), level),
        variance_correction=ONES,
        contact_mean_square_by_second=contacts * (1 + contact_n**2),
        contact_beyond_noise_n2=contacts * contact_n**2,
        contact_force_n2=contacts * 100.0,
        pulls=np.full(4, pulls),
        drift_cost=0.0,
        input_cost=0.0,
        line_cost=0.0,
        independent_sample_count=80.0,
    )


def test_a_residual_of_noise_costs_nothing_and_a_larger_one_its_logarithm():
    assert misfit_of_level(1.0).minus_two_log == pytest.approx(0.0)
    assert misfit_of_level(199.0).band_cost == pytest.approx(80.0 * SENSORS * np.log(100.0))
    assert misfit_of_level(1.0, pulls=2.0).minus_two_log == pytest.approx(16.0)


def test_an_unknown_scale_makes_a_lasting_error_cost_no_more_than_its_logarithm():
    known = 80.0 * SENSORS * 99.0  # what a Gaussian of known variance would ask for
    assert misfit_of_level(100.0).minus_two_log < 0.05 * known


def test_shares_are_beyond_noise_and_relative_to_the_motion():
    assert misfit_of_level(0.5).unexplained_share == 0.0
    assert misfit_of_level(1.5).unexplained_share == pytest.approx(np.sqrt(1.0 / 1e4))
    np.testing.assert_allclose(misfit_of_level(1.5).share_by_band, 0.01)
    np.testing.assert_allclose(misfit_of_level(1.0, contact_n=0.5).unexplained_contact_shares, 0.05)


def with_noise_of(level: float, seed: int) -> Misfit:
    """Noise in 400 bands, each of the mean square of 50 lines, beside five times its power."""
    bands = np.ones((400, SENSORS))
    noisy = NominalVariances(bands, bands, 5 * bands, np.full(400, 50.0), ())
    draws = np.random.default_rng(seed).gamma(50.0, level / 50.0, bands.shape)
    return replace(
        misfit_of_level(1.0),
        nominal_variances=noisy,
        variance_by_second=np.broadcast_to(draws, (SECONDS, *bands.shape)).copy(),
        variance_correction=bands,
    )


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_leaves_no_share_of_the_motion_in_many_noisy_bands(seed):
    """Positive parts of all bands would add up to 11 %."""
    noise = with_noise_of(1.0, seed)
    assert np.sqrt(np.mean(noise.share_by_band**2)) > 0.1
    assert noise.unexplained_share < 0.04


def test_noise_that_is_estimated_too_high_hides_no_misfit_of_one_band():
    noise = with_noise_of(0.8, 1)
    noise.variance_by_second[:, 7] += 100.0  # of a power of 5 in each of 400 bands
    assert noise.unexplained_share == pytest.approx(np.sqrt(100.0 / (5 * 400)), rel=0.01)


def test_the_size_of_a_gap_counts_in_what_matters():
    matters = Matters(motion=0.01, contact=0.05)
    assert mismatch_size(misfit_of_level(1.5), matters) == pytest.approx(1.0)
    assert mismatch_size(misfit_of_level(1.5, contact_n=0.5), matters) == pytest.approx(np.sqrt(3.0))


def test_what_is_closed_is_one_where_nothing_is_left():
    matters = Matters()
    assert explained_share(misfit_of_level(100.0), misfit_of_level(0.5), matters) == 1.0
    assert explained_share(misfit_of_level(4.5), misfit_of_level(1.5), matters) == pytest.approx(0.5)
    low, high = explained_share_interval(misfit_of_level(4.5), misfit_of_level(1.5), matters)
    assert low == pytest.approx(0.5)
    assert high == pytest.approx(0.5)


def test_where_noise_hides_a_gap_what_is_removed_is_the_strain_of_the_tolerances():
    strained, eased = misfit_of_level(0.5, pulls=4.0), misfit_of_level(0.5, pulls=2.0)
    assert removed_share(strained, eased, eased, Matters()) == pytest.approx(1 - 2.0**2 / 4.0**2)
    assert removed_share(misfit_of_level(0.5), misfit_of_level(0.5), misfit_of_level(0.5), Matters()) == 0.0
    assert removed_share(strained, misfit_of_level(4.5), misfit_of_level(1.5), Matters()) == pytest.approx(0.5)


def test_the_interval_of_a_closure_holds_it_where_seconds_scatter():
    rng = np.random.default_rng(2)
    after = replace(
        misfit_of_level(1.5),
        variance_by_second=1.5 * rng.chisquare(3, (SECONDS, 1, 1)) / 3 * np.ones((1, BANDS, SENSORS)),
    )
    low, high = explained_share_interval(misfit_of_level(40.0), after, Matters())
    assert low < explained_share(misfit_of_level(40.0), after, Matters()) < high
    assert high - low > 1e-3


def test_probabilities_sum_to_one_and_follow_the_odds():
    chances = probabilities(np.array([0.0, np.log(3.0), -1e9]))
    assert chances.sum() == pytest.approx(1.0)
    assert chances[1] / chances[0] == pytest.approx(3.0)


def misfit_of_costs(other_costs: float, law: float, peak: float = 1.0) -> Misfit:
    """-2 ln p of the contacts, of the rest, and the part of the worst band."""

    class MisfitOfCosts(Misfit):
        contact_cost = law
        peak_band_cost = peak

    bare = misfit_of_level(1.0)
    input_cost = other_costs - (bare.minus_two_log - bare.contact_cost)
    values = {field.name: getattr(bare, field.name) for field in fields(bare)}
    return MisfitOfCosts(**values | {"input_cost": input_cost})


def null(other_costs: float, law: float = -60.0, peak: float = 1.0) -> NullSimulation:
    return NullSimulation(other_costs + law, law, peak, (0.0,), 0.0, ())


@pytest.mark.parametrize("squares", [(40.0, 5.0, 2.0), (300.0, 40.0, 5.0), (2.0, 1.0, 1.0)])
def test_p_values_of_nulls_are_uniform(squares):
    """Few squares of normal variables are skewed: taken for normal, p-values would be small too often."""
    rng = np.random.default_rng(3)
    values = []
    for _ in range(2000):
        other_costs, law, peak = (rng.chisquare(count, 13) for count in squares)
        null_reference = NullReference("key", tuple(map(null, other_costs, law, peak))[:12])
        values.append(p_value(null_reference, misfit_of_costs(float(other_costs[12]), float(law[12]), float(peak[12]))))
    assert np.mean(np.array(values) < 0.01) < 0.015
    assert 0.02 < np.mean(np.array(values) < 0.05) < 0.07
    assert np.mean(np.array(values) < 0.5) == pytest.approx(0.42, abs=0.08)  # 1 - (5/6)^3, of three parts


def test_a_bound_that_says_nothing_leaves_a_p_value_alone_and_a_small_one_decides():
    for value in (0.004, 0.3, 0.9):
        assert value <= p_value_combined_with_bound(value, 1.0) <= 1.06 * value
    assert p_value_combined_with_bound(0.99, 1.0) == 1.0
    assert p_value_combined_with_bound(0.6, 1e-9) == pytest.approx(2e-8)


def test_a_contact_or_a_band_alone_beyond_the_nulls_shows():
    rng = np.random.default_rng(5)
    null_reference = NullReference("key", tuple(null(r) for r in rng.normal(50.0, 90.0, 12)))
    assert p_value(null_reference, misfit_of_costs(50.0, 0.0)) < 1e-4
    assert p_value(null_reference, misfit_of_costs(50.0, -60.0, 20.0)) < 1e-4
    assert p_value(null_reference, misfit_of_costs(50.0, -60.0)) > 0.4


def test_a_line_is_no_error_of_a_model():
    rng = np.random.default_rng(6)
    time = np.arange(8000) / 300.0
    noise = rng.standard_normal((12, 8000))
    resonance = lfilter([1.0], [1.0, -2 * 0.9995 * np.cos(2 * np.pi * 20 / 300), 0.9995**2], rng.standard_normal(8000))
    assert outstanding_line_cost(noise, 10) < 5.0
    assert outstanding_line_cost(noise + resonance / resonance.std(), 10) < 5.0
    toned = noise + np.cos(2 * np.pi * 42.263 * time)
    assert outstanding_line_cost(toned, 10) > 20.0
    assert np.linalg.norm(without_lines(toned, outstanding_line_frequencies(toned)) - noise) < 0.03 * np.linalg.norm(
        noise
    )
    assert not outstanding_line_frequencies(noise)


def test_the_lines_of_a_force_that_repeats_are_no_tones():
    """Noise that repeats 20 times has lines at all multiples of its frequency; a tone between them still stands out."""
    rng = np.random.default_rng(7)
    repeated = np.tile(rng.standard_normal((3, 200)), 20) + 0.01 * rng.standard_normal((3, 4000))
    repeats = 1 / 200
    assert outstanding_line_frequencies(repeated)
    assert outstanding_line_cost(repeated, 3) > 1000
    assert not outstanding_line_frequencies(repeated, repeats)
    assert outstanding_line_cost(repeated, 3, repeats) == 0.0
    tone = 20.5 * repeats
    toned = repeated + np.sin(2 * np.pi * tone * np.arange(4000))
    np.testing.assert_allclose(outstanding_line_frequencies(toned, repeats), [tone], rtol=1e-4)
    np.testing.assert_allclose(sharpest_line_frequencies(toned, 1, 0.05, repeats), [tone], rtol=1e-4)


def test_a_phase_randomized_force_keeps_its_spectrum_and_its_silence():
    rng = np.random.default_rng(4)
    force = np.concatenate([np.zeros(500), rng.standard_normal(4000)])
    turned = phase_randomized(force, 500, 1000.0, rng)
    assert not np.any(turned[:500])
    assert np.sqrt(np.mean(turned[500:] ** 2)) == pytest.approx(np.sqrt(np.mean(force[500:] ** 2)), rel=0.05)
    assert abs(np.corrcoef(turned, force)[0, 1]) < 0.1


def test_the_scale_of_what_is_unmodelled_is_told_by_the_residual():
    settings = BarrelCradle(sensors="acceleration", duration_s=12.0, rms_n=1.0, noise_density=1e-4)
    record = simulated_record(settings, settings.rig())
    prior = prior_scales(record)
    true_share = 4e-3
    deviation_ratio = np.sqrt(
        (record.noise_variance + true_share**2 * record.smoothed_power)
        / (record.noise_variance + prior.unmodelled_shares**2 * record.smoothed_power)
    )
    times = record.counted_slice.stop - record.counted_slice.start
    rng = np.random.default_rng(5)
    lines = rng.standard_normal((2, *deviation_ratio.shape))
    spectra = deviation_ratio * (lines[0] + 1j * lines[1]) / np.sqrt(2)
    residual = np.fft.irfft(spectra, record.transform_length // record.decimation)[:, :times]
    residual *= np.sqrt(record.transform_length // record.decimation)
    scales = estimated_scales(record, prior, residual, (0.2, 3.0))
    middle = scales.unmodelled_shares[:, record.omega.size // 4 : record.omega.size // 2]
    assert np.median(middle) == pytest.approx(true_share, rel=0.2)
    assert scales.contact_variances == (float(posterior_variance(np.array(0.2))), 2.0)
    assert residual_mean_squares_by_band(record, residual).min() > 0
