"""What law an unmeasured force follows: its time history regressed on laws of the motion at its place."""

from dataclasses import replace

import numpy as np

from identify.gaps.unknown.descent import begun_at, ended
from identify.gaps.unknown.forms import FORMS
from identify.gaps.unknown.law import ForceLaw, fitted, solved, tone_of
from identify.gaps.unknown.time_history import ForceHistory, softened

AS_GOOD = 0.02
"""A law keeps enough if no other keeps more of the free force's gain by more than this."""
FINISHED = 2


def laws(history: ForceHistory) -> tuple[ForceLaw, ...]:
    """Every law with its best numbers, those that keep most first.

    Those that need the slow motion are tried if no other serves; the best of them only to the end.
    """
    quick = [_toned(history), *(fitted(history, form) for form in FORMS if not form.slow)]
    slow: list[ForceLaw] = []
    if max(law.share for law in quick) < 1 - AS_GOOD:
        begun = sorted((begun_at(history, form) for form in FORMS if form.slow), key=lambda one: -one[1].law.share)
        finished = [ended(history, *one).law for one in begun[:FINISHED]]
        slow = finished + [
            replace(state.law, share=min(state.law.share, finished[-1].share)) for _, state in begun[FINISHED:]
        ]
    return tuple(sorted(quick + slow, key=lambda law: -law.share))


def shortest(found: tuple[ForceLaw, ...], least: float) -> ForceLaw | None:
    """The shortest law that keeps about as much as the best, if that is at least this share of the free force's."""
    enough = [law for law in found if law.share >= found[0].share - AS_GOOD]
    best = min(enough, key=lambda law: (law.form.length, -law.share))
    return best if best.share >= least else None


def _toned(history: ForceHistory) -> ForceLaw:
    """At the line where the free force is strongest, and a little beside; a tone is a tone to the last line."""
    history = softened(history, 0.0)
    form = tone_of(history)
    record = history.located.observed.record
    spectrum = np.abs(np.fft.rfft(history.found_n * history.counted))[: record.omega.size]
    spectrum[: history.located.observed.lines.start] = 0.0
    peak, step = int(np.argmax(spectrum)), record.omega[2] / (4 * np.pi)
    middle = record.omega[peak] / (2 * np.pi)
    seen = [middle + k * step / 2 for k in range(-2, 3)]
    start = max(seen, key=lambda hz: solved(history, form, hz)[1])
    return fitted(history, form, (start - step / 2, start + step / 2))
