"""Annular contacts: the law and its derivatives, recovery from records that another simulator made, and refusals."""

import dataclasses
from functools import cache
from itertools import compress

import numpy as np
import pytest
from msgspec.structs import replace

import identify
from identify.contacts.annular_estimate import AnnularEstimate
from identify.contacts.annular_record import annular_record, open_force_n
from identify.contacts.pooled import pooled_report
from identify.contacts.refusals import ContactRefusedError, RefusalCode, RemedyCode
from identify.contacts.ring_shares import ring_shares
from identify.contacts.separation import separate_planes
from identify.contacts.space_contacts import annular_records
from identify.contacts.space_identification import COUPLED_RINGS
from identify.linear.nuisance import SINGLE_FORCE_NAME, Nuisance, NuisanceKind
from identify.pages.wording import COVERED
from identify.planning.planned_test import planned_test, random_forces_n
from rig import BarrelCradleAnnular, record
from rig.errors import RigError
from rig.model.contact_laws.dead_zone import symmetric_dead_zone
from rig.model.description import PointSpring, Station
from rig.model.tolerances import EXACT, LABORATORY
from rig.recording import Recording, Signals, channel_groups, plane_recording
from rig.simulation.replay import modal
from tests.campaigns.annular import RATE_HZ, believed_rig, errors_of
from tests.campaigns.space_simulator import Accelerometer, Ring, SpaceMachine, Tube, simulated
from tests.identify.contacts.contact_records import contact_record
from tests.identify.small_rigs import MASS_IN_RING

SECONDS = 12.0
VALUES = np.array([2e-3, 5e5, 200.0, 0.1, np.log(0.01), 0.0, 1e-4, -2e-4, 0.0, 0.0])
PLACES = (("cradle", (0.25, 0.45, 0.75, 1.0)), ("barrel", (0.0, 0.25, 0.55, 1.0)))


def machine(gravity):
    """The reference rig barrel_cradle_annular."""
    return SpaceMachine(
        barrel=Tube("barrel", False, 1.0, 0.06, 0.04),
        cradle=Tube("cradle", True, 1.0, 0.08, 0.064),
        rings=tuple(
            Ring(f"contact_{k}", barrel_m, cradle_m, 2e-3, 5e5, 200.0, 0.1, 0.01)
            for k, (barrel_m, cradle_m) in enumerate(((0.0, 0.45), (0.55, 1.0)), 1)
        ),
        sensors=tuple(Accelerometer(body, position_m) for body, places in PLACES for position_m in places),
        force_m=1.0,
        gravity=gravity,
    )


@cache
def recorded(gravity, sensors=()):
    """Recording of the reference rig, and what is true of it."""
    built = machine(gravity)
    built = dataclasses.replace(built, sensors=sensors or built.sensors)
    truth = simulated(built, 60.0, round(SECONDS * RATE_HZ), RATE_HZ, 1)
    rig = believed_rig(built)
    rows = {"force": truth.forces_n, "acceleration": truth.accelerations.reshape(len(rig.sensors), -1)}
    signals = {name: Signals(channels, 0.0, rows[name]) for name, channels in channel_groups(rig).items()}
    return Recording(rig, signals, {}), truth


@pytest.fixture(scope="module", params=[True, False], ids=["weight", "floating"])
def found(request):
    recording, truth = recorded(request.param)
    return identify.contact(recording, tolerances="exact"), truth, request.param


def test_every_quantity_is_recovered_within_its_interval(found):
    result, _, _ = found
    assert not result.report.findings
    assert not result.report.unanswered
    for estimate, ring in zip(result.report.contacts, machine(True).rings, strict=True):
        row = errors_of(estimate, ring)
        for name in ("clearance_m", "stiffness_n_per_m", "damping_n_s_per_m", "friction_coefficient"):
            half = row[f"{name}_half_percent"]
            assert abs(row[f"{name}_error_percent"]) < 1.5 * half < 1.0
        speed = estimate.sliding_speed_m_per_s
        assert abs(speed.value - 0.01) < 1.5 * COVERED * speed.standard_error < 1e-3


def test_nifo_in_either_direction_tells_the_stiffness(found):
    """The equation of y and that of z by themselves, each in the middle of its lines, from a motion in both."""
    result, _, _ = found
    assert not result.report.notes
    assert [equation.equation for equation in result.report.nifo] == [
        f"barrel {mode} in {direction}" for direction in "yz" for mode in (1, 2, 3, 4)
    ]
    for methods in result.identification.methods:
        nifo = methods.main_nifo_results[0]
        assert nifo.contact_indices == (0, 1)
        for ring, stiffness_n_per_m in zip(machine(True).rings, nifo.stiffness_n_per_m.real, strict=True):
            assert np.median(stiffness_n_per_m) == pytest.approx(ring.stiffness_n_per_m, rel=0.02)


def test_the_centre_and_the_force_at_rest_are_known_under_weight_alone(found):
    result, truth, weight = found
    for estimate, rest_m, ring in zip(result.report.contacts, truth.rest_m, machine(True).rings, strict=True):
        assert ("its centre lies" in estimate.law_sentence) == weight
        if not weight:
            assert estimate.center_y_m is None
            continue
        for center, true_m in zip((estimate.center_y_m, estimate.center_z_m), -rest_m, strict=True):
            assert abs(center.value - true_m) < 2 * COVERED * center.standard_error < 1e-5
        rest_n = ring.stiffness_n_per_m * (rest_m[0] + ring.clearance_m)
        assert abs(estimate.rest_force_y_n.value - rest_n) < 2 * COVERED * estimate.rest_force_y_n.standard_error
        assert abs(estimate.rest_force_y_n.value - rest_n) < 0.003 * abs(rest_n)


def test_shares_are_those_of_the_true_motion(found):
    result, truth, _ = found
    begins = result.identification.contacts.separations[0].motion.excited_from
    for k, (name, estimate) in enumerate(result.identification.contacts.annular.items()):
        true_m = np.hypot(*truth.eta_m[:, k, begins : estimate.eta_m.shape[1]])
        shares = result.report.contacts[k].ring
        assert result.report.contacts[k].name == name
        assert shares.free == pytest.approx(np.mean(true_m < 2e-3), abs=2e-3)
        assert shares.free + shares.sliding + shares.sticking == pytest.approx(1.0)


def test_the_identified_rig_has_the_numbers_and_the_files_are_written(found, tmp_path):
    result, _, _ = found
    for contact, estimate in zip(result.rig.contacts, result.report.contacts, strict=True):
        assert contact.law.clearance_m == estimate.clearance_m.value
        assert contact.law.friction_coefficient == max(0.0, estimate.friction_coefficient.value)
        assert contact.law.sliding_speed_m_per_s == estimate.sliding_speed_m_per_s.value
    result.save(tmp_path)
    page = (tmp_path / "contact.html").read_text(encoding="utf-8")
    assert all(word in page for word in ("friction", "sliding speed, mm/s", "never pulling", "scatter of the record"))
    assert {"orbit.png", "radial.png", "ring_surface.png", "friction.png", "kinds.png", "nifo.png"} <= {
        path.name for path in tmp_path.iterdir()
    }
    assert "friction" in str(result)
    assert result["contact_1"].friction.unit == "1"


def test_segments_add_their_whirls(found):
    report = found[0].report
    pooled = pooled_report([report, report])
    for one, both in zip(report.contacts, pooled.contacts, strict=True):
        assert both.ring.whirls == one.ring.whirls * 2
        assert both.ring.free == pytest.approx(one.ring.free)
        assert both.friction_coefficient.value == pytest.approx(one.friction_coefficient.value)


def test_a_quarter_of_whirling_a_quarter_of_rocking_and_half_free():
    """Two turns along the wall at 20 mm/s, then so much time at rest on it, then amid the ring."""
    rate_hz, turn_s = 1000.0, 2 * np.pi * 2.1e-3 / 0.02
    samples = round(2 * turn_s * rate_hz)
    turning = 2 * np.pi * np.arange(samples) / (turn_s * rate_hz)
    angle = np.r_[turning, np.full(samples, turning[-1]), np.zeros(2 * samples)]
    radius = np.r_[np.full(2 * samples, 2.1e-3), np.full(2 * samples, 1e-4)]
    eta = radius * np.stack([np.cos(angle), np.sin(angle)])
    rate = np.where(np.arange(angle.size) < samples, 0.02, 0.0) * np.stack([-np.sin(angle), np.cos(angle)])
    estimate = AnnularEstimate(
        values=VALUES,
        covariances=dict.fromkeys(("scatter", "tolerances", "drift", "law"), np.zeros((10, 10))),
        sides_known=False,
        center_known=False,
        pulls=np.zeros(0),
        eta_m=eta,
        rate_m_per_s=rate,
        force_n=np.zeros((2, 1)),
        unexplained_share=0.0,
        split_half_z=(0.0, 0.0),
    )
    shares = ring_shares(estimate, rate_hz, 0, 3.0)
    assert (shares.free, shares.sliding, shares.sticking) == pytest.approx((0.5, 0.25, 0.25))
    assert shares.touched_sectors == 1.0
    ((begins_s, ends_s),) = shares.whirls
    assert begins_s == pytest.approx(3.0)
    assert ends_s == pytest.approx(3.0 + (2 * samples - 1) / rate_hz)


def test_what_a_body_has_in_common_is_one_parameter_of_both_directions():
    parameters = [
        Nuisance(NuisanceKind.FORCE_GAIN, SINGLE_FORCE_NAME),
        Nuisance(NuisanceKind.MASS, "barrel"),
        Nuisance(NuisanceKind.FREQUENCY, "barrel"),
        Nuisance(NuisanceKind.FREQUENCY, "barrel", 3),
    ]
    plane = contact_record(np.zeros(10), np.zeros((len(parameters), 10)))
    record = annular_record((plane, plane), (parameters, parameters), (("force_1",), ("force_2",)), 0)
    assert [p.name for p in record.parameters] == [
        "force gain of force_1",
        "mass of barrel",
        "frequency of barrel",
        "frequency of barrel (y) 3",
        "force gain of force_2",
        "frequency of barrel (z) 3",
    ]
    assert record.pull_indices[1].tolist() == [4, 1, 2, 5]


def test_the_force_of_an_open_contact_is_where_forces_are_densest():
    rng = np.random.default_rng(0)
    is_open = rng.uniform(size=20000) < 0.2
    force = np.where(is_open, [[110.0], [-3.0]], rng.normal(0, 300, (2, 20000))) + rng.normal(0, 0.5, (2, 20000))
    planes = tuple(contact_record(row, np.zeros((0, row.size))) for row in force)
    record = annular_record(planes, ([], []), (("force_1",), ("force_2",)), 0)
    assert np.abs(open_force_n(record) - [110.0, -3.0]).max() < 0.5


def in_y_alone(recording):
    """The recording without its sensors in z."""
    sensors = tuple(s for s in recording.rig.sensors if s.station.direction == "y")
    rig = replace(recording.rig, sensors=sensors)
    rows = [recording.values_of(s) for s in sensors]
    channels = channel_groups(rig)["acceleration"]
    signals = {**recording.signals, "acceleration": Signals(channels, 0.0, np.stack(rows))}
    return dataclasses.replace(recording, rig=rig, signals=signals)


def test_sensors_in_one_direction_are_refused_and_in_both_are_not(found):
    recording, _ = recorded(False)
    with pytest.raises(ContactRefusedError, match="has no sensor in z") as error:
        identify.contact(in_y_alone(recording))
    assert error.value.refusal.code == RefusalCode.ONE_DIRECTION
    assert error.value.refusal.remedy == RemedyCode.MEASURE_BOTH_DIRECTIONS
    assert len(found[0].report.contacts) == 2  # the remedy done


def test_weight_on_a_contact_of_one_direction_is_refused():
    recording, _ = recorded(True)
    plane = replace(recording.rig.contacts[0], law=symmetric_dead_zone(2e-3, 5e5))
    rig = replace(recording.rig, contacts=(plane, *recording.rig.contacts[1:]))
    with pytest.raises(ContactRefusedError, match="contact 'contact_1' in y that is not annular"):
        identify.contact(dataclasses.replace(recording, rig=rig))
    flat = plane_recording(recording, "y")
    with pytest.raises(RigError, match="it has gravity"):
        identify.contact(flat)


def test_a_contact_of_one_direction_beside_an_annular_one_is_its_plane_rigs():
    """contact_1 as a dead zone in y and one in z in place of the ring: refused or found, but both are answered."""
    recording, _ = recorded(False)
    first, second = recording.rig.contacts
    law = symmetric_dead_zone(2e-3, 5e5)
    at, against = (replace(station, direction="z") for station in (first.at, first.against))
    in_z = replace(first, name="sideways", law=law, at=at, against=against)
    rig = replace(recording.rig, contacts=(replace(first, law=law), in_z, second))
    report = identify.contact(dataclasses.replace(recording, rig=rig), tolerances="exact").report
    names = {contact.name: contact.law for contact in report.contacts} | {u.name: "" for u in report.unanswered}
    assert set(names) == {"contact_1", "sideways", "contact_2"}
    assert names["contact_2"] == "annular"


def test_check_takes_both_directions():
    recording, _ = recorded(True)
    assert identify.check(recording, tolerances="exact").sound
    accelerations = recording.signals["acceleration"]
    values = accelerations.values.copy()
    values[12] *= -1  # barrel, z
    wrong = {**recording.signals, "acceleration": dataclasses.replace(accelerations, values=values)}
    findings = identify.check(dataclasses.replace(recording, signals=wrong), tolerances="exact").findings
    assert recording.rig.sensors[12].name in {name for finding in findings for name in finding.channels}
    values[12] = values[4]  # the barrel's y at that place
    names = (recording.rig.sensors[4].name, recording.rig.sensors[12].name)
    findings = identify.check(dataclasses.replace(recording, signals=wrong), tolerances="exact").findings
    assert [f.channels for f in findings if f.cause == "copy"] == [names]


@pytest.mark.parametrize("frequency_hz", [0.0, 4.0])
def test_a_single_mass_is_not_compared_while_its_ring_is_open(frequency_hz):
    """Near the middle of one direction a ring may be closed in the other."""
    (mass,) = MASS_IN_RING.bodies
    rig = replace(MASS_IN_RING, bodies=(replace(mass, frequency_hz=frequency_hz),), gravity_m_per_s2=0.0)
    test = planned_test(rig, SECONDS, 20.0, (1.0, 50.0))
    result = identify.contact(modal(rig, rig, random_forces_n(test, 1), 1))
    assert not result.report.findings
    (ring,) = result.identification.contacts.annular.values()
    assert ring.widening_factor < 1.5  # sqrt(1 + p^2) by the pull p of its mass in the fit


def test_the_share_of_the_motion_across_is_in_the_intervals():
    """Accelerometers that show up to 2 % of the motion across: with its tolerance nothing is off by more than the
    intervals say; without it values are."""
    shares = np.random.default_rng(3).uniform(-0.02, 0.02, (8, 2))
    built = machine(True)
    sensors = tuple(dataclasses.replace(s, crossing=tuple(c)) for s, c in zip(built.sensors, shares, strict=True))
    recording, truth = recorded(True, sensors)
    known, ignored = (
        identify.contact(recording, tolerances=replace(EXACT, cross_axis=share)).report for share in (0.01, 0.0)
    )
    assert not known.findings
    errors = {}
    for report in (known, ignored):
        for contact, ring, rest_m in zip(report.contacts, built.rings, truth.rest_m, strict=True):
            estimates = (contact.clearance_m, contact.stiffness_n_per_m, contact.center_y_m, contact.center_z_m)
            true = (ring.clearance_m, ring.stiffness_n_per_m, *-rest_m)
            errors.setdefault(report is known, []).extend(
                abs(e.value - x) / e.standard_error for e, x in zip(estimates, true, strict=True)
            )
    assert max(errors[True]) < 2 * COVERED
    assert max(errors[False]) > 3 * COVERED


def test_a_delay_shifts_the_relative_displacement_in_the_whole_band():
    recording, _ = recorded(False)
    planes = [plane_recording(recording, direction) for direction in "yz"]
    y, z = separate_planes(planes, "auto", LABORATORY)
    ring = annular_records(recording.rig, (y, z), LABORATORY)["contact_1"].planes[0]
    parameters = list(compress(y.forces.nuisances.parameters, ring.shifts_eta))
    row = parameters.index(Nuisance(NuisanceKind.DELAY, "barrel_0000mm_acceleration"))
    velocity = y.motion.velocity_m_per_s[y.motion.row(Station("barrel", 0.0)), : ring.eta_m.size]
    shift = -LABORATORY.delay_s * velocity

    def error(nuisance_m):
        inside = slice(4096, -4096)
        return np.std((nuisance_m - shift)[inside]) / np.std(shift[inside])

    (separated,) = (r for r in y.records if np.array_equal(r.force_n, ring.force_n))
    assert error(ring.nuisance_m[row]) < 1e-3
    assert error(separated.nuisance_m[row]) > 3e-3  # in the band of the forces alone


def test_that_ground_springs_couple_the_slow_motions_of_rings_is_said(found):
    recording, _ = recorded(False)
    springs = tuple(
        PointSpring(station=Station("barrel", x, direction), stiffness_n_per_m=1.0)
        for x in (0.0, 1.0)
        for direction in "yz"
    )
    held = dataclasses.replace(recording, rig=replace(recording.rig, springs=springs))
    assert COUPLED_RINGS in identify.contact(held, tolerances="exact").report.notes
    assert COUPLED_RINGS not in found[0].report.notes


def test_displacements_beside_accelerations_have_shares_across_of_their_own(tmp_path):
    """Displacement sensors that are the quieter ones up to some hundred hertz, and all sensors with 2 % of the motion
    across at most: nothing is off by more than its interval says."""
    settings = BarrelCradleAnnular(duration_s=12.0, noise_density=1e-3)
    described = settings.rig()
    quiet = tuple(replace(s, noise_density=1e-8) if s.quantity == "displacement" else s for s in described.sensors)
    described = replace(described, sensors=quiet)
    recording = record(described, tmp_path / "both.mcap", force=settings.force(), duration_s=12.0, plant="modal")
    shares = np.random.default_rng(5)
    signals = dict(recording.signals)
    for quantity in ("displacement", "acceleration"):
        sensors = [s for s in described.sensors if s.quantity == quantity]
        places = [(s.station.body, s.station.position_m, s.station.direction) for s in sensors]
        across = [places.index((body, x, "z" if direction == "y" else "y")) for body, x, direction in places]
        values = signals[quantity].values
        crossed = values + shares.uniform(-0.02, 0.02, (len(sensors), 1)) * values[across]
        signals[quantity] = dataclasses.replace(signals[quantity], values=crossed)
    crossed_recording = dataclasses.replace(recording, signals=signals)
    report = identify.contact(crossed_recording, tolerances=replace(EXACT, cross_axis=0.01)).report
    assert not report.findings
    for contact in report.contacts:
        for estimate, true in ((contact.clearance_m, 2e-3), (contact.stiffness_n_per_m, 5e5)):
            assert abs(estimate.value - true) < 2 * COVERED * estimate.standard_error


def spring_held(frequency_hz):
    """True rest of a mass in a ring and on a spring, and what is identified of it."""
    (mass,) = MASS_IN_RING.bodies
    rig = replace(MASS_IN_RING, bodies=(replace(mass, frequency_hz=frequency_hz, damping_ratio=0.02),))
    test = planned_test(rig, 20.0, 60.0, (1.0, 80.0))
    (contact,) = identify.contact(modal(rig, rig, random_forces_n(test, 1), 1), tolerances="exact").report.contacts
    spring_n_per_m = mass.mass_kg * (2 * np.pi * frequency_hz) ** 2
    law = rig.contacts[0].law
    weight_n = mass.mass_kg * rig.gravity_m_per_s2
    depth_m = (weight_n - spring_n_per_m * law.clearance_m) / (law.stiffness_n_per_m + spring_n_per_m)
    return contact, law.clearance_m + depth_m, law.stiffness_n_per_m * max(0.0, depth_m)


def test_a_spring_that_bears_part_of_the_weight_is_not_taken_for_the_wall():
    contact, below_center_m, wall_n = spring_held(4.0)
    for estimate, true in ((contact.center_y_m, below_center_m), (contact.rest_force_y_n, -wall_n)):
        assert abs(estimate.value - true) < 2 * COVERED * estimate.standard_error
        assert estimate.standard_error < 0.02 * abs(true)


def test_a_mass_that_hangs_within_its_ring_rests_without_a_force_of_the_wall():
    contact, _, wall_n = spring_held(20.0)
    assert wall_n == 0
    assert contact.rest_force_y_n.value == 0
