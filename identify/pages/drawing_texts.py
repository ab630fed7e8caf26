"""Texts of the drawing of a rig: where each stands so that none lies over another."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from textwrap import wrap

from identify.pages.page import unbroken_html

WIDTH = 540.0
"""Width of the drawing, px."""
LINE_HEIGHT, LETTER_WIDTH, BOLD_LETTER_WIDTH = 17.0, 8.2, 9.0
"""Height of a line of text, and mean width of a letter and of a bold one, px."""
STOP_DISTANCE, STOP_HALF_WIDTH = 11.0, 15.0
"""Distance of a stop from its body, and half its width, px."""
MAX_LINE_LETTERS = 38
"""Letters in a line of a mark at most."""
MARK_GAP = 8.0
"""Distance between the words of a mark and the line of the next one, px."""


@dataclass
class TextSpans:
    """Texts of one level, as horizontal spans by line: `line_for` finds the first line where a span is free."""

    spans_by_line: list[list[tuple[float, float]]] = field(default_factory=list)

    def line_for(self, left_px: float, right_px: float, line_count: int = 1) -> int:
        first_line = 0
        while any(
            left_px < taken_right_px and taken_left_px < right_px
            for line_spans in self.spans_by_line[first_line : first_line + line_count]
            for taken_left_px, taken_right_px in line_spans
        ):
            first_line += 1
        self.spans_by_line += [[] for _ in range(first_line + line_count - len(self.spans_by_line))]
        for line_spans in self.spans_by_line[first_line : first_line + line_count]:
            line_spans.append((left_px, right_px))
        return first_line


@dataclass(frozen=True)
class DrawnText:
    """Lines of text beside x, the first of them on a line of its level."""

    x_px: float
    anchor: str
    lines: Sequence[str]
    first_line: int


def contact_text(x_px: float, text_lines: Sequence[str], text_spans: TextSpans, posts_px: Sequence[float]) -> DrawnText:
    """Lines of text beside a contact, on the side without posts of others, the right one if both or none is free."""
    offset_px, width_px = STOP_HALF_WIDTH + 8, LETTER_WIDTH * max(map(len, text_lines))
    left_px, right_px = x_px - offset_px - width_px, x_px + offset_px + width_px
    is_right_free = not any(x_px < post_px < right_px for post_px in posts_px)
    is_left_free = left_px >= 0 and not any(left_px < post_px < x_px for post_px in posts_px)
    if right_px <= WIDTH and (is_right_free or not is_left_free):
        return DrawnText(
            x_px + offset_px,
            "start",
            text_lines,
            text_spans.line_for(x_px - STOP_HALF_WIDTH, right_px, len(text_lines)),
        )
    return DrawnText(
        x_px - offset_px,
        "end",
        text_lines,
        text_spans.line_for(left_px, x_px + STOP_HALF_WIDTH, len(text_lines)),
    )


def mark_text(x_px: float, words: str, text_spans: TextSpans, marks_px: Sequence[float]) -> DrawnText:
    """Even lines of text centred about x, as far as the drawing's edges and the line of the next mark allow."""
    words = unbroken_html(words)
    line_count = len(wrap(words, MAX_LINE_LETTERS))
    right_px = min(
        [other_mark_px - MARK_GAP for other_mark_px in marks_px if other_mark_px > x_px + 1], default=WIDTH - 4
    )
    lines_and_limits = [
        (_even_lines(words, tried_line_count), right_limit_px)
        for right_limit_px in (right_px, WIDTH - 4)
        for tried_line_count in (line_count, line_count + 1)
    ]
    text_lines, right_px = next(
        (
            lines_and_limit
            for lines_and_limit in lines_and_limits
            if 4 + _bold_width_px(lines_and_limit[0]) <= lines_and_limit[1]
        ),
        lines_and_limits[-1],
    )
    half_width_px = _bold_width_px(text_lines) / 2
    middle_px = max(min(x_px, right_px - half_width_px), half_width_px + 4)
    return DrawnText(
        middle_px,
        "middle",
        text_lines,
        text_spans.line_for(middle_px - half_width_px, middle_px + half_width_px, len(text_lines)),
    )


def _even_lines(words: str, line_count: int) -> list[str]:
    """Words wrapped to at most `line_count` lines, whose longest is as short as it can be."""
    return next(
        lines for line_letters in range(1, len(words) + 1) if len(lines := wrap(words, line_letters)) <= line_count
    )


def _bold_width_px(text_lines: Sequence[str]) -> float:
    return BOLD_LETTER_WIDTH * max(map(len, text_lines))
