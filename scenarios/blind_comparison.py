"""Sealed answers, opened only if they are those that were hashed, beside what was found of the same recordings."""

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import msgspec

from rig.errors import RigError
from scenarios.blind_diagnosis import Found, Refused
from scenarios.scoreboard import ScoredCase, compared_cases
from scenarios.true_effect import Best, best_of
from scenarios.worlds.making import sha256_of
from scenarios.worlds.truth import Case, Key

T = TypeVar("T")


def opened(folder: Path) -> Key:
    """The sealed answers; raises RigError if they are not those whose hash was published."""
    path, hash_path = folder / "sealed" / "key.json", folder / "key.sha256"
    for wanted in (path, hash_path):
        if not wanted.exists():
            raise RigError(f"{wanted}: is missing; make the cases first")
    if sha256_of(path) != hash_path.read_text().strip():
        raise RigError(f"{path}: is not what was sealed: its hash differs from {hash_path}; make the cases anew")
    return decoded(path, Key)


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
) -> list[tuple[Case, Found]]:
    """What was found, in the order of the answers, without the cases whose diagnosis was refused.

    Raises RigError where it is missing or of another recording.
    """
    by_case: dict[str, Found | Refused] = {f.case: f for f in found}
    by_case |= {r.case: r for r in refused}
    for answer in answers:
        if answer.case not in by_case:
            raise RigError(f"{answer.case}: was not diagnosed; run diagnose on all cases")
        if by_case[answer.case].sha256 != answer.sha256:
            raise RigError(f"{answer.case}: another recording was diagnosed than was sealed; run diagnose again")
    pairs = [(answer, by_case[answer.case]) for answer in answers]
    return [(answer, one) for answer, one in pairs if isinstance(one, Found)]


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


def by_world(pairs: Sequence[tuple[Path, Path]], kept: Path) -> dict[str, list[ScoredCase]]:
    """Everything compared, world by world; what the truth achieves is laid once and kept in a folder."""
    worlds: dict[str, list[tuple[Case, Found, Best]]] = {}
    for cases, folder in pairs:
        key = opened(cases)
        check_recordings(cases, key.cases)
        answered = beside(key.cases, decoded(folder / "found.json", list[Found]), refused_in(folder))
        tolerances = answered[0][1].tolerances if answered else None
        best = best_of([answer for answer, _ in answered], cases / "recordings", kept, tolerances)
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
