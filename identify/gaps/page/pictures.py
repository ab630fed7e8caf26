"""Pictures of a diagnosis: causes, bands, experiments, and where the mismatch lies. Computes no estimate."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from identify.gaps.page.unknown_pictures import drawings
from identify.gaps.results import SAME_EXPERIMENT, Attribution, Gap, ResidualMap, Share
from identify.gaps.rollout.results import PredictionExample
from identify.gaps.wording import (
    cause_name,
    is_effective,
    probability,
    remaining_probabilities,
    removed_share_words,
    value_bound_and_limit_texts,
)
from identify.pages.style import BLUE, GREEN, GREY, INK, RED, Picture, picture

DrawFunction = Callable[[Any], None]

MAX_CAUSES = 6
"""Causes of a figure at most. Display."""
MAX_LABELS = 12
"""Labels of an axis at most. Display."""
LEAST_RATIO, UNBOUNDED_RATIO = 0.01, 1e4
"""Share of its threshold at which a smaller value is drawn, and to which the line of an unbounded one goes."""
MAX_NAME_CHARACTERS = 34
"""Length above which a name beside a bar is shortened."""
LOG_ODDS_95 = np.log(19)
"""Gain of log odds that turns even odds into 95 %."""
_WIDE_WIDTH_IN, _NARROW_WIDTH_IN, _ROW_IN, _FRAME_IN, _HEIGHT_IN = 7.2, 4.8, 0.3, 1.0, 3.2
"""Widths and heights of figures, inches. Display."""


def pictures(gap: Gap) -> dict[str, Picture]:
    """Pictures by name, which begins with the section: next, large, why, prediction, unknown or where.

    What the diagnosis lacks is left out.
    """
    return {name: picture(draw, *size_in) for name, size_in, draw in _drawings(gap)}


def _drawings(gap: Gap) -> Iterator[tuple[str, tuple[float, float], DrawFunction]]:
    """Name, width and height in inches, and drawing function of each picture."""
    if gap.next_experiments:
        height_in = _FRAME_IN + _ROW_IN * len(gap.next_experiments)
        yield "next_experiments", (_WIDE_WIDTH_IN, height_in), partial(_draw_experiments, gap=gap)
    if any(band.before or band.after or band.usual for band in gap.bands):
        yield "large_bands", (_WIDE_WIDTH_IN, 3.6), partial(_draw_bands, gap=gap)
    if quantity_count := len(gap.evidence.quantities):
        yield "decided_quantities", (_WIDE_WIDTH_IN, 1.6 + 0.5 * quantity_count), partial(_draw_quantities, gap=gap)
    if gap.causes:
        row_count = 1.5 * min(len(gap.causes), MAX_CAUSES) + 2
        size_in = _NARROW_WIDTH_IN, _FRAME_IN + _ROW_IN * row_count
        yield "why_probability", size_in, partial(_draw_probabilities, gap=gap)
        yield "why_closes", size_in, partial(_draw_removed_shares, gap=gap)
    if gap.unknown:
        for name, height_in, draw in drawings(gap.unknown):
            yield f"unknown_{name}", (_NARROW_WIDTH_IN, height_in), draw
    if gap.rollout and gap.rollout.example:
        yield (
            "prediction_motion",
            (_WIDE_WIDTH_IN, _HEIGHT_IN),
            partial(_draw_predicted_motion, example=gap.rollout.example),
        )
    for name, height_in, draw in _attribution_drawings(gap.attribution):
        yield f"where_{name}", (_NARROW_WIDTH_IN, height_in), draw


def _draw_bands(figure: Any, gap: Gap) -> None:
    """Unexplained shares over frequency, in per cent; zeros of a logarithmic axis are not drawn."""
    band_edges_hz = [band.low_hz for band in gap.bands] + [gap.bands[-1].high_hz]
    axes = figure.subplots()
    drawn_curves = [("the model as it is", RED, 3.2, "-", [band.before for band in gap.bands])]
    if gap.causes and is_effective(gap.causes[0]):
        drawn_curves.append(("with the likeliest cause", BLUE, 1.4, "-", [band.after for band in gap.bands]))
    drawn_curves.append(("95 % limit of tolerances and noise", GREEN, 1.4, ":", [band.usual for band in gap.bands]))
    for label, colour, line_width, line_style, band_shares in drawn_curves:
        line_options = {"color": colour, "lw": line_width, "ls": line_style, "label": label}
        axes.stairs(100 * np.array(band_shares), band_edges_hz, baseline=None, **line_options)
    axes.set_yscale("log", nonpositive="mask")
    axes.set_xlim(band_edges_hz[0], band_edges_hz[-1])
    axes.set(xlabel="frequency, Hz", ylabel="unexplained share of the band's rms, %")
    figure.legend(loc="outside upper center", ncols=2)


def _draw_quantities(figure: Any, gap: Gap) -> None:
    """Each deciding quantity over its threshold, with the upper end of its interval, or a line to the edge without one,
    for the rigs without and with the first cause.
    """
    quantities = gap.evidence.quantities
    axes = figure.subplots()
    drawn_rigs = [("the model as it is", quantities, RED, "s", 0.0)]
    if gap.causes and is_effective(gap.causes[0]):
        drawn_rigs.append(("with the likeliest cause", gap.evidence.quantities_after, BLUE, "o", 0.28))
    largest_ratio = 2.0
    for label, rig_quantities, colour, marker, row_offset in drawn_rigs:
        rows = row_offset + np.arange(len(rig_quantities))
        ratios = np.array(  # a value that is not known is not drawn
            [
                [np.nan if end is None else end / quantity.threshold for end in (quantity.value, quantity.upper)]
                for quantity in rig_quantities
            ]
        )
        drawn_ratios = np.maximum(ratios, LEAST_RATIO)
        axes.plot(drawn_ratios[:, 0], rows, marker, color=colour, label=label)
        for row, value_and_upper in zip(rows, drawn_ratios, strict=True):
            line_ends = np.nan_to_num(value_and_upper, nan=UNBOUNDED_RATIO, posinf=UNBOUNDED_RATIO)
            axes.plot(line_ends, [row, row], color=colour, lw=2.0)
        largest_ratio = max(largest_ratio, 2 * np.max(ratios, initial=0.0, where=np.isfinite(ratios)))
    axes.axvline(1.0, color=INK, lw=1.2, ls="--", label="limit")
    axes.set_xscale("log")
    axes.set_xlim(0.7 * LEAST_RATIO, largest_ratio)
    limits = [
        f", limit {value_bound_and_limit_texts(quantity)[-1]}" if quantity.threshold else "" for quantity in quantities
    ]
    names = [f"{_shortened_name(quantity.name)}{limit}" for quantity, limit in zip(quantities, limits, strict=True)]
    axes.set_yticks(np.arange(len(quantities)), names)
    axes.set_ylim(len(quantities) - 0.5, -0.5)
    axes.set(xlabel="difference over its limit")
    figure.legend(loc="outside upper center", ncols=3)


def _draw_probabilities(figure: Any, gap: Gap) -> None:
    """Probabilities of the likeliest causes, all others, no cause, and something unmeasured; they sum to one."""
    rows = [(_cause_lines(cause_name(cause)), cause.probability) for cause in gap.causes[:MAX_CAUSES]]
    rows += remaining_probabilities(gap, MAX_CAUSES)
    colours = [BLUE] * (len(rows) - 2) + [GREEN, GREY]
    names, probabilities = zip(*rows, strict=True)
    labels = [probability(p) for p in probabilities]
    axes = _bar_axes(figure, names, [100 * p for p in probabilities], labels, colours)
    axes.set(xlim=(0, 150), xticks=range(0, 101, 25), xlabel="probability, %")
    figure.suptitle("How likely each cause is", fontsize=10)


def _draw_removed_shares(figure: Any, gap: Gap) -> None:
    """Share of the mismatch that each of the likeliest causes removes, with its 95 % interval."""
    causes = gap.causes[:MAX_CAUSES]
    removed = [100 * min(max(cause.explained, 0.0), 1.0) for cause in causes]
    intervals = 100 * np.clip([cause.interval_95 for cause in causes], 0, 1)
    names = [f"{_cause_lines(cause_name(cause))}\n{removed_share_words(cause)}" for cause in causes]
    axes = _bar_axes(figure, names, removed, [""] * len(causes), BLUE)
    for row, (lower, upper) in enumerate(intervals):
        axes.plot([lower, upper], [row, row], color=INK, lw=2.0, marker="|", ms=8)
    axes.set(xlim=(0, 105), xticks=range(0, 101, 25), xlabel="share of the difference that it removes, %")
    axes.set_ylim(len(causes) - 0.4, -0.6)
    figure.suptitle("What each cause removes, with its 95 % interval", fontsize=10)


def _draw_experiments(figure: Any, gap: Gap) -> None:
    """Expected gain of each further recording in the log odds of the true one of two causes."""
    experiments = gap.next_experiments
    gains = [experiment.log_odds for experiment in experiments]
    is_same = [experiment.words == SAME_EXPERIMENT for experiment in experiments]
    names = [experiment.words + " (reference)" * same for experiment, same in zip(experiments, is_same, strict=True)]
    colours = [GREY if same else BLUE for same in is_same]
    axes = _bar_axes(figure, names, gains, [f"{gain:.1f}" for gain in gains], colours)
    axes.axvline(LOG_ODDS_95, color=INK, lw=1.2, ls="--", label="turns even odds into 95 %")
    axes.margins(x=0.12)
    axes.set(xlabel="expected gain of the log odds of the true one (natural logarithm)")
    figure.legend(loc="outside lower right")
    figure.suptitle(f"Which further recording tells {' from '.join(gap.next_between)}", fontsize=10)


def _draw_predicted_motion(figure: Any, example: PredictionExample) -> None:
    """Measured motion, and its predictions by the nominal and the corrected rig."""
    axes = figure.subplots()
    quantity, unit, scale = ("displacement", "mm", 1e3) if example.unit == "m" else ("velocity", example.unit, 1.0)
    for values, colour, width, style, label in (
        (example.measured, GREY, 3.0, "-", "measured"),
        (example.nominal, RED, 1.2, "--", "predicted by the model as it is"),
        (example.corrected, BLUE, 1.2, "-", "with the named effects"),
    ):
        axes.plot(example.time_s, scale * np.array(values), color=colour, lw=width, ls=style, label=label)
    figure.legend(loc="outside lower center", ncols=3)
    axes.set(xlabel="time, s", ylabel=f"{quantity} of {example.sensor}, {unit}")


def _attribution_drawings(attribution: Attribution) -> Iterator[tuple[str, float, DrawFunction]]:
    """Name, height in inches and drawing function of each picture of the mismatch's location.

    Left out where all shares are zero, as those of the acceleration of a single mass, whose mismatch is in the contact
    force.
    """
    positions, bands, times = attribution.positions_m, attribution.band_hz, attribution.time_s
    if any(any(station_shares.values()) for station_shares in positions.values()):
        yield "positions", 0.6 + 1.5 * len(positions), partial(_draw_positions, shares_by_body=positions)
    if any(band.share for band in bands):
        draw_bands = partial(_draw_shares_by_range, shares=bands, title="By frequency", x_label="band, Hz")
        yield "band", _HEIGHT_IN, draw_bands
    for name, shares, title in (
        ("channels", attribution.channels, "By channel"),
        ("modal_equations", attribution.modal_equations, "By modal equation"),
        ("parts", attribution.parts, "Linear structure or contact laws"),
        ("contact_state", attribution.contact_state, "By contact state"),
    ):
        if any(shares.values()):
            height_in = _FRAME_IN + _ROW_IN * len(shares)
            yield name, height_in, partial(_draw_share_bars, share_by_part=shares, title=title)
    if any(time.share for time in times):
        yield "time", _HEIGHT_IN, partial(_draw_shares_by_range, shares=times, title="Over time", x_label="time, s")
    for number, (contact_name, residual_map) in enumerate(attribution.surface.items(), 1):
        draw_surface = partial(_draw_residual_map, residual_map=residual_map, contact_name=contact_name)
        yield f"surface_{number}", _HEIGHT_IN, draw_surface


def _draw_share_bars(figure: Any, share_by_part: Mapping[str, float], title: str) -> None:
    percents = [100 * share for share in share_by_part.values()]
    names, labels = map(_shortened_name, share_by_part), [f"{value:.1f}" for value in percents]
    axes = _bar_axes(figure, list(names), percents, labels, BLUE)
    axes.margins(x=0.18)
    axes.set(xlabel="share of the mean square, %")
    figure.suptitle(title, fontsize=10)


def _draw_shares_by_range(figure: Any, shares: Sequence[Share], title: str, x_label: str) -> None:
    axes = figure.subplots()
    bars = np.arange(len(shares))
    axes.bar(bars, [100 * share.share for share in shares], width=0.85, color=BLUE)
    labelled = slice(None, None, -(-len(shares) // MAX_LABELS))
    names = [_shortened_name(f"{share.begin:.3g} to {share.end:.3g}") for share in shares]
    axes.set_xticks(bars[labelled], names[labelled], rotation=40, ha="right", rotation_mode="anchor")
    axes.grid(axis="x", visible=False)
    axes.set(xlabel=x_label, ylabel="share of the mean square, %", title=title)


def _draw_positions(figure: Any, shares_by_body: Mapping[str, Mapping[float, float]]) -> None:
    """Each body as a thick line from its left end, a bar at every station."""
    body_axes = figure.subplots(len(shares_by_body), 1, squeeze=False, sharex=True, sharey=True)[:, 0]
    longest_m = max([position_m for stations in shares_by_body.values() for position_m in stations], default=0.0) or 1.0
    for axes, (body_name, share_by_station) in zip(body_axes, shares_by_body.items(), strict=True):
        positions_m = np.array(list(share_by_station))
        percents = 100 * np.array(list(share_by_station.values()))
        axes.plot([0.0, max(positions_m.max(initial=0.0), 0.02 * longest_m)], [0, 0], color=INK, lw=5, zorder=3)
        bars = axes.bar(positions_m, percents, width=0.04 * longest_m, color=BLUE)
        axes.plot(positions_m, 0 * positions_m, "^", ms=5, color="white", mec=INK, zorder=4, clip_on=False)
        if positions_m.size <= MAX_LABELS:
            axes.bar_label(bars, [f"{value:.0f}" for value in percents], padding=2)
        axes.margins(y=0.22)
        axes.set_title(_shortened_name(body_name), loc="left", fontsize=9)
    body_axes[-1].set_xlabel("distance from the left end, m")
    body_axes[0].set_ylabel("share of the mean square, %")
    figure.suptitle("Along the bodies (stations marked)", fontsize=10)


def _draw_residual_map(figure: Any, residual_map: ResidualMap, contact_name: str) -> None:
    axes = figure.subplots()
    percents = 100 * np.array(residual_map.share)
    drawn_percents = np.where(percents > 0, percents, np.nan).T
    eta_mm = 1e3 * np.array(residual_map.eta_m)
    mesh = axes.pcolormesh(eta_mm, residual_map.rate_m_per_s, drawn_percents, cmap="viridis_r")
    figure.colorbar(mesh, label="share of the mean square, %")
    axes.set(xlabel="displacement, mm", ylabel="velocity, m/s", title=f"At {_shortened_name(contact_name)}")


def _shortened_name(name: str) -> str:
    return name if len(name) <= MAX_NAME_CHARACTERS else f"{name[: MAX_NAME_CHARACTERS - 1]}…"


def _cause_lines(cause_title: str) -> str:
    """Name of a cause with one effect per line."""
    first_effect, *further_effects = cause_title.split(" + ")
    return "\n".join([_shortened_name(first_effect), *(_shortened_name(f"+ {effect}") for effect in further_effects)])


def _bar_axes(figure: Any, names: Sequence[str], lengths: Sequence[float], labels: Sequence[str], colours: Any) -> Any:
    """Axes with horizontal bars, the first on top, and a label at the end of each."""
    axes, rows = figure.subplots(), np.arange(len(names))
    axes.bar_label(axes.barh(rows, lengths, height=0.62, color=colours), labels, padding=4)
    axes.set_yticks(rows, names)
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    return axes
