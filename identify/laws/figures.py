"""The figures of the contact laws that were found."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from identify.laws.identification import ENDS, FoundLaw
from identify.pages.picture import Picture
from identify.pages.style import BLUE, GREEN, GREY, RED, picture

SHOWN = 400
"""Samples of the force that the section over time shows."""


def drawn(laws: Sequence[FoundLaw]) -> dict[str, Picture]:
    """Figures by name; none where there is no law."""
    draws = {"law": _law, "law_over_time": _time} if laws else {}
    return {name: picture(partial(draw, laws=laws)) for name, draw in draws.items()}


def _law(figure: Any, laws: Sequence[FoundLaw]) -> None:
    """Figure of every contact's law: points searched, formula, and straight pieces with their knees.

    Where friction behind a backlash is the best law, that along the course of eta, and what it leaves.
    """
    upper, lower = figure.subplots(2, len(laws), squeeze=False, sharex="col", sharey="row", height_ratios=(3, 1))
    for axes, below, law in zip(upper, lower, laws, strict=True):
        if law.sliding is not None:
            _draw_sliding(axes, below, law)
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
    lower[0].set_ylabel("left over, N")
    _legend(figure, upper)


def _time(figure: Any, laws: Sequence[FoundLaw]) -> None:
    """Figure over time: separated force and that of the law around the largest, and the relative displacement."""
    upper, lower = figure.subplots(2, len(laws), squeeze=False, sharex="col", sharey="row")
    for axes, below, law in zip(upper, lower, laws, strict=True):
        force = law.record.force_n
        middle = int(np.argmax(np.abs(force[ENDS:-ENDS]))) + ENDS
        begin = min(max(middle - SHOWN // 2, 0), max(force.size - SHOWN, 0))
        shown = slice(begin, begin + SHOWN)
        axes.plot(law.time_s[shown], force[shown], color=GREY, lw=2.4, label="force, no law assumed")
        axes.plot(law.time_s[shown], law.drawn_n[shown], color=RED, lw=1.0, label=law.drawn)
        below.plot(law.time_s[shown], 1e3 * law.record.at_force_m[shown], color=BLUE, lw=1.0)
        axes.set(title=law.result.contact)
        below.set(xlabel="time, s")
    upper[0].set_ylabel("contact force, N")
    lower[0].set_ylabel("η, mm")
    _legend(figure, upper)


def _legend(figure: Any, panels: Any) -> None:
    """One for all panels, each label once."""
    named = {text: handle for axes in panels for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(named.values(), named.keys(), loc="outside upper center", ncols=4)


def _draw_sliding(axes: Any, below: Any, law: FoundLaw) -> None:
    eta, force, found = 1e3 * law.record.at_force_m, law.record.force_n, law.drawn_n
    axes.plot(eta, force, color=GREY, lw=0.5, label="force, no law assumed")
    axes.plot(eta, found, color=RED, lw=0.9, label=law.drawn)
    below.plot(eta, force - found, color=GREY, lw=0.5)
    axes.set(title=law.result.contact)
    below.set(xlabel="η, mm")
