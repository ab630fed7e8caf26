"""A machine of the null reference: the nominal rig with every value off by its own draw within its tolerances."""

from collections.abc import Iterator
from dataclasses import replace as with_fields

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace
from scipy.stats import norm, qmc

from rig.model.description import Body, Contact, Rig, Sensor, Station, contact_stations
from rig.model.modes import modes_of, modes_wanted
from rig.model.structure import SAME_PLACE_M, structure_of
from rig.model.tolerances import Tolerances
from rig.recording import Recording

MODES = 24
"""Of a drawn beam: as many as the plant `modal` is given in a replay."""
PLACES = 41
"""Of its shapes, beside those where something stands."""


def standard_normals(rig: Rig, simulations: int) -> Float[np.ndarray, "simulations draws"]:
    """Standard normal draws of every tolerance, spread evenly over them (Latin hypercube)."""
    draws = 512 + 8 * len(rig.sensors)
    return np.asarray(norm.ppf(qmc.LatinHypercube(draws, seed=7).random(simulations)))


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


def with_crosstalk(recording: Recording, share: float, rng: np.random.Generator) -> Recording:
    """The recording with random shares, of this deviation, of the channels beside each that measure the same."""
    signals = dict(recording.signals)
    for quantity in {sensor.quantity for sensor in recording.rig.sensors} if share else ():
        values = signals[quantity].values
        beside = np.eye(len(values), k=1) + np.eye(len(values), k=-1)
        mixing = np.eye(len(values)) + share * beside * rng.standard_normal(beside.shape)
        signals[quantity] = with_fields(signals[quantity], values=mixing @ values)
    return with_fields(recording, signals=signals)


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
