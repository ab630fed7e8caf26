"""The one error that a user sees: a sentence saying what is wrong, with which value, and what to do."""

import unicodedata
from collections.abc import Iterable
from difflib import get_close_matches

LONGEST = 1500
_OBEYED = {"Cc", "Cf", "Cs", "Zl", "Zp"}


class RigError(ValueError):
    """Input that cannot be used. Its text is one sentence for the user; the commands print it and exit with 1.

    What it quotes of a file may be anything: it is made one printable line of at most some 1500 characters.
    """

    def __init__(self, sentence: str) -> None:
        super().__init__(one_line(sentence))

    def noting(self, note: str) -> "RigError":
        """The same error, a note behind its sentence."""
        return RigError(f"{self} {note}")


class TooLargeError(RigError):
    """Error: this would take more memory than its file may."""


class CutOffError(RigError):
    """A recording that could not be written to its end, though what was written of it is kept."""

    def __init__(self, sentence: str, strerror: str) -> None:
        super().__init__(sentence)
        self.strerror = strerror


def meant(word: str, known: Iterable[str]) -> str:
    """The known word that is most like one that is not known, as a question in brackets; empty if none is."""
    return "".join(f" (did you mean {found!r}?)" for found in get_close_matches(word, known, 1))


def is_plain(text: str) -> bool:
    """True if it has no character that a terminal or a page would obey: control characters, line ends and such."""
    return (text.isascii() and text.isprintable()) or not any(unicodedata.category(c) in _OBEYED for c in text)


def one_line(text: str) -> str:
    """The text with line ends and the like as escapes, and without its middle if it is too long."""
    if len(text) > LONGEST:
        text = f"{text[: LONGEST // 2]} [...] {text[-LONGEST // 2 :]}"
    return text if text.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
