"""Role that each column of a file is taken for: a force, a sensor of some quantity, or nothing that a rig has."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, count

from rig.lab.looking.clock import is_time_column
from rig.lab.looking.columns import ColumnSummary
from rig.lab.units import FOREIGN_UNITS, canonical_unit, name_and_unit, quantity_of

_WORDS_OF_QUANTITIES = (
    ("force", r"force|kraft|load|(?<![bep])last|(?<![a-z])f(?![a-z])|(?<![a-z])f[xyz]?\d*(?![a-z])"),
    ("acceleration", r"acc|beschl|accel"),
    ("velocity", r"vel|geschw|speed"),
    ("displacement", r"disp|weg|auslenk|posit|lvdt|laser"),
    ("strain", r"strain|dehn|dms"),
    ("force", r"hammer|shaker|impact"),
)
"""Words in names, by the quantity that they suggest, the surest first."""


@dataclass(frozen=True)
class ColumnRole:
    """A column taken as force or sensor of a quantity; None: unknown."""

    column: ColumnSummary
    name: str
    quantity: str | None


def channel_columns_and_rejections(
    columns: Sequence[ColumnSummary],
) -> tuple[tuple[ColumnSummary, ...], tuple[tuple[ColumnSummary, str], ...]]:
    """Columns that vary, and the others with the reason in words; their lengths and rates may differ.

    Of forces one that does not vary counts too, if no other does.
    """
    reasons = {column.number: reason for column in columns if (reason := _unfit_reason(column))}
    if not any(is_called_force(column) for column in columns if column.number not in reasons):
        for column in columns:
            if is_called_force(column) and reasons.get(column.number) == _constancy_reason(column):
                del reasons[column.number]
    return (
        tuple(column for column in columns if column.number not in reasons),
        tuple((column, reasons[column.number]) for column in columns if column.number in reasons),
    )


def roles_of(columns: Sequence[ColumnSummary]) -> tuple[ColumnRole, ...]:
    """Role of each column that is none of time; names are distinct."""
    used_names: set[str] = set()
    return tuple(_role(column, used_names) for column in columns)


def _role(column: ColumnSummary, used_names: set[str]) -> ColumnRole:
    header = column.label or name_and_unit(column.name, guess=True)[0].strip()
    base_name = header if header.isprintable() and 0 < len(header) <= 200 else f"channel_{column.number}"
    name_variants = chain([base_name], (f"{base_name}_{number}" for number in count(2)))
    name = next(variant for variant in name_variants if variant not in used_names)
    used_names.add(name)
    return ColumnRole(column, name, _quantity(column))


def is_called_force(column: ColumnSummary) -> bool:
    """True if a column is a force by its unit, or by its name and no other unit of a rig's sensors."""
    return _quantity(column) == "force"


def named_quantity(column: ColumnSummary) -> str | None:
    """Quantity that the label suggests, or the name, its last part (group/channel, run.channel) first."""
    name_parts = [*re.split(r"[/.]", name_and_unit(column.name, guess=True)[0]), column.label]
    suggested_quantities = (
        quantity
        for part in reversed(name_parts)
        for quantity, words in _WORDS_OF_QUANTITIES
        if re.search(words, part, re.IGNORECASE)
    )
    return next(suggested_quantities, None)


def _quantity(column: ColumnSummary) -> str | None:
    return quantity_of(column.unit) or named_quantity(column)


def _constancy_reason(column: ColumnSummary) -> str:
    """Reason why a column is no signal; empty if it takes three values or more."""
    if column.distinct_count == 1:
        return f"it is {column.lowest:g} throughout"
    return f"it is {column.lowest:g} or {column.highest:g}, as a trigger is" if column.distinct_count == 2 else ""


def _unfit_reason(column: ColumnSummary) -> str:
    """Reason why a column is no measured channel; empty if it may be one."""
    is_foreign = not is_called_force(column) and (
        quantity_of(column.unit) == "time" or {column.unit, canonical_unit(column.unit or "")} & FOREIGN_UNITS
    )
    conditions_and_reasons = (
        (column.is_date, "dates"),
        (bool(column.fault), column.fault),
        (column.distinct_count < 3, _constancy_reason(column)),
        (column.stamps is not None and column.is_counter, "it counts the samples"),
        (column.stamps is not None and is_time_column(column), "it is a time"),
        (is_foreign, f"it is in {column.unit}, which no sensor of a rig measures"),
    )
    return next((reason for applies, reason in conditions_and_reasons if applies), "")
