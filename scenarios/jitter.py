"""A rig as a careful laboratory would build it: for the random rigs of the campaign."""

import msgspec
import numpy as np

from rig.model.description import Body, Rig


def jittered(rig: Rig, rng: np.random.Generator) -> Rig:
    """Rig with E off by up to 0.3 %, damping by 20 %, sensor stations by 1 mm and gains by 0.2 %, all uniform.

    Sensors at one station move together, as they sit on one block, those of both directions too; on a beam's end they
    move inwards.
    """
    bodies = tuple(_jittered_body(body, rng) for body in rig.bodies)
    actual_position_m = {
        (body, at_m): float(np.clip(at_m + rng.uniform(-1e-3, 1e-3), 0, rig.body(body).length_m))
        for body, at_m in dict.fromkeys((sensor.station.body, sensor.station.position_m) for sensor in rig.sensors)
    }
    sensors = tuple(
        msgspec.structs.replace(
            sensor,
            station=msgspec.structs.replace(station, position_m=actual_position_m[station.body, station.position_m]),
            gain=sensor.gain * (1 + rng.uniform(-2e-3, 2e-3)),
        )
        for sensor in rig.sensors
        for station in [sensor.station]
    )
    return msgspec.structs.replace(rig, bodies=bodies, sensors=sensors)


def _jittered_body(body: Body, rng: np.random.Generator) -> Body:
    """Body with its damping off, and its frequencies: of a beam or a structure by the root of E."""
    damped = body.scale_damping(1 + rng.uniform(-0.2, 0.2))
    if body.is_mass:
        return damped.scale_frequencies(1 + rng.uniform(-1.5e-3, 1.5e-3))
    return damped.scale_frequencies(float(np.sqrt(1 + rng.uniform(-3e-3, 3e-3))))
