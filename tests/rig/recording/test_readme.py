"""The table of rig.json in the README."""

from pathlib import Path

import msgspec
import pytest

import rig.recording
from rig.model.beam import Beam
from rig.model.contact_laws import LAWS
from rig.model.description import (
    BaseMotion,
    Clamp,
    Contact,
    ForceSensor,
    PointDamper,
    PointMass,
    PointSpring,
    Rig,
    Sensor,
    StaticLoad,
    Station,
    Tone,
)
from rig.model.oscillator import Oscillator
from rig.model.structure import ShapeRow, Structure

OBJECTS = {
    "the rig": Rig,
    "bodies, `type` beam": Beam,
    "bodies, `type` oscillator": Oscillator,
    "bodies, `type` structure": Structure,
    "shapes of a structure": ShapeRow,
    "contacts": Contact,
    "law of a contact, `type` dead_zone (also where none is given)": LAWS["dead_zone"],
    "law of a contact, `type` hunt_crossley": LAWS["hunt_crossley"],
    "sensors": Sensor,
    "station, force_at, at, against": Station,
    "masses": PointMass,
    "springs": PointSpring,
    "dampers": PointDamper,
    "clamps": Clamp,
    "loads": StaticLoad,
    "tones": Tone,
    "base_motion": BaseMotion,
    "force_sensor": ForceSensor,
}


def shown(field):
    if field.required:
        return f"`{field.encode_name}`"
    default = field.default if field.default is not msgspec.NODEFAULT else field.default_factory()
    text = "none" if default in (None, ()) else "as below" if isinstance(default, msgspec.Struct) else f"{default:g}"
    return f"`{field.encode_name}` ({text})"


@pytest.mark.parametrize("name", OBJECTS)
def test_the_readme_lists_every_field_with_its_default(name):
    text = (Path(*rig.recording.__path__) / "README.md").read_text(encoding="utf-8")
    row = f"| {name} | {', '.join(shown(field) for field in msgspec.structs.fields(OBJECTS[name]))} |"
    assert row in text.splitlines()
