"""A rig as a drawing: bodies, stations, contacts with their clearances, the force, sensors and what is attached."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from rig.model.description import Body, Contact, Rig, Station
from rig.viewer.stage import left_ends
from rig.viewer.svg import FAINT, FORCE, INK, MOVING, SENSOR, Drawing

LENGTH_PX, LEVEL_PX, HALF_PX, GAP_PX, REACH_PX = 800.0, 300.0, 7.0, 12.0, 62.0
TITLE_PX = -180.0
SLOT_PX, MASS_HALF_PX = 95.0, 34.0
LETTERS = {"acceleration": "a", "velocity": "v", "displacement": "x", "strain": "\u03b5"}


def draw(rig: Rig, path: Path) -> None:
    """Writes the drawing as SVG. Along the bodies it is to scale; clearances and thicknesses are not.

    Every station of a mass has a place of its own beside the others. Raises RigError if it cannot be written.
    """
    drawing = Drawing()
    plan = _plan(rig)
    drawing.text(0.0, TITLE_PX, rig.name, size=16)
    for contact in rig.contacts:
        _jaws(drawing, plan, contact)
    for body in rig.bodies:
        _body(drawing, plan, body)
    for contact in rig.contacts:
        _clearances(drawing, plan, contact)
    _forces(drawing, plan)
    _sensors(drawing, plan)
    _attached(drawing, plan)
    if rig.base_motion:
        base = rig.base_motion
        words = f"base motion {base.acceleration_rms_m_per_s2:g} m/s\u00b2 rms, {base.low_hz:g} to {base.high_hz:g} Hz"
        drawing.text(0.0, plan.levels[rig.bodies[0].name] + REACH_PX + 90, words, FORCE)
    drawing.write(path)


@dataclass(frozen=True)
class _Plan:
    """Plan of where everything stands, in pixels; a mass has a slot for each thing on it."""

    rig: Rig
    lefts: dict[str, float]
    scale: float
    levels: dict[str, float]
    slots: dict[str, tuple[object, ...]]

    def x(self, station: Station, what: object) -> float:
        left = self.lefts[station.body]
        things = self.slots.get(station.body)
        if things is None:
            return left + self.scale * station.position_m
        return left + SLOT_PX * (next(k for k, thing in enumerate(things) if thing is what) + 0.5)

    def half(self, body: str) -> float:
        return MASS_HALF_PX if body in self.slots else HALF_PX

    def over(self, body: str) -> float:
        return self.levels[body] - self.half(body)

    def under(self, body: str) -> float:
        return self.levels[body] + self.half(body)


def _plan(rig: Rig) -> _Plan:
    lefts = left_ends(rig)
    right = max(lefts[b.name] + b.length_m for b in rig.bodies)
    extent = right - min(lefts.values())
    scale = LENGTH_PX / extent if extent > 0 else 1.0
    levels = {body.name: -LEVEL_PX * k for k, body in enumerate(rig.bodies)}
    top = min(levels.values())
    slots = {body.name: tuple(_things(rig, body)) for body in rig.bodies if body.is_mass}
    placed = {name: scale * (left - min(lefts.values())) for name, left in lefts.items()}
    return _Plan(rig, placed, scale, {name: level - top for name, level in levels.items()}, slots)


def _things(rig: Rig, body: Body) -> Iterator[object]:
    """Things on a mass, from left to right: its own spring, then the rest."""
    yield body
    yield from (c for c in rig.contacts if body.name in (c.at.body, c.against.body if c.against else ""))
    yield from (at for at in dict.fromkeys(rig.forces) if at.body == body.name)
    if any(s.station.body == body.name for s in rig.sensors):
        yield rig.sensors
    for attached in (rig.masses, rig.springs, rig.dampers, rig.loads, rig.tones):
        yield from (one for one in attached if one.station.body == body.name)


def _body(drawing: Drawing, plan: _Plan, body: Body) -> None:
    level, left = plan.levels[body.name], plan.lefts[body.name]
    things = plan.slots.get(body.name)
    width = plan.scale * body.length_m if things is None else SLOT_PX * len(things)
    drawing.box(left, plan.over(body.name), left + width, plan.under(body.name), dashed=bool(len(body.positions_m)))
    for x_m in body.positions_m:
        drawing.dot(left + plan.scale * float(x_m), level, FAINT, 2.0)
    if body.clamped:
        drawing.wall(left, level, 30.0)
    if things is not None:
        drawing.text(left + 8, level + 4, f"{body.name}: {body.mass_kg:g} kg")
        x, bottom = plan.x(Station(body.name), body), plan.under(body.name)
        drawing.spring(x - 12, bottom, bottom + REACH_PX)
        drawing.damper(x + 14, bottom, bottom + REACH_PX)
        drawing.ground(x, bottom + REACH_PX, 60.0)
        (hz,), (ratio,) = body.frequencies_hz(1), body.damping_ratios(1)
        drawing.text(left, bottom + REACH_PX + 24, f"{hz:g} Hz, damping ratio {ratio:g}")
        return
    beam = next((b for b in plan.rig.beams if b == body), None)
    size = f", {1e3 * beam.width_m:g} mm wide, {1e3 * beam.thickness_m:g} mm thick" if beam else ""
    drawing.text(left, plan.over(body.name) - 98, f"{body.name}: {body.kind}, {body.length_m:g} m{size}", size=13)
    _ruler(drawing, plan, body)


def _ruler(drawing: Drawing, plan: _Plan, body: Body) -> None:
    """Places from the left end, under the body: both ends, contacts, the forces and what is attached."""
    rig, left, y = plan.rig, plan.lefts[body.name], plan.under(body.name) + REACH_PX + 34
    stations = [*rig.forces, *(s for c in rig.contacts for s in (c.at, c.against) if s is not None)]
    stations += [one.station for group in (rig.masses, rig.springs, rig.dampers, rig.loads, rig.tones) for one in group]
    places = sorted({0.0, body.length_m, *(s.position_m for s in stations if s.body == body.name)})
    drawing.line((left, y), (left + plan.scale * body.length_m, y), colour=FAINT, width=1.0)
    shown = -1e9
    for x_m in places:
        x = left + plan.scale * x_m
        drawing.line((x, y - 5), (x, y + 5), colour=FAINT, width=1.0)
        low = x - shown < 48  # beside the one before there is no room
        drawing.text(x, y + (30 if low else 18), f"{x_m:g} m", FAINT, "middle", size=11)
        shown = -1e9 if low else x


def _jaws(drawing: Drawing, plan: _Plan, contact: Contact) -> None:
    """The two stops about a body, and what carries them: another body, or the ground."""
    x, name = plan.x(contact.at, contact), contact.at.body
    upper, lower = plan.over(name) - GAP_PX, plan.under(name) + GAP_PX
    for y, ground_up in ((upper, True), (lower, False)):
        if contact.against is None:
            drawing.ground(x, y, upwards=ground_up)
        else:
            drawing.line((x - 16, y), (x + 16, y), colour=MOVING, width=3.0)
    if contact.against is not None:
        other = contact.against
        there = plan.x(other, contact)
        ends = (upper, plan.over(other.body)) if plan.levels[other.body] > plan.levels[name] else (
            lower, plan.under(other.body)
        )  # fmt: skip
        middle = (plan.levels[name] + plan.levels[other.body]) / 2
        drawing.line((x, ends[0]), (x, middle), (there, middle), (there, ends[1]), colour=MOVING)


def _clearances(drawing: Drawing, plan: _Plan, contact: Contact) -> None:
    x, name, law = plan.x(contact.at, contact), contact.at.body, contact.law
    upper, lower = plan.over(name) - GAP_PX, plan.under(name) + GAP_PX
    drawing.text(x + 20, upper + 4, f"+{1e3 * law.upper_clearance_m:g} mm", MOVING, size=11)
    drawing.text(x + 20, lower + 4, f"\u2212{1e3 * law.lower_clearance_m:g} mm", MOVING, size=11)
    y = lower + 22
    for words in (contact.name, f"{law.stiffness_n_per_m:g} N/m", *_further(contact)):
        drawing.text(x + 8, y, words, MOVING, size=11)
        y += 14


def _further(contact: Contact) -> Iterator[str]:
    if contact.law.damping_n_s_per_m:
        yield f"{contact.law.damping_n_s_per_m:g} N s/m"
    kind = str(contact.law.__struct_config__.tag)
    if kind != "dead_zone":
        yield kind


def _forces(drawing: Drawing, plan: _Plan) -> None:
    forces, names = plan.rig.forces, dict[Station, list[str]]()
    for number, at in enumerate(forces, start=1):
        names.setdefault(at, []).append("force F" if len(forces) == 1 else f"F{number}")
    for at in dict.fromkeys(forces):
        x, top = plan.x(at, at), plan.over(at.body)
        drawing.arrow((x, top - 1), (x, top - 80), FORCE, 3.0)
        drawing.text(x + 10, top - 70, ", ".join(names[at]), FORCE)


def _sensors(drawing: Drawing, plan: _Plan) -> None:
    """A mark at every station, with the letters of what is measured and the place."""
    quantities: dict[Station, list[str]] = {}
    for sensor in plan.rig.sensors:
        quantities.setdefault(sensor.station, []).append(LETTERS.get(sensor.quantity, sensor.quantity))
    for station, letters in quantities.items():
        x, top = plan.x(station, plan.rig.sensors), plan.over(station.body)
        drawing.line((x - 5, top - 9), (x + 5, top - 9), (x, top - 1), colour=SENSOR, fill=SENSOR)
        place = "" if station.body in plan.slots else f"  {station.position_m:g} m"
        drawing.text(x + 4, top - GAP_PX - 10, ", ".join(dict.fromkeys(letters)) + place, SENSOR, turned=-60, size=11)
    if quantities:
        used = dict.fromkeys(s.quantity for s in plan.rig.sensors)
        key = ", ".join(f"{LETTERS.get(q, q)} {q}" for q in used)
        drawing.text(0.0, TITLE_PX + 20, f"sensors: {key}", SENSOR)


def _attached(drawing: Drawing, plan: _Plan) -> None:
    rig = plan.rig
    for mass in rig.masses:
        x, top = plan.x(mass.station, mass), plan.over(mass.station.body)
        drawing.box(x - 9, top - 18, x + 9, top, fill=INK)
        drawing.text(x - 12, top - 6, f"{mass.mass_kg:g} kg", anchor="end", size=11)
    for spring in rig.springs:
        cubic, turning = (spring.cubic_n_per_m3, "N/m\u00b3"), (spring.rotational_n_m_per_rad, "N m/rad")
        values = [(spring.stiffness_n_per_m, "N/m"), cubic, turning]
        _grounded(drawing, plan, spring.station, spring, drawing.spring, values)
    for damper in rig.dampers:
        values = [(damper.damping_n_s_per_m, "N s/m"), (damper.friction_n, "N friction")]
        _grounded(drawing, plan, damper.station, damper, drawing.damper, values)
    for clamp in rig.clamps:
        x, y = plan.lefts[clamp.body], plan.levels[clamp.body]
        drawing.dot(x, y, MOVING, 6.0)
        drawing.text(x - 12, y + 46, f"{clamp.rotational_n_m_per_rad:g} N m/rad", size=11)
    for load in rig.loads:
        x, top = plan.x(load.station, load), plan.over(load.station.body)
        ends = ((x, top - 1), (x, top - 40))
        drawing.arrow(*(ends if load.force_n >= 0 else ends[::-1]))
        drawing.text(x + 6, top - 30, f"{abs(load.force_n):g} N", size=11)
    for tone in rig.tones:
        x, top = plan.x(tone.station, tone), plan.over(tone.station.body)
        drawing.arrow((x, top - 1), (x, top - 40), FORCE, 1.5)
        drawing.text(x + 6, top - 30, f"tone {tone.frequency_hz:g} Hz", FORCE, size=11)


def _grounded(
    drawing: Drawing,
    plan: _Plan,
    station: Station,
    what: object,
    shape: Callable[[float, float, float], None],
    values: list[tuple[float, str]],
) -> None:
    """A spring or damper under a body, with those of its values that are not zero."""
    x, bottom = plan.x(station, what), plan.under(station.body)
    shape(x, bottom, bottom + REACH_PX)
    drawing.ground(x, bottom + REACH_PX)
    for k, words in enumerate(f"{value:g} {unit}" for value, unit in values if value):
        drawing.text(x + 12, bottom + REACH_PX - 8 - 14 * k, words, size=11)
