"""Types and shapes checked at run time while the suite runs, by beartype and jaxtyping: the first calls of every
function in every test, as what holds for a hundred holds for the hundred thousand of a solver's loop."""

import functools
import sys
from collections import Counter
from collections.abc import Callable
from typing import Any, TypeVar, cast

from beartype import beartype

Checked = TypeVar("Checked", bound=Callable[..., object])

CALLS_PER_TEST = 10

_calls: Counter[Callable[..., object]] = Counter()
_released: list[Any] = []


def checked(function: Checked) -> Checked:
    """Function whose first calls in a test beartype checks; one defined within another as it is, since each call would
    compile it."""
    if "<locals>" in function.__qualname__:
        return function
    with_types = functools.cache(lambda: beartype(function))  # made at the first call: it takes a millisecond

    @functools.wraps(function)
    def counted(*arguments: object, **keywords: object) -> object:
        _calls[function] += 1
        if _calls[function] >= CALLS_PER_TEST:
            _release(sys._getframe(1).f_locals.get("fn"))
        return with_types()(*arguments, **keywords)

    return cast("Checked", counted)


def _release(product_function: Any) -> None:
    """Leave further calls of a function of the product unchecked by the mark that jaxtyping asks at each call.

    The frame of jaxtyping that calls the checks has the function as `fn`; in a version without, all calls are checked.
    """
    if product_function is not None:
        product_function.__no_type_check__ = True
        _released.append(product_function)


def begin_test() -> None:
    """Check every function anew."""
    for product_function in _released:
        product_function.__no_type_check__ = False
    _released.clear()
    _calls.clear()
