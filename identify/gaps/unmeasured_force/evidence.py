"""Evidence J for an unmeasured force: how much better it explains a record.

With the direction u = g / |g| of a candidate's residual g and its share t = u^H (r - D theta) of the residual,

    J = n sum over lines [(R - 1) ln s + Q / s + ln(s + S |g|^2) + |t|^2 / (s + S |g|^2) + 2 Re tr' theta]
        + theta' theta

is -2 ln L up to a constant: the force has the spectrum S and what nothing explains the variance s, both constant in
bands of 2 Hz (s is one where a line has one row only, which cannot tell it from S); Q = |r - D theta|^2 - |t|^2, R rows
a line, n independent real values a line. s, S and theta take turns.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from scipy.linalg import cho_factor, cho_solve

from identify.gaps.unmeasured_force.observed import WhitenedRecord

ROUNDS, SCORINGS = 4, 5
"""Of s and S in turn with theta; of Fisher scoring within each."""
LEAST = 1e-12


@dataclass(frozen=True)
class Explained:
    """A record with one candidate: J, nuisances in their tolerances, s and S by band, and the residual's share t.

    Without a candidate S is zero, and so is t.
    """

    criterion: float
    theta: Float[np.ndarray, " columns"]
    noise: Float[np.ndarray, " bands"]
    spectrum: Float[np.ndarray, " bands"]
    size: Float[np.ndarray, " lines"]
    along: Complex[np.ndarray, " lines"]


def solved(
    matrix: Float[np.ndarray, "columns columns"], rest: Float[np.ndarray, "columns"]
) -> Float[np.ndarray, "columns"]:
    return np.asarray(cho_solve(cho_factor(matrix), rest))


def left(own: WhitenedRecord, theta: Float[np.ndarray, " columns"]) -> Float[np.ndarray, " bands"]:
    """|r - D theta|^2 by band."""
    return np.maximum(own.squares - 2 * own.crossed @ theta + (own.gram @ theta) @ theta, LEAST * own.squares)


def normal(
    own: WhitenedRecord, noise: Float[np.ndarray, " bands"]
) -> tuple[Float[np.ndarray, "columns columns"], Float[np.ndarray, " columns"]]:
    """Normal equations of theta at some s, without a candidate."""
    matrix = own.count * np.tensordot(1 / noise, own.gram, 1) + np.eye(len(own.parameters))
    return matrix, own.count * (own.crossed.T @ (1 / noise) - own.trace / 2)


def without(own: WhitenedRecord) -> Explained:
    """The record by nuisances and noise alone."""
    counts = own.sizes * own.rows
    known = own.rows == 1
    theta, noise = np.zeros(len(own.parameters)), np.ones(counts.size) if known else own.squares / counts
    for _ in range(3 * ROUNDS):
        theta = solved(*normal(own, noise))
        if not known:
            noise = left(own, theta) / counts
    beside = left(own, theta)
    criterion = own.count * float(np.sum(counts * np.log(noise) + beside / noise)) + _held(own, theta)
    zero = np.zeros(own.residual.shape[0])
    return Explained(criterion, theta, noise, np.zeros(noise.size), zero, zero.astype(complex))


def explained(
    own: WhitenedRecord,
    candidate: Complex[np.ndarray, "lines rows"],
    start: Explained,
    cleared: Complex[np.ndarray, "lines rows"] | None = None,
    shape: Float[np.ndarray, " bands"] | None = None,
) -> Explained:
    """Evidence with a force of the candidate's residual per unit force, from the nuisances and noise of `start`.

    With the residual `cleared` of the nuisances of `start` these stay where they are: quick, for a first choice.
    `shape` is a spectrum of which only the size is free.
    """
    held = cleared is not None
    size = np.linalg.norm(candidate, axis=1)
    direction = candidate.conj() / np.maximum(size, 1e-300)[:, None]
    bare = np.einsum("lr,lr->l", direction, own.residual if cleared is None else cleared)
    columns = np.zeros((len(own.parameters), 0)) if held else _along(direction, own.columns)
    theta, noise = start.theta, start.noise
    spectrum = start.spectrum if np.any(start.spectrum) else None
    squares = size**2
    for turn in range(1 if held else ROUNDS):
        along = bare if held else bare - theta @ columns
        noise, spectrum = _scored(own, squares, np.abs(along) ** 2, left(own, theta), noise, spectrum, shape)
        if held or turn == ROUNDS - 1:
            break
        weights = own.on_lines(1 / noise)
        less = weights - 1 / (own.on_lines(noise) + own.on_lines(spectrum) * squares)
        matrix, rest = normal(own, noise)
        matrix -= own.count * (_halves(less * columns) @ _halves(columns).T)
        rest -= own.count * (_halves(less * columns) @ _halves(bare))
        theta = solved(matrix, rest)
    assert spectrum is not None
    whole = own.on_lines(noise) + own.on_lines(spectrum) * squares
    beside = np.maximum(left(own, theta) - _summed(own, np.abs(along) ** 2), 0.0)
    criterion = own.count * float(
        np.sum(own.sizes * (own.rows - 1) * np.log(noise) + beside / noise)
        + np.sum(np.log(whole) + np.abs(along) ** 2 / whole)
    ) + _held(own, theta)
    return Explained(criterion, theta, noise, spectrum, size, along)


def cleared_of(own: WhitenedRecord, theta: Float[np.ndarray, " columns"]) -> Complex[np.ndarray, "lines rows"]:
    """The residual without what the nuisances make."""
    found = own.residual.copy()
    for value, column in zip(theta, own.columns, strict=True):
        found -= value * column
    return found


def _held(own: WhitenedRecord, theta: Float[np.ndarray, " columns"]) -> float:
    """theta' theta, and what theta stretches the data by."""
    return float(theta @ theta) + own.count * float(own.trace @ theta)


def _along(
    direction: Complex[np.ndarray, "lines rows"], columns: Complex[np.ndarray, "columns lines rows"]
) -> Complex[np.ndarray, "columns lines"]:
    return np.einsum("lr,clr->cl", direction, columns)


def _halves(values: Complex[np.ndarray, "*rows lines"]) -> Float[np.ndarray, "*rows twice"]:
    """Real and imaginary parts beside each other."""
    return np.ascontiguousarray(values).view(float)


def _summed(own: WhitenedRecord, lines: Float[np.ndarray, " lines"]) -> Float[np.ndarray, " bands"]:
    return np.asarray(np.add.reduceat(lines, own.starts))


def _scored(
    own: WhitenedRecord,
    squares: Float[np.ndarray, " lines"],
    power: Float[np.ndarray, " lines"],
    whole: Float[np.ndarray, " bands"],
    noise: Float[np.ndarray, " bands"],
    spectrum: Float[np.ndarray, " bands"] | None,
    shape: Float[np.ndarray, " bands"] | None,
) -> tuple[Float[np.ndarray, " bands"], Float[np.ndarray, " bands"]]:
    """s and S by Fisher scoring, one in turn with the other."""
    beside = np.maximum(whole - _summed(own, power), 0.0)
    others = own.sizes * (own.rows - 1)
    known = own.rows == 1
    if spectrum is None:
        noise = noise if known else np.maximum(beside / others, LEAST * noise)
        excess = _summed(own, power) - noise * own.sizes
        spectrum = np.maximum(excess, 0.0) / np.maximum(_summed(own, squares), 1e-300)
    for _ in range(SCORINGS):
        variance = own.on_lines(noise) + own.on_lines(spectrum) * squares
        weights = 1 / variance**2
        fall = beside / noise**2 + _summed(own, weights * (power - own.on_lines(spectrum) * squares))
        noise = noise if known else np.maximum(fall / (others / noise**2 + _summed(own, weights)), LEAST * noise)
        variance = own.on_lines(noise) + own.on_lines(spectrum) * squares
        weights = squares / variance**2
        if shape is None:
            fall = _summed(own, weights * (power - own.on_lines(noise)))
            spectrum = np.maximum(fall, 0.0) / np.maximum(_summed(own, weights * squares), 1e-300)
        else:
            form = own.on_lines(shape)
            times = np.sum(weights * form * (power - own.on_lines(noise))) / max(
                float(np.sum(weights * squares * form**2)), 1e-300
            )
            spectrum = max(float(times), 0.0) * shape
    return noise, spectrum
