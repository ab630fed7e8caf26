"""Two effects on a clamped beam, each larger than the width of a resonance: neither is a start for the other."""

import pytest
from msgspec.structs import replace

from identify.gaps.decision.prepare import prepare_recording
from identify.gaps.search.candidates import candidates, effect_range_scale
from identify.gaps.search.far_sets import large_effect_fits
from identify.gaps.search.hypothesis import Search
from identify.gaps.search.nominal import fit_nuisance
from rig.effects import effect_named
from rig.model.description import Rig, Sensor, Station
from rig.model.tolerances import LABORATORY
from rig.simulation.excitation import force_history
from rig.simulation.reference import BarrelCradle
from rig.simulation.replay import modal

pytestmark = pytest.mark.long

KINDS = ("added_mass", "clamp_compliance", "force_gain", "linear_spring", "youngs_modulus")


def search_of(rig, actual, duration_s=20.0):
    settings = BarrelCradle(rms_n=2.0, high_hz=60.0, seed=3)
    recording = modal(rig, actual, force_history(settings.force(), duration_s, 1 / rig.sample_rate_hz), 1)
    observation = prepare_recording(recording, LABORATORY)
    linearization, residual = fit_nuisance(observation.record, rig)
    library = candidates(effect_range_scale(observation.record, rig), (), False)
    offered = tuple(c for c in library if c.kind.name in KINDS)
    return Search(observation.nominal_variances, linearization, residual, offered)


def test_two_large_effects_are_found_together():
    beam = replace(next(b for b in BarrelCradle().rig().beams if b.clamped), name="beam")
    sensors = tuple(
        Sensor(name=f"a{x}", station=Station("beam", x), quantity="acceleration", noise_density=1e-3)
        for x in (0.4, 0.7, 1.0)
    )
    rig = Rig(
        name="clamped",
        bodies=(beam,),
        contacts=(),
        force_at=Station("beam", 0.7),
        sensors=sensors,
        sample_rate_hz=1024.0,
    )
    actual = effect_named("clamp_compliance:compliance=0.04").applied_to(rig)
    actual = effect_named("added_mass:mass_kg=0.3,relative_position=0.8").applied_to(actual)
    search = search_of(rig, actual)
    likeliest = large_effect_fits(search)[0].hypothesis
    values_by_effect = dict(zip(likeliest.effects, likeliest.values_by_candidate(), strict=True))
    assert set(values_by_effect) == {"clamp_compliance", "added_mass"}
    assert values_by_effect["clamp_compliance"] == pytest.approx([0.04], rel=0.03)
    assert values_by_effect["added_mass"] == pytest.approx([0.3, 0.8], rel=0.03)
    assert likeliest.misfit.unexplained_share < 0.01 * search.nominal_fit().hypothesis.misfit.unexplained_share


def test_rigs_with_contacts_are_not_searched_from_afar():
    rig = BarrelCradle(sensors="acceleration").rig()
    assert large_effect_fits(search_of(rig, rig, 12.0)) == []
