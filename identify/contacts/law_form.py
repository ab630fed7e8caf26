"""Forms of a contact's law that a record may ask for: the dead zone, a power of the depth, a stop that cannot pull.

Of each the numbers of `LAW` are fitted; of a power law the exponent stands behind them. With the penetration `depth`
beyond a stop and its reference depth d,

    f = k depth |depth / d|^(p - 1) + c rate min(1, |depth| / 10 um)

where p is 1 but of a power law; a stop that cannot pull gives f only where f depth > 0.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from identify.contacts.contact_record import LAW, Law
from rig.model.contact_laws import DeadZone

FormName = Literal["dead zone", "power law", "cannot pull"]
EXPONENTS = (1.0, 3.0)
"""Between these `DeadZone` knows a power law."""

Signal = Float[np.ndarray, "*samples"]


@dataclass(frozen=True)
class LawForm:
    """A form. At the reference depth a power law has the force of a linear stop of the same stiffness."""

    name: FormName = "dead zone"
    reference_depth_m: float = 1e-4

    @property
    def shapes(self) -> int:
        """Count of the law's numbers behind those of the contacts."""
        return int(self.name == "power law")

    def contacts(self, law: Law) -> Float[np.ndarray, "contacts 4"]:
        """The numbers of each contact."""
        return law[: law.size - self.shapes].reshape(-1, len(LAW))

    def exponent(self, law: Law) -> float:
        return float(law[-1]) if self.shapes else 1.0

    def is_possible(self, law: Law) -> bool:
        """True if every number lies in its range and each stop has a stiffness."""
        contacts, (least, most) = self.contacts(law), EXPONENTS
        inside = np.all(contacts >= LAW.bounds[0]) and np.all(contacts[:, 2] > 0)
        return bool(inside and least <= self.exponent(law) <= most)

    def force_n(self, law: Law, eta_m: Signal, rate_m_per_s: Signal) -> Signal:
        """The sum over the contacts: stiffness and damping, of any sign, times what a `DeadZone` makes of one each."""
        force = np.zeros_like(eta_m)
        for contribution in self._contributions(law, eta_m, rate_m_per_s):
            force += contribution.force_n
        return force

    def slopes(self, law: Law, eta_m: Signal, rate_m_per_s: Signal) -> tuple[Signal, Signal]:
        """Stiffness and damping of the contacts that are closed."""
        by_stiffness, by_damping = np.zeros_like(eta_m), np.zeros_like(eta_m)
        for contribution in self._contributions(law, eta_m, rate_m_per_s):
            by_stiffness += contribution.slope_n_per_m
            by_damping += contribution.damping_n_s_per_m * contribution.closed
        return by_stiffness, by_damping

    def derivatives(self, law: Law, eta_m: Signal, rate_m_per_s: Signal) -> list[Signal]:
        """Derivatives of the force by every number of the law."""
        rows, by_exponent = [], np.zeros_like(eta_m)
        for contribution in self._contributions(law, eta_m, rate_m_per_s):
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

    def _contributions(self, law: Law, eta_m: Signal, rate_m_per_s: Signal) -> "list[_Contribution]":
        exponent = self.exponent(law)
        return [self._contribution(row, exponent, eta_m, rate_m_per_s) for row in self.contacts(law)]

    def _contribution(self, row: Law, exponent: float, eta_m: Signal, rate_m_per_s: Signal) -> "_Contribution":
        lower, upper, stiffness, damping = row.tolist()
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
        if self.name == "cannot pull":
            closed = (stiffness * shape + damping * drag) * depth > 0
        return _Contribution(depth, shape, drag, stiffness, damping, stiffness * by_eta * closed, closed)


@dataclass(frozen=True)
class _Contribution:
    """One contact: its depth, the forces of a unit of stiffness and of damping, and the slope of its force."""

    depth_m: Signal
    spring_m: Signal
    damper: Signal
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    slope_n_per_m: Signal
    closed: Bool[np.ndarray, "*samples"]

    @property
    def force_n(self) -> Signal:
        whole = self.stiffness_n_per_m * self.spring_m + self.damping_n_s_per_m * self.damper
        return np.asarray(whole * self.closed)


DEAD_ZONE = LawForm()


def by_stiffness_and_damping(law: Law, eta_m: Signal, rate_m_per_s: Signal) -> tuple[Signal, Signal]:
    """Forces of a unit of stiffness and of a unit of damping of a dead zone, by a contact's motion."""
    (contribution,) = DEAD_ZONE._contributions(law, eta_m, rate_m_per_s)
    return contribution.spring_m, contribution.damper
