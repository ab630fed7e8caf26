"""Types and shapes are checked in every test, at the first calls of each function."""

import jaxtyping
import numpy as np
import pytest

import tests.type_checking
from identify.signals.beginning import lead_in

SIGNAL = np.ones(16)
MATRIX = np.ones((16, 2))
INTEGERS = np.ones(16, int)


def test_an_array_of_another_shape_is_refused():
    with pytest.raises(jaxtyping.TypeCheckError, match="signal"):
        lead_in(MATRIX, 4)


def test_further_calls_are_unchecked_until_the_next_test_begins():
    for _ in range(tests.type_checking.CALLS_PER_TEST):
        lead_in(SIGNAL, 4)
    lead_in(INTEGERS, 4)
    tests.type_checking.begin_test()
    with pytest.raises(jaxtyping.TypeCheckError, match="signal"):
        lead_in(INTEGERS, 4)
