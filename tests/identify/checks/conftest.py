"""Small sound recordings of rigs that are built a little off their description."""

from functools import partial

import numpy as np
import pytest
from msgspec.structs import replace

from rig.effects import effect_named
from rig.recording import Recording, read
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle
from scenarios.jitter import jittered
from tests.campaigns.topologies import RIGS, Topology, one_mass

FRAME = RIGS["frame, free"].rig
FLOORS = [s.station for s in FRAME.sensors]
CASES = {
    "two shakers": Topology(replace(FRAME, force_at=(FLOORS[0], FLOORS[2])), 60.0, ""),
    "frame": RIGS["frame, free"],
    "cantilever": RIGS["cantilever with a stop at its tip"],
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
}


@pytest.fixture(scope="session")
def sound(tmp_path_factory):
    """name -> 12 s of a rig as a laboratory builds it."""
    folder = tmp_path_factory.mktemp("checks")

    def make(name: str) -> Recording:
        path, case = folder / f"{name}.mcap", CASES[name]
        if not path.exists():
            record(
                case.rig,
                replace(BarrelCradle(rms_n=case.rms_n, duration_s=12.0).force(), seed=3),
                plant=partial(modal.simulate, modes_per_beam=20),
                duration_s=12.0,
                step_s=2.0**-15,
                path=path,
                progress=lambda _: None,
                actual=jittered(case.rig, np.random.default_rng(3)),
            )
        return read(path)

    return make
