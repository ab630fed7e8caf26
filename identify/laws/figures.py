"""The figure of the contact laws that were found."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from identify.laws.identification import FoundLaw
from identify.laws.sliding import SlidingFriction
from identify.pages.picture import Picture
from identify.pages.style import BLUE, GREEN, GREY, RED, picture


def drawn(laws: Sequence[FoundLaw]) -> Picture:
    """For every contact: the points searched, the formula found, and the straight pieces fitted, with their knees.

    Where friction behind a backlash is the best law, that along the course of eta, and what it leaves.
    """

    def draw(figure: Any) -> None:
        upper, lower = figure.subplots(2, len(laws), squeeze=False, sharex="col", sharey="row", height_ratios=(3, 1))
        for axes, below, law in zip(upper, lower, laws, strict=True):
            if law.sliding is not None:
                _draw_sliding(axes, below, law, law.sliding)
                continue
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
        lower[0].set_ylabel("less the\nlaw, N")
        named = {text: handle for axes in upper for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)}
        figure.legend(named.values(), named.keys(), loc="outside upper center", ncols=4)

    return picture(draw)


def _draw_sliding(axes: Any, below: Any, law: FoundLaw, sliding: SlidingFriction) -> None:
    eta, force = 1e3 * law.record.at_force_m, law.record.force_n
    found = law.record.low_passed(sliding(law.record.eta_m))
    axes.plot(eta, force, color=GREY, lw=0.5, label="force, no law assumed")
    axes.plot(eta, found, color=RED, lw=0.9, label="friction behind a backlash")
    below.plot(eta, force - found, color=GREY, lw=0.5)
    axes.set(title=law.result.contact)
    below.set(xlabel="$\\eta$, mm")
