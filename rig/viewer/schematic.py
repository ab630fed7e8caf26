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

LENGTH_PX, LEVEL_PX, HALF_PX, GAP_PX, REACH_PX, STRUT_PX = 800.0, 300.0, 7.0, 12.0, 62.0, 70.0
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
        plan = _plan(replace(plane, contacts=contacts), lowest_px + VIEW_GAP_PX)
        drawing.text(0.0, plan.title_px, f"{rig.name}{VIEW_WORDS[direction] if rig.in_space else ''}", size=16)
        _view(drawing, plan, [f"F{k}" if len(rig.forces) > 1 else "force F" for k in numbers])
    drawing.write(path)


def _view(drawing: Drawing, plan: "_Plan", force_names: Sequence[str]) -> None:
    """Draw a plane rig; of a direction without forces no name is given."""
    rig = plan.rig
    for contact in rig.contacts:
        _jaws(drawing, plan, contact)
    for body in rig.bodies:
        _body(drawing, plan, body)
    for contact in rig.contacts:
        _clearances(drawing, plan, contact)
    _forces(drawing, plan, force_names)
    _sensors(drawing, plan)
    _attached(drawing, plan)
    if rig.gravity_m_per_s2:
        drawing.text(0.0, plan.title_px + 38, f"gravity {rig.gravity_m_per_s2:g} m/s\u00b2 downwards", GREY)
    if rig.base_motion:
        base = rig.base_motion
        words = f"base motion {base.acceleration_rms_m_per_s2:g} m/s\u00b2 rms, {base.low_hz:g} to {base.high_hz:g} Hz"
        drawing.text(0.0, plan.levels[rig.bodies[0].name] + REACH_PX + 90, words, FORCE_INK)


@dataclass(frozen=True)
class _Plan:
    """Positions of the bodies in pixels; a mass has a slot for each item on it."""

    rig: Rig
    lefts: dict[str, float]
    scale: float
    levels: dict[str, float]
    slots: dict[str, tuple[object, ...]]
    title_px: float

    def x(self, station: Station, item: object) -> float:
        left_px = self.lefts[station.body]
        items = self.slots.get(station.body)
        if items is None:
            return left_px + self.scale * station.position_m
        return left_px + SLOT_PX * (next(k for k, other in enumerate(items) if other is item) + 0.5)

    def half(self, body: str) -> float:
        return MASS_HALF_PX if body in self.slots else HALF_PX

    def top(self, body: str) -> float:
        return self.levels[body] - self.half(body)

    def bottom(self, body: str) -> float:
        return self.levels[body] + self.half(body)


def _plan(rig: Rig, title_px: float) -> _Plan:
    lefts = left_ends(rig)
    right = max(lefts[b.name] + b.length_m for b in rig.bodies)
    extent = right - min(lefts.values())
    scale = LENGTH_PX / extent if extent > 0 else 1.0
    levels = {body.name: -LEVEL_PX * k for k, body in enumerate(rig.bodies)}
    top = min(levels.values()) - (title_px - TITLE_PX)
    slots = {body.name: tuple(_items_on(rig, body)) for body in rig.bodies if body.is_mass}
    placed = {name: scale * (left_m - min(lefts.values())) for name, left_m in lefts.items()}
    return _Plan(rig, placed, scale, {name: level - top for name, level in levels.items()}, slots, title_px)


def _items_on(rig: Rig, body: Body) -> Iterator[object]:
    """Items on a mass from left to right, beginning with its own spring."""
    yield body
    yield from (c for c in rig.contacts if body.name in (c.at.body, c.against.body if c.against else ""))
    yield from (station for station in dict.fromkeys(rig.forces) if station.body == body.name)
    if any(s.station.body == body.name for s in rig.sensors):
        yield rig.sensors
    for attached in (rig.masses, rig.springs, rig.supports, rig.dampers, rig.loads, rig.tones):
        yield from (item for item in attached if item.station.body == body.name)


def _body(drawing: Drawing, plan: _Plan, body: Body) -> None:
    level, left_px = plan.levels[body.name], plan.lefts[body.name]
    items = plan.slots.get(body.name)
    width = plan.scale * body.length_m if items is None else SLOT_PX * len(items)
    drawing.box(
        left_px, plan.top(body.name), left_px + width, plan.bottom(body.name), dashed=bool(len(body.positions_m))
    )
    for x_m in body.positions_m:
        drawing.dot(left_px + plan.scale * float(x_m), level, GREY, 2.0)
    if body.clamped:
        drawing.wall(left_px, level, 30.0)
    if items is not None:
        drawing.text(left_px + 8, level + 4, f"{body.name}: {body.mass_kg:g} kg")
        x, bottom = plan.x(Station(body.name), body), plan.bottom(body.name)
        drawing.spring(x - 12, bottom, bottom + REACH_PX)
        drawing.damper(x + 14, bottom, bottom + REACH_PX)
        drawing.ground(x, bottom + REACH_PX, 60.0)
        (hz,), (ratio,) = body.frequencies_hz(1), body.damping_ratios(1)
        drawing.text(left_px, bottom + REACH_PX + 24, f"{hz:g} Hz, damping ratio {ratio:g}")
        return
    beam = next((b for b in plan.rig.beams if b == body), None)
    size = f", {1e3 * beam.width_m:g} mm wide, {1e3 * beam.thickness_m:g} mm thick" if beam else ""
    if beam and beam.outer_diameter_m:
        size = f", tube of {1e3 * beam.outer_diameter_m:g} and {1e3 * beam.inner_diameter_m:g} mm"
    drawing.text(left_px, plan.top(body.name) - 98, f"{body.name}: {body.kind}, {body.length_m:g} m{size}", size=13)
    _ruler(drawing, plan, body)


def _ruler(drawing: Drawing, plan: _Plan, body: Body) -> None:
    """Draw a ruler under a body with the positions of its ends, contacts, forces and attachments."""
    rig, left_px, y = plan.rig, plan.lefts[body.name], plan.bottom(body.name) + REACH_PX + 34
    stations = [*rig.forces, *(s for c in rig.contacts for s in (c.at, c.against) if s is not None)]
    stations += [
        item.station
        for group in (rig.masses, rig.springs, rig.supports, rig.dampers, rig.loads, rig.tones)
        for item in group
    ]
    places = sorted({0.0, body.length_m, *(s.position_m for s in stations if s.body == body.name)})
    drawing.line((left_px, y), (left_px + plan.scale * body.length_m, y), colour=GREY, width=1.0)
    labelled_x = -1e9
    for x_m in places:
        x = left_px + plan.scale * x_m
        drawing.line((x, y - 5), (x, y + 5), colour=GREY, width=1.0)
        is_low = x - labelled_x < 48  # beside the one before there is no room
        drawing.text(x, y + (30 if is_low else 18), f"{x_m:g} m", GREY, "middle", size=11)
        labelled_x = -1e9 if is_low else x


def _jaws(drawing: Drawing, plan: _Plan, contact: Contact) -> None:
    """Draw the two stops of a contact and their carrier, another body or the ground; or a spring between them."""
    x, name = plan.x(contact.at, contact), contact.at.body
    upper, lower = plan.top(name) - GAP_PX, plan.bottom(name) + GAP_PX
    if not contact.law.has_stops:
        _strut(drawing, plan, contact)
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
        against_x = plan.x(against, contact)
        end_levels = (upper, plan.top(against.body)) if plan.levels[against.body] > plan.levels[name] else (
            lower, plan.bottom(against.body)
        )  # fmt: skip
        middle = (plan.levels[name] + plan.levels[against.body]) / 2
        drawing.line(
            (x, end_levels[0]), (x, middle), (against_x, middle), (against_x, end_levels[1]), colour=BELIEVED_INK
        )


def _strut(drawing: Drawing, plan: _Plan, contact: Contact) -> None:
    """Draw a spring from a body to the one above or below it, or to the ground below."""
    x, name, against = plan.x(contact.at, contact), contact.at.body, contact.against
    if against is None:
        drawing.spring(x, plan.bottom(name), plan.bottom(name) + STRUT_PX)
        drawing.ground(x, plan.bottom(name) + STRUT_PX)
        return
    lower, higher = sorted((name, against.body), key=lambda body: -plan.levels[body])
    far_x = plan.x(against, contact)
    drawing.spring(x, plan.bottom(higher), plan.top(lower))
    end_y = plan.top(lower) if lower == against.body else plan.bottom(higher)
    drawing.line((x, end_y), (far_x, end_y), colour=BELIEVED_INK)


def _clearances(drawing: Drawing, plan: _Plan, contact: Contact) -> None:
    x, name, law = plan.x(contact.at, contact), contact.at.body, contact.law
    upper, lower = plan.top(name) - GAP_PX, plan.bottom(name) + GAP_PX
    for wall_m, side in walls_m(law) if law.has_stops else ():
        sign, y = ("+", upper) if side > 0 else ("\u2212", lower)
        drawing.text(x + 20, y + 4, f"{sign}{1e3 * abs(wall_m):g} mm", BELIEVED_INK, size=11)
    bodies = [station.body for station in contact_stations(contact)]
    below = name if law.has_stops else min(bodies, key=lambda body: plan.levels[body])
    text_x, y = x + (8 if law.has_stops else 14), plan.bottom(below) + GAP_PX + 22
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


def _forces(drawing: Drawing, plan: _Plan, force_names: Sequence[str]) -> None:
    names = dict[Station, list[str]]()
    for station, name in zip(plan.rig.forces, force_names, strict=False):
        names.setdefault(station, []).append(name)
    for station in (s for s in names if not plan.rig.is_on_ground(s)):
        x, top = plan.x(station, station), plan.top(station.body)
        drawing.arrow((x, top - 1), (x, top - 80), FORCE_INK, 3.0)
        drawing.text(x + 10, top - 70, ", ".join(names[station]), FORCE_INK)


def _sensors(drawing: Drawing, plan: _Plan) -> None:
    """Draw a mark at every station, with the letters of its quantities and its position."""
    quantities: dict[Station, list[str]] = {}
    for sensor in plan.rig.sensors:
        quantities.setdefault(sensor.station, []).append(LETTERS.get(sensor.quantity, sensor.quantity))
    for station, letters in quantities.items():
        if plan.rig.is_on_ground(station):
            continue
        x, top = plan.x(station, plan.rig.sensors), plan.top(station.body)
        drawing.line((x - 5, top - 9), (x + 5, top - 9), (x, top - 1), colour=SENSOR_INK, fill=SENSOR_INK)
        place = "" if station.body in plan.slots else f"  {place_name(plan.rig.body(station.body), station.position_m)}"
        drawing.text(
            x + 4, top - GAP_PX - 10, ", ".join(dict.fromkeys(letters)) + place, SENSOR_INK, turned=-60, size=11
        )
    if quantities:
        used = dict.fromkeys(s.quantity for s in plan.rig.sensors)
        key = ", ".join(f"{LETTERS.get(q, q)} {q}" for q in used)
        if plan.rig.base_sensors:
            key += "; on the ground: " + ", ".join(LETTERS.get(s.quantity, s.quantity) for s in plan.rig.base_sensors)
        drawing.text(0.0, plan.title_px + 20, f"sensors: {key}", SENSOR_INK)


def _attached(drawing: Drawing, plan: _Plan) -> None:
    rig = plan.rig
    for mass in rig.masses:
        x, top = plan.x(mass.station, mass), plan.top(mass.station.body)
        drawing.box(x - 9, top - 18, x + 9, top, fill=INK)
        drawing.text(x - 12, top - 6, f"{mass.mass_kg:g} kg", anchor="end", size=11)
    for spring in rig.springs:
        cubic, turning = (spring.cubic_n_per_m3, "N/m\u00b3"), (spring.rotational_n_m_per_rad, "N m/rad")
        values = [(spring.stiffness_n_per_m, "N/m"), cubic, turning]
        _grounded(drawing, plan, spring.station, spring, drawing.spring, values)
    for support in rig.supports:
        values = [(support.stiffness_n_per_m or 0.0, "N/m")]
        _grounded(drawing, plan, support.station, support, drawing.pin, values)
    for damper in rig.dampers:
        values = [(damper.damping_n_s_per_m, "N s/m"), (damper.friction_n, "N friction")]
        _grounded(drawing, plan, damper.station, damper, drawing.damper, values)
    for clamp in rig.clamps:
        x, y = plan.lefts[clamp.body], plan.levels[clamp.body]
        drawing.dot(x, y, BELIEVED_INK, 6.0)
        drawing.text(x - 12, y + 46, f"{clamp.rotational_n_m_per_rad:g} N m/rad", size=11)
    for load in rig.loads:
        x, top = plan.x(load.station, load), plan.top(load.station.body)
        arrow_ends = ((x, top - 1), (x, top - 40))
        drawing.arrow(*(arrow_ends if load.force_n >= 0 else arrow_ends[::-1]))
        drawing.text(x + 6, top - 30, f"{abs(load.force_n):g} N", size=11)
    for tone in rig.tones:
        x, top = plan.x(tone.station, tone), plan.top(tone.station.body)
        drawing.arrow((x, top - 1), (x, top - 40), FORCE_INK, 1.5)
        drawing.text(x + 6, top - 30, f"tone {tone.frequency_hz:g} Hz", FORCE_INK, size=11)


def _grounded(
    drawing: Drawing,
    plan: _Plan,
    station: Station,
    item: object,
    shape: Callable[[float, float, float], None],
    values: list[tuple[float, str]],
) -> None:
    """Draw a spring, support or damper under a body, with its non-zero values."""
    x, bottom = plan.x(station, item), plan.bottom(station.body)
    shape(x, bottom, bottom + REACH_PX)
    drawing.ground(x, bottom + REACH_PX)
    for k, words in enumerate(f"{value:g} {unit}" for value, unit in values if value):
        drawing.text(x + 12, bottom + REACH_PX - 8 - 14 * k, words, size=11)
