"""The measured record beside simulations with its force: the believed rig's, and that of the likeliest cause."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float
from scipy.signal import csd, welch

from identify.gaps.decision.familiar import familiar_figures
from identify.gaps.decision.null_reference import NullReference, Simulate
from identify.gaps.residual.residual import Linearization, linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.results import Curve, Figure
from identify.structure.joined import joined
from rig.model.description import Rig
from rig.recording import Recording

CURVE_POINTS = 400
CELLS = 80


def compared(
    measured: Recording, believed: Rig, corrected: Rig, simulate: Simulate, null_reference: NullReference
) -> tuple[tuple[Figure, ...], tuple[Curve, ...]]:
    """Figures and curves of the three runs.

    Contacts are seen by the rig that each run is of, the measured by the corrected one. Two records of the same chaotic
    machine differ too, by as much as null simulations scatter: nothing is decided by these figures.
    """
    runs = (
        measured,
        simulate(believed, believed, measured.force_n, 1),
        simulate(believed, corrected, measured.force_n, 1),
    )
    rigs = (corrected, believed, corrected)
    linearizations = [linearized(record_of(run), rig) for run, rig in zip(runs, rigs, strict=True)]
    was, by_believed, by_corrected = (familiar_figures(linearization) for linearization in linearizations)
    rows = tuple(
        Figure(name, unit, value, by_believed[name][0], by_corrected[name][0], null_reference.by_chance(name))
        for name, (value, unit) in was.items()
    )
    curves = [_spectrum(runs), *([_response(runs)] if np.any(measured.force_n) else [])]
    moved_mm = [1e3 * _excited_m(linearization) for linearization in linearizations]
    for j, contact in enumerate(joined(believed).contacts):
        eta = [moved[j] for moved in moved_mm]
        edges = np.linspace(min(e.min() for e in eta), max(e.max() for e in eta), CELLS + 1)
        curves.append(
            Curve(
                f"histogram of the relative displacement of {contact.name}",
                "relative displacement, mm",
                "share of the time per mm",
                tuple(((edges[1:] + edges[:-1]) / 2).tolist()),
                *_three(np.histogram(e, edges, density=True)[0] for e in eta),
            )
        )
    return rows, tuple(curves)


def _excited_m(of: Linearization) -> Float[np.ndarray, "contacts fine"]:
    """The relative displacements from when on the force acts: the rest before it would be a peak of the histogram."""
    record = of.record
    quiet_s = max(0.0, record.excited_s - record.time_s[0])
    return record.finely(of.model.eta_m)[:, round(quiet_s * record.sample_rate_hz * record.finer) :]


def _last(run: Recording) -> Float[np.ndarray, " samples"]:
    quantity = run.rig.sensors[-1].quantity
    return run.signals[quantity].values[-1]


def _unit(runs: tuple[Recording, ...]) -> str:
    return runs[0].rig.sensors[-1].measures.unit


def _spectrum(runs: tuple[Recording, ...]) -> Curve:
    """Of the last sensor."""
    rate = runs[0].rig.sample_rate_hz
    hz, density = zip(*(welch(_last(r), rate, nperseg=int(2 * rate)) for r in runs), strict=True)
    keep = slice(1, CURVE_POINTS)
    return Curve(
        f"power spectral density, {runs[0].rig.sensors[-1].name}",
        "frequency, Hz",
        f"({_unit(runs)})^2/Hz",
        tuple(hz[0][keep].tolist()),
        *_three(d[keep] for d in density),
        True,
    )


def _response(runs: tuple[Recording, ...]) -> Curve:
    """The last sensor over the force, H1."""
    rate = runs[0].rig.sample_rate_hz
    segment = int(2 * rate)
    curves = []
    for run in runs:
        hz, cross = csd(run.force_n, _last(run), rate, nperseg=segment)
        curves.append(np.abs(cross) / np.maximum(welch(run.force_n, rate, nperseg=segment)[1], 1e-300))
    strong = welch(runs[0].force_n, rate, nperseg=segment)[1]
    keep = slice(1, int(np.flatnonzero(strong > 1e-3 * strong.max())[-1]))
    return Curve(
        f"FRF (H1), {runs[0].rig.sensors[-1].name} over force",
        "frequency, Hz",
        f"({_unit(runs)})/N",
        tuple(hz[keep].tolist()),
        *_three(c[keep] for c in curves),
        True,
    )


def _three(
    rows: Iterable[Float[np.ndarray, " points"]],
) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """Of the measured, the believed and the corrected."""
    measured, believed, corrected = (tuple(row.tolist()) for row in rows)
    return measured, believed, corrected
