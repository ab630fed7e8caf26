"""Numbers of before and of now side by side, with a mark where they differ by more than rounding."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
from rich.console import Console
from rich.table import Table

OF_VALUE = 1e-6
OF_STANDARD_ERROR = 1e-3
"""Rounding changes a number by no more than one of these shares, of itself or of its standard error."""
NONE = "none"
WIDTH = 170


class Number(msgspec.Struct, frozen=True, omit_defaults=True):
    """A number with its standard error, 0 where it has none."""

    value: float
    standard_error: float = 0.0


class Told(msgspec.Struct, frozen=True):
    """What one recording told, by name."""

    words: dict[str, str]
    numbers: dict[str, Number]


Frozen = dict[str, Told]
"""By recording: the content of frozen.json."""


@dataclass(frozen=True)
class Row:
    """A number or word of before and of now."""

    recording: str
    name: str
    before: float | str
    now: float | str
    beyond_rounding: bool

    @property
    def difference(self) -> str:
        """Relative to before."""
        if isinstance(self.before, str) or isinstance(self.now, str):
            return ""
        if self.now == self.before:
            return "0"
        return f"{(self.now - self.before) / abs(self.before):+.1e}" if self.before else "from 0"


def compared(before: Frozen, now: Frozen) -> list[Row]:
    """Every number and word that is in either; what is in one of them alone is beyond rounding."""
    rows = []
    for recording in dict.fromkeys((*before, *now)):
        old, new = (_entries(frozen.get(recording, Told({}, {}))) for frozen in (before, now))
        for name in dict.fromkeys((*old, *new)):
            (was, rounding), (is_now, _) = old.get(name, (NONE, 0.0)), new.get(name, (NONE, 0.0))
            rows.append(Row(recording, name, was, is_now, not _within(was, is_now, rounding)))
    return rows


def shown(rows: Sequence[Row], against: str) -> None:
    """The table, and in a line below how many are beyond rounding."""
    table = Table(title=f"Now against {against}")
    for heading in ("recording", "number", "before", "now", "relative difference", ""):
        table.add_column(heading, justify="right" if heading in ("before", "now", "relative difference") else "left")
    for row in rows:
        texts = (_text(row.before), _text(row.now), row.difference)
        mark = "beyond rounding" if row.beyond_rounding else ""
        table.add_row(row.recording, row.name, *texts, mark, style="bold red" if row.beyond_rounding else None)
    console = Console() if sys.stdout.isatty() else Console(width=WIDTH)
    console.print(table)
    console.print(f"{sum(row.beyond_rounding for row in rows)} of {len(rows)} numbers and words beyond rounding")


def _entries(told: Told) -> dict[str, tuple[float | str, float]]:
    """Words, numbers and standard errors by name, each with what rounding may change of it."""
    entries: dict[str, tuple[float | str, float]] = {name: (word, 0.0) for name, word in told.words.items()}
    for name, number in told.numbers.items():
        of_error = OF_STANDARD_ERROR * number.standard_error
        entries[name] = (number.value, max(OF_VALUE * abs(number.value), of_error))
        if number.standard_error:
            entries[f"{name}, standard error"] = (number.standard_error, of_error)
    return entries


def _within(before: float | str, now: float | str, rounding: float) -> bool:
    if isinstance(before, str) or isinstance(now, str):
        return before == now
    return abs(now - before) <= rounding


def _text(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.9g}"
