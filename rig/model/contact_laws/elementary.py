"""Functions of a contact law's formula beside + - * /: each works on numbers and arrays.

Who evaluates formulas otherwise registers its own kind: the compiled loop of the modal plant for numba, the ancf plant
for Exudyn's symbolic numbers (`functools.singledispatch` goes by the first argument).
"""

from functools import singledispatch
from typing import Any

import numpy as np


@singledispatch
def given(factor: Any) -> Any:
    """True if a term with this factor is worth evaluating; always in the compiled loop, as a branch costs more."""
    return factor != 0.0


@singledispatch
def beyond(eta: Any, low: Any, high: Any) -> Any:
    """eta - high above high, eta - low below low, zero between."""
    return eta - np.clip(eta, low, high)


@singledispatch
def select(condition: Any, chosen: Any, otherwise: Any) -> Any:
    """One value where the condition holds, the other elsewhere."""
    return np.where(condition, chosen, otherwise)


@singledispatch
def smaller(one: Any, other: Any) -> Any:
    return np.minimum(one, other)


@singledispatch
def magnitude(x: Any) -> Any:
    return np.abs(x)


@singledispatch
def power(x: Any, exponent: Any) -> Any:
    return np.power(x, exponent)


@singledispatch
def tanh(x: Any) -> Any:
    return np.tanh(x)
