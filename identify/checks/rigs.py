"""Changes of rig.json that would make a record fit: mass, density, frequencies, damping, ends, places, the clock."""

import dataclasses
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from msgspec.structs import replace
from scipy.optimize import minimize_scalar

from identify.checks.findings import Finding, spoken
from identify.checks.prediction import linear_check
from identify.checks.spectra import Spectra
from identify.checks.trial import Trial
from identify.linear.model import ResponseCache
from rig.model.description import Body, Rig, Station

FACTOR = 3.0
"""Masses and frequencies are sought within this factor."""
PLACES = 21


def rig_trials(rig: Rig, spectra: Spectra, usable: list[int]) -> Iterator[Trial]:
    """Every change of rig.json that is usual, each by its best value."""

    cache = ResponseCache(spectra.omega)

    def misfit(other: Rig, own: Spectra = spectra) -> float:
        return linear_check(other, own, usable, cache).predicted(usable).misfit

    def trial(left: float, finding: Callable[[], Finding]) -> Trial:
        return Trial(left, usable, lambda: (finding(),), False)

    def scaled(make: Callable[[float], Rig], factor: float = FACTOR) -> tuple[float, float]:
        grid = np.linspace(-np.log(factor), np.log(factor), 13)
        sizes = [misfit(make(float(np.exp(x)))) for x in grid]
        k = int(np.argmin(sizes))
        bounds = (grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)])
        found = minimize_scalar(
            lambda x: misfit(make(float(np.exp(x)))), bounds=bounds, method="bounded", options={"xatol": 2e-3}
        )
        return float(np.exp(found.x)), float(found.fun)

    for body in rig.bodies:
        for other, said in _other_ends(rig, body):
            yield trial(misfit(_with_body(rig, other)), partial(_ends, body.name, said))
        if body.length_m:
            yield trial(misfit(rig, _mirrored(spectra, body)), partial(_turned, body.name, spectra))
        for say, change in CHANGES.items():
            factor, left = scaled(partial(_changed, rig, body, change))
            yield trial(left, partial(say, body.name, factor))
    fast, left = scaled(lambda x: replace(rig, bodies=tuple(b.scale_frequencies(x) for b in rig.bodies)), 1.2)
    yield trial(left, partial(_clock, fast))
    for number, (name, now) in enumerate(zip(rig.force_names, rig.forces, strict=True)):
        for place in _places(rig.body(now.body), now):
            moved = (*rig.forces[:number], place, *rig.forces[number + 1 :])
            moved_rig = replace(rig, force_at=moved if len(moved) > 1 else place)
            yield trial(misfit(moved_rig), partial(_force_place, name, place))
    for contact in rig.contacts:
        for side in ("at", "against"):
            at = getattr(contact, side)
            for place in _places(rig.body(at.body), at) if at else ():
                contacts = tuple(replace(c, **{side: place}) if c is contact else c for c in rig.contacts)
                yield trial(misfit(replace(rig, contacts=contacts)), partial(_contact_place, contact.name, place))


def _places(body: Body, now: Station) -> list[Station]:
    """Others along the body, at least a hundredth of its length away."""
    if not body.length_m:
        return []
    every = np.linspace(0, body.length_m, PLACES)
    return [Station(body.name, float(x)) for x in every if abs(x - now.position_m) > 0.01 * body.length_m]


def _changed(rig: Rig, body: Body, change: Callable[[Body, float], Body], by: float) -> Rig:
    return _with_body(rig, change(body, by))


def _with_body(rig: Rig, body: Body) -> Rig:
    return replace(rig, bodies=tuple(body if b.name == body.name else b for b in rig.bodies))


def _other_ends(rig: Rig, body: Body) -> Iterator[tuple[Body, str]]:
    for beam in (b for b in rig.beams if b == body):
        for ends, said in (("free-free", "free at both ends"), ("clamped-free", "clamped at its left end")):
            if beam.ends != ends:
                yield replace(beam, ends=ends), said


def _mirrored(spectra: Spectra, body: Body) -> Spectra:
    sensors = tuple(
        replace(s, station=replace(s.station, position_m=body.length_m - s.station.position_m))
        if s.station.body == body.name
        else s
        for s in spectra.sensors
    )
    return dataclasses.replace(spectra, sensors=sensors)


def _ends(body: str, said: str) -> Finding:
    return Finding(cause="ends", of=body, evidence=f"{body} moves as a beam that is {said}", mend="correct its ends")


def _turned(body: str, spectra: Spectra) -> Finding:
    return Finding(
        cause="mirrored",
        of=body,
        channels=tuple(s.name for s in spectra.sensors if s.station.body == body),
        evidence=f"the channels of {body} fit if their positions count from its other end",
        mend="correct the positions in rig.json",
    )


def _force_place(name: str, place: Station) -> Finding:
    return Finding(
        cause="force place",
        channels=(name,),
        of=place.body,
        evidence=f"{spoken(name)} acts as if it stood at {place.position_m:.3g} m of {place.body}",
        mend="measure where it acts and correct force_at in rig.json",
    )


def _contact_place(contact: str, place: Station) -> Finding:
    return Finding(
        cause="contact place",
        of=contact,
        evidence=f"{contact} acts as if it stood at {place.position_m:.3g} m of {place.body}",
        mend="measure where it touches and correct rig.json",
    )


def _damping(body: str, factor: float) -> Finding:
    return Finding(
        cause="damping",
        of=body,
        evidence=f"{body} is damped {factor**3:.3g} times as much as rig.json says",
        mend="take its damping from a modal test",
    )


def _mass(body: str, factor: float) -> Finding:
    return Finding(
        cause="mass",
        of=body,
        evidence=f"{body} moves as if its mass were {factor:.4g} times what rig.json says",
        mend="weigh it and correct rig.json, or check the unit of all its channels",
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
        mend="correct its stiffness, thickness or length in rig.json by a modal test, or check the sampling rate",
    )


def _clock(factor: float) -> Finding:
    return Finding(
        cause="clock",
        evidence=f"all bodies vibrate at {factor:.5g} times the frequencies of rig.json",
        mend=f"check the sampling rate: the clock seems to be {100 * abs(1 - 1 / factor):.2g} % "
        f"{'fast' if factor < 1 else 'slow'}",
    )


CHANGES: dict[Callable[[str, float], Finding], Callable[[Body, float], Body]] = {
    _mass: lambda body, x: body.scale_mass(x),
    _density: lambda body, x: body.scale_mass(x).scale_frequencies(x**-0.5),
    _frequency: lambda body, x: body.scale_frequencies(x),
    _damping: lambda body, x: body.scale_damping(x**3),
}
