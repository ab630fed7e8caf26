"""Figure of the F-16: the accelerations on a level, measured and by both rigs, over frequency."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from rig.recording import Recording
from scenarios.silverbox_figures import BLUE, GREY, RED, STYLE

BAND_HZ = (2.0, 15.0)
EXCITED = 0.05
"""Lines of less than this share of the force's largest are left out."""


def drawn(recording: Recording, runs: Mapping[str, Recording], period: int, path: Path) -> None:
    """The lines that the force excites, of the last period, of the record and of free runs under its force."""
    force = _lines(recording.force_n, period)
    hz = np.fft.rfftfreq(period, 1 / recording.rig.sample_rate_hz)
    excited = (hz >= BAND_HZ[0]) & (hz <= BAND_HZ[1]) & (force > EXCITED * force.max())
    shown = [("measured", recording, GREY, 2.5)]
    shown += [(name, one, colour, 1.0) for (name, one), colour in zip(runs.items(), (BLUE, RED), strict=True)]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 6.0), layout="constrained")
        panels = figure.subplots(len(recording.rig.sensors), 1, sharex=True)
        for row, (axes, sensor) in enumerate(zip(panels, recording.rig.sensors, strict=True)):
            for name, one, colour, width in shown:
                size = _lines(one.signals["acceleration"].values[row], period)
                axes.semilogy(hz[excited], size[excited], color=colour, lw=width, label=name)
            axes.set(ylabel="m/s$^2$", title=sensor.name)
        panels[-1].set(xlabel="frequency, Hz")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=3)
        figure.savefig(path, dpi=140)


def _lines(values: Float[np.ndarray, " samples"], period: int) -> Float[np.ndarray, " lines"]:
    return np.asarray(2 / period * np.abs(np.fft.rfft(values[-period:])))
