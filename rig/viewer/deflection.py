"""Displacements for display: at every station, of a body between its stations, and across the contacts."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.signal.windows import tukey

from rig.errors import RigError
from rig.model.description import ON_GROUND, Body, Direction, Rig, Station, contact_rows
from rig.recording import Recording

LOWEST_INTEGRATED_HZ = 1.0
TAPER_S = 0.5
ALL_SAMPLES = slice(None)


@dataclass(frozen=True)
class Deflection:
    """Displacement of the stations; `is_approximate` if it was integrated, without the content below 1 Hz."""

    rig: Rig
    stations: tuple[Station, ...]
    displacement_m: Float[np.ndarray, "stations samples"]
    is_approximate: bool

    def body_displacement_m(
        self,
        body: Body,
        positions_m: Float[np.ndarray, " positions"],
        samples: slice | Int[np.ndarray, " frames"] = ALL_SAMPLES,
        direction: Direction = "y",
    ) -> Float[np.ndarray, "positions frames"]:
        """w(x) = phi(x) pinv(phi(stations)) w(stations), with as many modes as the body has stations.

        Zero in a direction without stations.
        """
        station_rows = [k for k, s in enumerate(self.stations) if (s.body, s.direction) == (body.name, direction)]
        if not station_rows:
            return np.zeros((len(positions_m), self.displacement_m[:1, samples].shape[1]))
        stations_m = np.array([self.stations[station_row].position_m for station_row in station_rows])
        mode_count = min(len(station_rows), body.max_modes)
        inverse_shapes = np.linalg.pinv(body.shapes(stations_m, mode_count), rcond=1e-3)
        displacement_m = self.displacement_m[station_rows][:, samples]
        return np.asarray(body.shapes(positions_m, mode_count) @ inverse_shapes @ displacement_m)

    def displacement_at(self, station: Station) -> Float[np.ndarray, " samples"]:
        """Displacement at a station, m: as measured there, else from the body's modes."""
        if station in self.stations:
            return self.displacement_m[self.stations.index(station)]
        position_m = np.array([station.position_m])
        return self.body_displacement_m(self.rig.body(station.body), position_m, direction=station.direction)[0]

    def relative_displacement_m(self) -> Float[np.ndarray, "contacts samples"]:
        """Displacement of each contact's station less that of the station it strikes against, m (`contact_rows`)."""
        relative_rows = [
            self.displacement_at(contact.at) - (self.displacement_at(contact.against) if contact.against else 0.0)
            for contact in contact_rows(self.rig)
        ]
        return np.array(relative_rows).reshape(len(relative_rows), self.displacement_m.shape[1])


def deflection(recording: Recording, truth: Recording | None) -> Deflection:
    """Deflection by the truth file if there is one, else by the sensor of least integration at every station, relative
    to a base whose motion is measured.

    Raises RigError if a body has no motion sensor.
    """
    if truth is not None:
        true_signals = truth.signals["displacement"]
        stations = tuple(station for station in true_signals.channels.stations if station is not None)
        return Deflection(truth.rig, stations, true_signals.values, is_approximate=False)
    rig = recording.rig
    motion_sensors = [sensor for sensor in rig.sensors if sensor.measures.translates]
    sensor_by_station = {s.station: s for s in sorted(motion_sensors, key=lambda s: s.measures.order, reverse=True)}
    for body in rig.bodies:
        if body.name not in {station.body for station in sensor_by_station}:
            raise RigError(f"body {body.name!r} has no sensor of its motion, so that it cannot be shown; record one")
    displacement_rows = []
    for sensor in sensor_by_station.values():
        signals = recording.signals[sensor.quantity]
        sensor_samples = signals.values[signals.channels.names.index(sensor.name)] / sensor.gain
        displacement_rows.append(_integrate(sensor_samples, sensor.measures.order, rig.sample_rate_hz))
    is_approximate = any(s.measures.order for s in sensor_by_station.values())
    stations, displacement_m = tuple(sensor_by_station), np.stack(displacement_rows)
    if rig.base_sensors:
        base_row = stations.index(ON_GROUND)
        displacement_m = np.delete(displacement_m - displacement_m[base_row], base_row, axis=0)
        stations = tuple(station for station in stations if station != ON_GROUND)
    return Deflection(rig, stations, displacement_m, is_approximate)


def _integrate(
    samples: Float[np.ndarray, " samples"], integration_count: int, sample_rate_hz: float
) -> Float[np.ndarray, " samples"]:
    """Record, tapered at both ends, divided by (i omega)^integration_count; zero below LOWEST_INTEGRATED_HZ."""
    if not integration_count:
        return samples
    omega = 2 * np.pi * np.fft.rfftfreq(samples.size, 1 / sample_rate_hz)
    tapered_spectrum = np.fft.rfft(samples * tukey(samples.size, min(1.0, 2 * TAPER_S * sample_rate_hz / samples.size)))
    is_in_passband = omega >= 2 * np.pi * LOWEST_INTEGRATED_HZ
    integration_factor = np.zeros(omega.size, dtype=complex)
    integration_factor[is_in_passband] = (1j * omega[is_in_passband]) ** -integration_count
    return np.fft.irfft(tapered_spectrum * integration_factor, samples.size)
