"""How the score moves when a default tolerance is doubled or halved."""

from collections.abc import Iterator, Mapping

from msgspec.structs import replace
from rich.table import Table

from rig.model.tolerances import LABORATORY, Tolerances
from scenarios.score_table import told
from scenarios.scoreboard import Score

FACTORS = {"doubled": 2.0, "halved": 0.5}


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
    table = Table(title="each tolerance doubled and halved")
    table.add_column("")
    first = next(iter(boards.values()))
    previous = ""
    for rate in first.rates:
        previous = rate.name if not rate.name.startswith("...") else previous
        table.add_column(rate.name if rate.name == previous else f"{previous}, {rate.name[4:]}")
    for name, board in boards.items():
        table.add_row(name.replace("_", " "), *(told(rate) for rate in board.rates))
    return table
