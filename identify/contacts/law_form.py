"""Parameters and forms of a contact's law: the dead zone, a power of the depth, a stop that cannot pull.

All forms have the parameters of `LAW`; a power law has its exponent behind them. With the penetration `depth` beyond a
stop and its reference depth d,

    f = k depth |depth / d|^(p - 1) + c rate ((1 - o) min(1, |depth| / 10 um) + o)

where the onset o of the damping is 0 in rig.json and 1 of a damper that acts at once, p = 1 except for a power law, and
a stop that cannot pull has f = 0 where f depth < 0. A spring has no clearance, and its damping acts always,
f = k eta + c rate. It may stand alone or beside stops between the same places.

A damper sets in within less time than passes between samples. Of samples that are a time step_s apart, what acts of it
is the mean over that time about each, with a depth that is linear in time: single values of so short a pulse would be
noise, which makes its size come out too small. With step_s = 0 they are single values, and the moment of contact is
held in the derivatives, as far from the solution it would lead a fit astray.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rig.model.contact_laws import ContactLaw, DeadZone
from rig.model.contact_laws.dead_zone import DAMPING_DEPTH_M
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
LEAST_TRAVEL_M = 1e-12
"""Least travel between samples over which a mean is taken."""

Signal = Float[np.ndarray, "*samples"]


def parameters_of_law(law: ContactLaw) -> Float[np.ndarray, " 4"]:
    """Parameters of `LAW` of a law, with `ABSENT_STOP_M` for the clearance where there is no stop."""
    return np.minimum([getattr(law, name) for name in LAW.names], [ABSENT_STOP_M, ABSENT_STOP_M, np.inf, np.inf])


@dataclass(frozen=True)
class LawForm:
    """Form of a law. At the reference depth a power law has the force of a linear stop of the same stiffness.

    spring_indices are those of the contacts that have no stops; step_s is the time between samples, s.
    """

    name: FormName = "dead zone"
    reference_depth_m: float = 1e-4
    spring_indices: tuple[int, ...] = ()
    step_s: float = 0.0

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

    def tangent_n_per_m(self, law_parameters: LawParameters, eta_m: Signal, rate_m_per_s: Signal) -> Signal:
        """Derivative of the springs' force by displacement."""
        tangent_n_per_m = np.zeros_like(eta_m)
        for contribution in self.contributions(law_parameters, eta_m, rate_m_per_s):
            tangent_n_per_m += contribution.spring_by_eta_n_per_m
        return tangent_n_per_m

    def derivatives(
        self, law_parameters: LawParameters, eta_m: Signal, rate_m_per_s: Signal, onset: float
    ) -> Float[np.ndarray, "derivatives *samples"]:
        """Derivatives of the force by displacement (N/m), by velocity (N s/m), by the onset, and by every parameter of
        the law; how the travel between samples changes with the velocity is left out."""
        by_eta, by_rate, by_onset, by_exponent = np.zeros((4, *eta_m.shape))
        by_parameters = list[Signal]()
        for contact in self.contributions(law_parameters, eta_m, rate_m_per_s, onset):
            slope_n_per_m = contact.spring_by_eta_n_per_m + contact.damper_by_eta_n_per_m
            by_eta += slope_n_per_m
            by_rate += contact.law_damping_n_s_per_m * contact.damping_share
            by_onset += contact.law_damping_n_s_per_m * contact.withheld_share * rate_m_per_s
            by_parameters += [slope_n_per_m * contact.is_lower, -slope_n_per_m * ~contact.is_lower]
            by_parameters += [contact.spring_m, contact.unit_damping_force_m_per_s]
            if self.exponent_count:
                depth_ratio = np.maximum(np.abs(contact.depth_m) / self.reference_depth_m, 1e-9)
                by_exponent += contact.law_stiffness_n_per_m * contact.spring_m * np.log(depth_ratio)
        by_law = [*by_parameters, by_exponent] if self.exponent_count else by_parameters
        return np.stack([by_eta, by_rate, by_onset, *by_law])

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
            is_lower = eta_m < (upper_m - lower_m) / 2
            share = DampingShare(np.ones_like(eta_m), np.zeros_like(eta_m), np.zeros_like(eta_m))
            if contact_index not in self.spring_indices:
                distance_m = np.where(is_lower, -lower_m - eta_m, eta_m - upper_m)
                share = damping_share(distance_m, rate_m_per_s, onset, self.step_s)
            contribution = ContactContribution(
                law_stiffness_n_per_m=stiffness,
                law_damping_n_s_per_m=damping,
                rate_m_per_s=rate_m_per_s,
                is_lower=is_lower,
                depth_m=unit_spring.penetration_m(eta_m),
                spring_m=unit_spring.force_n(eta_m),
                damping_share=share.acting,
                withheld_share=share.withheld,
                spring_by_eta_n_per_m=stiffness * unit_spring.by_eta_n_per_m(eta_m),
                damper_by_eta_n_per_m=damping * rate_m_per_s * np.where(is_lower, -1, 1) * share.by_depth_per_m,
            )
            yield contribution.clipped_to_pushing_force() if self.name == "cannot pull" else contribution


class DampingShare(NamedTuple):
    """Share of a damping that acts, what it lacks until it has set in, and the derivative of the former by depth."""

    acting: Signal
    withheld: Signal
    by_depth_per_m: Signal


def damping_share(distance_m: Signal, rate_m_per_s: Signal, onset: float, step_s: float) -> DampingShare:
    """Share of a damping that acts at a signed distance d beyond a wall, as its mean over step_s about each sample:

        s = (1 - o) min(1, d / 10 um) + o    for d > 0,  else 0

    with the onset o, and d linear in time between samples. The derivative is zero where step_s is.
    """
    half_travel_m = np.maximum(np.abs(rate_m_per_s) * (step_s / 2), LEAST_TRAVEL_M)
    acting = (distance_m > 0).astype(float)
    withheld, by_depth_per_m = np.zeros((2, *acting.shape))
    is_near = np.abs(distance_m) < half_travel_m + DAMPING_DEPTH_M
    half_travel_m = half_travel_m[is_near]
    ends_m = np.maximum(distance_m[is_near] + np.stack([half_travel_m, -half_travel_m]), 0.0)
    rising_m = np.minimum(ends_m, DAMPING_DEPTH_M)
    withheld_m, end_shares = rising_m * (1 - rising_m / (2 * DAMPING_DEPTH_M)), rising_m / DAMPING_DEPTH_M
    end_shares += onset * ((ends_m > 0) - end_shares)
    differences = np.stack([ends_m - (1 - onset) * withheld_m, withheld_m, end_shares])
    acting[is_near], withheld[is_near], by_depth_per_m[is_near] = (differences[:, 0] - differences[:, 1]) / (
        2 * half_travel_m
    )
    return DampingShare(acting, withheld, by_depth_per_m if step_s else np.zeros_like(acting))


@dataclass(frozen=True)
class ContactContribution:
    """Force of one contact: stiffness and damping of the law, force of unit stiffness, shares of the damping that act
    and that do not yet (withheld), and derivatives by the displacement of the spring's force and of the damper's, which
    moves with the moment of contact."""

    law_stiffness_n_per_m: float
    law_damping_n_s_per_m: float
    rate_m_per_s: Signal
    is_lower: Bool[np.ndarray, "*samples"]
    depth_m: Signal
    spring_m: Signal
    damping_share: Signal
    withheld_share: Signal
    spring_by_eta_n_per_m: Signal
    damper_by_eta_n_per_m: Signal

    @property
    def unit_damping_force_m_per_s(self) -> Signal:
        """Force of unit damping."""
        return np.asarray(self.damping_share * self.rate_m_per_s)

    @property
    def force_n(self) -> Signal:
        return np.asarray(
            self.law_stiffness_n_per_m * self.spring_m + self.law_damping_n_s_per_m * self.unit_damping_force_m_per_s
        )

    def clipped_to_pushing_force(self) -> "ContactContribution":
        """Contribution of stops that do not draw back what leaves them."""
        pushes = self.force_n * self.depth_m > 0
        masked_names = ("spring_m", "damping_share", "withheld_share", "spring_by_eta_n_per_m", "damper_by_eta_n_per_m")
        return replace(self, **{name: getattr(self, name) * pushes for name in masked_names})


DEAD_ZONE, SPRING = LawForm(), LawForm("spring", spring_indices=(0,))


def dead_zone_or_spring_form(touched: TouchedStops) -> LawForm:
    """Dead zones, and a spring where neither side is touched."""
    spring_indices = tuple(np.flatnonzero(~touched.any(axis=1)).tolist())
    return LawForm("spring" if len(spring_indices) == len(touched) else "dead zone", spring_indices=spring_indices)


def unit_forces(form: LawForm, law_parameters: LawParameters, eta_m: Signal, rate_m_per_s: Signal) -> list[Signal]:
    """Forces of unit stiffness and of unit damping of every contact, for their motion."""
    contributions = form.contributions(law_parameters, eta_m, rate_m_per_s)
    return [force for contact in contributions for force in (contact.spring_m, contact.unit_damping_force_m_per_s)]
