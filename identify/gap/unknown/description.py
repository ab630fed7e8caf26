"""What law an unmeasured force follows: its course in time regressed on laws of the motion at its place."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Complex, Float
from scipy.optimize import minimize_scalar

from identify.gap.unknown.course import KNOTS_S, Course, softened
from identify.kinematics import CORNER_HZ
from rig.contact import dead_zone

Against = Literal["displacement", "velocity", "velocity squared", "acceleration", "time", "clearance", "none"]
Fine = Float[np.ndarray, " fine"]
Shape = Callable[[Fine, Fine, float], list[Fine]]
"""From displacement (m), velocity (m/s) and a parameter to the forces per unit of each coefficient."""

AS_GOOD = 0.02
"""A law keeps enough if no other keeps more of the free force's gain by more than this."""
STEPS = 8
GRID, HALVINGS = 14, 5
TRUSTED = (1.0, 0.3, 0.1)
"""A law is first trusted to this share of the force: far from its numbers, details mislead."""
SETTLED = 1e-4
CREEP = 0.01
"""Friction changes its sign over this share of the velocity's root mean square."""


@dataclass(frozen=True)
class Form:
    """A law up to its numbers: the force against the motion is the sum of coefficients times shapes.

    `parameter` names what the shapes depend on beside (none: ""), within `range_share` of the largest motion; `slow`
    says that it needs the slow motion that integration loses. The text holds {0}, {1} for the coefficients and {p}.
    """

    name: str
    against: Against
    text: str
    units: tuple[str, ...]
    shapes: Shape
    parameter: str = ""
    unit: str = ""
    range_share: tuple[float, float] = (0.0, 0.0)
    slow: bool = False

    @property
    def length(self) -> int:
        return len(self.units) + bool(self.parameter)


FORMS: tuple[Form, ...] = (
    Form("Coulomb friction", "velocity", "{0} sign(v)", ("N",), lambda _, v, p: [np.tanh(v / _creep(v))]),
    Form("viscous damping", "velocity", "{0} v", ("N s/m",), lambda _, v, p: [v]),
    Form("quadratic drag", "velocity squared", "{0} |v| v", ("N s^2/m^2",), lambda _, v, p: [np.abs(v) * v]),
    Form("cubic damping", "velocity", "{0} v^3", ("N s^3/m^3",), lambda _, v, p: [v**3]),
    Form("linear spring", "displacement", "{0} w", ("N/m",), lambda w, _, p: [w]),
    Form(
        "power of the velocity",
        "velocity",
        "{0} |v|^{p} sign(v)",
        ("N (s/m)^p",),
        lambda _, v, p: [np.abs(v) ** p * np.sign(v)],
        "p",
        "1",
        (0.2, 4.0),
    ),
    Form(
        "cubic spring",
        "displacement",
        "{0} w + {1} w^3",
        ("N/m", "N/m^3"),
        lambda w, _, p: [w, w**3],
        slow=True,
    ),
    Form(
        "softening spring",
        "displacement",
        "{0} w0 tanh(w / w0), w0 = {p}",
        ("N/m",),
        lambda w, _, p: [p * np.tanh(w / p)],
        "w0",
        "m",
        (0.01, 1.5),
        slow=True,
    ),
    Form(
        "stop",
        "clearance",
        "{0} (|w| - d) sign(w) beyond d = {p}",
        ("N/m",),
        lambda w, _, p: [dead_zone(w, p, p)],
        "d",
        "m",
        (0.02, 0.95),
        slow=True,
    ),
    Form(
        "stop on one side",
        "clearance",
        "{0} (w - d) beyond d = {p}",
        ("N/m",),
        lambda w, _, p: [np.maximum(w - p, 0.0) if p > 0 else np.minimum(w - p, 0.0)],
        "d",
        "m",
        (-0.9, 0.9),
        slow=True,
    ),
)


@dataclass(frozen=True)
class Law:
    """A form with its numbers: the force on the body is minus the coefficients times the shapes.

    share is how much of the free force's gain in -2 ln L it keeps. offset_m is the mean of the slow motion, spread_m
    its standard deviation. A tone has the coefficients of cosine and sine, and its frequency as the parameter.
    """

    form: Form
    coefficients: tuple[float, ...]
    errors: tuple[float, ...]
    parameter: float
    parameter_error: float
    offset_m: float
    share: float

    @property
    def text(self) -> str:
        """The force against the motion."""
        return formula(self.form, self.coefficients, self.parameter)


def formula(form: Form, coefficients: tuple[float, ...], parameter: float) -> str:
    """N, with w in m and v in m/s, every number with its unit."""
    shown = [f"{c:.4g} {u}" for c, u in zip(coefficients, form.units, strict=True)]
    held = f"{parameter:.4g} {form.unit}" if form.unit not in ("", "1") else f"{parameter:.3g}"
    if form.unit == "m":
        held = f"{1e3 * parameter:.4g} mm"
    return form.text.format(*shown, p=held)


def _tone(course: Course) -> Form:
    def shapes(w: Fine, _: Fine, hz: float) -> list[Fine]:
        phase = 2 * np.pi * hz * course.fine_s
        return [np.cos(phase), np.sin(phase)]

    return Form("tone", "time", "{0} cos(2 pi f t) + {1} sin(2 pi f t), f = {p}", ("N", "N"), shapes, "f", "Hz")


def laws(course: Course) -> tuple[Law, ...]:
    """Every law with its best numbers, those that keep most first; the slow ones only if no quick one serves."""
    quick = [_toned(course), *(_fitted(course, form) for form in FORMS if not form.slow)]
    if max(law.share for law in quick) < 1 - AS_GOOD:
        quick += [_with_slow(course, form) for form in FORMS if form.slow]
    return tuple(sorted(quick, key=lambda law: -law.share))


def shortest(found: tuple[Law, ...], least: float) -> Law | None:
    """The shortest law that keeps about as much as the best, if that is at least this share of the free force's."""
    enough = [law for law in found if law.share >= found[0].share - AS_GOOD]
    best = min(enough, key=lambda law: (law.form.length, -law.share))
    return best if best.share >= least else None


def _toned(course: Course) -> Law:
    """At the line where the free force is strongest, and a little beside."""
    form = _tone(course)
    record = course.located.observed.record
    spectrum = np.abs(np.fft.rfft(course.found_n * course.counted))[: record.omega.size]
    spectrum[: course.located.observed.lines.start] = 0.0
    peak, step = int(np.argmax(spectrum)), record.omega[2] / (4 * np.pi)
    middle = record.omega[peak] / (2 * np.pi)
    seen = [middle + k * step / 2 for k in range(-2, 3)]
    start = max(seen, key=lambda hz: _solved(course, form, hz)[1])
    return _fitted(course, form, (start - step / 2, start + step / 2))


def _fitted(course: Course, form: Form, within: tuple[float, float] | None = None) -> Law:
    """Coefficients by least squares, the parameter by bounded minimisation."""
    low, high = within or form.range_share
    parameter, error = 0.0, 0.0
    if form.parameter:
        found = minimize_scalar(lambda p: -_solved(course, form, p)[1], bounds=(low, high), method="bounded")
        parameter = float(found.x)
        step = 1e-3 * (high - low)
        beside = [_solved(course, form, parameter + k * step)[1] for k in (-1, 0, 1)]
        curved = (2 * beside[1] - beside[0] - beside[2]) / step**2
        error = float(np.sqrt(2 / curved)) if curved > 0 else float("inf")
    coefficients, gain, errors = _solved(course, form, parameter)
    return Law(
        form,
        tuple(-coefficients),
        tuple(errors),
        parameter,
        error,
        0.0,
        gain / max(course.free_gain, 1e-300),
    )


def _columns(
    course: Course, form: Form, parameter: float, slow_m: Fine | float = 0.0
) -> Complex[np.ndarray, "_ lines"]:
    shapes = form.shapes(course.moved_m + slow_m, course.rate_m_per_s, parameter)
    return course.spectra(np.stack(shapes))


def _solved(
    course: Course, form: Form, parameter: float
) -> tuple[Float[np.ndarray, " coefficients"], float, Float[np.ndarray, " coefficients"]]:
    """Coefficients of the force on the body, what they gain, and their standard errors."""
    matrix, rest = course.reduced(_columns(course, form, parameter))
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix / np.outer(size, size)
    inverse = np.linalg.pinv(scaled, rcond=1e-10, hermitian=True)
    found = inverse @ (rest / size)
    return found / size, float(found @ (rest / size)), np.sqrt(np.maximum(np.diag(inverse), 0.0)) / size


def _with_slow(course: Course, form: Form) -> Law:
    """By Gauss-Newton: coefficients, parameter, and the slow motion in cubic splines with a prior.

    It begins at the best of a grid of the parameter without slow motion, and trusts the law more and more.
    """
    largest = float(np.abs(course.moved_m * (course.finely(course.counted) > 0)).max())
    low, high = (share * largest for share in form.range_share)
    parameter = 0.0
    if form.parameter:
        soft = softened(course, TRUSTED[0])
        places = np.geomspace(low, high, GRID) if low > 0 else np.linspace(low, high, GRID)
        parameter = max((float(p) for p in places), key=lambda p: _solved(soft, form, p)[1])
    at = _at(softened(course, TRUSTED[0]), form, largest, (low, high))
    state = at.start(parameter)
    for law_error in TRUSTED:
        at = replace(at, course=softened(course, law_error))
        state = at.descended(state)
    state = replace(at, course=course).descended(state)
    return state.law


@dataclass(frozen=True)
class _State:
    coefficients: Float[np.ndarray, " coefficients"]
    parameter: float
    knots: Float[np.ndarray, " knots"]
    law: Law


@dataclass(frozen=True)
class _Descent:
    """Gauss-Newton of one form against one weighting of a course."""

    course: Course
    form: Form
    step: float
    within: tuple[float, float]
    prior: Float[np.ndarray, "knots knots"]

    def start(self, parameter: float) -> _State:
        coefficients, gain, errors = _solved(self.course, self.form, parameter)
        knots = np.zeros(len(self.prior))
        law = Law(self.form, tuple(-coefficients), tuple(errors), parameter, 0.0, 0.0, gain / self.course.free_gain)
        return _State(coefficients, parameter, knots, law)

    def shapes(self, parameter: float, knots: Float[np.ndarray, " knots"], more_m: float = 0.0) -> Fine:
        moved = self.course.moved_m + self.course.finely(self.course.slow @ knots) + more_m
        return np.stack(self.form.shapes(moved, self.course.rate_m_per_s, parameter))

    def value(self, force: Fine, knots: Float[np.ndarray, " knots"]) -> float:
        return self.course.gain(self.course.spectra(force)) - float(knots @ self.prior @ knots)

    def descended(self, state: _State) -> _State:
        course, form, kinds = self.course, self.form, len(self.form.units)
        coefficients, parameter, knots = state.coefficients, state.parameter, state.knots
        free = kinds + bool(form.parameter)
        for _ in range(STEPS):
            shapes = self.shapes(parameter, knots)
            force = coefficients @ shapes
            held = self.value(force, knots)
            fine = [*shapes]
            if form.parameter:
                fine.append((coefficients @ self.shapes(parameter + self.step, knots) - force) / self.step)
            tangent = (coefficients @ self.shapes(parameter, knots, self.step) - force) / self.step
            means = tangent.reshape(len(course.slow), -1).mean(axis=1)
            along = course.coarsely((course.slow * means[:, None]).T)
            columns = np.concatenate([course.spectra(np.stack(fine)), along, course.spectra(force)[None]])
            matrix, rest = course.reduced(columns)
            gradient, matrix = rest[:-1] - matrix[:-1, -1], matrix[:-1, :-1]
            matrix[free:, free:] += self.prior
            gradient[free:] -= self.prior @ knots
            size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
            covariance = np.linalg.pinv(matrix / np.outer(size, size), rcond=1e-10, hermitian=True)
            covariance /= np.outer(size, size)
            change = covariance @ gradient
            better = held
            for halving in range(HALVINGS):
                part = change / 2**halving
                there = float(np.clip(parameter + part[kinds], *self.within)) if form.parameter else 0.0
                bent = knots + part[free:]
                if form.parameter and not there:
                    continue
                own, _ = self.scaled(there, bent)
                better = self.value(own @ self.shapes(there, bent), bent)
                if better > held:
                    coefficients, parameter, knots = own, there, bent
                    break
            if better - held < SETTLED * abs(held):
                break
        errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        inside = course.counted > 0
        law = Law(
            form,
            tuple(-coefficients),
            tuple(errors[:kinds]),
            parameter,
            float(errors[kinds]) if form.parameter else 0.0,
            float(np.mean((course.slow @ knots)[inside])),
            max(better, held) / max(course.free_gain, 1e-300),
        )
        return _State(coefficients, parameter, knots, law)

    def scaled(
        self, parameter: float, knots: Float[np.ndarray, " knots"]
    ) -> tuple[Float[np.ndarray, " coefficients"], Float[np.ndarray, "coefficients coefficients"]]:
        """The best coefficients at a parameter and slow motion."""
        matrix, rest = self.course.reduced(self.course.spectra(self.shapes(parameter, knots)))
        size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        inverse = np.linalg.pinv(matrix / np.outer(size, size), rcond=1e-10, hermitian=True) / np.outer(size, size)
        return inverse @ rest, inverse


def _at(course: Course, form: Form, largest_m: float, within: tuple[float, float]) -> _Descent:
    """The slow motion lies below the corner of integration and is no larger than what is left of the motion."""
    knots = course.slow.shape[1]
    bend = np.diff(np.eye(knots), 2, axis=0) / (2 * np.pi * CORNER_HZ * KNOTS_S) ** 2
    prior = (np.eye(knots) + bend.T @ bend) / float(np.std(course.moved_m)) ** 2
    return _Descent(course, form, 1e-4 * largest_m, within, prior)


def _creep(rate: Fine) -> float:
    return CREEP * float(np.std(rate)) + 1e-300
