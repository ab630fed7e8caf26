"""Null simulations: machines drawn within the tolerances of the nominal rig, their forces and measured channels.

A free decay is simulated by a blow or a release, which the record does not hold, before it begins.

Notes for maintainers
1. Every value is off by its own draw (Latin hypercube over the tolerances), each mode in frequency and damping. The
   force has the measured spectrum with random phases; a hammer's force is taken as it is.
2. Of a free decay, short simulations of the nominal rig scale half-sine blows of several durations, and a force that
   is released, to the largest motion that counts; that of the closest spectrum is taken, and the record begins up to
   a period after it. High-passes run before that: one that begins with the record drifts for seconds.
3. A simulation counts for as long as the record does, as -2 ln p grows with the number of samples.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace
from scipy.stats import norm, qmc

from identify.gaps.decision.channel_errors import ChannelErrors, with_channel_errors
from identify.gaps.decision.recordings import cut_recording
from identify.gaps.residual.law import LEAST_CLEARANCE_FACTOR
from identify.gaps.residual.record import Record
from identify.gaps.residual.shaken_base import with_inertial_force
from rig.model.description import ON_GROUND, Body, Contact, Rig, Sensor, Station, contact_stations
from rig.model.modes import mode_count, modes_of, participation_or_empty
from rig.model.structure import SAME_PLACE_M, structure_of
from rig.model.tolerances import Tolerances
from rig.recording import Recording, Signals
from rig.recording.interfaces import Simulate

FORCE_ONSET_S = 0.1
"""Onset of the null's force, s. Set by hand."""
IMPULSE_ENERGY_SHARE, IMPULSE_SAMPLE_SHARE = 0.9, 0.1
"""A force is impulsive where a smaller share of the samples than the second holds the first share of the energy.
Derived: 0.45 of Gaussian noise, 0.27 of its bursts."""

DRAWN_MODE_COUNT = 24
"""Number of modes of a drawn beam: as many as the plant `modal` is given in a replay."""
SHAPE_POSITION_COUNT = 41
"""Positions at which its mode shapes are given, beside those of sensors, forces, contacts and loads."""


def standard_normals(rig: Rig, simulation_count: int) -> Float[np.ndarray, "simulations draws"]:
    """Standard normal draws for every tolerance (Latin hypercube)."""
    draw_count = 512 + 8 * len(rig.sensors)
    return np.asarray(norm.ppf(qmc.LatinHypercube(draw_count, seed=7).random(simulation_count)))


def draw_rig(rig: Rig, tolerances: Tolerances, normals: Float[np.ndarray, " draws"]) -> Rig:
    """Draw a rig: every value is off by its tolerance times the next of the standard normal draws.

    A beam becomes a structure with a frequency and a damping ratio of its own for each mode. The extra high-pass of an
    AC-coupled sensor is added to its corner frequency. The gains of several forces are not part of the rig (see
    `channel_errors`).
    """
    next_normals = iter(normals.tolist())
    drawn_sensors = []
    drawn_stations = {ON_GROUND: ON_GROUND}
    for sensor in rig.sensors:
        sensor_tolerances, station = tolerances.of_sensor(sensor.name), sensor.station
        if station not in drawn_stations:  # sensors at one station sit on one block
            drawn_position_m = station.position_m + sensor_tolerances.position_m * next(next_normals)
            position_m = float(np.clip(drawn_position_m, 0.0, rig.body(station.body).length_m))
            drawn_stations[station] = Station(station.body, position_m)
        gain = sensor.gain * (1 + sensor_tolerances.gain * next(next_normals))
        delay_s = sensor.delay_s + sensor_tolerances.delay_s * next(next_normals)
        added_corner_hz = abs(sensor_tolerances.high_pass_hz * next(next_normals)) * sensor.measures.ac_coupled
        drawn_sensors.append(
            replace(
                sensor,
                station=drawn_stations[station],
                fibre_m=rig.fibre_m(sensor) or None,  # a structure does not know how thick it is
                gain=gain,
                delay_s=delay_s,
                high_pass_hz=sensor.high_pass_hz + added_corner_hz,
            )
        )
    force_gain = rig.force_sensor.gain * (1 + tolerances.force_gain * next(next_normals) * (len(rig.forces) == 1))
    contacts = tuple(_draw_contact(contact, tolerances, next_normals) for contact in rig.contacts)
    bodies = tuple(_draw_body(rig, body, drawn_sensors, tolerances, next_normals) for body in rig.bodies)
    modal_bodies = {body.name for body in bodies if not body.is_mass}
    return replace(
        rig,
        bodies=bodies,
        sensors=tuple(drawn_sensors),
        contacts=contacts,
        force_sensor=replace(rig.force_sensor, gain=force_gain),
        masses=tuple(mass for mass in rig.masses if mass.station.body not in modal_bodies),
        springs=tuple(_springs_beyond_modes(rig, modal_bodies)),
        supports=(),
        clamps=(),
    )


def simulated_machines(
    measured_recording: Recording, rig: Rig, channel_errors: ChannelErrors, simulate: Simulate, machine_count: int
) -> Iterator[Recording]:
    """Recordings of machines like `rig`, each off by its own draw of the tolerances, under the measured forces."""
    measured_rig, forces_n = measured_recording.rig, measured_recording.forces_n
    for seed, normals in enumerate(standard_normals(measured_rig, machine_count)):
        drawn_rig = draw_rig(rig, channel_errors.tolerances, normals)
        yield with_channel_errors(simulate(measured_rig, drawn_rig, forces_n, seed), channel_errors, seed)


def _springs_beyond_modes(rig: Rig, modal_bodies: set[str]) -> Iterator[object]:
    """Springs, without those parts that the modes of a body already contain."""
    for spring in rig.springs:
        if spring.station.body not in modal_bodies:
            yield spring
        elif spring.cubic_n_per_m3:
            yield replace(spring, stiffness_n_per_m=0.0, rotational_n_m_per_rad=0.0)


def _draw_contact(contact: Contact, tolerances: Tolerances, next_normals: Iterator[float]) -> Contact:
    law = contact.law
    clearance_factor = max(LEAST_CLEARANCE_FACTOR, 1 + tolerances.clearance * next(next_normals))
    stiffness_factor = max(0.01, 1 + tolerances.stiffness * next(next_normals))
    damping_n_s_per_m = tolerances.contact_damping_s * law.stiffness_n_per_m * abs(next(next_normals))
    drawn_law = replace(
        law,
        lower_clearance_m=law.lower_clearance_m * clearance_factor,
        upper_clearance_m=law.upper_clearance_m * clearance_factor,
        stiffness_n_per_m=law.stiffness_n_per_m * stiffness_factor,
        damping_n_s_per_m=law.damping_n_s_per_m + damping_n_s_per_m,
    )
    return replace(contact, law=drawn_law)


def _draw_body(
    rig: Rig, body: Body, sensors: list[Sensor], tolerances: Tolerances, next_normals: Iterator[float]
) -> Body:
    mass_factor = 1 + tolerances.mass * next(next_normals)
    frequency_change, log_damping = tolerances.frequency * next(next_normals), tolerances.damping * next(next_normals)
    if body.is_mass:
        drawn_mass = body.scale_mass(mass_factor).scale_frequencies(1 + frequency_change)
        return drawn_mass.scale_damping(float(np.exp(log_damping)))
    modes, count = modes_of(rig, body), mode_count(body, DRAWN_MODE_COUNT)
    mode_tolerances = [tolerances.of_mode(body.name, mode + 1) for mode in range(count)]
    frequency_factors = np.array(
        [1 + frequency_change + mode.frequency * next(next_normals) for mode in mode_tolerances]
    )
    damping_factors = np.exp([log_damping + mode.damping * next(next_normals) for mode in mode_tolerances])
    natural_hz = modes.frequencies_hz(count) * frequency_factors
    sorting = np.argsort(natural_hz)
    needed_stations = [*rig.forces, *(sensor.station for sensor in (*sensors, *rig.sensors))]
    needed_stations += [load.station for load in rig.loads]
    needed_stations += [station for contact in rig.contacts for station in contact_stations(contact)]
    needed_positions_m = [station.position_m for station in needed_stations if station.body == body.name]
    positions_m = np.unique([*body.places(SHAPE_POSITION_COUNT), *needed_positions_m])
    positions_m = positions_m[np.append(np.diff(positions_m) > SAME_PLACE_M, True)]
    shapes = modes.shapes(positions_m, count) / np.sqrt(mass_factor)
    participations = np.sqrt(mass_factor) * participation_or_empty(rig, body, modes, count)
    damping_ratios = np.minimum(modes.damping_ratios(count) * damping_factors, 0.9)
    drawn_body = structure_of(
        body.name, body.length_m, natural_hz[sorting], damping_ratios[sorting], positions_m, shapes[:, sorting]
    )
    ordered_participations = participations[sorting] if participations.size else participations
    return replace(drawn_body, participations=tuple(ordered_participations.tolist()))


def is_impulsive(force_n: Float[np.ndarray, " samples"]) -> bool:
    """True for a hammer's force, or none: it is simulated as measured, as random phases would make it noise."""
    energy = np.cumsum(np.sort(force_n**2)[::-1])
    return bool(np.searchsorted(energy, IMPULSE_ENERGY_SHARE * energy[-1]) < IMPULSE_SAMPLE_SHARE * force_n.size)


def phase_randomized(
    force_n: Float[np.ndarray, " samples"], silent_sample_count: int, sample_rate_hz: float, rng: np.random.Generator
) -> Float[np.ndarray, " samples"]:
    """Force of the same spectrum with random phases, after `silent_sample_count` zeros."""
    excited_n = force_n[silent_sample_count:]
    spectrum = np.fft.rfft(excited_n)
    phase_factors = np.exp(2j * np.pi * rng.uniform(size=spectrum.size))
    randomized_n = np.fft.irfft(np.abs(spectrum) * phase_factors, excited_n.size)
    onset_sample_count = min(round(FORCE_ONSET_S * sample_rate_hz), excited_n.size)
    randomized_n[:onset_sample_count] *= np.sin(np.linspace(0, np.pi / 2, onset_sample_count)) ** 2
    return np.concatenate([np.zeros(silent_sample_count), randomized_n])


BLOW_DURATIONS_IN_PERIODS = tuple(2.0**-k for k in (1, 2, 3, 4, 5))
"""Durations of the blow, in longest periods of the rig: short blows excite higher modes. Effort."""
RELEASE_IN_PERIODS = 4
"""Longest periods over which a force rises that is then released: slowly enough to excite no mode before. Set by
hand."""
SCALING_STEP_COUNT = 4
"""Number of short simulations that scale each excitation. Effort."""
REPRODUCED_MOTION_S = 8
"""Beginning of the counted motion, s, which the excitation reproduces. Set by hand."""
LARGE_MOTION_EXPONENT = 8
"""Exponent of the mean over time that excitations are scaled by: the largest motion decides what contacts do, and a
mean over a decay of wrong damping does not tell it. Set by hand."""


def null_simulator(measured_recording: Recording, record: Record, simulate: Simulate) -> Simulate:
    """Simulator of a recording's test: with its force, by its shaken base, or of its free decay."""
    if record.base is not None:
        return ShakenBaseSimulator(simulate)
    return simulate if record.has_force else FreeDecaySimulator(measured_recording, record, simulate)


@dataclass(frozen=True)
class ShakenBaseSimulator:
    """Simulator of rigs on a shaken base, whose force is what the sensor on the base shows of it."""

    simulate: Simulate

    def __call__(
        self, rig: Rig, actual_rig: Rig, forces_n: Float[np.ndarray, "forces samples"], seed: int
    ) -> Recording:
        return with_inertial_force(self.simulate(rig, actual_rig, forces_n, seed))


@dataclass(frozen=True)
class FreeDecaySimulator:
    """Simulator of free decays as long as the measured one, which ignores the force.

    The excitation, at the place of the first force, is the half-sine or the released force after which the nominal
    rig's largest counted motion is the measured one's and its spectrum the closest, octave by octave. A decay begins up
    to one period after it, depending on the seed.
    """

    measured: Recording
    record: Record
    simulate: Simulate

    def __call__(
        self, rig: Rig, actual_rig: Rig, forces_n: Float[np.ndarray, "forces samples"], seed: int
    ) -> Recording:
        return self._decay_recording(rig, actual_rig, self.excitation_n, forces_n.shape[1], seed)

    def __getstate__(self) -> dict[str, object]:
        """State with the excitation, which is not to be scaled again in every worker process."""
        return self.__dict__ | {"excitation_n": self.excitation_n}

    @cached_property
    def excitation_n(self) -> Float[np.ndarray, " begin"]:
        """Excitation before the decay, scaled by short simulations of the nominal rig when it is first needed."""
        period_samples = self._longest_period_samples
        blow_sample_counts = [max(2, round(periods * period_samples)) for periods in BLOW_DURATIONS_IN_PERIODS]
        unit_pulses = [np.sin(np.pi * np.arange(samples) / samples) for samples in blow_sample_counts]
        unit_pulses.append(np.sin(np.linspace(0, np.pi / 2, RELEASE_IN_PERIODS * period_samples)) ** 2)
        return min(map(self._spectrum_distance_and_excitation, unit_pulses), key=lambda scaled: scaled[0])[1]

    @property
    def _longest_period_samples(self) -> int:
        rig = self.measured.rig
        natural_hz = np.concatenate([modes_of(rig, body).frequencies_hz(body.max_modes) for body in rig.bodies])
        lowest_hz = float(np.min(natural_hz[natural_hz > 0], initial=np.inf))
        return round(rig.sample_rate_hz / max(lowest_hz, 1.0))

    def _decay_recording(
        self, rig: Rig, actual_rig: Rig, excitation_n: Float[np.ndarray, " begin"], decay_sample_count: int, seed: int
    ) -> Recording:
        delay_sample_count = round(self._longest_period_samples * np.random.default_rng([seed, 78]).uniform())
        decay_start = excitation_n.size + delay_sample_count
        forces_n = np.zeros((len(rig.forces), decay_start + decay_sample_count))
        forces_n[0, : excitation_n.size] = excitation_n
        recording = self.simulate(rig, actual_rig, forces_n, seed)
        return _with_zero_force(cut_recording(recording, slice(decay_start, decay_start + decay_sample_count)))

    def _spectrum_distance_and_excitation(
        self, pulse: Float[np.ndarray, " begin"]
    ) -> tuple[float, Float[np.ndarray, " begin"]]:
        """Distance between the spectra, and the scaled excitation."""
        rig, rate_hz, start_s = self.measured.rig, self.record.sample_rate_hz, float(self.record.residual_times_s[0])
        sample_count = min(round((start_s + REPRODUCED_MOTION_S) * rate_hz), self.measured.samples)
        counted = slice(round(start_s * rate_hz), sample_count)
        measured_motion = _sensor_motion(self.measured, counted)
        excitation_n = rig.body(rig.forces[0].body).mass_kg * pulse
        for _ in range(SCALING_STEP_COUNT):
            simulated_motion = _sensor_motion(self._decay_recording(rig, rig, excitation_n, sample_count, 0), counted)
            excitation_n = excitation_n * _largest_motion(measured_motion) / _largest_motion(simulated_motion)
        simulated_levels, measured_levels = (
            _octave_log_rms(motion, rate_hz, self.record.highest_hz) for motion in (simulated_motion, measured_motion)
        )
        return float(np.linalg.norm(simulated_levels - measured_levels)), excitation_n


def _sensor_motion(recording: Recording, counted_slice: slice) -> Float[np.ndarray, "sensors samples"]:
    """Signals of all sensors of the last sensor's quantity, without their means."""
    signals = recording.signals[recording.rig.sensors[-1].quantity].values[:, counted_slice]
    return np.asarray(signals - signals.mean(axis=1, keepdims=True))


def _largest_motion(sensor_signals: Float[np.ndarray, "sensors samples"]) -> float:
    """Generalised mean of the magnitude over time, near its largest values."""
    magnitude = np.linalg.norm(sensor_signals, axis=0)
    peak = max(float(magnitude.max()), 1e-300)
    return peak * float(np.mean((magnitude / peak) ** LARGE_MOTION_EXPONENT)) ** (1 / LARGE_MOTION_EXPONENT)


def _octave_log_rms(
    sensor_signals: Float[np.ndarray, "sensors samples"], rate_hz: float, highest_hz: float
) -> Float[np.ndarray, " octaves"]:
    """Logarithm of the rms of all sensors in each octave below a frequency."""
    sample_count = sensor_signals.shape[1]
    fade = np.hanning(2 * sample_count)[sample_count:]
    line_power = np.sum(np.abs(np.fft.rfft(sensor_signals * fade, axis=1)) ** 2, axis=0)[1:]
    lines_hz = np.fft.rfftfreq(sample_count, 1 / rate_hz)[1:]
    is_below = lines_hz <= highest_hz
    octave_indices = np.floor(np.log2(highest_hz / lines_hz[is_below])).astype(int)
    return np.asarray(0.5 * np.log(np.maximum(np.bincount(octave_indices, line_power[is_below]), 1e-300)))


def _with_zero_force(recording: Recording) -> Recording:
    force_signals = recording.signals["force"]
    zero_force = Signals(force_signals.channels, force_signals.start_s, np.zeros_like(force_signals.values))
    return Recording(recording.rig, {**recording.signals, "force": zero_force}, recording.provenance)
