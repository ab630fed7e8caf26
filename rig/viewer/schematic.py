"""Schematic drawing of a rig: bodies, stations, contacts with clearances, forces, sensors and attachments."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from msgspec.structs import replace

from rig.model.contact_laws import walls_m
from rig.model.contact_laws.annular import Annular
from rig.model.description import Body, Contact, Rig, Station, contact_stations
from rig.model.layout import left_ends
from rig.model.nodes import place_name
from rig.model.space import plane_rigs
from rig.viewer.palette import BELIEVED_INK, FORCE_INK, INK, SENSOR_INK
from rig.viewer.svg import GREY, Drawing

DRAWING_PX, LEVEL_STEP_PX, BODY_HALF_PX, GAP_PX, ATTACHED_PX, STRUT_PX = 800.0, 300.0, 7.0, 12.0, 62.0, 70.0
TITLE_PX = -180.0
VIEW_GAP_PX = 70.0
VIEW_WORDS = {"y": ", seen from the side, y up", "z": ", seen from below, z up"}
SLOT_PX, MASS_HALF_PX = 95.0, 34.0
LETTERS = {"acceleration": "a", "velocity": "v", "displacement": "x", "strain": "\u03b5"}


def draw(rig: Rig, path: Path) -> None:
    """Draw a rig as SVG, to scale along the bodies; clearances and thicknesses are not to scale.

    Items on a mass are drawn side by side. A rig in space is drawn from the side, and from above below that. Raises
    RigError if the file cannot be written.
    """
    drawing = Drawing()
    for direction, plane in plane_rigs(rig).items():
        laws = {contact.name: contact.law for contact in rig.contacts}
        contacts = tuple(replace(contact, law=laws[contact.name]) for contact in plane.contacts)
        numbers = [k for k, station in enumerate(rig.forces, start=1) if station.direction == direction]
        lowest_px = max((y for _, y in drawing.corners), default=TITLE_PX - VIEW_GAP_PX)
        layout = _layout(replace(plane, contacts=contacts), lowest_px + VIEW_GAP_PX)
        drawing.text(0.0, layout.title_px, f"{rig.name}{VIEW_WORDS[direction] if rig.in_space else ''}", size=16)
        _draw_view(drawing, layout, [f"F{k}" if len(rig.forces) > 1 else "force F" for k in numbers])
    drawing.write(path)


def _draw_view(drawing: Drawing, layout: "_SchematicLayout", force_names: Sequence[str]) -> None:
    """Draw a plane rig; of a direction without forces no name is given."""
    rig = layout.rig
    for contact in rig.contacts:
        _draw_stops(drawing, layout, contact)
    for body in rig.bodies:
        _draw_body(drawing, layout, body)
    for contact in rig.contacts:
        _draw_clearances(drawing, layout, contact)
    _draw_forces(drawing, layout, force_names)
    _draw_sensors(drawing, layout)
    _draw_attachments(drawing, layout)
    if rig.gravity_m_per_s2:
        drawing.text(0.0, layout.title_px + 38, f"gravity {rig.gravity_m_per_s2:g} m/s\u00b2 downwards", GREY)
    if rig.base_motion:
        base = rig.base_motion
        words = f"base motion {base.acceleration_rms_m_per_s2:g} m/s\u00b2 rms, {base.low_hz:g} to {base.high_hz:g} Hz"
        drawing.text(0.0, layout.level_px[rig.bodies[0].name] + ATTACHED_PX + 90, words, FORCE_INK)


@dataclass(frozen=True)
class _SchematicLayout:
    """Positions of the bodies in pixels; a mass has a slot for each item on it."""

    rig: Rig
    left_px: dict[str, float]
    px_per_m: float
    level_px: dict[str, float]
    slot_items: dict[str, tuple[object, ...]]
    title_px: float

    def x_px(self, station: Station, item: object) -> float:
        left_px = self.left_px[station.body]
        items = self.slot_items.get(station.body)
        if items is None:
            return left_px + self.px_per_m * station.position_m
        return left_px + SLOT_PX * (next(slot for slot, other_body in enumerate(items) if other_body is item) + 0.5)

    def half_px(self, body: str) -> float:
        return MASS_HALF_PX if body in self.slot_items else BODY_HALF_PX

    def top_px(self, body: str) -> float:
        return self.level_px[body] - self.half_px(body)

    def bottom_px(self, body: str) -> float:
        return self.level_px[body] + self.half_px(body)


def _layout(rig: Rig, title_px: float) -> _SchematicLayout:
    left_ends_m = left_ends(rig)
    extent_m = max(left_ends_m[body.name] + body.length_m for body in rig.bodies) - min(left_ends_m.values())
    px_per_m = DRAWING_PX / extent_m if extent_m > 0 else 1.0
    top_px = TITLE_PX - title_px - LEVEL_STEP_PX * (len(rig.bodies) - 1)
    level_px = {body.name: -LEVEL_STEP_PX * level_index - top_px for level_index, body in enumerate(rig.bodies)}
    slot_items = {body.name: tuple(_items_on(rig, body)) for body in rig.bodies if body.is_mass}
    left_px = {name: px_per_m * (left_m - min(left_ends_m.values())) for name, left_m in left_ends_m.items()}
    return _SchematicLayout(rig, left_px, px_per_m, level_px, slot_items, title_px)


def _items_on(rig: Rig, body: Body) -> Iterator[object]:
    """Items on a mass from left to right, beginning with its own spring."""
    yield body
    yield from (c for c in rig.contacts if body.name in (c.at.body, c.against.body if c.against else ""))
    yield from (station for station in dict.fromkeys(rig.forces) if station.body == body.name)
    if any(sensor.station.body == body.name for sensor in rig.sensors):
        yield rig.sensors
    for attached in (rig.masses, rig.springs, rig.supports, rig.dampers, rig.loads, rig.tones):
        yield from (item for item in attached if item.station.body == body.name)


def _draw_body(drawing: Drawing, layout: _SchematicLayout, body: Body) -> None:
    level, left_px = layout.level_px[body.name], layout.left_px[body.name]
    items = layout.slot_items.get(body.name)
    width = layout.px_per_m * body.length_m if items is None else SLOT_PX * len(items)
    drawing.box(
        left_px,
        layout.top_px(body.name),
        left_px + width,
        layout.bottom_px(body.name),
        dashed=bool(len(body.positions_m)),
    )
    for x_m in body.positions_m:
        drawing.dot(left_px + layout.px_per_m * float(x_m), level, GREY, 2.0)
    if body.clamped:
        drawing.wall(left_px, level, 30.0)
    if items is not None:
        drawing.text(left_px + 8, level + 4, f"{body.name}: {body.mass_kg:g} kg")
        x, bottom = layout.x_px(Station(body.name), body), layout.bottom_px(body.name)
        drawing.spring(x - 12, bottom, bottom + ATTACHED_PX)
        drawing.damper(x + 14, bottom, bottom + ATTACHED_PX)
        drawing.ground(x, bottom + ATTACHED_PX, 60.0)
        (hz,), (ratio,) = body.frequencies_hz(1), body.damping_ratios(1)
        drawing.text(left_px, bottom + ATTACHED_PX + 24, f"{hz:g} Hz, damping ratio {ratio:g}")
        return
    beam = next((beam for beam in layout.rig.beams if beam == body), None)
    size = f", {1e3 * beam.width_m:g} mm wide, {1e3 * beam.thickness_m:g} mm thick" if beam else ""
    if beam and beam.outer_diameter_m:
        size = f", tube of {1e3 * beam.outer_diameter_m:g} and {1e3 * beam.inner_diameter_m:g} mm"
    drawing.text(
        left_px, layout.top_px(body.name) - 98, f"{body.name}: {body.kind}, {body.length_m:g} m{size}", size=13
    )
    _draw_ruler(drawing, layout, body)


def _draw_ruler(drawing: Drawing, layout: _SchematicLayout, body: Body) -> None:
    """Draw a ruler under a body with the positions of its ends, contacts, forces and attachments."""
    rig, left_px, y = layout.rig, layout.left_px[body.name], layout.bottom_px(body.name) + ATTACHED_PX + 34
    stations = [*rig.forces, *(s for contact in rig.contacts for s in (contact.at, contact.against) if s is not None)]
    stations += [
        item.station
        for position_group in (rig.masses, rig.springs, rig.supports, rig.dampers, rig.loads, rig.tones)
        for item in position_group
    ]
    places = sorted({0.0, body.length_m, *(station.position_m for station in stations if station.body == body.name)})
    drawing.line((left_px, y), (left_px + layout.px_per_m * body.length_m, y), colour=GREY, width=1.0)
    labelled_x = -1e9
    for x_m in places:
        x = left_px + layout.px_per_m * x_m
        drawing.line((x, y - 5), (x, y + 5), colour=GREY, width=1.0)
        is_low = x - labelled_x < 48  # beside the one before there is no room
        drawing.text(x, y + (30 if is_low else 18), f"{x_m:g} m", GREY, "middle", size=11)
        labelled_x = -1e9 if is_low else x


def _draw_stops(drawing: Drawing, layout: _SchematicLayout, contact: Contact) -> None:
    """Draw the two stops of a contact and their carrier, another body or the ground; or a spring between them."""
    x, name = layout.x_px(contact.at, contact), contact.at.body
    upper, lower = layout.top_px(name) - GAP_PX, layout.bottom_px(name) + GAP_PX
    if not contact.law.has_stops:
        _strut(drawing, layout, contact)
        return
    sides = contact.law.sides or (-1, 1)
    for y, side in ((upper, 1), (lower, -1)):
        if side not in sides:
            continue
        if contact.against is None:
            drawing.ground(x, y, upwards=side > 0)
        else:
            drawing.line((x - 16, y), (x + 16, y), colour=BELIEVED_INK, width=3.0)
    if contact.against is not None:
        against = contact.against
        against_x = layout.x_px(against, contact)
        is_below = layout.level_px[against.body] > layout.level_px[name]
        other_px = layout.top_px(against.body) if is_below else layout.bottom_px(against.body)
        end_levels = (upper if is_below else lower, other_px)
        middle = (layout.level_px[name] + layout.level_px[against.body]) / 2
        drawing.line(
            (x, end_levels[0]), (x, middle), (against_x, middle), (against_x, end_levels[1]), colour=BELIEVED_INK
        )


def _strut(drawing: Drawing, layout: _SchematicLayout, contact: Contact) -> None:
    """Draw a spring from a body to the one above or below it, or to the ground below."""
    x, name, against = layout.x_px(contact.at, contact), contact.at.body, contact.against
    if against is None:
        drawing.spring(x, layout.bottom_px(name), layout.bottom_px(name) + STRUT_PX)
        drawing.ground(x, layout.bottom_px(name) + STRUT_PX)
        return
    lower, higher = sorted((name, against.body), key=lambda body: -layout.level_px[body])
    far_x = layout.x_px(against, contact)
    drawing.spring(x, layout.bottom_px(higher), layout.top_px(lower))
    end_y = layout.top_px(lower) if lower == against.body else layout.bottom_px(higher)
    drawing.line((x, end_y), (far_x, end_y), colour=BELIEVED_INK)


def _draw_clearances(drawing: Drawing, layout: _SchematicLayout, contact: Contact) -> None:
    x, name, law = layout.x_px(contact.at, contact), contact.at.body, contact.law
    upper, lower = layout.top_px(name) - GAP_PX, layout.bottom_px(name) + GAP_PX
    for wall_m, side in walls_m(law) if law.has_stops else ():
        sign, y = ("+", upper) if side > 0 else ("\u2212", lower)
        drawing.text(x + 20, y + 4, f"{sign}{1e3 * abs(wall_m):g} mm", BELIEVED_INK, size=11)
    bodies = [station.body for station in contact_stations(contact)]
    below = name if law.has_stops else min(bodies, key=lambda body: layout.level_px[body])
    text_x, y = x + (8 if law.has_stops else 14), layout.bottom_px(below) + GAP_PX + 22
    for words in (contact.name, f"{law.stiffness_n_per_m:g} N/m", *_contact_notes(contact)):
        drawing.text(text_x, y, words, BELIEVED_INK, size=11)
        y += 14


def _contact_notes(contact: Contact) -> Iterator[str]:
    if contact.law.damping_n_s_per_m:
        yield f"{contact.law.damping_n_s_per_m:g} N s/m"
    kind = str(contact.law.__struct_config__.tag)
    if kind != "dead_zone":
        yield kind
    if isinstance(contact.law, Annular) and contact.law.friction_coefficient:
        yield f"friction {contact.law.friction_coefficient:g}"


def _draw_forces(drawing: Drawing, layout: _SchematicLayout, force_names: Sequence[str]) -> None:
    names = dict[Station, list[str]]()
    for station, name in zip(layout.rig.forces, force_names, strict=False):
        names.setdefault(station, []).append(name)
    for station in (s for s in names if not layout.rig.is_on_ground(s)):
        x, top = layout.x_px(station, station), layout.top_px(station.body)
        drawing.arrow((x, top - 1), (x, top - 80), FORCE_INK, 3.0)
        drawing.text(x + 10, top - 70, ", ".join(names[station]), FORCE_INK)


def _draw_sensors(drawing: Drawing, layout: _SchematicLayout) -> None:
    """Draw a mark at every station, with the letters of its quantities and its position."""
    quantities: dict[Station, list[str]] = {}
    for sensor in layout.rig.sensors:
        quantities.setdefault(sensor.station, []).append(LETTERS.get(sensor.quantity, sensor.quantity))
    for station, letters in quantities.items():
        if layout.rig.is_on_ground(station):
            continue
        x, top = layout.x_px(station, layout.rig.sensors), layout.top_px(station.body)
        drawing.line((x - 5, top - 9), (x + 5, top - 9), (x, top - 1), colour=SENSOR_INK, fill=SENSOR_INK)
        place = (
            ""
            if station.body in layout.slot_items
            else f"  {place_name(layout.rig.body(station.body), station.position_m)}"
        )
        drawing.text(
            x + 4, top - GAP_PX - 10, ", ".join(dict.fromkeys(letters)) + place, SENSOR_INK, turned=-60, size=11
        )
    if quantities:
        used = dict.fromkeys(sensor.quantity for sensor in layout.rig.sensors)
        key = ", ".join(f"{LETTERS.get(q, q)} {q}" for q in used)
        if layout.rig.base_sensors:
            key += "; on the ground: " + ", ".join(LETTERS.get(s.quantity, s.quantity) for s in layout.rig.base_sensors)
        drawing.text(0.0, layout.title_px + 20, f"sensors: {key}", SENSOR_INK)


def _draw_attachments(drawing: Drawing, layout: _SchematicLayout) -> None:
    rig = layout.rig
    for mass in rig.masses:
        x, top = layout.x_px(mass.station, mass), layout.top_px(mass.station.body)
        drawing.box(x - 9, top - 18, x + 9, top, fill=INK)
        drawing.text(x - 12, top - 6, f"{mass.mass_kg:g} kg", anchor="end", size=11)
    for spring in rig.springs:
        cubic, turning = (spring.cubic_n_per_m3, "N/m\u00b3"), (spring.rotational_n_m_per_rad, "N m/rad")
        values = [(spring.stiffness_n_per_m, "N/m"), cubic, turning]
        _grounded(drawing, layout, spring.station, spring, drawing.spring, values)
    for support in rig.supports:
        values = [(support.stiffness_n_per_m or 0.0, "N/m")]
        _grounded(drawing, layout, support.station, support, drawing.pin, values)
    for damper in rig.dampers:
        values = [(damper.damping_n_s_per_m, "N s/m"), (damper.friction_n, "N friction")]
        _grounded(drawing, layout, damper.station, damper, drawing.damper, values)
    for clamp in rig.clamps:
        x, y = layout.left_px[clamp.body], layout.level_px[clamp.body]
        drawing.dot(x, y, BELIEVED_INK, 6.0)
        drawing.text(x - 12, y + 46, f"{clamp.rotational_n_m_per_rad:g} N m/rad", size=11)
    for load in rig.loads:
        x, top = layout.x_px(load.station, load), layout.top_px(load.station.body)
        arrow_ends = ((x, top - 1), (x, top - 40))
        drawing.arrow(*(arrow_ends if load.force_n >= 0 else arrow_ends[::-1]))
        drawing.text(x + 6, top - 30, f"{abs(load.force_n):g} N", size=11)
    for tone in rig.tones:
        x, top = layout.x_px(tone.station, tone), layout.top_px(tone.station.body)
        drawing.arrow((x, top - 1), (x, top - 40), FORCE_INK, 1.5)
        drawing.text(x + 6, top - 30, f"tone {tone.frequency_hz:g} Hz", FORCE_INK, size=11)


def _grounded(
    drawing: Drawing,
    layout: _SchematicLayout,
    station: Station,
    item: object,
    shape: Callable[[float, float, float], None],
    values: list[tuple[float, str]],
) -> None:
    """Draw a spring, support or damper under a body, with its non-zero values."""
    x, bottom = layout.x_px(station, item), layout.bottom_px(station.body)
    shape(x, bottom, bottom + ATTACHED_PX)
    drawing.ground(x, bottom + ATTACHED_PX)
    for k, words in enumerate(f"{value:g} {unit}" for value, unit in values if value):
        drawing.text(x + 12, bottom + ATTACHED_PX - 8 - 14 * k, words, size=11)
