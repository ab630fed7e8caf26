"""Arrays of a recording for the peers, and the form of their answers."""

from dataclasses import dataclass

import msgspec
import numpy as np
from jaxtyping import Float

from rig.model.quantities import QuantityName
from rig.model.sensing import sensors_of
from rig.recording import Recording
from rig.simulation.plants.modal import model_of

START_CLEARANCE, START_STIFFNESS = 0.8, 1.5
"""Where the peers that iterate start: shares of the true clearance and stiffness."""

MODES_PER_BEAM = 32
"""Modes of a simulated beam, and of the model that peers are given: with 16 the stiffnesses differ by 0.02 % from those
of the beam that rig.json describes, as far as intervals that take the model for exact."""


class ContactAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """Clearance and stiffness of a contact, with half-widths of their 95 % intervals; None where a peer has none."""

    contact: str
    clearance_m: float | None
    stiffness_n_per_m: float
    clearance_half_width_m: float | None = None
    stiffness_half_width_n_per_m: float | None = None


@dataclass(frozen=True)
class LinearModel:
    """Believed linear part of a rig: modes with unit modal mass, and shapes at force, contacts and sensors.

    A mode obeys q'' + 2 zeta omega q' + omega^2 q = force_row F - sum_j contact_rows_j f_j.
    """

    omega: Float[np.ndarray, " modes"]
    zeta: Float[np.ndarray, " modes"]
    bodies: tuple[str, ...]
    force_row: Float[np.ndarray, " modes"]
    contact_rows: Float[np.ndarray, "contacts modes"]
    sensor_rows: Float[np.ndarray, "stations modes"]


@dataclass(frozen=True)
class PeerData:
    """A recording as arrays, with the true contact laws for those peers that are told them, or start near them."""

    model: LinearModel
    names: tuple[str, ...]
    true_clearance_m: Float[np.ndarray, " contacts"]
    true_stiffness_n_per_m: Float[np.ndarray, " contacts"]
    sample_rate_hz: float
    force_n: Float[np.ndarray, " samples"]
    displacement_m: Float[np.ndarray, "stations samples"]
    velocity_m_per_s: Float[np.ndarray, "stations samples"]
    acceleration_m_per_s2: Float[np.ndarray, "stations samples"]
    station_bodies: tuple[str, ...]
    contact_stations: Float[np.ndarray, "contacts stations"]
    """Relative displacements by the stations' displacements: 1 at a contact's place, -1 at the other body's."""
    force_station: int

    @property
    def eta_m(self) -> Float[np.ndarray, "contacts samples"]:
        """Relative displacements at the contacts, as measured."""
        return self.contact_stations @ self.displacement_m


def peer_data(recording: Recording, modes_per_beam: int = MODES_PER_BEAM) -> PeerData:
    """Arrays of a recording that has displacement, velocity and acceleration at every station."""
    rig = recording.rig
    model = model_of(rig, False, modes_per_beam)
    stations = [sensor.station for sensor in sensors_of(rig, "displacement")]
    mode_bodies = [body.name for body in rig.bodies for _ in range(model.omega.size // len(rig.bodies))]
    eta_from_stations = np.zeros((len(rig.contacts), len(stations)))
    for row, contact in zip(eta_from_stations, rig.contacts, strict=True):
        row[stations.index(contact.at)] = 1
        if contact.against:
            row[stations.index(contact.against)] = -1

    def values(quantity: QuantityName) -> Float[np.ndarray, "stations samples"]:
        return np.array([recording.values_of(sensor) for sensor in sensors_of(rig, quantity)])

    return PeerData(
        model=LinearModel(
            omega=model.omega,
            zeta=model.zeta,
            bodies=tuple(mode_bodies),
            force_row=model.modal_force_by_input[0],
            contact_rows=model.eta_rows,
            sensor_rows=np.array([model.station_rows[place] for place in stations]),
        ),
        names=tuple(contact.name for contact in rig.contacts),
        true_clearance_m=np.array([contact.law.clearance_m for contact in rig.contacts]),
        true_stiffness_n_per_m=np.array([contact.law.stiffness_n_per_m for contact in rig.contacts]),
        sample_rate_hz=rig.sample_rate_hz,
        force_n=recording.force_n,
        displacement_m=values("displacement"),
        velocity_m_per_s=values("velocity"),
        acceleration_m_per_s2=values("acceleration"),
        station_bodies=tuple(place.body for place in stations),
        contact_stations=eta_from_stations,
        force_station=stations.index(rig.forces[0]),
    )


def dead_zone(eta_m: Float[np.ndarray, "..."], clearance_m: float) -> Float[np.ndarray, "..."]:
    """Penetration beyond a clearance to both sides, with the sign of the displacement, m."""
    return np.sign(eta_m) * np.maximum(np.abs(eta_m) - clearance_m, 0)
