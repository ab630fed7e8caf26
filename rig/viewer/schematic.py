"""Schematic drawing of a rig: bodies, stations, contacts with clearances, forces, sensors and attachments."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.model.contact_laws import walls_m
from rig.model.description import Body, Contact, Rig, Station, contact_stations
from rig.model.layout import left_ends
from rig.model.nodes import place_name
from rig.viewer.palette import BELIEVED_INK, FORCE_INK, INK, SENSOR_INK
from rig.viewer.svg import GREY, Drawing

DRAWING_PX, LEVEL_STEP_PX, BODY_HALF_PX, GAP_PX, ATTACHED_PX, STRUT_PX = 800.0, 300.0, 7.0, 12.0, 62.0, 70.0
TITLE_PX = -180.0
SLOT_PX, MASS_HALF_PX = 95.0, 34.0
LETTERS = {"acceleration": "a", "velocity": "v", "displacement": "x", "strain": "\u03b5"}


def draw(rig: Rig, path: Path) -> None:
    """Draw a rig as SVG, to scale along the bodies; clearances and thicknesses are not to scale.

    Items on a mass are drawn side by side. Raises RigError if the file cannot be written.
    """
    drawing = Drawing()
    layout = _layout(rig)
    drawing.text(0.0, TITLE_PX, rig.name, size=16)
    for contact in rig.contacts:
        _draw_stops(drawing, layout, contact)
    for body in rig.bodies:
        _draw_body(drawing, layout, body)
    for contact in rig.contacts:
        _draw_clearances(drawing, layout, contact)
    _draw_forces(drawing, layout)
    _draw_sensors(drawing, layout)
    _draw_attachments(drawing, layout)
    if rig.base_motion:
        base = rig.base_motion
        text = f"base motion {base.acceleration_rms_m_per_s2:g} m/s\u00b2 rms, {base.low_hz:g} to {base.high_hz:g} Hz"
        drawing.text(0.0, layout.level_px[rig.bodies[0].name] + ATTACHED_PX + 90, text, FORCE_INK)
    drawing.write(path)


@dataclass(frozen=True)
class _Layout:
    """Positions of the bodies in pixels; a mass has a slot for each item on it."""

    rig: Rig
    left_px: dict[str, float]
    px_per_m: float
    level_px: dict[str, float]
    slot_items: dict[str, tuple[object, ...]]

    def x_px(self, station: Station, item: object) -> float:
        start_px = self.left_px[station.body]
        items = self.slot_items.get(station.body)
        if items is None:
            return start_px + self.px_per_m * station.position_m
        return start_px + SLOT_PX * (next(slot for slot, slot_item in enumerate(items) if slot_item is item) + 0.5)

    def half_px(self, body: str) -> float:
        return MASS_HALF_PX if body in self.slot_items else BODY_HALF_PX

    def top_px(self, body: str) -> float:
        return self.level_px[body] - self.half_px(body)

    def bottom_px(self, body: str) -> float:
        return self.level_px[body] + self.half_px(body)


def _layout(rig: Rig) -> _Layout:
    lefts_m = left_ends(rig)
    right_m = max(lefts_m[b.name] + b.length_m for b in rig.bodies)
    extent_m = right_m - min(lefts_m.values())
    px_per_m = DRAWING_PX / extent_m if extent_m > 0 else 1.0
    level_px = {body.name: -LEVEL_STEP_PX * k for k, body in enumerate(rig.bodies)}
    top_px = min(level_px.values())
    slot_items = {body.name: tuple(_items_on(rig, body)) for body in rig.bodies if body.is_mass}
    left_px = {name: px_per_m * (left_m - min(lefts_m.values())) for name, left_m in lefts_m.items()}
    return _Layout(rig, left_px, px_per_m, {name: y_px - top_px for name, y_px in level_px.items()}, slot_items)


def _items_on(rig: Rig, body: Body) -> Iterator[object]:
    """Items on a mass from left to right, beginning with its own spring."""
    yield body
    yield from (c for c in rig.contacts if body.name in (c.at.body, c.against.body if c.against else ""))
    yield from (station for station in dict.fromkeys(rig.forces) if station.body == body.name)
    if any(s.station.body == body.name for s in rig.sensors):
        yield rig.sensors
    yield from (item for item in _attachments(rig) if item.station.body == body.name)


def _attachments(rig: Rig) -> tuple[Any, ...]:
    """Point masses, springs, supports, dampers, loads and tones, each with a station."""
    return (*rig.masses, *rig.springs, *rig.supports, *rig.dampers, *rig.loads, *rig.tones)


def _draw_body(drawing: Drawing, layout: _Layout, body: Body) -> None:
    y, left_px = layout.level_px[body.name], layout.left_px[body.name]
    items = layout.slot_items.get(body.name)
    width_px = layout.px_per_m * body.length_m if items is None else SLOT_PX * len(items)
    top, bottom = layout.top_px(body.name), layout.bottom_px(body.name)
    drawing.box(left_px, top, left_px + width_px, bottom, dashed=bool(len(body.positions_m)))
    for x_m in body.positions_m:
        drawing.dot(left_px + layout.px_per_m * float(x_m), y, GREY, 2.0)
    if body.clamped:
        drawing.wall(left_px, y, 30.0)
    if items is not None:
        drawing.text(left_px + 8, y + 4, f"{body.name}: {body.mass_kg:g} kg")
        x = layout.x_px(Station(body.name), body)
        drawing.spring(x - 12, bottom, bottom + ATTACHED_PX)
        drawing.damper(x + 14, bottom, bottom + ATTACHED_PX)
        drawing.ground(x, bottom + ATTACHED_PX, 60.0)
        (natural_hz,), (ratio,) = body.frequencies_hz(1), body.damping_ratios(1)
        drawing.text(left_px, bottom + ATTACHED_PX + 24, f"{natural_hz:g} Hz, damping ratio {ratio:g}")
        return
    beam = next((b for b in layout.rig.beams if b == body), None)
    section = f", {1e3 * beam.width_m:g} mm wide, {1e3 * beam.thickness_m:g} mm thick" if beam else ""
    drawing.text(left_px, top - 98, f"{body.name}: {body.kind}, {body.length_m:g} m{section}", size=13)
    _draw_ruler(drawing, layout, body)


def _draw_ruler(drawing: Drawing, layout: _Layout, body: Body) -> None:
    """Draw a ruler under a body with the positions of its ends, contacts, forces and attachments."""
    rig, left_px, y = layout.rig, layout.left_px[body.name], layout.bottom_px(body.name) + ATTACHED_PX + 34
    stations = [*rig.forces, *(s for c in rig.contacts for s in (c.at, c.against) if s is not None)]
    stations += [item.station for item in _attachments(rig)]
    positions_m = sorted({0.0, body.length_m, *(s.position_m for s in stations if s.body == body.name)})
    drawing.line((left_px, y), (left_px + layout.px_per_m * body.length_m, y), colour=GREY, width=1.0)
    labelled_x = -1e9
    for x_m in positions_m:
        x = left_px + layout.px_per_m * x_m
        drawing.line((x, y - 5), (x, y + 5), colour=GREY, width=1.0)
        is_lowered = x - labelled_x < 48  # beside the one before there is no room
        drawing.text(x, y + (30 if is_lowered else 18), f"{x_m:g} m", GREY, "middle", size=11)
        labelled_x = -1e9 if is_lowered else x


def _draw_stops(drawing: Drawing, layout: _Layout, contact: Contact) -> None:
    """Draw the two stops of a contact and their carrier, another body or the ground; or a spring between them."""
    x, name = layout.x_px(contact.at, contact), contact.at.body
    upper_y, lower_y = layout.top_px(name) - GAP_PX, layout.bottom_px(name) + GAP_PX
    if not contact.law.has_stops:
        _draw_spring(drawing, layout, contact)
        return
    sides = contact.law.sides or (-1, 1)
    for y, side in ((upper_y, 1), (lower_y, -1)):
        if side not in sides:
            continue
        if contact.against is None:
            drawing.ground(x, y, upwards=side > 0)
        else:
            drawing.line((x - 16, y), (x + 16, y), colour=BELIEVED_INK, width=3.0)
    if contact.against is not None:
        partner = contact.against
        partner_x = layout.x_px(partner, contact)
        end_y = (upper_y, layout.top_px(partner.body)) if layout.level_px[partner.body] > layout.level_px[name] else (
            lower_y, layout.bottom_px(partner.body)
        )  # fmt: skip
        middle_y = (layout.level_px[name] + layout.level_px[partner.body]) / 2
        drawing.line((x, end_y[0]), (x, middle_y), (partner_x, middle_y), (partner_x, end_y[1]), colour=BELIEVED_INK)


def _draw_spring(drawing: Drawing, layout: _Layout, contact: Contact) -> None:
    """Draw a spring from a body to the one above or below it, or to the ground below."""
    x, name, partner = layout.x_px(contact.at, contact), contact.at.body, contact.against
    if partner is None:
        drawing.spring(x, layout.bottom_px(name), layout.bottom_px(name) + STRUT_PX)
        drawing.ground(x, layout.bottom_px(name) + STRUT_PX)
        return
    lower_body, upper_body = sorted((name, partner.body), key=lambda body: -layout.level_px[body])
    partner_x = layout.x_px(partner, contact)
    drawing.spring(x, layout.bottom_px(upper_body), layout.top_px(lower_body))
    end_y = layout.top_px(lower_body) if lower_body == partner.body else layout.bottom_px(upper_body)
    drawing.line((x, end_y), (partner_x, end_y), colour=BELIEVED_INK)


def _draw_clearances(drawing: Drawing, layout: _Layout, contact: Contact) -> None:
    x, name, law = layout.x_px(contact.at, contact), contact.at.body, contact.law
    upper_y, lower_y = layout.top_px(name) - GAP_PX, layout.bottom_px(name) + GAP_PX
    for wall_m, side in walls_m(law) if law.has_stops else ():
        sign, y = ("+", upper_y) if side > 0 else ("\u2212", lower_y)
        drawing.text(x + 20, y + 4, f"{sign}{1e3 * abs(wall_m):g} mm", BELIEVED_INK, size=11)
    bodies = [station.body for station in contact_stations(contact)]
    lowest_body = name if law.has_stops else min(bodies, key=lambda body: layout.level_px[body])
    text_x, y = x + (8 if law.has_stops else 14), layout.bottom_px(lowest_body) + GAP_PX + 22
    for line in (contact.name, f"{law.stiffness_n_per_m:g} N/m", *_contact_notes(contact)):
        drawing.text(text_x, y, line, BELIEVED_INK, size=11)
        y += 14


def _contact_notes(contact: Contact) -> Iterator[str]:
    if contact.law.damping_n_s_per_m:
        yield f"{contact.law.damping_n_s_per_m:g} N s/m"
    law_tag = str(contact.law.__struct_config__.tag)
    if law_tag != "dead_zone":
        yield law_tag


def _draw_forces(drawing: Drawing, layout: _Layout) -> None:
    forces, names_by_station = layout.rig.forces, dict[Station, list[str]]()
    for force_number, station in enumerate(forces, start=1):
        names_by_station.setdefault(station, []).append("force F" if len(forces) == 1 else f"F{force_number}")
    for station in dict.fromkeys(s for s in forces if not layout.rig.is_on_ground(s)):
        x, top = layout.x_px(station, station), layout.top_px(station.body)
        drawing.arrow((x, top - 1), (x, top - 80), FORCE_INK, 3.0)
        drawing.text(x + 10, top - 70, ", ".join(names_by_station[station]), FORCE_INK)


def _draw_sensors(drawing: Drawing, layout: _Layout) -> None:
    """Draw a mark at every station, with the letters of its quantities and its position."""
    station_letters: dict[Station, list[str]] = {}
    for sensor in layout.rig.sensors:
        station_letters.setdefault(sensor.station, []).append(LETTERS.get(sensor.quantity, sensor.quantity))
    for station, letters in station_letters.items():
        if layout.rig.is_on_ground(station):
            continue
        x, top = layout.x_px(station, layout.rig.sensors), layout.top_px(station.body)
        drawing.line((x - 5, top - 9), (x + 5, top - 9), (x, top - 1), colour=SENSOR_INK, fill=SENSOR_INK)
        place = f"  {place_name(layout.rig.body(station.body), station.position_m)}"
        place = "" if station.body in layout.slot_items else place
        drawing.text(
            x + 4, top - GAP_PX - 10, ", ".join(dict.fromkeys(letters)) + place, SENSOR_INK, turned=-60, size=11
        )
    if station_letters:
        quantities = dict.fromkeys(s.quantity for s in layout.rig.sensors)
        legend = ", ".join(f"{LETTERS.get(q, q)} {q}" for q in quantities)
        if layout.rig.base_sensors:
            legend += "; on the ground: " + ", ".join(
                LETTERS.get(s.quantity, s.quantity) for s in layout.rig.base_sensors
            )
        drawing.text(0.0, TITLE_PX + 20, f"sensors: {legend}", SENSOR_INK)


def _draw_attachments(drawing: Drawing, layout: _Layout) -> None:
    rig = layout.rig
    for mass in rig.masses:
        x, top = layout.x_px(mass.station, mass), layout.top_px(mass.station.body)
        drawing.box(x - 9, top - 18, x + 9, top, fill=INK)
        drawing.text(x - 12, top - 6, f"{mass.mass_kg:g} kg", anchor="end", size=11)
    for spring in rig.springs:
        cubic, turning = (spring.cubic_n_per_m3, "N/m\u00b3"), (spring.rotational_n_m_per_rad, "N m/rad")
        quantities = [(spring.stiffness_n_per_m, "N/m"), cubic, turning]
        _draw_grounded(drawing, layout, spring.station, spring, drawing.spring, quantities)
    for support in rig.supports:
        quantities = [(support.stiffness_n_per_m or 0.0, "N/m")]
        _draw_grounded(drawing, layout, support.station, support, drawing.pin, quantities)
    for damper in rig.dampers:
        quantities = [(damper.damping_n_s_per_m, "N s/m"), (damper.friction_n, "N friction")]
        _draw_grounded(drawing, layout, damper.station, damper, drawing.damper, quantities)
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


def _draw_grounded(
    drawing: Drawing,
    layout: _Layout,
    station: Station,
    item: object,
    draw_element: Callable[[float, float, float], None],
    quantities: list[tuple[float, str]],
) -> None:
    """Draw a spring, support or damper under a body, with its non-zero values."""
    x, bottom = layout.x_px(station, item), layout.bottom_px(station.body)
    draw_element(x, bottom, bottom + ATTACHED_PX)
    drawing.ground(x, bottom + ATTACHED_PX)
    for line_number, line in enumerate(f"{value:g} {unit}" for value, unit in quantities if value):
        drawing.text(x + 12, bottom + ATTACHED_PX - 8 - 14 * line_number, line, size=11)
