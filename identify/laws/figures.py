"""The figure of the contact laws that were found."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from identify.laws.identification import FoundLaw
from identify.pages.style import BLUE, GREEN, GREY, RED, png


def drawn(laws: Sequence[FoundLaw]) -> bytes:
    """For every contact: the points searched, the formula found, and the straight pieces fitted, with their knees."""

    def draw(figure: Any) -> None:
        upper, lower = figure.subplots(2, len(laws), squeeze=False, sharex="col", sharey="row", height_ratios=(3, 1))
        for axes, below, law in zip(upper, lower, laws, strict=True):
            eta, knees = law.eta_m, law.pieces.knees_m
            span = np.linspace(eta.min(), eta.max(), 800)
            axes.plot(1e3 * eta, law.force_n, "o", ms=4, color=GREY, alpha=0.4, label="force, no law assumed")
            below.plot(1e3 * eta, law.force_n - law.pieces(eta), ".", ms=2, color=GREY, alpha=0.5)
            for panel, taken in ((axes, 0.0), (below, law.pieces(span))):
                panel.plot(1e3 * span, law.formula(span) - taken, color=BLUE, lw=1.4, label="formula found")
                panel.plot(1e3 * span, law.pieces(span) - taken, color=RED, lw=1.4, ls="--", label="straight pieces")
            axes.plot(1e3 * knees, law.pieces(knees), "o", ms=8, mfc="none", mew=1.5, color=GREEN, label="knees")
            axes.set(title=law.result.contact)
            below.set(xlabel="η, mm")
        upper[0].set_ylabel("contact force, N")
        lower[0].set_ylabel("less the\nstraight pieces, N")
        handles, labels = upper[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=4)

    return png(draw)
