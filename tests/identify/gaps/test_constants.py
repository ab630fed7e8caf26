"""The README's tables name every constant of the diagnosis."""

import ast
from pathlib import Path

import identify.gaps

FOLDER = Path(*identify.gaps.__path__)


def _constants(path):
    for node in ast.parse(path.read_text()).body:
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        for target in targets:
            for one in getattr(target, "elts", [target]):
                if isinstance(one, ast.Name) and one.id.isupper():
                    yield one.id


def test_the_readme_names_every_constant():
    text = (FOLDER / "README.md").read_text()
    files = sorted(FOLDER.rglob("*.py"))
    names = {(path.name, name) for path in files for name in _constants(path)}
    assert len(names) > 100
    assert not [(file, name) for file, name in names if f"`{name}`" not in text]
