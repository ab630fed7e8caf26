"""Recordings of the two reference rigs under the paper's conditions, simulated once for all tests."""

from pathlib import Path

import pytest

from rig.recording import truth_path
from rig.simulation.reference import BarrelCradle, Sdof
from tests.recorded import recorded


@pytest.fixture(scope="session")
def simulate():
    return recorded


@pytest.fixture(scope="session")
def one_mass(tmp_path_factory) -> Path:
    """825 s of the one-mass rig, displacement known, no noise; there is no truth file beside."""
    path = recorded(Sdof(sensors="displacement", step_s=2.0**-12), tmp_path_factory.mktemp("one_mass") / "r.mcap")
    truth_path(path).unlink()
    return path


@pytest.fixture(scope="session")
def barrel_cradle(tmp_path_factory) -> Path:
    """30 s of the barrel in its cradle, six displacement sensors and six accelerometers a beam, no noise."""
    return recorded(BarrelCradle(duration_s=30.0), tmp_path_factory.mktemp("barrel_cradle") / "r.mcap")
