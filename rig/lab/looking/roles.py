"""Role that each column of a file is taken for: a force, a sensor of some quantity, or nothing that a rig has."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rig.lab.looking.clock import is_time
from rig.lab.looking.columns import ColumnSummary
from rig.lab.units import SCALED_UNITS, name_and_unit, quantity_of

_WORDS_BY_QUANTITY = {
    "force": r"force|kraft|load|last|hammer|shaker|impact|(?<![a-z])f(?![a-z])|(?<![a-z])f[xyz]?\d*(?![a-z])",
    "acceleration": r"acc|beschl|accel",
    "velocity": r"vel|geschw|speed",
    "displacement": r"disp|weg|auslenk|posit|lvdt|laser",
    "strain": r"strain|dehn|dms",
}
"""Words in names, by the quantity that they suggest."""


@dataclass(frozen=True)
class ColumnRole:
    """A column taken as force or sensor: its quantity (None: unknown) and whether only its name suggests it."""

    column: ColumnSummary
    name: str
    quantity: str | None
    is_by_name: bool


def candidates_in(
    columns: Sequence[ColumnSummary],
) -> tuple[tuple[ColumnSummary, ...], tuple[tuple[ColumnSummary, str], ...]]:
    """Columns that vary over the samples most of them have, and the others with the reason in words."""
    reason_by_number = {column.number: reason for column in columns if (reason := _unfit_reason(column))}
    usable_columns = [column for column in columns if column.number not in reason_by_number]
    counts_by_length_and_rate = Counter((column.sample_count, column.rate_hz) for column in usable_columns)
    if counts_by_length_and_rate:
        (usual_samples, usual_rate_hz), _ = counts_by_length_and_rate.most_common(1)[0]
        for column in usable_columns:
            if column.sample_count != usual_samples:
                reason_by_number[column.number] = f"it has {column.sample_count} samples, most have {usual_samples}"
            elif column.rate_hz != usual_rate_hz:
                reason_by_number[column.number] = (
                    f"it is sampled at {column.rate_hz or 0:g} Hz, most at {usual_rate_hz or 0:g}"
                )
    return (
        tuple(column for column in usable_columns if column.number not in reason_by_number),
        tuple((column, reason_by_number[column.number]) for column in columns if column.number in reason_by_number),
    )


def roles_of(columns: Sequence[ColumnSummary]) -> tuple[ColumnRole, ...]:
    """Role of each column that is none of time; names are distinct."""
    used_names: set[str] = set()
    return tuple(_role(column, used_names) for column in columns)


def _role(column: ColumnSummary, used_names: set[str]) -> ColumnRole:
    name_without_unit = name_and_unit(column.name, guess=True)[0].strip()
    printable_name = (
        name_without_unit
        if name_without_unit.isprintable() and 0 < len(name_without_unit) <= 200
        else f"channel_{column.number}"
    )
    name = next(candidate for candidate in _name_variants(printable_name) if candidate not in used_names)
    used_names.add(name)
    if quantity := quantity_of(column.unit):
        return ColumnRole(column, name, quantity, is_by_name=False)
    if column.unit in SCALED_UNITS:
        return ColumnRole(column, name, None, is_by_name=False)
    suggested_quantity = next(
        (
            quantity_name
            for quantity_name, words in _WORDS_BY_QUANTITY.items()
            if re.search(words, name_without_unit, re.IGNORECASE)
        ),
        None,
    )
    return ColumnRole(column, name, suggested_quantity, is_by_name=True)


def _name_variants(name: str) -> Iterator[str]:
    yield name
    number = 2
    while True:
        yield f"{name}_{number}"
        number += 1


def _unfit_reason(column: ColumnSummary) -> str:
    """Reason why a column is no measured channel; empty if it may be one."""
    is_foreign_unit = quantity_of(column.unit) in (None, "time") and column.unit not in (None, *SCALED_UNITS)
    reasons = (
        (column.is_date, "dates"),
        (bool(column.fault), column.fault),
        (column.distinct_count == 1, f"it is {column.lowest:g} throughout"),
        (column.distinct_count == 2, f"it is {column.lowest:g} or {column.highest:g}, as a trigger is"),
        (column.stamps is not None and column.is_counter, "it counts the samples"),
        (column.stamps is not None and is_time(column), "it is a time"),
        (is_foreign_unit, f"it is in {column.unit}, which no sensor of a rig measures"),
    )
    return next((reason for applies, reason in reasons if applies), "")
