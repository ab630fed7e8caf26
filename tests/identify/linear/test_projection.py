"""The solution of the linear model, against least squares by scipy, line by line, and against sampled statistics."""

import numpy as np
import pytest
from scipy.linalg import lstsq, null_space, solve_triangular

from identify.linear.projection import (
    estimated_inputs_and_log_det,
    free_input_estimator_and_condition,
    input_complement,
    input_residual,
    projection,
    residuals_without_free_inputs,
)

INPUTS, SENSORS, LINES = 3, 7, 5


def drawn(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(4)


def covariances(rng: np.random.Generator) -> np.ndarray:
    roots = drawn(rng, LINES, SENSORS, SENSORS)
    return roots @ roots.conj().transpose(0, 2, 1) + np.eye(SENSORS)


def batches(covariance: np.ndarray) -> list[tuple[slice, np.ndarray]]:
    return [(slice(0, 2), covariance[:2]), (slice(2, LINES), covariance[2:])]


@pytest.mark.parametrize("free", range(INPUTS + 1))
def test_inputs_are_those_of_least_squares_with_a_row_more_for_each_prior(rng, free):
    by_input, deviation = drawn(rng, INPUTS, SENSORS, LINES), rng.uniform(0.1, 3, (SENSORS, LINES))
    measured = drawn(rng, SENSORS, LINES)
    projected = projection(by_input / deviation, deviation, free)
    rows, inputs = projected.applied_to(measured)
    single, _ = estimated_inputs_and_log_det(by_input / deviation, measured / deviation, free)
    for line in range(LINES):
        weighted = np.concatenate([(by_input[..., line] / deviation[:, line]).T, np.eye(INPUTS)[free:]])
        expected = lstsq(weighted, np.append(measured[:, line] / deviation[:, line], np.zeros(INPUTS - free)))[0]
        np.testing.assert_allclose(single[:, line], expected, rtol=1e-9)
        np.testing.assert_allclose(inputs[:, line], expected[:free], rtol=1e-9)
        np.testing.assert_allclose(rows[SENSORS:, line], expected[free:], rtol=1e-9)
        residual = measured[:, line] - expected @ by_input[..., line]
        np.testing.assert_allclose(rows[:SENSORS, line], residual / deviation[:, line], rtol=1e-8)


def test_what_some_sensors_deliver_is_what_all_do_with_the_others_at_rest(rng):
    by_input, deviation = drawn(rng, INPUTS, SENSORS, LINES), rng.uniform(0.1, 3, (SENSORS, LINES))
    sensors, delivered = [1, 4], drawn(rng, 2, LINES)
    everywhere = np.zeros((SENSORS, LINES), dtype=complex)
    everywhere[sensors] = delivered
    projected = projection(by_input, deviation, 2)
    for by_two, by_all in zip(projected.applied_to(delivered, sensors), projected.applied_to(everywhere), strict=True):
        np.testing.assert_allclose(by_two, by_all, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        projected.in_single_precision().applied_to(everywhere)[0],
        projected.applied_to(everywhere)[0],
        rtol=1e-4,
        atol=1e-5,
    )


@pytest.mark.parametrize("free", range(INPUTS))
def test_the_determinant_is_that_of_the_likelihood_with_the_inputs_integrated_out(rng, free):
    """Of noise one and inputs of variance one: log det (1 + B B^H), in what free inputs do not reach."""
    by_input = drawn(rng, INPUTS, SENSORS, LINES)
    expected = 0.0
    for line in range(LINES):
        outside = null_space(by_input[:free, :, line].conj()) if free else np.eye(SENSORS)
        reached = outside.conj().T @ by_input[free:, :, line].T
        expected += np.linalg.slogdet(np.eye(len(reached)) + reached @ reached.conj().T)[1]
    _, log_determinant = estimated_inputs_and_log_det(by_input, drawn(rng, SENSORS, LINES), free)
    assert log_determinant == pytest.approx(expected, rel=1e-9)


def test_with_a_covariance_the_inputs_are_those_of_whitened_sensors(rng):
    by_input, covariance = drawn(rng, INPUTS, SENSORS, LINES), covariances(rng)
    measured, columns = drawn(rng, SENSORS, LINES), drawn(rng, 2, SENSORS, LINES)
    to_inputs, condition = free_input_estimator_and_condition(by_input, batches(covariance))
    assert 1 <= condition < 1e4
    residuals = np.concatenate(
        list(residuals_without_free_inputs([columns, measured[None]], by_input, batches(covariance)))
    )
    for line in range(LINES):
        root = np.linalg.cholesky(covariance[line])
        white = [
            solve_triangular(root, x, lower=True)
            for x in (by_input[..., line].T, measured[:, line], columns[1, :, line])
        ]
        expected = lstsq(white[0], white[1])[0]
        np.testing.assert_allclose(to_inputs[..., line] @ measured[:, line], expected, rtol=1e-9)
        standard = residuals[line * SENSORS : (line + 1) * SENSORS]
        np.testing.assert_allclose(standard[:, 2], white[1] - white[0] @ expected, rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(
            standard[:, 1], white[2] - white[0] @ lstsq(white[0], white[2])[0], rtol=1e-7, atol=1e-9
        )


def test_inputs_that_the_sensors_do_not_tell_apart_are_said_to_be_so_and_share_what_they_make(rng):
    by_input = drawn(rng, 1, SENSORS, LINES) * np.array([1.0, 2.0])[:, None, None]
    _, condition = free_input_estimator_and_condition(by_input, batches(covariances(rng)))
    assert condition > 1e12
    inputs = np.array([[3.0], [-1.0]]) * np.ones(LINES)
    measured = -input_residual(by_input, inputs.astype(complex), np.zeros((SENSORS, LINES), dtype=complex))
    rows, _ = projection(by_input, np.ones((SENSORS, LINES)), 2).applied_to(measured)
    assert np.abs(rows).max() < 1e-2 * np.abs(measured).max()


def test_inputs_that_no_sensor_feels_are_zero_or_their_prior(rng):
    by_input = drawn(rng, 2, SENSORS, LINES)
    by_input[1] = 0
    for free in (1, 2):
        inputs, log_determinant = estimated_inputs_and_log_det(by_input, drawn(rng, SENSORS, LINES), free)
        assert not np.any(inputs[1])
        assert log_determinant == 0


def test_the_complement_is_orthonormal_and_keeps_the_residual_of_free_inputs(rng):
    by_input, measured = drawn(rng, INPUTS, SENSORS, LINES), drawn(rng, SENSORS, LINES)
    rows = input_complement(by_input)
    residual = projection(by_input, np.ones((SENSORS, LINES)), INPUTS).applied_to(measured)[0]
    assert rows.shape == (LINES, SENSORS - INPUTS, SENSORS)
    for line in range(LINES):
        np.testing.assert_allclose(rows[line] @ rows[line].conj().T, np.eye(SENSORS - INPUTS), atol=1e-12)
        np.testing.assert_allclose(rows[line] @ by_input[..., line].T, 0, atol=1e-12)
        assert np.linalg.norm(rows[line] @ measured[:, line]) == pytest.approx(np.linalg.norm(residual[:, line]))
        inside = null_space(by_input[..., line].conj())
        np.testing.assert_allclose(rows[line].conj().T @ rows[line], inside @ inside.conj().T, atol=1e-10)


@pytest.mark.parametrize(("inputs", "rows"), [(0, SENSORS), (SENSORS, 0), (SENSORS + 1, 0)])
def test_of_no_inputs_all_is_left_and_of_as_many_as_sensors_nothing(rng, inputs, rows):
    assert input_complement(drawn(rng, inputs, SENSORS, LINES)).shape == (LINES, rows, SENSORS)


def test_without_inputs_everything_is_residual(rng):
    measured, deviation = drawn(rng, SENSORS, LINES), np.full((SENSORS, LINES), 2.0)
    rows, inputs = projection(np.zeros((0, SENSORS, LINES), dtype=complex), deviation, 0).applied_to(measured)
    np.testing.assert_allclose(rows, measured / 2)
    assert inputs.shape == (0, LINES)
