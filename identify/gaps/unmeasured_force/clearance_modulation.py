"""Harmonic change of a contact's clearance during the record: its amplitude and frequency.

While a contact is pressed, its residual force r over the law's tangent stiffness k is a change of its clearance,
-sign(eta) r / k with the relative displacement eta.
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
"""Lowest frequency of a harmonic change of the clearance. Set by hand."""
PRESSED_SHARE = 0.5
"""A contact counts as pressed where its tangent stiffness, low-passed, exceeds this share of the largest. Set by
hand."""
NAMED_SHARE = 0.3
"""Share of the variance of the clearance from which a harmonic change is named; chance makes a hundredth. Set by
hand."""
FEWEST_SAMPLES = 50
"""Count of pressed samples below which a contact is not analysed. Set by hand."""


@dataclass(frozen=True)
class ClearanceModulation:
    """Harmonic change of a clearance; share is its part of the variance of the clearance while pressed."""

    contact: str
    amplitude_m: float
    frequency_hz: float
    share: float

    def described(self, contact: Contact) -> UnmeasuredForce:
        """Entry of gap.json, as an unmeasured force of the kind "contact"."""
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


def clearance_modulation(record: Record, residual: Residual) -> ClearanceModulation | None:
    """Modulation with the largest share among the contacts; None if none reaches `NAMED_SHARE`."""
    modulations = [
        _contact_modulation(record, c.name, contact)
        for c, contact in zip(residual.model.rig.contacts, residual.contacts, strict=True)
    ]
    named = [modulation for modulation in modulations if modulation is not None and modulation.share > NAMED_SHARE]
    return max(named, key=lambda modulation: modulation.share, default=None)


def _contact_modulation(record: Record, name: str, contact: ContactResidual) -> ClearanceModulation | None:
    """Modulation at the peak of the periodogram of the pressed samples, refined within its resolution."""
    weights = contact.observation.weights
    tangent, signed_slope_n_per_m, *_ = contact.slopes.sum(axis=1)
    pressed = (weights > 0) & (tangent > PRESSED_SHARE * max(float(tangent.max()), 1e-300))
    if np.count_nonzero(pressed) < FEWEST_SAMPLES:
        return None
    time_s = record.time_s[pressed]
    residual_force_n = contact.residual[: weights.size][pressed] / weights[pressed]
    change_m = -residual_force_n * signed_slope_n_per_m[pressed] / tangent[pressed] ** 2
    resolution_hz = 1 / (time_s[-1] - time_s[0])
    hz, shares = _periodogram(change_m, pressed, record.rate_hz)
    trial_hz = hz[int(np.argmax(shares))] + resolution_hz * np.linspace(-0.5, 0.5, 41)
    fits = [_harmonic(time_s, change_m, f) for f in trial_hz if f > 0]
    share, amplitude_m, frequency_hz = max(fits)
    return ClearanceModulation(name, amplitude_m, frequency_hz, share)


def _periodogram(
    change_m: Float[np.ndarray, " taken"], pressed: Bool[np.ndarray, " times"], rate_hz: float
) -> tuple[Float[np.ndarray, " lines"], Float[np.ndarray, " lines"]]:
    """Frequencies (Hz), and the share of the samples' variance that a harmonic at each explains.

    The samples lie at some places of a uniform grid (Lomb, Astrophys. Space Sci. 39, 1976). With the transforms Y of
    the samples y less their mean, and W of ones in their places, both zero elsewhere, the share is

        2 (W(0) |Y|^2 - Re(W(2 f) conj(Y)^2)) / (W(0)^2 - |W(2 f)|^2) / sum y^2
    """
    centred = np.zeros(pressed.size)
    centred[pressed] = change_m - change_m.mean()
    length = next_fast_len(3 * pressed.size, real=True)
    ones, transform = rfft(pressed.astype(float), length), rfft(centred, length)
    lines = np.arange(int(np.ceil(LOWEST_HZ * length / rate_hz)), length // 4)
    count, ones_at_double, y = float(ones[0].real), ones[2 * lines], transform[lines]
    fitted = (
        2 * (count * np.abs(y) ** 2 - (ones_at_double * y.conj() ** 2).real) / (count**2 - np.abs(ones_at_double) ** 2)
    )
    return lines * rate_hz / length, fitted / max(float(centred @ centred), 1e-300)


def _harmonic(
    time_s: Float[np.ndarray, " times"], change_m: Float[np.ndarray, " times"], hz: float
) -> tuple[float, float, float]:
    """Share of the variance, amplitude and frequency of a harmonic at hz, fitted by least squares with a mean."""
    angle = 2 * np.pi * hz * time_s
    columns = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)], axis=1)
    coefficients = np.linalg.lstsq(columns, change_m, rcond=None)[0]
    residual_variance = float(np.var(change_m - columns @ coefficients))
    return 1 - residual_variance / max(float(np.var(change_m)), 1e-300), float(np.hypot(*coefficients[1:])), float(hz)
