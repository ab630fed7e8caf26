"""Drawing of a rig for a page: on a wide and on a narrow screen, and the key of the symbols that occur in it."""

from collections.abc import Iterator, Mapping, Sequence
from html import escape

import numpy as np

from identify.pages.drawing_texts import NARROW_WIDTH, WIDTH
from identify.pages.machine import DrawnMark, has_spring, rig_drawing_svg
from rig.model.contact_laws import ContactLaw
from rig.model.description import Rig

_BODY = '<rect class="body" x="2" y="7" width="32" height="10"/>'
_FORK = '<path class="{}" d="M9,3h18V23M9,21h18"/>' + _BODY
_HALF_FORK = '<path class="{}" d="M9,3h18V23"/>' + _BODY
_SPRING = '<path class="{}" d="M18,1v3l-6,1.5l12,3l-12,3l12,3l-12,3l6,1.5v4"/>'
_CONTACT_ICONS = {
    "contact, two stops": _FORK,
    "contact, one stop": _HALF_FORK,
    "contact, a ring": _FORK,
    "spring": _SPRING,
}
_RING = '<circle class="{}" cx="18" cy="12" r="9"/>'


def drawing_html(rig: Rig, contact_lines: Mapping[str, Sequence[str]], marks: Sequence[DrawnMark] = ()) -> str:
    """Drawings of a rig, of which the screen shows the one that fits, and their key."""
    wide, narrow = (rig_drawing_svg(rig, contact_lines, marks, width_px) for width_px in (WIDTH, NARROW_WIDTH))
    items = (
        f'<li><svg class="machine" viewBox="0 0 36 24" aria-hidden="true">{icon}</svg>{escape(words)}</li>'
        for icon, words in _legend_entries(rig, contact_lines, marks)
    )
    return f'<div class="broad">{wide}</div><div class="narrow">{narrow}</div><ul class="key">{"".join(items)}</ul>'


def _contact_kind(law: ContactLaw) -> str:
    """Words of the key for a contact."""
    if not law.has_stops:
        return "spring"
    if law.spatial:
        return "contact, a ring"
    return "contact, two stops" if np.isfinite(law.lower_clearance_m + law.upper_clearance_m) else "contact, one stop"


def _legend_entries(
    rig: Rig, contact_lines: Mapping[str, Sequence[str]], marks: Sequence[DrawnMark]
) -> Iterator[tuple[str, str]]:
    """Icon and words of each symbol that occurs."""
    if any(not body.is_mass for body in rig.bodies):
        yield f'{_BODY}<circle class="origin" cx="2" cy="12" r="3"/>', "body, its lengths in m from the dot"
    if any(body.is_mass for body in rig.bodies):
        yield '<rect class="body" x="6" y="3" width="24" height="18"/>', "mass"
    if any(body.clamped for body in rig.bodies):
        hatch = "".join(f"M18,{2 + 5 * k}l-7,6" for k in range(4))
        yield f'<path class="ink" d="M18,1v22"/><path class="thin" d="{hatch}"/>', "clamp"
    if any(map(has_spring, rig.bodies)):
        yield _SPRING.format("thin") + '<path class="ink" d="M8,23h20"/>', "spring to the ground"
    for name, icon in _CONTACT_ICONS.items():
        has_values = [bool(contact_lines.get(c.name)) for c in rig.contacts if _contact_kind(c.law) == name]
        if True in has_values:
            yield icon.format("found"), f"{name}, with its values"
        if False in has_values:
            yield icon.format("fork"), name
    if rig.supports:
        yield '<path class="support" d="M18,4l-8,15h16z"/>', "support"
    if len(rig.base_sensors) < len(rig.sensors):
        yield '<path class="sensor" d="M12,7h12l-6,10z"/>', "sensor"
    if any(not rig.is_on_ground(station) for station in rig.forces):
        yield '<path class="force" d="M18,23V3m-6,9l6,-9l6,9"/>', "force F"
    if not all(mark.is_hint for mark in marks):
        yield _RING.format("mark"), "what was found"
    if any(mark.is_hint for mark in marks):
        yield _RING.format("mark hint"), "hint, not certain"
