"""Modules stay short enough to be read at once."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
LONGEST = 350


def test_no_module_is_longer_than_350_lines():
    lengths = {
        path.relative_to(ROOT).as_posix(): len(path.read_text(encoding="utf-8").splitlines())
        for package in ("rig", "identify", "scenarios")
        for path in (ROOT / package).rglob("*.py")
    }
    assert len(lengths) > 200
    assert not {name: lines for name, lines in lengths.items() if lines > LONGEST}
