"""The one statistic of the diagnosis: how likely a record is under a rig whose model errs by an unknown scale.

With L_bi the mean square of the linear residual of sensor i in band b and L_j that of contact j, both in the variances
that noise and the tolerated shares of the unmodelled make, and an inverse-gamma prior of the true variances around,

    -2 ln p = sum_bi N_b ln((1 + L_bi) / 2) + sum_j N_j ln((1 + L_j) / 2) + pulls^2 + drift + freedom + sharp

A variance that is not known makes a residual ten times too large cost N ln 100 / 2, not N * 50: what lasts (a shape
that is slightly wrong, a cable) is one error, however many samples show it. N are the samples that count as
independent; drift is what the prior of the slow motion costs, freedom what inputs cost that are known by their spectrum
alone (their own squares, and the determinant of their marginal likelihood). No error of a model is as sharp as one
line: sharp is what lines cost that stand out of those beside them. Kennedy and O'Hagan, J. R. Stat. Soc. B 63,
2001; the Student form is that of Lange et al., J. Am. Stat. Assoc. 84, 1989.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from identify.gaps.residual.law import ContactResidual
from identify.gaps.residual.lines import cost_of_lines
from identify.gaps.residual.observation import ContactObservation
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Linearization, Residual
from identify.gaps.residual.scales import band_of_lines, by_band, measured_levels, posterior_level, second_levels

NOISY = 0.5
"""Where noise is more than this share of the power, a band tells no share of the motion."""


@dataclass(frozen=True)
class Reference:
    """The variances that noise and tolerated shares make, by the believed rig: what all models of a record share.

    By band and sensor: usual is that variance, noise the noise's part, power the size of the acceleration; lines the
    number of lines of each band.
    """

    usual: Float[np.ndarray, "bands sensors"]
    noise: Float[np.ndarray, "bands sensors"]
    power: Float[np.ndarray, "bands sensors"]
    lines: Float[np.ndarray, " bands"]
    seen: tuple[ContactObservation, ...]

    @property
    def has_signal(self) -> Bool[np.ndarray, "bands sensors"]:
        """Mask of bands and sensors of which more than half the power is no noise."""
        return self.noise < NOISY * self.power


def reference_of(linearization: Linearization) -> Reference:
    """Reference by a linearisation at the scales that the tolerances state."""
    record = linearization.record
    bands = second_levels(record, np.zeros((len(record.sensors), record.taken.stop - record.taken.start))).shape[1]
    usual, noise, power = (
        by_band(record, x, bands) for x in (linearization.model.deviation**2, record.noise, record.power)
    )
    lines = np.bincount(band_of_lines(record, bands), minlength=bands).astype(float)
    return Reference(usual, noise, power, lines, linearization.seen)


@dataclass(frozen=True)
class Misfit:
    """Misfit of a rig to a record, second by second.

    left is the variance of the linear residual (as `Reference.usual`), measured what it is in the sensors' unit as a
    share of that, as variances change within a band (`scales.measured_levels`), contact_left the square of each
    contact's residual in the reference's variances, contact_n2 its mean square beyond noise and force_n2 that of the
    contact force (N^2). sharp is what the lines cost that stand out (`lines.cost_of_lines`).
    """

    reference: Reference
    left: Float[np.ndarray, "seconds bands sensors"]
    measured: Float[np.ndarray, "bands sensors"]
    contact_left: Float[np.ndarray, "seconds contacts"]
    contact_n2: Float[np.ndarray, "seconds contacts"]
    force_n2: Float[np.ndarray, "seconds contacts"]
    pulls: Float[np.ndarray, " pulls"]
    drift: float
    freedom: float
    sharp: float
    samples: float

    @property
    def levels(self) -> Float[np.ndarray, "bands sensors"]:
        """Levels of the linear residual: 1 where noise and tolerated shares alone are left."""
        return np.asarray(self.left.mean(axis=0) / self.reference.usual)

    @property
    def contacts(self) -> Float[np.ndarray, " contacts"]:
        """Levels of the contacts' residuals."""
        return np.asarray(self.contact_left.mean(axis=0))

    @property
    def per_cell(self) -> float:
        """N_b: the independent samples of each band and sensor."""
        return self.samples / self.left.shape[1]

    @cached_property
    def linear(self) -> float:
        """The part of the bands."""
        return float(self.per_cell * np.sum(np.log(posterior_level(self.levels))))

    @cached_property
    def peak(self) -> float:
        """The largest part of any one band."""
        return float(self.per_cell * np.max(np.sum(np.log(posterior_level(self.levels)), axis=1)))

    @cached_property
    def law(self) -> float:
        """The part of the contacts."""
        return float(self.samples * np.sum(np.log(posterior_level(self.contacts))))

    @property
    def minus_two_log(self) -> float:
        """-2 ln p, up to a constant of the record."""
        return self.linear + self.law + float(self.pulls @ self.pulls) + self.drift + self.freedom + self.sharp

    @property
    def excess(self) -> float:
        """The part of -2 ln p above noise and tolerated shares: N ln L of the cells and contacts whose L is above 1.

        Logarithms, so that closing a gap means closing it everywhere: a mean square would be content with its peaks.
        """
        cells = self.per_cell * np.sum(np.log(np.maximum(self.levels, 1.0)))
        return float(cells + self.samples * np.sum(np.log(np.maximum(self.contacts, 1.0)))) + self.sharp

    @property
    def beyond_noise(self) -> Float[np.ndarray, "bands sensors"]:
        """Mean square of what is left by line, beyond noise, in the sensors' unit; zero where noise is most of the
        signal, so that it decides nothing."""
        left = np.maximum(self.left.mean(axis=0) * self.measured - self.reference.noise, 0.0)
        return np.asarray(left * self.reference.has_signal)

    @property
    def shares(self) -> Float[np.ndarray, " bands"]:
        """Unexplained share of the acceleration's root mean square by band, beyond noise."""
        return np.asarray(np.sqrt(self.beyond_noise.sum(axis=1) / np.maximum(self.reference.power.sum(axis=1), 1e-300)))

    @property
    def share(self) -> float:
        """The same over all bands."""
        beyond = self.beyond_noise.sum(axis=1)
        whole = max(float(self.reference.lines @ self.reference.power.sum(axis=1)), 1e-300)
        return float(np.sqrt(self.reference.lines @ beyond / whole))

    @property
    def share_by_second(self) -> Float[np.ndarray, " seconds"]:
        """Its square as each second alone has it, beyond noise; below zero where a second is quieter than noise."""
        whole = max(float(self.reference.lines @ self.reference.power.sum(axis=1)), 1e-300)
        beyond = (self.left * self.measured - self.reference.noise) * self.reference.has_signal
        return np.einsum("sbi,b->s", beyond, self.reference.lines) / whole

    @property
    def contact_shares(self) -> Float[np.ndarray, " contacts"]:
        """Unexplained share of each contact force's root mean square, beyond noise."""
        left = np.maximum(self.contact_n2.mean(axis=0), 0.0)
        return np.asarray(np.sqrt(left / np.maximum(self.force_n2.mean(axis=0), 1e-300)))

    def drawn(self, seconds: Int[np.ndarray, " seconds"]) -> "Misfit":
        """Misfit of some seconds of the record: for a bootstrap."""
        return replace(
            self,
            left=self.left[seconds],
            contact_left=self.contact_left[seconds],
            contact_n2=self.contact_n2[seconds],
            force_n2=self.force_n2[seconds],
        )


def misfit(record: Record, reference: Reference, at: Residual) -> Misfit:
    """Misfit of a fitted residual, whatever scales it was fitted at."""
    levels = second_levels(record, at.linear)
    seconds, bands = levels.shape[:2]
    usual = by_band(record, at.model.deviation**2, bands)
    contacts = [_of_contact(seen, contact, seconds) for contact, seen in zip(at.contacts, reference.seen, strict=True)]
    rows = np.array(contacts).reshape(len(contacts), 3, seconds)
    drift = sum(float(np.sum(c.residual[c.seen.weights.size : -c.pulls.size] ** 2)) for c in at.contacts)
    lines = at.model.deviation.shape[1]
    inputs = float(np.sum(at.linear[len(record.sensors) :] ** 2))
    sharp = 0.0  # a free decay rings as sharply as tones
    if record.forced:
        directions = len(record.sensors) - len(at.contacts)
        sharp = cost_of_lines(at.linear[: len(record.sensors)], directions, record.repeats)
    return Misfit(
        reference=reference,
        left=levels * usual,
        measured=measured_levels(record, at.linear, at.model.deviation, bands) / usual,
        contact_left=rows[:, 0].T,
        contact_n2=rows[:, 1].T,
        force_n2=rows[:, 2].T,
        pulls=at.pulls,
        drift=drift / record.sample_ratio,
        freedom=(inputs + at.model.log_determinant * at.linear.shape[1] / lines) / record.sample_ratio,
        sharp=sharp,
        samples=at.linear.shape[1] / record.sample_ratio,
    )


def _of_contact(seen: ContactObservation, contact: ContactResidual, seconds: int) -> list[list[float]]:
    """Second by second: the level of its residual, its mean square beyond noise, and that of the force (N^2)."""
    weights = contact.seen.weights
    moving = weights > 0
    left_n = np.divide(contact.residual[: weights.size], weights, out=np.zeros(weights.size), where=moving)
    usual_n = np.divide(1.0, seen.weights, out=np.zeros(weights.size), where=moving)
    rows = (left_n * seen.weights) ** 2, left_n**2 - usual_n**2, contact.signals.force_n**2
    return [[float(np.mean(part)) for part in np.array_split(row, seconds)] for row in rows]
