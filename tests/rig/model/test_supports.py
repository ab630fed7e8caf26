"""Supports: pins and rollers along a body, stiff unless they say how much they give."""

import json

import jsonschema
import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from rig.errors import RigError
from rig.model.beam import Beam
from rig.model.description import PointSpring, Rig, Sensor, Station, Support, from_json, to_json
from rig.model.modes import modes_of, participation, with_attachments_merged
from rig.model.oscillator import Oscillator
from rig.model.schema import rig_schema
from rig.viewer.schematic import draw

BEAM = Beam(name="beam", ends="clamped-free", length_m=1.0, width_m=0.05, thickness_m=0.02)


def held(body=BEAM, *supports):
    """The body with supports, without contacts."""
    at = Station(body.name, body.length_m / 2)
    sensor = Sensor(name="a", station=at, quantity="acceleration")
    return Rig(
        name="held", bodies=(body,), contacts=(), force_at=at, sensors=(sensor,), sample_rate_hz=2e3, supports=supports
    )


def at(position_m, **given):
    return Support(station=Station("beam", position_m), **given)


@pytest.mark.parametrize(
    ("ends", "places_m", "roots"),
    [
        ("clamped-free", (1.0,), (3.926602, 7.068583, 10.210176)),
        ("free-free", (0.0, 1.0), (np.pi, 2 * np.pi, 3 * np.pi)),
        ("free-free", (1.0,), (0.0, 3.926602, 7.068583)),
    ],
)
def test_a_support_is_a_pin_by_bernoulli_and_euler(ends, places_m, roots):
    """Clamped and pinned: tan x = tanh x; pinned at both ends: sin x = 0; pinned and free: tan x = tanh x, and a
    rotation about the pin."""
    beam = replace(BEAM, ends=ends)
    rig = held(beam, *(at(x_m) for x_m in places_m))
    flexural = np.sqrt(beam.bending_stiffness_n_m2 / beam.mass_per_length_kg_per_m)
    expected_hz = np.array(roots) ** 2 * flexural / (2 * np.pi)
    np.testing.assert_allclose(modes_of(rig, beam).frequencies_hz(3), expected_hz, rtol=5e-4, atol=0.05)


def test_a_support_holds_the_higher_modes_too():
    """Clamped and pinned, tan x = tanh x: x = (n + 1/4) pi from the second root on."""
    rig = held(BEAM, at(1.0))
    flexural = np.sqrt(BEAM.bending_stiffness_n_m2 / BEAM.mass_per_length_kg_per_m)
    roots = (np.arange(2, 13) + 0.25) * np.pi
    np.testing.assert_allclose(modes_of(rig, BEAM).frequencies_hz(12)[1:], roots**2 * flexural / (2 * np.pi), rtol=3e-4)


def test_a_support_that_gives_is_a_spring():
    sprung = replace(held(), springs=(PointSpring(station=Station("beam", 0.7), stiffness_n_per_m=3e4),))
    given = held(BEAM, at(0.7, stiffness_n_per_m=3e4))
    np.testing.assert_array_equal(modes_of(given, BEAM).frequencies_hz(5), modes_of(sprung, BEAM).frequencies_hz(5))


def test_a_condensed_body_follows_its_base_as_beam_theory_says():
    """The first modes of a cantilever carry 61.31, 18.83 and 6.47 % of its mass (Blevins, Formulas for Natural
    Frequency and Mode Shape, 1979); a spring of nothing makes it a body with an attachment."""
    (body,) = with_attachments_merged(held(BEAM, at(0.7, stiffness_n_per_m=1e-3))).bodies
    shares = np.square(participation(held(body), body, body, 3)) / BEAM.mass_kg
    np.testing.assert_allclose(shares, [0.6131, 0.1883, 0.0647], atol=2e-4)
    assert from_json(to_json(held(body)), "rig.json").bodies == (body,)


def test_a_condensed_body_has_the_modes_of_the_supported_one():
    rig = held(BEAM, at(0.7))
    (body,), places = with_attachments_merged(rig).bodies, np.array([0.313, 0.5, 0.9])
    modes = modes_of(rig, BEAM)
    assert with_attachments_merged(rig).supports == ()
    np.testing.assert_array_equal(body.frequencies_hz(6), modes.frequencies_hz(6))
    for order, share in ((0, 1e-5), (1, 1e-3)):
        shapes = modes.shapes(places, 6, order)
        np.testing.assert_allclose(body.shapes(places, 6, order), shapes, atol=share * np.abs(shapes).max())
    assert with_attachments_merged(held()) == held()


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (
            lambda: held(BEAM, at(0.0)),
            "a support stands at the clamped end of 'beam', which is held there; leave it out",
        ),
        (lambda: held(BEAM, at(1.2)), "a support stands at 1.2 m, off 'beam'; give 0 to 1.0 m"),
        (lambda: held(BEAM, at(0.5), at(0.5)), "more than one support stands at 0.5 m of 'beam'; give one"),
        (
            lambda: at(0.5, stiffness_n_per_m=0.0),
            "stiffness_n_per_m is 0.0; give a finite value above zero, or leave it",
        ),
        (lambda: at(0.5, stiffness_n_per_m=np.inf), "stiffness_n_per_m is inf; give a finite value"),
        (
            lambda: held(Oscillator(name="beam", mass_kg=1.0, frequency_hz=5.0, damping_ratio=0.01), at(0.0)),
            "a support holds 'beam', a mass; supports stand along beams and structures",
        ),
    ],
)
def test_a_support_that_makes_no_sense_is_refused(make, sentence):
    with pytest.raises(RigError) as refused:
        make()
    assert sentence in str(refused.value)


def test_rig_json_and_its_schema_have_supports():
    rig = held(BEAM, at(0.7), at(0.9, stiffness_n_per_m=2e5))
    assert from_json(to_json(rig), "rig.json") == rig
    described = msgspec.json.decode(to_json(held()))
    described["supports"] = [{"station": {"body": "beam", "position_m": 0.7}}]
    assert jsonschema.Draft202012Validator(rig_schema()).is_valid(described)
    assert from_json(json.dumps(described).encode(), "rig.json") == held(BEAM, at(0.7))
    described["supports"][0]["stifness_n_per_m"] = 1e8
    with pytest.raises(RigError, match="did you mean 'stiffness_n_per_m'"):
        from_json(json.dumps(described).encode(), "rig.json")


def test_the_drawing_shows_a_triangle_with_its_stiffness(tmp_path):
    bare, supported = tmp_path / "bare.svg", tmp_path / "supported.svg"
    draw(held(), bare)
    draw(held(BEAM, at(0.7, stiffness_n_per_m=2e5)), supported)
    text = supported.read_text(encoding="utf-8")
    assert "200000 N/m" in text
    assert "0.7 m" in text
    assert "0.7 m" not in bare.read_text(encoding="utf-8")
