"""How the score moves when a default tolerance is doubled or halved."""

from collections.abc import Iterator, Mapping

from msgspec.structs import replace
from rich.table import Table

from rig.model.tolerances import LABORATORY, Tolerances
from tests.campaigns.scoreboard import Score

FACTORS = {"doubled": 2.0, "halved": 0.5}
COLUMNS = {
    "visible effects named": "visible named",
    "verdict right": "verdicts",
    "null: false alarm": "false alarms",
    "outside: description right": "described",
    "parameter in its 95 % interval": "parameters",
    "false names a case": "false names",
}
"""The rates of the table, with its headings."""


def settings(only: str | None = None) -> Iterator[tuple[str, Tolerances]]:
    """The defaults, then each of them doubled and halved, or that of one name; with the name of its folder."""
    yield "default", LABORATORY
    for field in LABORATORY.__struct_fields__:
        value = getattr(LABORATORY, field)
        if isinstance(value, float) and value > 0 and only in (None, field):
            for what, factor in FACTORS.items():
                yield f"{field}_{what}", replace(LABORATORY, **{field: factor * value})


def table_of(boards: Mapping[str, Score]) -> Table:
    """A row a setting, a column a rate."""
    table = Table(title="each tolerance doubled and halved: right of so many")
    table.add_column("", no_wrap=True)
    for heading in COLUMNS.values():
        table.add_column(heading, justify="right")
    for name, board in boards.items():
        rates = {rate.name: rate for rate in (*board.rates, board.false_names)}
        table.add_row(name.replace("_", " "), *(f"{rates[c].count} of {rates[c].of}" for c in COLUMNS))
    return table
