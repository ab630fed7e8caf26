"""Errors for users: one sentence with what is wrong, the value, and what to do."""

import unicodedata
from collections.abc import Iterable
from difflib import get_close_matches

MAX_SENTENCE_LENGTH = 1500
_CONTROL_CATEGORIES = {"Cc", "Cf", "Cs", "Zl", "Zp"}


class RigError(ValueError):
    """Input that cannot be used. Its text is one sentence for the user; the commands print it and exit with 1.

    What it quotes of a file may be anything: it is made one printable line of at most some 1500 characters.
    """

    def __init__(self, sentence: str) -> None:
        super().__init__(one_line(sentence))

    def with_note(self, note: str) -> "RigError":
        """Error with a note appended to its sentence."""
        return RigError(f"{self} {note}")


class TooLargeError(RigError):
    """Input that would take more memory than `rig.limits` allows for its file."""


class CutOffError(RigError):
    """A recording that could not be written to its end; the part that was written is kept."""

    def __init__(self, sentence: str, strerror: str) -> None:
        super().__init__(sentence)
        self.strerror = strerror


def hint(word: str, candidates: Iterable[str]) -> str:
    """Suggestion " (did you mean 'x'?)" of the candidate closest to an unknown word; empty if none is close."""
    return "".join(f" (did you mean {match!r}?)" for match in get_close_matches(word, candidates, 1))


def has_no_control_characters(text: str) -> bool:
    """True if the text has no control characters, line ends or other characters that a terminal or page obeys."""
    return (text.isascii() and text.isprintable()) or not any(
        unicodedata.category(character) in _CONTROL_CATEGORIES for character in text
    )


def one_line(text: str) -> str:
    """Text on one line: unprintable characters escaped, the middle cut out beyond MAX_SENTENCE_LENGTH characters."""
    if len(text) > MAX_SENTENCE_LENGTH:
        text = f"{text[: MAX_SENTENCE_LENGTH // 2]} [...] {text[-MAX_SENTENCE_LENGTH // 2 :]}"
    return text if text.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
