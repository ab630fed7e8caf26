"""A diagnosis: recordings prepared, effects searched, hypotheses judged, the answer described."""

from collections.abc import Callable, Sequence
from pathlib import Path

from identify.gaps.decision.describe import describe
from identify.gaps.decision.hypotheses import search
from identify.gaps.decision.judge import judge
from identify.gaps.decision.prepare import Simulator, prepare
from identify.gaps.results import Gap, Matters
from rig.model.description import Rig
from rig.model.tolerances import Tolerances
from rig.recording import Recording

__all__ = ["Simulator", "diagnose"]

MATTERS = Matters()

Progress = Callable[[str, float], None]


def diagnose(
    recordings: Recording | Sequence[Recording],
    validation: Recording | None,
    simulator: Simulator,
    kept: Path | None = None,
    progress: Progress = lambda *_: None,
    tolerances: Tolerances | None = None,
    matters: Matters = MATTERS,
    ask_next: bool = False,
) -> tuple[Gap, Rig]:
    """The diagnosis, and the rig corrected by it (the believed one, if no effect explains the gap at least in part).

    `validation` may be one of the recordings, or another; None: the last of several, or the last part of a single one.
    Of several that are fitted, the one of the strongest force is searched; then all share the parameters of what was
    found there, and what differs between the records is told. The null reference is made by the simulator, or read from
    `kept` (see `null_reference`); tolerances say how exactly the rig is believed (else the rig itself does, else they
    are a laboratory's). Raises RigError if the records do not fit together or allow no diagnosis. With ask_next the
    next experiment is computed where two causes stay alike.
    """

    def causes(begin: float, end: float) -> Callable[[float], None]:
        return lambda share: progress("causes", begin + (end - begin) * share)

    prepared = prepare(
        recordings, validation, simulator, kept, tolerances, lambda share: progress("null_reference", share)
    )
    searched = search(prepared, causes(0.0, 0.7))
    judgement = judge(prepared, searched, matters, causes(0.7, 0.9))
    gap = describe(prepared, searched, judgement, matters, ask_next, causes(0.9, 1.0))
    return gap, judgement.decision.corrected_rig or prepared.validation.record.rig
