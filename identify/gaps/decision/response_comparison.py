"""Comparison of the measured record with simulations under its force, by the nominal and by the corrected rig."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from scipy.signal import csd, welch

from identify.gaps.decision.null_reference import NullReference, summary_statistics
from identify.gaps.residual.residual import Linearization, linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.results import Curve, SummaryStatistic
from identify.linear.joined import joined
from rig.model.description import Rig
from rig.recording import Recording
from rig.recording.interfaces import Simulate

CURVE_POINTS = 400
"""Points of a compared curve at most. Display."""
SEGMENT_S = 2.0
"""Segment of the spectra, s. Display."""
HISTOGRAM_CELLS = 80
"""Cells of a histogram. Display."""


def compare_responses(
    measured: Recording, nominal: Rig, corrected: Rig, simulate: Simulate, null_reference: NullReference
) -> tuple[tuple[SummaryStatistic, ...], tuple[Curve, ...]]:
    """Summary statistics and curves of the measured, the nominal and the corrected run.

    Contact forces are separated by the rig of the run, and by the corrected rig in the measured record. Two records of
    the same chaotic machine differ as much as null simulations scatter, so these statistics decide nothing.
    """
    runs = []
    for actual, contact_rig in ((None, corrected), (nominal, nominal), (corrected, corrected)):
        recording = measured if actual is None else simulate(nominal, actual, measured.forces_n, 1)
        runs.append(_run(recording, linearized(record_of(recording), contact_rig)))
    measured_statistics, nominal_statistics, corrected_statistics = (run.figures for run in runs)
    rows = tuple(
        SummaryStatistic(
            name,
            unit,
            value,
            nominal_statistics[name][0],
            corrected_statistics[name][0],
            null_reference.half_width_95(name),
        )
        for name, (value, unit) in measured_statistics.items()
    )
    curves = [_spectrum(measured, runs), *_responses(measured, runs)]
    for j, contact in enumerate(joined(nominal).contacts):
        eta = [1e3 * run.eta_m[j] for run in runs]
        edges = np.linspace(
            min(run_eta.min() for run_eta in eta), max(run_eta.max() for run_eta in eta), HISTOGRAM_CELLS + 1
        )
        curves.append(
            Curve(
                f"histogram of the relative displacement of {contact.name}",
                "relative displacement, mm",
                "share of the time per mm",
                tuple(((edges[1:] + edges[:-1]) / 2).tolist()),
                *_value_triples(np.histogram(run_eta, edges, density=True)[0] for run_eta in eta),
            )
        )
    return rows, tuple(curves)


@dataclass(frozen=True)
class _Run:
    """Compared quantities of one run; density and responses are spectra of the last sensor, the latter over each force.

    Relative displacements start with the force, as the rest before it would be a peak of the histogram.
    """

    figures: dict[str, tuple[float, str]]
    eta_m: Float[np.ndarray, "contacts samples"]
    density: Float[np.ndarray, " lines"]
    responses: Float[np.ndarray, "forces lines"]


def _run(recording: Recording, linearization: Linearization) -> _Run:
    rate = recording.rig.sample_rate_hz
    segment_samples = int(SEGMENT_S * rate)
    record = linearization.record
    force_start = round(max(0.0, record.excited_s - record.time_s[0]) * rate)
    last_channel = recording.signals[recording.rig.sensors[-1].quantity].values[-1]
    _, force_spectra = csd(recording.forces_n[:, None], recording.forces_n[None], rate, nperseg=segment_samples)
    _, cross_spectra = csd(recording.forces_n, last_channel, rate, nperseg=segment_samples)
    return _Run(
        figures=summary_statistics(linearization),
        eta_m=record.sampled(linearization.model.eta_m)[:, force_start:],
        density=welch(last_channel, rate, nperseg=segment_samples)[1],
        responses=np.abs(_h1(force_spectra, cross_spectra)),
    )


def _spectrum(measured: Recording, runs: list[_Run]) -> Curve:
    """Power spectral density of the last sensor."""
    sensor, lines, rate = measured.rig.sensors[-1], slice(1, CURVE_POINTS), measured.rig.sample_rate_hz
    hz = np.fft.rfftfreq(int(SEGMENT_S * rate), 1 / rate)
    return Curve(
        f"power spectral density, {sensor.name}",
        "frequency, Hz",
        f"({sensor.measures.unit})^2/Hz",
        tuple(hz[lines].tolist()),
        *_value_triples(run.density[lines] for run in runs),
        True,
    )


def _responses(measured: Recording, runs: list[_Run]) -> list[Curve]:
    """Frequency response functions (H1) of the last sensor over each force that acts."""
    sensor, rate = measured.rig.sensors[-1], measured.rig.sample_rate_hz
    curves = []
    for number, name in enumerate(measured.force_names):
        hz, force_density = welch(measured.forces_n[number], rate, nperseg=int(SEGMENT_S * rate))
        if not np.any(force_density):
            continue
        lines = slice(1, int(np.flatnonzero(force_density > 1e-3 * force_density.max())[-1]))
        curves.append(
            Curve(
                f"FRF (H1), {sensor.name} over {name}",
                "frequency, Hz",
                f"({sensor.measures.unit})/N",
                tuple(hz[lines].tolist()),
                *_value_triples(run.responses[number, lines] for run in runs),
                True,
            )
        )
    return curves


def _h1(
    force_spectra: Complex[np.ndarray, "forces forces lines"], cross_spectra: Complex[np.ndarray, "forces lines"]
) -> Complex[np.ndarray, "forces lines"]:
    """H of S_fy = S_ff H at every line: minimum-norm where forces are alike, zero where none acts."""
    inverse = np.linalg.pinv(force_spectra.transpose(2, 0, 1), rcond=1e-12, hermitian=True)
    return np.asarray(np.einsum("lij,jl->il", inverse, cross_spectra))


def _value_triples(
    rows: Iterable[Float[np.ndarray, " points"]],
) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """Values of the measured, the nominal and the corrected run."""
    measured, nominal, corrected = (tuple(row.tolist()) for row in rows)
    return measured, nominal, corrected
