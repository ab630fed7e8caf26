"""Gross faults of channels, force or rig.json: the one change after which the linear model fits the record."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np
from jaxtyping import Float

from identify.checks.channels import channel_finding, channel_gain
from identify.checks.findings import Finding, merged
from identify.checks.force import force_finding
from identify.checks.prediction import LinearCheck, Predicted, linear_check
from identify.checks.relations import relation
from identify.checks.rigs import rig_trials
from identify.checks.spectra import Spectra
from identify.checks.trial import Trial
from rig.model.description import Rig

SOUND = 0.3
"""A larger misfit is no matter of tolerances."""
CURED = 0.5
"""A change that leaves more of the misfit than this share, and no sound fit, explains nothing."""
MUCH = 0.6
GAIN = 0.1
"""Of all gains that are fitted at once, those are named that are off by more."""
LATE_S = 3e-4
LEFT_OUT = 1.5
"""What frees a channel has to leave so much less."""
PARTS = 4


@dataclass(frozen=True)
class Gross:
    """Gross findings; the channels that may be believed, and whether the rest fits the model."""

    findings: tuple[Finding, ...]
    kept: list[int]
    sound: bool


def gross(rig: Rig, spectra: Spectra, usable: list[int], fine: Callable[[], Spectra], doubted: bool = False) -> Gross:
    """The change that leaves the least misfit: of a channel, a force, two channels that are swapped, all gains,
    rig.json; or several channels left out. `fine` gives the spectra on all lines.

    Of a record that fits well, but is doubted, only a change that fits much better is told.
    """
    check = linear_check(rig, spectra, usable)
    misfit = check.predicted(usable).misfit
    forces = list(_forces(check, usable))
    only = forces[0].findings() if len(forces) == 1 else ()  # of several a weak one follows the errors of the model
    wrong = [f for f in only if f.cause in ("force", "filtered")]
    if misfit < SOUND and (wrong or not doubted):
        return Gross(tuple(wrong), usable, not wrong)
    trials = [
        *forces,
        *_channels(rig, check, usable, fine),
        *_swaps(check, usable),
        *_gains(rig, check, usable),
        *rig_trials(rig, spectra, usable),
    ]
    best = min(trials, key=lambda t: t.misfit * t.allowance)
    if misfit < SOUND and best.misfit * best.allowance > MUCH * misfit:
        return Gross((), usable, True)
    if best.misfit >= SOUND:
        found = _several(rig, check, usable, fine)
        if found is not None:
            return found
        if best.misfit >= CURED * misfit:
            return Gross((_nothing(misfit),), usable, False)
    return Gross(best.findings(), best.kept, best.sensors_alone and best.misfit < SOUND)


def _nothing(misfit: float) -> Finding:
    return Finding(
        cause="model",
        evidence="the sensors do not move as the linear bodies of rig.json do under the force and any contact forces "
        f"(off by {min(3 * np.sqrt(misfit), 100):.2g} % of the motion)",
        mend="check geometry, ends, stations and units in rig.json, and that the record is of this rig",
    )


def _channels(rig: Rig, check: LinearCheck, usable: list[int], fine: Callable[[], Spectra]) -> Iterator[Trial]:
    for channel in usable:
        kept = [i for i in usable if i != channel]
        others = check.beside(check.spectra, kept)
        found = others.predicted(kept)
        if np.isfinite(found.misfit):
            yield Trial(
                found.misfit, kept, partial(_of_channel, rig, others, found, channel, kept, fine), allowance=LEFT_OUT
            )


def _of_channel(
    rig: Rig, check: LinearCheck, found: Predicted, channel: int, kept: list[int], fine: Callable[[], Spectra]
) -> tuple[Finding, ...]:
    return (channel_finding(rig, check, channel, found, lambda: _over_time(rig, fine(), channel, kept)),)


def _over_time(rig: Rig, spectra: Spectra, channel: int, kept: list[int]) -> Float[np.ndarray, " parts"] | None:
    """The delays of a channel against what the others predict, in each part of the record; None where it is lost."""
    check = linear_check(rig, spectra, kept)
    expected = check.predicted(kept).acceleration[channel]
    both = spectra.in_time(np.stack([spectra.acceleration[channel], expected]) / check.scale[channel])
    delays = []
    for measured, predicted in (p for p in np.array_split(both, PARTS, axis=1)):
        window = np.hanning(measured.size)
        lines = np.fft.rfft(measured * window), np.fft.rfft(predicted * window)
        omega = 2 * np.pi * np.fft.rfftfreq(measured.size, 1 / spectra.per_s)
        found = relation(omega[1:], lines[0][1:], lines[1][1:], np.ones(omega.size - 1))
        if found.coherence < 0.8:
            return None
        delays.append(found.delay_s)
    return np.array(delays) if np.ptp(delays) > LATE_S else None


def _forces(check: LinearCheck, usable: list[int]) -> Iterator[Trial]:
    for number in range(len(check.spectra.forces)):
        found = check.predicted(usable, doubted=number)
        if np.isfinite(found.misfit):
            yield Trial(found.misfit, usable, partial(_of_force, check, usable, number, found), False, LEFT_OUT)


def _of_force(check: LinearCheck, usable: list[int], number: int, found: Predicted) -> tuple[Finding, ...]:
    by_force = check.accelerance[number][usable]
    shown = by_force / check.scale[usable]
    if len(check.spectra.forces) > 1:  # what no contact force does too
        shown = check.projection(usable).of(by_force)[0]
    weight = np.sqrt(np.mean(np.abs(shown) ** 2, axis=0))
    return (force_finding(check.spectra, number, found.forces[number], weight),)


def _swaps(check: LinearCheck, usable: list[int]) -> Iterator[Trial]:
    spectra = check.spectra
    for one, other in combinations(usable, 2):
        rows = spectra.acceleration.copy()
        rows[[one, other]] = rows[[other, one]]
        names = spectra.sensors[one].name, spectra.sensors[other].name
        yield Trial(
            check.beside(spectra.with_rows(rows), usable).predicted(usable).misfit,
            [i for i in usable if i not in (one, other)],
            partial(_swapped, names),
        )
    for pair in combinations(range(len(spectra.forces)), 2):
        forces = spectra.forces.copy()
        forces[[*pair]] = forces[[*pair[::-1]]]
        names = spectra.force_names[pair[0]], spectra.force_names[pair[1]]
        left = check.beside(replace(spectra, forces=forces), usable).predicted(usable).misfit
        yield Trial(left, usable, partial(_swapped, names), False)


def _swapped(names: tuple[str, str]) -> tuple[Finding, ...]:
    return (
        Finding(
            cause="swapped",
            channels=names,
            evidence=f"{names[0]} and {names[1]} fit the model if they change places",
            mend="swap their cables, or their columns in the import map",
        ),
    )


def _gains(rig: Rig, check: LinearCheck, usable: list[int]) -> Iterator[Trial]:
    """All channels' gains by linear least squares: the factors of the channels that bring the projected residual down.

    Polarities, units and gains of several channels at once. Two rounds, the second in the scale of the first.
    """
    spectra, gains = check.spectra, np.ones(len(check.spectra.sensors))
    rows = spectra.acceleration
    for _ in range(3):
        check = check.beside(spectra.with_rows(rows), usable)
        projection = check.projection(usable)
        columns = np.array([projection.of(rows[[i]], [k])[0].ravel() for k, i in enumerate(usable)])
        target = projection.of(check.by_force[usable])[0].ravel()
        normal, wanted = (columns.conj() @ columns.T).real, (columns.conj() @ target).real
        factors = np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(len(usable)), wanted)
        if not np.all(np.isfinite(factors)) or np.any(np.abs(factors) < 1e-9):
            return
        rows = rows.copy()
        rows[usable] *= factors[:, None]
        gains[usable] /= factors
    left = check.beside(spectra.with_rows(rows), usable).predicted(usable).misfit
    off = [i for i in usable if abs(gains[i] - 1) > GAIN]
    if off:
        yield Trial(
            left,
            [i for i in usable if i not in off],
            lambda: merged([channel_gain(spectra.sensors[i].name, float(gains[i])) for i in off], rig),
            allowance=LEFT_OUT**2,
        )


def _several(rig: Rig, check: LinearCheck, usable: list[int], fine: Callable[[], Spectra]) -> Gross | None:
    """Channel after channel is left out, the worst first, while three more than the contacts are left."""
    kept, left_out = list(usable), list[int]()
    while len(kept) > len(rig.contacts) + 3 and len(left_out) < len(usable) / 2:
        trials = []
        for channel in kept:
            rest = [i for i in kept if i != channel]
            trials.append((check.beside(check.spectra, rest).predicted(rest).misfit, channel))
        misfit, worst = min(trials)
        kept, left_out = [i for i in kept if i != worst], [*left_out, worst]
        if misfit < SOUND:
            check = check.beside(check.spectra, kept)
            predicted = check.predicted(kept)
            found = [f for c in sorted(left_out) for f in _of_channel(rig, check, predicted, c, kept, fine)]
            return Gross(merged(found, rig), kept, True)
    return None
