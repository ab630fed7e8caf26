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

DrawFunction = Callable[[Any], None]

MAX_CAUSES = 6
"""Causes of a figure at most. Display."""
MAX_LABELS = 12
"""Labels of an axis at most. Display."""
LEAST_PERCENT, UNBOUNDED_PERCENT = 1.0, 1e6
"""Per cent of its threshold at which a smaller value is drawn, and to which the line of an unbounded one goes."""
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
    return {name: picture(draw_function, *size_in) for name, size_in, draw_function in _drawings(gap)}


def _drawings(gap: Gap) -> Iterator[tuple[str, tuple[float, float], DrawFunction]]:
    """Name, width and height in inches, and drawing function of each picture."""
    if gap.next_experiments:
        height_in = _FRAME_IN + _ROW_IN * len(gap.next_experiments)
        yield "next_experiments", (_WIDE_IN, height_in), partial(_draw_experiments, gap=gap)
    if any(band.before or band.after or band.usual for band in gap.bands):
        yield "large_bands", (_WIDE_IN, 3.6), partial(_draw_bands, gap=gap)
    if quantity_count := len(gap.evidence.quantities):
        yield "decided_quantities", (_WIDE_IN, 1.6 + 0.5 * quantity_count), partial(_draw_quantities, gap=gap)
    if gap.causes:
        row_count = 1.5 * min(len(gap.causes), MAX_CAUSES) + 2
        yield "why_probability", (_WIDTH_IN, _FRAME_IN + _ROW_IN * row_count), partial(_draw_probabilities, gap=gap)
        yield "why_closes", (_WIDTH_IN, _FRAME_IN + _ROW_IN * row_count), partial(_draw_removed_shares, gap=gap)
    if gap.unknown:
        for picture_name, height_in, draw_function in drawings(gap.unknown):
            yield f"unknown_{picture_name}", (_WIDTH_IN, height_in), draw_function
    if gap.rollout and gap.rollout.example:
        yield "prediction_motion", (_WIDE_IN, _HEIGHT_IN), partial(_draw_motion, example=gap.rollout.example)
    for picture_name, height_in, draw_function in _attribution_drawings(gap.attribution):
        yield f"where_{picture_name}", (_WIDTH_IN, height_in), draw_function


def _draw_bands(figure: Any, gap: Gap) -> None:
    """Unexplained shares over frequency, in per cent; zeros of a logarithmic axis are not drawn."""
    band_edges_hz = [band.low_hz for band in gap.bands] + [gap.bands[-1].high_hz]
    axes = figure.subplots()
    drawn_curves = [("the model as it is", RED, 3.2, "-", [band.before for band in gap.bands])]
    if gap.causes and is_effective(gap.causes[0]):
        drawn_curves.append(("with the likeliest causes", BLUE, 1.4, "-", [band.after for band in gap.bands]))
    drawn_curves.append(("95 % limit of tolerances and noise", GREEN, 1.4, ":", [band.usual for band in gap.bands]))
    for label, colour, line_width, line_style, band_shares in drawn_curves:
        line_options = {"color": colour, "lw": line_width, "ls": line_style, "label": label}
        axes.stairs(100 * np.array(band_shares), band_edges_hz, baseline=None, **line_options)
    limit_label = f"matters above {percent(gap.matters.motion)} (whole motion)"
    axes.axhline(100 * gap.matters.motion, color=INK, lw=1.2, ls="--", label=limit_label)
    axes.set_yscale("log", nonpositive="mask")
    axes.set_xlim(band_edges_hz[0], band_edges_hz[-1])
    axes.set(xlabel="frequency, Hz", ylabel="unexplained share of the acceleration, %")
    figure.legend(loc="outside upper center", ncols=2)


def _draw_quantities(figure: Any, gap: Gap) -> None:
    """Each deciding quantity over its threshold, with the upper end of its interval, or a line to the edge without one,
    for the rigs without and with the first cause.
    """
    quantities = gap.evidence.quantities
    axes = figure.subplots()
    drawn_rigs = [("the model as it is", quantities, RED, "s", 0.0)]
    if gap.causes and is_effective(gap.causes[0]):
        drawn_rigs.append(("with the likeliest causes", gap.evidence.quantities_after, BLUE, "o", 0.28))
    right_percent = 200.0
    for label, rig_quantities, colour, marker, row_offset in drawn_rigs:
        rows = row_offset + np.arange(len(rig_quantities))
        ends_percent = [
            [
                np.nan if quantity_value is None else 100 * quantity_value / quantity.threshold
                for quantity_value in (quantity.value, quantity.upper)
            ]
            for quantity in rig_quantities
        ]
        values_percent, upper_percent = np.maximum(
            np.array(ends_percent), LEAST_PERCENT
        ).T  # a value that is not known is not drawn
        axes.plot(values_percent, rows, marker, color=colour, label=label)
        for row, value, upper_end in zip(rows, values_percent, upper_percent, strict=True):
            line_ends = np.nan_to_num([value, upper_end], nan=UNBOUNDED_PERCENT, posinf=UNBOUNDED_PERCENT)
            axes.plot(line_ends, [row, row], color=colour, lw=2.0)
        right_percent = max(
            right_percent, 2 * np.max(np.array(ends_percent), initial=0.0, where=np.isfinite(ends_percent))
        )
    axes.axvline(100.0, color=INK, lw=1.2, ls="--", label="what matters")
    axes.set_xscale("log")
    axes.set_xlim(0.7 * LEAST_PERCENT, right_percent)
    axes.set_yticks(np.arange(len(quantities)), [_shortened_name(quantity.name) for quantity in quantities])
    axes.set_ylim(len(quantities) - 0.5, -0.5)
    axes.set(xlabel="difference relative to the least that matters, %")
    figure.legend(loc="outside upper center", ncols=3)


def _draw_probabilities(figure: Any, gap: Gap) -> None:
    """Probabilities of the likeliest causes, all others, no cause, and something unmeasured; they sum to one."""
    top_causes, remaining_causes = gap.causes[:MAX_CAUSES], gap.causes[MAX_CAUSES:]
    labelled_rows = [(_cause_lines(cause_name(cause)), cause.probability) for cause in top_causes]
    if remaining_causes:
        labelled_rows.append(
            (f"{len(remaining_causes)} further causes", sum(cause.probability for cause in remaining_causes))
        )
    labelled_rows += remaining_probabilities(gap)
    colours = [BLUE] * (len(labelled_rows) - 2) + [GREEN, GREY]
    bar_names, percentages = ([row[0] for row in labelled_rows], [100 * row[1] for row in labelled_rows])
    axes = _bar_axes(figure, bar_names, percentages, [probability(row[1]) for row in labelled_rows], colours)
    axes.set(xlim=(0, 130), xticks=range(0, 101, 25), xlabel="probability, %")
    figure.suptitle("How likely each cause is", fontsize=10)


def _draw_removed_shares(figure: Any, gap: Gap) -> None:
    """Share of the mismatch that each of the likeliest causes removes, with its 95 % interval."""
    top_causes = gap.causes[:MAX_CAUSES]
    removed_percent = [100 * min(max(top_cause.explained, 0.0), 1.0) for top_cause in top_causes]
    intervals_percent = 100 * np.clip([top_cause.interval_95 for top_cause in top_causes], 0, 1)
    cause_names = [_cause_lines(cause_name(top_cause)) for top_cause in top_causes]
    axes = _bar_axes(figure, cause_names, removed_percent, [""] * len(top_causes), BLUE)
    for bar_index, (cause, (lower_percent, upper_percent)) in enumerate(
        zip(top_causes, intervals_percent, strict=True)
    ):
        axes.plot([lower_percent, upper_percent], [bar_index, bar_index], color=INK, lw=2.0, marker="|", ms=8)
        axes.annotate(
            removed_share_words(cause),
            (max(upper_percent, removed_percent[bar_index]), bar_index),
            (6, 0),
            textcoords="offset points",
            va="center",
        )
    axes.set(xlim=(0, 210), xticks=range(0, 101, 25), xlabel="share of the difference that it closes, %")
    axes.set_ylim(len(top_causes) - 0.4, -0.6)
    figure.suptitle("What each cause closes, with its 95 % interval", fontsize=10)


def _draw_experiments(figure: Any, gap: Gap) -> None:
    """Expected gain of each further recording in the log odds of the true one of two causes."""
    next_experiments = gap.next_experiments
    gains = [experiment.log_odds for experiment in next_experiments]
    experiment_words = [
        experiment.words + " (reference)" * (experiment.words == SAME_EXPERIMENT) for experiment in next_experiments
    ]
    colours = [GREY if experiment.words == SAME_EXPERIMENT else BLUE for experiment in next_experiments]
    axes = _bar_axes(figure, experiment_words, gains, [f"{gain:.1f}" for gain in gains], colours)
    axes.axvline(LOG_ODDS_95, color=INK, lw=1.2, ls="--", label="turns even odds into 95 %")
    axes.margins(x=0.12)
    axes.set(xlabel="expected gain of the log odds of the true one (natural logarithm)")
    figure.legend(loc="outside lower right")
    figure.suptitle(f"Which further recording tells {' from '.join(gap.next_between)}", fontsize=10)


def _draw_motion(figure: Any, example: PredictionExample) -> None:
    """Measured motion, and its predictions by the nominal and the corrected rig."""
    axes = figure.subplots()
    quantity_name, unit, scale = ("displacement", "mm", 1e3) if example.unit == "m" else ("velocity", example.unit, 1.0)
    for signal_values, colour, line_width, line_style, label in (
        (example.measured, GREY, 3.0, "-", "measured"),
        (example.nominal, RED, 1.2, "--", "predicted by the model as it is"),
        (example.corrected, BLUE, 1.2, "-", "with the named effects"),
    ):
        axes.plot(
            example.time_s, scale * np.array(signal_values), color=colour, lw=line_width, ls=line_style, label=label
        )
    figure.legend(loc="outside lower center", ncols=3)
    axes.set(xlabel="time, s", ylabel=f"{quantity_name} of {example.sensor}, {unit}")


def _attribution_drawings(attribution: Attribution) -> Iterator[tuple[str, float, DrawFunction]]:
    """Name, height in inches and drawing function of each picture of the mismatch's location.

    Left out where all shares are zero, as those of the acceleration of a single mass, whose mismatch is in the contact
    force.
    """
    if any(any(share_by_station.values()) for share_by_station in attribution.positions_m.values()):
        yield (
            "positions",
            0.6 + 1.5 * len(attribution.positions_m),
            partial(_draw_positions, shares_by_body=attribution.positions_m),
        )
    if any(interval_share.share for interval_share in attribution.band_hz):
        yield (
            "band",
            _HEIGHT_IN,
            partial(_draw_share_row, shares=attribution.band_hz, title="By frequency", x_label="band, Hz"),
        )
    for picture_name, shares, title in (
        ("channels", attribution.channels, "By channel"),
        ("modal_equations", attribution.modal_equations, "By modal equation"),
        ("parts", attribution.parts, "Linear structure or contact laws"),
        ("contact_state", attribution.contact_state, "By contact state"),
    ):
        if any(shares.values()):
            yield (
                picture_name,
                _FRAME_IN + _ROW_IN * len(shares),
                partial(_draw_share_bars, share_by_part=shares, title=title),
            )
    if any(interval_share.share for interval_share in attribution.time_s):
        yield (
            "time",
            _HEIGHT_IN,
            partial(_draw_share_row, shares=attribution.time_s, title="Over time", x_label="time, s"),
        )
    for surface_number, (contact_name, residual_map) in enumerate(attribution.surface.items(), 1):
        yield (
            f"surface_{surface_number}",
            _HEIGHT_IN,
            partial(_draw_surface, residual_map=residual_map, contact_name=contact_name),
        )


def _draw_share_bars(figure: Any, share_by_part: Mapping[str, float], title: str) -> None:
    percentages = [100 * share for share in share_by_part.values()]
    axes = _bar_axes(
        figure,
        [_shortened_name(part) for part in share_by_part],
        percentages,
        [f"{share:.1f}" for share in percentages],
        BLUE,
    )
    axes.margins(x=0.18)
    axes.set(xlabel="share of the difference, %")
    figure.suptitle(title, fontsize=10)


def _draw_share_row(figure: Any, shares: Sequence[Share], title: str, x_label: str) -> None:
    axes = figure.subplots()
    axes.bar(np.arange(len(shares)), [100 * share.share for share in shares], width=0.85, color=BLUE)
    labelled_bars = slice(None, None, -(-len(shares) // MAX_LABELS))
    interval_names = [_shortened_name(f"{share.begin:.3g} to {share.end:.3g}") for share in shares]
    axes.set_xticks(
        np.arange(len(shares))[labelled_bars],
        interval_names[labelled_bars],
        rotation=40,
        ha="right",
        rotation_mode="anchor",
    )
    axes.grid(axis="x", visible=False)
    axes.set(xlabel=x_label, ylabel="share of the difference, %", title=title)


def _draw_positions(figure: Any, shares_by_body: Mapping[str, Mapping[float, float]]) -> None:
    """Each body as a thick line from its left end, a bar at every station."""
    body_axes = figure.subplots(len(shares_by_body), 1, squeeze=False, sharex=True, sharey=True)[:, 0]
    longest_m = max([position_m for stations in shares_by_body.values() for position_m in stations], default=0.0) or 1.0
    for axes, (body_name, share_by_station) in zip(body_axes, shares_by_body.items(), strict=True):
        positions_m = np.array(list(share_by_station))
        percentages = 100 * np.array(list(share_by_station.values()))
        axes.plot([0.0, max(positions_m.max(initial=0.0), 0.02 * longest_m)], [0, 0], color=INK, lw=5, zorder=3)
        station_bars = axes.bar(positions_m, percentages, width=0.04 * longest_m, color=BLUE)
        axes.plot(positions_m, 0 * positions_m, "^", ms=5, color="white", mec=INK, zorder=4, clip_on=False)
        if positions_m.size <= MAX_LABELS:
            axes.bar_label(station_bars, [f"{percentage:.0f}" for percentage in percentages], padding=2)
        axes.margins(y=0.22)
        axes.set_title(_shortened_name(body_name), loc="left", fontsize=9)
    body_axes[-1].set_xlabel("distance from the left end, m")
    body_axes[0].set_ylabel("share of the difference, %")
    figure.suptitle("Along the bodies (stations marked)", fontsize=10)


def _draw_surface(figure: Any, residual_map: ResidualMap, contact_name: str) -> None:
    axes = figure.subplots()
    percentages = 100 * np.array(residual_map.share)
    cell_mesh = axes.pcolormesh(
        1e3 * np.array(residual_map.eta_m),
        residual_map.rate_m_per_s,
        np.where(percentages > 0, percentages, np.nan).T,
        cmap="viridis_r",
    )
    figure.colorbar(cell_mesh, label="share of the difference, %")
    axes.set(xlabel="displacement, mm", ylabel="velocity, m/s", title=f"At {_shortened_name(contact_name)}")


def _shortened_name(long_name: str) -> str:
    return long_name if len(long_name) <= MAX_NAME_CHARACTERS else f"{long_name[: MAX_NAME_CHARACTERS - 1]}…"


def _cause_lines(cause_title: str) -> str:
    """Name of a cause with one effect per line."""
    first_effect, *further_effects = cause_title.split(" + ")
    return "\n".join([_shortened_name(first_effect), *(_shortened_name(f"+ {effect}") for effect in further_effects)])


def _bar_axes(
    figure: Any, bar_names: Sequence[str], bar_lengths: Sequence[float], bar_labels: Sequence[str], colours: Any
) -> Any:
    """Axes with horizontal bars, the first on top, and a label at the end of each."""
    axes = figure.subplots()
    drawn_bars = axes.barh(np.arange(len(bar_names)), bar_lengths, height=0.62, color=colours)
    axes.bar_label(drawn_bars, bar_labels, padding=4)
    axes.set_yticks(np.arange(len(bar_names)), bar_names)
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    return axes
