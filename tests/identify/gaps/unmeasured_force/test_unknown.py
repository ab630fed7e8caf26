"""A known force that nobody measured is found: its place, its time history and its law."""

import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace as changed

from identify.gaps.unmeasured_force import described_force, likeliest_force
from identify.gaps.unmeasured_force.evidence import evidence_with_force, evidence_without_force
from identify.gaps.unmeasured_force.location import ForcePlace, force_places, locate_force, response_of
from identify.gaps.unmeasured_force.nuisance import whitened_record
from identify.gaps.unmeasured_force.time_history import explained_share
from identify.gaps.unmeasured_force.whitened_record import force_noise_variance
from rig.errors import RigError
from rig.model.contact_laws import DeadZone
from rig.model.description import Contact, Sensor, Station
from rig.model.unmeasured_force import UnmeasuredForce

WITHIN_M = 0.01


def both(world, unknown, spoilt=None, rms_n=5.0):
    """A record to fit, and one of a higher level to validate."""
    return world.record(rms_n, unknown, spoilt), world.record(1.6 * rms_n, unknown, spoilt)


def force_in(world, unknown, spoilt=None, rms_n=5.0):
    fit, validation = both(world, unknown, spoilt, rms_n)
    estimate = likeliest_force(fit, world.rig, validation)
    force = described_force(estimate)
    assert force.same_place
    assert min(explained_share(estimate.on_fit_record), force.explained) >= 0.5
    return force


def test_drag_is_found_with_its_place_and_law(damped):
    drag, place_m = 10.0, 0.63
    force = force_in(damped, ((Station("beam", place_m),), lambda _, __, v: -drag * np.abs(v) * v), rms_n=20.0)
    assert (force.kind, force.body) == ("force", "beam")
    assert msgspec.json.decode(msgspec.json.encode(force), type=UnmeasuredForce) == force
    assert force.position_m == pytest.approx(place_m, abs=WITHIN_M)
    assert force.against == "velocity squared"
    assert force.law_parameters["coefficient"].value == pytest.approx(drag, rel=0.03)
    words = r"a force on the beam near ([0-9.]+) ± ([0-9.]+) m that grows with the square of the velocity, "
    numbers = re.match(words + r"c \|v\| v, c = ([0-9.]+) ± ([0-9.]+) N s²/m²", force.sentence).groups()
    stated_m, width_m, stated, width = map(float, numbers)
    assert (stated_m, stated) == pytest.approx((force.position_m, force.law_parameters["coefficient"].value), rel=0.01)
    assert abs(stated_m - place_m) < 1.5 * width_m < WITHIN_M
    assert abs(stated - drag) < width < 0.1 * drag


def test_sensors_that_the_diagnosis_does_not_use_are_no_candidates(world):
    """Displacement sensors beside accelerometers once raised an exception here."""
    laser = Sensor(name="laser", station=Station("beam", 1.0), quantity="displacement")
    rig = changed(world.rig, sensors=(laser, *world.rig.sensors))
    estimate = locate_force(whitened_record(replace(world.record(), rig=rig), rig))
    named = {place.sensor_name for place in force_places(rig, estimate.whitened_record.record.sensors)}
    assert named == {"", *(s.name for s in world.rig.sensors)}


def test_a_tone_that_runs_before_the_excitation_is_no_noise(world):
    amplitude_n, hz, place_m = 0.4, 31.3, 0.78
    place = Station("beam", place_m)
    force = force_in(world, ((place,), lambda t, _, __: amplitude_n * np.sin(2 * np.pi * hz * t)))
    assert force.position_m == pytest.approx(place_m, abs=WITHIN_M)
    assert force.frequency_hz == pytest.approx(hz, abs=0.01)
    assert force.amplitude_n == pytest.approx(amplitude_n, rel=0.05)
    assert force.against == "none"
    numbers = re.search(r"at ([0-9.]+) ± ([0-9.]+) Hz, ([0-9.]+) ± ([0-9.]+) N", force.sentence).groups()
    stated_hz, width_hz, stated_n, width_n = map(float, numbers)
    assert width_hz == pytest.approx(1.96 * force.law_parameters["f"].standard_error, rel=0.06)
    assert (stated_hz, stated_n) == pytest.approx((force.frequency_hz, force.amplitude_n), rel=1e-3, abs=0.0)
    assert abs(stated_n - amplitude_n) < 2 * width_n < 0.2 * amplitude_n


def test_a_random_force_has_a_band_and_no_law(world):
    rms_n, place_m = 0.3, 0.47
    history = world.random_n(rms_n, (5.0, 25.0))
    force = force_in(world, ((Station("beam", place_m),), lambda *_: history))
    assert force.position_m == pytest.approx(place_m, abs=WITHIN_M)
    assert force.law == ""
    assert force.rms_n == pytest.approx(rms_n, rel=0.15)
    assert 3 < force.band_hz[0] < force.band_hz[1] < 27
    assert force.before_excitation == pytest.approx(1.0, abs=0.5)
    assert "random force" in force.sentence


def test_a_support_that_yields_is_told_from_other_springs(damped):
    stiffness, yield_m, place_m = 100.0, 1e-3, 0.9
    law = ((Station("beam", place_m),), lambda _, w, __: -stiffness * yield_m * np.tanh(w / yield_m))
    force = force_in(damped, law)
    assert force.position_m == pytest.approx(place_m, abs=WITHIN_M)
    assert force.law_name == "softening spring"
    assert force.law_parameters["coefficient"].value == pytest.approx(stiffness, rel=0.05)
    assert force.law_parameters["w0"].value == pytest.approx(yield_m, rel=0.05)
    for name, true in (("coefficient", stiffness), ("w0", yield_m)):
        assert abs(force.law_parameters[name].value - true) < 1.96 * force.law_parameters[name].standard_error


def test_a_pair_pushes_both_bodies(two):
    place_m, damping = 0.6, 8.0
    stations = (Station("upper", place_m), Station("lower", place_m))
    force = force_in(two, (stations, lambda _, __, v: -damping * v))
    assert (force.kind, {force.body, force.against_body}) == ("pair", {"upper", "lower"})
    assert force.position_m == pytest.approx(place_m, abs=WITHIN_M)
    assert force.law_name == "viscous damping"
    assert force.law_parameters["coefficient"].value == pytest.approx(damping, rel=0.05)
    estimate = force.law_parameters["coefficient"]
    assert abs(estimate.value - damping) < 1.96 * estimate.standard_error


def test_a_sensor_that_clips_is_a_sensor(world):
    row = 3

    def clipped(signals):
        limit = 1.5 * signals[row].std()
        return np.where((np.arange(len(signals)) == row)[:, None], np.clip(signals, -limit, limit), signals)

    force = force_in(world, None, clipped)
    assert (force.kind, force.sensor) == ("sensor", world.rig.sensors[row].name)
    assert force.sentence == f"a fault of sensor {force.sensor}: its signal does not follow the motion"


def test_a_null_shows_no_force(world):
    fit, validation = both(world, None)
    force = described_force(likeliest_force(fit, world.rig, validation))
    assert force.explained < 0.3
    assert force.law == ""


def test_a_small_force_is_placed_and_gains_more_than_nothing(world):
    history = world.random_n(0.01)
    small = ((Station("beam", 0.7),), lambda *_: history)
    records = [both(world, unknown) for unknown in (None, small)]
    nothing, with_force = (likeliest_force(fit, world.rig, validation) for fit, validation in records)
    assert with_force.same_place
    assert explained_share(with_force.at_fit_place) < 0.5
    assert with_force.at_fit_place.criterion_decrease > 2 * max(nothing.at_fit_place.criterion_decrease, 0.0)


def test_nuisances_do_not_shrink_the_data(world):
    """Scaling down all that was measured, and the force with it, makes every residual smaller, and explains nothing."""
    whitened = whitened_record(world.record(), world.rig)
    fitted = evidence_without_force(whitened)
    gains = [v for p, v in zip(whitened.nuisance_parameters, fitted.theta, strict=True) if p.kind.endswith("gain")]
    assert len(gains) == len(world.rig.sensors) + 1
    assert np.max(np.abs(gains)) < 4
    shrinking = evidence_without_force(replace(whitened, trace_terms=np.zeros_like(whitened.trace_terms)))
    assert np.sum(shrinking.theta**2) > np.sum(fitted.theta**2)


def test_the_criterion_falls_most_at_the_true_place(world):
    history = world.random_n(0.3)
    place_m = 0.5
    whitened = whitened_record(world.record(5.0, ((Station("beam", place_m),), lambda *_: history)), world.rig)
    before = evidence_without_force(whitened)

    def criterion(at_m):
        response = response_of(whitened, ForcePlace("force", (Station("beam", at_m),)))
        return evidence_with_force(whitened, response, before).criterion

    lowest = criterion(place_m)
    assert lowest < before.criterion
    assert all(lowest < criterion(x) for x in (0.3, 0.45, 0.47, 0.53, 0.55, 0.8))


def test_the_place_has_an_honest_error(world):
    history = world.random_n(0.05)
    place_m = 0.5
    whitened = whitened_record(world.record(5.0, ((Station("beam", place_m),), lambda *_: history)), world.rig)
    estimate = locate_force(whitened)
    assert 0 < estimate.position_error_m < WITHIN_M
    assert abs(estimate.force_place.stations[0].position_m - place_m) < max(6 * estimate.position_error_m, 2e-3)


def test_the_noise_of_the_force_channel_is_heard(world):
    record = world.record()
    described = record.sample_count * 5e-4**2 * record.sample_rate_hz / 2
    assert force_noise_variance(record) == pytest.approx(described, rel=0.3)


def test_too_few_sensors_are_refused(world):
    record = world.record()
    law = DeadZone(lower_clearance_m=1e-3, upper_clearance_m=1e-3, stiffness_n_per_m=1e4)
    stops = tuple(
        Contact(name=f"stop_{i}", at=s.station, against=None, law=law) for i, s in enumerate(world.rig.sensors)
    )
    rig = changed(world.rig, contacts=stops)
    with pytest.raises(RigError, match="6 sensors and 6 contacts leave nothing that could show an unmeasured force"):
        whitened_record(replace(record, rig=rig, drifts=(None,) * len(stops)), rig)
