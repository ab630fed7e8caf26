"""From recordings to a diagnosis in words and numbers: the content of gap.json."""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from identify.gap.closure import closure, likeness
from identify.gap.diagnose import Explanation, Outcome, diagnosed
from identify.gap.doubts import moved
from identify.gap.faults import sound_channels
from identify.gap.floor import Floor, Floors, Simulate, floors_of
from identify.gap.results import Cause, Gap, Value
from identify.gap.spectra import Record, record_of
from identify.gap.where import where
from rig.description import Rig, to_json
from rig.errors import RigError
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording, Signals

FIT_SHARE = 0.55
"""Of a single record, what is fitted on; the rest validates."""
ALIKE = 0.15
"""Causes whose remainders on the validation record differ by less than this share cannot be told apart."""


def diagnose(
    recording: Recording,
    validation: Recording | None,
    simulate: Simulate,
    floor_file: Path | None,
    progress: Callable[[str, float], None] = lambda *_: None,
    tolerances: Tolerances = LABORATORY,
) -> tuple[Gap, Rig]:
    """The diagnosis, and the rig corrected by it (the believed one, if nothing explains the gap).

    The floor is made by the simulator, or read from floor_file; tolerances say how exactly the rig is believed. Raises
    RigError if the records do not fit together or allow no diagnosis.
    """
    if validation is None:
        recording, validation = _halves(recording)
    elif to_json(recording.rig) != to_json(validation.rig):
        raise RigError("the validation recording is of another rig (their rig.json differ); record the same rig twice")
    full = recording.rig
    force_n = loudest([recording, validation]).force_n
    floors = floors_of(full, force_n, simulate, lambda x: progress("floor", x), floor_file, tolerances)
    fit_part, faults = sound_channels(recording)
    other, more = sound_channels(validation, without=tuple(faults))
    if more:
        fit_part, _ = sound_channels(recording, without=tuple(more))
    faults |= more
    fit_record, other_record = (record_of(part, tolerances=tolerances) for part in (fit_part, other))
    outcome = diagnosed(fit_record, other_record, floors, lambda x: progress("causes", x))
    floor = floors.of(other_record)
    best = outcome.explanations[0] if outcome.verdict == "effect" else None
    corrected = fit_part.rig
    if best:
        found = best.fitted.residual
        corrected, _ = moved(best.rig, found.names, found.doubts, tolerances)
    simulated, likenesses, curves = likeness(other, fit_part.rig, corrected, simulate)
    after = best.validated if best else outcome.validation_nominal
    alike = _alike(outcome)
    gap = Gap(
        verdict=outcome.verdict,
        sentence=_sentence(outcome, faults) + _beyond(floors, other_record),
        size=outcome.validation_remainder.size,
        causes=tuple(
            _cause(e, p, floors.of(fit_record))
            for e, p in zip(outcome.explanations, outcome.probabilities, strict=True)
        ),
        equivalent=(tuple(alike),) if len(alike) > 1 else (),
        separate_by=tuple(f"{name}: {how}" for name, how in alike.items()) if len(alike) > 1 else (),
        where=where(outcome.validation, outcome.validation_nominal, floor),
        closure=closure(outcome.validation, outcome.validation_nominal, after, floor, simulated),
        likeness=likenesses,
        curves=curves,
        channel_faults=faults,
    )
    return gap, corrected


def loudest(recordings: Iterable[Recording]) -> Recording:
    """The one of the largest force (root mean square): the floor has to reach as far."""
    return max(recordings, key=lambda r: float(np.mean(r.force_n**2)))


def _beyond(floors: Floors, record: Record) -> str:
    if floors.hold(record):
        return ""
    most, own = 1e3 * floors.levels[-1].motion_m, 1e3 * record.motion_m
    return (
        f" The validation record moves more ({own:.3g} mm, root mean square) than the floor's nulls ({most:.3g} mm):"
        " remove the floor's file, and it is made anew."
    )


def _halves(recording: Recording) -> tuple[Recording, Recording]:
    """One record cut in two."""
    cut = round(FIT_SHARE * recording.samples)

    def part(keep: slice) -> Recording:
        signals = {n: Signals(s.channels, 0.0, s.values[:, keep]) for n, s in recording.signals.items()}
        return Recording(recording.rig, signals, recording.provenance)

    return part(slice(0, cut)), part(slice(cut, None))


def _cause(explanation: Explanation, probability: float, floor: Floor) -> Cause:
    """Standard errors hold what the effect leaves, and what it seems to explain where there is none."""
    parameters: dict[str, Value] = {}
    places: dict[str, str] = {}
    at = 0
    misfit = max(1.0, explanation.remainder.size)  # nulls leave one
    spread = np.sqrt(np.maximum(np.diag(explanation.fitted.covariance), 0.0) * misfit)
    for part in explanation.parts:
        spurious = max(1.0, floor.gains.get(part.kind.name, 0.0) / explanation.validated.strictness) ** 0.5
        for name, about in part.parameters.items():
            value = float(explanation.fitted.values[at])
            parameters[f"{part.kind.name}.{name}"] = Value(value, float(spread[at]) * spurious, about.unit)
            at += 1
        places |= {f"{part.kind.name}.{field}": place or "all" for field, place in part.place.items()}
    return Cause(explanation.effects, probability, parameters, places, explanation.remainder.size)


def _alike(outcome: Outcome) -> dict[str, str]:
    """Single effects that explain the validation record about as well as the best, with what would separate them."""
    if outcome.verdict != "effect" or len(outcome.explanations[0].parts) > 1:
        return {}
    least = outcome.explanations[0].validated.cost
    close = [e for e in outcome.explanations if len(e.parts) == 1 and e.validated.cost < (1 + ALIKE) * least]
    return {e.effects[0]: e.parts[0].kind.separated_by for e in close}


def _sentence(outcome: Outcome, faults: dict[str, str]) -> str:
    said = "".join(f" Channel {name} is {what} and was left out." for name, what in faults.items())
    size = outcome.validation_remainder.size
    if outcome.verdict == "no_gap":
        return f"No gap: the record is what the believed rig would give, as far as noise and integration show it.{said}"
    if outcome.verdict == "none_of_these":
        return f"There is a gap ({size:.3g} times the floor), and no effect of the library explains it.{said}"
    best = outcome.explanations[0]
    words = " and ".join(c.name.replace(":", " of ", 1) for c in best.parts)
    explain = "explains" if len(best.parts) == 1 else "together explain"
    left = best.remainder.size
    return (
        f"There is a gap ({size:.3g} times the floor); {words} {explain} it, down to {left:.3g} times the floor.{said}"
    )
