"""Axes drawn by hand: round figures within the ends, places in proportion."""

import numpy as np
import pytest

from rig.viewer.axes import HEIGHT, MAX_TICK_COUNT, WIDTH, Axes, decades, tick_values
from rig.viewer.blueprint import labelled_axis_end


@pytest.mark.parametrize(
    ("low", "high"), [(-8.5, 8.5), (0.0, 1.0), (-2.8e-3, 2.8e-3), (3.1, 3.2), (-250.0, 1000.0), (0.0, 60.0)]
)
def test_figures_are_few_round_and_within(low, high):
    values = tick_values(low, high)
    step = np.diff(values)
    assert not np.signbit(values[values == 0]).any()  # printed as -0
    assert 3 <= values.size <= MAX_TICK_COUNT
    np.testing.assert_allclose(step, step[0])
    assert round(step[0] / 10 ** np.floor(np.log10(step[0]) + 1e-9), 6) in {1, 2, 5}
    np.testing.assert_allclose(values / step[0], np.round(values / step[0]), atol=1e-6)
    assert low <= values[0] + 1e-9
    assert values[-1] <= high + 1e-9


def test_decades_include_the_ends():
    np.testing.assert_allclose(decades(0.01, 100.0), [0.01, 0.1, 1, 10, 100])
    np.testing.assert_allclose(decades(0.02, 99.0), [0.1, 1, 10])


def test_places_go_up_and_are_kept_within_the_frame():
    axes = Axes((0.0, 10.0), (-1.0, 1.0), "x", "y")
    np.testing.assert_allclose(
        axes.points(np.array([0.0, 5.0, 20.0]), np.array([-1.0, 0.0, 3.0])),
        [[0, 0], [WIDTH / 2, -HEIGHT / 2], [WIDTH, -HEIGHT]],
    )
    axes = Axes((1.0, 100.0), (1e-3, 10.0), "x", "y", is_logarithmic=True)
    np.testing.assert_allclose(
        axes.points(np.array([10.0, 0.0]), np.array([0.1, 0.0])), [[WIDTH / 2, -HEIGHT / 2], [0, 0]]
    )


@pytest.mark.parametrize(("reach", "expected"), [(3.0, 3.0), (8.5, 10.5), (10.2, 10.2), (0.5, 1.05), (10.0, 10.5)])
def test_a_displacement_axis_ends_where_there_are_figures(reach, expected):
    assert labelled_axis_end(reach) == pytest.approx(expected)
