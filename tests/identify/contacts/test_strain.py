"""Strain gauges in the separation of contact forces: their rows by beam theory, the slow motion that they carry, and
contacts within their intervals."""

from dataclasses import replace as with_fields

import numpy as np
import pytest
from msgspec.structs import replace

from identify.contacts.gauges import gauges_and_motion_of
from identify.contacts.identification import identify_contact
from identify.contacts.separation import separate
from identify.contacts.slow_motion import low_pass
from identify.linear.model import ResponseCache, accelerances, response_of
from identify.pages.wording import COVERED
from identify.signals.kinematics import kinematics
from identify.signals.spectra import decimated
from rig.model.beam import Beam
from rig.model.contact_laws.dead_zone import symmetric_dead_zone
from rig.model.description import Contact, ForceSensor, Rig, Sensor, Station
from rig.model.tolerances import EXACT, LABORATORY
from rig.recording import channel_groups, read, read_truth, truth_path
from rig.simulation.excitation import excitation_of
from rig.simulation.plants import plant_named
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle

pytestmark = pytest.mark.long

LENGTH_M, CLEARANCE_M, STIFFNESS_N_PER_M = 1.0, 5e-4, 2e4
GAUGES_M = (0.05, 0.3, 0.6)
INFINITE = float("inf")


def beam(ends="clamped-free"):
    return Beam(name="beam", ends=ends, length_m=LENGTH_M, width_m=0.05, thickness_m=0.01, damping_ratio=0.02)


def cantilever(lower_clearance_m=CLEARANCE_M):
    """A clamped beam with AC-coupled accelerometers, strain gauges, and stops at its tip."""
    law = replace(symmetric_dead_zone(CLEARANCE_M, STIFFNESS_N_PER_M, 5.0), lower_clearance_m=lower_clearance_m)

    def sensor(letter, x, **fields):
        return Sensor(name=f"{letter}{1000 * x:04.0f}", station=Station("beam", x), **fields)

    accelerometer = {"quantity": "acceleration", "noise_density": 3e-4, "high_pass_hz": 0.5}
    accelerometers = (sensor("a", x, **accelerometer) for x in (0.5, LENGTH_M))
    gauges = (sensor("e", x, quantity="strain", noise_density=1e-9) for x in GAUGES_M)
    return Rig(
        name="cantilever",
        bodies=(beam(),),
        contacts=(Contact(name="stop", at=Station("beam", LENGTH_M), law=law),),
        force_at=Station("beam", 0.7),
        sensors=(*accelerometers, *gauges),
        sample_rate_hz=512.0,
    )


def off_by_tolerances(rig, seed):
    """The rig as a laboratory has it: everything off by one draw of its tolerance."""
    rng, tolerances = np.random.default_rng(seed), LABORATORY

    def factor(tolerance):
        return 1 + tolerance * rng.standard_normal()

    def actual(sensor):
        place_m = sensor.station.position_m + tolerances.position_m * rng.standard_normal()
        station = Station("beam", float(np.clip(place_m, 0, LENGTH_M)))
        return replace(sensor, gain=factor(tolerances.gain), station=station)

    body = beam().scale_mass(factor(tolerances.mass)).scale_frequencies(factor(tolerances.frequency))
    return replace(
        rig,
        bodies=(body.scale_damping(factor(tolerances.damping)),),
        sensors=tuple(actual(sensor) for sensor in rig.sensors),
        force_sensor=ForceSensor(gain=factor(tolerances.force_gain)),
    )


def slow_force(seed=1, low_hz=0.02, high_hz=0.4):
    return excitation_of("gaussian", rms_n=6.0, low_hz=low_hz, high_hz=high_hz, seed=seed)


def recorded(rig, path, force, *, plant="modal", duration_s=30.0, step_s=2.0**-13, actual=None):
    record(
        rig,
        force,
        plant=plant_named(plant),
        duration_s=duration_s,
        step_s=step_s,
        path=path,
        progress=lambda _: None,
        actual=actual,
    )
    return read(path)


@pytest.fixture(scope="module")
def slow(tmp_path_factory):
    """A beam that meets two stops below the corner of its accelerometers."""
    path = tmp_path_factory.mktemp("slow") / "r.mcap"
    return recorded(cantilever(), path, slow_force(), actual=off_by_tolerances(cantilever(), 1))


def only(recording, sensors):
    """The recording with these sensors alone."""
    rig = replace(recording.rig, sensors=sensors)
    signals = {"force": recording.signals["force"]}
    for group, channels in channel_groups(rig).items():
        if group != "force":
            rows = np.stack([recording.values_of(s) for s in sensors if s.quantity == group])
            signals[group] = with_fields(recording.signals[group], channels=channels, values=rows)
    return with_fields(recording, rig=rig, signals=signals)


def assert_found(identification, *, clearance_share, stiffness_share):
    (contact,) = identification.report.contacts
    for estimate, true, share in (
        (contact.clearance_m, CLEARANCE_M, clearance_share),
        (contact.stiffness_n_per_m, STIFFNESS_N_PER_M, stiffness_share),
    ):
        within = COVERED * estimate.standard_error
        print(f"{100 * (estimate.value / true - 1):+.2f} % ({100 * within / true:.2f} %)", end="  ")
        assert abs(estimate.value - true) < 1.5 * within
        assert within < share * true
    return contact


def strain_per_newton(body, forces, places_m, hz):
    """Strain at gauges, on the surface, per newton at some places, by the sum over the modes."""
    rig = replace(cantilever(), bodies=(body,), contacts=(), force_at=forces)
    omega = np.array([2 * np.pi * hz])
    gauges = [Sensor(name="e", station=Station("beam", float(x)), quantity="strain") for x in places_m]
    response = response_of(rig, body, ResponseCache(omega))
    return accelerances(rig, [response], rig.forces, gauges)[..., 0] / -(omega**2)


def test_a_clamped_beam_bends_as_under_a_constant_force():
    """w'' = F (a - x) / E I between the clamp and the force at a, and none beyond."""
    places_m, forces = np.linspace(0, 0.6, 7), (Station("beam", 0.75), Station("beam", LENGTH_M))
    made = strain_per_newton(beam(), forces, places_m, 0.01)
    arms_m = np.maximum(np.array([[0.75], [LENGTH_M]]) - places_m, 0)
    expected = -beam().half_thickness_m * arms_m / beam().bending_stiffness_n_m2
    np.testing.assert_allclose(made.real, expected, atol=2e-3 * np.abs(expected).max())


def test_a_free_beam_bends_by_its_inertia():
    """Pushed at its end, E I w'' = F x (x / L)(1 - x / L) (of rigid acceleration 4 F / m there, -2 F / m at the other
    end), with no moment at either end."""
    places_m, body = np.linspace(0, LENGTH_M, 9), beam("free-free")
    (made,) = strain_per_newton(body, (Station("beam", LENGTH_M), Station("beam", 0.0)), places_m, 0.01)[:1]
    moments_n_m = places_m * (places_m / LENGTH_M) * (1 - places_m / LENGTH_M)
    expected = -body.half_thickness_m * moments_n_m / body.bending_stiffness_n_m2
    np.testing.assert_allclose(made.real, expected, atol=0.03 * np.abs(expected).max())


def test_slopes_of_gauges_are_those_of_their_rows():
    response = response_of(cantilever(), beam(), ResponseCache(np.ones(1)))
    gauge = Sensor(name="e", station=Station("beam", 0.3), quantity="strain")
    moved = [replace(gauge, station=Station("beam", 0.3 + step_m)) for step_m in (-1e-5, 1e-5)]
    below, above = response.shapes(moved)[:, :8]
    np.testing.assert_allclose(response.slopes([gauge])[0, :8], (above - below) / 2e-5, rtol=1e-3, atol=1e-6)


def test_the_low_pass_completes_the_integration():
    omega = 2 * np.pi * np.array([1e-6, 0.4, 0.75, 1.0, 5.0])
    np.testing.assert_allclose(low_pass(omega, 1.0), [1.0, 1.0, 0.5, 0.0, 0.0], atol=1e-12)


def test_accelerometers_alone_do_not_tell_a_slow_stop(slow):
    assert not identify_contact(slow, use="acceleration").report.contacts


def test_gauges_tell_a_slow_stop_and_its_sides(slow):
    identification = identify_contact(slow)
    contact = assert_found(identification, clearance_share=0.02, stiffness_share=0.06)
    assert contact.lower_clearance_m is not None
    assert contact.upper_clearance_m is not None
    assert {f"e{1000 * x:04.0f}" for x in GAUGES_M} <= {*identification.report.channels_used}
    assert identification.report.trusted_hz[0] == 0.0


def test_the_slow_motion_is_that_of_the_plant(tmp_path):
    """Displacement and force against the truth of finite elements, which knows no modes."""
    path = tmp_path / "r.mcap"
    force = slow_force(low_hz=0.1, high_hz=2.0)
    recording = recorded(cantilever(), path, force, plant="ancf", duration_s=12.0, step_s=2.0**-11)
    separation = separate(recording, "auto", EXACT)
    truth = read_truth(truth_path(path))
    eta_m, force_n = (truth.signals[group].values[0] for group in ("relative_displacement", "contact_force"))
    (contact_record,) = separation.records
    samples, factor = contact_record.eta_m.size, separation.forces.decimation
    assert separation.motion.slow_by_gauges
    assert np.std(contact_record.eta_m - eta_m[:samples]) < 0.01 * np.std(eta_m)
    slow_n = decimated(force_n, factor)[: contact_record.force_n.size]
    assert np.std(contact_record.force_n - slow_n) < 0.02 * np.std(slow_n)


def test_the_zero_of_a_bridge_changes_nothing(slow):
    signals = slow.signals["strain"]
    shifted = with_fields(signals, values=signals.values + np.array([[2e-5], [-1e-4], [0.0]]))
    moved = with_fields(slow, signals={**slow.signals, "strain": shifted})
    plain, other = (separate(recording, "auto", LABORATORY).records[0] for recording in (slow, moved))
    np.testing.assert_allclose(other.force_n, plain.force_n, atol=1e-6 * np.std(plain.force_n))
    np.testing.assert_allclose(other.eta_m, plain.eta_m, atol=1e-6 * np.std(plain.eta_m))


def test_a_gauge_has_the_tolerances_of_a_sensor(slow):
    parameters = {p.name for p in separate(slow, "auto", LABORATORY).forces.nuisances.parameters}
    for gauge in ("e0050", "e0300", "e0600"):
        assert {f"{kind} of {gauge}" for kind in ("gain", "position", "delay", "zero")} <= parameters


def described(recording, kind):
    """The recording with one thing described a standard deviation less than it is, and the parameter of that."""
    rig, force = recording.rig, recording.signals["force"]
    gauge = next(s for s in rig.sensors if s.name == "e0300")

    def with_gauge(**changes):
        sensors = tuple(replace(s, **changes) if s.name == gauge.name else s for s in rig.sensors)
        return with_fields(recording, rig=replace(rig, sensors=sensors))

    if kind == "frequency of beam":
        return with_fields(recording, rig=replace(rig, bodies=(beam().scale_frequencies(1 / 1.002),)))
    if kind == "mass of beam":
        return with_fields(recording, rig=replace(rig, bodies=(beam().scale_mass(1 / 1.003),)))
    if kind == "force gain of the force":
        louder = with_fields(force, values=1.003 * force.values)
        return with_fields(recording, signals={**recording.signals, "force": louder})
    if kind == "gain of e0300":
        return with_gauge(gain=1 / 1.002)
    return with_gauge(station=Station("beam", gauge.station.position_m - 1e-3))


@pytest.mark.parametrize(
    "kind", ["frequency of beam", "mass of beam", "force gain of the force", "gain of e0300", "position of e0300"]
)
def test_a_tolerance_changes_force_and_slow_motion_as_a_wrong_description_does(kind, slow):
    nominal, changed = (separate(recording, "auto", LABORATORY) for recording in (slow, described(slow, kind)))
    signals, (before,), (after,) = nominal.forces.nuisances, nominal.records, changed.records
    (index,) = (i for i, parameter in enumerate(signals.parameters) if parameter.name == kind)
    inside = slice(100, -100)  # the ends are smoothed
    moved_m = before.at_force_samples(after.eta_m - before.eta_m)
    for made, stated_whole in (
        (after.force_n - before.force_n, signals.force_n[index, 0]),
        (moved_m, signals.eta_m[index, 0]),
    ):
        stated = stated_whole[: made.size]
        assert np.std(made[inside] - stated[inside]) < 0.05 * np.std(stated[inside])


def test_a_gauge_of_wrong_polarity_is_not_taken_in_silence(slow):
    signals = slow.signals["strain"]
    turned = with_fields(signals, values=signals.values * np.array([[-1], [1], [1]]))
    report = identify_contact(with_fields(slow, signals={**slow.signals, "strain": turned})).report
    assert report.findings or not report.contacts


def test_a_record_in_motion_uses_no_gauges(slow):
    first = 512 * 5
    signals = {name: with_fields(s, values=s.values[:, first:]) for name, s in slow.signals.items()}
    late = with_fields(slow, signals=signals)
    gauges, motion = gauges_and_motion_of(late, "auto", kinematics(late))
    assert not gauges.sensors
    assert not {"e0050", "e0300", "e0600"} & {*motion.channels}


@pytest.mark.study
@pytest.mark.parametrize("lower_clearance_m", [CLEARANCE_M, INFINITE], ids=["two stops", "one stop"])
@pytest.mark.parametrize("seed", [2, 3, 4])
def test_slow_stops_are_found_whatever_is_off_by_its_tolerance(seed, lower_clearance_m, tmp_path):
    rig = cantilever(lower_clearance_m)
    path, actual = tmp_path / "r.mcap", off_by_tolerances(rig, seed)
    recording = recorded(rig, path, slow_force(seed), duration_s=40.0, actual=actual)
    assert_found(identify_contact(recording), clearance_share=0.02, stiffness_share=0.06)


@pytest.mark.study
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_six_gauges_and_four_accelerometers_on_two_beams(seed, tmp_path):
    """The plant has 16 modes a beam, the identification 40, and so a strain that converged further."""
    settings = BarrelCradle(
        sensors="acceleration", noise_density=1e-3, duration_s=16.0, seed=seed, sample_rate_hz=1024.0
    )
    plain, places = settings.rig(), (("cradle", (0.05, 0.35, 0.7)), ("barrel", (0.15, 0.5, 0.75)))
    gauges = tuple(
        Sensor(
            name=f"{body}_{x:g}", station=Station(body, x * settings.length_m), quantity="strain", noise_density=1e-9
        )
        for body, shares in places
        for x in shares
    )
    rig = replace(plain, sensors=(*plain.sensors, *gauges))
    recording = recorded(rig, tmp_path / "r.mcap", settings.force(), duration_s=16.0)
    at_contacts = {s for c in plain.contacts for s in (c.at, c.against)}
    few = tuple(s for s in plain.sensors if s.station in at_contacts)
    for label, chosen in (
        ("12 accelerometers", plain.sensors),
        ("4 accelerometers", few),
        ("4 accelerometers, 6 gauges", (*few, *gauges)),
    ):
        report = identify_contact(only(recording, chosen)).report
        for contact, true in zip(report.contacts, plain.contacts, strict=True):
            for estimate, value in (
                (contact.clearance_m, true.law.lower_clearance_m),
                (contact.stiffness_n_per_m, true.law.stiffness_n_per_m),
            ):
                error = 100 * (estimate.value / value - 1)
                within = 100 * COVERED * estimate.standard_error / value
                print(f"{label}, {contact.name}: {error:+.3f} % ({within:.3f} %)")
                assert abs(error) < 1.5 * within < 1.5
