"""Small sound recordings of rigs that are built a little off their description, or off it by all tolerances."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from rig.effects import effect_named
from rig.model.description import Rig, Station
from rig.model.tolerances import LABORATORY
from rig.recording import Recording, read
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle
from scenarios.jitter import jittered
from tests.campaigns.topologies import RIGS, Topology, one_mass

BEAMS = BarrelCradle(sensors="acceleration", noise_density=1e-4).rig()
CONTACT_STATIONS = {side for c in BEAMS.contacts for side in (c.at, c.against)}
CANTILEVER = RIGS["cantilever with a stop at its tip"]
FRAME = RIGS["frame, free"].rig
FLOORS = [s.station for s in FRAME.sensors]
CASES = {
    "two shakers": Topology(replace(FRAME, force_at=(FLOORS[0], FLOORS[2])), 60.0, ""),
    "frame": RIGS["frame, free"],
    "cantilever": CANTILEVER,
    "mass": Topology(one_mass(5e-4, quantity="acceleration"), 6.0, ""),
    "mass with a spring and a mass on it": Topology(
        effect_named("linear_spring:stiffness_n_per_m=150").applied_to(
            effect_named("added_mass:mass_kg=0.15").applied_to(one_mass(5e-4, quantity="acceleration"))
        ),
        6.0,
        "",
    ),
    "progressive stop": RIGS["bumper and hard stop, accelerometer"],
    "two stops at one place": RIGS["two beams, two stops at one place"],
    "two beams, four accelerometers": Topology(
        replace(BEAMS, sensors=tuple(s for s in BEAMS.sensors if s.station in CONTACT_STATIONS)), 25.0, ""
    ),
    "cantilever, three accelerometers": Topology(
        replace(
            CANTILEVER.rig, sensors=tuple(s for s in CANTILEVER.rig.sensors if s.station.position_m in (0.4, 0.8, 1))
        ),
        20.0,
        "",
    ),
    "cantilever, hard blows": Topology(CANTILEVER.rig, 40.0, ""),
}


def within_tolerances(rig: Rig, seed: int) -> Rig:
    """The rig with masses, frequencies, damping, places, gains and delays off by one tolerance times a normal draw."""
    rng, off = np.random.default_rng(seed), LABORATORY
    bodies = tuple(
        body.scale_mass(1 + off.mass * rng.standard_normal())
        .scale_frequencies(1 + off.frequency * rng.standard_normal())
        .scale_damping(float(np.exp(off.damping * rng.standard_normal())))
        for body in rig.bodies
    )
    sensors = []
    for sensor in rig.sensors:
        at, length_m = sensor.station, rig.body(sensor.station.body).length_m
        position_m = np.clip(at.position_m + off.position_m * rng.standard_normal(), 0.0, length_m)
        gain, delay_s = 1 + off.gain * rng.standard_normal(), off.delay_s * rng.standard_normal()
        sensors.append(replace(sensor, station=Station(at.body, float(position_m)), gain=gain, delay_s=delay_s))
    return replace(rig, bodies=bodies, sensors=tuple(sensors))


def simulated(case: Topology, path: Path, actual: Rig, seed: int = 3, modes_per_beam: int = 20) -> Recording:
    """12 s of a rig, which is actually another than its description has."""
    if not path.exists():
        record(
            case.rig,
            replace(BarrelCradle(rms_n=case.rms_n, duration_s=12.0).force(), seed=seed),
            plant=partial(modal.simulate, modes_per_beam=modes_per_beam),
            duration_s=12.0,
            step_s=2.0**-15,
            path=path,
            progress=lambda _: None,
            actual=actual,
        )
    return read(path)


@pytest.fixture(scope="session")
def sound(tmp_path_factory):
    """name -> 12 s of a rig as a laboratory builds it."""
    folder = tmp_path_factory.mktemp("checks")

    def make(name: str) -> Recording:
        case = CASES[name]
        return simulated(case, folder / f"{name}.mcap", jittered(case.rig, np.random.default_rng(3)))

    return make


@pytest.fixture
def off_by_tolerances(tmp_path):
    """name and seed -> 12 s of a rig that is off by what its tolerances state."""
    return lambda name, seed: simulated(
        CASES[name], tmp_path / "r.mcap", within_tolerances(CASES[name].rig, seed), seed
    )


@pytest.fixture
def damped(tmp_path):
    """name and factor -> 12 s of a rig whose damping is so many times that of its description."""

    def make(name: str, factor: float) -> Recording:
        rig = CASES[name].rig
        actual = replace(rig, bodies=tuple(body.scale_damping(factor) for body in rig.bodies))
        return simulated(CASES[name], tmp_path / "r.mcap", actual)

    return make


@pytest.fixture
def of_few_modes(tmp_path):
    """name -> 12 s of a rig as described, but for the modes beyond the eighth of each beam, which it lacks."""
    return lambda name: simulated(CASES[name], tmp_path / "r.mcap", CASES[name].rig, modes_per_beam=8)
