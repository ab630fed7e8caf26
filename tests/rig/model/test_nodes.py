"""Stations by the names of a modal basis's nodes: they read as positions, and errors name the nearest node."""

import json

import jsonschema
import numpy as np
import pytest

from rig.errors import RigError
from rig.model.description import Station, from_json, to_json
from rig.model.modes import modes_of
from rig.model.schema import rig_schema
from rig.viewer.schematic import draw

SHAPES = {"11": [0.9, 0.4], "12": [0.7, -0.2], "21": [0.8, 0.3], "22": [0.1, 0.6]}


def plate(**changes):
    """A plate whose four points have no common axis, with a stop at one and a force at another."""
    body = {
        "type": "structure",
        "name": "plate",
        "frequencies_hz": [30.0, 80.0],
        "damping_ratios": [0.01, 0.01],
        "shapes": [{"node": node, "values": values} for node, values in SHAPES.items()],
    }
    return {
        "name": "plate",
        "bodies": [body],
        "contacts": [
            {
                "name": "stop",
                "at": {"body": "plate", "node": "22"},
                "law": {"lower_clearance_m": 1e-4, "upper_clearance_m": 1e-4, "stiffness_n_per_m": 1e5},
            }
        ],
        "force_at": {"body": "plate", "node": 11},
        "sensors": [
            {"name": f"a{node}", "station": {"body": "plate", "node": node}, "quantity": "acceleration"}
            for node in SHAPES
        ],
        "sample_rate_hz": 2048.0,
    } | changes


def read(description):
    return from_json(json.dumps(description).encode(), "rig.json")


def test_the_shapes_at_a_station_are_those_of_its_node():
    rig = read(plate())
    stations = [s.station for s in rig.sensors]
    assert rig.forces == (stations[0],)
    assert rig.contacts[0].at == stations[3]
    body = rig.bodies[0]
    shapes = modes_of(rig, body).shapes(np.array([s.position_m for s in stations]), 2)
    np.testing.assert_array_equal(shapes, list(SHAPES.values()))


def test_the_names_are_kept_and_the_file_written_reads_as_the_same_rig():
    rig = read(plate())
    assert from_json(to_json(rig), "rig.json") == rig
    assert [row.node for row in rig.bodies[0].rows] == list(SHAPES)


def test_points_without_an_axis_have_no_slope_and_no_shapes_between_them():
    body = read(plate()).bodies[0]
    np.testing.assert_array_equal(body.shapes(np.array([0.4, 1.0]), 2, order=1), np.zeros((2, 2)))
    np.testing.assert_array_equal(body.shapes(np.array([0.4]), 2)[0], SHAPES["11"])


def test_a_length_of_points_without_an_axis_does_not_limit_them():
    """The plate's own length, 0.3 m, is no bound of the numbers that stand for its nodes."""
    description = plate()
    description["bodies"][0]["length_m"] = 0.3
    assert read(description) == read(plate())


def test_nodes_with_positions_keep_them():
    description = plate()
    for row, position_m in zip(description["bodies"][0]["shapes"], (0.0, 0.1, 0.4, 0.5), strict=True):
        row["position_m"] = position_m
    description["bodies"][0]["length_m"] = 0.6
    rig = read(description)
    assert rig.contacts[0].at == Station("plate", 0.5)
    assert rig.bodies[0].has_axis


@pytest.mark.parametrize(
    ("station", "sentence"),
    [
        (
            {"body": "plate", "node": "111"},
            "force_at.node is '111' (did you mean '11'?); the modal basis of 'plate' has 11, ",
        ),
        ({"body": "plate", "node": None}, "force_at.node is None; give the name of a node"),
        ({"body": "beam", "node": "22"}, "force_at.node is '22', and 'beam' has no nodes with names; give position_m"),
        (
            {"body": "plate", "node": "22", "position_m": 1.0},
            "gives node '22', which stands at 3.0 m, and position_m 1.0",
        ),
    ],
)
def test_a_node_that_is_not_there_is_refused_with_the_nearest(station, sentence):
    with pytest.raises(RigError) as refused:
        read(plate(force_at=station))
    assert sentence in str(refused.value)
    assert str(refused.value).startswith("rig.json: not a rig description: ")


def test_two_nodes_of_one_name_are_refused():
    description = plate()
    description["bodies"][0]["shapes"][1]["node"] = "11"
    with pytest.raises(RigError, match="more than one node is named '11'"):
        read(description)


def test_the_schema_takes_nodes_and_refuses_rows_without_a_place():
    validator, description = jsonschema.Draft202012Validator(rig_schema()), plate()
    assert validator.is_valid(description)
    del description["bodies"][0]["shapes"][0]["node"]
    assert not validator.is_valid(description)


def test_the_drawing_names_the_nodes(tmp_path):
    draw(read(plate()), tmp_path / "plate.svg")
    assert "node 21" in (tmp_path / "plate.svg").read_text(encoding="utf-8")
