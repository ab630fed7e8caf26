"""Rigs in space: unfolded and back, effects on both directions, diagnoses of machines that another simulator made."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

import identify
from identify.gaps.decision.prepare import prepare_recording
from identify.gaps.decision.rings import (
    RingFit,
    candidates_in_linear_residual,
    ring_contact_candidates,
    ring_parameter_distances,
)
from identify.gaps.residual.likelihood import misfit
from identify.gaps.residual.nuisance import nuisance_columns_of
from identify.gaps.residual.residual import linearized, residual_of
from identify.gaps.residual.unfolding import IN_Z, Unfolding, check_unfolds, free_contact_tolerances
from identify.gaps.search.candidates import candidates, effect_range_scale
from identify.gaps.search.nominal import fit_nuisance
from identify.linear.nuisance import NuisanceKind
from identify.pages.wording import COVERED
from rig import BarrelCradleAnnular
from rig.errors import RigError
from rig.model.beam import Beam
from rig.model.contact_laws import DeadZone
from rig.model.description import Contact, PointDamper, PointMass, PointSpring, Station
from rig.model.tolerances import LABORATORY, ModeTolerance
from rig.recording import Recording, Signals, channel_groups
from tests.campaigns.annular import RATE_HZ, as_built, believed_rig
from tests.campaigns.space_simulator import simulated
from tests.identify.contacts.test_annular import machine

SECONDS = 12.0
MASS_KG, MASS_M, CLEARANCE_FACTOR = 0.4, 0.8, 1.1
RIG = BarrelCradleAnnular(sensors="acceleration", noise_density=1e-3).rig()


def believed(nominal):
    """The machine as rig.json describes it, with right laws."""
    rig = believed_rig(nominal)
    contacts = []
    for contact, ring in zip(rig.contacts, nominal.rings, strict=True):
        numbers = {name: getattr(ring, name) for name in ("clearance_m", "stiffness_n_per_m", "damping_n_s_per_m")}
        contacts.append(replace(contact, law=replace(contact.law, **numbers)))
    return replace(rig, contacts=tuple(contacts))


@cache
def recorded(mass_kg, clearance_factor, seed, crossing=0.0):
    """Recording of the reference rig as a laboratory builds it, with a mass on the barrel and a wider first ring."""
    nominal = machine(True)
    first, second = nominal.rings
    rings = (dataclasses.replace(first, clearance_m=clearance_factor * first.clearance_m), second)
    barrel = dataclasses.replace(nominal.barrel, masses=((MASS_M, mass_kg),) if mass_kg else ())
    changed = dataclasses.replace(nominal, barrel=barrel, rings=rings)
    built = as_built(changed, np.random.default_rng(7), crossing)
    truth = simulated(built, 60.0, round(SECONDS * RATE_HZ), RATE_HZ, seed)
    rig = believed(nominal)
    rows = {"force": truth.forces_n, "acceleration": truth.accelerations.reshape(len(rig.sensors), -1)}
    signals = {name: Signals(channels, 0.0, rows[name]) for name, channels in channel_groups(rig).items()}
    return Recording(rig, signals, {})


def unfolded_candidates(record):
    library = candidates(
        effect_range_scale(record, record.rig), record.channel_names, record.zero_known, record.has_force
    )
    return candidates_in_linear_residual(library, record.rig), ring_contact_candidates(library, record.rig)


def test_a_rig_folds_back_to_itself():
    rig = replace(
        RIG,
        masses=(PointMass(station=Station("barrel", 0.3), mass_kg=0.1),),
        springs=(PointSpring(station=Station("barrel", 0.2, "z"), stiffness_n_per_m=1e3),),
        dampers=(PointDamper(station=Station("cradle", 0.7), damping_n_s_per_m=2.0),),
    )
    unfolding = Unfolding(rig)
    assert not unfolding.unfolded_rig.in_space
    assert unfolding.space_rig_of(unfolding.unfolded_rig) == rig


def test_twins_have_the_tolerances_of_their_bodies():
    tolerances = replace(LABORATORY, modes={"barrel tube 3": ModeTolerance(frequency=0.01)})
    assert free_contact_tolerances(tolerances).of_mode(f"barrel tube{IN_Z}", 3).frequency == 0.01


@pytest.mark.parametrize(
    ("changes", "refusal"),
    [
        (
            {"contacts": (*RIG.contacts, Contact(name="stop", at=Station("barrel", 0.5), law=DeadZone(
                lower_clearance_m=1e-3, upper_clearance_m=1e-3, stiffness_n_per_m=1e5)))},
            "contact 'stop' acts in one direction",
        ),
        (
            {"bodies": (RIG.bodies[0], Beam(name="barrel", ends="free-free", length_m=1.0, width_m=0.05,
                                           thickness_m=0.02, damping_ratio=0.01))},
            "body 'barrel' bends in z otherwise than in y",
        ),
        (
            {"springs": (PointSpring(station=Station("barrel", 0.2, "z"), stiffness_n_per_m=1e3),)},
            "a spring holds body 'barrel' in y otherwise than in z",
        ),
    ],
)  # fmt: skip
def test_what_does_not_unfold_is_refused_by_name(changes, refusal):
    with pytest.raises(RigError, match=refusal):
        check_unfolds(replace(RIG, **changes))


def test_next_experiments_and_records_without_force_are_refused():
    recording = recorded(0.0, 1.0, 1)
    with pytest.raises(RigError, match="leave --next-experiment out"):
        identify.gap(recording, next_experiment=True)
    force = recording.signals["force"]
    signals = {**recording.signals, "force": dataclasses.replace(force, values=0 * force.values)}
    with pytest.raises(RigError, match="needs the measured force"):
        identify.gap(dataclasses.replace(recording, signals=signals))


@pytest.fixture(scope="module")
def observation():
    """Record of a machine with an added mass and a wider ring, unfolded."""
    recording = recorded(MASS_KG, CLEARANCE_FACTOR, 1, crossing=0.02)
    unfolding = Unfolding(recording.rig)
    return unfolding, prepare_recording(unfolding.unfolded_recording(recording), free_contact_tolerances(LABORATORY))


def test_effects_act_on_what_both_directions_share_or_in_one(observation):
    _, prepared = observation
    linear, rings = unfolded_candidates(prepared.record)
    by_name = {candidate.name: candidate for candidate in linear}
    rig = prepared.record.rig
    heavier = by_name["added_mass:barrel"].applied(rig, np.array([0.2, 0.5]))
    assert [mass.station for mass in heavier.masses] == [Station("barrel", 0.5), Station(f"barrel{IN_Z}", 0.5)]
    assert f"added_mass:barrel{IN_Z}" not in by_name
    held = by_name[f"linear_spring:barrel{IN_Z}"].applied(rig, np.array([1e3, 0.5]))
    assert [spring.station for spring in held.springs] == [Station(f"barrel{IN_Z}", 0.5)]
    assert not {name for name in by_name if name.startswith(("contact_clearance", "coulomb", "preload", "base_motion"))}
    assert {c.name for c in rings} == {
        f"contact_{what}:contact_{k}" for what in ("clearance", "stiffness", "damping") for k in (1, 2)
    }
    wider = next(c for c in rings if c.name == "contact_clearance:contact_2").applied(rig, np.array([1.5]))
    assert [c.law.lower_clearance_m for c in wider.contacts] == pytest.approx([2e-3, 3e-3, 2e-3, 3e-3])


def test_the_mass_shows_in_the_motion_and_the_clearance_in_the_fit_of_the_rings_alone(observation):
    unfolding, prepared = observation
    record, rig = prepared.record, prepared.record.rig
    mass = next(c for c in unfolded_candidates(record)[0] if c.name == "added_mass:barrel")
    heavier = mass.applied(rig, np.array([MASS_KG, MASS_M]))
    wider = replace(rig, contacts=tuple(replace(c, law=replace(c.law, lower_clearance_m=3e-3)) for c in rig.contacts))

    linearization = linearized(record, rig)

    def cost(changed):
        return misfit(record, prepared.nominal_variances, residual_of(linearization, changed)).minus_two_log

    assert cost(heavier) < cost(rig) - 100
    assert cost(wider) == pytest.approx(cost(rig), abs=0.5)
    distances = ring_parameter_distances([prepared], heavier, RingFit(unfolding, LABORATORY))
    off = {bound.name: (bound.value, bound.upper) for bound in distances.parameter_bounds}
    value, upper = off["clearance of contact_1"]
    assert abs(value - 0.2e-3) < upper - value < 0.02e-3
    assert all(bound.holds for bound in distances.parameter_bounds if bound.name != "clearance of contact_1")


def test_sensors_show_motion_across_which_is_fitted(observation):
    _, prepared = observation
    columns = nuisance_columns_of(prepared.record, linearized(prepared.record, prepared.record.rig).model)
    across = [p.owner for p in columns.parameters if p.kind is NuisanceKind.CROSS_AXIS]
    assert sorted(across) == sorted(sensor.name for sensor in prepared.record.sensors)
    residual = fit_nuisance(prepared.record, prepared.record.rig)[1]
    pulls = dict(zip(columns.parameters, residual.nuisance_pulls, strict=True))
    largest = max(abs(pull) for p, pull in pulls.items() if p.kind is NuisanceKind.CROSS_AXIS)
    assert 0.5 < largest < 3.0  # shares of up to 2 %, in tolerances of 1 %


@pytest.mark.study
@pytest.mark.parametrize(
    ("mass_kg", "clearance_factor"), [(0.0, 1.0), (MASS_KG, CLEARANCE_FACTOR)], ids=["nothing", "mass and clearance"]
)
def test_a_machine_is_diagnosed(mass_kg, clearance_factor, tmp_path):
    records = [recorded(mass_kg, clearance_factor, seed, 0.02) for seed in (1, 2)]
    gap = identify.gap(records, null_reference=tmp_path / "null.json")
    report = gap.report
    assert "friction of rings was not compared" in report.sentence
    if not mass_kg:
        assert not report.evidence.differs
        assert not report.evidence.named
        return
    assert report.verdict == "explained"
    assert set(report.attribution.positions_m) == {"cradle", "barrel"}
    assert set(report.evidence.named) == {"added_mass:barrel", "contact_clearance:contact_1"}
    values = report.causes[0].parameters
    truth = {"added_mass.mass_kg": mass_kg, "added_mass.relative_position": MASS_M}
    truth["contact_clearance.factor"] = clearance_factor
    for name, true in truth.items():
        assert abs(values[name].value - true) < 1.5 * COVERED * values[name].standard_error
    (mass,) = gap.corrected.masses
    assert mass.station.body == "barrel"
    assert gap.corrected.contacts[0].law.clearance_m == pytest.approx(2e-3 * values["contact_clearance.factor"].value)
    assert "off by more than matters: the clearance of contact_1" in report.sentence.lower()
    gap.save(tmp_path / "gap")
    assert "barrel at 0.8" in (tmp_path / "gap" / "gap.html").read_text(encoding="utf-8")
