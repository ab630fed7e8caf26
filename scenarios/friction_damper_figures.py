"""Figure of the friction damper: force over displacement, measured and by the law, at every tension."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
from matplotlib.figure import Figure

from identify.laws import FoundLaw
from scenarios.silverbox_figures import GREY, RED, STYLE

if TYPE_CHECKING:
    from scenarios.friction_damper import DamperLaw

COLUMNS = 3


def drawn(laws: "Sequence[DamperLaw]", curves: Sequence[FoundLaw], path: Path) -> None:
    """A panel a record."""
    lines = -(-len(laws) // COLUMNS)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.0, 3.0 * lines), layout="constrained")
        panels = figure.subplots(lines, COLUMNS, sharex=True, sharey=True, squeeze=False)
        for axes, one, curve in zip(panels.ravel(), laws, curves, strict=False):
            record = curve.record
            axes.plot(1e3 * record.at_force_m, 1e-3 * record.force_n, color=GREY, lw=0.5, label="measured")
            if curve.sliding is not None:
                force = record.low_passed(curve.sliding)
                axes.plot(1e3 * record.at_force_m, 1e-3 * force, color=RED, lw=0.9, label="friction behind a backlash")
            axes.set(title=f"{one.frequency_hz:g} Hz, band {one.tension_n:.0f} N")
        for axes in panels[-1]:
            axes.set(xlabel="displacement, mm")
        for axes in panels[:, 0]:
            axes.set(ylabel="force, kN")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=2)
        figure.savefig(path, dpi=140)
