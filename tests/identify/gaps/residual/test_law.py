"""Contact forces against the rig's laws."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.decision.channel_errors import with_lateral_motion
from identify.gaps.decision.null_simulations import draw_rig, standard_normals
from identify.gaps.residual.likelihood import misfit, nominal_variances_of
from identify.gaps.residual.residual import linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.nominal import fit_nuisance
from rig.effects import effect_named
from rig.model.tolerances import LABORATORY
from rig.simulation.excitation import force_history
from rig.simulation.reference import BarrelCradle, Sdof
from rig.simulation.replay import modal
from tests.identify.gaps.residual.simulated_records import simulated_record


@pytest.mark.study
def test_a_spring_under_a_floating_body_makes_no_drift_of_the_noise():
    settings = BarrelCradle(sensors="acceleration", duration_s=20.0, noise_density=1e-4)
    believed = settings.rig()
    held = effect_named("linear_spring:stiffness_n_per_m=400,relative_position=0.7,body=barrel").applied_to(believed)
    record = simulated_record(settings, believed, held)
    reference = nominal_variances_of(linearized(record, believed))
    floating, springing = (misfit(record, reference, fit_nuisance(record, rig)[1]) for rig in (believed, held))
    assert max(springing.contact_mean_squares) < 0.2
    assert min(floating.contact_mean_squares) > 4 * max(springing.contact_mean_squares)


def test_a_stop_that_is_not_there_leaves_the_other_one_to_be_judged():
    settings = Sdof(sensors="displacement+acceleration", duration_s=20.0, noise_density=1e-5)
    rig = settings.rig()
    (contact,) = rig.contacts
    believed = replace(rig, contacts=(replace(contact, law=replace(contact.law, lower_clearance_m=np.inf)),))
    wider = effect_named("contact_clearance:factor=1.3").applied_to(believed)
    misfits = []
    for actual in (believed, wider):
        record = simulated_record(settings, believed, actual)
        reference = nominal_variances_of(linearized(record, believed))
        misfits.append(max(misfit(record, reference, fit_nuisance(record, believed)[1]).contact_mean_squares))
    assert misfits[0] < 10
    assert misfits[1] > 100
    drawn = draw_rig(believed, replace(LABORATORY, clearance=3.0), standard_normals(believed, 8)[0])
    assert drawn.contacts[0].law.sides == (1,)


def test_motion_across_the_axes_is_no_force_of_a_stiff_stop():
    settings = BarrelCradle(duration_s=10.0, noise_density=1e-3, stiffness_1_n_per_m=5e5, stiffness_2_n_per_m=5e5)
    rig = settings.rig()
    force_n = force_history(settings.force(), settings.duration_s, 1 / rig.sample_rate_hz)
    record = record_of(with_lateral_motion(modal(rig, rig, force_n, 1), 3e-3, 0, np.random.default_rng(3)))
    reference = nominal_variances_of(linearized(record, rig))
    assert max(misfit(record, reference, fit_nuisance(record, rig)[1]).contact_mean_squares) < 1
