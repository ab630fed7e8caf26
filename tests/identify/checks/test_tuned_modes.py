"""Linearisation of a check about modes that are off within their tolerances."""

import numpy as np
from msgspec.structs import replace

from identify.checks.prediction import linear_check, with_tuned_modes
from identify.checks.spectra import spectra_of
from identify.linear.nuisance import Nuisance, NuisanceKind
from rig.model.tolerances import LABORATORY
from tests.identify.checks.conftest import CASES


def test_modes_with_their_pulls_are_those_of_the_rig_that_is_off_by_them(sound):
    recording = sound("frame")
    rig = replace(CASES["frame"].rig, contacts=())
    (body,) = rig.bodies
    check = linear_check(rig, spectra_of(recording, rig.sensors))
    pulls = {Nuisance(NuisanceKind.FREQUENCY, body.name): 2.0, Nuisance(NuisanceKind.DAMPING, body.name): -1.0}
    tuned = with_tuned_modes(rig, check, pulls, LABORATORY)
    off_body = body.scale_frequencies(1 + 2 * LABORATORY.frequency).scale_damping(1 - LABORATORY.damping)
    off = linear_check(replace(rig, bodies=(off_body,)), check.spectra)
    np.testing.assert_allclose(tuned.accelerance, off.accelerance, rtol=1e-9)
    assert np.max(np.abs(check.accelerance / off.accelerance - 1)) > 0.1


def test_a_single_mode_is_tuned_by_its_own_pull(sound):
    recording = sound("frame")
    rig = replace(CASES["frame"].rig, contacts=())
    (body,) = rig.bodies
    check = linear_check(rig, spectra_of(recording, rig.sensors))
    tuned = with_tuned_modes(rig, check, {Nuisance(NuisanceKind.FREQUENCY, body.name, 2): 3.0}, LABORATORY)
    hz, tuned_hz = (c.responses[0].dynamics.natural_hz for c in (check, tuned))
    expected = np.ones(hz.size)
    expected[1] += 3 * LABORATORY.frequency
    np.testing.assert_allclose(tuned_hz, hz * expected, rtol=1e-12)
