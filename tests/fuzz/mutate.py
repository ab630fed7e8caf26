"""What happens to a file: flips, cuts, regions doubled, moved or emptied, absurd lengths; in a text, absurd values."""

import re
import struct
from collections.abc import Callable

import numpy as np

_ABSURD = (
    "0 -0 -1 2 1e-320 1e-300 1e-9 1e9 1e18 1e300 1.7976931348623157e308 1e999 -1e999 NaN -Infinity nan inf 4294967296 "
    '18446744073709551616 0x10 1_0 1d3 1,5 +5 null true [] {} "x"'
)
NUMBERS = (*_ABSURD.encode().split(), b" ", b"9" * 400, b"[" * 20_000, b'{"a":' * 20_000)
_WORDS = (
    '"" "\\u0000" "../../x" "\\ud800" "NaN" "mm" "kN" "s" "beam" "a\\nb" "%s" "=" "/etc/passwd" "true" null 7 [1] '
    '"\U0001f4a5"'
)
TEXTS = (*_WORDS.encode().split(), b'"\xff"', b'"' + b"y" * 100_000 + b'"')
_NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
_TEXT = re.compile(rb'"[^"\n]*"')


def bytes_changed(rng: np.random.Generator, content: bytes) -> bytes:
    """One to three changes that know nothing of the format."""
    for _ in range(rng.integers(1, 4)):
        content = _BLIND[rng.integers(len(_BLIND))](rng, bytearray(content))
    return bytes(content)


def text_changed(rng: np.random.Generator, content: bytes) -> bytes:
    """Mostly one change of a text, up to three: of its numbers, its words, its lines, or blind ones."""
    for _ in range(1 + rng.integers(3) // 2 * rng.integers(3)):
        kind = rng.integers(5)
        if kind <= 1:
            content = _token_replaced(rng, content, _NUMBER, NUMBERS)
        elif kind == 2:
            content = _token_replaced(rng, content, _TEXT, TEXTS)
        elif kind == 3:
            content = _lines_changed(rng, content)
        else:
            content = bytes(_BLIND[rng.integers(len(_BLIND))](rng, bytearray(content)))
    return content


def cut(rng: np.random.Generator, content: bytes) -> bytes:
    return content[: int(rng.integers(len(content)))]


def _token_replaced(
    rng: np.random.Generator, content: bytes, pattern: re.Pattern[bytes], others: tuple[bytes, ...]
) -> bytes:
    found = [m.span() for m in pattern.finditer(content)]
    if not found:
        return content
    begin, end = found[rng.integers(len(found))]
    another = found[rng.integers(len(found))]  # now and then one that stands elsewhere
    new = content[slice(*another)] if rng.random() < 0.2 else others[rng.integers(len(others))]
    return content[:begin] + new + content[end:]


def _lines_changed(rng: np.random.Generator, content: bytes) -> bytes:
    lines = content.split(b"\n")
    one, other = rng.integers(len(lines), size=2)
    kind = rng.integers(4)
    if kind == 0:
        lines[one], lines[other] = lines[other], lines[one]
    elif kind == 1:
        del lines[one]
    elif kind == 2:
        lines.insert(other, lines[one])
    else:
        lines = [line + b"\r" for line in lines]
    return b"\n".join(lines)


def _region(rng: np.random.Generator, size: int) -> slice:
    """A region, as often short as long."""
    begin = int(rng.integers(size))
    return slice(begin, begin + int(2 ** rng.uniform(0, np.log2(size + 1))))


def _flipped(rng: np.random.Generator, content: bytearray) -> bytearray:
    for place in rng.integers(len(content) or 1, size=rng.integers(1, 9)):
        if content:
            content[place] ^= 1 << int(rng.integers(8))
    return content


def _flipped_in_front(rng: np.random.Generator, content: bytearray) -> bytearray:
    """Where formats keep what the rest is."""
    content[:4096] = _flipped(rng, content[:4096])
    return content


def _cut(rng: np.random.Generator, content: bytearray) -> bytearray:
    return content[: int(rng.integers(len(content) + 1))]


def _taken_out(rng: np.random.Generator, content: bytearray) -> bytearray:
    del content[_region(rng, len(content) or 1)]
    return content


def _doubled(rng: np.random.Generator, content: bytearray) -> bytearray:
    region = _region(rng, len(content) or 1)
    return content[: region.stop] + content[region] + content[region.stop :]


def _moved(rng: np.random.Generator, content: bytearray) -> bytearray:
    region = _region(rng, len(content) or 1)
    piece = content[region]
    del content[region]
    place = int(rng.integers(len(content) + 1))
    return content[:place] + piece + content[place:]


def _emptied(rng: np.random.Generator, content: bytearray) -> bytearray:
    region = _region(rng, len(content) or 1)
    content[region] = bytes(len(content[region]))
    return content


def _absurd_length(rng: np.random.Generator, content: bytearray) -> bytearray:
    """Eight, four or two bytes become a number that may be taken for a length."""
    for form, largest in (("<Q", 2**64 - 1), ("<I", 2**32 - 1), (">I", 2**32 - 1), ("<H", 2**16 - 1)):
        if rng.random() < 0.5:
            number = (largest, largest // 2, 2**31, 2**40, 0, 1)[rng.integers(6)] & largest
            place = int(rng.integers(min(len(content), 4096 if rng.random() < 0.5 else len(content)) or 1))
            content[place : place + struct.calcsize(form)] = struct.pack(form, number)
    return content


def _noise(rng: np.random.Generator, content: bytearray) -> bytearray:
    region = _region(rng, len(content) or 1)
    content[region] = rng.bytes(len(content[region]))
    return content


_BLIND: tuple[Callable[[np.random.Generator, bytearray], bytearray], ...] = (
    _flipped,
    _flipped_in_front,
    _cut,
    _taken_out,
    _doubled,
    _moved,
    _emptied,
    _absurd_length,
    _noise,
)
