"""The null reference: what the believed rig leaves of recordings of itself, built within its tolerances.

Integration, chaos, sensors and tolerances are in it; it turns what is left of a record into a p-value. Made once for a
rig, its tolerances, a simulator and a level of force, it is kept.
"""

import hashlib
import importlib.metadata
from collections.abc import Callable, Iterator
from dataclasses import replace as with_fields
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float
from msgspec.structs import replace
from scipy.stats import norm, qmc
from scipy.stats import t as student

from identify.gaps.residual.likelihood import Misfit, misfit, reference_of
from identify.gaps.residual.residual import Linearization, linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.nominal import fit_nuisance
from rig.errors import RigError
from rig.files import check_target, contents, make_folder, write_bytes
from rig.model.description import Body, Contact, Rig, Sensor, Station, contact_stations, to_json
from rig.model.modes import modes_of, modes_wanted
from rig.model.structure import SAME_PLACE_M, structure_of
from rig.model.tolerances import Tolerances
from rig.recording import Recording

NULL_SIMULATIONS = 12
"""Their mean is known within 29 % of their standard deviation, that within 21 %: Student's distribution knows."""
NULL_REFERENCE_SUFFIX = ".null_reference.json"
RISE_S = 0.1
MOST, BLOWS = 0.9, 0.1
"""A force of which a smaller share of the samples holds so much of the energy is one of blows."""
LEVEL = 1.25
"""Forces within this factor of each other share a null reference."""
MODES = 24
"""Of a drawn beam: as many as the plant `modal` is given in a replay."""
PLACES = 41
"""Of its shapes, beside those where something stands."""

Simulate = Callable[[Rig, Rig, Float[np.ndarray, "forces samples"], int], Recording]
"""The recording of the believed rig (first) that the actual one makes under a measured force, noise from a seed: the
simulator that the diagnosis is handed."""


class NullSimulation(msgspec.Struct, frozen=True):
    """What one null simulation leaves: -2 ln p, the contacts' part of it and that of the worst band, and the
    unexplained shares by band, overall, and of each contact force; and its figures in familiar terms."""

    minus_two_log: float
    law: float
    peak: float
    shares: tuple[float, ...]
    share: float
    contact_shares: tuple[float, ...]
    figures: dict[str, float]


class NullReference(msgspec.Struct, frozen=True):
    """The null simulations of one rig; `key` says of which rig, tolerances, simulator, force and program.

    `checksum` is of what is kept in a file.
    """

    key: str
    simulations: tuple[NullSimulation, ...]
    checksum: str = ""

    def p_value(self, left: Misfit) -> float:
        """How often tolerances and noise alone leave as much: Student's prediction from the null simulations' -2 ln p.

        The contacts' part and that of the worst band are judged apart, as one contact or one sharp line is a small
        share of the whole; the smallest p-value counts, three times (Bonferroni).
        """
        parts = np.array([[n.minus_two_log - n.law, n.law, n.peak] for n in self.simulations])
        deviations = np.maximum(parts.std(axis=0, ddof=1) * np.sqrt(1 + 1 / len(parts)), 1.0)
        here = np.array([left.minus_two_log - left.law, left.law, left.peak])
        beyond = student.sf((here - parts.mean(axis=0)) / deviations, len(parts) - 1)
        return min(1.0, 3 * float(beyond.min()))

    def by_chance(self, figure: str) -> float:
        """How far nineteen of twenty null simulations lie from their mean at most, in the figure's unit."""
        values = np.array([n.figures[figure] for n in self.simulations])
        return float(student.ppf(0.975, values.size - 1) * np.sqrt(1 + 1 / values.size) * values.std(ddof=1))

    def usual_shares(self) -> Float[np.ndarray, " bands"]:
        """By band: the share that nineteen of twenty null simulations stay below."""
        common = min(len(n.shares) for n in self.simulations)  # the bands of a record end where its force does
        rows = np.array([n.shares[:common] for n in self.simulations])
        beyond = student.ppf(0.95, len(rows) - 1) * np.sqrt(1 + 1 / len(rows))
        return np.asarray(rows.mean(axis=0) + beyond * rows.std(axis=0, ddof=1))


def null_reference_of(
    measured: Recording,
    tolerances: Tolerances,
    simulate: Simulate,
    simulator: str,
    progress: Callable[[float], None] = lambda _: None,
    kept: Path | None = None,
    simulations: int = NULL_SIMULATIONS,
) -> NullReference:
    """That of a recording's rig, length and force, from the file `kept` if that is of the same; else made, and kept.

    Of a folder it is the file named after the key, so that many rigs and levels have theirs in one.
    """
    key = null_key(measured, tolerances, simulator, simulations)
    if kept and kept.is_dir():
        kept = kept / f"{key[:16]}.json"
    if kept and (found := _read(kept, key)):
        return found
    if kept:
        check_target(kept, new_folder=True)
    seen = record_of(measured, tolerances=tolerances)
    densities = np.sqrt(seen.force_noise / seen.samples)
    gain = tolerances.force_gain if len(densities) > 1 else 0.0  # of one force the rig that is drawn has it
    start = round(seen.excited_s * seen.sample_rate_hz)
    rows = []
    for seed, normals in enumerate(_normals(measured.rig, simulations)):
        rng = np.random.default_rng([seed, 77])
        actual = drawn(measured.rig, tolerances, normals)
        forces_n = np.array(
            [
                row if of_blows(row) else phase_randomized(row, start, measured.rig.sample_rate_hz, rng)
                for row in measured.forces_n
            ]
        )
        made = simulate(measured.rig, actual, forces_n, seed)
        rows.append(_left(_instrumented(made, densities, gain, rng), tolerances))
        progress((seed + 1) / simulations)
    reference = NullReference(key, tuple(rows))
    if kept:
        make_folder(kept.parent)
        write_bytes(msgspec.json.encode(replace(reference, checksum=_checksum(reference))), kept)
    return reference


def of_blows(force_n: Float[np.ndarray, " samples"]) -> bool:
    """Whether a force is a hammer's, or none: then it is taken as it is; noise of its spectrum is another test."""
    energy = np.cumsum(np.sort(force_n**2)[::-1])
    return bool(np.searchsorted(energy, MOST * energy[-1]) < BLOWS * force_n.size)


def phase_randomized(
    force_n: Float[np.ndarray, " samples"], start: int, sample_rate_hz: float, rng: np.random.Generator
) -> Float[np.ndarray, " samples"]:
    """A force of the same spectrum with other phases, after silence up to the sample `start`."""
    excited = force_n[start:]
    spectrum = np.fft.rfft(excited)
    turned = np.fft.irfft(np.abs(spectrum) * np.exp(2j * np.pi * rng.uniform(size=spectrum.size)), excited.size)
    rise = min(round(RISE_S * sample_rate_hz), excited.size)
    turned[:rise] *= np.sin(np.linspace(0, np.pi / 2, rise)) ** 2
    return np.concatenate([np.zeros(start), turned])


def _normals(rig: Rig, simulations: int) -> Float[np.ndarray, "simulations draws"]:
    """Standard normal draws of every tolerance, spread evenly over them (Latin hypercube)."""
    draws = 512 + 8 * len(rig.sensors)
    return np.asarray(norm.ppf(qmc.LatinHypercube(draws, seed=7).random(simulations)))


def _instrumented(
    made: Recording,
    force_noise_n: Float[np.ndarray, " forces"],
    force_gain: float,
    rng: np.random.Generator,
) -> Recording:
    """With noise and gains of the force channels, which the simulator does not know."""
    group = made.signals["force"]
    values = group.values + force_noise_n[:, None] * rng.standard_normal(group.values.shape)
    values = values * (1 + force_gain * rng.standard_normal((len(values), 1)))
    return with_fields(made, signals={**made.signals, "force": with_fields(group, values=values)})


def _left(recording: Recording, tolerances: Tolerances) -> NullSimulation:
    record = record_of(recording, tolerances=tolerances)
    linearization = linearized(record, record.rig)
    reference = reference_of(linearization)
    left = misfit(record, reference, fit_nuisance(record, record.rig, rounds=1)[1])
    return NullSimulation(
        left.minus_two_log,
        left.law,
        left.peak,
        tuple(left.shares.tolist()),
        left.share,
        tuple(left.contact_shares.tolist()),
        {name: value for name, (value, _) in familiar_figures(linearization).items()},
    )


def null_key(measured: Recording, tolerances: Tolerances, simulator: str, simulations: int = NULL_SIMULATIONS) -> str:
    """Of the rig, its tolerances, the simulator, the force's (in a free decay the motion's) level and length, and the
    program."""
    driven = (
        measured.forces_n if np.any(measured.forces_n) else measured.signals[measured.rig.sensors[-1].quantity].values
    )
    level = round(float(np.log(max(np.std(driven), 1e-300)) / np.log(LEVEL)))
    version = importlib.metadata.version("rig-identify")
    kind = " blows" * any(of_blows(row) for row in measured.forces_n)
    parts = (
        to_json(replace(measured.rig, tolerances=None)),
        msgspec.json.encode(tolerances),
        f"{simulator} {level} {measured.samples} {simulations} {version}{kind}".encode(),
    )
    return hashlib.sha256(b"\n".join(parts)).hexdigest()


def _read(path: Path, key: str) -> NullReference | None:
    """What the file holds, if it is of this key and as it was written; a damaged one or another's is made anew.

    Raises RigError if it cannot be read, or is a file of something else, which is not to be lost.
    """
    if not path.exists():
        return None
    content = contents(path)
    if content and not content.startswith(b'{"key"') and not path.name.endswith(NULL_REFERENCE_SUFFIX):
        raise RigError(f"{path}: is no null reference, and is not written over; give another name, or remove it")
    try:
        found = msgspec.json.decode(content, type=NullReference)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
    return replace(found, checksum="") if (found.key, found.checksum) == (key, _checksum(found)) else None


def _checksum(reference: NullReference) -> str:
    return hashlib.sha256(msgspec.json.encode(replace(reference, checksum=""))).hexdigest()


def familiar_figures(linearization: Linearization) -> dict[str, tuple[float, str]]:
    """Value and unit by name; contacts as the linearisation's rig has them."""
    accelerations = linearization.record.in_time(linearization.record.delivered)
    found = {"acceleration, rms of all sensors": (float(np.sqrt(np.mean(accelerations**2))), "m/s^2")}
    seconds = accelerations.shape[1] / linearization.record.rate_hz
    for contact, seen in zip(linearization.model.rig.contacts, linearization.seen, strict=True):
        found[f"time that {contact.name} is closed"] = 100 * float(np.mean(seen.closed)), "%"
        found[f"impacts of {contact.name}"] = float(np.sum(np.diff(seen.closed) > 0)) / seconds, "1/s"
    return found


def drawn(rig: Rig, tolerances: Tolerances, normals: Float[np.ndarray, " draws"]) -> Rig:
    """The rig with every value off by its tolerance times the next of the standard normal draws.

    A beam becomes a structure, each of whose modes has a frequency and a damping of its own. An AC-coupled sensor has a
    high-pass more than its description says, as one whose corner is the sum. The gain of one of several forces is in no
    rig.
    """
    draw = iter(normals.tolist())
    sensors = []
    moved: dict[Station, Station] = {}
    for sensor in rig.sensors:
        own = tolerances.of_sensor(sensor.name)
        if sensor.station not in moved:  # sensors at one station sit on one block
            length = rig.body(sensor.station.body).length_m
            place = float(np.clip(sensor.station.position_m + own.position_m * next(draw), 0.0, length))
            moved[sensor.station] = Station(sensor.station.body, place)
        gain, delay_s = 1 + own.gain * next(draw), own.delay_s * next(draw)
        corner_hz = abs(own.high_pass_hz * next(draw)) * sensor.measures.ac_coupled
        chain = {"gain": sensor.gain * gain, "delay_s": sensor.delay_s + delay_s}
        chain["high_pass_hz"] = sensor.high_pass_hz + corner_hz
        fibre_m = rig.fibre_m(sensor) or None  # a structure does not know how thick it is
        sensors.append(replace(sensor, station=moved[sensor.station], fibre_m=fibre_m, **chain))
    gain = rig.force_sensor.gain * (1 + tolerances.force_gain * next(draw) * (len(rig.forces) == 1))
    contacts = tuple(_contact(contact, tolerances, draw) for contact in rig.contacts)
    bodies = tuple(_body(rig, body, sensors, tolerances, draw) for body in rig.bodies)
    taken_up = {b.name for b in bodies if not b.is_mass} & {b.name for b in rig.bodies}
    return replace(
        rig,
        bodies=bodies,
        sensors=tuple(sensors),
        contacts=contacts,
        force_sensor=replace(rig.force_sensor, gain=gain),
        masses=tuple(m for m in rig.masses if m.station.body not in taken_up),
        springs=tuple(_nonlinear(rig, taken_up)),
        clamps=(),
    )


def _nonlinear(rig: Rig, taken_up: set[str]) -> Iterator[object]:
    """Springs without what the modes of a body hold already."""
    for spring in rig.springs:
        if spring.station.body not in taken_up:
            yield spring
        elif spring.cubic_n_per_m3:
            yield replace(spring, stiffness_n_per_m=0.0, rotational_n_m_per_rad=0.0)


def _contact(contact: Contact, tolerances: Tolerances, draw: Iterator[float]) -> Contact:
    law = contact.law
    wider = max(0.0, 1 + tolerances.clearance * next(draw))
    stiffer = max(0.01, 1 + tolerances.stiffness * next(draw))
    damping = tolerances.contact_damping_s * law.stiffness_n_per_m * abs(next(draw))
    changed = replace(
        law,
        lower_clearance_m=law.lower_clearance_m * wider,
        upper_clearance_m=law.upper_clearance_m * wider,
        stiffness_n_per_m=law.stiffness_n_per_m * stiffer,
        damping_n_s_per_m=law.damping_n_s_per_m + damping,
    )
    return replace(contact, law=changed)


def _body(rig: Rig, body: Body, sensors: list[Sensor], tolerances: Tolerances, draw: Iterator[float]) -> Body:
    heavier = 1 + tolerances.mass * next(draw)
    faster, lossier = tolerances.frequency * next(draw), tolerances.damping * next(draw)
    if body.is_mass:
        return body.scale_mass(heavier).scale_frequencies(1 + faster).scale_damping(float(np.exp(lossier)))
    modes, count = modes_of(rig, body), modes_wanted(body, MODES)
    own = [tolerances.of_mode(body.name, m + 1) for m in range(count)]
    factors = np.array([1 + faster + t.frequency * next(draw) for t in own])
    losses = np.exp([lossier + t.damping * next(draw) for t in own])
    frequencies = modes.frequencies_hz(count) * factors
    order = np.argsort(frequencies)
    standing = [s.station for s in sensors] + [s.station for s in rig.sensors] + [*rig.forces]
    standing += [s for c in rig.contacts for s in contact_stations(c)] + [load.station for load in rig.loads]
    given = body.places(PLACES)
    places = np.unique([*given, *(s.position_m for s in standing if s.body == body.name)])
    places = places[np.append(np.diff(places) > SAME_PLACE_M, True)]
    shapes = modes.shapes(places, count) / np.sqrt(heavier)
    ratios = np.minimum(modes.damping_ratios(count) * losses, 0.9)
    return structure_of(body.name, body.length_m, frequencies[order], ratios[order], places, shapes[:, order])
