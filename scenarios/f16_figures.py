"""Figure of the F-16: the payload's acceleration on a level, measured and by both rigs, over frequency."""

from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from rig.model.description import Rig
from rig.recording import Recording
from scenarios.silverbox_figures import BLUE, GREY, RED, STYLE

BAND_HZ = (2.0, 15.0)


def drawn(
    recording: Recording,
    believed: Rig,
    corrected: Rig,
    free_run: Callable[[Rig, Float[np.ndarray, " samples"]], Recording],
    path: Path,
) -> None:
    """The lines that the force excites, of the last period."""
    period = recording.period_samples if hasattr(recording, "period_samples") else 8192
    rate = recording.rig.sample_rate_hz

    def lines(values: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " lines"]:
        return np.asarray(np.abs(np.fft.rfft(values[-period:])) * 2 / period)

    hz = np.fft.rfftfreq(period, 1 / rate)
    excited = (
        (hz >= BAND_HZ[0]) & (hz <= BAND_HZ[1]) & (lines(recording.force_n) > 0.05 * lines(recording.force_n).max())
    )
    rows = (
        ("measured", recording, GREY, 2.5),
        ("rig of level 1", free_run(believed, recording.force_n), BLUE, 1.0),
        ("corrected rig", free_run(corrected, recording.force_n), RED, 1.0),
    )
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 5.4), layout="constrained")
        panels = figure.subplots(3, 1, sharex=True)
        for axes, sensor, row in zip(panels, recording.rig.sensors, range(3), strict=True):
            for name, one, colour, width in rows:
                values = one.signals["acceleration"].values[row]
                axes.semilogy(hz[excited], lines(values)[excited], color=colour, lw=width, label=name)
            axes.set(ylabel="m/s$^2$", title=sensor.name)
        panels[0].legend(ncols=3)
        panels[-1].set(xlabel="frequency, Hz")
        figure.savefig(path, dpi=140)
