"""The decimating filter as matrices against the convolution that it stands for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import upfirdn

from rig.simulation.decimation import decimated, decimator


def by_convolution(taps, signals, factor, samples):
    """Convolved at the full rate where all taps meet a sample, then every factor-th."""
    return np.array([upfirdn(taps, row)[taps.size - 1 :: factor][:samples] for row in signals])


@given(
    st.integers(1, 9),
    st.integers(1, 300),
    st.integers(0, 40),
    st.integers(0, 40),
    st.integers(1, 100),
    st.integers(0, 1000),
)
def test_it_is_a_convolution_decimated(factor, used, before, behind, samples, seed):
    rng = np.random.default_rng(seed)
    taps = np.concatenate([np.zeros(before), rng.standard_normal(used), np.zeros(behind)])
    needed = (samples - 1) * factor + taps.size
    signals = rng.standard_normal((3, needed))
    chain = decimator(taps, factor)
    room = np.pad(signals, ((0, 0), (0, max(0, chain.reach(samples) - needed))))
    found = decimated(chain, room, samples)
    expected = by_convolution(taps, signals, factor, samples)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(taps).sum())


@pytest.mark.parametrize("late", [0, 5, 4000])
def test_taps_of_zero_cost_nothing(late):
    """A filter that is centred late is as small as one that is not."""
    taps = np.zeros(8001)
    taps[late : late + 129] = 1.0
    assert decimator(taps, 4).pieces.size == decimator(np.ones(129), 4).pieces.size


def test_no_taps_give_nothing():
    chain = decimator(np.zeros(33), 4)
    assert not decimated(chain, np.ones((2, chain.reach(20))), 20).any()
