"""Identified contact with its quantities, each with value, unit, standard error and 95 % interval."""

from dataclasses import dataclass

from identify.contacts.results import ContactEstimate, Estimate
from identify.pages.wording import COVERED, interval


@dataclass(frozen=True)
class EstimatedQuantity:
    """Value with its unit and standard error; prints as value ± half its 95 % interval."""

    value: float
    """Estimate, in `unit`."""
    standard_error: float
    """Standard error by scatter, noise and the tolerances of rig.json, in `unit`."""
    unit: str
    """SI unit, as "N/m"; "1" of a number without one."""

    @property
    def interval(self) -> tuple[float, float]:
        """Both ends of the 95 % interval, value ∓ 1.96 standard errors, in `unit`."""
        half_width = COVERED * self.standard_error
        return self.value - half_width, self.value + half_width

    def __str__(self) -> str:
        return interval(self.value, self.standard_error, self.unit)

    def scaled(self, scale: float = 1.0) -> str:
        """Value ± half its 95 % interval, in units of 1 / scale, without the unit."""
        return interval(scale * self.value, scale * self.standard_error, "1")


@dataclass(frozen=True, kw_only=True)
class IdentifiedContact:
    """Clearance, stiffness and damping of a contact; `identify.contact(...)["contact_1"]` is one."""

    name: str
    """Name of the contact in rig.json."""
    clearance: EstimatedQuantity
    """Half the total play, or the clearance of the only touched stop; of an annular contact the radial one, m."""
    stiffness: EstimatedQuantity
    """Stiffness of a closed stop, N/m; of a power law, force over depth at the reference depth."""
    damping: EstimatedQuantity
    """Damping of a closed stop, N s/m."""
    lower_clearance: EstimatedQuantity | None
    """Clearance of the lower stop, m; None where only the total play is known."""
    upper_clearance: EstimatedQuantity | None
    """Clearance of the upper stop, m; None where only the total play is known."""
    law: str
    """Form of the law that the record supports: "dead zone", "power law" or "cannot pull"; "spring" of a spring,
    whose clearances are zero; "annular" of an annular contact."""
    friction: EstimatedQuantity | None = None
    """Friction coefficient of an annular contact."""
    sliding_speed: EstimatedQuantity | None = None
    """Speed along the wall at which the friction of an annular contact turns round, m/s."""
    center_y: EstimatedQuantity | None = None
    """Centre of an annular contact against its rest position, m; None where it is not known."""
    center_z: EstimatedQuantity | None = None
    """Centre of an annular contact against its rest position, m; None where it is not known."""

    @property
    def cells(self) -> dict[str, str]:
        """Cells of the contact in a table, by their headings."""
        friction_cell = {} if self.friction is None else {"friction": self.friction.scaled()}
        return {
            "contact": self.name,
            "clearance, mm": "" if self.law == "spring" else self.clearance.scaled(1e3),
            "stiffness, N/m": self.stiffness.scaled(),
            "damping, N s/m": self.damping.scaled(),
        } | friction_cell

    def __str__(self) -> str:
        friction = "" if self.friction is None else f", friction {self.friction}"
        return f"{self.name}: clearance {self.clearance}, stiffness {self.stiffness}, damping {self.damping}{friction}"


def identified_contact(contact: ContactEstimate) -> IdentifiedContact:
    """Contact of contact.json with the units that its fields have in their names."""
    return IdentifiedContact(
        name=contact.name,
        clearance=_with_unit(contact.clearance_m, "m"),
        stiffness=_with_unit(contact.stiffness_n_per_m, "N/m"),
        damping=_with_unit(contact.damping_n_s_per_m, "N s/m"),
        lower_clearance=_if_known(contact.lower_clearance_m, "m"),
        upper_clearance=_if_known(contact.upper_clearance_m, "m"),
        law=contact.law,
        friction=_if_known(contact.friction_coefficient, "1"),
        sliding_speed=_if_known(contact.sliding_speed_m_per_s, "m/s"),
        center_y=_if_known(contact.center_y_m, "m"),
        center_z=_if_known(contact.center_z_m, "m"),
    )


def _with_unit(estimate: Estimate, unit: str) -> EstimatedQuantity:
    return EstimatedQuantity(estimate.value, estimate.standard_error, unit)


def _if_known(estimate: Estimate | None, unit: str) -> EstimatedQuantity | None:
    return None if estimate is None else _with_unit(estimate, unit)
