"""What the owner of a machine of the world "bench" believes: its rig.json, written from the machine as it should be."""

import numpy as np

from rig.model.beam import Beam
from rig.model.contact_laws import DeadZone
from rig.model.description import (
    Body,
    Contact,
    PointDamper,
    PointMass,
    PointSpring,
    Rig,
    Sensor,
    Station,
)
from rig.model.oscillator import Oscillator
from rig.model.structure import ShapeRow, Structure
from tests.campaigns.worlds.lumped import lumped_modes
from tests.campaigns.worlds.machine import Link, Lumped, Machine, Place, TrueBeam


def described(machine: Machine, name: str, sample_rate_hz: float) -> Rig:
    """Beams as beams, a single mass as an oscillator, masses in a row by their modes; what is fixed to beams as points.

    Links beside the contacts are friction and damping against the ground.
    """
    bodies = [*(_beam(b) for b in machine.beams), *(_row(b) for b in machine.lumped)]
    dampers = [
        PointDamper(
            station=_station(link.at),
            damping_n_s_per_m=link.law.dashpot_n_s_per_m,
            friction_n=link.law.friction_n,
        )
        for link in machine.links
    ]
    masses = [PointMass(station=Station(b.name, x), mass_kg=kg) for b in machine.beams for x, kg in b.masses]
    springs = [
        PointSpring(station=Station(b.name, x), stiffness_n_per_m=k) for b in machine.beams for x, k in b.springs
    ]
    return Rig(
        name=name,
        bodies=tuple(bodies),
        contacts=tuple(_contact(c) for c in machine.contacts),
        force_at=_station(machine.force_at),
        sensors=tuple(
            Sensor(name=s.name, station=_station(s.at), quantity=s.quantity, noise_density=s.noise_density)
            for s in machine.sensors
        ),
        sample_rate_hz=sample_rate_hz,
        masses=tuple(masses),
        springs=tuple(springs),
        dampers=tuple(dampers),
    )


def _station(place: Place) -> Station:
    return Station(place.body, place.position_m)


def _beam(beam: TrueBeam) -> Body:
    return Beam(
        name=beam.name,
        ends="clamped-free" if beam.clamped else "free-free",
        length_m=beam.length_m,
        width_m=beam.width_m,
        thickness_m=beam.thickness_m,
        youngs_modulus_pa=beam.youngs_modulus_pa,
        density_kg_per_m3=beam.density_kg_per_m3,
        damping_ratio=beam.damping_ratio,
    )


def _row(body: Lumped) -> Body:
    modes = lumped_modes(body)
    natural_hz = modes.omega_rad_per_s / (2 * np.pi)
    if len(body.masses_kg) == 1:
        return Oscillator(
            name=body.name,
            mass_kg=body.masses_kg[0],
            frequency_hz=float(natural_hz[0]),
            damping_ratio=float(modes.damping_ratio[0]),
        )
    rows = (ShapeRow(x, tuple(modes.shapes(x).tolist())) for x in body.positions_m)
    return Structure(
        name=body.name,
        length_m=body.length_m,
        natural_hz=tuple(natural_hz.tolist()),
        ratios=tuple(modes.damping_ratio.tolist()),
        rows=tuple(rows),
    )


def _contact(link: Link) -> Contact:
    law = link.law
    believed = DeadZone(
        lower_clearance_m=law.lower_m,
        upper_clearance_m=law.upper_m,
        stiffness_n_per_m=law.stiffness_above_n_per_m,
        damping_n_s_per_m=law.damping_n_s_per_m,
    )
    return Contact(
        name=link.name,
        at=_station(link.at),
        against=_station(link.against) if link.against else None,
        law=believed,
    )
