"""Figures of the Silverbox: what force no linear rig has, and the errors of both rigs over time."""

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from scipy.ndimage import uniform_filter1d

from identify.signals.kinematics import kinematics
from rig.model.description import Rig
from rig.recording import Recording
from scenarios.silverbox_data import mass_of

BLUE, RED, GREY = "#1f5fa8", "#c8402f", "#8a8a8a"
STYLE = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False}


def drawn(
    validation: Recording,
    corrected: Rig,
    arrow: Recording,
    errors: dict[str, Float[np.ndarray, " later"]],
    folder: Path,
) -> None:
    """Writes where.png and arrow.png; errors (mV) end with the arrow."""
    with mpl.rc_context(STYLE):
        _where(validation, corrected).savefig(folder / "where.png", dpi=140)
        _arrow(arrow, errors).savefig(folder / "arrow.png", dpi=140)


def _where(recording: Recording, corrected: Rig) -> Figure:
    """The force beyond mass, damping and linear spring, F - m a - c v - k x, over the displacement."""
    motion, body = kinematics(replace(recording, rig=corrected)), mass_of(corrected)
    (x,), (v,), (a,) = motion.displacement_m, motion.velocity_m_per_s, motion.acceleration_m_per_s2
    beyond = motion.force_n - body.mass_kg * a - body.damping_n_s_per_m * v - body.stiffness_n_per_m * x
    at = np.linspace(x.min(), x.max(), 200)
    cubic = sum(s.cubic_n_per_m3 for s in corrected.springs)
    edges = np.quantile(x, np.linspace(0, 1, 31))
    cell = np.clip(np.searchsorted(edges, x) - 1, 0, 29)
    count = np.bincount(cell, minlength=30)
    centre, mean = (np.bincount(cell, values, minlength=30) / count for values in (x, beyond))
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    axes = figure.subplots()
    axes.plot(1e3 * x, beyond, ".", ms=1, color=GREY, alpha=0.3, rasterized=True, label="measured")
    axes.plot(1e3 * centre, mean, "o", ms=4, color=BLUE, label="its means")
    axes.plot(1e3 * at, cubic * at**3, color=RED, label="cubic spring, as found")
    axes.set(xlabel="displacement, mm", ylabel="force beyond the linear part, N")
    axes.legend(markerscale=1.5)
    return figure


def _arrow(arrow: Recording, errors: dict[str, Float[np.ndarray, " later"]]) -> Figure:
    """The displacement, and the errors of both rigs."""
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    rate = arrow.rig.sample_rate_hz
    moved_m = arrow.signals["displacement"].values[0]
    above.plot(np.arange(moved_m.size) / rate, 1e3 * moved_m, color=GREY, lw=0.4)
    for (name, error), colour in zip(errors.items(), (BLUE, RED), strict=True):
        time_s = np.arange(arrow.samples - error.size, arrow.samples) / rate
        below.semilogy(time_s, np.sqrt(uniform_filter1d(error**2, round(rate))), color=colour, label=name)
    above.set(ylabel="displacement, mm")
    below.set(xlabel="time, s", ylabel="error of the free run, mV\n(rms over 1 s)")
    below.legend()
    return figure
