"""The judgement of a case: the right numbers, or one sentence."""

from collections.abc import Callable
from pathlib import Path

from rig.errors import RigError


def refused_or_right(folder: Path, work: Callable[[], None]) -> str:
    try:
        work()
    except RigError as error:
        sentence = str(error)
        assert sentence.startswith("/"), f"names no file: {sentence[:300]}"
        assert sentence.isprintable(), f"not one printable line: {sentence[:300]!r}"
        assert len(sentence) < 2000, f"a sentence of {len(sentence)} characters: {sentence[:300]}"
        assert "memory" not in sentence, "needs too much memory"
        assert not list(folder.glob("*.part")), f"leaves {list(folder.glob('*.part'))}"
        return "refused"
    return "right"
