"""A recording as the diagnosis reads it: the spectra of force and accelerations, and how far noise explains them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import uniform_filter1d

from identify.contacts.separation import drift_of
from identify.gaps.residual.channel_noise import force_noise_n, read_sensors, sensor_densities
from identify.gaps.residual.extent import (
    LEAST_S,
    REACH,
    Beginning,
    beginning_of,
    check_length,
    decayed_s,
    high_hz_of,
    is_free,
)
from identify.gaps.residual.record import Record
from identify.gaps.residual.ringing import MeasuredMode, measured_modes
from identify.linear.joined import joined
from identify.signals.drift import Drift
from identify.signals.kinematics import CORNER_HZ, integrated, kinematics, taper
from identify.signals.noise import acceleration_noise
from rig.model.description import Rig, Sensor
from rig.model.modes import modes_of
from rig.model.sensing import PASSBAND
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording
from rig.recording.period import period_of

RING_S, LONGEST_RING_S, DECAY_TIMES = 12.0, 60.0, 20.0
"""Silence behind the record in which the beams ring down before the transform wraps round; where no contacts take part
until the slowest mode, of two fifths of its damping, is 3e-4 of what it was, but no longer than the second."""
SMOOTHED_HZ = 1.0


@dataclass(frozen=True)
class _Transform:
    """Samples under a window with silence behind, so many together, and the lines that stand for every `factor`-th."""

    sample_rate_hz: float
    length: int
    factor: int
    window: Float[np.ndarray, " samples"]

    @property
    def lines(self) -> int:
        return self.length // self.factor // 2 + 1

    @property
    def omega(self) -> Float[np.ndarray, " lines"]:
        omega = 2 * np.pi * np.arange(self.lines) * self.sample_rate_hz / self.length
        omega[0] = 0.01 * omega[1]  # stands for the mean, which powers of omega would lose
        return omega

    @property
    def omega_beyond(self) -> Float[np.ndarray, " morelines"]:
        """Circular frequencies from the last of the lines to half the sample rate."""
        return 2 * np.pi * self.sample_rate_hz / self.length * np.arange(self.lines - 1, self.length // 2 + 1)

    def spectrum(self, signal: Float[np.ndarray, "*rows samples"]) -> Complex[np.ndarray, "*rows all"]:
        return np.asarray(rfft(signal * self.window, self.length))


def record_of(
    recording: Recording,
    low_hz: float = CORNER_HZ,
    tolerances: Tolerances | None = None,
    counted_until_s: float | None = None,
) -> Record:
    """The spectra of a recording's accelerometers; without any, of its velocity or else its displacement sensors.

    In a free decay its displacement sensors come first, or else those of the velocity. It counts until it has decayed,
    or as long as another record does.

    Raises RigError if it is too short or has no sensors.
    """
    rig, rate, samples = recording.rig, recording.rig.sample_rate_hz, recording.samples
    joint, tolerances = joined(rig), tolerances or rig.tolerances or LABORATORY
    sensors = read_sensors(recording)
    beginning = beginning_of(recording, sensors)
    check_length(recording, beginning)
    densities = sensor_densities(recording, sensors, beginning.quiet_samples)
    high_hz = high_hz_of(recording, sensors, densities, tolerances, low_hz)
    modes: tuple[MeasuredMode, ...] = ()
    if beginning.from_the_blow and not rig.contacts:
        modes = measured_modes(np.stack([recording.values_of(s) for s in sensors]), rate, high_hz, densities)
        high_hz = min(high_hz, REACH * max((m.frequency_hz for m in modes), default=np.inf))
    transform = _transform(recording, beginning, high_hz)
    omega = transform.omega
    measured, eta_beyond = _spectra(recording, transform, joint, sensors)
    turned, twice_less = (
        np.stack([integrated(omega, order - s.measures.order, low_hz) for s in sensors]) for order in (2, 0)
    )
    faded, delivered = _faded(recording, transform, sensors, omega, beginning.zero_known)
    delivered += measured * turned
    period = _period_of(recording.forces_n[:, beginning.excited_from :])
    size = np.stack([omega ** (2 - s.measures.order) for s in sensors])
    return Record(
        rig=rig,
        sensors=sensors,
        zero_known=beginning.zero_known,
        sample_rate_hz=rate,
        length=transform.length,
        samples=samples,
        factor=transform.factor,
        window=transform.window,
        omega=omega,
        forces=transform.spectrum(recording.forces_n)[:, : omega.size],
        delivered=delivered,
        displaced=measured * twice_less,
        faded=faded,
        force_noise=samples * force_noise_n(recording, beginning.quiet_samples, tolerances) ** 2,
        noise=samples * (densities[:, None] * size) ** 2 * rate / 2,
        power=_smoothed(delivered, np.stack([_by_force(rig, s, omega) for s in sensors]), transform),
        eta_beyond=eta_beyond,
        drifts=_drifts(recording, joint, sensors, tolerances, beginning),
        excited_s=beginning.excited_from / rate,
        period_s=None if period is None else period / rate,
        tolerances=tolerances,
        from_the_blow=beginning.from_the_blow,
        modes=modes,
        taken=_taken(samples, transform, beginning, delivered, counted_until_s),
        windows_responses=not rig.contacts,
    )


def _transform(recording: Recording, beginning: Beginning, high_hz: float) -> _Transform:
    """Transform with the lines up to a frequency. A record fades out, and in unless it begins quiet or with a blow."""
    rate, samples = recording.rig.sample_rate_hz, recording.samples
    factor = max(1, int(rate / (2 * high_hz)))
    length = factor * next_fast_len(-(-(samples + round(_ring_down_s(recording.rig) * rate)) // factor), real=True)
    window = taper(samples, max(2, round(beginning.faded_s * rate)))
    if beginning.zero_known and not beginning.from_the_blow:  # differentiated twice, a kink in w'' would ring
        window = np.sin(np.pi / 2 * window) ** 2
    if beginning.from_the_blow:
        window[0] = 0.5  # half a sample: what begins there has no value before
    elif not beginning.quiet:
        window = window * window[::-1]
    return _Transform(rate, length, factor, window)


def _ring_down_s(rig: Rig) -> float:
    """Seconds that a rig may ring on behind the record: without contacts until its slowest decay is over."""
    if rig.contacts:
        return RING_S
    rates = []
    for body in rig.bodies:
        modes, count = modes_of(rig, body), body.max_modes
        rates += (2 * np.pi * modes.frequencies_hz(count) * modes.damping_ratios(count)).tolist()
    slowest = min((rate for rate in rates if rate > 0), default=np.inf)
    return float(np.clip(DECAY_TIMES / slowest, RING_S, LONGEST_RING_S))


def _drifts(
    recording: Recording, joint: Rig, sensors: tuple[Sensor, ...], tolerances: Tolerances, beginning: Beginning
) -> tuple[Drift | None, ...]:
    """The slow part of every relative displacement that integration loses, as far as it is known."""
    if not beginning.integrates:
        return (None,) * len(joint.contacts)
    motion = kinematics(recording, sensors[0].quantity, least_order=2)
    noise = acceleration_noise(motion, recording.rig)
    return tuple(drift_of(joint, motion, j, noise, tolerances, recording.samples) for j in range(len(joint.contacts)))


def _spectra(
    recording: Recording, transform: _Transform, joint: Rig, sensors: tuple[Sensor, ...]
) -> tuple[Complex[np.ndarray, "sensors lines"], Complex[np.ndarray, "contacts morelines"]]:
    """Spectra of each sensor on the lines; and beyond them, the relative displacements by sensors at the contacts."""
    omega_beyond = transform.omega_beyond
    eta_beyond = np.zeros((len(joint.contacts), omega_beyond.size), dtype=complex)
    measured = np.empty((len(sensors), transform.lines), dtype=complex)
    for row, sensor in zip(measured, sensors, strict=True):
        whole = transform.spectrum(recording.values_of(sensor))
        row[:] = whole[: transform.lines]
        _add_beyond(eta_beyond, joint, sensor, whole[transform.lines - 1 :], omega_beyond)
    return measured, eta_beyond


def _by_force(rig: Rig, sensor: Sensor, omega: Float[np.ndarray, " lines"]) -> Float[np.ndarray, " lines"]:
    """Approximate fall of a body's acceleration with the frequency under a steady force: omega^2 / (omega^2 +
    omega_1^2) below its first mode, not at all of a free body, nor where accelerations are measured, which then show
    noise.
    """
    body = rig.body(sensor.station.body)
    first = 2 * np.pi * float(np.min(modes_of(rig, body).frequencies_hz(body.max_modes)))
    return omega**2 / (omega**2 + first**2) if sensor.measures.order < 2 else np.ones_like(omega)


def _smoothed(
    delivered: Complex[np.ndarray, "sensors lines"], by_force: Float[np.ndarray, "sensors lines"], transform: _Transform
) -> Float[np.ndarray, "sensors lines"]:
    """The accelerations' power, smoothed as that of the forces which make them."""
    width = max(1, round(SMOOTHED_HZ * transform.length / transform.sample_rate_hz))
    return np.asarray(uniform_filter1d(np.abs(delivered / by_force) ** 2, width, axis=1) * by_force**2)


def _faded(
    recording: Recording,
    transform: _Transform,
    sensors: tuple[Sensor, ...],
    omega: Float[np.ndarray, " lines"],
    zero_known: bool,
) -> tuple[Complex[np.ndarray, "sensors lines"], Complex[np.ndarray, "sensors lines"]]:
    """Differences of the windowed velocity and acceleration from the derivatives of the windowed displacement x:
    w x' = (w x)' - w' x and w x'' = (w x)'' - 2 (w' x)' + w'' x. Of free masses, whose acceleration at any time is that
    of the force then; a body that is held answers a faded force by a motion that is not the faded one."""
    velocity, acceleration = np.zeros((2, len(sensors), omega.size), dtype=complex)
    slope = np.gradient(transform.window) * transform.sample_rate_hz
    bend = np.gradient(slope) * transform.sample_rate_hz
    for k, sensor in enumerate(sensors):
        if zero_known and is_free(recording.rig, sensor.station.body):
            sloped, bent = rfft(np.stack([slope, bend]) * recording.values_of(sensor), transform.length)[
                :, : omega.size
            ]
            velocity[k], acceleration[k] = -sloped, bent - 2j * omega * sloped
    return velocity, acceleration


def _taken(
    samples: int,
    transform: _Transform,
    beginning: Beginning,
    delivered: Complex[np.ndarray, "sensors lines"],
    counted_until_s: float | None,
) -> slice:
    """The samples that count, of every `factor`-th: neither the ends nor what follows when the rig has come to rest."""
    rate_hz = transform.sample_rate_hz / transform.factor
    duration_s = samples / transform.sample_rate_hz
    begin_s, at_end_s = beginning.left_out_s
    if counted_until_s is None:
        rows = irfft(delivered, transform.length // transform.factor)[:, : int(duration_s * rate_hz)]
        counted_until_s = decayed_s(rows, rate_hz)
    end_s = min(duration_s - at_end_s, max(counted_until_s, begin_s + LEAST_S))
    return slice(round(begin_s * rate_hz), int(end_s * rate_hz))


def _period_of(forces_n: Float[np.ndarray, "forces samples"]) -> int | None:
    """After how many samples all forces repeat; None where they do not, or not together."""
    first, *others = {period_of(row) for row in forces_n if np.any(row)} or {None}
    return None if others else first


def _add_beyond(
    eta_beyond: Complex[np.ndarray, "contacts lines"],
    rig: Rig,
    sensor: Sensor,
    measured: Complex[np.ndarray, " lines"],
    omega: Float[np.ndarray, " lines"],
) -> None:
    """Add what a sensor at a contact shows of its relative displacement above the band of the diagnosis."""
    for j, contact in enumerate(rig.contacts):
        for station, sign in ((contact.at, 1.0), (contact.against, -1.0)):
            if sensor.station == station:
                heard = omega <= 2 * np.pi * PASSBAND * rig.sample_rate_hz
                eta_beyond[j] += sign * heard * measured * integrated(omega, -sensor.measures.order, CORNER_HZ)
