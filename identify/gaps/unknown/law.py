"""A law with its numbers, and those that need no slow motion fitted to the time history of an unmeasured force."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar

from identify.gaps.unknown.forms import Fine, Form, formula
from identify.gaps.unknown.time_history import ForceHistory


@dataclass(frozen=True)
class ForceLaw:
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


def tone_of(history: ForceHistory) -> Form:
    def shapes(_: Fine, __: Fine, hz: float) -> list[Fine]:
        phase = 2 * np.pi * hz * history.fine_s
        return [np.cos(phase), np.sin(phase)]

    return Form("tone", "time", "{0} cos(2 pi f t) + {1} sin(2 pi f t), f = {p}", ("N", "N"), shapes, "f", "Hz")


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
