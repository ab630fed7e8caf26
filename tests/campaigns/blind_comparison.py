"""Sealed answers, opened only if they are those that were hashed, beside what was found of the same recordings."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, TypeVar

import msgspec

from rig.errors import RigError
from rig.files import write_bytes, write_json
from tests.campaigns.blind_diagnosis import Found, Refused
from tests.campaigns.scoreboard import ScoredCase, compared_cases
from tests.campaigns.true_effect import Best
from tests.campaigns.worlds.making import sha256_of
from tests.campaigns.worlds.truth import Case, Key

T = TypeVar("T")
Sealed = Literal["key", "limits"]
"""The answers, and what their true effects achieve: of every case by its name."""
MISSING: dict[Sealed, str] = {
    "key": "make the cases first",
    "limits": "lay the limits first, with the command `limits`",
}


def seal(value: object, folder: Path, name: Sealed) -> str:
    """Writes what is sealed, and its hash beside the recordings; returns that."""
    path = folder / "sealed" / f"{name}.json"
    write_json(value, path)
    digest = sha256_of(path)
    write_bytes(f"{digest}\n".encode(), folder / f"{name}.sha256")
    return digest


def unsealed(folder: Path, name: Sealed, kind: type[T]) -> T:
    """Raises RigError if it is not what was sealed."""
    path, hash_path = folder / "sealed" / f"{name}.json", folder / f"{name}.sha256"
    for wanted in (path, hash_path):
        if not wanted.exists():
            raise RigError(f"{wanted}: is missing; {MISSING[name]}")
    if sha256_of(path) != hash_path.read_text().strip():
        raise RigError(f"{path}: is not what was sealed: its hash differs from {hash_path}; make the cases anew")
    return decoded(path, kind)


def opened(folder: Path) -> Key:
    """The sealed answers; raises RigError if they are not those whose hash was published."""
    return unsealed(folder, "key", Key)


def limits_of(folder: Path, answers: Sequence[Case]) -> list[Best]:
    """The sealed limits, in the order of the answers."""
    known = unsealed(folder, "limits", dict[str, Best])
    return [known[answer.case] for answer in answers]


def check_recordings(folder: Path, answers: Sequence[Case]) -> None:
    """Raises RigError unless every recording is the one that the answers were written for."""
    for answer in answers:
        for name, digest in answer.sha256.items():
            path = folder / "recordings" / name
            if not path.exists():
                raise RigError(f"{path}: is missing; make the cases anew in another folder")
            if sha256_of(path) != digest:
                raise RigError(f"{path}: is not the recording that was sealed; make the cases anew in another folder")


def beside(
    answers: Sequence[Case], found: Sequence[Found], refused: Sequence[Refused] = ()
) -> list[tuple[Case, Found | Refused]]:
    """What was found, or that the diagnosis was refused, in the order of the answers.

    Raises RigError where it is missing or of another recording.
    """
    by_case: dict[str, Found | Refused] = {f.case: f for f in found}
    by_case |= {r.case: r for r in refused}
    for answer in answers:
        if answer.case not in by_case:
            raise RigError(f"{answer.case}: was not diagnosed; run diagnose on all cases")
        if by_case[answer.case].sha256 != answer.sha256:
            raise RigError(f"{answer.case}: another recording was diagnosed than was sealed; run diagnose again")
    return [(answer, by_case[answer.case]) for answer in answers]


def refused_in(folder: Path) -> list[Refused]:
    """The cases that `diagnose` refused, with their sentences; a folder of before has no such file."""
    path = folder / "refused.json"
    return decoded(path, list[Refused]) if path.exists() else []


def pairs_of(cases: Path, found: Path, also: Sequence[str]) -> list[tuple[Path, Path]]:
    """Folders of cases with those of what was found; `also` as CASES:FOUND."""
    pairs = [(cases, found)]
    for text in also:
        one, colon, other = text.partition(":")
        if not (one and colon and other):
            raise RigError(f"--also {text}: is not CASES:FOUND; name a folder of cases and one of what was found")
        pairs.append((Path(one), Path(other)))
    return pairs


def by_world(pairs: Sequence[tuple[Path, Path]]) -> dict[str, list[ScoredCase]]:
    """Everything compared, world by world."""
    worlds: dict[str, list[tuple[Case, Found | Refused, Best]]] = {}
    for cases, folder in pairs:
        key = opened(cases)
        check_recordings(cases, key.cases)
        answered = beside(key.cases, decoded(folder / "found.json", list[Found]), refused_in(folder))
        best = limits_of(cases, key.cases)
        worlds.setdefault(key.world, []).extend((*pair, one) for pair, one in zip(answered, best, strict=True))
    return {world: compared_cases(rows) for world, rows in worlds.items() if rows}


def decoded(path: Path, kind: type[T]) -> T:
    """A file of JSON; raises RigError if it cannot be read or is of something else."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except OSError as error:
        raise RigError(f"{path}: cannot be read ({error.strerror}); give the right place") from error
    except msgspec.DecodeError as error:
        raise RigError(f"{path}: {error}; make it anew") from error
