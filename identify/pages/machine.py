"""Drawing of a rig for a page, as SVG, with what was identified written at its place.

Notes for maintainers
1. Bodies lie in rows, the first one lowest, to scale along x, so that stations in contact stand one above the other. A
   mass is a block. Heights, thicknesses and clearances are not to scale. Each body but a mass is a ruler from its left
   end, where its stations are counted from.
2. Between two rows there is room for the lines of the contacts (below the upper body) and for those of the marks (above
   a body, but below the lowest one, on which the contacts of the others stand); texts that would overlap stand one
   below the other.
3. Colours are those of the page (`identify.pages.page`), so that light, dark and printed pages agree.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

from identify.pages.drawing_texts import (
    LINE_HEIGHT,
    RING_RADIUS,
    STOP_DISTANCE,
    STOP_HALF_WIDTH,
    WIDTH,
    DrawnText,
    TextSpans,
    bold_width_px,
    contact_text,
    foot_notes,
    mark_texts,
    ruler_numbers,
)
from rig.model.description import Body, Contact, Rig, Station, contact_stations
from rig.model.layout import left_end_m_by_body

LEFT_MARGIN, NAME_MARGIN, BEAM_HEIGHT, MASS_SIZE = 34.0, 30.0, 20.0, (120.0, 46.0)
"""Left margin, right margin beside the longest name, thickness of a beam, width and height of a mass, px."""
RING_SHARE = 0.38
"""Place of a mass's ring, in shares of its width from its middle."""
ROW_GAP, FOOT_HEIGHT = 46.0, 54.0
"""Height between two rows without texts, and below the lowest one, px."""
GROUND_HALF_WIDTH = 20.0
"""Half the width of the hatched ground, px."""


@dataclass(frozen=True)
class DrawnMark:
    """Mark of an effect or force with its words: at a station, or around the whole of its beam; a hint is fainter."""

    station: Station
    words: str
    is_hint: bool = False
    of_whole_body: bool = False

    @property
    def css_class(self) -> str:
        return "mark hint" if self.is_hint else "mark"


@dataclass(frozen=True)
class _Layout:
    """Places of bodies, stations and contacts, px."""

    rig: Rig
    width_px: float
    left_ends_m: Mapping[str, float]
    px_per_m: float
    tops_px: dict[str, float] = field(default_factory=dict)

    def x_px(self, station: Station) -> float:
        """Place along x; of masses alone, the middle."""
        if not self.px_per_m:
            return self.width_px / 2
        x_m = self.left_ends_m[station.body] + station.position_m - min(self.left_ends_m.values())
        return LEFT_MARGIN + self.px_per_m * x_m

    def contact_x_px(self, contact: Contact) -> float:
        """Place of a contact along x; the contacts of a mass stand side by side."""
        body = self.upper_body(contact)
        if not body.is_mass:
            return self.x_px(contact.at)
        contacts, x_px = self.contacts_of(body), self.x_px(Station(body.name))
        step_px = min(0.5 * MASS_SIZE[0], (self.width_px - x_px - STOP_HALF_WIDTH) / len(contacts))
        return x_px + step_px * contacts.index(contact)

    def contacts_of(self, body: Body) -> list[Contact]:
        """Contacts of which a body is the upper one."""
        return [contact for contact in self.rig.contacts if self.upper_body(contact) == body]

    def corner_x_px(self, station: Station, width_share: float) -> float:
        """Place of a station along x; on a mass, this share of its width from its middle."""
        return self.x_px(station) + width_share * MASS_SIZE[0] * self.rig.body(station.body).is_mass

    def upper_body(self, contact: Contact) -> Body:
        """Upper one of the bodies in contact: the later one in the rig."""
        body_names = [station.body for station in contact_stations(contact)]
        return next(body for body in reversed(self.rig.bodies) if body.name in body_names)

    def is_marked_below(self, body: Body) -> bool:
        """True of the lowest of several bodies, unless a contact's texts stand below it."""
        return body == self.rig.bodies[0] and len(self.rig.bodies) > 1 and not self.contacts_of(body)

    @property
    def drawn_forces(self) -> tuple[Station, ...]:
        """Stations of the forces, those on the ground apart."""
        return tuple(dict.fromkeys(station for station in self.rig.forces if not self.rig.is_on_ground(station)))

    def force_left_right_px(self, station: Station) -> tuple[float, float]:
        """Left and right end of the arrow of a force and its letter."""
        x_px = self.corner_x_px(station, -0.35)
        return x_px - 6, x_px + 20

    def bottom_px(self, body: Body) -> float:
        return self.tops_px[body.name] + _height_px(body)


def rig_drawing_svg(
    rig: Rig, contact_lines: Mapping[str, Sequence[str]], marks: Sequence[DrawnMark] = (), width_px: float = WIDTH
) -> str:
    """SVG of a rig: bodies, sensors, forces, contacts with their lines of text, and marks with theirs."""
    left_ends_m = left_end_m_by_body(rig)
    extent_m = max(left_ends_m[b.name] + b.length_m for b in rig.bodies) - min(left_ends_m.values())
    name_px = max([bold_width_px(body.name) for body in rig.bodies if not body.is_mass], default=0.0)
    right_margin_px = NAME_MARGIN + min(name_px, width_px / 3)
    px_per_m = (width_px - LEFT_MARGIN - right_margin_px) / extent_m if extent_m > 0 else 0.0
    layout = _Layout(rig, width_px, left_ends_m, px_per_m)
    spans_below, spans_above = ({body.name: TextSpans() for body in rig.bodies} for _ in range(2))
    for station in layout.drawn_forces:
        spans_below[station.body].first_free_line(*layout.force_left_right_px(station))
    for body in filter(has_spring, rig.bodies):
        ground_px = _spring_x_px(layout, body)
        spans_below[body.name].first_free_line(ground_px - GROUND_HALF_WIDTH, ground_px + GROUND_HALF_WIDTH)
    contact_texts: list[tuple[Contact, DrawnText]] = []
    for contact in rig.contacts:
        lines, body = [contact.name, *contact_lines.get(contact.name, ())], layout.upper_body(contact)
        neighbours = [neighbour for neighbour in layout.contacts_of(body) if neighbour != contact]
        posts_px = [layout.contact_x_px(neighbour) + STOP_HALF_WIDTH for neighbour in neighbours]
        text = contact_text(layout.contact_x_px(contact), lines, spans_below[body.name], posts_px, width_px)
        contact_texts.append((contact, text))
    marks_and_texts = list(_mark_texts(layout, marks, spans_below, spans_above))
    places = [(mark.station.body, round(layout.x_px(mark.station)), mark.of_whole_body) for mark, _ in marks_and_texts]
    ringed_stations = [mark.station for mark, _ in marks_and_texts if not mark.of_whole_body]
    rings_px = {body.name: [layout.x_px(s) for s in ringed_stations if s.body == body.name] for body in rig.bodies}
    ringed = dict(zip(places[::-1], marks_and_texts[::-1], strict=True))  # the first mark of each place
    y_px = 0.0
    for body in reversed(rig.bodies):
        layout.tops_px[body.name] = y_px = y_px + ROW_GAP + LINE_HEIGHT * len(spans_above[body.name].spans_by_line)
        y_px += _height_px(body) + LINE_HEIGHT * len(spans_below[body.name].spans_by_line)
    notes = foot_notes(rig)
    height_px = y_px + FOOT_HEIGHT + LINE_HEIGHT * max(0, len(notes) - 1)
    svg_elements = [
        *(element for body in rig.bodies for element in _clamp_or_spring(layout, body)),
        *(element for contact, text in contact_texts for element in _contact(layout, contact, text)),
        *(element for contact, text in contact_texts for element in _contact_words(layout, contact, text)),
        *(element for body in rig.bodies for element in _body(layout, body, rings_px[body.name])),
        *_supports(layout),
        *_sensors(layout),
        *_forces(layout),
        *_foot_note_elements(notes, y_px + FOOT_HEIGHT - 6),
        *(element for mark, text in ringed.values() for element in _mark_ring(layout, mark, text)),
        *(element for mark, text in marks_and_texts for element in _mark_words(layout, mark, text)),
    ]
    return (
        f'<svg viewBox="0 0 {width_px:g} {height_px:g}" role="img" aria-label="Drawing of {escape(rig.name)}" '
        f'class="machine">{"".join(svg_elements)}</svg>'
    )


def _height_px(body: Body) -> float:
    return MASS_SIZE[1] if body.is_mass else BEAM_HEIGHT


def _clamp_or_spring(layout: _Layout, body: Body) -> Iterator[str]:
    """Wall of a clamped beam; spring of a mass, from its left side down to the ground."""
    x_px, middle_px = layout.x_px(Station(body.name)), layout.tops_px[body.name] + _height_px(body) / 2
    if body.clamped:
        yield _path_element("ink", f"M{x_px:g},{middle_px - 26:g}v52")
        yield _path_element("thin", "".join(f"M{x_px:g},{middle_px - 22 + 9 * k:g}l-10,9" for k in range(6)))
    if has_spring(body):
        spring_px, foot_px = _spring_x_px(layout, body), layout.bottom_px(body) + 16
        coil = "l-7,2.5" + "l14,5l-14,5" * 2 + "l7,2.5"
        yield _path_element("thin", f"M{spring_px + 26:g},{middle_px:g}h-26v7{coil}V{foot_px:g}")
        yield from _ground(spring_px, foot_px)


def has_spring(body: Body) -> bool:
    """True of a mass that a spring holds to the ground."""
    return body.is_mass and bool(body.frequencies_hz(1)[0] > 0)


def _spring_x_px(layout: _Layout, mass: Body) -> float:
    """Place along x of the spring of a mass."""
    return layout.x_px(Station(mass.name)) - MASS_SIZE[0] / 2 - 26


def _ground(x_px: float, y_px: float) -> Iterator[str]:
    """Hatched ground about x."""
    yield _path_element("ink", f"M{x_px - GROUND_HALF_WIDTH:g},{y_px:g}h{2 * GROUND_HALF_WIDTH:g}")
    yield _path_element("thin", "".join(f"M{x_px - 16 + 8 * k:g},{y_px:g}l-6,8" for k in range(5)))


def _body(layout: _Layout, body: Body, rings_px: Sequence[float]) -> Iterator[str]:
    """Block of a mass with its name; beam with its ruler, from a dot at its left end, and its name beside it."""
    x_px, top_px, height_px = layout.x_px(Station(body.name)), layout.tops_px[body.name], _height_px(body)
    width_px = MASS_SIZE[0] if body.is_mass else layout.px_per_m * body.length_m
    left_px = x_px - width_px / 2 if body.is_mass else x_px
    yield f'<rect class="body" x="{left_px:g}" y="{top_px:g}" width="{width_px:g}" height="{height_px:g}"/>'
    if body.is_mass:
        yield _text_element(x_px, top_px + height_px / 2 + 5, "middle", body.name, "name")
    else:
        for place_px, middle_px, text in ruler_numbers(body.length_m, left_px, width_px, rings_px):
            yield _path_element("thin", f"M{place_px:g},{top_px:g}v3M{place_px:g},{top_px + height_px:g}v-3")
            yield _text_element(middle_px, top_px + height_px - 6, "middle", text, "ruler")
        yield f'<circle class="origin" cx="{left_px:g}" cy="{top_px + height_px / 2:g}" r="3"/>'
        contacts_px = map(layout.contact_x_px, layout.contacts_of(body))
        end_px = max(left_px + width_px, *(x_px + STOP_HALF_WIDTH for x_px in contacts_px), 0.0)
        yield _text_element(end_px + 12, top_px + height_px - 4, "start", body.name, "name")


def _contact(layout: _Layout, contact: Contact, text: DrawnText) -> Iterator[str]:
    """Fork with its stops around the upper body, or a spring below it, from the lower body or the ground."""
    body = layout.upper_body(contact)
    left_px, post_px = layout.contact_x_px(contact) - STOP_HALF_WIDTH, layout.contact_x_px(contact) + STOP_HALF_WIDTH
    top_px, bottom_px = layout.tops_px[body.name], layout.bottom_px(body)
    carriers = [station.body for station in contact_stations(contact) if station.body != body.name]
    foot_px = bottom_px + ROW_GAP + LINE_HEIGHT * (text.first_line + len(text.lines) - 1)
    if carriers:
        foot_px = layout.tops_px[carriers[0]]
    css_class = "found" if len(text.lines) > 1 else "fork"
    if contact.law.has_stops:
        foot_path = f"V{foot_px:g}" + f"h{-STOP_HALF_WIDTH:g}" * bool(carriers)  # back to the carrier's station
        has_stop_above, has_stop_below = _stops_above_and_below(contact, body)
        stops_px = [top_px - STOP_DISTANCE] * has_stop_above + [bottom_px + STOP_DISTANCE] * has_stop_below
        stop_paths = [f"M{left_px:g},{y_px:g}h{2 * STOP_HALF_WIDTH:g}" for y_px in stops_px]
        yield _path_element(css_class, stop_paths[0] + foot_path)
        yield from (_path_element(css_class, stop_path) for stop_path in stop_paths[1:])
    else:
        step_px = (foot_px - bottom_px) / 8
        coil = f"l16,{step_px:g}l-16,{step_px:g}" * 2 + f"l16,{step_px:g}l-8,{step_px / 2:g}"
        yield _path_element(css_class, f"M{post_px:g},{bottom_px:g}v{step_px:g}l-8,{step_px / 2:g}{coil}V{foot_px:g}")
    if not carriers:
        yield from _ground(post_px, foot_px)


def _stops_above_and_below(contact: Contact, upper_body: Body) -> tuple[bool, bool]:
    """Presence of a stop above the upper body, and of one below it.

    The stop at the upper clearance is touched as `at` moves up from `against`: it is above `at`, or below `against`.
    """
    law = contact.law
    has_upper, has_lower = bool(np.isfinite(law.upper_clearance_m)), bool(np.isfinite(law.lower_clearance_m))
    return (has_upper, has_lower) if contact.at.body == upper_body.name else (has_lower, has_upper)


def _contact_words(layout: _Layout, contact: Contact, text: DrawnText) -> Iterator[str]:
    """Lines of text of a contact, above all posts."""
    for k, line in enumerate(text.lines):
        y_px = layout.bottom_px(layout.upper_body(contact)) + 30 + LINE_HEIGHT * (text.first_line + k)
        yield _text_element(text.x_px, y_px, text.anchor, line, "value" if k else "name")


def _supports(layout: _Layout) -> Iterator[str]:
    """Triangle below a body at every support, on hatched ground."""
    for support in layout.rig.supports:
        x_px, y_px = layout.x_px(support.station), layout.bottom_px(layout.rig.body(support.station.body))
        yield _path_element("support", f"M{x_px:g},{y_px:g}l-7,14h14z", f"support at {support.station.position_m:g} m")
        yield _path_element("thin", "".join(f"M{x_px - 8 + 6 * k:g},{y_px + 14:g}l-5,6" for k in range(4)))


def _sensors(layout: _Layout) -> Iterator[str]:
    """Triangle at every station with sensors; their names show under the pointer."""
    sensors = [sensor for sensor in layout.rig.sensors if sensor not in layout.rig.base_sensors]
    for station in dict.fromkeys(sensor.station for sensor in sensors):
        path_data = f"M{layout.x_px(station) - 5:g},{layout.tops_px[station.body] - 9:g}h10l-5,8z"
        names = ", ".join(sensor.name for sensor in sensors if sensor.station == station)
        yield _path_element("sensor", path_data, names)


def _forces(layout: _Layout) -> Iterator[str]:
    for station in layout.drawn_forces:
        x_px, y_px = layout.corner_x_px(station, -0.35), layout.bottom_px(layout.rig.body(station.body))
        yield _path_element("force", f"M{x_px:g},{y_px + 34:g}V{y_px + 5:g}m-5,9l5,-9l5,9")
        yield _text_element(x_px + 9, y_px + 33, "start", "F", "dim")


def _foot_note_elements(notes: Sequence[str], baseline_px: float) -> Iterator[str]:
    """Notes at the foot of the drawing, the first of them at this height."""
    for line, note in enumerate(notes):
        yield _text_element(LEFT_MARGIN, baseline_px + LINE_HEIGHT * line, "start", note, "dim")


def _baseline_px(layout: _Layout, mark: DrawnMark, text: DrawnText) -> float:
    """Baseline of the first line of a mark's words."""
    body = layout.rig.body(mark.station.body)
    if layout.is_marked_below(body):
        return layout.bottom_px(body) + 30 + LINE_HEIGHT * text.first_line
    return layout.tops_px[body.name] - 24 - LINE_HEIGHT * (text.first_line + len(text.lines) - 1)


def _mark_texts(
    layout: _Layout,
    marks: Sequence[DrawnMark],
    spans_below: Mapping[str, TextSpans],
    spans_above: Mapping[str, TextSpans],
) -> Iterator[tuple[DrawnMark, DrawnText]]:
    """Marks with their texts, body by body, from left to right."""
    for body in layout.rig.bodies:
        body_marks = sorted(
            (mark for mark in marks if mark.station.body == body.name), key=lambda mark: layout.x_px(mark.station)
        )
        spans = (spans_below if layout.is_marked_below(body) else spans_above)[body.name]
        words_at_x = [(layout.corner_x_px(mark.station, RING_SHARE), mark.words) for mark in body_marks]
        yield from zip(body_marks, mark_texts(words_at_x, spans, layout.width_px), strict=True)


def _mark_ring(layout: _Layout, mark: DrawnMark, text: DrawnText) -> Iterator[str]:
    """Ring about the station, or frame about the body, and a line to its words."""
    body = layout.rig.body(mark.station.body)
    height_px, top_px = _height_px(body), layout.tops_px[body.name]
    x_px, middle_px = layout.corner_x_px(mark.station, RING_SHARE), top_px + height_px / 2
    reach_px = height_px / 2 if mark.of_whole_body else RING_RADIUS
    words_px = _baseline_px(layout, mark, text) + LINE_HEIGHT * (len(text.lines) - 1) + 5
    ends_px = (middle_px - reach_px, words_px)
    if layout.is_marked_below(body):
        ends_px = (middle_px + reach_px, _baseline_px(layout, mark, text) - LINE_HEIGHT + 3)
    yield _path_element(mark.css_class, f"M{x_px:g},{ends_px[0]:g}V{ends_px[1]:g}")
    if mark.of_whole_body:
        left_px, width_px = layout.x_px(Station(body.name)), layout.px_per_m * body.length_m
        yield _path_element(mark.css_class, f"M{left_px:g},{top_px:g}h{width_px:g}v{height_px:g}h{-width_px:g}z")
    else:
        yield f'<circle class="{mark.css_class}" cx="{x_px:g}" cy="{middle_px:g}" r="{RING_RADIUS:g}"/>'


def _mark_words(layout: _Layout, mark: DrawnMark, text: DrawnText) -> Iterator[str]:
    for k, line in enumerate(text.lines):
        y_px = _baseline_px(layout, mark, text) + LINE_HEIGHT * k
        yield _text_element(text.x_px, y_px, text.anchor, line, "dim" if mark.is_hint else "mark-words")


def _path_element(css_class: str, path_data: str, tooltip: str = "") -> str:
    return f'<path class="{css_class}" d="{path_data}">{f"<title>{escape(tooltip)}</title>" if tooltip else ""}</path>'


def _text_element(x_px: float, y_px: float, anchor: str, text: str, css_class: str) -> str:
    return f'<text class="{css_class}" x="{x_px:g}" y="{y_px:g}" text-anchor="{anchor}">{escape(text)}</text>'
