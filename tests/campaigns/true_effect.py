"""What the true effects of a blind case achieve at their true parameters, and so their detection limits.

The limits are laid once, when the cases are made, and sealed: they do not move with the program that is scored. So the
temperature and the priors that they ask for are those of the release that set them, not those in use.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from math import comb
from pathlib import Path

import msgspec
import numpy as np

from identify.gaps.decision.comparison import mismatch_size, nominal_misfit_with_same_nuisance
from identify.gaps.decision.recordings import without_faulty_channels
from identify.gaps.residual.likelihood import Misfit, NominalVariances, misfit, nominal_variances_of
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.results import Matters
from identify.gaps.search.candidates import candidates, effect_range_scale
from identify.gaps.search.nominal import fit_nuisance
from rig.commands.tasks import run_tasks
from rig.effects import effect_named
from rig.errors import RigError
from rig.model.description import Rig
from rig.model.tolerances import LABORATORY
from rig.recording import read
from tests.campaigns.worlds.truth import Case

TEMPERATURE = 6.0
PRIOR_NOTHING, PRIOR_ONE, PRIOR_TWO = 0.3, 0.35, 0.15
FURTHER = PRIOR_TWO / PRIOR_ONE
"""Each further effect is so much less likely."""


class ToLay(msgspec.Struct, frozen=True):
    """The recordings of a case, and its true effects if the library has them."""

    fit: str
    validate: str
    effects: tuple[str, ...]


class TrueEffect(msgspec.Struct, frozen=True):
    """What one true effect achieves on the validation record, beside the others.

    made is what it changes, in units of what matters; gain by how much it lowers -2 ln p, and needed by how much it
    must to be likelier than without it.
    """

    made: float
    gain: float
    needed: float | None
    """None where the library does not offer the effect for such a record."""

    @property
    def above(self) -> bool:
        """Above its limit."""
        return self.made >= 1 and self.needed is not None and self.gain > self.needed

    def limit(self, strength: float) -> float:
        """The strength of the limit, by that of the case: changes grow with it, gains with its square."""
        if self.needed is None or self.gain <= 0 or self.made <= 0:
            return float("inf")
        return float(strength * max(np.sqrt(self.needed / self.gain), 1 / self.made))


class Best(msgspec.Struct, frozen=True):
    """before is the size of the gap, in units of what matters.

    refusal says why the records allow no limits, which then lie above every effect.
    """

    before: float
    effects: tuple[TrueEffect, ...] = ()
    refusal: str = ""


def best_of(cases: Sequence[Case], recordings: Path, kept: Path, dask: str | None = None) -> list[Best]:
    """Of every case; of nulls and of effects outside the library it is the gap alone."""
    tasks = []
    for case in cases:
        fit, validate = (str(recordings / f"{case.case}{end}.mcap") for end in ("", "_validate"))
        inside = case.effects if case.kind != "outside" else ()
        tasks.append(ToLay(fit, validate, tuple(e.text for e in inside)))
    return run_tasks(achieved, tasks, Best, kept, dask)


def achieved(task: ToLay) -> Best:
    """What the diagnosis would have found, had it been told."""
    try:
        return _achieved(task)
    except RigError as error:
        return Best(0.0, refusal=str(error))


def _achieved(task: ToLay) -> Best:
    (_, validation), _ = without_faulty_channels(read(Path(task.fit)), read(Path(task.validate)))
    record = record_of(validation, tolerances=validation.rig.tolerances or LABORATORY)
    reference, matters = nominal_variances_of(linearized(record, record.rig)), Matters()
    alone = misfit(record, reference, fit_nuisance(record, record.rig)[1])
    before = mismatch_size(alone, matters)
    if not task.effects:
        return Best(before)
    left, without = _laid(record, reference, task.effects, alone)
    known = candidates(effect_range_scale(record, record.rig), [s.name for s in record.sensors], record.zero_known)
    placed = Counter(c.kind.name for c in known)
    found = []
    for k, effect in enumerate(task.effects):
        others = task.effects[:k] + task.effects[k + 1 :]
        rest = _laid(record, reference, others, alone)[0] if others else alone
        # of a single effect, what the believed rig leaves with its nuisance parameters, as the verdict has it
        behind = mismatch_size(rest if others else without, matters)
        made = float(np.sqrt(max(behind**2 - mismatch_size(left, matters) ** 2, 0.0)))
        found.append(TrueEffect(made, rest.minus_two_log - left.minus_two_log, needed(effect, others, placed)))
    return Best(before, tuple(found))


def needed(effect: str, others: Sequence[str], placed: Mapping[str, int]) -> float | None:
    """2 TEMPERATURE (ln prior without the effect - ln prior with it), of those that the library offers."""
    name, *fewer = (text.partition(":")[0] for text in (effect, *others))
    if not placed.get(name):
        return None
    fewer = [one for one in fewer if placed.get(one)]
    return 2 * TEMPERATURE * (log_prior(fewer, placed) - log_prior([name, *fewer], placed))


def log_prior(effects: Sequence[str], placed: Mapping[str, int]) -> float:
    """Of effects at one place each; `placed` counts the places of every effect of the library."""
    count = len(effects)
    if not count:
        return float(np.log(PRIOR_NOTHING))
    among = PRIOR_ONE * FURTHER ** (count - 1) / max(1, comb(len(placed), count))
    return float(np.log(among) - sum(np.log(placed[name]) for name in effects))


def _laid(record: Record, reference: NominalVariances, effects: Sequence[str], alone: Misfit) -> tuple[Misfit, Misfit]:
    """What the rig with these effects leaves, and the believed one with its nuisance parameters."""
    rig: Rig = record.rig
    for text in effects:
        rig = effect_named(text).applied_to(rig)
    linearization, at = fit_nuisance(record, rig)
    return misfit(record, reference, at), nominal_misfit_with_same_nuisance(
        record, reference, linearization, at
    ) or alone
