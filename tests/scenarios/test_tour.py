"""The tour ends where it says: with the mass that the real rig has."""

import pytest

from rig.model.description import from_json
from scenarios.tour import tour

pytestmark = pytest.mark.long


@pytest.mark.study
def test_the_tour_corrects_the_rig(tmp_path, capsys):
    tour(out=tmp_path, duration=40.0)
    assert [line[0] for line in capsys.readouterr().out.splitlines() if line[0].isdigit()] == list("1234567")
    corrected = from_json((tmp_path / "rig.json").read_bytes(), "rig.json")
    assert abs(sum(m.mass_kg for m in corrected.masses) / 0.05 - 1) < 0.1
