"""The one mass as a body with one mode."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.errors import RigError
from rig.model.oscillator import Oscillator


@given(st.floats(1e-2, 1e3), st.floats(0.1, 1e3), st.floats(0, 0.9))
def test_stiffness_and_damping_give_back_frequency_and_ratio(mass_kg, frequency_hz, damping_ratio):
    body = Oscillator(name="m", mass_kg=mass_kg, frequency_hz=frequency_hz, damping_ratio=damping_ratio)
    omega = np.sqrt(body.stiffness_n_per_m / mass_kg)
    assert omega == pytest.approx(2 * np.pi * frequency_hz)
    assert body.damping_n_s_per_m == pytest.approx(2 * damping_ratio * np.sqrt(body.stiffness_n_per_m * mass_kg))
    shape = body.shapes(np.zeros(3), 1)
    np.testing.assert_allclose(mass_kg * shape**2, 1)  # mass-normalised
    assert body.frequencies_hz(1) == [frequency_hz]
    assert body.damping_ratios(1) == [damping_ratio]


@pytest.mark.parametrize(("field", "value"), [("mass_kg", 0.0), ("frequency_hz", np.nan), ("damping_ratio", -0.1)])
def test_a_bad_value_is_named(field, value):
    good = {"name": "m", "mass_kg": 1.0, "frequency_hz": 5.0, "damping_ratio": 0.01}
    with pytest.raises(RigError, match=rf"'m': {field} is {value}; give"):
        Oscillator(**good | {field: value})


def test_it_has_one_mode():
    body = Oscillator(name="m", mass_kg=1.0, frequency_hz=5.0, damping_ratio=0.0)
    with pytest.raises(RigError, match="2 modes asked for; it has exactly one"):
        body.frequencies_hz(2)
