"""Short view of a result: sentences and a table, as text for the screen and as HTML for a notebook."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape

from identify.pages.page import table


@dataclass(frozen=True)
class Summary:
    """Rows of a table by their column names, all rows with the same ones, and the sentences above and below it."""

    rows: tuple[Mapping[str, str], ...] = ()
    above: tuple[str, ...] = ()
    below: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """Lines of text with the columns aligned."""
        return "\n".join([*self.above, *_aligned_lines(self.rows), *self.below])

    @property
    def html(self) -> str:
        """HTML without a style of its own."""
        html_tables = [table(tuple(self.rows[0]), [tuple(row.values()) for row in self.rows])] if self.rows else []
        return "\n".join([*map(_paragraph, self.above), *html_tables, *map(_paragraph, self.below)])


class Summarized(ABC):
    """Result that prints as its summary, and that a notebook shows as a table."""

    @abstractmethod
    def summary(self) -> Summary:
        """Sentences and short table of the result."""

    def __str__(self) -> str:
        return self.summary().text

    def _repr_html_(self) -> str:
        return self.summary().html


def _aligned_lines(rows: tuple[Mapping[str, str], ...]) -> list[str]:
    if not rows:
        return []
    cell_rows = [tuple(rows[0]), *(tuple(row.values()) for row in rows)]
    column_widths = [max(map(len, column)) for column in zip(*cell_rows, strict=True)]
    return ["  ".join(map(str.ljust, cell_row, column_widths)).rstrip() for cell_row in cell_rows]


def _paragraph(sentence: str) -> str:
    return f"<p>{escape(sentence)}</p>"
