"""Settings and force of a recording of a rig of one's own."""

import pytest

from rig.errors import RigError
from rig.simulation.own import default_plant_name, user_rig
from rig.simulation.reference import Sdof


@pytest.mark.parametrize(
    ("settings", "is_beyond"),
    [({"rms_n": "1999"}, False), ({"rms_n": "2500"}, True), ({"rms_n": "2500", "excitation": "hammer"}, False)],
)
def test_a_force_beyond_a_large_shaker_is_warned_of(settings, is_beyond):
    warnings = user_rig(Sdof().rig(), settings).warnings
    assert bool(warnings) == is_beyond
    assert all("2500 N rms is more than a large laboratory shaker gives" in w for w in warnings)


def test_settings_follow_from_the_rig_unless_they_are_given():
    rig = Sdof(sample_rate_hz=1000.0).rig()
    default = user_rig(rig, {})
    assert default.step_s == 1 / 17_000
    assert default.force().high_hz == 25.0
    chosen = user_rig(rig, {"rms_n": "2", "step_s": "1e-4", "high_hz": "40", "seed": "3", "duration_s": "5"})
    assert (chosen.force().rms_n, chosen.force().high_hz, chosen.force().seed) == (2.0, 40.0, 3)
    assert (chosen.step_s, chosen.duration_s) == (1e-4, 5.0)
    assert default_plant_name(rig) == "ancf"
    for wrong in ({"mass_kg": "2"}, {"rms_n": "much"}):
        with pytest.raises(RigError, match=next(iter(wrong))):
            user_rig(rig, wrong)
