"""Changes of rig.json that could make a record fit: mass, density, frequencies, damping, ends, places, the clock."""

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from msgspec.structs import replace
from scipy.optimize import minimize_scalar

from identify.checks.findings import Finding, force_in_words
from identify.checks.prediction import linear_check
from identify.checks.spectra import Spectra
from identify.linear.model import ResponseCache
from rig.model.description import Body, Rig, Station
from rig.model.tolerances import Tolerances

NamedFactors = tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Trial:
    """Trial change of a record or of rig.json: its misfit, and the findings if it is the best one.

    The channels of trusted_indices may be trusted beside it; if is_rest_right, they, the forces and rig.json are right
    as they are. A trial with more freedom has a misfit_factor above one. A change of rig.json has its changed_rig, and
    what the tolerances allow of it by their names: tolerance_factors on the believed values.
    """

    misfit: float
    trusted_indices: list[int]
    findings: Callable[[], tuple[Finding, ...]]
    is_rest_right: bool = True
    misfit_factor: float = 1.0
    changed_rig: Rig | None = None
    tolerance_factors: NamedFactors = ()

    def distance_in_tolerances(self, tolerances: Tolerances) -> float:
        """Distance of the changed rig.json from the believed one, in standard deviations of the logarithms, as the
        values are positive; infinite where no tolerance allows the change at all."""
        tolerances_and_factors = [(getattr(tolerances, name), factor) for name, factor in self.tolerance_factors]
        if not tolerances_and_factors or any(tolerance == 0 for tolerance, _ in tolerances_and_factors):
            return np.inf
        return float(np.linalg.norm([np.log(factor) / tolerance for tolerance, factor in tolerances_and_factors]))


MAX_CHANGE_FACTOR = 3.0
"""Masses and frequencies are varied within this factor."""
POSITION_COUNT = 21


def rig_trials(rig: Rig, spectra: Spectra, usable_indices: list[int]) -> Iterator[Trial]:
    """Trials of every usual change of rig.json, each with its best value."""
    cache = ResponseCache(spectra.omega)

    def misfit_of(candidate_rig: Rig, rig_spectra: Spectra = spectra) -> float:
        return linear_check(candidate_rig, rig_spectra, usable_indices, cache).prediction(usable_indices).misfit

    def trial(misfit: float, find: Callable[[], Finding], trial_rig: Rig | None, factors: NamedFactors = ()) -> Trial:
        return Trial(misfit, usable_indices, lambda: (find(),), False, changed_rig=trial_rig, tolerance_factors=factors)

    def factor_and_misfit(rig_of: Callable[[float], Rig], max_factor: float = MAX_CHANGE_FACTOR) -> tuple[float, float]:
        def misfit_at(log_factor: float) -> float:
            return misfit_of(rig_of(float(np.exp(log_factor))))

        log_factors = np.linspace(-np.log(max_factor), np.log(max_factor), 13)
        best_index = int(np.argmin([misfit_at(log_factor) for log_factor in log_factors]))
        log_bounds = (log_factors[max(best_index - 1, 0)], log_factors[min(best_index + 1, len(log_factors) - 1)])
        optimum = minimize_scalar(misfit_at, bounds=log_bounds, method="bounded", options={"xatol": 2e-3})
        return float(np.exp(optimum.x)), float(optimum.fun)

    for body in rig.bodies:
        for changed_body, ends_words in _beams_with_other_ends(rig, body):
            trial_rig = _with_body(rig, changed_body)
            yield trial(misfit_of(trial_rig), partial(_ends_finding, body.name, ends_words), trial_rig)
        if body.length_m:
            misfit = misfit_of(rig, _mirrored_spectra(spectra, body))
            yield trial(misfit, partial(_mirrored_finding, body.name, spectra), None)
        for finding_of, (change, exponents) in BODY_CHANGES.items():
            factor, misfit = factor_and_misfit(partial(_with_changed_body, rig, body, change))
            factors = tuple((name, factor**exponent) for name, exponent in exponents.items())
            trial_rig = _with_changed_body(rig, body, change, factor)
            yield trial(misfit, partial(finding_of, body.name, factor), trial_rig, factors)
    factor, misfit = factor_and_misfit(partial(_with_scaled_frequencies, rig), 1.2)
    factors = (("frequency", factor),) * len(rig.bodies)
    yield trial(misfit, partial(_clock_finding, factor), _with_scaled_frequencies(rig, factor), factors)
    for i, (name, stated_station) in enumerate(zip(rig.force_names, rig.forces, strict=True)):
        for station in _trial_stations_along_body(rig, stated_station):
            stations = (*rig.forces[:i], station, *rig.forces[i + 1 :])
            trial_rig = replace(rig, force_at=stations if len(stations) > 1 else station)
            yield trial(misfit_of(trial_rig), partial(_force_place_finding, name, station), trial_rig)
    for contact in rig.contacts:
        for station_field in ("at", "against"):
            for station in _trial_stations_along_body(rig, getattr(contact, station_field)):
                contacts = (replace(c, **{station_field: station}) if c is contact else c for c in rig.contacts)
                trial_rig = replace(rig, contacts=tuple(contacts))
                yield trial(misfit_of(trial_rig), partial(_contact_place_finding, contact.name, station), trial_rig)


def _with_scaled_frequencies(rig: Rig, frequency_factor: float) -> Rig:
    return replace(rig, bodies=tuple(body.scale_frequencies(frequency_factor) for body in rig.bodies))


def _trial_stations_along_body(rig: Rig, stated_station: Station | None) -> list[Station]:
    """Other places along a station's body, at least a hundredth of its length away; none of a mass or the ground."""
    if stated_station is None or not (length_m := rig.body(stated_station.body).length_m):
        return []
    positions_m = np.linspace(0, length_m, POSITION_COUNT)
    other_positions_m = positions_m[np.abs(positions_m - stated_station.position_m) > 0.01 * length_m]
    return [Station(stated_station.body, float(position_m)) for position_m in other_positions_m]


def _with_changed_body(rig: Rig, body: Body, change: Callable[[Body, float], Body], factor: float) -> Rig:
    return _with_body(rig, change(body, factor))


def _with_body(rig: Rig, body: Body) -> Rig:
    return replace(rig, bodies=tuple(body if b.name == body.name else b for b in rig.bodies))


def _beams_with_other_ends(rig: Rig, body: Body) -> Iterator[tuple[Body, str]]:
    for beam in (b for b in rig.beams if b == body):
        for ends, ends_words in (("free-free", "free at both ends"), ("clamped-free", "clamped at its left end")):
            if beam.ends != ends:
                yield replace(beam, ends=ends), ends_words


def _mirrored_spectra(spectra: Spectra, body: Body) -> Spectra:
    sensors = tuple(
        replace(sensor, station=replace(sensor.station, position_m=body.length_m - sensor.station.position_m))
        if sensor.station.body == body.name
        else sensor
        for sensor in spectra.sensors
    )
    return dataclasses.replace(spectra, sensors=sensors)


def _ends_finding(body_name: str, ends_words: str) -> Finding:
    return Finding(
        cause="ends",
        of=body_name,
        evidence=f"{body_name} moves as a beam that is {ends_words}",
        mend="correct its ends",
    )


def _mirrored_finding(body_name: str, spectra: Spectra) -> Finding:
    return Finding(
        cause="mirrored",
        of=body_name,
        channels=tuple(sensor.name for sensor in spectra.sensors if sensor.station.body == body_name),
        evidence=f"the channels of {body_name} fit if their positions count from its other end",
        mend="correct the positions in rig.json",
    )


def _force_place_finding(force_name: str, station: Station) -> Finding:
    return Finding(
        cause="force place",
        channels=(force_name,),
        of=station.body,
        evidence=f"{force_in_words(force_name)} acts as if it stood at {station.position_m:.3g} m of {station.body}",
        mend="measure where it acts and correct force_at in rig.json",
    )


def _contact_place_finding(contact_name: str, station: Station) -> Finding:
    return Finding(
        cause="contact place",
        of=contact_name,
        evidence=f"{contact_name} acts as if it stood at {station.position_m:.3g} m of {station.body}",
        mend="measure where it touches and correct rig.json",
    )


def _damping_finding(body_name: str, factor: float) -> Finding:
    return Finding(
        cause="damping",
        of=body_name,
        evidence=f"{body_name} is damped {factor**3:.3g} times as much as rig.json says",
        mend="take its damping from a modal test",
    )


def _mass_finding(body_name: str, factor: float) -> Finding:
    return Finding(
        cause="mass",
        of=body_name,
        evidence=f"{body_name} moves as if its mass were {factor:.4g} times what rig.json says",
        mend="weigh it and correct rig.json, or check the unit of all its channels",
    )


def _density_finding(body_name: str, factor: float) -> Finding:
    return Finding(
        cause="mass",
        of=body_name,
        evidence=f"{body_name} moves as if its density were {factor:.4g} times what rig.json says",
        mend="weigh it and correct its density in rig.json",
    )


def _frequency_finding(body_name: str, factor: float) -> Finding:
    return Finding(
        cause="frequency",
        of=body_name,
        evidence=f"{body_name} vibrates at {factor:.4g} times the frequencies of rig.json",
        mend="correct its stiffness, thickness or length in rig.json by a modal test, or check the sampling rate",
    )


def _clock_finding(factor: float) -> Finding:
    return Finding(
        cause="clock",
        evidence=f"all bodies vibrate at {factor:.5g} times the frequencies of rig.json",
        mend=f"check the sampling rate: the clock seems to be {100 * abs(1 - 1 / factor):.2g} % "
        f"{'fast' if factor < 1 else 'slow'}",
    )


BODY_CHANGES: dict[Callable[[str, float], Finding], tuple[Callable[[Body, float], Body], dict[str, float]]] = {
    _mass_finding: (lambda body, x: body.scale_mass(x), {"mass": 1.0}),
    _density_finding: (lambda body, x: body.scale_mass(x).scale_frequencies(x**-0.5), {"mass": 1.0, "frequency": -0.5}),
    _frequency_finding: (lambda body, x: body.scale_frequencies(x), {"frequency": 1.0}),
    _damping_finding: (lambda body, x: body.scale_damping(x**3), {"damping": 3.0}),
}
"""Change of a body by a factor x, and the exponents of x in what the tolerances allow."""
