"""Gross faults of channels, force or rig.json: the one change after which the linear model fits the record."""

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from msgspec.structs import replace
from scipy.optimize import minimize_scalar

from identify.checks.channels import channel_finding, force_finding, usual_factor
from identify.checks.findings import Finding, named
from identify.checks.prediction import LinearCheck, linear_check
from identify.checks.spectra import Spectra
from rig.model.beam import Beam
from rig.model.description import Body, Rig, Station

SOUND = 0.3
"""A larger misfit is no matter of tolerances."""
CURED = 0.5
"""A change that leaves more of the misfit than this share, and no sound fit, explains nothing."""
FACTOR = 3.0


@dataclass(frozen=True)
class Gross:
    """What was found; the channels that may be believed, and whether the rest fits the model."""

    findings: tuple[Finding, ...]
    kept: list[int]
    sound: bool


def gross(rig: Rig, spectra: Spectra, usable: list[int]) -> Gross:
    """Single channels first, then the force, pairs of channels, bodies and rig.json: what leaves the least misfit."""
    check = linear_check(rig, spectra, usable)
    if len(usable) <= check.contacts:
        return Gross((), usable, True)
    misfit = check.predicted(usable).misfit
    if misfit < SOUND:
        return Gross((), usable, True)
    trials = [*_channels(rig, spectra, usable), *_force(check, usable), *_swaps(rig, spectra, usable)]
    if min((t.misfit for t in trials), default=np.inf) > SOUND:
        trials += [*_bodies(rig, spectra, usable), *_rigs(rig, spectra, usable)]
    best = min(trials, key=lambda t: t.misfit)
    if best.misfit < SOUND:
        return Gross((best.finding(),), best.kept, best.sensors_alone)
    found = _several(rig, spectra, usable)
    if found is not None:
        return found
    if best.misfit < CURED * misfit:
        return Gross((best.finding(),), best.kept, False)
    return Gross((_nothing(misfit),), usable, False)


@dataclass(frozen=True)
class _Trial:
    """A change and what it leaves; sensors_alone: that the rest of the record and rig.json are right as they are."""

    misfit: float
    kept: list[int]
    finding: Callable[[], Finding]
    sensors_alone: bool = True


def _nothing(misfit: float) -> Finding:
    return Finding(
        cause="model",
        evidence="the sensors do not move as the linear bodies of rig.json do under the force and any contact forces "
        f"(off by {100 * 0.03 * np.sqrt(misfit):.2g} % of the motion)",
        mend="check geometry, ends, stations and units in rig.json, and that the record is of this rig",
    )


def _channels(rig: Rig, spectra: Spectra, usable: list[int]) -> Iterator[_Trial]:
    for channel in usable:
        kept = [i for i in usable if i != channel]
        check = linear_check(rig, spectra, kept)
        found = check.predicted(kept)
        if np.isfinite(found.misfit):
            yield _Trial(found.misfit, kept, lambda c=channel, k=check, f=found: _of_channel(k, c, f.acceleration))


def _of_channel(check: LinearCheck, channel: int, predicted: np.ndarray) -> Finding:
    return channel_finding(check.spectra, channel, predicted, 1 / check.scale[channel])


def _force(check: LinearCheck, usable: list[int]) -> Iterator[_Trial]:
    found = check.predicted(usable, force=False)
    if np.isfinite(found.misfit):
        size = np.abs(check.accelerance[0][usable])
        weight = np.sqrt(np.mean((size / check.scale[usable]) ** 2, axis=0))
        yield _Trial(found.misfit, usable, lambda: force_finding(check.spectra, found.force, weight), False)


def _swaps(rig: Rig, spectra: Spectra, usable: list[int]) -> Iterator[_Trial]:
    for one, other in combinations(usable, 2):
        rows = spectra.acceleration.copy()
        rows[[one, other]] = rows[[other, one]]
        names = tuple(spectra.sensors[i].name for i in (one, other))
        swapped = linear_check(rig, spectra.with_rows(rows), usable).predicted(usable).misfit
        yield _Trial(
            swapped,
            [i for i in usable if i not in (one, other)],
            lambda names=names: Finding(
                cause="swapped",
                channels=names,
                evidence=f"{names[0]} and {names[1]} fit the model if they change places",
                mend="swap their cables, or their columns in the import map",
            ),
        )


def _bodies(rig: Rig, spectra: Spectra, usable: list[int]) -> Iterator[_Trial]:
    """All channels of a body by one factor or delay: as if it had an instrument of its own."""
    for body in rig.bodies:
        own = [i for i in usable if spectra.sensors[i].station.body == body.name]
        rest = [i for i in usable if i not in own]
        if not own or not rest:
            continue
        for what, factors in (("sign", (-1.0,)), ("unit", (9.80665, 1 / 9.80665, 1e3, 1e-3, 1e6, 1e-6, 100.0, 0.01))):
            for factor in factors:
                rows = spectra.acceleration.copy()
                rows[own] /= factor
                trial = linear_check(rig, spectra.with_rows(rows), usable).predicted(usable).misfit
                yield _Trial(trial, rest, lambda f=factor, w=what, o=own, b=body.name: _of_body(spectra, o, b, w, f))


def _of_body(spectra: Spectra, own: list[int], body: str, what: str, factor: float) -> Finding:
    names = tuple(spectra.sensors[i].name for i in own)
    if what == "sign":
        return Finding(
            cause="polarity",
            channels=names,
            of=body,
            evidence=f"all channels of {body} have the opposite sign of what the model and the others predict",
            mend="turn them with scale = -1 in the import map",
        )
    return Finding(
        cause="units",
        channels=names,
        of=body,
        evidence=f"all channels of {body} deliver {factor:.4g} times what the model and the others predict",
        mend=f"correct their unit in the import map; it looks like {usual_factor(factor)}",
    )


def _rigs(rig: Rig, spectra: Spectra, usable: list[int]) -> Iterator[_Trial]:
    def misfit(other: Rig, own: Spectra = spectra) -> float:
        return linear_check(other, own, usable).predicted(usable).misfit

    def scaled(make: Callable[[float], Rig]) -> tuple[float, float]:
        grid = np.linspace(-np.log(FACTOR), np.log(FACTOR), 13)
        sizes = [misfit(make(float(np.exp(x)))) for x in grid]
        k = int(np.argmin(sizes))
        bounds = (grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)])
        found = minimize_scalar(
            lambda x: misfit(make(float(np.exp(x)))), bounds=bounds, method="bounded", options={"xatol": 1e-3}
        )
        return float(np.exp(found.x)), float(found.fun)

    for body in rig.bodies:
        for other, sentence in _other_ends(body):
            yield _Trial(
                misfit(_with_body(rig, other)),
                usable,
                lambda b=body, s=sentence: Finding(
                    cause="ends", of=b.name, evidence=f"{b.name} moves as a beam that is {s}", mend="correct its ends"
                ),
                False,
            )
        if body.length_m:
            mirrored = _mirrored(spectra, body)
            yield _Trial(
                misfit(rig, mirrored),
                usable,
                lambda b=body: Finding(
                    cause="mirrored",
                    of=b.name,
                    channels=tuple(s.name for s in spectra.sensors if s.station.body == b.name),
                    evidence=f"the channels of {b.name} fit if their positions count from its other end",
                    mend="correct the positions in rig.json",
                ),
                False,
            )
        mass, left = scaled(lambda x, b=body: _with_body(rig, b.scale_mass(x)))
        yield _Trial(left, usable, lambda b=body, x=mass: _mass(b.name, x), False)
        dense, left = scaled(lambda x, b=body: _with_body(rig, b.scale_mass(x).scale_frequencies(x**-0.5)))
        yield _Trial(left, usable, lambda b=body, x=dense: _density(b.name, x), False)
        stiff, left = scaled(lambda x, b=body: _with_body(rig, b.scale_frequencies(x)))
        yield _Trial(left, usable, lambda b=body, x=stiff: _frequency(b.name, x), False)
    fast, left = scaled(lambda x: replace(rig, bodies=tuple(b.scale_frequencies(x) for b in rig.bodies)))
    yield _Trial(left, usable, lambda: _clock(fast), False)


def _with_body(rig: Rig, body: Body) -> Rig:
    return replace(rig, bodies=tuple(body if b.name == body.name else b for b in rig.bodies))


def _other_ends(body: Body) -> Iterator[tuple[Body, str]]:
    if isinstance(body, Beam):
        for ends, said in (("free-free", "free at both ends"), ("clamped-free", "clamped at its left end")):
            if body.ends != ends:
                yield replace(body, ends=ends), said


def _mirrored(spectra: Spectra, body: Body) -> Spectra:
    def turned(station: Station) -> Station:
        return replace(station, position_m=body.length_m - station.position_m)

    sensors = tuple(replace(s, station=turned(s.station)) if s.station.body == body.name else s for s in spectra.sensors)
    return dataclasses.replace(spectra, sensors=sensors)


def _mass(body: str, factor: float) -> Finding:
    return Finding(
        cause="mass",
        of=body,
        evidence=f"{body} moves as if its mass were {factor:.4g} times what rig.json says",
        mend="weigh it and correct rig.json, or check the force's unit",
    )


def _density(body: str, factor: float) -> Finding:
    return Finding(
        cause="mass",
        of=body,
        evidence=f"{body} moves as if its density were {factor:.4g} times what rig.json says",
        mend="weigh it and correct its density in rig.json",
    )


def _frequency(body: str, factor: float) -> Finding:
    return Finding(
        cause="frequency",
        of=body,
        evidence=f"{body} vibrates at {factor:.4g} times the frequencies of rig.json",
        mend="correct its stiffness, thickness or length in rig.json by a modal test",
    )


def _clock(factor: float) -> Finding:
    return Finding(
        cause="clock",
        evidence=f"all bodies vibrate at {factor:.5g} times the frequencies of rig.json",
        mend=f"check the sampling rate: the clock seems to be {100 * abs(1 - 1 / factor):.2g} % "
        f"{'fast' if factor < 1 else 'slow'}",
    )


def _several(rig: Rig, spectra: Spectra, usable: list[int]) -> Gross | None:
    """Channel after channel is left out, the worst first, while more than contacts and one are left."""
    kept, left_out = list(usable), list[int]()
    while len(kept) > len(rig.contacts) + 2:
        trials = []
        for channel in kept:
            rest = [i for i in kept if i != channel]
            trials.append((linear_check(rig, spectra, rest).predicted(rest).misfit, channel))
        misfit, worst = min(trials)
        kept, left_out = [i for i in kept if i != worst], [*left_out, worst]
        if misfit < SOUND:
            check = linear_check(rig, spectra, kept)
            predicted = check.predicted(kept).acceleration
            return Gross(tuple(_of_channel(check, c, predicted) for c in sorted(left_out)), kept, True)
    return None
