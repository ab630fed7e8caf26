"""Effects on contact laws, by the fit that `identify contact` makes: the same numbers, beside other effects too."""

from dataclasses import replace

import numpy as np
import pytest

import identify
from identify.gaps.decision.contact_evidence import contact_minus_two_log
from identify.gaps.decision.prepare import prepare_recording
from identify.gaps.residual.likelihood import misfit
from identify.gaps.residual.residual import linearized, residual_of
from identify.gaps.search.candidates import candidates, effect_range_scale
from identify.gaps.search.contact_laws import LawEstimate, with_contact_fit
from identify.gaps.search.hypothesis import Hypothesis
from rig.effects import effect_named
from rig.effects.added_mass import AddedMass
from rig.effects.contact_clearance import ContactClearance
from rig.effects.contact_damping import ContactDamping
from rig.model.tolerances import LABORATORY
from rig.simulation.reference import BarrelCradle

SETTINGS = BarrelCradle(sensors="acceleration", noise_density=1e-3, duration_s=16.0, seed=77)
CLEARANCE = ContactClearance(factor=1.058, contact="contact_1")
DAMPING = ContactDamping(damping_n_s_per_m=10.0, contact="contact_1")
MASS = AddedMass(mass_kg=0.15, relative_position=0.7)


def hypothesis_of(recording, *effects):
    """Effects of the library at typical values, as a search may hand them over."""
    observation = prepare_recording(recording, LABORATORY)
    known = candidates(
        effect_range_scale(observation.record, recording.rig), [s.name for s in recording.rig.sensors], False
    )
    parts = []
    for effect in effects:
        place = getattr(effect, "contact", None) or getattr(effect, "body", None) or "barrel"
        parts.append(next(c for c in known if c.kind is type(effect) and place in c.place.values()))
    values = np.concatenate([part.typical_values for part in parts])
    linearization = linearized(observation.record, recording.rig)
    left = misfit(observation.record, observation.nominal_variances, residual_of(linearization, recording.rig))
    return Hypothesis(tuple(parts), values, np.eye(values.size), left)


@pytest.mark.study
def test_values_and_errors_are_those_of_identify_contact(recorded_machine):
    recording = recorded_machine(SETTINGS, CLEARANCE, DAMPING)
    hypothesis = with_contact_fit(hypothesis_of(recording, CLEARANCE, DAMPING), [recording], LABORATORY)
    (contact,) = (c for c in identify.contact(recording).report.contacts if c.name == "contact_1")
    believed_m = recording.rig.contacts[0].law.clearance_m
    (factor, damping), errors = hypothesis.values, np.sqrt(np.diag(hypothesis.covariance))
    assert factor * believed_m == pytest.approx(contact.clearance_m.value, rel=1e-6)
    assert damping == pytest.approx(contact.damping_n_s_per_m.value, rel=1e-6)
    assert errors[0] * believed_m == pytest.approx(contact.clearance_m.standard_error, rel=0.1)
    assert errors[1] == pytest.approx(contact.damping_n_s_per_m.standard_error, rel=0.1)
    assert abs(factor - 1.058) < 3 * errors[0] < 0.01
    assert abs(damping - 10.0) < 3 * errors[1] < 1.0


def test_other_effects_are_in_the_linear_model(recorded_machine):
    """Without the mass the clearance is 1 % off, with it a hundredth of that, and the mass keeps what was searched."""
    recording = recorded_machine(SETTINGS, CLEARANCE, MASS)
    searched = hypothesis_of(recording, CLEARANCE, MASS)
    searched = replace(searched, values=np.array([1.1, MASS.mass_kg, MASS.relative_position]))
    hypothesis = with_contact_fit(searched, [recording], LABORATORY)
    error = float(np.sqrt(hypothesis.covariance[0, 0]))
    assert abs(hypothesis.values[0] - 1.058) < 3 * error < 0.01
    assert tuple(hypothesis.values[1:]) == (MASS.mass_kg, MASS.relative_position)
    assert not hypothesis.covariance[0, 1:].any()


def test_what_moves_no_law_stays_as_it_is(recorded_machine):
    recording = recorded_machine(SETTINGS, MASS)
    searched = hypothesis_of(recording, MASS)
    assert with_contact_fit(searched, [recording], LABORATORY) is searched


def test_the_contact_fit_speaks_for_its_numbers_and_not_of_laws_of_another_kind():
    """d' (C + S)^-1 d - n, by hand for one contact whose damping alone is off."""
    nominal = BarrelCradle(sensors="acceleration").rig()
    contact = nominal.contacts[0]
    law = contact.law
    off = 5.0
    rows = np.array([[0.5, 0.5, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]])
    numbers = np.array([law.lower_clearance_m, law.upper_clearance_m, law.stiffness_n_per_m, law.damping_n_s_per_m])
    values = rows @ numbers + [0, 0, off]
    covariance = np.diag([1e-12, 1e2, 0.04])
    estimate = LawEstimate(contact.name, rows, values, covariance, 0 * covariance)
    stated = (LABORATORY.contact_damping_s * law.stiffness_n_per_m) ** 2
    assert contact_minus_two_log(estimate, nominal, nominal, LABORATORY) == pytest.approx(off**2 / (0.04 + stated) - 3)
    damped = effect_named(f"contact_damping:damping_n_s_per_m={off},contact={contact.name}").applied_to(nominal)
    assert contact_minus_two_log(estimate, nominal, damped, LABORATORY) == pytest.approx(-3)
    hertz = effect_named(f"hertz_stop:exponent=1.3,contact={contact.name}").applied_to(nominal)
    assert contact_minus_two_log(estimate, nominal, hertz, LABORATORY) == 0.0
