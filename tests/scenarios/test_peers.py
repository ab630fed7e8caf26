"""Head to head with other methods: the table's numbers, what is not installed, and one peer against the truth."""

from pathlib import Path

import msgspec
import pytest

from rig.api import record
from rig.simulation.reference import Sdof
from scenarios.peers.methods import METHODS, Method, this_project
from scenarios.peers.output_error import output_error
from scenarios.peers.peer_data import ContactAnswer, peer_data
from scenarios.peers.table import PeerOutcome, PeerTrial, row


def outcome(seed: int, clearance_m: float | None, stiffness: float, reach_m: float | None = None) -> PeerOutcome:
    answer = ContactAnswer(
        contact="stop", clearance_m=clearance_m, stiffness_n_per_m=stiffness, clearance_half_width_m=reach_m
    )
    trial = PeerTrial("some", "sdof", seed)
    return PeerOutcome(trial=trial, versions="some 1.0", true=((1e-3, 1e4),), answers=(answer,), cpu_s=2.0 * seed)


def test_row_holds_median_and_largest_errors_the_intervals_that_cover_and_the_mean_time() -> None:
    outcomes = [outcome(1, 1.01e-3, 1.02e4, 2e-5), outcome(2, 0.97e-3, 0.9e4, 1e-5), outcome(3, 1.02e-3, 1.03e4, 3e-5)]
    assert row("a peer", "nothing", outcomes) == ("sdof", "a peer", "2, 3", "3, 10", "2 of 3", "4", "nothing")


def test_row_of_a_method_that_is_told_the_clearance_has_no_interval_and_counts_failures() -> None:
    failed = msgspec.structs.replace(outcome(3, None, 0.0), answers=(), failure="ValueError: no")
    cells = row("a peer", "all", [outcome(1, None, 1.1e4), failed])
    assert cells == ("sdof", "a peer (1 of 2 failed)", "told", "10, 10", "none", "2", "all")


def test_method_without_its_package_is_not_installed() -> None:
    assert METHODS["ours"].installed
    assert not Method("a peer", ("no_such_module",), ("no-such-package",), "nothing", this_project).installed


def test_output_error_finds_the_stop_of_a_simulated_mass(tmp_path: Path) -> None:
    settings = Sdof(noise_density=1e-3, sensors="displacement+velocity+acceleration", duration_s=6.0)
    recording = record(settings.rig(), tmp_path / "mass.mcap", force=settings.force(), duration_s=6.0, step_s=2.0**-13)
    (answer,) = output_error(peer_data(recording))
    assert answer.clearance_m == pytest.approx(settings.clearance_m, rel=0.01)
    assert answer.stiffness_n_per_m == pytest.approx(settings.stiffness_n_per_m, rel=0.02)
    assert answer.clearance_half_width_m is not None
    assert abs(answer.clearance_m - settings.clearance_m) < 2 * answer.clearance_half_width_m
