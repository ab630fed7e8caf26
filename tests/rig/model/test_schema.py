"""The JSON Schema of rig.json: it takes what is read, and refuses what is refused."""

import jsonschema
import msgspec
import pytest

from rig.errors import RigError
from rig.lab.importing import Map
from rig.model.description import from_json, to_json
from rig.model.schema import rig_schema, schema_of
from rig.simulation.reference import BarrelCradle, Sdof

VALIDATOR = jsonschema.Draft202012Validator
RIGS = {"sdof": Sdof().rig(), "barrel_cradle": BarrelCradle().rig()}
LAW = ["contacts", 0, "law"]


def described(place, changes):
    rig = msgspec.json.decode(to_json(RIGS["barrel_cradle"]))
    target = rig
    for key in place:
        target = target[key]
    target.update(changes)
    return rig


@pytest.mark.parametrize("name", RIGS)
def test_the_reference_rigs_are_valid(name):
    VALIDATOR.check_schema(rig_schema())
    VALIDATOR(rig_schema()).validate(msgspec.json.decode(to_json(RIGS[name])))


@pytest.mark.parametrize(
    ("place", "changes", "is_valid"),
    [
        (LAW, {"lower_clearance_m": None}, True),
        (["contacts", 0], {"against": "ground"}, True),
        (["sensors", 0], {"station": "ground"}, True),
        (["sensors", 0], {"station": "grund"}, False),
        (["contacts", 0], {"against": None}, True),
        ([], {"$schema": "rig.schema.json"}, True),
        ([], {"force_at": [{"body": "barrel"}, {"body": "barrel", "position_m": 1.0}]}, True),
        (LAW, {"stiffness_n_per_m": None}, False),
        (LAW, {"lower_clearance_m": "none"}, False),
        (["contacts", 0], {"against": "grund"}, False),
        (["bodies", 0], {"ends": "cantilever"}, False),
        (["bodies", 0], {"type": "bean"}, False),
        (["sensors", 0], {"quantity": "speed"}, False),
        (["sensors", 0], {"gains": 1.0}, False),
        ([], {"rate_hz": 1.0}, False),
    ],
)
def test_the_schema_and_the_reader_agree(place, changes, is_valid):
    rig = described(place, changes)
    assert VALIDATOR(rig_schema()).is_valid(rig) == is_valid
    try:
        from_json(msgspec.json.encode(rig), "rig.json")
        is_read = True
    except RigError:
        is_read = False
    assert is_read == is_valid


def test_a_law_without_a_type_is_a_dead_zone():
    rig = described([], {})
    del rig["contacts"][0]["law"]["type"]
    assert VALIDATOR(rig_schema()).is_valid(rig)


@pytest.mark.parametrize(
    ("changes", "is_valid"),
    [({}, True), ({"force": "none"}, True), ({"froce": "none"}, False), ({"sensors": {"a": {"unit": "g"}}}, False)],
)
def test_the_schema_of_the_map_takes_a_map(changes, is_valid):
    schema = schema_of(Map, "import map")
    VALIDATOR.check_schema(schema)
    mapping = {"rig": "rig.json", "force": {"column": "F", "unit": "N"}, "sensors": {"a": {"column": 2, "unit": "g"}}}
    assert VALIDATOR(schema).is_valid(mapping | changes) == is_valid
