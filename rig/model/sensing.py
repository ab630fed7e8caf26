"""Sensors of a rig by quantity, and the band in which a recording shows them."""

from rig.model.description import Rig, Sensor, Station
from rig.model.quantities import QuantityName

PASSBAND = 0.4
"""The chain is flat within 2e-5 up to this fraction of the sampling rate (and down by 100 dB at 1 - PASSBAND)."""


def sensors_of(rig: Rig, quantity: QuantityName) -> tuple[Sensor, ...]:
    return tuple(sensor for sensor in rig.sensors if sensor.quantity == quantity)


def quantities_of(rig: Rig) -> tuple[QuantityName, ...]:
    return tuple(dict.fromkeys(sensor.quantity for sensor in rig.sensors))


def named_sensor(station: Station, quantity: QuantityName, noise_density: float = 0.0) -> Sensor:
    """Sensor named after its station and quantity; noise_density (m/s^2/sqrt(Hz)) is for accelerometers only."""
    return Sensor(
        name=f"{station.label}_{quantity}",
        station=station,
        quantity=quantity,
        noise_density=noise_density if quantity == "acceleration" else 0.0,
    )
