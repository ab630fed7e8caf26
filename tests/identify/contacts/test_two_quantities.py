"""Stations with an accelerometer and a displacement sensor: a cantilever between stops, whose slow forces the
displacements tell, simulated by the plant `modal`."""

from dataclasses import replace as replace_fields

import numpy as np
import pytest
from msgspec.structs import replace

from identify.contacts.acceptance import estimated_contacts
from identify.contacts.separation import separate
from identify.linear.nuisance import NuisanceKind
from identify.pages.wording import COVERED
from rig.model.tolerances import LABORATORY
from rig.recording import read
from tests.campaigns.spoiling.alteration import mapped
from tests.campaigns.topologies import RIGS, Topology, one_mass, recorded

CASE = RIGS["cantilever with a stop at its tip"]
TIP = CASE.rig.contacts[0].at
DENSITIES = {"acceleration": 1e-3, "displacement": 1e-8}
CHANNELS = [f"beam_1000_{quantity}" for quantity in DENSITIES]


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """12 s by an accelerometer and a displacement sensor at each of three stations."""
    stations = [s for s in CASE.rig.sensors if s.station.position_m in (0.4, 0.8, 1.0)]
    sensors = tuple(
        replace(s, name=f"{s.name}_{quantity}", quantity=quantity, noise_density=density)
        for quantity, density in DENSITIES.items()
        for s in stations
    )
    case = replace_fields(CASE, rig=replace(CASE.rig, sensors=sensors))
    return read(recorded(case, tmp_path_factory.mktemp("held") / "r.mcap", duration_s=12.0))


def assert_answered(contacts):
    (estimate,) = contacts.outcomes.estimates.values()
    law = CASE.rig.contacts[0].law
    for value, error, true in (
        (estimate.values[0], estimate.errors[0], law.lower_clearance_m),
        (estimate.values[1], estimate.errors[1], law.upper_clearance_m),
        (estimate.stiffness_n_per_m, estimate.errors[2], law.stiffness_n_per_m),
    ):
        assert abs(value - true) < COVERED * error < 0.02 * true
    assert estimate.sides_known
    assert not contacts.findings


def test_the_stated_noise_of_the_forces_is_that_of_the_quiet_second(recording):
    (record,) = separate(recording, "auto", LABORATORY).records
    assert record.noise_n == pytest.approx(record.quiet_deviation_n, rel=0.2)


def test_the_force_on_a_single_mass_has_the_errors_of_its_accelerometer(tmp_path):
    """Its displacement sensor, though quieter, moves the relative displacement alone."""
    rig = one_mass(1e-3, frequency_hz=0.0, damping_ratio=0.0)
    (sensor,) = rig.sensors
    sensors = tuple(
        replace(sensor, name=quantity, quantity=quantity, noise_density=density)
        for quantity, density in DENSITIES.items()
    )
    path = recorded(Topology(replace(rig, sensors=sensors), 6.0, ""), tmp_path / "r.mcap", duration_s=8.0)
    separation = separate(read(path), "auto", LABORATORY)
    ((record,), parameters) = separation.records, separation.forces.nuisances.parameters
    by_name = dict(zip((p.name for p in parameters), record.nuisance_n, strict=True))
    assert np.std(by_name["gain of acceleration"]) > 0.5 * LABORATORY.gain * np.std(record.force_n)
    assert not np.any(by_name["gain of displacement"])
    assert not np.any(by_name["delay of displacement"])
    shifted = {p.name for p, shifts in zip(parameters, record.shifts_eta, strict=True) if shifts}
    assert {"gain of displacement", "delay of displacement"} <= shifted


def test_a_clearance_is_found_by_both_sensors_and_no_worse_than_by_displacements(recording):
    both, displacements = (estimated_contacts(recording, use, LABORATORY) for use in ("auto", "displacement"))
    assert_answered(both)
    errors_m = [contacts.outcomes.estimates["tip"].clearance_error_m for contacts in (both, displacements)]
    assert errors_m[0] < 1.1 * errors_m[1]


def test_displacements_at_the_contact_alone_tell_its_sides(recording):
    sensors = tuple(s for s in recording.rig.sensors if s.quantity == "acceleration" or s.station == TIP)
    displacements = recording.signals["displacement"]
    row = displacements.channels.names.index(CHANNELS[1])
    channels = replace_fields(displacements.channels, names=(CHANNELS[1],), stations=(TIP,))
    tip_alone = replace_fields(displacements, channels=channels, values=displacements.values[[row]])
    signals = {**recording.signals, "displacement": tip_alone}
    fewer = replace_fields(recording, rig=replace(recording.rig, sensors=sensors), signals=signals)
    assert_answered(estimated_contacts(fewer, "auto", LABORATORY))


@pytest.mark.parametrize("channel", CHANNELS)
def test_the_change_by_a_gain_is_that_of_the_channel_that_is_used(recording, channel):
    """Signals of the nuisance parameter against the difference of two separations without it."""
    spoilt = mapped((channel,), lambda row: (1 + LABORATORY.gain) * row)(recording)
    nominal, changed = (separate(r, "auto", LABORATORY) for r in (recording, spoilt))
    parameters = [(p.kind, p.owner) for p in nominal.forces.nuisances.parameters]
    nuisance_n = nominal.forces.nuisances.force_n[parameters.index((NuisanceKind.GAIN, channel)), 0]
    expected_n = changed.forces.force_n[0] - nominal.forces.force_n[0]
    middle = slice(len(nuisance_n) // 8, -len(nuisance_n) // 8)
    assert np.linalg.norm((nuisance_n - expected_n)[middle]) < 0.1 * np.linalg.norm(expected_n[middle])
