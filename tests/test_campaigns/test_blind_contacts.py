"""Contacts on recordings of a simulator that the identification shares nothing with."""

import pytest

from tests.campaigns.blind_contacts import Task, one_recording
from tests.campaigns.worlds.making import made, planned


def test_every_contact_is_within_its_interval(tmp_path):
    (plan,) = planned(tmp_path, "wide", 7200, 1, 20.0, nulls_only=True)
    (tmp_path / "recordings").mkdir()
    (tmp_path / "sealed" / "work").mkdir(parents=True)
    case = made(plan)
    found = one_recording(Task(str(tmp_path / "recordings" / case.records[1].file), case.true))
    assert not found.refusals
    assert len(found.names) == 6
    for name, true, value, error in zip(
        found.names, found.true_values, found.estimates, found.standard_errors, strict=True
    ):
        assert abs(value - true) < 3 * error, name
        if "damping" not in name:
            assert value == pytest.approx(true, rel=1e-2)
