"""Every attribute of what the packages offer has a sentence, which the reference shows."""

import ast
import inspect
import textwrap
from typing import get_args

import pytest

import identify
import rig

OFFERED = [
    item
    for package in (rig, identify)
    for name in package.__all__
    for item in get_args(getattr(package, name)) or (getattr(package, name),)
]
CLASSES = {
    base
    for item in OFFERED
    if isinstance(item, type)
    for base in item.__mro__
    if base.__module__.split(".")[0] in ("rig", "identify")
}


def is_text(node):
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def without_sentence(kind):
    """Public fields, properties and methods of a class that have no docstring."""
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    for node, following in zip(tree.body, [*tree.body[1:], None], strict=True):
        if isinstance(node, ast.AnnAssign) and not node.target.id.startswith("_") and not is_text(following):
            yield node.target.id
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_") and not ast.get_docstring(node):
            yield node.name


@pytest.mark.parametrize("kind", sorted(CLASSES, key=lambda kind: kind.__name__), ids=lambda kind: kind.__name__)
def test_every_attribute_has_a_sentence(kind):
    assert kind.__doc__
    assert list(without_sentence(kind)) == []


@pytest.mark.parametrize(
    "item", [item for item in OFFERED if not isinstance(item, type)], ids=lambda item: item.__name__
)
def test_every_function_has_a_sentence(item):
    assert inspect.getdoc(item)
