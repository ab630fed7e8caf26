"""The pictures of a diagnosis. Computes no estimate."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from identify.gaps.page import attribution_pictures, unknown_pictures
from identify.gaps.page.axes import lying_bars, stacked
from identify.gaps.results import AGAIN, Curve, Gap
from identify.gaps.wording import cause_name, closes, closes_some, others, probability
from identify.pages.picture import Picture
from identify.pages.style import BLUE, GREEN, GREY, INK, RED, picture
from rig.model.description import Rig
from rig.model.quantities import printed_unit

Draw = Callable[[Any], None]

MOST_CAUSES = 6
DECIDED = np.log(19)
_WIDE_IN, _WIDTH_IN, _ROW_IN, _FRAME_IN, _HEIGHT_IN = 7.2, 4.8, 0.3, 1.0, 3.2


def pictures(gap: Gap, rig: Rig) -> dict[str, Picture]:
    """Pictures by name, which begins with the section: next, large, why, unknown, where or far.

    What the diagnosis lacks is left out; the rig gives the bodies that an unknown force is drawn on.
    """
    return {name: picture(draw, *size) for name, size, draw in _drawn(gap, rig)}


def _drawn(gap: Gap, rig: Rig) -> Iterator[tuple[str, tuple[float, float], Draw]]:
    """Name, width and height in inches, and the function that draws."""
    if gap.next_experiments:
        height = _FRAME_IN + _ROW_IN * len(gap.next_experiments)
        yield "next_experiments", (_WIDE_IN, height), partial(_experiments, gap=gap)
    if any(b.before or b.after or b.usual for b in gap.bands):
        yield "large_bands", (_WIDE_IN, 3.6), partial(_bands, gap=gap)
    if gap.causes:
        rows = 1.5 * min(len(gap.causes), MOST_CAUSES) + 2
        yield "why_probability", (_WIDTH_IN, _FRAME_IN + _ROW_IN * rows), partial(_probability, gap=gap)
        yield "why_closes", (_WIDTH_IN, _FRAME_IN + _ROW_IN * rows), partial(_closes, gap=gap)
    if gap.unknown:
        for name, height, draw in unknown_pictures.drawn(gap.unknown, rig):
            wide = name == "place"
            yield f"unknown_{name}", (_WIDE_IN if wide else _WIDTH_IN, height), draw
    for name, height, draw in attribution_pictures.drawn(gap.attribution):
        yield f"where_{name}", (_WIDTH_IN, height), draw
    for j, curve in enumerate(gap.curves, 1):
        yield f"far_curve_{j}", (_WIDTH_IN, _HEIGHT_IN), partial(_curve, curve=curve)


def _bands(figure: Any, gap: Gap) -> None:
    """Unexplained shares over frequency, in per cent; zeros of a logarithmic axis are not drawn."""
    edges = [b.low_hz for b in gap.bands] + [gap.bands[-1].high_hz]
    axes = figure.subplots()
    rows = [("believed rig", RED, [b.before for b in gap.bands])]
    if gap.causes and closes_some(gap.causes[0]):
        rows.append(("with the likeliest cause", BLUE, [b.after for b in gap.bands]))
    rows.append(("nineteen of twenty null simulations stay below", GREEN, [b.usual for b in gap.bands]))
    for label, colour, shares in rows:
        width = 3.2 if colour == RED else 1.4  # seen beside a line that lies on it
        axes.stairs(100 * np.array(shares), edges, baseline=None, color=colour, lw=width, label=label)
    axes.axhline(100 * gap.matters.motion, color=INK, lw=1.2, ls="--", label="what matters")
    axes.set_yscale("log", nonpositive="mask")
    axes.set_xlim(edges[0], edges[-1])
    axes.set(xlabel="frequency, Hz", ylabel="unexplained share of the acceleration, %")
    figure.legend(loc="outside upper center", ncols=2)


def _probability(figure: Any, gap: Gap) -> None:
    """Probabilities of the likeliest causes, the others together, none, and something unknown: they sum to one."""
    shown, rest = gap.causes[:MOST_CAUSES], gap.causes[MOST_CAUSES:]
    rows = [(stacked(cause_name(c)), c.probability) for c in shown]
    if rest:
        rows.append((f"{len(rest)} further causes", sum(c.probability for c in rest)))
    rows += others(gap)
    colours = [BLUE] * (len(rows) - 2) + [GREEN, GREY]
    names, sizes = [r[0] for r in rows], [100 * r[1] for r in rows]
    axes = lying_bars(figure, names, sizes, [probability(r[1]) for r in rows], colours)
    axes.set(xlim=(0, 130), xticks=range(0, 101, 25), xlabel="probability, %")
    figure.suptitle("How likely each cause is", fontsize=10)


def _closes(figure: Any, gap: Gap) -> None:
    """The fraction of the gap that each of the likeliest causes closes, with its 95 % interval."""
    shown = gap.causes[:MOST_CAUSES]
    sizes = [100 * min(max(c.explained, 0.0), 1.0) for c in shown]
    ends = 100 * np.clip([c.interval_95 for c in shown], 0, 1)
    names = [stacked(cause_name(c)) for c in shown]
    axes = lying_bars(figure, names, sizes, [""] * len(shown), BLUE)
    for row, (cause, (low, high)) in enumerate(zip(shown, ends, strict=True)):
        axes.plot([low, high], [row, row], color=INK, lw=2.0, marker="|", ms=8)
        axes.annotate(closes(cause), (max(high, sizes[row]), row), (6, 0), textcoords="offset points", va="center")
    axes.set(xlim=(0, 210), xticks=range(0, 101, 25), xlabel="share of the gap that it closes, %")
    axes.set_ylim(len(shown) - 0.4, -0.6)
    figure.suptitle("What each cause closes, with its 95 % interval", fontsize=10)


def _experiments(figure: Any, gap: Gap) -> None:
    """Expected gain by each further recording in the odds of the true one of two causes."""
    shown = gap.next_experiments
    sizes = [e.log_odds for e in shown]
    names = [e.words + " (reference)" * (e.words == AGAIN) for e in shown]
    colours = [GREY if e.words == AGAIN else BLUE for e in shown]
    axes = lying_bars(figure, names, sizes, [f"{size:.1f}" for size in sizes], colours)
    axes.axvline(DECIDED, color=INK, lw=1.2, ls="--", label="turns even odds into 95 %")
    axes.margins(x=0.12)
    axes.set(xlabel="expected gain of the log odds of the true one (natural logarithm)")
    figure.legend(loc="outside lower right")
    figure.suptitle(f"Which further recording tells {' from '.join(gap.next_between)}", fontsize=10)


def _curve(figure: Any, curve: Curve) -> None:
    axes = figure.subplots()
    for values, colour, width, label in (
        (curve.measured, GREY, 2.4, "measured"),
        (curve.believed, RED, 1.0, "believed rig"),
        (curve.corrected, BLUE, 1.0, "with the likeliest cause"),
    ):
        axes.plot(curve.x, values, color=colour, lw=width, ls="--" if colour == RED else "-", label=label)
    if curve.logarithmic:
        axes.set_yscale("log", nonpositive="mask")
    figure.legend(loc="outside lower center", ncols=3, columnspacing=1.0, handlelength=1.6)
    axes.set(xlabel=curve.x_label, ylabel=printed_unit(curve.y_label))
    axes.set_title(curve.name, wrap=True)
