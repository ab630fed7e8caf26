"""The scenario of the installations knows every extra."""

from importlib.metadata import metadata

from tests.campaigns.installs import PARTS

WITHOUT_A_PART = {"all", "docs", "peers", "test"}
"""Sets of others, and what no user needs: packages of the site, of the tests and of the methods compared with."""


def test_every_extra_has_a_part_that_runs():
    assert set(PARTS) == set(metadata("rig-identify").get_all("Provides-Extra")) - WITHOUT_A_PART
