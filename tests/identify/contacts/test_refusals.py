"""Every place that refuses gives the evidence that its code's words need, and the code reaches contact.json."""

import ast
from pathlib import Path
from string import Formatter

import msgspec
import pytest

from identify import contacts
from identify.checks import adding_first_finding_to_error
from identify.checks.findings import Finding
from identify.contacts.outcomes import length_ratio
from identify.contacts.refusals import CAUSES, REMEDIES, ContactRefusedError, RefusalCode, RemedyCode, refused
from identify.contacts.results import Unanswered, unanswered


def places() -> list[tuple[RefusalCode, set[str]]]:
    """The code and the names of the evidence of every call of `refused` in the room."""
    (folder,) = contacts.__path__
    calls = [
        node
        for module in Path(folder).glob("*.py")
        for node in ast.walk(ast.parse(module.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "refused"
    ]
    return [(RefusalCode[call.args[0].attr], {k.arg for k in call.keywords} - {"length_ratio"}) for call in calls]


def evidence_of(code):
    return {name for _, name, _, _ in Formatter().parse(CAUSES[code][0]) if name}


@pytest.mark.parametrize(("code", "evidence"), places())
def test_a_place_that_refuses_gives_the_evidence_that_the_words_need(code, evidence):
    assert evidence == evidence_of(code)


def test_every_code_has_words_and_a_place_and_every_remedy_is_some_codes():
    assert set(CAUSES) == set(RefusalCode) == {code for code, _ in places()}
    assert set(REMEDIES) == set(RemedyCode)
    unusual = {RemedyCode.RECORD_LONGER_FROM_REST_OR_DISPLACEMENTS, RemedyCode.RECORD_LONGER_OR_EXCITE_MORE}
    assert {remedy for _, remedy in CAUSES.values()} | unusual == set(RemedyCode)


def test_a_refusal_says_cause_and_remedy_with_its_numbers():
    error = refused(RefusalCode.NOT_REACHED, stop_mm=2.0, reach_mm=0.4321)
    assert str(error) == (
        "its stops, by rig.json 2 mm away, are not reached: the relative displacement goes to 0.432 mm; excite the rig "
        "more strongly"
    )
    assert error.refusal.advice == "excite the rig more strongly"


@pytest.mark.parametrize(
    ("scatter", "rest", "words"),
    [(3.0, 0.25, "record about 4 times as long, "), (0.25, 3.0, "record longer, "), (1.2e4, 0.25, "record longer, ")],
)
def test_a_record_that_scatters_too_much_says_how_long_it_should_be(scatter, rest, words):
    """scatter / length + rest = the square of a tenth of the value, here 1; not where the rest alone is as much."""
    ratio = length_ratio(scatter, scatter + rest, 10.0)
    assert ratio is None or scatter / ratio + rest == pytest.approx(1.0)
    refusal = refused(RefusalCode.UNCERTAIN, None, ratio, quantity="stiffness", uncertain_percent=18.0).refusal
    assert refusal.advice.startswith(words)


def test_a_finding_beside_does_not_lose_the_code():
    finding = Finding(cause="dead", channels=("a",), evidence="a is dead", mend="mend it")
    with (
        pytest.raises(ContactRefusedError, match=r"\(the check of the record found: a is dead: mend it\.\)$") as raised,
        adding_first_finding_to_error((finding,)),
    ):
        raise refused(RefusalCode.ALL_ZERO)
    assert raised.value.refusal.code == RefusalCode.ALL_ZERO


def test_the_code_stands_beside_the_reason_in_contact_json():
    refusal = refused(RefusalCode.UNCERTAIN, quantity="stiffness", uncertain_percent=12.4).refusal
    (entry,) = unanswered({"stop": refusal})
    plain = msgspec.json.decode(msgspec.json.encode(entry))
    assert plain == {
        "name": "stop",
        "reason": "its stiffness is uncertain by 12 % or more; record longer, excite the rig more strongly, or measure "
        "displacements at its places; if it never opens, give it the law of a spring",
        "code": "uncertain",
        "remedy": "record_longer_or_other_force",
        "evidence": {"quantity": "stiffness", "uncertain_percent": 12.4},
    }
    assert msgspec.convert(plain, Unanswered) == entry
    assert msgspec.convert({"name": "stop", "reason": "open"}, Unanswered).code is None  # as written before codes
