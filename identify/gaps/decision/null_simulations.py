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
from dataclasses import replace as with_fields

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace
from scipy.stats import norm, qmc

from identify.gaps.decision.recordings import cut_recording
from identify.gaps.residual.law import LEAST_CLEARANCE_FACTOR
from identify.gaps.residual.record import Record
from rig.model.description import Body, Contact, Rig, Sensor, Station, contact_stations
from rig.model.modes import mode_count, modes_of
from rig.model.structure import SAME_PLACE_M, structure_of
from rig.model.tolerances import Tolerances
from rig.recording import Recording, Signals
from rig.recording.interfaces import Simulate

ONSET_S = 0.1
"""Onset of the null's force, s. Set by hand."""
IMPULSE_ENERGY_SHARE, IMPULSE_SAMPLE_SHARE = 0.9, 0.1
"""A force is impulsive where a smaller share of the samples than the second holds the first share of the energy.
Derived: 0.45 of Gaussian noise, 0.27 of its bursts."""

DRAWN_MODES = 24
"""Number of modes of a drawn beam: as many as the plant `modal` is given in a replay."""
SHAPE_POSITIONS = 41
"""Positions at which its mode shapes are given, beside those of sensors, forces, contacts and loads."""


def standard_normals(rig: Rig, simulation_count: int) -> Float[np.ndarray, "simulations draws"]:
    """Standard normal draws for every tolerance (Latin hypercube)."""
    draws = 512 + 8 * len(rig.sensors)
    return np.asarray(norm.ppf(qmc.LatinHypercube(draws, seed=7).random(simulation_count)))


def draw_rig(rig: Rig, tolerances: Tolerances, normals: Float[np.ndarray, " draws"]) -> Rig:
    """Draw a rig: every value is off by its tolerance times the next of the standard normal draws.

    A beam becomes a structure with a frequency and a damping ratio of its own for each mode. The extra high-pass of an
    AC-coupled sensor is added to its corner frequency. The gains of several forces are not part of the rig (see
    `with_force_noise`).
    """
    normal = iter(normals.tolist())
    sensors = []
    stations: dict[Station, Station] = {}
    for sensor in rig.sensors:
        sensor_tolerances = tolerances.of_sensor(sensor.name)
        if sensor.station not in stations:  # sensors at one station sit on one block
            length_m = rig.body(sensor.station.body).length_m
            position_m = float(
                np.clip(sensor.station.position_m + sensor_tolerances.position_m * next(normal), 0.0, length_m)
            )
            stations[sensor.station] = Station(sensor.station.body, position_m)
        gain, delay_s = 1 + sensor_tolerances.gain * next(normal), sensor_tolerances.delay_s * next(normal)
        corner_hz = abs(sensor_tolerances.high_pass_hz * next(normal)) * sensor.measures.ac_coupled
        chain = {"gain": sensor.gain * gain, "delay_s": sensor.delay_s + delay_s}
        chain["high_pass_hz"] = sensor.high_pass_hz + corner_hz
        fibre_m = rig.fibre_m(sensor) or None  # a structure does not know how thick it is
        sensors.append(replace(sensor, station=stations[sensor.station], fibre_m=fibre_m, **chain))
    gain = rig.force_sensor.gain * (1 + tolerances.force_gain * next(normal) * (len(rig.forces) == 1))
    contacts = tuple(_draw_contact(contact, tolerances, normal) for contact in rig.contacts)
    bodies = tuple(_draw_body(rig, body, sensors, tolerances, normal) for body in rig.bodies)
    modal_bodies = {b.name for b in bodies if not b.is_mass} & {b.name for b in rig.bodies}
    return replace(
        rig,
        bodies=bodies,
        sensors=tuple(sensors),
        contacts=contacts,
        force_sensor=replace(rig.force_sensor, gain=gain),
        masses=tuple(m for m in rig.masses if m.station.body not in modal_bodies),
        springs=tuple(_remaining_springs(rig, modal_bodies)),
        supports=(),
        clamps=(),
    )


def with_crosstalk(recording: Recording, share: float, rng: np.random.Generator) -> Recording:
    """Recording with crosstalk: random shares, of this standard deviation, of the adjacent channels of the same
    quantity."""
    signals = dict(recording.signals)
    for quantity in dict.fromkeys(sensor.quantity for sensor in recording.rig.sensors) if share else ():
        values = signals[quantity].values
        neighbours = np.eye(len(values), k=1) + np.eye(len(values), k=-1)
        mixing = np.eye(len(values)) + share * neighbours * rng.standard_normal(neighbours.shape)
        signals[quantity] = with_fields(signals[quantity], values=mixing @ values)
    return with_fields(recording, signals=signals)


def _remaining_springs(rig: Rig, modal_bodies: set[str]) -> Iterator[object]:
    """Springs, without those parts that the modes of a body already contain."""
    for spring in rig.springs:
        if spring.station.body not in modal_bodies:
            yield spring
        elif spring.cubic_n_per_m3:
            yield replace(spring, stiffness_n_per_m=0.0, rotational_n_m_per_rad=0.0)


def _draw_contact(contact: Contact, tolerances: Tolerances, normal: Iterator[float]) -> Contact:
    law = contact.law
    clearance_factor = max(LEAST_CLEARANCE_FACTOR, 1 + tolerances.clearance * next(normal))
    stiffness_factor = max(0.01, 1 + tolerances.stiffness * next(normal))
    damping_n_s_per_m = tolerances.contact_damping_s * law.stiffness_n_per_m * abs(next(normal))
    changed = replace(
        law,
        lower_clearance_m=law.lower_clearance_m * clearance_factor,
        upper_clearance_m=law.upper_clearance_m * clearance_factor,
        stiffness_n_per_m=law.stiffness_n_per_m * stiffness_factor,
        damping_n_s_per_m=law.damping_n_s_per_m + damping_n_s_per_m,
    )
    return replace(contact, law=changed)


def _draw_body(rig: Rig, body: Body, sensors: list[Sensor], tolerances: Tolerances, normal: Iterator[float]) -> Body:
    mass_factor = 1 + tolerances.mass * next(normal)
    frequency_change, log_damping = tolerances.frequency * next(normal), tolerances.damping * next(normal)
    if body.is_mass:
        return (
            body.scale_mass(mass_factor)
            .scale_frequencies(1 + frequency_change)
            .scale_damping(float(np.exp(log_damping)))
        )
    modes, count = modes_of(rig, body), mode_count(body, DRAWN_MODES)
    mode_tolerances = [tolerances.of_mode(body.name, m + 1) for m in range(count)]
    frequency_factors = np.array(
        [1 + frequency_change + tolerance.frequency * next(normal) for tolerance in mode_tolerances]
    )
    damping_factors = np.exp([log_damping + tolerance.damping * next(normal) for tolerance in mode_tolerances])
    natural_hz = modes.frequencies_hz(count) * frequency_factors
    order = np.argsort(natural_hz)
    stations = [s.station for s in sensors] + [s.station for s in rig.sensors] + [*rig.forces]
    stations += [s for c in rig.contacts for s in contact_stations(c)] + [load.station for load in rig.loads]
    shape_positions = body.places(SHAPE_POSITIONS)
    positions_m = np.unique([*shape_positions, *(s.position_m for s in stations if s.body == body.name)])
    positions_m = positions_m[np.append(np.diff(positions_m) > SAME_PLACE_M, True)]
    shapes = modes.shapes(positions_m, count) / np.sqrt(mass_factor)
    ratios = np.minimum(modes.damping_ratios(count) * damping_factors, 0.9)
    return structure_of(body.name, body.length_m, natural_hz[order], ratios[order], positions_m, shapes[:, order])


def is_impulsive(force_n: Float[np.ndarray, " samples"]) -> bool:
    """True for a hammer's force, or none: it is simulated as measured, as random phases would make it noise."""
    energy = np.cumsum(np.sort(force_n**2)[::-1])
    return bool(np.searchsorted(energy, IMPULSE_ENERGY_SHARE * energy[-1]) < IMPULSE_SAMPLE_SHARE * force_n.size)


def phase_randomized(
    force_n: Float[np.ndarray, " samples"], silent_samples: int, sample_rate_hz: float, rng: np.random.Generator
) -> Float[np.ndarray, " samples"]:
    """Force of the same spectrum with random phases, after `silent_samples` zeros."""
    excited = force_n[silent_samples:]
    spectrum = np.fft.rfft(excited)
    randomized = np.fft.irfft(np.abs(spectrum) * np.exp(2j * np.pi * rng.uniform(size=spectrum.size)), excited.size)
    onset = min(round(ONSET_S * sample_rate_hz), excited.size)
    randomized[:onset] *= np.sin(np.linspace(0, np.pi / 2, onset)) ** 2
    return np.concatenate([np.zeros(silent_samples), randomized])


def with_force_noise(
    recording: Recording,
    force_noise_n: Float[np.ndarray, " forces"],
    force_gain: float,
    rng: np.random.Generator,
) -> Recording:
    """Recording with noise and gain errors of the force channels, which the simulator does not know."""
    group = recording.signals["force"]
    values = group.values + force_noise_n[:, None] * rng.standard_normal(group.values.shape)
    values = values * (1 + force_gain * rng.standard_normal((len(values), 1)))
    return with_fields(recording, signals={**recording.signals, "force": with_fields(group, values=values)})


BLOW_PERIODS = tuple(2.0**-k for k in (1, 2, 3, 4, 5))
"""Durations of the blow, in longest periods of the rig: short blows excite higher modes. Effort."""
RELEASE_PERIODS = 4
"""Longest periods over which a force rises that is then released: slowly enough to excite no mode before. Set by
hand."""
SCALING_STEPS = 4
"""Number of short simulations that scale each excitation. Effort."""
SCALED_S = 8
"""Beginning of the counted motion, s, which the excitation reproduces. Set by hand."""
LARGE_MOTION_POWER = 8
"""Exponent of the mean over time that excitations are scaled by: the largest motion decides what contacts do, and a
mean over a decay of wrong damping does not tell it. Set by hand."""


def null_simulator(measured: Recording, record: Record, simulate: Simulate) -> Simulate:
    """Simulator of a recording's test: with its force, or of its free decay."""
    return simulate if record.forced else free_decay_simulator(measured, record, simulate)


def free_decay_simulator(measured: Recording, record: Record, simulate: Simulate) -> Simulate:
    """Simulator of free decays as long as the measured one, which ignores the force.

    The excitation, at the place of the first force, is the half-sine or the released force after which the nominal
    rig's largest counted motion is the measured one's and its spectrum the closest, octave by octave. A decay begins up
    to one period after it, depending on the seed.
    """
    rate, start_s = measured.rig.sample_rate_hz, float(record.time_s[0])
    scaled_samples = min(round((start_s + SCALED_S) * rate), measured.samples)
    extent = slice(round(start_s * rate), scaled_samples)
    measured_rows = _motion(measured, extent)
    natural_hz = np.concatenate(
        [modes_of(measured.rig, body).frequencies_hz(body.max_modes) for body in measured.rig.bodies]
    )
    period = round(rate / max(float(np.min(natural_hz[natural_hz > 0], initial=np.inf)), 1.0))

    def decay(rig: Rig, actual: Rig, excitation_n: Float[np.ndarray, " begin"], samples: int, seed: int) -> Recording:
        start = excitation_n.size + round(period * np.random.default_rng([seed, 78]).uniform())
        forces_n = np.zeros((len(rig.forces), start + samples))
        forces_n[0, : excitation_n.size] = excitation_n
        return _unforced(cut_recording(simulate(rig, actual, forces_n, seed), slice(start, start + samples)))

    def scaled(pulse: Float[np.ndarray, " begin"]) -> tuple[float, Float[np.ndarray, " begin"]]:
        """Distance between the spectra, and the scaled excitation."""
        excitation_n = measured.rig.body(measured.rig.forces[0].body).mass_kg * pulse
        for _ in range(SCALING_STEPS):
            rows = _motion(decay(measured.rig, measured.rig, excitation_n, scaled_samples, 0), extent)
            excitation_n = excitation_n * _largest(measured_rows) / _largest(rows)
        levels, measured_levels = (_octave_levels(row, rate, record.highest_hz) for row in (rows, measured_rows))
        return float(np.linalg.norm(levels - measured_levels)), excitation_n

    half_sines = [max(2, round(share * period)) for share in BLOW_PERIODS]
    pulses = [np.sin(np.pi * np.arange(samples) / samples) for samples in half_sines]
    pulses.append(np.sin(np.linspace(0, np.pi / 2, RELEASE_PERIODS * period)) ** 2)
    _, excitation_n = min((scaled(pulse) for pulse in pulses), key=lambda result: result[0])

    def simulated(rig: Rig, actual: Rig, forces_n: Float[np.ndarray, "forces samples"], seed: int) -> Recording:
        return decay(rig, actual, excitation_n, forces_n.shape[1], seed)

    return simulated


def _motion(recording: Recording, extent: slice) -> Float[np.ndarray, "sensors samples"]:
    """Signals of all sensors of the last sensor's quantity, without their means."""
    rows = recording.signals[recording.rig.sensors[-1].quantity].values[:, extent]
    return np.asarray(rows - rows.mean(axis=1, keepdims=True))


def _largest(rows: Float[np.ndarray, "sensors samples"]) -> float:
    """Generalised mean of the magnitude over time, near its largest values."""
    magnitude = np.linalg.norm(rows, axis=0)
    highest = max(float(magnitude.max()), 1e-300)
    return highest * float(np.mean((magnitude / highest) ** LARGE_MOTION_POWER)) ** (1 / LARGE_MOTION_POWER)


def _octave_levels(
    rows: Float[np.ndarray, "sensors samples"], rate_hz: float, highest_hz: float
) -> Float[np.ndarray, " octaves"]:
    """Logarithm of the rms of all sensors in each octave below a frequency."""
    fading = np.hanning(2 * rows.shape[1])[rows.shape[1] :]
    power = np.sum(np.abs(np.fft.rfft(rows * fading, axis=1)) ** 2, axis=0)[1:]
    hz = np.fft.rfftfreq(rows.shape[1], 1 / rate_hz)[1:]
    octaves = np.floor(np.log2(highest_hz / hz[hz <= highest_hz])).astype(int)
    return np.asarray(0.5 * np.log(np.maximum(np.bincount(octaves, power[hz <= highest_hz]), 1e-300)))


def _unforced(recording: Recording) -> Recording:
    force = recording.signals["force"]
    zero = Signals(force.channels, force.start_s, np.zeros_like(force.values))
    return Recording(recording.rig, {**recording.signals, "force": zero}, recording.provenance)
