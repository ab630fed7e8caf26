"""Laws by which an unmeasured force may depend on the motion at its place: their forms, and a form with its values."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.gaps.unmeasured_force.time_history import LAW_ERROR_SHARE, ForceAndMotionHistory
from identify.pages.wording import estimate_words
from rig.model.contact_laws import penetration_m
from rig.model.unmeasured_force import Against, Value

Series = Float[np.ndarray, " fine"]
LawShapes = Callable[[Series, Series, float], list[Series]]
"""Forces per unit of each coefficient, by displacement (m), velocity (m/s) and the parameter."""

CREEP_VELOCITY_SHARE = 0.01
"""Velocity over which friction changes its sign, as a share of the velocity's root mean square."""


@dataclass(frozen=True)
class ForceLawForm:
    """Form of a law: the force against the motion is the sum of coefficients times shapes.

    `parameter_name` is that of the one nonlinear parameter of the shapes, unit_forces ("" if there is none).
    `parameter_range` holds its bounds, which a form that needs_slow_motion takes in shares of the largest displacement:
    its force depends on the slow motion, which integration loses. `formula_template` has the places {0}, {1} for the
    coefficients and {p}, `phrase_template` {where} for the place. `error_shares` are standard errors relative to the
    coefficients and to the parameter, beside those of the fit: what even the true law may miss lasts.
    """

    name: str
    phrase_template: str
    argument: Against
    formula_template: str
    coefficient_units: tuple[str, ...]
    unit_forces: LawShapes
    parameter_name: str = ""
    parameter_unit: str = ""
    parameter_range: tuple[float, float] = (0.0, 0.0)
    needs_slow_motion: bool = False
    error_shares: tuple[float, float] = (LAW_ERROR_SHARE, LAW_ERROR_SHARE)

    @property
    def value_count(self) -> int:
        """Count of fitted values."""
        return len(self.coefficient_units) + bool(self.parameter_name)

    @property
    def is_tone(self) -> bool:
        return self.name == TONE


TONE = "tone"
STOP_ERROR_SHARES, SOFTENING_ERROR_SHARES = (0.08, 0.005), (LAW_ERROR_SHARE, 0.05)
"""Lasting shares of stiffness and clearance of a stop, whose corners the band of the force rounds, and of stiffness and
yield of a softening spring. Set by hand on four and three blind cases (seeds 99402 to 99414)."""


@dataclass(frozen=True)
class ForceLaw:
    """Form with fitted values: the force on the body is minus the sum of coefficients times shapes.

    coefficient_errors are standard errors. share_of_free_gain is the law's gain in -2 ln L over that of the free force.
    mean_displacement_m is the mean of the slow motion. A tone has the coefficients of cosine and sine, and its
    frequency as parameter_value.
    """

    form: ForceLawForm
    coefficients: tuple[float, ...]
    coefficient_errors: tuple[float, ...]
    parameter_value: float
    parameter_error: float
    mean_displacement_m: float
    share_of_free_gain: float

    @property
    def stated_errors(self) -> list[float]:
        """Standard errors of the coefficients with the share that lasts."""
        return np.hypot(self.coefficient_errors, np.multiply(self.form.error_shares[0], self.coefficients)).tolist()

    @property
    def stated_parameter_error(self) -> float:
        """Standard error of the parameter with the share that lasts."""
        return float(np.hypot(self.parameter_error, self.form.error_shares[1] * self.parameter_value))

    @property
    def formula(self) -> str:
        """Formula of the force against the motion, N, of w in m and v in m/s, each value with interval and unit."""
        form, scale = self.form, 1e3 if self.form.parameter_unit == "m" else 1.0
        coefficients = map(estimate_words, self.coefficients, self.stated_errors, form.coefficient_units)
        unit = "mm" if form.parameter_unit == "m" else form.parameter_unit
        parameter = estimate_words(scale * self.parameter_value, scale * self.stated_parameter_error, unit)
        return form.formula_template.format(*coefficients, p=parameter)

    @property
    def parameters(self) -> dict[str, Value]:
        form = self.form
        names = ("amplitude of cosine", "amplitude of sine") if form.is_tone else ("coefficient", "cubic")
        coefficients = zip(names, self.coefficients, self.stated_errors, form.coefficient_units, strict=False)
        values = {name: Value(value, error, unit) for name, value, error, unit in coefficients}
        if form.parameter_name:
            values[form.parameter_name] = Value(self.parameter_value, self.stated_parameter_error, form.parameter_unit)
        if form.needs_slow_motion:
            values["offset"] = Value(self.mean_displacement_m, 0.0, "m")
        return values


def friction_transition_m_per_s(velocity_m_per_s: Series) -> float:
    """Velocity over which friction changes its sign, above zero."""
    return CREEP_VELOCITY_SHARE * float(np.std(velocity_m_per_s)) + 1e-300


LAW_FORMS: tuple[ForceLawForm, ...] = (
    ForceLawForm(
        "Coulomb friction",
        "friction {where}",
        "velocity",
        "F sign(v), F = {0}",
        ("N",),
        lambda _, v, __: [np.tanh(v / friction_transition_m_per_s(v))],
    ),
    ForceLawForm(
        "viscous damping",
        "a force {where} that grows with the velocity",
        "velocity",
        "c v, c = {0}",
        ("N s/m",),
        lambda _, v, __: [v],
    ),
    ForceLawForm(
        "quadratic drag",
        "a force {where} that grows with the square of the velocity",
        "velocity squared",
        "c |v| v, c = {0}",
        ("N s^2/m^2",),
        lambda _, v, __: [np.abs(v) * v],
    ),
    ForceLawForm(
        "cubic damping",
        "a force {where} that grows with the cube of the velocity",
        "velocity",
        "c v^3, c = {0}",
        ("N s^3/m^3",),
        lambda _, v, __: [v**3],
    ),
    ForceLawForm("linear spring", "a spring {where}", "displacement", "k w, k = {0}", ("N/m",), lambda w, _, __: [w]),
    ForceLawForm(
        "power of the velocity",
        "a force {where} that grows with a power of the velocity",
        "velocity",
        "c |v|^p sign(v), c = {0}, p = {p}",
        ("N (s/m)^p",),
        lambda _, v, p: [np.abs(v) ** p * np.sign(v)],
        "p",
        "1",
        (0.2, 4.0),
    ),
    ForceLawForm(
        "cubic spring",
        "a spring {where} whose stiffness changes with the displacement",
        "displacement",
        "k w + k3 w^3, k = {0}, k3 = {1}",
        ("N/m", "N/m^3"),
        lambda w, _, __: [w, w**3],
        needs_slow_motion=True,
    ),
    ForceLawForm(
        "softening spring",
        "a softening spring {where}",
        "displacement",
        "k w0 tanh(w / w0), k = {0}, w0 = {p}",
        ("N/m",),
        lambda w, _, p: [p * np.tanh(w / p)],
        "w0",
        "m",
        (0.01, 1.5),
        needs_slow_motion=True,
        error_shares=SOFTENING_ERROR_SHARES,
    ),
    ForceLawForm(
        "stop",
        "a stop {where}",
        "clearance",
        "k (|w| - d) sign(w) beyond d, k = {0}, d = {p}",
        ("N/m",),
        lambda w, _, p: [penetration_m(w, p, p)],
        "d",
        "m",
        (0.02, 0.95),
        needs_slow_motion=True,
        error_shares=STOP_ERROR_SHARES,
    ),
    ForceLawForm(
        "stop on one side",
        "a stop on one side {where}",
        "clearance",
        "k (w - d) beyond d, k = {0}, d = {p}",
        ("N/m",),
        lambda w, _, p: [np.maximum(w - p, 0.0) if p > 0 else np.minimum(w - p, 0.0)],
        "d",
        "m",
        (-0.9, 0.9),
        needs_slow_motion=True,
        error_shares=STOP_ERROR_SHARES,
    ),
)


def tone_form(history: ForceAndMotionHistory) -> ForceLawForm:
    """Form of a harmonic force of time, with its frequency f (Hz) as the parameter."""

    def unit_forces(_: Series, __: Series, frequency_hz: float) -> list[Series]:
        phase_rad = 2 * np.pi * frequency_hz * history.fine_times_s
        return [np.cos(phase_rad), np.sin(phase_rad)]

    formula_template = "A cos(2 pi f t) + B sin(2 pi f t), A = {0}, B = {1}, f = {p}"
    return ForceLawForm(TONE, "", "time", formula_template, ("N", "N"), unit_forces, "f", "Hz", error_shares=(0.0, 0.0))
