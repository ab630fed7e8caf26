"""Drawing of a rig for a page, as SVG, with what was identified written at its place.

Notes for maintainers
1. Bodies lie in rows, the first one lowest, to scale along x, so that stations in contact stand one above the other. A
   mass is a block. Heights, thicknesses and clearances are not to scale.
2. Between two rows there is room for the lines of the contacts (below the upper body) and for those of the marks (above
   the lower body); texts that would overlap stand one below the other.
3. Colours are those of the page (`identify.pages.page`), so that light, dark and printed pages agree.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from textwrap import wrap

from rig.model.description import Body, Contact, Rig, Station, contact_stations
from rig.model.layout import left_ends

WIDTH, LEFT, RIGHT, BAR, BLOCK = 620.0, 34.0, 84.0, 15.0, (120.0, 46.0)
"""Width of the drawing, its left and right margin, thickness of a beam, width and height of a mass, px."""
LINE, LETTER = 17.0, 8.2
"""Height of a line of text, and mean width of a letter, px."""
JAW, REACH = 11.0, 15.0
"""Distance of a stop from its body, and half its width, px."""
ROOM, FOOT = 46.0, 54.0
"""Height between two rows without texts, and below the lowest one, px."""
MAX_LETTERS = 40
"""Letters in a line of a mark at most."""


@dataclass(frozen=True)
class DrawnMark:
    """Mark of an effect or force at a station, with its words."""

    station: Station
    words: str


@dataclass
class _Rows:
    """Texts of one level, as horizontal spans by line: `line_for` finds the first line where a span is free."""

    spans: list[list[tuple[float, float]]] = field(default_factory=list)

    def line_for(self, left_px: float, right_px: float, count: int = 1) -> int:
        first = 0
        while any(
            left_px < taken_right_px and taken_left_px < right_px
            for spans in self.spans[first : first + count]
            for taken_left_px, taken_right_px in spans
        ):
            first += 1
        self.spans += [[] for _ in range(first + count - len(self.spans))]
        for spans in self.spans[first : first + count]:
            spans.append((left_px, right_px))
        return first


@dataclass(frozen=True)
class _Text:
    """Lines of text beside x, the first of them on a line of its level."""

    x: float
    anchor: str
    lines: Sequence[str]
    first_line: int


@dataclass(frozen=True)
class _Layout:
    """Places of bodies, stations and contacts, px."""

    rig: Rig
    left_m: Mapping[str, float]
    scale: float
    tops: dict[str, float] = field(default_factory=dict)

    def x(self, station: Station) -> float:
        """Place along x; of masses alone, the middle."""
        if not self.scale:
            return WIDTH / 2
        return LEFT + self.scale * (self.left_m[station.body] + station.position_m - min(self.left_m.values()))

    def contact_x(self, contact: Contact) -> float:
        """Place of a contact along x; the contacts of a mass stand side by side."""
        upper = self.upper_body(contact)
        if not upper.is_mass:
            return self.x(contact.at)
        beside = [other for other in self.rig.contacts if self.upper_body(other) == upper]
        return self.x(Station(upper.name)) + 0.5 * BLOCK[0] * beside.index(contact)

    def corner_x(self, station: Station, share: float) -> float:
        """Place of a station along x; on a mass, this share of its width from its middle."""
        return self.x(station) + share * BLOCK[0] * self.rig.body(station.body).is_mass

    def upper_body(self, contact: Contact) -> Body:
        """Upper one of the bodies in contact: the later one in the rig."""
        names = [station.body for station in contact_stations(contact)]
        return next(body for body in reversed(self.rig.bodies) if body.name in names)

    def bottom(self, body: Body) -> float:
        return self.tops[body.name] + _height(body)


def machine(rig: Rig, contact_lines: Mapping[str, Sequence[str]], marks: Sequence[DrawnMark] = ()) -> str:
    """SVG of a rig: bodies, sensors, forces, contacts with their lines of text, and marks with theirs."""
    left_m = left_ends(rig)
    extent_m = max(left_m[b.name] + b.length_m for b in rig.bodies) - min(left_m.values())
    layout = _Layout(rig, left_m, (WIDTH - LEFT - RIGHT) / extent_m if extent_m > 0 else 0.0)
    rows_below, rows_above = ({body.name: _Rows() for body in rig.bodies} for _ in range(2))
    contact_texts: list[tuple[Contact, _Text]] = []
    for contact in rig.contacts:
        lines = [contact.name, *contact_lines.get(contact.name, ())]
        rows = rows_below[layout.upper_body(contact).name]
        contact_texts.append((contact, _contact_text(layout.contact_x(contact), lines, rows)))
    mark_texts: list[tuple[DrawnMark, _Text]] = []
    for mark in sorted(marks, key=lambda mark: layout.x(mark.station)):
        lines = wrap(mark.words, MAX_LETTERS)
        mark_texts.append((mark, _mark_text(layout.x(mark.station), lines, rows_above[mark.station.body])))
    y = 0.0
    for body in reversed(rig.bodies):
        layout.tops[body.name] = y = y + ROOM + LINE * len(rows_above[body.name].spans)
        y += _height(body) + LINE * len(rows_below[body.name].spans)
    parts = [
        *(part for body in rig.bodies for part in _support(layout, body)),
        *(part for contact, text in contact_texts for part in _contact(layout, contact, text)),
        *(part for body in rig.bodies for part in _body(layout, body)),
        *_sensors(layout),
        *_forces(layout),
        *_measured_base(layout, y + FOOT),
        *(part for mark, text in mark_texts for part in _ring(layout, mark, text)),
        *(part for mark, text in mark_texts for part in _words(layout, mark, text)),
    ]
    return (
        f'<svg viewBox="0 0 {WIDTH:g} {y + FOOT:g}" role="img" aria-label="Drawing of {escape(rig.name)}" '
        f'class="machine">{"".join(parts)}</svg>'
    )


def _height(body: Body) -> float:
    return BLOCK[1] if body.is_mass else BAR


def _contact_text(x: float, lines: Sequence[str], rows: _Rows) -> _Text:
    """Lines of text beside a contact, on the side that has room for them."""
    offset, width = REACH + 8, LETTER * max(map(len, lines))
    if x + offset + width <= WIDTH:
        return _Text(x + offset, "start", lines, rows.line_for(x - REACH, x + offset + width, len(lines)))
    return _Text(x - offset, "end", lines, rows.line_for(x - offset - width, x + REACH, len(lines)))


def _mark_text(x: float, lines: Sequence[str], rows: _Rows) -> _Text:
    """Lines of text centred about x, as far as the drawing's edges allow."""
    half = LETTER * max(map(len, lines)) / 2
    middle = min(max(x, half + 4), WIDTH - half - 4)
    return _Text(middle, "middle", lines, rows.line_for(middle - half, middle + half, len(lines)))


def _support(layout: _Layout, body: Body) -> Iterator[str]:
    """Wall of a clamped beam; spring of a mass."""
    x, middle = layout.x(Station(body.name)), layout.tops[body.name] + _height(body) / 2
    if body.clamped:
        yield _path("ink", f"M{x:g},{middle - 26:g}v52")
        yield _path("thin", "".join(f"M{x:g},{middle - 22 + 9 * k:g}l-10,9" for k in range(6)))
    if body.is_mass and body.frequencies_hz(1)[0] > 0:
        left = x - BLOCK[0] / 2
        turns = "l-3,-6" + "l-6,12l-6,-12" * 3 + "l-3,6"
        yield _path("thin", f"M{left:g},{middle:g}h-10{turns}h-10")
        yield _path("ink", f"M{left - 62:g},{middle - 20:g}v40")


def _body(layout: _Layout, body: Body) -> Iterator[str]:
    x, top, height = layout.x(Station(body.name)), layout.tops[body.name], _height(body)
    width = BLOCK[0] if body.is_mass else layout.scale * body.length_m
    left = x - width / 2 if body.is_mass else x
    yield f'<rect class="body" x="{left:g}" y="{top:g}" width="{width:g}" height="{height:g}"/>'
    if body.is_mass:
        yield _line(x, top + height / 2 + 5, "middle", body.name, "name")
    else:
        yield _line(left + width + 8, top + height, "start", body.name, "name")


def _contact(layout: _Layout, contact: Contact, text: _Text) -> Iterator[str]:
    """Fork with two stops around the upper body, or a spring below it, from the lower body or the ground, and its lines
    of text."""
    x, upper = layout.contact_x(contact), layout.upper_body(contact)
    top, bottom = layout.tops[upper.name], layout.bottom(upper)
    carriers = [s.body for s in contact_stations(contact) if s.body != upper.name]
    foot = layout.tops[carriers[0]] if carriers else bottom + ROOM + LINE * (text.first_line + len(text.lines) - 2)
    kind = "found" if len(text.lines) > 1 else "fork"
    if contact.law.has_stops:
        yield _path(kind, f"M{x - REACH:g},{top - JAW:g}h{2 * REACH:g}V{foot:g}")
        yield _path(kind, f"M{x - REACH:g},{bottom + JAW:g}h{2 * REACH:g}")
    else:
        step = (foot - bottom) / 8
        turns = f"l-8,{step / 2:g}" + f"l16,{step:g}l-16,{step:g}" * 2 + f"l16,{step:g}l-8,{step / 2:g}"
        yield _path(kind, f"M{x + REACH:g},{bottom:g}v{step:g}{turns}V{foot:g}")
    if not carriers:
        yield _path("ink", f"M{x + REACH - 20:g},{foot:g}h40")
        yield _path("thin", "".join(f"M{x + REACH - 16 + 8 * k:g},{foot:g}l-6,8" for k in range(5)))
    for k, line in enumerate(text.lines):
        y = bottom + 30 + LINE * (text.first_line + k)
        yield _line(text.x, y, text.anchor, line, "value" if k else "name")


def _sensors(layout: _Layout) -> Iterator[str]:
    """Triangle at every station with sensors; their names show under the pointer."""
    sensors = [sensor for sensor in layout.rig.sensors if sensor not in layout.rig.base_sensors]
    for station in dict.fromkeys(sensor.station for sensor in sensors):
        d = f"M{layout.x(station) - 5:g},{layout.tops[station.body] - 9:g}h10l-5,8z"
        yield _path("sensor", d, ", ".join(sensor.name for sensor in sensors if sensor.station == station))


def _forces(layout: _Layout) -> Iterator[str]:
    for station in dict.fromkeys(s for s in layout.rig.forces if not layout.rig.is_on_ground(s)):
        x, y = layout.corner_x(station, -0.35), layout.bottom(layout.rig.body(station.body))
        yield _path("force", f"M{x:g},{y + 34:g}V{y + 5:g}m-5,9l5,-9l5,9")
        yield _line(x + 9, y + 33, "start", "F", "dim")


def _measured_base(layout: _Layout, foot: float) -> Iterator[str]:
    """Words on the sensors of a base that shakes, at the foot of the drawing."""
    if names := ", ".join(sensor.name for sensor in layout.rig.base_sensors):
        yield _line(LEFT, foot - 6, "start", f"the ground shakes, measured by {names}", "dim")


def _base(layout: _Layout, mark: DrawnMark, text: _Text) -> float:
    """Baseline of the lowest line of a mark's words."""
    return layout.tops[mark.station.body] - 24 - LINE * text.first_line


def _ring(layout: _Layout, mark: DrawnMark, text: _Text) -> Iterator[str]:
    """Ring about the station, and a line to its words."""
    x, top = layout.corner_x(mark.station, 0.38), layout.tops[mark.station.body]
    middle = top + _height(layout.rig.body(mark.station.body)) / 2
    yield _path("mark", f"M{x:g},{middle - 9:g}V{_base(layout, mark, text) + 5:g}")
    yield f'<circle class="mark" cx="{x:g}" cy="{middle:g}" r="9"/>'


def _words(layout: _Layout, mark: DrawnMark, text: _Text) -> Iterator[str]:
    for k, line in enumerate(reversed(text.lines)):
        yield _line(text.x, _base(layout, mark, text) - LINE * k, text.anchor, line, "mark-words")


def _path(kind: str, d: str, title: str = "") -> str:
    return f'<path class="{kind}" d="{d}">{f"<title>{escape(title)}</title>" if title else ""}</path>'


def _line(x: float, y: float, anchor: str, text: str, kind: str) -> str:
    return f'<text class="{kind}" x="{x:g}" y="{y:g}" text-anchor="{anchor}">{escape(text)}</text>'
