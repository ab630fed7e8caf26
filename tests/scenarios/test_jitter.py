"""Random deviations of a laboratory's rig: which sensors move together."""

import numpy as np

from rig.simulation.reference import BarrelCradleAnnular
from scenarios.jitter import jittered


def test_sensors_of_both_directions_on_one_block_move_together():
    rig = BarrelCradleAnnular().rig()
    actual = jittered(rig, np.random.default_rng(1))
    moved_m: dict[tuple[str, float], set[float]] = {}
    for sensor, actual_sensor in zip(rig.sensors, actual.sensors, strict=True):
        assert actual_sensor.station.direction == sensor.station.direction
        key = sensor.station.body, sensor.station.position_m
        moved_m.setdefault(key, set()).add(actual_sensor.station.position_m - sensor.station.position_m)
    assert {len(shifts) for shifts in moved_m.values()} == {1}
    assert len(set.union(*moved_m.values())) > 1
