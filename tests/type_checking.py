"""Run-time checks of types and shapes while the suite runs: the check that `--jaxtyping-packages` of pyproject.toml names."""

from collections.abc import Callable
from typing import TypeVar

from beartype import beartype

Checked = TypeVar("Checked", bound=Callable[..., object])


def checked(function: Checked) -> Checked:
    """Return a function that beartype checks; one defined in a function as it is, since every call would compile its check."""
    return function if "<locals>" in function.__qualname__ else beartype(function)
