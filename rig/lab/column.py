"""The channels of a file of measured data: listed by name, and read where they are asked for."""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Column:
    """Its name and samples; unit and sample rate are None where the file does not say them."""

    name: str
    values: Float[np.ndarray, " samples"]
    unit: str | None = None
    sample_rate_hz: float | None = None


@dataclass(frozen=True)
class ColumnBlock:
    """Columns of equal length that a file keeps together; `read` decodes those at the given places among the names.

    working_bytes is what `read` takes of memory beside the columns themselves.
    """

    names: tuple[str, ...]
    samples: int
    read: Callable[[Sequence[int]], Sequence[Column]]
    working_bytes: int = 0


@dataclass(frozen=True)
class Refused:
    """Refusal of what a file lists by this name and is not read, such as a link to another file, and the sentence that
    says so.
    """

    name: str
    sentence: str


Blocks = Generator[ColumnBlock | Refused, None, None]
"""What a file lists, one after the other; a block is read before the next one is asked for."""


class UnreadableError(ValueError):
    """A fault of a file, in words that stand between "cannot be read as .mat (" and ")"."""


def decoded(raw: bytes) -> str:
    """A text whose encoding the file does not say: UTF-8, or else Latin-1."""
    try:
        return raw.decode()
    except UnicodeDecodeError:
        return raw.decode("latin-1")
