"""The form of a contact's law that a record asks for, and the errors that the chosen one leaves in its numbers.

A form is asked for where its fit, with the weights of the dead zone's, leaves less by Schwarz's criterion, and in one
sixteenth of the record after the other (the statistic of Vuong, Econometrica 57, 1989):

    N / L sum_b n_b ln(S_0b / S_b) > m ln N + 2 ln 1000,    mean_i(d_i) > 3 std_i(d_i) / sqrt(16)

with the weighted squares S_b in bands of n_b of the L lines of the spectrum, m more numbers than the dead zone, N
samples, 20 a second, and d_i what a sixteenth of the record leaves less, every band by its own S_0b / n_b. Bands: noise
where the law does not act would drown what it leaves elsewhere.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import f

from identify.contacts.law_fit import LawFit
from identify.contacts.law_form import FormName, LawForm
from identify.contacts.linearization import Jacobian, moved
from identify.contacts.refusals import ContactRefusedError
from identify.signals.scores import PARTS, part_scores

FORMS: tuple[FormName, ...] = ("power law", "cannot pull")
ODDS = 1000.0
CONSISTENT = 3.0
SURE = 0.99
BANDS, LOWEST_LINE = 24, 8
"""Bands grow with frequency, from one of so many lines on."""
LEAST_SAMPLES = 10 * PARTS
"""Of fewer samples on one side of a split nothing is told of the law."""


def asked_form(fit: LawFit, names: Sequence[FormName]) -> LawFit:
    """The fit of the form that the record asks for, settled; the dead zone's where it asks for none."""
    if not names:
        return fit
    form = LawForm(reference_depth_m=_typical_depth_m(fit))
    if not form.reference_depth_m:
        return fit
    chosen, least = None, np.inf
    for name in names:
        try:
            alternative = fit.by_form(replace(form, name=name))
        except ContactRefusedError:
            continue
        if is_asked_for(fit, alternative) and alternative.squares.sum() < least:
            chosen, least = alternative, float(alternative.squares.sum())
    try:
        return chosen.settled if chosen else fit
    except ContactRefusedError:
        return fit


def is_asked_for(simple: LawFit, alternative: LawFit) -> bool:
    """True if the alternative form leaves less than the dead zone, by both criteria above."""
    samples = max(2.0, simple.weights.size / simple.record.sample_ratio)
    gained, steadily = evidence(simple, alternative, samples)
    return bool(gained > alternative.state.form.shapes * np.log(samples) + 2 * np.log(ODDS) and steadily > CONSISTENT)


def evidence(simple: LawFit, alternative: LawFit, samples: float) -> tuple[float, float]:
    """The left sides of the criteria, the second one over the right one's scatter."""
    before, after = (np.fft.rfft(fit.weights * fit.state.residual) for fit in (simple, alternative))
    edges = np.geomspace(LOWEST_LINE, before.size, BANDS + 1).astype(int)
    starts = np.unique(np.r_[0, edges[1:-1]])
    count = np.diff(np.r_[starts, before.size])
    left, fewer = (np.add.reduceat(np.abs(lines) ** 2, starts) for lines in (before, after))
    if not np.all((left > 0) & (fewer > 0)):
        return 0.0, 0.0
    gained = samples * float(count @ np.log(left / fewer)) / before.size
    usual = np.repeat(np.sqrt(left / count), count)
    squares = [np.fft.irfft(lines / usual, simple.weights.size) ** 2 for lines in (before, after)]
    parts = np.array([part.sum() for part in np.array_split(squares[0] - squares[1], PARTS)])
    scatter = float(parts.std(ddof=1)) / np.sqrt(PARTS)
    return gained, float(parts.mean()) / scatter if scatter > 0 else 0.0


def misfit_covariance(
    fit: LawFit, jacobian: Jacobian, begins: Int[np.ndarray, " parts"]
) -> Float[np.ndarray, "laws laws"]:
    """Covariance of a law's numbers from what the law, where it is not the record's, leaves of the force.

    The closed samples are parted in two ways: deep and shallow ones, and such in which the depth grows or falls. Were
    the law right, the numbers by either half, all else as fitted, would differ by the record's scatter C alone, and
    with their difference D of f numbers T^2 = D' C^-1 D would follow Hotelling's distribution of 16 parts. With the
    bound T0^2 that it then keeps in 99 of 100 records,

        D D' / 4 max(0, 1 - T0^2 / T^2)

    is added for each way.
    """
    law = fit.state.law
    found = np.zeros((law.size, law.size))
    to_law = fit.linearized[2]
    for half in _halves(fit):
        sides = [_numbers_by(fit, jacobian.by_law @ to_law, side, begins) for side in half]
        if any(side is None for side in sides):
            continue
        first, second = (side for side in sides if side is not None)
        apart, excess = _excess(first - second)
        moved_law = to_law @ apart / 2
        found += excess * np.outer(moved_law, moved_law)
    return found


def _excess(scores: Float[np.ndarray, "parts free"]) -> tuple[Float[np.ndarray, " free"], float]:
    """The sum D of the parts' scores, and the share by which T^2 exceeds what chance makes of it."""
    count, free = scores.shape
    apart = scores.sum(axis=0)
    scale = np.maximum(np.sqrt(np.sum(scores**2, axis=0)), 1e-300)
    scatter = (scores - scores.mean(axis=0)) / scale
    covariance = count / (count - 1) * scatter.T @ scatter
    square = float((apart / scale) @ np.linalg.pinv(covariance, hermitian=True) @ (apart / scale))
    bound = free * (count - 1) / (count - free) * float(f.ppf(SURE, free, count - free))
    return apart, max(0.0, 1 - bound / max(square, 1e-300))


def _halves(fit: LawFit) -> list[tuple[Bool[np.ndarray, " fewer"], Bool[np.ndarray, " fewer"]]]:
    """The closed samples: deep and shallow; pressed in and let go."""
    record, state = fit.record, fit.state
    eta, rate = (row[:: record.factor][: state.residual.size] for row in _motion(fit))
    depth = _depth_m(fit, eta)
    closed = state.form.slopes(state.law, eta, rate)[0] > 0
    deep = np.abs(depth) > np.median(np.abs(depth[closed])) if closed.any() else closed
    grows = depth * rate > 0
    return [(closed & deep, closed & ~deep), (closed & grows, closed & ~grows)]


def _numbers_by(
    fit: LawFit,
    by_free: Float[np.ndarray, "fewer free"],
    samples: Bool[np.ndarray, " fewer"],
    begins: Int[np.ndarray, " parts"],
) -> Float[np.ndarray, "parts free"] | None:
    """Scores of the law's free numbers by part of the record: how far these samples alone would move them."""
    if samples.sum() < LEAST_SAMPLES:
        return None
    weights = np.where(samples, fit.weights, 0.0)[:, None] ** 2
    normal = by_free.T @ (weights * by_free)
    if not np.linalg.cond(normal) < 1e10:
        return None
    influence = weights * by_free @ np.linalg.inv(normal)
    return part_scores(influence, fit.state.residual, begins)


def _typical_depth_m(fit: LawFit) -> float:
    """The root mean square of the depth while the contact is closed, as 1, 2 or 5 times a power of ten, so that records
    of a machine have the same."""
    depth = _depth_m(fit, _motion(fit)[0])
    if not depth.any():
        return 0.0
    typical_m = float(np.sqrt(np.mean(depth[depth != 0] ** 2)))
    power = float(10 ** np.floor(np.log10(typical_m)))
    return min(
        (round_number * power for round_number in (1.0, 2.0, 5.0, 10.0)), key=lambda d: abs(np.log(d / typical_m))
    )


def _motion(fit: LawFit) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
    return moved(fit.record, fit.curve, fit.state.knots, fit.state.pulls)


def _depth_m(fit: LawFit, eta_m: Float[np.ndarray, " some"]) -> Float[np.ndarray, " some"]:
    lower, upper, _, _ = fit.state.form.contacts(fit.state.law)[0]
    return np.asarray(eta_m - np.clip(eta_m, -lower, upper))
