"""A clamped beam on a support: one that stands elsewhere is found with its place."""

import pytest
from msgspec.structs import replace

import identify
from rig.effects import effect_named
from rig.model.description import Rig, Sensor, Station, Support
from rig.simulation.excitation import force_history
from rig.simulation.reference import BarrelCradle
from rig.simulation.replay import modal

pytestmark = [pytest.mark.long, pytest.mark.study]

STATIONS = [Station("beam", x_m) for x_m in (0.25, 0.45, 0.8, 0.9, 1.0)]


def test_a_support_that_stands_elsewhere_is_named_with_its_shift():
    beam = replace(next(b for b in BarrelCradle().rig().beams if b.clamped), name="beam")
    rig = Rig(
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
    actual = effect_named("support_position:shift_m=-0.008").applied_to(rig)
    settings = BarrelCradle(rms_n=5.0, high_hz=200.0)
    forces = [force_history(replace(settings, seed=seed).force(), 20.0, 1 / 2048.0) for seed in (1, 2)]
    gap = identify.gap(*(modal(rig, actual, force_n, seed) for seed, force_n in enumerate(forces))).report
    assert gap.verdict == "explained"
    assert gap.causes[0].effects == ("support_position",)
    assert "a support of the beam that stands " in gap.causes[0].words[0]
    assert gap.causes[0].words[0].endswith("mm nearer to the left end")
    (shift,) = gap.causes[0].parameters.values()
    assert abs(shift.value + 0.008) < 3 * shift.standard_error < 1e-3
