"""Pictures of a diagnosis: causes, bands, experiments, and where the mismatch lies. Computes no estimate."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from identify.gaps.page.unknown_pictures import drawings
from identify.gaps.results import SAME_EXPERIMENT, Attribution, Gap, ResidualMap, Share
from identify.gaps.rollout.results import PredictionExample
from identify.gaps.wording import cause_name, is_effective, probability, remaining_probabilities, removed_share_words
from identify.pages.style import BLUE, GREEN, GREY, INK, RED, Picture, picture
from identify.pages.wording import percent

Draw = Callable[[Any], None]

MAX_CAUSES = 6
"""Causes of a figure at most. Display."""
MAX_LABELS = 12
"""Labels of an axis at most. Display."""
MAX_NAME_CHARACTERS = 34
"""Length above which a name beside a bar is shortened."""
LOG_ODDS_95 = np.log(19)
"""Gain of log odds that turns even odds into 95 %."""
_WIDE_IN, _WIDTH_IN, _ROW_IN, _FRAME_IN, _HEIGHT_IN = 7.2, 4.8, 0.3, 1.0, 3.2
"""Widths and heights of figures, inches. Display."""


def pictures(gap: Gap) -> dict[str, Picture]:
    """Pictures by name, which begins with the section: next, large, why, prediction, unknown or where.

    What the diagnosis lacks is left out.
    """
    return {name: picture(draw, *size) for name, size, draw in _drawings(gap)}


def _drawings(gap: Gap) -> Iterator[tuple[str, tuple[float, float], Draw]]:
    """Name, width and height in inches, and drawing function of each picture."""
    if gap.next_experiments:
        height = _FRAME_IN + _ROW_IN * len(gap.next_experiments)
        yield "next_experiments", (_WIDE_IN, height), partial(_experiments, gap=gap)
    if any(b.before or b.after or b.usual for b in gap.bands):
        yield "large_bands", (_WIDE_IN, 3.6), partial(_bands, gap=gap)
    if gap.causes:
        rows = 1.5 * min(len(gap.causes), MAX_CAUSES) + 2
        yield "why_probability", (_WIDTH_IN, _FRAME_IN + _ROW_IN * rows), partial(_probability, gap=gap)
        yield "why_closes", (_WIDTH_IN, _FRAME_IN + _ROW_IN * rows), partial(_closes, gap=gap)
    if gap.unknown:
        for name, height, draw in drawings(gap.unknown):
            yield f"unknown_{name}", (_WIDTH_IN, height), draw
    if gap.rollout and gap.rollout.example:
        yield "prediction_motion", (_WIDE_IN, _HEIGHT_IN), partial(_motion, example=gap.rollout.example)
    for name, height, draw in _attribution_drawings(gap.attribution):
        yield f"where_{name}", (_WIDTH_IN, height), draw


def _bands(figure: Any, gap: Gap) -> None:
    """Unexplained shares over frequency, in per cent; zeros of a logarithmic axis are not drawn."""
    edges = [b.low_hz for b in gap.bands] + [gap.bands[-1].high_hz]
    axes = figure.subplots()
    rows = [("the model as it is", RED, [b.before for b in gap.bands])]
    if gap.causes and is_effective(gap.causes[0]):
        rows.append(("with the likeliest causes", BLUE, [b.after for b in gap.bands]))
    rows.append(("95 % limit of tolerances and noise", GREEN, [b.usual for b in gap.bands]))
    for label, colour, shares in rows:
        width = 3.2 if colour == RED else 1.4  # seen beside a line that lies on it
        axes.stairs(100 * np.array(shares), edges, baseline=None, color=colour, lw=width, label=label)
    axes.axhline(
        100 * gap.matters.motion, color=INK, lw=1.2, ls="--", label=f"matters above {percent(gap.matters.motion)}"
    )
    axes.set_yscale("log", nonpositive="mask")
    axes.set_xlim(edges[0], edges[-1])
    axes.set(xlabel="frequency, Hz", ylabel="unexplained share of the acceleration, %")
    figure.legend(loc="outside upper center", ncols=2)


def _probability(figure: Any, gap: Gap) -> None:
    """Probabilities of the likeliest causes, all others, no cause, and something unmeasured; they sum to one."""
    top_causes, remaining_causes = gap.causes[:MAX_CAUSES], gap.causes[MAX_CAUSES:]
    rows = [(_cause_lines(cause_name(c)), c.probability) for c in top_causes]
    if remaining_causes:
        rows.append((f"{len(remaining_causes)} further causes", sum(c.probability for c in remaining_causes)))
    rows += remaining_probabilities(gap)
    colours = [BLUE] * (len(rows) - 2) + [GREEN, GREY]
    names, sizes = [r[0] for r in rows], [100 * r[1] for r in rows]
    axes = _horizontal_bars(figure, names, sizes, [probability(r[1]) for r in rows], colours)
    axes.set(xlim=(0, 130), xticks=range(0, 101, 25), xlabel="probability, %")
    figure.suptitle("How likely each cause is", fontsize=10)


def _closes(figure: Any, gap: Gap) -> None:
    """Share of the mismatch that each of the likeliest causes removes, with its 95 % interval."""
    top_causes = gap.causes[:MAX_CAUSES]
    sizes = [100 * min(max(c.explained, 0.0), 1.0) for c in top_causes]
    intervals_percent = 100 * np.clip([c.interval_95 for c in top_causes], 0, 1)
    names = [_cause_lines(cause_name(c)) for c in top_causes]
    axes = _horizontal_bars(figure, names, sizes, [""] * len(top_causes), BLUE)
    for row, (cause, (low, high)) in enumerate(zip(top_causes, intervals_percent, strict=True)):
        axes.plot([low, high], [row, row], color=INK, lw=2.0, marker="|", ms=8)
        axes.annotate(
            removed_share_words(cause), (max(high, sizes[row]), row), (6, 0), textcoords="offset points", va="center"
        )
    axes.set(xlim=(0, 210), xticks=range(0, 101, 25), xlabel="share of the gap that it closes, %")
    axes.set_ylim(len(top_causes) - 0.4, -0.6)
    figure.suptitle("What each cause closes, with its 95 % interval", fontsize=10)


def _experiments(figure: Any, gap: Gap) -> None:
    """Expected gain of each further recording in the log odds of the true one of two causes."""
    experiments = gap.next_experiments
    sizes = [e.log_odds for e in experiments]
    names = [e.words + " (reference)" * (e.words == SAME_EXPERIMENT) for e in experiments]
    colours = [GREY if e.words == SAME_EXPERIMENT else BLUE for e in experiments]
    axes = _horizontal_bars(figure, names, sizes, [f"{size:.1f}" for size in sizes], colours)
    axes.axvline(LOG_ODDS_95, color=INK, lw=1.2, ls="--", label="turns even odds into 95 %")
    axes.margins(x=0.12)
    axes.set(xlabel="expected gain of the log odds of the true one (natural logarithm)")
    figure.legend(loc="outside lower right")
    figure.suptitle(f"Which further recording tells {' from '.join(gap.next_between)}", fontsize=10)


def _motion(figure: Any, example: PredictionExample) -> None:
    """Measured motion, and its predictions by the nominal and the corrected rig."""
    axes = figure.subplots()
    for values, colour, width, style, label in (
        (example.measured, GREY, 3.0, "-", "measured"),
        (example.nominal, RED, 1.2, "--", "predicted by the model as it is"),
        (example.corrected, BLUE, 1.2, "-", "with the named effects"),
    ):
        axes.plot(example.time_s, values, color=colour, lw=width, ls=style, label=label)
    figure.legend(loc="outside lower center", ncols=3)
    quantity = "displacement" if example.unit == "m" else "velocity"
    axes.set(xlabel="time, s", ylabel=f"{quantity} of {example.sensor}, {example.unit}")


def _attribution_drawings(attribution: Attribution) -> Iterator[tuple[str, float, Draw]]:
    """Name, height in inches and drawing function of each picture of the mismatch's location.

    Left out where all shares are zero, as those of the acceleration of a single mass, whose mismatch is in the contact
    force.
    """
    if any(any(stations.values()) for stations in attribution.positions_m.values()):
        yield "positions", 0.6 + 1.5 * len(attribution.positions_m), partial(_positions, bodies=attribution.positions_m)
    if any(s.share for s in attribution.band_hz):
        yield "band", _HEIGHT_IN, partial(_row, shares=attribution.band_hz, title="By frequency", x_label="band, Hz")
    for name, shares, title in (
        ("channels", attribution.channels, "By channel"),
        ("modal_equations", attribution.modal_equations, "By modal equation"),
        ("parts", attribution.parts, "Linear structure or contact laws"),
        ("contact_state", attribution.contact_state, "By contact state"),
    ):
        if any(shares.values()):
            yield name, _FRAME_IN + _ROW_IN * len(shares), partial(_bars, shares=shares, title=title)
    if any(s.share for s in attribution.time_s):
        yield "time", _HEIGHT_IN, partial(_row, shares=attribution.time_s, title="Over time", x_label="time, s")
    for j, (contact, surface) in enumerate(attribution.surface.items(), 1):
        yield f"surface_{j}", _HEIGHT_IN, partial(_surface, surface=surface, contact=contact)


def _bars(figure: Any, shares: Mapping[str, float], title: str) -> None:
    sizes = [100 * s for s in shares.values()]
    axes = _horizontal_bars(figure, [_shortened(n) for n in shares], sizes, [f"{s:.1f}" for s in sizes], BLUE)
    axes.margins(x=0.18)
    axes.set(xlabel="share of the gap, %")
    figure.suptitle(title, fontsize=10)


def _row(figure: Any, shares: Sequence[Share], title: str, x_label: str) -> None:
    axes = figure.subplots()
    axes.bar(np.arange(len(shares)), [100 * s.share for s in shares], width=0.85, color=BLUE)
    labelled = slice(None, None, -(-len(shares) // MAX_LABELS))
    names = [_shortened(f"{s.begin:.3g} to {s.end:.3g}") for s in shares]
    axes.set_xticks(np.arange(len(shares))[labelled], names[labelled], rotation=40, ha="right", rotation_mode="anchor")
    axes.grid(axis="x", visible=False)
    axes.set(xlabel=x_label, ylabel="share of the gap, %", title=title)


def _positions(figure: Any, bodies: Mapping[str, Mapping[float, float]]) -> None:
    """Each body as a thick line from its left end, a bar at every station."""
    panels = figure.subplots(len(bodies), 1, squeeze=False, sharex=True, sharey=True)[:, 0]
    longest = max([position_m for stations in bodies.values() for position_m in stations], default=0.0) or 1.0
    for axes, (body, stations) in zip(panels, bodies.items(), strict=True):
        places = np.array(list(stations))
        sizes = 100 * np.array(list(stations.values()))
        axes.plot([0.0, max(places.max(initial=0.0), 0.02 * longest)], [0, 0], color=INK, lw=5, zorder=3)
        bars = axes.bar(places, sizes, width=0.04 * longest, color=BLUE)
        axes.plot(places, 0 * places, "^", ms=5, color="white", mec=INK, zorder=4, clip_on=False)
        if places.size <= MAX_LABELS:
            axes.bar_label(bars, [f"{s:.0f}" for s in sizes], padding=2)
        axes.margins(y=0.22)
        axes.set_title(_shortened(body), loc="left", fontsize=9)
    panels[-1].set_xlabel("distance from the left end, m")
    panels[0].set_ylabel("share of the gap, %")
    figure.suptitle("Along the bodies (stations marked)", fontsize=10)


def _surface(figure: Any, surface: ResidualMap, contact: str) -> None:
    axes = figure.subplots()
    share = 100 * np.array(surface.share)
    cells = axes.pcolormesh(
        1e3 * np.array(surface.eta_m), surface.rate_m_per_s, np.where(share > 0, share, np.nan).T, cmap="viridis_r"
    )
    figure.colorbar(cells, label="share of the gap, %")
    axes.set(xlabel="displacement, mm", ylabel="velocity, m/s", title=f"At {_shortened(contact)}")


def _shortened(name: str) -> str:
    return name if len(name) <= MAX_NAME_CHARACTERS else f"{name[: MAX_NAME_CHARACTERS - 1]}…"


def _cause_lines(name: str) -> str:
    """Name of a cause with one effect per line."""
    first, *further_effects = name.split(" + ")
    return "\n".join([_shortened(first), *(_shortened(f"+ {effect}") for effect in further_effects)])


def _horizontal_bars(
    figure: Any, names: Sequence[str], sizes: Sequence[float], bar_labels: Sequence[str], colours: Any
) -> Any:
    """Axes with horizontal bars, the first on top, and a label at the end of each."""
    axes = figure.subplots()
    bars = axes.barh(np.arange(len(names)), sizes, height=0.62, color=colours)
    axes.bar_label(bars, bar_labels, padding=4)
    axes.set_yticks(np.arange(len(names)), names)
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    return axes
