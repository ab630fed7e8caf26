"""Laws of the motion that an unmeasured force may follow, up to their numbers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from rig.model.contact_laws import penetration_m

Against = Literal["displacement", "velocity", "velocity squared", "acceleration", "time", "clearance", "none"]
Fine = Float[np.ndarray, " fine"]
Shape = Callable[[Fine, Fine, float], list[Fine]]
"""From displacement (m), velocity (m/s) and a parameter to the forces per unit of each coefficient."""

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


def creep_m_per_s(rate_m_per_s: Fine) -> float:
    return CREEP * float(np.std(rate_m_per_s)) + 1e-300


def formula(form: Form, coefficients: tuple[float, ...], parameter: float) -> str:
    """N, with w in m and v in m/s, every number with its unit."""
    shown = [f"{c:.4g} {u}" for c, u in zip(coefficients, form.units, strict=True)]
    held = f"{parameter:.4g} {form.unit}" if form.unit not in ("", "1") else f"{parameter:.3g}"
    if form.unit == "m":
        held = f"{1e3 * parameter:.4g} mm"
    return form.text.format(*shown, p=held)


FORMS: tuple[Form, ...] = (
    Form("Coulomb friction", "velocity", "{0} sign(v)", ("N",), lambda _, v, __: [np.tanh(v / creep_m_per_s(v))]),
    Form("viscous damping", "velocity", "{0} v", ("N s/m",), lambda _, v, __: [v]),
    Form("quadratic drag", "velocity squared", "{0} |v| v", ("N s^2/m^2",), lambda _, v, __: [np.abs(v) * v]),
    Form("cubic damping", "velocity", "{0} v^3", ("N s^3/m^3",), lambda _, v, __: [v**3]),
    Form("linear spring", "displacement", "{0} w", ("N/m",), lambda w, _, __: [w]),
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
        lambda w, _, __: [w, w**3],
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
        lambda w, _, p: [penetration_m(w, p, p)],
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
