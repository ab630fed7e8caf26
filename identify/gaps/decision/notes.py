"""Side analyses of a diagnosis: a failure becomes a note beside the answer."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from identify.gaps.results import Analysis, FailedAnalysis
from rig.errors import RigError

Result = TypeVar("Result")


@dataclass(frozen=True)
class Attempt(Generic[Result]):
    """Result of a side analysis, or the note that says why there is none."""

    result: Result | None = None
    notes: tuple[FailedAnalysis, ...] = ()


def attempted(analysis: Analysis, compute: Callable[[], Result]) -> Attempt[Result]:
    """Result of a side analysis, or a note on any exception, as the answer does not rest on it."""
    try:
        return Attempt(compute())
    except RigError as error:
        return Attempt(notes=(FailedAnalysis(analysis, str(error)),))
    except Exception as error:
        return Attempt(notes=(FailedAnalysis(analysis, f"{type(error).__name__}: {error}"),))
