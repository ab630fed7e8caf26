"""Functions that a contact law's formula may use besides + - * /, for numbers and arrays.

Other evaluators register their own versions (`functools.singledispatch` on the first argument): the compiled loop of
the modal plant for numba, the ancf plant for Exudyn's symbolic numbers.
"""

from functools import singledispatch
from typing import Any

import numpy as np


@singledispatch
def contributes(factor: Any) -> Any:
    """True if a term with this factor has to be evaluated; always in the compiled loop, where a branch costs more."""
    return factor != 0.0


@singledispatch
def beyond(eta: Any, low: Any, high: Any) -> Any:
    """eta - high above high, eta - low below low, zero between."""
    return eta - np.clip(eta, low, high)


@singledispatch
def select(condition: Any, chosen: Any, otherwise: Any) -> Any:
    """`chosen` where the condition holds, `otherwise` elsewhere."""
    return np.where(condition, chosen, otherwise)


@singledispatch
def smaller(x: Any, y: Any) -> Any:
    return np.minimum(x, y)


@singledispatch
def magnitude(x: Any) -> Any:
    return np.abs(x)


@singledispatch
def power(x: Any, exponent: Any) -> Any:
    return np.power(x, exponent)


@singledispatch
def root(x: Any) -> Any:
    return np.sqrt(x)


@singledispatch
def tanh(x: Any) -> Any:
    return np.tanh(x)
