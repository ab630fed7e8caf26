"""The worlds share no function with what makes the null simulations."""

import ast
from pathlib import Path

import pytest

import tests.campaigns.worlds

PACKAGE = Path(tests.campaigns.worlds.__path__[0])
OWN = "tests.campaigns.worlds"
ALLOWED = {
    "rig.errors",
    "rig.model.beam",
    "rig.model.contact_laws",
    "rig.model.description",
    "rig.model.oscillator",
    "rig.model.structure",
    "rig.recording",
    "rig.simulation.reference",
}
"""The believed rig and the file of a recording; of the reference rig its description alone, never its force."""


def imported(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}: a relative import"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("path", sorted(PACKAGE.glob("*.py")), ids=lambda p: p.stem)
def test_nothing_of_the_null_simulations_is_imported(path):
    for name in imported(path):
        if name.split(".")[0] in ("rig", "identify", "scenarios", "tests"):
            module = name if name in ALLOWED else name.rpartition(".")[0]
            assert name.startswith(OWN) or name in ALLOWED or module in ALLOWED, f"{path.name} imports {name}"


def test_the_reference_gives_its_rig_and_not_its_force():
    text = (PACKAGE / "believed.py").read_text()
    assert ".rig()" in text
    assert all(".force()" not in path.read_text() for path in PACKAGE.glob("*.py"))


def test_the_rule_would_notice():
    forbidden = ast.parse("from rig.simulation.plants import modal\nfrom identify.signals.kinematics import kinematics")
    names = [node.module for node in ast.walk(forbidden) if isinstance(node, ast.ImportFrom)]
    assert not {*names} & ALLOWED


def test_only_what_is_believed_is_described_by_the_product():
    """The bodies and laws of rig.json serve to write it; nothing that is simulated knows them."""
    models = {name for name in ALLOWED if name.startswith("rig.model")} - {"rig.model.description"}
    users = {path.stem for path in PACKAGE.glob("*.py") if {*imported(path)} & models}
    assert users == {"describing"}
