"""Constants of the diagnosis state what they mean, and why they have their value, where they stand."""

import ast
from itertools import zip_longest
from pathlib import Path

import identify.gaps

FOLDER = Path(*identify.gaps.__path__)


def _constants(path):
    """Names and values of a module's constants, and the docstring below each."""
    body = ast.parse(path.read_text()).body
    for node, following in zip_longest(body, body[1:]):
        if not isinstance(node, ast.Assign | ast.AnnAssign):
            continue
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        text = following.value if isinstance(following, ast.Expr) else None
        for target in targets:
            for name in getattr(target, "elts", [target]):
                if isinstance(name, ast.Name) and name.id.isupper():
                    yield name.id, node.value, getattr(text, "value", None)


def _is_number(value):
    """True of numbers, and of tuples of them; not of words and tables of words."""
    return all(
        (isinstance(part, ast.Constant) and isinstance(part.value, int | float))
        or isinstance(part, ast.UnaryOp | ast.BinOp)
        for part in getattr(value, "elts", [value])
    )


def test_every_number_has_a_docstring():
    numbers = [
        (path.relative_to(FOLDER).as_posix(), name, text)
        for path in sorted(FOLDER.rglob("*.py"))
        for name, value, text in _constants(path)
        if _is_number(value)
    ]
    assert len(numbers) > 100
    assert [(path, name) for path, name, text in numbers if not text] == []
