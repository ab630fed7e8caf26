"""First frequency of each body that touches nothing, from free motion or from responses to a broad force."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from scipy.fft import rfft, rfftfreq
from scipy.signal.windows import hann

from identify.checks.findings import Finding
from rig.model.description import Body, Rig, Sensor, contact_stations
from rig.model.modes import modes_of
from rig.recording import Recording

MAX_FREQUENCY_FACTOR = 3.0
"""The first frequency is sought up to this factor beside that of rig.json."""
MIN_FREQUENCY_ERROR = 0.2
"""Smallest error of a first frequency that is named here: roughly is enough, and what is less others find."""
SAME_FREQUENCY, NEIGHBOURHOOD_FACTOR, MIN_PROMINENCE = 0.1, 1.5, 30.0
"""Relative width of a peak; factor of frequency to either side within which its power is compared with the usual one;
least ratio of both."""
MIN_SHAPE_AGREEMENT, COMPARED_MODES = 0.9, 5
"""Least modal assurance of a peak's shape with the first mode, and the modes that it is compared with."""
MIN_PERIODS, FREE_SEGMENTS, FORCED_SEGMENTS = 12.0, 2, 4
"""Periods of the first mode in a segment, and segments of free motion and of motion under a force."""
ACTING_SHARE, MIN_DRIVEN_SHARE, MIN_DRIVEN_LINES = 0.02, 1e-3, 0.8
"""Share of its peak from which on a force acts; share of its largest power density with which it drives a line, and
least share of the lines that it drives where the mode is sought."""


@dataclass(frozen=True)
class _Responses:
    """Responses of a body's sensors as velocities, or their ratios to a force: spectra of several segments."""

    line_hz: Float[np.ndarray, " lines"]
    spectra: Complex[np.ndarray, "sensors lines segments"]

    @property
    def power(self) -> Float[np.ndarray, " lines"]:
        return np.asarray(np.sum(np.abs(self.spectra) ** 2, axis=(0, 2)))

    def peak_lines(self, low_hz: float, high_hz: float) -> Iterator[int]:
        """Lines of the prominent peaks between two frequencies."""
        for k in np.flatnonzero((self.line_hz > low_hz) & (self.line_hz < high_hz)).tolist():
            ratios = self.line_hz / self.line_hz[k]
            is_near = np.abs(ratios - 1) < SAME_FREQUENCY
            is_beside = ~is_near & (ratios < NEIGHBOURHOOD_FACTOR) & (ratios > 1 / NEIGHBOURHOOD_FACTOR)
            is_highest = self.power[k] >= self.power[is_near].max()
            if is_highest and is_beside.any() and self.power[k] > MIN_PROMINENCE * np.median(self.power[is_beside]):
                yield k

    def shape(self, line: int) -> Float[np.ndarray, " sensors"]:
        """Real shape of the motion at a line."""
        left_vectors, _, _ = np.linalg.svd(self.spectra[:, line], full_matrices=False)
        vector = left_vectors[:, 0]
        return np.asarray((vector * np.exp(-0.5j * np.angle(np.sum(vector**2)))).real)


def first_mode_findings(recording: Recording) -> Iterator[Finding]:
    """Findings on bodies of a plane rig whose first elastic mode lies elsewhere than rig.json has it.

    A body that meets stops or springs of others is left out, as its frequencies change with what it touches.
    """
    rig = recording.rig
    touched_names = {station.body for contact in rig.contacts for station in contact_stations(contact)}
    touched_names |= {spring.station.body for spring in rig.springs if spring.cubic_n_per_m3}
    for body in rig.bodies:
        sensors = _sensors_of_one_quantity(rig, body)
        if body.name not in touched_names and sensors:
            finding = _first_mode_finding(recording, body, sensors)
            if finding is not None:
                yield finding


def _sensors_of_one_quantity(rig: Rig, body: Body) -> list[Sensor]:
    """Sensors of a body of that quantity of motion of which it has most."""
    sensors = [s for s in rig.sensors if s.station.body == body.name and s.measures.translates]
    by_quantity = ([s for s in sensors if s.quantity == quantity] for quantity in {s.quantity for s in sensors})
    return max(by_quantity, key=len, default=[])


def _first_mode_finding(recording: Recording, body: Body, sensors: Sequence[Sensor]) -> Finding | None:
    """Finding if no peak is the first mode where rig.json has it, and one is elsewhere."""
    modes = modes_of(recording.rig, body)
    mode_count = min(body.rigid_modes + COMPARED_MODES, body.max_modes)
    natural_hz = modes.frequencies_hz(mode_count)
    positions_m = np.array([sensor.station.position_m for sensor in sensors])
    shapes, first = modes.shapes(positions_m, mode_count), int(np.argmax(natural_hz > 0))
    stated_hz = float(natural_hz[first])
    responses = _responses(recording, sensors, stated_hz) if stated_hz else None
    if responses is None:
        return None
    found_hz = []
    high_hz = min(MAX_FREQUENCY_FACTOR * stated_hz, 0.4 * recording.rig.sample_rate_hz)
    for line in responses.peak_lines(stated_hz / MAX_FREQUENCY_FACTOR, high_hz):
        line_hz, shape = float(responses.line_hz[line]), responses.shape(line)
        agreements = [_agreement(shape, mode_shape) for mode_shape in shapes.T]
        is_another = len(sensors) == 1 and np.any(np.abs(natural_hz[first + 1 :] / line_hz - 1) < SAME_FREQUENCY)
        if agreements[first] > MIN_SHAPE_AGREEMENT and agreements[first] >= max(agreements) and not is_another:
            found_hz.append(line_hz)
    errors = [abs(line_hz / stated_hz - 1) for line_hz in found_hz]
    if not found_hz or min(errors) < MIN_FREQUENCY_ERROR:
        return None
    return Finding(
        cause="frequency",
        of=body.name,
        evidence=f"mode {first + 1} of {body.name} is at {found_hz[0]:.2g} Hz, rig.json has {stated_hz:.2g} Hz",
        mend="correct its stiffness and clamp, or the masses on it that rig.json leaves out",
    )


def _agreement(shape: Float[np.ndarray, " sensors"], other: Float[np.ndarray, " sensors"]) -> float:
    """Modal assurance of two shapes, between 0 and 1."""
    return float((shape @ other) ** 2 / max(float((shape @ shape) * (other @ other)), 1e-300))


def _responses(recording: Recording, sensors: Sequence[Sensor], stated_hz: float) -> _Responses | None:
    """Responses of sensors after the force, or else to it; None if neither tells a first mode."""
    rate_hz, forces_n = recording.rig.sample_rate_hz, recording.forces_n
    signals = np.stack([recording.values_of(sensor) for sensor in sensors])
    orders = sensors[0].measures.order
    free_from = _first_free_sample(forces_n)
    min_samples = round(MIN_PERIODS * rate_hz / stated_hz)
    free_samples = (recording.samples - free_from) // FREE_SEGMENTS
    if free_samples >= min_samples:
        line_hz, spectra = _segment_spectra(signals[:, free_from:], rate_hz, free_samples)
        return _Responses(line_hz, spectra * (2j * np.pi * line_hz[:, None]) ** (1 - orders))
    forced_samples = recording.samples // FORCED_SEGMENTS
    if len(forces_n) > 1 or forced_samples < min_samples:
        return None
    line_hz, spectra = _segment_spectra(np.concatenate([forces_n, signals]), rate_hz, forced_samples)
    force_power = np.mean(np.abs(spectra[0]) ** 2, axis=-1)
    is_driven = force_power > MIN_DRIVEN_SHARE * force_power.max()
    is_sought = (line_hz > stated_hz / MAX_FREQUENCY_FACTOR) & (line_hz < MAX_FREQUENCY_FACTOR * stated_hz)
    if np.mean(is_driven[is_sought]) < MIN_DRIVEN_LINES:
        return None
    h1 = np.mean(spectra[1:] * spectra[0].conj(), axis=-1, keepdims=True) / np.maximum(force_power, 1e-300)[:, None]
    return _Responses(line_hz, h1 * is_driven[:, None] * (2j * np.pi * line_hz[:, None]) ** (1 - orders))


def _first_free_sample(forces_n: Float[np.ndarray, "forces samples"]) -> int:
    """First sample after which no force acts."""
    sizes_n = np.abs(forces_n)
    is_acting = (sizes_n > ACTING_SHARE * sizes_n.max(axis=1, keepdims=True)).any(axis=0)
    return int(is_acting.size - np.argmax(is_acting[::-1])) if is_acting.any() else 0


def _segment_spectra(
    signals: Float[np.ndarray, "rows samples"], rate_hz: float, segment_samples: int
) -> tuple[Float[np.ndarray, " lines"], Complex[np.ndarray, "rows lines segments"]]:
    """Spectra above 0 Hz of segments that overlap by half, under a Hann window, without means."""
    centred = signals - signals.mean(axis=1, keepdims=True)
    starts = range(0, signals.shape[1] - segment_samples + 1, max(1, segment_samples // 2))
    segments = np.stack([centred[:, start : start + segment_samples] for start in starts], axis=-1)
    windowed = segments * hann(segment_samples, sym=False)[:, None]
    return rfftfreq(segment_samples, 1 / rate_hz)[1:], rfft(windowed, axis=1)[:, 1:]
