"""Answers against their own numbers: every rule of a consistent answer holds, and can fail."""

import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from identify.gaps.decision_table import Bounded, Evidence, Strength
from identify.gaps.results import Criteria
from identify.gaps.rollout.results import Rollout
from rig.files import write_json
from tests.campaigns.consistency import RULES, app, violations
from tests.test_campaigns.blind_cases import found, gap

LARGE, SMALL = Bounded("motion", "1", 0.1, 0.11, 0.005), Bounded("motion", "1", 0.001, 0.002, 0.005)
BEYOND = Bounded("motion", "1", 4.34, 4.4, 0.005)
CONTACT = Bounded("clearance of contact_1", "m", 1e-5, 2e-5, 1e-4)
NAME = Strength("contact_clearance:contact_1", 0.99, (1.04, 1.08), 1.0)
BEFORE = Evidence(
    p_value=1e-6,
    quantities=(LARGE, CONTACT),
    strengths=(NAME,),
    p_value_after=0.3,
    quantities_after=(SMALL,),
    removed=0.9,
)
NOTHING = replace(BEFORE, p_value=0.4, quantities=(SMALL, CONTACT), strengths=())
EXPLAINED = gap("explained", evidence=BEFORE, criteria=Criteria(True, False, (NAME.effect,), True))
CONSISTENT = gap("consistent", evidence=NOTHING)
TABLE, LEAVES, SHARE, NAMES, CONTACTS, VETO = RULES


def explained(**changes):
    return replace(EXPLAINED, evidence=replace(BEFORE, **changes))


def consistent(*quantities):
    return replace(CONSISTENT, evidence=replace(NOTHING, quantities=quantities))


def with_strength(**changes):
    return explained(strengths=(replace(NAME, **changes),))


@pytest.mark.parametrize(
    ("answer", "rules"),
    [
        (EXPLAINED, []),
        (CONSISTENT, []),
        (replace(EXPLAINED, verdict="unexplained"), [TABLE]),
        (replace(CONSISTENT, verdict="cannot_tell"), [TABLE]),
        (explained(p_value_after=0.01), []),  # what is left is bounded
        (explained(quantities_after=(LARGE,)), []),  # noise leaves as much
        (explained(p_value_after=0.01, quantities_after=(LARGE,)), [TABLE, LEAVES]),
        (explained(p_value_after=0.01, quantities_after=()), [TABLE, LEAVES]),
        (explained(quantities_after=(BEYOND,)), [SHARE]),
        (explained(quantities=(BEYOND, SMALL)), [SHARE]),
        (explained(quantities=(BEYOND, LARGE)), []),  # another one decides the same
        (with_strength(interval_95=(0.98, 1.08)), [TABLE, NAMES]),
        (with_strength(inclusion_probability=0.9), [TABLE, NAMES]),
        (with_strength(effect="preload:barrel"), [NAMES]),
        (consistent(SMALL), [CONTACTS]),
        (consistent(SMALL, replace(CONTACT, value=2e-4, upper=3e-4)), [TABLE, CONTACTS]),
        (consistent(SMALL, replace(CONTACT, value=None, upper=None)), [TABLE, CONTACTS]),
        (replace(EXPLAINED, rollout=Rollout(code="not_vetoed")), []),
        (replace(EXPLAINED, rollout=Rollout(code="worse")), [VETO]),
    ],
)
def test_an_answer_violates_the_rules_that_its_numbers_contradict(answer, rules):
    assert [rule for rule, _ in violations(answer)] == rules


def test_violations_are_a_table_and_an_exit_code(tmp_path):
    write_json(
        [found(EXPLAINED, "case_000"), found(explained(quantities_after=(BEYOND,)), "case_001")],
        tmp_path / "found.json",
    )
    write_json(CONSISTENT, tmp_path / "gap.json")
    done = CliRunner().invoke(app, [str(tmp_path / name) for name in ("found.json", "gap.json")])
    assert done.exit_code == 1
    assert "case_001" in done.output
    assert "434 %" in done.output
    assert "1 violations in 3 answers" in done.output
    assert CliRunner().invoke(app, [str(tmp_path / "gap.json")]).exit_code == 0
