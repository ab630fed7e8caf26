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
from identify.pages.wording import interval
from identify.signals.scores import cluster_scores
from rig.model.description import Contact
from rig.model.unmeasured_force import UnmeasuredForce

LOWEST_MODULATION_HZ = 0.2
"""Lowest frequency of a harmonic change of the clearance. Set by hand."""
PRESSED_STIFFNESS_SHARE = 0.5
"""A contact counts as pressed where its tangent stiffness, low-passed, exceeds this share of the largest. Set by
hand."""
MIN_NAMED_SHARE = 0.3
"""Share of the variance of the clearance from which a harmonic change is named; chance makes a hundredth. Set by
hand."""
MIN_PRESSED_SAMPLE_COUNT = 50
"""Count of pressed samples below which a contact is not analysed. Set by hand."""


@dataclass(frozen=True)
class ClearanceModulation:
    """Harmonic change of a clearance, with standard errors; variance_share is its part of that of the clearance while
    pressed."""

    contact_name: str
    amplitude_m: float
    amplitude_error_m: float
    frequency_hz: float
    frequency_error_hz: float
    variance_share: float

    def as_unmeasured_force(self, contact: Contact) -> UnmeasuredForce:
        """Entry of gap.json, as an unmeasured force of the kind "contact"."""
        amplitude_text = interval(1e3 * self.amplitude_m, 1e3 * self.amplitude_error_m, "mm")
        swing_text = f"{amplitude_text} at {interval(self.frequency_hz, self.frequency_error_hz, 'Hz')}"
        return UnmeasuredForce(
            sentence=f"the clearance of {self.contact_name} swings by {swing_text}",
            kind="contact",
            body=contact.at.body,
            position_m=contact.at.position_m,
            position_error_m=0.0,
            against_body=contact.against.body if contact.against else None,
            against_position_m=contact.against.position_m if contact.against else None,
            contact=self.contact_name,
            frequency_hz=self.frequency_hz,
            band_hz=(self.frequency_hz, self.frequency_hz),
            rms_n=0.0,
            law=swing_text,
            explained=self.variance_share,
        )


def clearance_modulation(record: Record, residual: Residual) -> ClearanceModulation | None:
    """Modulation with the largest share among the contacts; None if none reaches `MIN_NAMED_SHARE`."""
    modulations = [
        _contact_modulation(record, contact.name, contact_residual)
        for contact, contact_residual in zip(residual.model.rig.contacts, residual.contacts, strict=True)
    ]
    nameable = [modulation for modulation in modulations if modulation and modulation.variance_share > MIN_NAMED_SHARE]
    return max(nameable, key=lambda modulation: modulation.variance_share, default=None)


def _contact_modulation(record: Record, contact_name: str, contact: ContactResidual) -> ClearanceModulation | None:
    """Modulation at the peak of the periodogram of the pressed samples, refined within its resolution."""
    weights = contact.observation.force_weights
    tangent_n_per_m, signed_slope_n_per_m, *_ = contact.slopes.sum(axis=1)
    is_pressed = (weights > 0) & (tangent_n_per_m > PRESSED_STIFFNESS_SHARE * max(float(tangent_n_per_m.max()), 1e-300))
    if np.count_nonzero(is_pressed) < MIN_PRESSED_SAMPLE_COUNT:
        return None
    times_s = record.residual_times_s[is_pressed]
    residual_force_n = contact.residual[: weights.size][is_pressed] / weights[is_pressed]
    clearance_change_m = -residual_force_n * signed_slope_n_per_m[is_pressed] / tangent_n_per_m[is_pressed] ** 2
    resolution_hz = 1 / (times_s[-1] - times_s[0])
    lines_hz, variance_shares = _periodogram(clearance_change_m, is_pressed, record.residual_rate_hz)
    trial_hz = lines_hz[int(np.argmax(variance_shares))] + resolution_hz * np.linspace(-0.5, 0.5, 41)
    share, frequency_hz = max(
        (_harmonic_share(times_s, clearance_change_m, trial), float(trial)) for trial in trial_hz if trial > 0
    )
    return _fitted_modulation(contact_name, times_s, clearance_change_m, frequency_hz, share)


def _periodogram(
    clearance_change_m: Float[np.ndarray, " taken"], is_pressed: Bool[np.ndarray, " times"], rate_hz: float
) -> tuple[Float[np.ndarray, " lines"], Float[np.ndarray, " lines"]]:
    """Frequencies (Hz), and the share of the samples' variance that a harmonic at each explains.

    The samples lie at some places of a uniform grid (Lomb, Astrophys. Space Sci. 39, 1976). With the transforms Y of
    the samples y less their mean, and W of ones in their places, both zero elsewhere, the share is

        2 (W(0) |Y|^2 - Re(W(2 f) conj(Y)^2)) / (W(0)^2 - |W(2 f)|^2) / sum y^2
    """
    centred_m = np.zeros(is_pressed.size)
    centred_m[is_pressed] = clearance_change_m - clearance_change_m.mean()
    padded_sample_count = next_fast_len(3 * is_pressed.size, real=True)
    mask_spectrum = rfft(is_pressed.astype(float), padded_sample_count)
    lines = np.arange(int(np.ceil(LOWEST_MODULATION_HZ * padded_sample_count / rate_hz)), padded_sample_count // 4)
    change_spectrum, mask_at_double_lines = rfft(centred_m, padded_sample_count)[lines], mask_spectrum[2 * lines]
    pressed_count = float(mask_spectrum[0].real)
    harmonic_squares = (
        2
        * (pressed_count * np.abs(change_spectrum) ** 2 - (mask_at_double_lines * change_spectrum.conj() ** 2).real)
        / (pressed_count**2 - np.abs(mask_at_double_lines) ** 2)
    )
    return lines * rate_hz / padded_sample_count, harmonic_squares / max(float(centred_m @ centred_m), 1e-300)


def _harmonic_share(
    times_s: Float[np.ndarray, " times"], clearance_change_m: Float[np.ndarray, " times"], frequency_hz: float
) -> float:
    """Share of the variance that a harmonic, fitted by least squares with a mean, explains."""
    columns = _harmonic_columns(times_s, frequency_hz)
    residual_m = clearance_change_m - columns @ np.linalg.lstsq(columns, clearance_change_m, rcond=None)[0]
    return 1 - float(np.var(residual_m)) / max(float(np.var(clearance_change_m)), 1e-300)


def _fitted_modulation(
    contact_name: str,
    times_s: Float[np.ndarray, " times"],
    clearance_change_m: Float[np.ndarray, " times"],
    frequency_hz: float,
    share: float,
) -> ClearanceModulation:
    """Modulation near a frequency: mean + a cos + b sin, and the frequency by one Gauss-Newton step from there; errors
    by the scatter of sixteenths of the record, as what the law leaves is coloured."""
    columns = _harmonic_columns(times_s, frequency_hz)
    _, cosine_m, sine_m = np.linalg.lstsq(columns, clearance_change_m, rcond=None)[0]
    by_frequency = 2 * np.pi * times_s * (sine_m * columns[:, 1] - cosine_m * columns[:, 2])
    jacobian = np.column_stack([columns, by_frequency])
    influence = np.linalg.pinv(jacobian).T
    solution = influence.T @ clearance_change_m
    _, cosine_m, sine_m, frequency_step_hz = solution
    residual_m = clearance_change_m - jacobian @ solution
    amplitude_m = float(np.hypot(cosine_m, sine_m))
    scores = cluster_scores(influence, residual_m)
    amplitude_scores = scores @ np.array([0.0, cosine_m, sine_m, 0.0]) / max(amplitude_m, 1e-300)
    amplitude_error_m, frequency_error_hz = (float(np.sqrt(np.sum(s**2))) for s in (amplitude_scores, scores[:, 3]))
    return ClearanceModulation(
        contact_name, amplitude_m, amplitude_error_m, float(frequency_hz + frequency_step_hz), frequency_error_hz, share
    )


def _harmonic_columns(times_s: Float[np.ndarray, " times"], frequency_hz: float) -> Float[np.ndarray, "times 3"]:
    """Ones, cosine and sine."""
    phase_rad = 2 * np.pi * frequency_hz * times_s
    return np.stack([np.ones_like(phase_rad), np.cos(phase_rad), np.sin(phase_rad)], axis=1)
