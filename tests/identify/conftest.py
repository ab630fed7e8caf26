"""Recordings of the two reference rigs under the paper's conditions, simulated once for all tests."""

from pathlib import Path

import pytest

from rig.recording import truth_path
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle, Sdof


def simulated(settings: Sdof | BarrelCradle, path: Path) -> Path:
    record(
        settings.rig(),
        settings.force(),
        plant=modal.simulate,
        duration_s=settings.duration_s,
        step_s=settings.step_s,
        path=path,
        progress=lambda _: None,
    )
    return path


@pytest.fixture(scope="session")
def simulate():
    return simulated


@pytest.fixture(scope="session")
def one_mass(tmp_path_factory) -> Path:
    """825 s of the one-mass rig, displacement known, no noise; there is no truth file beside."""
    path = simulated(Sdof(sensors="displacement", step_s=2.0**-12), tmp_path_factory.mktemp("one_mass") / "r.mcap")
    truth_path(path).unlink()
    return path


@pytest.fixture(scope="session")
def barrel_cradle(tmp_path_factory) -> Path:
    """30 s of the barrel in its cradle, six displacement sensors and six accelerometers a beam, no noise."""
    return simulated(BarrelCradle(duration_s=30.0), tmp_path_factory.mktemp("barrel_cradle") / "r.mcap")
