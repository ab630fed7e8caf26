"""Names are shown as they are: no markup, no mathematics, no paths, no numbers of columns; or refused in a sentence."""

import html
import json
from xml.etree import ElementTree

import msgspec
import pytest

from rig.model.description import Rig, Station, to_json
from rig.simulation.reference import Sdof

NAMES = ("[/]", ":smile:", "<b>&amp;[bold]a", "a/b", "$x^$")
REFUSED = {
    "an escape sequence": "\x1b[31mred",
    "a new line": "a\nb",
    "a megabyte": "a" * 2**20,
    "half a pair": "\ud800",
}


def renamed(names) -> Rig:
    """The one-mass rig; names are those of the rig, the body, the contact and the two sensors."""
    rig = Sdof(frequency_hz=2.0).rig()
    name, body, contact, *sensors = names
    station = Station(body)
    return msgspec.structs.replace(
        rig,
        name=name,
        bodies=(msgspec.structs.replace(rig.bodies[0], name=body),),
        contacts=(msgspec.structs.replace(rig.contacts[0], name=contact, at=station),),
        force_at=station,
        sensors=tuple(
            msgspec.structs.replace(s, name=n, station=station) for s, n in zip(rig.sensors, sensors, strict=True)
        ),
    )


def test_every_command_shows_names_as_they_are(command, tmp_path):
    name, body, contact, *sensors = NAMES
    (tmp_path / "n.json").write_bytes(to_json(renamed(NAMES)))
    path, results = tmp_path / "r.mcap", tmp_path / "results"
    driven = ("--plant", "modal", "--duration", 40, "--set", "high_hz=6")

    def done(*words):
        status, out, err = command(*words)
        assert (status, err) == (0, "")
        return out

    done("rig", "record", tmp_path / "n.json", *driven, "--out", path)
    shown = done("rig", "info", path)
    assert f"rig {name}, " in shown
    assert all(f" {each} " in shown for each in (body, contact, *sensors))
    done("rig", "draw", path)
    drawn = "".join(ElementTree.parse(tmp_path / "r.svg").getroot().itertext())
    assert all(each in drawn for each in (name, body, contact))
    shown = done("identify", "contact", path, "--averages", 10, "--details", "--out", results)
    assert f"Contacts of {name}," in shown
    assert f" {contact} " in shown
    assert f"of {body}: " in shown
    assert html.escape(contact) in (results / "contact.html").read_text()
    assert json.loads((results / "contact.json").read_text())["contacts"][0]["name"] == contact
    done("identify", "check", path)
    done("rig", "view", path, "--contact", results / "contact.json")


@pytest.mark.parametrize("wrong", REFUSED.values(), ids=REFUSED)
@pytest.mark.parametrize("place", ["name", "bodies", "contacts", "sensors"])
def test_a_name_that_cannot_be_shown_is_refused(command, tmp_path, place, wrong):
    told = json.loads(to_json(Sdof().rig()))
    if place == "name":
        told["name"] = wrong
    else:
        told[place][0]["name"] = wrong
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(told))
    for words in (("draw", path), ("record", path, "--out", tmp_path / "r.mcap")):
        status, out, err = command("rig", *words)
        assert (status, out) == (1, "")
        assert err.startswith(f"rig: {path}: ")
        assert err[:-1].isprintable()
        assert len(err) < 2000
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["a\x1b[31mb.mcap", "a\nb.mcap", b"\xff.mcap".decode(errors="surrogateescape")])
def test_a_file_whose_name_cannot_be_shown_is_refused(command, sound, tmp_path, name):
    bad = tmp_path / name
    bad.write_bytes(sound.recording.read_bytes())
    for words in (
        *(("rig", each, bad) for each in ("info", "check", "view", "draw")),
        *(("identify", each, bad) for each in ("check", "contact", "law", "gap")),
        ("rig", "recover", bad, "--out", tmp_path / "o.mcap"),
        ("rig", "recover", sound.recording, "--out", bad, "--force"),
    ):
        status, out, err = command(*words)
        assert (status, out) == (1, "")
        assert "its name has control characters, or is not UTF-8; rename it" in err
        assert err[:-1].isprintable()
    assert list(tmp_path.iterdir()) == [bad]
    assert bad.read_bytes() == sound.recording.read_bytes()
