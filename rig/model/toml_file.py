"""Reading an untrusted TOML file: import maps and tolerances."""

import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from rig.errors import RigError
from rig.files import contents
from rig.limits import MAX_DEPTH
from rig.model.decoding import explained

T = TypeVar("T")
MAX_TOML_BYTES = 1_000_000
_KEY_PART = r"""(?:(?<![\w-])[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')"""
DEEP_KEY = re.compile(rf"(?:{_KEY_PART}[ \t]*+\.[ \t]*+){{{MAX_DEPTH}}}")
"""A dotted key of more than MAX_DEPTH parts, whose parsing takes quadratic time and memory."""


def read_toml(
    path: Path, kind: type[T], label: str, described_in: str, check: Callable[[dict[str, Any]], None] = lambda _: None
) -> T:
    """Content of a TOML file as `kind`; raises RigError if it is invalid, too large, or has too deep a key.

    `check` sees the values first, and may raise a RigError of its own.
    """
    error_prefix = f"{path}: is no {label}"
    try:
        content = contents(path)
        if len(content) > MAX_TOML_BYTES:
            raise RigError(f"{error_prefix}: it has more than {MAX_TOML_BYTES // 1000} kB; see {described_in}")
        text = content.decode()
        if DEEP_KEY.search(text):
            raise RigError(f"{error_prefix}: it has a key of more than {MAX_DEPTH} parts; see {described_in}")
        decoded = tomllib.loads(text)
        check(decoded)
        return msgspec.convert(decoded, kind)
    except RigError:
        raise
    except UnicodeDecodeError as error:
        raise RigError(f"{error_prefix}: it is not text in UTF-8; save it so") from error
    except RecursionError as error:
        raise RigError(f"{error_prefix}: its values are nested too deep; see {described_in}") from error
    except msgspec.ValidationError as error:
        raise RigError(f"{error_prefix} ({explained(error, decoded, kind)})") from error
    except tomllib.TOMLDecodeError as error:
        raise RigError(f"{error_prefix} ({error}); see {described_in}") from error
    except ValueError as error:
        raise RigError(f"{error_prefix}: it has a number of too many digits; see {described_in}") from error
