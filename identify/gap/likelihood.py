"""The one statistic of the diagnosis: how likely a record is under a rig whose model errs by an unknown scale.

With L_b the mean square of the linear residual in band b and L_j that of contact j, both in the variances that noise
and the tolerated shares of the unmodelled make, and an inverse-gamma prior of the true variances around them,

    -2 ln p = sum_b N_b ln((1 + L_b) / 2) + sum_j N_j ln((1 + L_j) / 2) + pulls^2 + drift + freedom

A variance that is not known makes a residual ten times too large cost N ln 100 / 2, not N * 50: what lasts (a shape
that is slightly wrong, a cable) is one error, however many samples show it. N are the samples that count as
independent; drift is what the prior of the slow motion costs, freedom what inputs cost that are known by their spectrum
alone (the determinant of their marginal likelihood). Kennedy and O'Hagan, J. R. Stat. Soc. B 63, 2001; the Student form is that of Lange et al., J. Am. Stat.
Assoc. 84, 1989.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.gap.law import Seen
from identify.gap.residual import Base, Residual
from identify.gap.scales import band_levels, band_of_lines, by_band, posterior_level
from identify.gap.spectra import Record


@dataclass(frozen=True)
class Reference:
    """The variances that noise and tolerated shares make, by the believed rig: what all models of a record share."""

    variance: Float[np.ndarray, "sensors lines"]
    seen: tuple[Seen, ...]


@dataclass(frozen=True)
class Misfit:
    """What a rig leaves of a record: levels by band and by contact (1: noise and tolerated shares alone).

    share is the unexplained share of the acceleration's root mean square by band, contact_share that of each contact
    force's; both beyond noise.
    """

    bands: Float[np.ndarray, " bands"]
    sensors: Float[np.ndarray, " sensors"]
    contacts: Float[np.ndarray, " contacts"]
    pulls: Float[np.ndarray, " pulls"]
    drift: float
    freedom: float
    per_band: float
    per_contact: float
    share: Float[np.ndarray, " bands"]
    total_share: float
    contact_share: Float[np.ndarray, " contacts"]

    @property
    def linear(self) -> float:
        """The part of the bands."""
        return float(self.per_band * np.sum(np.log(posterior_level(self.bands))))

    @property
    def law(self) -> float:
        """The part of the contacts."""
        return float(self.per_contact * np.sum(np.log(posterior_level(self.contacts))))

    @property
    def minus_two_log(self) -> float:
        """-2 ln p, up to a constant of the record."""
        return self.linear + self.law + float(self.pulls @ self.pulls) + self.drift + self.freedom


def reference_of(base: Base) -> Reference:
    """From a base at the scales that the tolerances state."""
    return Reference(base.model.spread**2, base.seen)


def misfit(record: Record, reference: Reference, base: Base, at: Residual) -> Misfit:
    """What a fitted residual leaves, whatever scales it was fitted at."""
    levels = band_levels(record, at.linear)
    bands = len(levels)
    used = by_band(record, at.model.spread**2, bands)
    absolute = levels * used
    usual = by_band(record, reference.variance, bands)
    noise, power = by_band(record, record.noise, bands), by_band(record, record.power, bands)
    beyond = np.maximum(absolute - noise, 0.0)
    counted = band_of_lines(record, bands)
    widths = np.bincount(counted, minlength=bands) / counted.size
    contacts, shares = [], []
    for contact, seen in zip(at.contacts, reference.seen, strict=True):
        moving = seen.weights > 0
        force = contact.laid.force_n[moving]
        left = contact.residual[: moving.size][moving] / contact.seen.weights[moving]
        contacts.append(float(np.mean((left * seen.weights[moving]) ** 2)) if left.size else 0.0)
        noisy = float(np.sum(left**2)) - float(np.sum(1 / seen.weights[moving] ** 2))
        shares.append(float(np.sqrt(max(noisy, 0.0) / max(float(np.sum(force**2)), 1e-300))))
    samples = at.linear.shape[1] / record.strictness
    drift = sum(float(np.sum(c.residual[c.seen.weights.size : -3] ** 2)) for c in at.contacts)
    return Misfit(
        bands=(absolute / usual).mean(axis=1),
        sensors=(absolute / usual).mean(axis=0),
        contacts=np.array(contacts),
        pulls=at.pulls,
        drift=drift / record.strictness,
        freedom=at.model.log_determinant * at.linear.shape[1] / at.model.spread.shape[1] / record.strictness,
        per_band=samples * len(record.sensors) / bands,
        per_contact=samples,
        share=np.sqrt(beyond.sum(axis=1) / np.maximum(power.sum(axis=1), 1e-300)),
        total_share=float(np.sqrt(np.sum(widths * beyond.sum(axis=1)) / np.sum(widths * power.sum(axis=1)))),
        contact_share=np.array(shares),
    )
