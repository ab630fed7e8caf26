"""Schematic drawing of a rig: bodies, stations, contacts with clearances, forces, sensors and attachments."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from rig.model.contact_laws import stop_positions_m_and_sides
from rig.model.contact_laws.annular import Annular
from rig.model.description import Body, Contact, Rig, Station, contact_stations
from rig.model.layout import left_end_m_by_body
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

DrawShape = Callable[[float, float, float], None]
"""Drawing of a shape at x, from its top to its bottom, px."""


def draw(rig: Rig, path: Path) -> None:
    """Draw a rig as SVG, to scale along the bodies; clearances and thicknesses are not to scale.

    Items on a mass are drawn side by side. A rig in space is drawn from the side, and under that from below. Raises
    RigError if the file cannot be written.
    """
    drawing = Drawing()
    for direction, plane_rig in plane_rigs(rig).items():
        law_by_contact = {contact.name: contact.law for contact in rig.contacts}
        contacts = tuple(replace(contact, law=law_by_contact[contact.name]) for contact in plane_rig.contacts)
        force_numbers = [number for number, force in enumerate(rig.forces, start=1) if force.direction == direction]
        lowest_y_px = max((y for _, y in drawing.corners), default=TITLE_PX - VIEW_GAP_PX)
        layout = _schematic_layout(replace(plane_rig, contacts=contacts), lowest_y_px + VIEW_GAP_PX)
        drawing.text(0.0, layout.title_px, f"{rig.name}{VIEW_WORDS[direction] if rig.in_space else ''}", size=16)
        force_labels = [f"F{number}" if len(rig.forces) > 1 else "force F" for number in force_numbers]
        _draw_view(drawing, layout, force_labels)
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
        base, y_px = rig.base_motion, layout.level_px[rig.bodies[0].name] + ATTACHED_PX + 90
        words = f"base motion {base.acceleration_rms_m_per_s2:g} m/s\u00b2 rms, {base.low_hz:g} to {base.high_hz:g} Hz"
        drawing.text(0.0, y_px, words, FORCE_INK)


@dataclass(frozen=True)
class _SchematicLayout:
    """Positions of the bodies in pixels; a mass has a slot for each item on it."""

    rig: Rig
    left_px: dict[str, float]
    px_per_m: float
    level_px: dict[str, float]
    slot_items: dict[str, tuple[object, ...]]
    title_px: float

    def x_px(self, station: Station, drawn_item: object) -> float:
        left_px = self.left_px[station.body]
        items = self.slot_items.get(station.body)
        if items is None:
            return left_px + self.px_per_m * station.position_m
        return left_px + SLOT_PX * (next(slot for slot, slot_item in enumerate(items) if slot_item is drawn_item) + 0.5)

    def half_height_px(self, body: str) -> float:
        return MASS_HALF_PX if body in self.slot_items else BODY_HALF_PX

    def top_px(self, body: str) -> float:
        return self.level_px[body] - self.half_height_px(body)

    def bottom_px(self, body: str) -> float:
        return self.level_px[body] + self.half_height_px(body)


def _schematic_layout(rig: Rig, title_px: float) -> _SchematicLayout:
    left_ends_m = left_end_m_by_body(rig)
    extent_m = max(left_ends_m[body.name] + body.length_m for body in rig.bodies) - min(left_ends_m.values())
    px_per_m = DRAWING_PX / extent_m if extent_m > 0 else 1.0
    top_px = TITLE_PX - title_px - LEVEL_STEP_PX * (len(rig.bodies) - 1)
    level_px = {body.name: -LEVEL_STEP_PX * level_index - top_px for level_index, body in enumerate(rig.bodies)}
    slot_items = {body.name: tuple(_items_on_mass(rig, body)) for body in rig.bodies if body.is_mass}
    left_px = {name: px_per_m * (left_end_m - min(left_ends_m.values())) for name, left_end_m in left_ends_m.items()}
    return _SchematicLayout(rig, left_px, px_per_m, level_px, slot_items, title_px)


def _items_on_mass(rig: Rig, body: Body) -> Iterator[object]:
    """Items on a mass from left to right, beginning with its own spring."""
    yield body
    for contact in rig.contacts:
        if body.name in [station.body for station in contact_stations(contact)]:
            yield contact
    yield from (station for station in dict.fromkeys(rig.forces) if station.body == body.name)
    if any(sensor.station.body == body.name for sensor in rig.sensors):
        yield rig.sensors
    yield from (component for component in _attachments(rig) if component.station.body == body.name)


def _attachments(rig: Rig) -> tuple[Any, ...]:
    """Components at stations, in the order in which they are drawn on a mass."""
    return (*rig.masses, *rig.springs, *rig.supports, *rig.dampers, *rig.loads, *rig.tones)


def _draw_body(drawing: Drawing, layout: _SchematicLayout, body: Body) -> None:
    level_px, left_px = layout.level_px[body.name], layout.left_px[body.name]
    items = layout.slot_items.get(body.name)
    right_px = left_px + (layout.px_per_m * body.length_m if items is None else SLOT_PX * len(items))
    top_px, bottom_px = layout.top_px(body.name), layout.bottom_px(body.name)
    drawing.box(left_px, top_px, right_px, bottom_px, dashed=bool(len(body.positions_m)))
    for x_m in body.positions_m:
        drawing.dot(left_px + layout.px_per_m * float(x_m), level_px, GREY, 2.0)
    if body.clamped:
        drawing.wall(left_px, level_px, 30.0)
    if items is not None:
        drawing.text(left_px + 8, level_px + 4, f"{body.name}: {body.mass_kg:g} kg")
        spring_x_px = layout.x_px(Station(body.name), body)
        drawing.spring(spring_x_px - 12, bottom_px, bottom_px + ATTACHED_PX)
        drawing.damper(spring_x_px + 14, bottom_px, bottom_px + ATTACHED_PX)
        drawing.ground(spring_x_px, bottom_px + ATTACHED_PX, 60.0)
        (natural_hz,), (damping_ratio,) = body.frequencies_hz(1), body.damping_ratios(1)
        drawing.text(left_px, bottom_px + ATTACHED_PX + 24, f"{natural_hz:g} Hz, damping ratio {damping_ratio:g}")
        return
    beam = next((beam for beam in layout.rig.beams if beam == body), None)
    size_words = f", {1e3 * beam.width_m:g} mm wide, {1e3 * beam.thickness_m:g} mm thick" if beam else ""
    if beam and beam.outer_diameter_m:
        size_words = f", tube of {1e3 * beam.outer_diameter_m:g} and {1e3 * beam.inner_diameter_m:g} mm"
    drawing.text(left_px, top_px - 98, f"{body.name}: {body.kind}, {body.length_m:g} m{size_words}", size=13)
    _draw_ruler(drawing, layout, body)


def _draw_ruler(drawing: Drawing, layout: _SchematicLayout, body: Body) -> None:
    """Draw a ruler under a body with the positions of its ends, contacts, forces and attachments."""
    rig, left_px, y_px = layout.rig, layout.left_px[body.name], layout.bottom_px(body.name) + ATTACHED_PX + 34
    ruler_stations = [*rig.forces, *(station for contact in rig.contacts for station in contact_stations(contact))]
    ruler_stations += [component.station for component in _attachments(rig)]
    positions_m = {0.0, body.length_m, *(station.position_m for station in ruler_stations if station.body == body.name)}
    drawing.line((left_px, y_px), (left_px + layout.px_per_m * body.length_m, y_px), colour=GREY, width=1.0)
    last_label_px = -1e9
    for x_m in sorted(positions_m):
        x_px = left_px + layout.px_per_m * x_m
        drawing.line((x_px, y_px - 5), (x_px, y_px + 5), colour=GREY, width=1.0)
        is_lowered = x_px - last_label_px < 48  # beside the one before there is no room
        drawing.text(x_px, y_px + (30 if is_lowered else 18), f"{x_m:g} m", GREY, "middle", size=11)
        last_label_px = -1e9 if is_lowered else x_px


def _draw_stops(drawing: Drawing, layout: _SchematicLayout, contact: Contact) -> None:
    """Draw the two stops of a contact and their carrier, another body or the ground; or a spring between them."""
    x_px, body_name = layout.x_px(contact.at, contact), contact.at.body
    upper_stop_px, lower_stop_px = layout.top_px(body_name) - GAP_PX, layout.bottom_px(body_name) + GAP_PX
    if not contact.law.has_stops:
        _draw_connecting_spring(drawing, layout, contact)
        return
    drawn_sides = contact.law.sides or (-1, 1)
    for stop_y_px, side in ((upper_stop_px, 1), (lower_stop_px, -1)):
        if side not in drawn_sides:
            continue
        if contact.against is None:
            drawing.ground(x_px, stop_y_px, upwards=side > 0)
        else:
            drawing.line((x_px - 16, stop_y_px), (x_px + 16, stop_y_px), colour=BELIEVED_INK, width=3.0)
    if contact.against is not None:
        against = contact.against
        against_x_px = layout.x_px(against, contact)
        is_below = layout.level_px[against.body] > layout.level_px[body_name]
        carrier_y_px = layout.top_px(against.body) if is_below else layout.bottom_px(against.body)
        end_y_px = (upper_stop_px if is_below else lower_stop_px, carrier_y_px)
        middle_y_px = (layout.level_px[body_name] + layout.level_px[against.body]) / 2
        drawing.line(
            (x_px, end_y_px[0]),
            (x_px, middle_y_px),
            (against_x_px, middle_y_px),
            (against_x_px, end_y_px[1]),
            colour=BELIEVED_INK,
        )


def _draw_connecting_spring(drawing: Drawing, layout: _SchematicLayout, contact: Contact) -> None:
    """Draw a spring from a body to the one above or below it, or to the ground below."""
    x_px, body_name, against = layout.x_px(contact.at, contact), contact.at.body, contact.against
    if against is None:
        drawing.spring(x_px, layout.bottom_px(body_name), layout.bottom_px(body_name) + STRUT_PX)
        drawing.ground(x_px, layout.bottom_px(body_name) + STRUT_PX)
        return
    lower_body, higher_body = sorted((body_name, against.body), key=lambda body: -layout.level_px[body])
    against_x_px = layout.x_px(against, contact)
    drawing.spring(x_px, layout.bottom_px(higher_body), layout.top_px(lower_body))
    end_y_px = layout.top_px(lower_body) if lower_body == against.body else layout.bottom_px(higher_body)
    drawing.line((x_px, end_y_px), (against_x_px, end_y_px), colour=BELIEVED_INK)


def _draw_clearances(drawing: Drawing, layout: _SchematicLayout, contact: Contact) -> None:
    x_px, body_name, law = layout.x_px(contact.at, contact), contact.at.body, contact.law
    upper_stop_px, lower_stop_px = layout.top_px(body_name) - GAP_PX, layout.bottom_px(body_name) + GAP_PX
    for wall_m, side in stop_positions_m_and_sides(law) if law.has_stops else ():
        sign, text_y_px = ("+", upper_stop_px) if side > 0 else ("\u2212", lower_stop_px)
        drawing.text(x_px + 20, text_y_px + 4, f"{sign}{1e3 * abs(wall_m):g} mm", BELIEVED_INK, size=11)
    body_names = [station.body for station in contact_stations(contact)]
    lowest_body = body_name if law.has_stops else min(body_names, key=lambda body: layout.level_px[body])
    text_x_px, text_y_px = x_px + (8 if law.has_stops else 14), layout.bottom_px(lowest_body) + GAP_PX + 22
    for label_line in (contact.name, f"{law.stiffness_n_per_m:g} N/m", *_contact_notes(contact)):
        drawing.text(text_x_px, text_y_px, label_line, BELIEVED_INK, size=11)
        text_y_px += 14


def _contact_notes(contact: Contact) -> Iterator[str]:
    if contact.law.damping_n_s_per_m:
        yield f"{contact.law.damping_n_s_per_m:g} N s/m"
    law_tag = str(contact.law.__struct_config__.tag)
    if law_tag != "dead_zone":
        yield law_tag
    if isinstance(contact.law, Annular) and contact.law.friction_coefficient:
        yield f"friction {contact.law.friction_coefficient:g}"


def _draw_forces(drawing: Drawing, layout: _SchematicLayout, force_names: Sequence[str]) -> None:
    names_by_station = dict[Station, list[str]]()
    for station, force_name in zip(layout.rig.forces, force_names, strict=False):
        names_by_station.setdefault(station, []).append(force_name)
    for station in (s for s in names_by_station if not layout.rig.is_on_ground(s)):
        x_px, top_px = layout.x_px(station, station), layout.top_px(station.body)
        drawing.arrow((x_px, top_px - 1), (x_px, top_px - 80), FORCE_INK, 3.0)
        drawing.text(x_px + 10, top_px - 70, ", ".join(names_by_station[station]), FORCE_INK)


def _draw_sensors(drawing: Drawing, layout: _SchematicLayout) -> None:
    """Draw a mark at every station, with the letters of its quantities and its position."""
    letters_by_station: dict[Station, list[str]] = {}
    for sensor in layout.rig.sensors:
        letters_by_station.setdefault(sensor.station, []).append(LETTERS.get(sensor.quantity, sensor.quantity))
    for station, letters in letters_by_station.items():
        if layout.rig.is_on_ground(station):
            continue
        x_px, top_px = layout.x_px(station, layout.rig.sensors), layout.top_px(station.body)
        mark_corners = (x_px - 5, top_px - 9), (x_px + 5, top_px - 9), (x_px, top_px - 1)
        drawing.line(*mark_corners, colour=SENSOR_INK, fill=SENSOR_INK)
        sensor_words = ", ".join(dict.fromkeys(letters))
        if station.body not in layout.slot_items:
            sensor_words += f"  {place_name(layout.rig.body(station.body), station.position_m)}"
        drawing.text(x_px + 4, top_px - GAP_PX - 10, sensor_words, SENSOR_INK, rotation_deg=-60, size=11)
    if letters_by_station:
        quantities = dict.fromkeys(sensor.quantity for sensor in layout.rig.sensors)
        key_words = ", ".join(f"{LETTERS.get(quantity, quantity)} {quantity}" for quantity in quantities)
        if base_sensors := layout.rig.base_sensors:
            key_words += "; on the ground: " + ", ".join(LETTERS.get(s.quantity, s.quantity) for s in base_sensors)
        drawing.text(0.0, layout.title_px + 20, f"sensors: {key_words}", SENSOR_INK)


def _draw_attachments(drawing: Drawing, layout: _SchematicLayout) -> None:
    rig = layout.rig
    for mass in rig.masses:
        x_px, top_px = layout.x_px(mass.station, mass), layout.top_px(mass.station.body)
        drawing.box(x_px - 9, top_px - 18, x_px + 9, top_px, fill=INK)
        drawing.text(x_px - 12, top_px - 6, f"{mass.mass_kg:g} kg", anchor="end", size=11)
    for spring in rig.springs:
        cubic, rotational = (spring.cubic_n_per_m3, "N/m\u00b3"), (spring.rotational_n_m_per_rad, "N m/rad")
        values_and_units = [(spring.stiffness_n_per_m, "N/m"), cubic, rotational]
        _draw_grounded(drawing, layout, spring, drawing.spring, values_and_units)
    for support in rig.supports:
        _draw_grounded(drawing, layout, support, drawing.pin, [(support.stiffness_n_per_m or 0.0, "N/m")])
    for damper in rig.dampers:
        values_and_units = [(damper.damping_n_s_per_m, "N s/m"), (damper.friction_n, "N friction")]
        _draw_grounded(drawing, layout, damper, drawing.damper, values_and_units)
    for clamp in rig.clamps:
        x_px, y_px = layout.left_px[clamp.body], layout.level_px[clamp.body]
        drawing.dot(x_px, y_px, BELIEVED_INK, 6.0)
        drawing.text(x_px - 12, y_px + 46, f"{clamp.rotational_n_m_per_rad:g} N m/rad", size=11)
    for load in rig.loads:
        x_px, top_px = layout.x_px(load.station, load), layout.top_px(load.station.body)
        arrow_ends = ((x_px, top_px - 1), (x_px, top_px - 40))
        drawing.arrow(*(arrow_ends if load.force_n >= 0 else arrow_ends[::-1]))
        drawing.text(x_px + 6, top_px - 30, f"{abs(load.force_n):g} N", size=11)
    for tone in rig.tones:
        x_px, top_px = layout.x_px(tone.station, tone), layout.top_px(tone.station.body)
        drawing.arrow((x_px, top_px - 1), (x_px, top_px - 40), FORCE_INK, 1.5)
        drawing.text(x_px + 6, top_px - 30, f"tone {tone.frequency_hz:g} Hz", FORCE_INK, size=11)


def _draw_grounded(
    drawing: Drawing, layout: _SchematicLayout, component: Any, draw_shape: DrawShape, values: list[tuple[float, str]]
) -> None:
    """Draw a spring, support or damper under a body, with its non-zero values."""
    x_px, bottom_px = layout.x_px(component.station, component), layout.bottom_px(component.station.body)
    draw_shape(x_px, bottom_px, bottom_px + ATTACHED_PX)
    drawing.ground(x_px, bottom_px + ATTACHED_PX)
    for line_number, value_words in enumerate(f"{value:g} {unit}" for value, unit in values if value):
        drawing.text(x_px + 12, bottom_px + ATTACHED_PX - 8 - 14 * line_number, value_words, size=11)
