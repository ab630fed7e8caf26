"""Laws of the motion at its place that an unmeasured force may follow, and such a law fitted to its time history."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar

from identify.gaps.unmeasured_force.time_history import ForceHistory
from rig.model.contact_laws import penetration_m
from rig.model.unmeasured_force import Against, Value

Fine = Float[np.ndarray, " fine"]
Shape = Callable[[Fine, Fine, float], list[Fine]]
"""From displacement (m), velocity (m/s) and a parameter to the forces per unit of each coefficient."""

CREEP = 0.01
"""Friction changes its sign over this share of the velocity's root mean square."""


@dataclass(frozen=True)
class Form:
    """A law up to its numbers: the force against the motion is the sum of coefficients times shapes.

    `parameter` names what the shapes depend on beside (none: ""), within `range_share` of the largest motion; `slow`
    says that it needs the slow motion that integration loses. The text holds {0}, {1} for the coefficients and {p},
    the words {where} for the place.
    """

    name: str
    words: str
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

    @property
    def is_tone(self) -> bool:
        return self.name == TONE


TONE = "tone"


@dataclass(frozen=True)
class ForceLaw:
    """A form with its numbers: the force on the body is minus the coefficients times the shapes.

    share is how much of the free force's gain in -2 ln L it keeps. offset_m is the mean of the slow motion. A tone has
    the coefficients of cosine and sine, and its frequency as the parameter.
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
        """The force against the motion, N, with w in m and v in m/s, every number with its unit."""
        form = self.form
        shown = [f"{c:.4g} {u}" for c, u in zip(self.coefficients, form.units, strict=True)]
        held = f"{self.parameter:.4g} {form.unit}" if form.unit not in ("", "1") else f"{self.parameter:.3g}"
        if form.unit == "m":
            held = f"{1e3 * self.parameter:.4g} mm"
        return form.text.format(*shown, p=held)

    @property
    def parameters(self) -> dict[str, Value]:
        names = ("amplitude of cosine", "amplitude of sine") if self.form.is_tone else ("coefficient", "cubic")
        found = {
            name: Value(value, error, unit)
            for name, value, error, unit in zip(names, self.coefficients, self.errors, self.form.units, strict=False)
        }
        if self.form.parameter:
            found[self.form.parameter] = Value(self.parameter, self.parameter_error, self.form.unit)
        if self.form.slow:
            found["offset"] = Value(self.offset_m, 0.0, "m")
        return found


def creep_m_per_s(rate_m_per_s: Fine) -> float:
    return CREEP * float(np.std(rate_m_per_s)) + 1e-300


FORMS: tuple[Form, ...] = (
    Form(
        "Coulomb friction",
        "friction {where}",
        "velocity",
        "{0} sign(v)",
        ("N",),
        lambda _, v, __: [np.tanh(v / creep_m_per_s(v))],
    ),
    Form(
        "viscous damping",
        "a force {where} that grows with the velocity",
        "velocity",
        "{0} v",
        ("N s/m",),
        lambda _, v, __: [v],
    ),
    Form(
        "quadratic drag",
        "a force {where} that grows with the square of the velocity",
        "velocity squared",
        "{0} |v| v",
        ("N s^2/m^2",),
        lambda _, v, __: [np.abs(v) * v],
    ),
    Form(
        "cubic damping",
        "a force {where} that grows with the cube of the velocity",
        "velocity",
        "{0} v^3",
        ("N s^3/m^3",),
        lambda _, v, __: [v**3],
    ),
    Form("linear spring", "a spring {where}", "displacement", "{0} w", ("N/m",), lambda w, _, __: [w]),
    Form(
        "power of the velocity",
        "a force {where} that grows with a power of the velocity",
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
        "a spring {where} whose stiffness changes with the displacement",
        "displacement",
        "{0} w + {1} w^3",
        ("N/m", "N/m^3"),
        lambda w, _, __: [w, w**3],
        slow=True,
    ),
    Form(
        "softening spring",
        "a softening spring {where}",
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
        "a stop {where}",
        "clearance",
        "{0} (|w| - d) sign(w) beyond d = {p}",
        ("N/m",),
        lambda w, _, p: [penetration_m(w, p, p)],
        "d",
        "m",
        (0.02, 0.95),
        slow=True,
    ),
    Form(
        "stop on one side",
        "a stop on one side {where}",
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


def tone_of(history: ForceHistory) -> Form:
    def shapes(_: Fine, __: Fine, hz: float) -> list[Fine]:
        phase = 2 * np.pi * hz * history.fine_s
        return [np.cos(phase), np.sin(phase)]

    text = "{0} cos(2 pi f t) + {1} sin(2 pi f t), f = {p}"
    return Form(TONE, "", "time", text, ("N", "N"), shapes, "f", "Hz")


def fitted(history: ForceHistory, form: Form, within: tuple[float, float] | None = None) -> ForceLaw:
    """Coefficients by least squares, the parameter by bounded minimisation."""
    low, high = within or form.range_share
    parameter, error = 0.0, 0.0
    if form.parameter and low == high:
        parameter = low
    elif form.parameter:
        found = minimize_scalar(lambda p: -solved(history, form, p)[1], bounds=(low, high), method="bounded")
        parameter = float(found.x)
        step = 1e-3 * (high - low)
        beside = [solved(history, form, parameter + k * step)[1] for k in (-1, 0, 1)]
        curved = (2 * beside[1] - beside[0] - beside[2]) / step**2
        error = float(np.sqrt(2 / curved)) if curved > 0 else float("inf")
    coefficients, gain, errors = solved(history, form, parameter)
    return ForceLaw(
        form,
        tuple((-coefficients).tolist()),
        tuple(errors.tolist()),
        parameter,
        error,
        0.0,
        gain / max(history.free_gain, 1e-300),
    )


def solved(
    history: ForceHistory, form: Form, parameter: float
) -> tuple[Float[np.ndarray, " coefficients"], float, Float[np.ndarray, " coefficients"]]:
    """Coefficients of the force on the body, what they gain, and their standard errors."""
    shapes = np.stack(form.shapes(history.moved_m, history.rate_m_per_s, parameter))
    matrix, rest = history.reduced(history.spectra(shapes))
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix / np.outer(size, size)
    inverse = np.linalg.pinv(scaled, rcond=1e-10, hermitian=True)
    found = inverse @ (rest / size)
    return found / size, float(found @ (rest / size)), np.sqrt(np.maximum(np.diag(inverse), 0.0)) / size
