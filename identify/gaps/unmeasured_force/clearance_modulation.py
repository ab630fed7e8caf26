"""A contact whose clearance changes during the record: by what, and at which frequency.

While a contact presses, its residual force r over the law's tangent k is a change of its clearance, -sign(depth) r / k.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.fft import next_fast_len, rfft

from identify.gaps.residual.law import ContactResidual
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Residual
from rig.model.description import Contact
from rig.model.unmeasured_force import UnmeasuredForce

LOWEST_HZ = 0.2
STEEP = 0.5
"""A contact presses where its tangent, low-passed, is this share of its largest."""
LEAST = 0.3
"""A harmonic change is named if it makes this share of the clearance's changes; chance makes a hundredth."""
FEW = 50


@dataclass(frozen=True)
class ClearanceModulation:
    """A clearance that swings: amplitude and frequency, and the share of the clearance's changes that this is."""

    contact: str
    amplitude_m: float
    frequency_hz: float
    share: float

    def described(self, contact: Contact) -> UnmeasuredForce:
        """Description in the words of gap.json."""
        size = f"{1e3 * self.amplitude_m:.2g} mm at {self.frequency_hz:.1f} Hz"
        return UnmeasuredForce(
            sentence=f"the clearance of {self.contact} swings by {size}",
            kind="contact",
            body=contact.at.body,
            position_m=contact.at.position_m,
            position_error_m=0.0,
            against_body=contact.against.body if contact.against else None,
            against_position_m=contact.against.position_m if contact.against else None,
            contact=self.contact,
            frequency_hz=self.frequency_hz,
            band_hz=(self.frequency_hz, self.frequency_hz),
            rms_n=0.0,
            law=f"{1e3 * self.amplitude_m:.3g} mm at {self.frequency_hz:.4g} Hz",
            explained=self.share,
        )


def clearance_modulation(record: Record, at: Residual) -> ClearanceModulation | None:
    """The contact whose clearance swings most clearly; None if none does."""
    found = [_of(record, c.name, contact) for c, contact in zip(at.model.rig.contacts, at.contacts, strict=True)]
    clear = [b for b in found if b is not None and b.share > LEAST]
    return max(clear, key=lambda b: b.share, default=None)


def _of(record: Record, name: str, contact: ContactResidual) -> ClearanceModulation | None:
    """Modulation by the periodogram of the samples at which the contact presses, refined about its peak."""
    weights = contact.seen.weights
    tangent, side, _ = contact.slopes.sum(axis=1)
    pressed = (weights > 0) & (tangent > STEEP * max(float(tangent.max()), 1e-300))
    if np.count_nonzero(pressed) < FEW:
        return None
    time_s = record.time_s[pressed]
    left_n = contact.residual[: weights.size][pressed] / weights[pressed]
    change_m = -left_n * side[pressed] / tangent[pressed] ** 2
    resolution_hz = 1 / (time_s[-1] - time_s[0])
    hz, shares = _periodogram(change_m, pressed, record.rate_hz)
    near = hz[int(np.argmax(shares))] + resolution_hz * np.linspace(-0.5, 0.5, 41)
    fits = [_harmonic(time_s, change_m, f) for f in near if f > 0]
    share, amplitude_m, frequency_hz = max(fits)
    return ClearanceModulation(name, amplitude_m, frequency_hz, share)


def _periodogram(
    change_m: Float[np.ndarray, " taken"], pressed: Bool[np.ndarray, " times"], rate_hz: float
) -> tuple[Float[np.ndarray, " lines"], Float[np.ndarray, " lines"]]:
    """Frequencies, and the share of the square of some even samples less their mean that a harmonic makes (Lomb,
    Astrophys. Space Sci. 39, 1976). With Y their transform, W that of ones in their places, both zero elsewhere,

        2 (W(0) |Y|^2 - Re(W(2 f) conj(Y)^2)) / (W(0)^2 - |W(2 f)|^2) / sum y^2
    """
    centred = np.zeros(pressed.size)
    centred[pressed] = change_m - change_m.mean()
    length = next_fast_len(3 * pressed.size, real=True)
    ones, transform = rfft(pressed.astype(float), length), rfft(centred, length)
    lines = np.arange(int(np.ceil(LOWEST_HZ * length / rate_hz)), length // 4)
    count, twice, y = float(ones[0].real), ones[2 * lines], transform[lines]
    fitted = 2 * (count * np.abs(y) ** 2 - (twice * y.conj() ** 2).real) / (count**2 - np.abs(twice) ** 2)
    return lines * rate_hz / length, fitted / max(float(centred @ centred), 1e-300)


def _harmonic(
    time_s: Float[np.ndarray, " times"], change_m: Float[np.ndarray, " times"], hz: float
) -> tuple[float, float, float]:
    """Share of the variance, amplitude and frequency of the harmonic that fits best beside a mean."""
    angle = 2 * np.pi * hz * time_s
    columns = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)], axis=1)
    found = np.linalg.lstsq(columns, change_m, rcond=None)[0]
    left = float(np.var(change_m - columns @ found))
    return 1 - left / max(float(np.var(change_m)), 1e-300), float(np.hypot(*found[1:])), float(hz)
