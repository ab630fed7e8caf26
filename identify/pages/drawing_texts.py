"""Texts of the drawing of a rig: where each stands so that none lies over another."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import count
from textwrap import wrap

from identify.pages.page import unbroken_html
from rig.model.description import Rig

WIDTH = 540.0
"""Width of the drawing, px."""
NARROW_WIDTH = 356.0
"""Width of the drawing on a narrow screen, px: letters keep their size on one of 390 px, less the page's margins."""
RULER_LETTER_WIDTH, RULER_STEP = 7.0, 42.0
"""Mean width of a letter of a ruler, and distance of its numbers at least, px."""
LINE_HEIGHT, LETTER_WIDTH, BOLD_LETTER_WIDTH = 17.0, 8.4, 9.0
"""Height of a line of text, and mean width of a letter and of a bold one, px."""
STOP_DISTANCE, STOP_HALF_WIDTH = 11.0, 15.0
"""Distance of a stop from its body, and half its width, px."""
RING_RADIUS = 9.0
"""Radius of the ring of a mark, px."""
MAX_LINE_LETTERS = 38
"""Letters in a line of a mark at most."""
LEADER_GAP = 4.0
"""Distance between the line that leads from a ring to its words and other words, px."""
EDGE_GAP = 4.0
"""Distance of the words of a mark from the drawing's edges, px."""
MARK_GAP = 8.0
"""Distance between the words of a mark and the line of the next one, px."""
NO_BREAK = "\u00a0"
"""Space at which no line breaks."""
HELD_WORDS = "is held: no rigid-body mode"
"""Words on a body that is given by its modes and held somewhere: they do not tell where."""


@dataclass
class TextSpans:
    """Texts of one level, as horizontal spans by line: `first_free_line` finds the first line where a span is free."""

    spans_by_line: list[list[tuple[float, float]]] = field(default_factory=list)

    def first_free_line(self, left_px: float, right_px: float, line_count: int = 1) -> int:
        first_line = 0
        while any(
            left_px < taken_right_px and taken_left_px < right_px
            for spans in self.spans_by_line[first_line : first_line + line_count]
            for taken_left_px, taken_right_px in spans
        ):
            first_line += 1
        self.spans_by_line += [[] for _ in range(first_line + line_count - len(self.spans_by_line))]
        for spans in self.spans_by_line[first_line : first_line + line_count]:
            spans.append((left_px, right_px))
        return first_line

    def reserve_leader_line(self, text_line: int, x_px: float) -> None:
        """Take the place of the line that leads from a ring at x to the text on a line of its own."""
        for spans in self.spans_by_line[:text_line]:
            spans.append((x_px - LEADER_GAP, x_px + LEADER_GAP))


@dataclass(frozen=True)
class DrawnText:
    """Lines of text beside x, the first of them on a line of its level."""

    x_px: float
    anchor: str
    lines: Sequence[str]
    first_line: int


def contact_text(
    x_px: float, text_lines: Sequence[str], text_spans: TextSpans, posts_px: Sequence[float], drawing_px: float = WIDTH
) -> DrawnText:
    """Lines of text beside a contact, on the right side if they have room there before the next post of another, else
    on the left; wrapped on the right where neither side has room, or if that is too narrow for a word, over the post
    of the contact from the left edge on."""
    offset_px = STOP_HALF_WIDTH + 8
    right_room_px = min([post_px for post_px in posts_px if post_px > x_px], default=drawing_px) - x_px - offset_px
    left_room_px = x_px - offset_px - max([post_px for post_px in posts_px if post_px < x_px], default=0.0)
    if max(map(plain_width_px, text_lines)) > max(left_room_px, right_room_px):
        text_lines = _wrapped(text_lines, right_room_px) or text_lines
    width_px = max(map(plain_width_px, text_lines))
    if width_px <= right_room_px:
        right_px = x_px + offset_px + width_px
        first_line = text_spans.first_free_line(x_px - STOP_HALF_WIDTH, right_px, len(text_lines))
        return DrawnText(x_px + offset_px, "start", text_lines, first_line)
    end_px = max(x_px - offset_px, width_px)
    first_line = text_spans.first_free_line(end_px - width_px, max(end_px, x_px + STOP_HALF_WIDTH), len(text_lines))
    return DrawnText(end_px, "end", text_lines, first_line)


def _wrapped(text_lines: Sequence[str], width_px: float) -> list[str]:
    """Lines wrapped to a width, an interval with its unit unbroken; none where a word is wider."""
    lines = []
    for line in text_lines:
        value, *interval = line.split(" ± ")
        breakable = " ".join([value, *(f"± {half_and_unit}".replace(" ", NO_BREAK) for half_and_unit in interval)])
        lines += wrap(breakable, max(1, int(width_px / LETTER_WIDTH)), break_long_words=False)
    return lines if max(map(plain_width_px, lines)) <= width_px else []


def mark_texts(
    words_at_x: Sequence[tuple[float, str]], text_spans: TextSpans, drawing_px: float = WIDTH
) -> list[DrawnText]:
    """Even lines of text for marks at x, each with its words, such that no line to a ring passes through words.

    Of the marks without a text, the leftmost whose words have room between its neighbours without one is next. Where
    none has room, the leftmost is, and its words may lie on such a line.
    """
    texts: dict[int, DrawnText] = {}
    unplaced = sorted(range(len(words_at_x)), key=lambda index: words_at_x[index][0])
    while unplaced:
        for index in unplaced:
            x_px, words = words_at_x[index]
            unplaced_px = [words_at_x[unplaced_index][0] for unplaced_index in unplaced]
            left_px = max([px + MARK_GAP for px in unplaced_px if px < x_px - 1], default=EDGE_GAP)
            right_px = min([px - MARK_GAP for px in unplaced_px if px > x_px + 1], default=drawing_px - EDGE_GAP)
            if lines := _lines_within(words, right_px - left_px):
                break
        else:
            index, left_px, right_px = unplaced[0], EDGE_GAP, drawing_px - EDGE_GAP
            x_px, words = words_at_x[index]
            lines = _even_lines(unbroken_html(words), len(words))
        half_px = BOLD_LETTER_WIDTH * max(map(len, lines)) / 2
        middle_px = max(min(x_px, right_px - half_px), left_px + half_px)
        first_line = text_spans.first_free_line(middle_px - half_px, middle_px + half_px, len(lines))
        text_spans.reserve_leader_line(first_line, x_px)
        texts[index] = DrawnText(middle_px, "middle", lines, first_line)
        unplaced.remove(index)
    return [texts[index] for index in range(len(words_at_x))]


def _lines_within(words: str, width_px: float) -> list[str]:
    """Lines of text, as few as there are at the usual width or one more, within a width; none where it has no room."""
    words = unbroken_html(words)
    line_count = len(wrap(words, MAX_LINE_LETTERS))
    for most_lines in (line_count, line_count + 1):
        lines = _even_lines(words, most_lines)
        if BOLD_LETTER_WIDTH * max(map(len, lines)) <= width_px:
            return lines
    return []


def ruler_numbers(
    length_m: float, left_px: float, length_px: float, rings_px: Sequence[float]
) -> list[tuple[float, float, str]]:
    """Numbers of a ruler along a body from its left end, each as place and middle of its text, px, and the text: the
    length with its unit, then even steps, as far as none lies over another or a ring."""
    steps_m = (digit * 10.0**power for power in count(-6) for digit in (1, 2, 5))
    step_m = next(step_m for step_m in steps_m if step_m * length_px >= RULER_STEP * length_m)
    numbers: list[tuple[float, float, str]] = []
    taken_px = [(ring_px - RING_RADIUS - 2, ring_px + RING_RADIUS + 2) for ring_px in rings_px]
    for place_m in (length_m, *(step_m * k for k in range(int(length_m / step_m) + 1))):
        text = f"{place_m:.4g}" + " m" * (place_m == length_m)
        half_px, place_px = RULER_LETTER_WIDTH * len(text) / 2, left_px + length_px * place_m / length_m
        middle_px = max(min(place_px, left_px + length_px - 3 - half_px), left_px + 6 + half_px)
        first_px, last_px = middle_px - half_px - 2, middle_px + half_px + 2
        if last_px <= left_px + length_px and all(last_px <= first or last <= first_px for first, last in taken_px):
            taken_px.append((first_px, last_px))
            numbers.append((place_px, middle_px, text))
    return numbers


def foot_notes(rig: Rig) -> list[str]:
    """Sentences on what cannot be drawn: that a body is held somewhere, and that the base shakes."""
    is_held = [not (body.is_mass or body.clamped) and body.rigid_modes == 0 for body in rig.bodies]
    notes = [f"{body.name} {HELD_WORDS}" for body, held in zip(rig.bodies, is_held, strict=True) if held]
    base_names = ", ".join(sensor.name for sensor in rig.base_sensors)
    return [*notes, *([f"the ground shakes, measured by {base_names}"] if base_names else [])]


def bold_width_px(text: str) -> float:
    """Width of bold letters, among which m and w are half as wide again."""
    return BOLD_LETTER_WIDTH * (len(text) + 0.5 * _wide_letter_count(text))


def plain_width_px(text: str) -> float:
    """Width of letters, among which m and w are half as wide again."""
    return LETTER_WIDTH * (len(text) + 0.5 * _wide_letter_count(text))


def _wide_letter_count(text: str) -> int:
    return sum(text.lower().count(letter) for letter in "mw")


def _even_lines(words: str, line_count: int) -> list[str]:
    """Words wrapped, none broken, to at most `line_count` lines, whose longest is as short as it can be; to as many as
    there are with the longest word alone in its line."""
    longest_word = max(map(len, words.split()))
    wrapped = [wrap(words, letters) for letters in range(longest_word, max(longest_word, MAX_LINE_LETTERS) + 1)]
    return next((lines for lines in wrapped if len(lines) <= line_count), wrapped[0])
