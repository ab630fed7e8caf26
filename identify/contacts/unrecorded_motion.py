"""Motion of the contacts beyond the recorded band, which no sensor shows.

A stop that closes excites all modes. Beyond the band in which the sensors can be trusted, the modes of rig.json move
the contacts by

    eta_j = sum_i G_ji f_i / omega^2

with the accelerances G of the relative motion and the forces f_i of the fitted laws, at the rate at which laws are
evaluated. Where that is no small share of the depth to which a contact closes, clearance and stiffness may be off by
more than their intervals: the law is fitted to the recorded motion alone.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from scipy.fft import rfft, rfftfreq

from identify.contacts.joint_fit import JointEstimate
from identify.contacts.separation import Separation
from identify.linear.model import ResponseCache, real_product, relative_shapes, response_of
from identify.signals.law_evaluation import interpolated, oversampling

SECTION_SAMPLES = 1 << 14
"""Samples of the record that are looked at: those in which the contacts push most. Effort."""
TINY_POWER = 1e-300
"""Power by which a force that is zero throughout is divided."""


def beyond_band_motion_shares(separation: Separation, estimates: Mapping[str, JointEstimate]) -> dict[str, float]:
    """Motion (rms) of each identified contact beyond the recorded band, over its depth (rms) while it is closed."""
    contacts, records = separation.rig.contacts, separation.records
    rate_hz, section = records[0].sample_rate_hz, _strongest_force_section(separation)
    depths_m, force_by_contact = dict[str, float](), dict[int, Float[np.ndarray, " fine"]]()
    for group, record in zip(separation.contact_groups, records, strict=True):
        for contact_index, sign in zip(group.contact_indices, group.signs, strict=True):
            if estimate := estimates.get(contacts[contact_index].name):
                eta_m = interpolated(sign * (record.eta_m + estimate.drift_m)[section], rate_hz)
                velocity = interpolated(sign * (record.velocity_m_per_s + estimate.drift_m_per_s)[section], rate_hz)
                force_by_contact[contact_index] = estimate.force_n(eta_m, velocity)
                if np.any(depth_m := estimate.spring_force_over_stiffness_m(eta_m)):
                    depths_m[contacts[contact_index].name] = float(np.sqrt(np.mean(depth_m[depth_m != 0] ** 2)))
    if not depths_m:
        return {}
    unseen_m = _rms_beyond_band_m(separation, force_by_contact, rate_hz * oversampling(rate_hz))
    names = [contact.name for contact in contacts]
    return {name: float(unseen_m[names.index(name)] / depth_m) for name, depth_m in depths_m.items()}


def _strongest_force_section(separation: Separation) -> slice:
    """Samples in which the separated forces have most power, each over its own in the record."""
    records = separation.records
    powers = [record.force_n**2 / max(float(np.sum(record.force_n**2)), TINY_POWER) for record in records]
    power = np.sum(powers, axis=0)
    count = max(1, min(SECTION_SAMPLES // records[0].decimation, power.size))
    power_so_far = np.concatenate([[0.0], np.cumsum(power)])
    first = int(np.argmax(power_so_far[count:] - power_so_far[:-count])) * records[0].decimation
    return slice(first, first + min(SECTION_SAMPLES, records[0].eta_m.size))


def _rms_beyond_band_m(
    separation: Separation, force_by_contact: Mapping[int, Float[np.ndarray, " fine"]], fine_rate_hz: float
) -> Float[np.ndarray, " contacts"]:
    """Relative displacement of every contact (rms, m) beyond the recorded band by these contact forces."""
    forces_n, force_indices = np.stack(list(force_by_contact.values())), list(force_by_contact)
    window, sample_count = np.hanning(forces_n.shape[1]), forces_n.shape[1]
    frequency_hz = rfftfreq(sample_count, 1 / fine_rate_hz)
    is_beyond = frequency_hz > separation.motion.trusted_hz[1]
    omega, spectra = 2 * np.pi * frequency_hz[is_beyond], rfft(forces_n * window)[:, is_beyond]
    rig, cache = separation.rig, ResponseCache(omega, 0)
    accelerations = np.zeros((len(rig.contacts), omega.size), dtype=complex)
    for response in (response_of(rig, body, cache) for body in rig.bodies):
        shapes = relative_shapes(rig, response)
        modal_forces = real_product(shapes[force_indices].T, spectra)
        accelerations += real_product(shapes, response.accelerance * modal_forces)
    power = 2 * np.sum(np.abs(accelerations / omega**2) ** 2, axis=1) / sample_count
    return np.asarray(np.sqrt(power / np.sum(window**2)))
