"""Parameters and forms of a contact's law: the dead zone, a power of the depth, a stop that cannot pull.

All forms have the parameters of `LAW`; a power law has its exponent behind them. With the penetration `depth` beyond a
stop and its reference depth d,

    f = k depth |depth / d|^(p - 1) + c rate ((1 - o) min(1, |depth| / 10 um) + o)

where the onset o of the damping is 0 in rig.json and 1 of a damper that acts at once, p = 1 except for a power law, and
a stop that cannot pull has f = 0 where f depth < 0. A spring has no clearance, and its damping acts always,
f = k eta + c rate. It may stand alone or beside stops between the same places.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from msgspec.structs import replace

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
STIFFNESS_GRADIENT = LAW.vector({"stiffness_n_per_m": 1.0})
"""Stiffness as a linear function of the parameters."""
DAMPING_GRADIENT = LAW.vector({"damping_n_s_per_m": 1.0})
OFFSET_GRADIENT = LAW.vector({"lower_clearance_m": -0.5, "upper_clearance_m": 0.5})
"""Distance of the middle of the play from zero, m."""

ABSENT_STOP_M = 1e6
"""Clearance that stands for a stop that is not there, out of every motion's reach: sums over the parameters are
finite."""

TouchedStops = Bool[np.ndarray, "contacts 2"]
"""Contacts x (lower, upper): True where the record determines that stop."""
LawParameters = Float[np.ndarray, " laws"]
"""Values of the parameters of `LAW`, contact by contact."""
NominalLaws = Float[np.ndarray, "contacts 4"]
"""Values of the parameters of `LAW` in rig.json."""

FormName = Literal["dead zone", "power law", "cannot pull", "spring", "annular"]
EXPONENT_RANGE = (1.0, 3.0)
"""Range of the exponent of a `DeadZone`."""

Signal = Float[np.ndarray, "*samples"]


def parameters_of_law(law: ContactLaw) -> Float[np.ndarray, " 4"]:
    """Parameters of `LAW` of a law, with `ABSENT_STOP_M` for the clearance where there is no stop."""
    return np.minimum([getattr(law, name) for name in LAW.names], [ABSENT_STOP_M, ABSENT_STOP_M, np.inf, np.inf])


@dataclass(frozen=True)
class LawForm:
    """Form of a law. At the reference depth a power law has the force of a linear stop of the same stiffness.

    spring_indices are those of the contacts that have no stops.
    """

    name: FormName = "dead zone"
    reference_depth_m: float = 1e-4
    spring_indices: tuple[int, ...] = ()

    @property
    def exponent_count(self) -> int:
        """Number of further parameters behind those of `LAW`: 1 for a power law, else 0."""
        return int(self.name == "power law")

    def contact_parameters(self, law_parameters: LawParameters) -> Float[np.ndarray, "contacts 4"]:
        """Parameters of `LAW` by contact."""
        return law_parameters[: law_parameters.size - self.exponent_count].reshape(-1, len(LAW))

    def exponent(self, law_parameters: LawParameters) -> float:
        return float(law_parameters[-1]) if self.exponent_count else 1.0

    def is_within_bounds(self, law_parameters: LawParameters) -> bool:
        """True if every parameter lies in its range and each stiffness is positive."""
        values_by_contact, (least_exponent, most_exponent) = self.contact_parameters(law_parameters), EXPONENT_RANGE
        is_law_within = np.all(values_by_contact >= LAW.bounds[0]) and np.all(values_by_contact[:, 2] > 0)
        return bool(is_law_within and least_exponent <= self.exponent(law_parameters) <= most_exponent)

    def force_n(self, law_parameters: LawParameters, eta_m: Signal, rate_m_per_s: Signal, onset: float = 0.0) -> Signal:
        """Contact force, N: sum over the contacts of stiffness and damping times the forces of a `DeadZone` with one
        each."""
        force = np.zeros_like(eta_m)
        for contribution in self.contributions(law_parameters, eta_m, rate_m_per_s, onset):
            force += contribution.force_n
        return force

    def slopes(self, law_parameters: LawParameters, eta_m: Signal, rate_m_per_s: Signal) -> tuple[Signal, Signal]:
        """Derivatives of the force by displacement (N/m) and by velocity (N s/m)."""
        by_displacement, by_velocity = np.zeros_like(eta_m), np.zeros_like(eta_m)
        for contribution in self.contributions(law_parameters, eta_m, rate_m_per_s):
            by_displacement += contribution.slope_n_per_m
            by_velocity += contribution.damping_n_s_per_m * contribution.is_closed
        return by_displacement, by_velocity

    def by_onset_n(self, law_parameters: LawParameters, eta_m: Signal, rate_m_per_s: Signal) -> Signal:
        """Derivative of the force by the onset of the damping, N."""
        derivative_n = np.zeros_like(eta_m)
        for contribution in self.contributions(law_parameters, eta_m, rate_m_per_s):
            derivative_n += contribution.damping_n_s_per_m * contribution.is_closed * contribution.withheld_m_per_s
        return derivative_n

    def derivatives(
        self, law_parameters: LawParameters, eta_m: Signal, rate_m_per_s: Signal, onset: float = 0.0
    ) -> list[Signal]:
        """Derivatives of the force by every parameter of the law."""
        by_parameters, by_exponent = [], np.zeros_like(eta_m)
        for contribution in self.contributions(law_parameters, eta_m, rate_m_per_s, onset):
            by_lower_clearance = contribution.slope_n_per_m * (contribution.depth_m < 0)
            by_upper_clearance = by_lower_clearance - contribution.slope_n_per_m
            unit_forces_of_closed = (contribution.unit_spring_m, contribution.unit_damper_m_per_s)
            by_parameters += [by_lower_clearance, by_upper_clearance]
            by_parameters += [unit_force * contribution.is_closed for unit_force in unit_forces_of_closed]
            if self.exponent_count:
                depth_ratio = np.maximum(np.abs(contribution.depth_m) / self.reference_depth_m, 1e-9)
                by_exponent += contribution.stiffness_n_per_m * contribution.unit_spring_m * np.log(depth_ratio)
        return [*by_parameters, by_exponent] if self.exponent_count else by_parameters

    def contributions(
        self, law_parameters: LawParameters, eta_m: Signal, rate_m_per_s: Signal, onset: float = 0.0
    ) -> "Iterator[ContactContribution]":
        """Contributions of the contacts to the force."""
        exponent = self.exponent(law_parameters)
        for contact_index, law_values in enumerate(self.contact_parameters(law_parameters)):
            lower_m, upper_m, stiffness, damping = law_values.tolist()
            unit_spring = DeadZone(
                lower_clearance_m=lower_m,
                upper_clearance_m=upper_m,
                stiffness_n_per_m=1.0,
                damping_n_s_per_m=0.0,
                exponent=exponent,
                reference_depth_m=self.reference_depth_m,
            )
            unit_damper = replace(unit_spring, stiffness_n_per_m=0.0, damping_n_s_per_m=1.0)
            depth_m, spring_m = unit_spring.penetration_m(eta_m), unit_spring.force_n(eta_m)
            damper_m_per_s, is_closed = unit_damper.force_n(eta_m, rate_m_per_s), depth_m != 0
            if contact_index in self.spring_indices:
                damper_m_per_s, is_closed = rate_m_per_s, np.ones_like(is_closed)
            withheld_m_per_s = rate_m_per_s * is_closed - damper_m_per_s
            damper_m_per_s = damper_m_per_s + onset * withheld_m_per_s
            if self.name == "cannot pull":
                is_closed = (stiffness * spring_m + damping * damper_m_per_s) * depth_m > 0
            slope_n_per_m = stiffness * unit_spring.by_eta_n_per_m(eta_m) * is_closed
            yield ContactContribution(
                depth_m, spring_m, damper_m_per_s, withheld_m_per_s, stiffness, damping, slope_n_per_m, is_closed
            )


@dataclass(frozen=True)
class ContactContribution:
    """Force of one contact: depth, forces of unit stiffness and of unit damping, what the latter lacks until the
    damping has set in (withheld), derivative by the displacement."""

    depth_m: Signal
    unit_spring_m: Signal
    unit_damper_m_per_s: Signal
    withheld_m_per_s: Signal
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    slope_n_per_m: Signal
    is_closed: Bool[np.ndarray, "*samples"]

    @property
    def force_n(self) -> Signal:
        force = self.stiffness_n_per_m * self.unit_spring_m + self.damping_n_s_per_m * self.unit_damper_m_per_s
        return np.asarray(force * self.is_closed)


DEAD_ZONE, SPRING = LawForm(), LawForm("spring", spring_indices=(0,))


def linear_form(touched: TouchedStops) -> LawForm:
    """Dead zones, and a spring where neither side is touched."""
    spring_indices = tuple(np.flatnonzero(~touched.any(axis=1)).tolist())
    return LawForm("spring" if len(spring_indices) == len(touched) else "dead zone", spring_indices=spring_indices)


def unit_forces(form: LawForm, law_parameters: LawParameters, eta_m: Signal, rate_m_per_s: Signal) -> list[Signal]:
    """Forces of unit stiffness and of unit damping of every contact, for their motion."""
    contributions = form.contributions(law_parameters, eta_m, rate_m_per_s)
    return [force for part in contributions for force in (part.unit_spring_m, part.unit_damper_m_per_s)]
