"""The pictures of the README: frames of the motion, and what is missing is said."""

import numpy as np
import pytest

from rig.errors import RigError
from rig.recording import read, read_truth, truth_path
from rig.simulation.reference import BarrelCradle
from rig.viewer.deflection import deflection
from scenarios import pictures
from tests.recorded import recorded

SETTINGS = BarrelCradle(duration_s=2.0)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return recorded(SETTINGS, tmp_path_factory.mktemp("pictures") / "r.mcap")


def test_a_stop_is_red_while_its_contact_is_closed(recording):
    motion = deflection(read(recording), read_truth(truth_path(recording)))
    clearance_m = SETTINGS.clearance_1_m
    depth_m = np.abs(motion.relative_displacement_m()).max(axis=0) - clearance_m
    red = np.array([int(pictures.COLOURS["closed"][k : k + 2], 16) for k in (1, 3, 5)])
    for sample, closed in ((int(np.argmax(depth_m)), True), (int(np.argmin(depth_m)), False)):
        frame = np.asarray(pictures._frame(motion, sample, 0.0, 40.0)).astype(int)
        assert np.any(np.abs(frame - red).sum(axis=2) < 6) == closed


def test_seconds_that_the_record_lacks_are_refused(recording, tmp_path):
    with pytest.raises(RigError, match=r"is shorter than 9.36 s; start earlier"):
        pictures.animation(recording, tmp_path / "m.gif", start=9.0)
    assert not (tmp_path / "m.gif").exists()


def test_pages_that_are_not_there_are_named(tmp_path, monkeypatch):
    monkeypatch.setenv("CHROMIUM", "chromium")
    with pytest.raises(RigError, match=r"contact.html: is not there; make it by `rig demo"):
        pictures.screens(tmp_path, tmp_path)
