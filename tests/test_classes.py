"""The house: a name for each class, and bodies that are asked rather than told apart."""

import ast
from collections import Counter
from pathlib import Path

import pytest

import identify
import rig

MODULES = [path for room in (rig, identify) for path in Path(room.__path__[0]).rglob("*.py")]
TREES = {path: ast.parse(path.read_text()) for path in MODULES}
BODIES = {"Beam", "Oscillator", "Structure", "Body"}


def test_no_class_name_stands_twice():
    classes = Counter(n.name for tree in TREES.values() for n in ast.walk(tree) if isinstance(n, ast.ClassDef))
    assert [name for name, count in classes.items() if count > 1] == []


def test_type_variables_of_one_name_have_one_bound():
    """The lowest version of beartype that is allowed tells type variables apart by their names alone."""
    bounds = {}
    for call in [n for tree in TREES.values() for n in ast.walk(tree) if isinstance(n, ast.Call)]:
        if getattr(call.func, "id", "") == "TypeVar":
            name = ast.literal_eval(call.args[0])
            bounds.setdefault(name, set()).add((*map(ast.unparse, call.args[1:]), *map(ast.unparse, call.keywords)))
    assert len(bounds) > 10
    assert [name for name, kinds in bounds.items() if len(kinds) > 1] == []


@pytest.mark.parametrize("path", [p for p in MODULES if "model" not in p.parts], ids=lambda p: "/".join(p.parts[-3:]))
def test_bodies_are_not_told_apart_outside_the_model(path):
    asked = [
        {n.id for n in ast.walk(call) if isinstance(n, ast.Name)}
        for call in ast.walk(TREES[path])
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "isinstance"
    ]
    assert not any(BODIES & names for names in asked)
