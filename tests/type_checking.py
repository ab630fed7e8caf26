"""Types and shapes checked at run time while the suite runs, by beartype and jaxtyping."""

from collections.abc import Callable
from typing import TypeVar

from beartype import beartype

Checked = TypeVar("Checked", bound=Callable[..., object])


def checked(function: Checked) -> Checked:
    """Function whose calls beartype checks; one defined within another as it is, since each call would compile it."""
    return function if "<locals>" in function.__qualname__ else beartype(function)
