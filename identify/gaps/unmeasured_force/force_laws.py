"""Laws by which an unmeasured force may depend on the motion at its place: their forms, and a form with its values."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.gaps.unmeasured_force.time_history import ForceHistory
from rig.model.contact_laws import penetration_m
from rig.model.unmeasured_force import Against, Value

Series = Float[np.ndarray, " fine"]
Shape = Callable[[Series, Series, float], list[Series]]
"""Forces per unit of each coefficient, by displacement (m), velocity (m/s) and the parameter."""

CREEP = 0.01
"""Velocity over which friction changes its sign, as a share of the velocity's root mean square."""


@dataclass(frozen=True)
class Form:
    """Form of a law: the force against the motion is the sum of coefficients times shapes.

    `parameter` is the name of the one nonlinear parameter of the shapes ("" if there is none). `range_share` holds its
    bounds, which a `slow` form takes in shares of the largest displacement: its force depends on the slow motion, which
    integration loses. `text` has the places {0}, {1} for the coefficients and {p}, `words` {where} for the place.
    """

    name: str
    words: str
    against: Against
    text: str
    coefficient_units: tuple[str, ...]
    shapes: Shape
    parameter: str = ""
    unit: str = ""
    range_share: tuple[float, float] = (0.0, 0.0)
    slow: bool = False

    @property
    def length(self) -> int:
        """Count of fitted values."""
        return len(self.coefficient_units) + bool(self.parameter)

    @property
    def is_tone(self) -> bool:
        return self.name == TONE


TONE = "tone"


@dataclass(frozen=True)
class ForceLaw:
    """Form with fitted values: the force on the body is minus the sum of coefficients times shapes.

    errors are standard errors of the coefficients. share is the law's gain in -2 ln L over that of the free force.
    offset_m is the mean of the slow motion. A tone has the coefficients of cosine and sine, and its frequency as the
    parameter.
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
        """Formula of the force against the motion, N, of w in m and v in m/s, each value with its unit."""
        form = self.form
        terms = [f"{c:.4g} {u}" for c, u in zip(self.coefficients, form.coefficient_units, strict=True)]
        parameter_text = f"{self.parameter:.4g} {form.unit}" if form.unit not in ("", "1") else f"{self.parameter:.3g}"
        if form.unit == "m":
            parameter_text = f"{1e3 * self.parameter:.4g} mm"
        return form.text.format(*terms, p=parameter_text)

    @property
    def parameters(self) -> dict[str, Value]:
        names = ("amplitude of cosine", "amplitude of sine") if self.form.is_tone else ("coefficient", "cubic")
        values = {
            name: Value(value, error, unit)
            for name, value, error, unit in zip(
                names, self.coefficients, self.errors, self.form.coefficient_units, strict=False
            )
        }
        if self.form.parameter:
            values[self.form.parameter] = Value(self.parameter, self.parameter_error, self.form.unit)
        if self.form.slow:
            values["offset"] = Value(self.offset_m, 0.0, "m")
        return values


def creep_m_per_s(velocity_m_per_s: Series) -> float:
    """Velocity over which friction changes its sign, above zero."""
    return CREEP * float(np.std(velocity_m_per_s)) + 1e-300


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
        "k w0 tanh(w / w0), k = {0}, w0 = {p}",
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


def tone_form(history: ForceHistory) -> Form:
    """Form of a harmonic force of time, with its frequency f (Hz) as the parameter."""

    def shapes(_: Series, __: Series, hz: float) -> list[Series]:
        phase = 2 * np.pi * hz * history.fine_s
        return [np.cos(phase), np.sin(phase)]

    text = "{0} cos(2 pi f t) + {1} sin(2 pi f t), f = {p}"
    return Form(TONE, "", "time", text, ("N", "N"), shapes, "f", "Hz")
