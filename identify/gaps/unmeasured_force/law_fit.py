"""The law that an unmeasured force follows: its time history regressed on laws of the motion at its place.

Laws that need the slow motion which integration loses are fitted by Gauss-Newton on their numbers and that motion.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from identify.gaps.unmeasured_force.force_laws import FORMS, Fine, ForceLaw, Form, fitted, solved, tone_of
from identify.gaps.unmeasured_force.time_history import KNOTS_S, ForceHistory, softened
from identify.signals.descent import Step, descended
from identify.signals.kinematics import CORNER_HZ

STEPS, SETTLED = 8, 1e-4
GRID = 14
TRUSTED = (1.0, 0.3, 0.1)
"""A law is first trusted to this share of the force: far from its numbers, details mislead."""
AS_GOOD = 0.02
"""A law keeps enough if no other keeps more of the free force's gain by more than this."""
FINISHED = 2


def laws(history: ForceHistory) -> tuple[ForceLaw, ...]:
    """Every law with its best numbers, those that keep most first.

    Those that need the slow motion are tried if no other serves; the best of them only to the end.
    """
    quick = [_toned(history), *(fitted(history, form) for form in FORMS if not form.slow)]
    slow: list[ForceLaw] = []
    if max(law.share for law in quick) < 1 - AS_GOOD:
        begun = sorted((begun_at(history, form) for form in FORMS if form.slow), key=lambda one: -one[1].law.share)
        finished = [ended(history, *one).law for one in begun[:FINISHED]]
        slow = finished + [
            replace(state.law, share=min(state.law.share, finished[-1].share)) for _, state in begun[FINISHED:]
        ]
    return tuple(sorted(quick + slow, key=lambda law: -law.share))


def shortest(found: tuple[ForceLaw, ...], least: float) -> ForceLaw | None:
    """The shortest law that keeps about as much as the best, if that is at least this share of the free force's."""
    enough = [law for law in found if law.share >= found[0].share - AS_GOOD]
    best = min(enough, key=lambda law: (law.form.length, -law.share))
    return best if best.share >= least else None


def _toned(history: ForceHistory) -> ForceLaw:
    """Tone at the line where the free force is strongest, and a little beside; a tone is a tone to the last line."""
    history = softened(history, 0.0)
    form = tone_of(history)
    record = history.located.observed.record
    spectrum = np.abs(np.fft.rfft(history.found_n * history.counted))[: record.omega.size]
    spectrum[: history.located.observed.lines.start] = 0.0
    peak, step = int(np.argmax(spectrum)), record.omega[2] / (4 * np.pi)
    middle = record.omega[peak] / (2 * np.pi)
    seen = [middle + k * step / 2 for k in range(-2, 3)]
    start = max(seen, key=lambda hz: solved(history, form, hz)[1])
    return fitted(history, form, (start - step / 2, start + step / 2))


def begun_at(history: ForceHistory, form: Form) -> "tuple[Descent, DescentState]":
    """The first numbers, by a law of which little is trusted: from the best of a grid, without slow motion."""
    soft = softened(history, TRUSTED[0])
    largest = float(np.abs(history.moved_m * (history.finely(history.counted) > 0)).max())
    low, high = (share * largest for share in form.range_share)
    parameter = 0.0
    if form.parameter:
        places = np.geomspace(low, high, GRID) if low > 0 else np.linspace(low, high, GRID)
        parameter = max((float(p) for p in places), key=lambda p: solved(soft, form, p)[1])
    at = _at(soft, form, largest, (low, high))
    state = at.descended(at.start(parameter))
    at = replace(at, history=softened(history, TRUSTED[1]))
    return at, at.descended(state)


def ended(history: ForceHistory, at: "Descent", state: "DescentState") -> "DescentState":
    """Fit from the first numbers on, the law trusted more and more."""
    for law_error in TRUSTED[2:]:
        state = replace(at, history=softened(history, law_error)).descended(state)
    return replace(at, history=history).descended(state)


@dataclass(frozen=True)
class DescentState:
    coefficients: Float[np.ndarray, " coefficients"]
    parameter: float
    knots: Float[np.ndarray, " knots"]
    law: ForceLaw


@dataclass(frozen=True)
class _ForceState:
    coefficients: Float[np.ndarray, " coefficients"]
    parameter: float
    knots: Float[np.ndarray, " knots"]
    cost: float


@dataclass(frozen=True)
class _ForceStep(Step[_ForceState]):
    covariance: Float[np.ndarray, "unknowns unknowns"]


def _settled(at: _ForceState) -> float:
    return SETTLED * abs(at.cost)


@dataclass(frozen=True)
class Descent:
    """Gauss-Newton of one form against one weighting of a time history."""

    history: ForceHistory
    form: Form
    step: float
    within: tuple[float, float]
    prior: Float[np.ndarray, "knots knots"]

    def start(self, parameter: float) -> DescentState:
        coefficients, gain, errors = solved(self.history, self.form, parameter)
        knots = np.zeros(len(self.prior))
        law = ForceLaw(
            self.form,
            tuple((-coefficients).tolist()),
            tuple(errors.tolist()),
            parameter,
            0.0,
            0.0,
            gain / self.history.free_gain,
        )
        return DescentState(coefficients, parameter, knots, law)

    def shapes(
        self, parameter: float, knots: Float[np.ndarray, " knots"], more_m: float = 0.0
    ) -> Float[np.ndarray, "coefficients fine"]:
        moved = self.history.moved_m + self.history.finely(self.history.slow @ knots) + more_m
        return np.stack(self.form.shapes(moved, self.history.rate_m_per_s, parameter))

    def value(self, force: Fine, knots: Float[np.ndarray, " knots"]) -> float:
        return self.history.gain(self.history.spectra(force)) - float(knots @ self.prior @ knots)

    def descended(self, state: DescentState) -> DescentState:
        at, last = descended(self._at(state.coefficients, state.parameter, state.knots), self._step, _settled, STEPS)
        kinds, errors = len(self.form.units), np.sqrt(np.maximum(np.diag(last.covariance), 0.0))
        law = ForceLaw(
            self.form,
            tuple((-at.coefficients).tolist()),
            tuple(errors[:kinds].tolist()),
            at.parameter,
            float(errors[kinds]) if self.form.parameter else 0.0,
            float(np.mean((self.history.slow @ at.knots)[self.history.counted > 0])),
            -at.cost / max(self.history.free_gain, 1e-300),
        )
        return DescentState(at.coefficients, at.parameter, at.knots, law)

    def _at(
        self,
        coefficients: Float[np.ndarray, " coefficients"],
        parameter: float,
        knots: Float[np.ndarray, " knots"],
    ) -> _ForceState:
        cost = -self.value(coefficients @ self.shapes(parameter, knots), knots)
        return _ForceState(coefficients, parameter, knots, cost)

    def _step(self, at: _ForceState) -> _ForceStep:
        """Step of the numbers and the slow motion; the coefficients are the best of where the others come to."""
        history, form, kinds = self.history, self.form, len(self.form.units)
        free = kinds + bool(form.parameter)
        shapes = self.shapes(at.parameter, at.knots)
        force = at.coefficients @ shapes
        fine = [*shapes]
        if form.parameter:
            fine.append((at.coefficients @ self.shapes(at.parameter + self.step, at.knots) - force) / self.step)
        tangent = (at.coefficients @ self.shapes(at.parameter, at.knots, self.step) - force) / self.step
        means = tangent.reshape(len(history.slow), -1).mean(axis=1)
        along = history.coarsely((history.slow * means[:, None]).T)
        columns = np.concatenate([history.spectra(np.stack(fine)), along, history.spectra(force)[None]])
        matrix, rest = history.reduced(columns)
        gradient, matrix = rest[:-1] - matrix[:-1, -1], matrix[:-1, :-1]
        matrix[free:, free:] += self.prior
        gradient[free:] -= self.prior @ at.knots
        size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        covariance = np.linalg.pinv(matrix / np.outer(size, size), rcond=1e-10, hermitian=True)
        covariance /= np.outer(size, size)
        change = covariance @ gradient

        def after(share: float) -> _ForceState | None:
            parameter = float(np.clip(at.parameter + share * change[kinds], *self.within)) if form.parameter else 0.0
            if form.parameter and not parameter:
                return None
            knots = at.knots + share * change[free:]
            return self._at(self.scaled(parameter, knots), parameter, knots)

        return _ForceStep(after, float(gradient @ change), covariance)

    def scaled(self, parameter: float, knots: Float[np.ndarray, " knots"]) -> Float[np.ndarray, " coefficients"]:
        """The best coefficients at a parameter and slow motion."""
        matrix, rest = self.history.reduced(self.history.spectra(self.shapes(parameter, knots)))
        size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        scaled = np.linalg.pinv(matrix / np.outer(size, size), rcond=1e-10, hermitian=True)
        return np.asarray(scaled @ (rest / size) / size)


def _at(history: ForceHistory, form: Form, largest_m: float, within: tuple[float, float]) -> Descent:
    """The slow motion lies below the corner of integration and is no larger than what is left of the motion."""
    knots = history.slow.shape[1]
    bend = np.diff(np.eye(knots), 2, axis=0) / (2 * np.pi * CORNER_HZ * KNOTS_S) ** 2
    prior = (np.eye(knots) + bend.T @ bend) / float(np.std(history.moved_m)) ** 2
    return Descent(history, form, 1e-4 * largest_m, within, prior)
