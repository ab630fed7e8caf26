"""The whole identification, on recordings of rigs whose contacts are known."""

import shutil
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

import identify
from identify.contacts import identify_contact
from identify.contacts.acceptance import estimated_contacts
from identify.contacts.refusals import RefusalCode, RemedyCode
from rig.errors import RigError
from rig.model.contact_laws import DeadZone
from rig.model.description import PointDamper, Station
from rig.model.tolerances import EXACT, LABORATORY
from rig.recording import Recording, read, truth_path
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle, Sdof

TRUE = BarrelCradle()
PAPER = {"contact_1": (4e-3, 1.15e-3), "contact_2": (4e-3, 2.65e-2)}
"""How far the paper's clearance and stiffness are off at the barrel and its cradle, as shares."""


@pytest.fixture(scope="module")
def without_truth(barrel_cradle, tmp_path_factory):
    """The recording alone."""
    path = Path(shutil.copy(barrel_cradle, tmp_path_factory.mktemp("alone")))
    assert not truth_path(path).exists()
    return read(path)


@pytest.fixture(scope="module")
def progress():
    return []


@pytest.fixture(scope="module")
def identification(without_truth, progress):
    return identify_contact(without_truth, use="displacement", equation="barrel 3", progress=progress.append)


def short_mass(folder, law=None, duration_s=60.0, **settings):
    """A minute of the one-mass rig, with another contact law if one is given."""
    settings = Sdof(duration_s=duration_s, step_s=2.0**-12, **settings)
    rig = settings.rig()
    if law is not None:
        rig = msgspec.structs.replace(rig, contacts=(msgspec.structs.replace(rig.contacts[0], law=law),))
    path = folder / "r.mcap"
    record(
        rig,
        settings.force(),
        plant=modal.simulate,
        duration_s=duration_s,
        step_s=settings.step_s,
        path=path,
        progress=lambda _: None,
    )
    return read(path)


def test_as_good_as_the_paper(identification):
    assert [c.name for c in identification.report.contacts] == ["contact_1", "contact_2"]
    assert identification.report.unanswered == ()
    for contact in identification.report.contacts:
        clearance, stiffness = PAPER[contact.name]
        assert contact.clearance_m.value == pytest.approx(TRUE.clearance_1_m, rel=clearance)
        assert contact.stiffness_n_per_m.value == pytest.approx(TRUE.stiffness_1_n_per_m, rel=stiffness)
        for side in (contact.lower_clearance_m, contact.upper_clearance_m):
            assert side.value == pytest.approx(TRUE.clearance_1_m, rel=clearance)
            assert 0 < side.standard_error < 0.1 * side.value
        assert abs(contact.damping_n_s_per_m.value) < 4 * contact.damping_n_s_per_m.standard_error + 0.5


def test_the_papers_methods_are_as_good_as_the_paper(identification):
    """Modal equation 3 of the barrel: its first bending."""
    nifo = next(n for n in identification.report.nifo if n.equation == "barrel 3")
    surface = next(s for s in identification.report.surface.surfaces if s.equation == "barrel 3")
    assert (
        identification.report.main_equation
        == identification.weak_nifo.equation.name
        == identification.surface.equation.name
        == "barrel 3"
    )
    assert nifo.averages == 40
    for stiffness in nifo.stiffness:
        assert stiffness.mean_n_per_m.value == pytest.approx(TRUE.stiffness_1_n_per_m, rel=PAPER[stiffness.contact][1])
    for estimate in surface.clearances:
        assert estimate.clearance_m.value == pytest.approx(TRUE.clearance_1_m, rel=PAPER[estimate.contact][0])
    for estimate in identification.report.surface.histogram:
        assert estimate.clearance_m.value == pytest.approx(TRUE.clearance_1_m, rel=0.1)  # its density is an assumption
    assert len(nifo.stiffness) == len(surface.clearances) == len(identification.report.surface.histogram) == 2


def test_every_body_and_equation_is_reported(identification):
    report, rig = identification.report, identification.rig
    assert [n.equation for n in report.nifo] == [f"barrel {i}" for i in range(1, 5)]  # the force is on the barrel
    assert [s.equation for s in report.surface.surfaces] == [
        f"{b} {i}" for b in ("cradle", "barrel") for i in (1, 2, 3, 4)
    ]
    assert [(t.body, t.stations, t.modes) for t in report.transformation] == [("cradle", 6, 6), ("barrel", 6, 6)]
    (mode,) = report.modes  # only the barrel's first bending lies in the band
    assert (mode.beam, mode.index) == ("barrel", 3)
    assert mode.frequency_hz == pytest.approx(rig.body("barrel").frequencies_hz(3)[2], rel=1e-3)
    assert mode.damping_ratio == pytest.approx(TRUE.damping_ratio, rel=0.02)
    sensors = {s.name for s in rig.sensors if s.quantity == "displacement"}
    assert report.channels_used[0] == "force"
    assert set(report.channels_used[1:]) == sensors


def test_contacts_near_a_node_are_named(identification):
    """Contact 2 is 5 cm from the middle of the barrel, where its rotation has its node."""
    hidden = {n.equation: n.nearly_invisible for n in identification.report.nifo}
    assert hidden == {"barrel 1": (), "barrel 2": ("contact_2",), "barrel 3": (), "barrel 4": ()}


def test_progress_only_grows(identification, progress):
    assert identification.report.contacts
    assert progress == sorted(progress)
    assert 0 < progress[0] <= progress[-1] <= 1


def test_what_the_linear_model_leaves_out_is_refused(without_truth):
    damped = msgspec.structs.replace(
        without_truth.rig, dampers=(PointDamper(station=Station("barrel", 0.5), damping_n_s_per_m=5.0),)
    )
    with pytest.raises(RigError, match="'barrel_cradle' has dampers, which the identification does not know"):
        identify_contact(replace(without_truth, rig=damped))


def test_accelerometers_alone_tell_the_play_but_not_its_sides(without_truth):
    result = identify_contact(without_truth, use="acceleration", tolerances=EXACT)
    assert [c.name for c in result.report.contacts] == ["contact_1", "contact_2"]
    for contact in result.report.contacts:
        assert contact.lower_clearance_m is None
        assert contact.upper_clearance_m is None
        assert contact.clearance_m.value == pytest.approx(TRUE.clearance_1_m, rel=2e-3)
        assert contact.stiffness_n_per_m.value == pytest.approx(TRUE.stiffness_1_n_per_m, rel=1e-2)
    numbers = np.concatenate(
        [result.eta_m.ravel(), result.weak_nifo.stiffness_n_per_m.ravel(), result.surface.fitted_modal_force]
    )
    assert np.isfinite(numbers).all()
    assert all(name == "force" or name.endswith("acceleration") for name in result.report.channels_used)


@pytest.mark.parametrize("use", ["displacement", "acceleration"])
def test_one_mass_with_unequal_stops_and_damping(tmp_path, use):
    """The spring to the ground holds the zero, so even accelerometers tell the sides apart."""
    law = DeadZone(lower_clearance_m=0.8e-3, upper_clearance_m=1.1e-3, stiffness_n_per_m=1.5e4, damping_n_s_per_m=4.0)
    recording = short_mass(tmp_path, law)
    (contact,) = identify_contact(recording, use=use, tolerances=EXACT).report.contacts
    for estimate, true, share in (
        (contact.lower_clearance_m, law.lower_clearance_m, 1e-3),
        (contact.upper_clearance_m, law.upper_clearance_m, 1e-3),
        (contact.clearance_m, law.clearance_m, 1e-3),
        (contact.stiffness_n_per_m, law.stiffness_n_per_m, 1e-3),
        (contact.damping_n_s_per_m, law.damping_n_s_per_m, 2e-2),
    ):
        assert estimate.value == pytest.approx(true, rel=share)


def test_gains_are_not_fitted_to_the_noise(tmp_path):
    """A common gain of force and sensor that is too small would make the noise, and so the residual, smaller."""
    recording = short_mass(tmp_path, duration_s=240.0, sensors="acceleration", noise_density=2e-3)
    fit = estimated_contacts(recording, "acceleration", LABORATORY).outcomes.estimates["stop"]
    assert np.abs(fit.pulls).max() < 1
    assert abs(fit.values[0] - recording.rig.contacts[0].law.lower_clearance_m) < 2 * fit.errors[0]


def test_a_contact_that_is_never_reached_is_not_answered(tmp_path):
    result = identify_contact(short_mass(tmp_path, rms_n=0.01, duration_s=30.0), use="displacement")
    assert result.report.contacts == ()
    (silent,) = result.report.unanswered
    assert silent.name == "stop"
    assert (silent.code, silent.remedy) == (RefusalCode.HARDLY_CLOSES, RemedyCode.EXCITE_MORE_OR_QUIETER)
    assert result.outcomes.refusals["stop"].sentence == silent.reason
    assert result.stops == (None,)
    assert result.report.surface.histogram == ()


@pytest.fixture(scope="module")
def mass(tmp_path_factory):
    return short_mass(tmp_path_factory.mktemp("mass"), duration_s=30.0)


def test_an_unknown_equation_is_refused(mass):
    with pytest.raises(RigError, match="no modal equation 'barrel 3' with a measured force; there are mass 1"):
        identify_contact(mass, use="displacement", equation="barrel 3")


def test_a_rig_without_contacts_is_refused(mass):
    bare = Recording(msgspec.structs.replace(mass.rig, contacts=()), mass.signals, {})
    with pytest.raises(RigError, match="rig 'sdof' has no contacts; describe them"):
        identify_contact(bare)


def test_a_record_without_force_is_refused(mass):
    still = replace(mass.signals["force"], values=np.zeros_like(mass.signals["force"].values))
    with pytest.raises(RigError, match="the exciting force is zero throughout"):
        identify_contact(Recording(mass.rig, {**mass.signals, "force": still}, {}))


def test_a_record_of_nothing_is_refused(mass):
    still = {name: replace(each, values=np.zeros_like(each.values)) for name, each in mass.signals.items()}
    with pytest.raises(RigError, match="the force and all sensors are zero throughout; look at their channels"):
        identify_contact(Recording(mass.rig, still, {}), use="displacement")


def test_a_contact_without_an_accelerometer_is_refused(without_truth):
    """Without it the drift of the relative displacement is not held."""
    rig = without_truth.rig
    contact_station = rig.contacts[0].at
    sensors = tuple(s for s in rig.sensors if s.station != contact_station)
    signals = dict(without_truth.signals)
    for quantity, group in signals.items():
        rows = [i for i, s in enumerate(group.channels.stations) if s != contact_station or quantity == "force"]
        channels = replace(
            group.channels,
            names=tuple(group.channels.names[i] for i in rows),
            stations=tuple(group.channels.stations[i] for i in rows),
        )
        signals[quantity] = replace(group, channels=channels, values=group.values[rows])
    fewer = Recording(msgspec.structs.replace(rig, sensors=sensors), signals, {})
    with pytest.raises(RigError, match=r"contact 'contact_1' has no sensor at 0\.0 m of 'barrel'"):
        identify_contact(fewer, use="acceleration")


def test_what_only_a_simulator_knows_is_not_even_named():
    (folder,) = identify.__path__
    for module in Path(folder).rglob("*.py"):
        assert "truth" not in module.read_text(encoding="utf-8").lower(), module.name
