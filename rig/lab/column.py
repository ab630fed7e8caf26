"""Channels of a file of measured data: listed by name, and decoded only if requested."""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

LEAST_SPARSE_NUMBERS = 8
"""Fewest numbers by which it is told that a channel has one in every second, third, ... line."""
LEAST_CHANGES = 20
"""Fewest changes of a channel by which it is told that its values are repeated."""


@dataclass(frozen=True)
class Column:
    """A channel; unit, sample rate and start are None, date_text and label empty where the file has none.

    start_s is the time of the first sample, s, on a clock that all columns of the file share, whatever its zero. Values
    are NaN between those of a channel that is slower than its neighbours. last_digit is the value of the last digit
    written, in the unit of the column; 0 if the numbers are binary. label is what the file calls the channel beside its
    name, by which a map finds it.
    """

    name: str
    values: Float[np.ndarray, " samples"]
    unit: str | None = None
    sample_rate_hz: float | None = None
    date_text: str = ""
    start_s: float | None = None
    last_digit: float = 0.0
    label: str = ""


@dataclass(frozen=True)
class ColumnBlock:
    """Columns of equal length that a file stores together; `read` decodes those with the given indices.

    working_bytes is the memory that `read` needs besides the columns themselves. notes say what was decided about them.
    """

    names: tuple[str, ...]
    sample_count: int
    read: Callable[[Sequence[int]], Sequence[Column]]
    working_bytes: int = 0
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Refused:
    """Content that is listed under a name but not read, such as a link to another file, with the reason."""

    name: str
    sentence: str


Blocks = Generator[ColumnBlock | Refused, None, None]
"""Content of a file in order; a block is read before the next one is requested."""


class UnreadableError(ValueError):
    """Fault of a file, in words that fit between "cannot be read as .mat (" and ")"."""


def utf8_or_latin1_text(encoded_text: bytes) -> str:
    """Text of unknown encoding: UTF-8, or else Latin-1."""
    try:
        return encoded_text.decode()
    except UnicodeDecodeError:
        return encoded_text.decode("latin-1")


def column_names(matrix_name: str, count: int) -> tuple[str, ...]:
    """Names of the columns of a matrix: its own of a single one, else NAME[1], NAME[2], ..."""
    return (matrix_name,) if count == 1 else tuple(f"{matrix_name}[{number}]" for number in range(1, count + 1))


def missing_row(values: Float[np.ndarray, " rows"]) -> int | None:
    """First row without a number; None if all have one, or regularly every second, third, ... row."""
    is_filled = np.isfinite(values)
    if is_filled.all():
        return None
    rows = np.flatnonzero(is_filled)
    if rows.size >= LEAST_SPARSE_NUMBERS:
        step = int(rows[1] - rows[0])
        if rows[0] < step and values.size - rows[-1] <= step and (np.diff(rows) == step).all():
            return None
    return int(np.argmin(is_filled))


def repetition_count(values: Float[np.ndarray, " samples"]) -> int:
    """How many times a slower channel repeats each of its values; 1 if it does not."""
    changes = np.flatnonzero(np.diff(values))
    if changes.size < LEAST_CHANGES or changes.size > values.size // 2:
        return 1
    count = int(np.gcd.reduce(np.diff(changes)))
    return count if changes.size * count > values.size / 2 else 1


def repetition_words(name: str, count: int, rate_hz: float) -> str:
    """Sentence on a channel that repeats its values."""
    return (
        f"{name} changes only once in {count} samples: its values are repeated, and its own rate is "
        f"{rate_hz / count:.6g} Hz, which delays it by {(count - 1) / 2:g} samples; export it at that rate"
    )
