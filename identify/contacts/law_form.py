"""Parameters and forms of a contact's law: the dead zone, a power of the depth, a stop that cannot pull.

All forms have the parameters of `LAW`; a power law has its exponent behind them. With the penetration `depth` beyond a
stop and its reference depth d,

    f = k depth |depth / d|^(p - 1) + c rate min(1, |depth| / 10 um)

where p = 1 except for a power law; a stop that cannot pull has f = 0 where f depth < 0. A spring has no clearance, and
its damping acts always, f = k eta + c rate. It may stand alone or beside stops between the same places.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from rig.model.contact_laws import ContactLaw, DeadZone
from rig.model.parameters import Parameter, ParameterSet

LAW = ParameterSet(
    (
        Parameter("m", 0.0, np.inf, name="lower_clearance_m"),
        Parameter("m", 0.0, np.inf, name="upper_clearance_m"),
        Parameter("N/m", 0.0, np.inf, name="stiffness_n_per_m"),
        Parameter("N s/m", -np.inf, np.inf, name="damping_n_s_per_m"),
    )
)
"""Estimated parameters of a `DeadZone`; its damping may have either sign."""
STIFFNESS = LAW.vector({"stiffness_n_per_m": 1.0})
"""Stiffness as a linear function of the parameters."""
DAMPING = LAW.vector({"damping_n_s_per_m": 1.0})
OFFSET = LAW.vector({"lower_clearance_m": -0.5, "upper_clearance_m": 0.5})
"""Distance of the middle of the play from zero, m."""

ABSENT_STOP_M = 1e6
"""Clearance that stands for a stop that is not there, out of every motion's reach: sums over the parameters are
finite."""

Touched = Bool[np.ndarray, "contacts 2"]
"""Contacts x (lower, upper): True where the record determines that stop."""
LawParameters = Float[np.ndarray, " laws"]
"""Values of the parameters of `LAW`, contact by contact."""
NominalLaws = Float[np.ndarray, "contacts 4"]
"""Values of the parameters of `LAW` in rig.json."""

FormName = Literal["dead zone", "power law", "cannot pull", "spring", "annular"]
EXPONENTS = (1.0, 3.0)
"""Range of the exponent of a `DeadZone`."""

Signal = Float[np.ndarray, "*samples"]


def law_numbers(law: ContactLaw) -> Float[np.ndarray, " 4"]:
    """Parameters of `LAW` of a law, with `ABSENT_STOP_M` for the clearance where there is no stop."""
    return np.minimum([getattr(law, name) for name in LAW.names], [ABSENT_STOP_M, ABSENT_STOP_M, np.inf, np.inf])


@dataclass(frozen=True)
class LawForm:
    """Form of a law. At the reference depth a power law has the force of a linear stop of the same stiffness.

    springs are the numbers of those contacts that have no stops.
    """

    name: FormName = "dead zone"
    reference_depth_m: float = 1e-4
    springs: tuple[int, ...] = ()

    @property
    def shapes(self) -> int:
        """Number of further parameters behind those of `LAW`: 1 for a power law, else 0."""
        return int(self.name == "power law")

    def contacts(self, law_parameters: LawParameters) -> Float[np.ndarray, "contacts 4"]:
        """Parameters of `LAW` by contact."""
        return law_parameters[: law_parameters.size - self.shapes].reshape(-1, len(LAW))

    def exponent(self, law_parameters: LawParameters) -> float:
        return float(law_parameters[-1]) if self.shapes else 1.0

    def is_possible(self, law_parameters: LawParameters) -> bool:
        """True if every parameter lies in its range and each stiffness is positive."""
        contacts, (lowest, highest) = self.contacts(law_parameters), EXPONENTS
        within_bounds = np.all(contacts >= LAW.bounds[0]) and np.all(contacts[:, 2] > 0)
        return bool(within_bounds and lowest <= self.exponent(law_parameters) <= highest)

    def force_n(self, law_parameters: LawParameters, eta_m: Signal, rate_m_per_s: Signal) -> Signal:
        """Contact force, N: sum over the contacts of stiffness and damping times the forces of a `DeadZone` with one
        each."""
        force = np.zeros_like(eta_m)
        for contribution in self._contributions(law_parameters, eta_m, rate_m_per_s):
            force += contribution.force_n
        return force

    def slopes(self, law_parameters: LawParameters, eta_m: Signal, rate_m_per_s: Signal) -> tuple[Signal, Signal]:
        """Derivatives of the force by displacement (N/m) and by velocity (N s/m)."""
        by_stiffness, by_damping = np.zeros_like(eta_m), np.zeros_like(eta_m)
        for contribution in self._contributions(law_parameters, eta_m, rate_m_per_s):
            by_stiffness += contribution.slope_n_per_m
            by_damping += contribution.damping_n_s_per_m * contribution.closed
        return by_stiffness, by_damping

    def derivatives(self, law_parameters: LawParameters, eta_m: Signal, rate_m_per_s: Signal) -> list[Signal]:
        """Derivatives of the force by every parameter of the law."""
        rows, by_exponent = [], np.zeros_like(eta_m)
        for contribution in self._contributions(law_parameters, eta_m, rate_m_per_s):
            lower = contribution.slope_n_per_m * (contribution.depth_m < 0)
            rows += [
                lower,
                lower - contribution.slope_n_per_m,
                contribution.spring_m * contribution.closed,
                contribution.damper * contribution.closed,
            ]
            if self.shapes:
                share = np.maximum(np.abs(contribution.depth_m) / self.reference_depth_m, 1e-9)
                by_exponent += contribution.stiffness_n_per_m * contribution.spring_m * np.log(share)
        return [*rows, by_exponent] if self.shapes else rows

    def _contributions(
        self, law_parameters: LawParameters, eta_m: Signal, rate_m_per_s: Signal
    ) -> "list[_Contribution]":
        exponent = self.exponent(law_parameters)
        return [
            self._contribution(row, exponent, eta_m, rate_m_per_s, number in self.springs)
            for number, row in enumerate(self.contacts(law_parameters))
        ]

    def _contribution(
        self, contact_parameters: LawParameters, exponent: float, eta_m: Signal, rate_m_per_s: Signal, is_spring: bool
    ) -> "_Contribution":
        lower, upper, stiffness, damping = contact_parameters.tolist()
        spring, damper = (
            DeadZone(
                lower_clearance_m=lower,
                upper_clearance_m=upper,
                stiffness_n_per_m=k,
                damping_n_s_per_m=c,
                exponent=exponent,
                reference_depth_m=self.reference_depth_m,
            )
            for k, c in ((1.0, 0.0), (0.0, 1.0))
        )
        depth, by_eta = spring.penetration_m(eta_m), spring.by_eta_n_per_m(eta_m)
        shape, drag = spring.force_n(eta_m), damper.force_n(eta_m, rate_m_per_s)
        closed = depth != 0
        if is_spring:
            drag, closed = rate_m_per_s, np.ones_like(closed)
        if self.name == "cannot pull":
            closed = (stiffness * shape + damping * drag) * depth > 0
        return _Contribution(depth, shape, drag, stiffness, damping, stiffness * by_eta * closed, closed)


@dataclass(frozen=True)
class _Contribution:
    """Force of one contact: depth, forces of unit stiffness and of unit damping, derivative by the displacement."""

    depth_m: Signal
    spring_m: Signal
    damper: Signal
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    slope_n_per_m: Signal
    closed: Bool[np.ndarray, "*samples"]

    @property
    def force_n(self) -> Signal:
        force = self.stiffness_n_per_m * self.spring_m + self.damping_n_s_per_m * self.damper
        return np.asarray(force * self.closed)


DEAD_ZONE, SPRING = LawForm(), LawForm("spring", springs=(0,))


def linear_form(touched: Touched) -> LawForm:
    """Dead zones, and a spring where neither side is touched."""
    springs = tuple(np.flatnonzero(~touched.any(axis=1)).tolist())
    return LawForm("spring" if len(springs) == len(touched) else "dead zone", springs=springs)


def by_stiffness_and_damping(
    form: LawForm, law_parameters: LawParameters, eta_m: Signal, rate_m_per_s: Signal
) -> list[Signal]:
    """Forces of unit stiffness and of unit damping of every contact, for their motion."""
    contributions = form._contributions(law_parameters, eta_m, rate_m_per_s)
    return [row for contribution in contributions for row in (contribution.spring_m, contribution.damper)]
