"""The measured record beside simulations with its force: the believed rig's, and that of the likeliest cause."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from scipy.signal import csd, welch

from identify.gaps.decision.null_reference import NullReference, Simulate, familiar_figures
from identify.gaps.residual.residual import Linearization, linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.results import Curve, Figure
from identify.linear.joined import joined
from rig.model.description import Rig
from rig.recording import Recording

CURVE_POINTS = 400
SEGMENT_S = 2.0
CELLS = 80


def compared(
    measured: Recording, believed: Rig, corrected: Rig, simulate: Simulate, null_reference: NullReference
) -> tuple[tuple[Figure, ...], tuple[Curve, ...]]:
    """Figures and curves of the three runs.

    Contacts are seen by the rig that each run is of, the measured by the corrected one. Two records of the same chaotic
    machine differ too, by as much as null simulations scatter: nothing is decided by these figures.
    """
    observed = []
    for simulated, rig in ((None, corrected), (believed, believed), (corrected, corrected)):
        run = measured if simulated is None else simulate(believed, simulated, measured.forces_n, 1)
        observed.append(_observed(run, linearized(record_of(run), rig)))
    was, by_believed, by_corrected = (one.figures for one in observed)
    rows = tuple(
        Figure(name, unit, value, by_believed[name][0], by_corrected[name][0], null_reference.by_chance(name))
        for name, (value, unit) in was.items()
    )
    curves = [_spectrum(measured, observed), *_responses(measured, observed)]
    for j, contact in enumerate(joined(believed).contacts):
        eta = [1e3 * one.eta_m[j] for one in observed]
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


@dataclass(frozen=True)
class _Observed:
    """Quantities compared of one run; spectra are those of the last sensor, and of it by each force.

    The relative displacements begin when the force does: the rest before it would be a peak of the histogram.
    """

    figures: dict[str, tuple[float, str]]
    eta_m: Float[np.ndarray, "contacts samples"]
    density: Float[np.ndarray, " lines"]
    responses: Float[np.ndarray, "forces lines"]


def _observed(run: Recording, linearization: Linearization) -> _Observed:
    rate = run.rig.sample_rate_hz
    segment = int(SEGMENT_S * rate)
    record = linearization.record
    begun = round(max(0.0, record.excited_s - record.time_s[0]) * rate)
    last = run.signals[run.rig.sensors[-1].quantity].values[-1]
    _, of_forces = csd(run.forces_n[:, None], run.forces_n[None], rate, nperseg=segment)
    _, cross = csd(run.forces_n, last, rate, nperseg=segment)
    return _Observed(
        figures=familiar_figures(linearization),
        eta_m=record.sampled(linearization.model.eta_m)[:, begun:],
        density=welch(last, rate, nperseg=segment)[1],
        responses=np.abs(_h1(of_forces, cross)),
    )


def _spectrum(measured: Recording, observed: list[_Observed]) -> Curve:
    """Spectrum of the last sensor."""
    last, keep, rate = measured.rig.sensors[-1], slice(1, CURVE_POINTS), measured.rig.sample_rate_hz
    hz = np.fft.rfftfreq(int(SEGMENT_S * rate), 1 / rate)
    return Curve(
        f"power spectral density, {last.name}",
        "frequency, Hz",
        f"({last.measures.unit})^2/Hz",
        tuple(hz[keep].tolist()),
        *_three(one.density[keep] for one in observed),
        True,
    )


def _responses(measured: Recording, observed: list[_Observed]) -> list[Curve]:
    """The last sensor over each force that acts, H1."""
    last, rate = measured.rig.sensors[-1], measured.rig.sample_rate_hz
    found = []
    for number, name in enumerate(measured.force_names):
        hz, strong = welch(measured.forces_n[number], rate, nperseg=int(SEGMENT_S * rate))
        if not np.any(strong):
            continue
        keep = slice(1, int(np.flatnonzero(strong > 1e-3 * strong.max())[-1]))
        found.append(
            Curve(
                f"FRF (H1), {last.name} over {name}",
                "frequency, Hz",
                f"({last.measures.unit})/N",
                tuple(hz[keep].tolist()),
                *_three(one.responses[number, keep] for one in observed),
                True,
            )
        )
    return found


def _h1(
    of_forces: Complex[np.ndarray, "forces forces lines"], cross: Complex[np.ndarray, "forces lines"]
) -> Complex[np.ndarray, "forces lines"]:
    """H of S_fy = S_ff H, line by line; of least size where forces are alike, zero where none acts."""
    inverse = np.linalg.pinv(of_forces.transpose(2, 0, 1), rcond=1e-12, hermitian=True)
    return np.asarray(np.einsum("lij,jl->il", inverse, cross))


def _three(
    rows: Iterable[Float[np.ndarray, " points"]],
) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """Values of the measured, the nominal and the corrected run."""
    measured, believed, corrected = (tuple(row.tolist()) for row in rows)
    return measured, believed, corrected
