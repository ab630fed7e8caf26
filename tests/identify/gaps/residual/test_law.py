"""Contact forces against the rig's laws."""

from identify.gaps.residual.likelihood import misfit, nominal_variances_of
from identify.gaps.residual.residual import linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.nominal import fit_nuisance
from rig.effects import effect_named
from rig.simulation.excitation import force_history
from rig.simulation.reference import BarrelCradle
from rig.simulation.replay import modal


def test_a_spring_under_a_floating_body_makes_no_drift_of_the_noise():
    settings = BarrelCradle(sensors="acceleration", duration_s=20.0, noise_density=1e-4)
    believed = settings.rig()
    held = effect_named("linear_spring:stiffness_n_per_m=400,relative_position=0.7,body=barrel").applied_to(believed)
    force_n = force_history(settings.force(), settings.duration_s, 1 / believed.sample_rate_hz)
    record = record_of(modal(believed, held, force_n, 1))
    reference = nominal_variances_of(linearized(record, believed))
    floating, springing = (misfit(record, reference, fit_nuisance(record, rig)[1]) for rig in (believed, held))
    assert max(springing.contacts) < 10
    assert max(floating.contacts) > 100
