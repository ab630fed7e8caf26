"""A clamped beam on a support: a support that stands elsewhere, and a tone behind a damper, are found."""

import pytest
from msgspec.structs import replace

import identify
from identify.gaps.decision.prepare import prepare_recording
from identify.gaps.search.candidates import candidates, effect_range_scale
from identify.gaps.search.hypothesis import Search
from identify.gaps.search.nominal import fit_nuisance
from identify.gaps.search.sparse import ranked_hypotheses
from rig.effects import effect_named
from rig.model.description import Rig, Sensor, Station, Support
from rig.model.tolerances import LABORATORY
from rig.simulation.excitation import force_history
from rig.simulation.reference import BarrelCradle
from rig.simulation.replay import modal

pytestmark = pytest.mark.long

STATIONS = [Station("beam", x_m) for x_m in (0.25, 0.45, 0.8, 0.9, 1.0)]


@pytest.fixture(scope="module")
def supported_rig():
    beam = replace(next(b for b in BarrelCradle().rig().beams if b.clamped), name="beam")
    return Rig(
        name="supported",
        bodies=(beam,),
        contacts=(),
        force_at=STATIONS[2],
        sensors=tuple(
            Sensor(name=f"a{i}", station=station, quantity="acceleration", noise_density=1e-3)
            for i, station in enumerate(STATIONS)
        ),
        sample_rate_hz=2048.0,
        supports=(Support(station=Station("beam", 0.6)),),
    )


def recordings_of(rig, actual, duration_s, seeds):
    settings = BarrelCradle(rms_n=5.0, high_hz=200.0)
    forces = [force_history(replace(settings, seed=seed).force(), duration_s, 1 / 2048.0) for seed in seeds]
    return [modal(rig, actual, force_n, seed) for seed, force_n in enumerate(forces)]


@pytest.mark.study
def test_a_tone_is_found_beside_a_damper_that_hides_it(supported_rig):
    """The damper leaves more of the motion than the tone at its line, so that the tone alone explains little."""
    actual = effect_named("ground_damper:damping_n_s_per_m=70,relative_position=0.75").applied_to(supported_rig)
    tone = effect_named("tone:cosine_n=0.4,sine_n=-0.3,frequency_hz=127.7,relative_position=0.95")
    (recording,) = recordings_of(supported_rig, tone.applied_to(actual), 20.0, [1])
    observation = prepare_recording(recording, LABORATORY)
    linearization, residual = fit_nuisance(observation.record, supported_rig)
    names = [sensor.name for sensor in supported_rig.sensors]
    library = candidates(effect_range_scale(observation.record, supported_rig), names, False)
    likeliest = ranked_hypotheses(Search(observation.nominal_variances, linearization, residual, tuple(library)))[0]
    assert likeliest.effects == ("ground_damper", "tone")
    damper_values, tone_values = likeliest.values_by_candidate()
    assert damper_values == pytest.approx([70.0, 0.75], rel=0.01)  # the motion there is near the noise
    assert tone_values[:3] == pytest.approx([0.4, -0.3, 127.7], abs=0.01)


@pytest.mark.study
def test_a_support_that_stands_elsewhere_is_named_with_its_shift(supported_rig):
    actual = effect_named("support_position:shift_m=-0.008").applied_to(supported_rig)
    gap = identify.gap(*recordings_of(supported_rig, actual, 20.0, (1, 2))).report
    assert gap.verdict == "explained"
    assert gap.causes[0].effects == ("support_position",)
    assert "a support of the beam that stands " in gap.causes[0].words[0]
    assert gap.causes[0].words[0].endswith("mm nearer to the left end")
    (shift,) = gap.causes[0].parameters.values()
    assert abs(shift.value + 0.008) < 3 * shift.standard_error < 1e-3
