"""History of a machine as a sentence, a table, a figure, history.csv and the page history.html."""

import csv
from collections.abc import Iterator, Sequence
from io import StringIO
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from identify.contacts.results import Estimate
from identify.history.changes import MIN_TREND_COUNT, SIGNIFICANCE_LEVEL, History, QuantityHistory
from identify.pages import page
from identify.pages.style import Picture
from identify.pages.wording import COVERED, interval, number, p_value_words

ORDER_LABEL = "recording, in order"
TIME_UNITS_S = (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0))
WORD_UNIT_FACTOR = {
    "clearance_m": ("clearance", "mm", 1e3),
    "stiffness_n_per_m": ("stiffness", "N/m", 1.0),
    "damping_n_s_per_m": ("damping", "N s/m", 1.0),
    "frequency_hz": ("frequency", "Hz", 1.0),
    "damping_ratio": ("damping", "%", 100.0),
}


def sentence(history: History) -> str:
    """Sentence on the quantities that changed, by how much, and with which p-value."""
    names = [observation.name for observation in history.compared]
    change_texts = [f"{quantity_name(q)} {_change_predicate(q, names)}" for q in history.quantities if q.changed]
    changes_text = "; ".join(change_texts) or "nothing changed by more than chance"
    return f"{len(history.compared)} recordings of {history.rig}: {changes_text}."


def quantity_name(quantity: QuantityHistory) -> str:
    return f"{quantity.of}: {WORD_UNIT_FACTOR[quantity.quantity][0]}"


def _change_predicate(quantity: QuantityHistory, recordings: Sequence[str]) -> str:
    """Predicate on a quantity that changed: its drift if the trend is significant, else its largest change."""
    if quantity.p_trend is not None and quantity.p_trend < SIGNIFICANCE_LEVEL:
        return f"drifts by {drift_text(quantity)} from the first to the last ({p_value_words(quantity.p_trend)})"
    return f"changes by {change_text(quantity, recordings)} ({p_value_words(quantity.p_different or 0.0)})"


def change_text(quantity: QuantityHistory, recordings: Sequence[str]) -> str:
    """Largest change from the first recording ± 95 %, its recordings, and the value that it has now: "+0.0202 ± 0.0003
    mm to 0.5204 mm in day3 against day1"."""
    if quantity.largest_change is None:
        return ""
    first_index, last_index, change = quantity.largest_change
    _, unit, unit_factor = WORD_UNIT_FACTOR[quantity.quantity]
    value_text = f"{number(unit_factor * (quantity.values[last_index] or 0.0))} {unit}"
    places_text = f"in {recordings[last_index]} against {recordings[first_index]}"
    return f"{_signed_interval(quantity, change)} to {value_text} {places_text}"


def _signed_interval(quantity: QuantityHistory, change: Estimate) -> str:
    """Change with its sign and 95 % interval, lengths below a tenth of a millimetre in micrometres."""
    _, unit, unit_factor = WORD_UNIT_FACTOR[quantity.quantity]
    if unit == "mm" and abs(change.value) < 1e-4:
        unit, unit_factor = "µm", 1e6
    value, error = unit_factor * change.value, unit_factor * change.standard_error
    words = f"{number(value, 2)} {unit}" if error == 0 else interval(value, error, unit)
    return "+" * (value > 0) + words


def drift_text(quantity: QuantityHistory) -> str:
    """Change along the trend ± 95 %, in its unit and, if smaller than the mean, in per cent of it."""
    if quantity.drift is None:
        return ""
    change = quantity.drift.value
    percent_phrase = f" ({100 * change / quantity.mean:+.2g} %)" if abs(change) < abs(quantity.mean) else ""
    return _signed_interval(quantity, quantity.drift) + percent_phrase


QUANTITY_HEADINGS = ("", "mean", "largest change", "p", "first to last, along the trend", "p of the trend")


def quantity_rows(history: History) -> Iterator[tuple[str, ...]]:
    """Yield for each quantity its name, mean, largest change, p of that, change along the trend, and p of the trend."""
    recordings = [observation.name for observation in history.compared]
    for quantity in history.quantities:
        _, unit, unit_factor = WORD_UNIT_FACTOR[quantity.quantity]
        p_different, p_trend = (
            "" if p_value is None else p_value_words(p_value).removeprefix("p ").removeprefix("= ")
            for p_value in (quantity.p_different, quantity.p_trend)
        )
        mean, change = f"{number(unit_factor * quantity.mean)} {unit}", change_text(quantity, recordings)
        yield quantity_name(quantity), mean, change, p_different, drift_text(quantity), p_trend


def quantity_table(history: History) -> tuple[list[str], list[list[str]]]:
    """Headings and rows of the quantities, without the columns that are empty."""
    rows = [*quantity_rows(history)]
    filled = [0, *(column for column in range(1, len(QUANTITY_HEADINGS)) if any(row[column] for row in rows))]
    return [QUANTITY_HEADINGS[column] for column in filled], [[row[column] for column in filled] for row in rows]


def history_csv(history: History) -> bytes:
    """Content of history.csv: a row for each quantity and recording, with the half-widths of the 95 % intervals of the
    value alone and of its differences."""
    csv_buffer = StringIO()
    writer = csv.writer(csv_buffer, lineterminator="\n")
    writer.writerow(["recording", "recorded", "of", "quantity", "unit", "value", "within_95", "own_within_95"])
    for q in history.quantities:
        for recording, value, *errors in zip(history.compared, q.values, q.standard_errors, q.own_errors, strict=True):
            if value is not None:
                half_widths = ["" if not value_error else repr(COVERED * value_error) for value_error in errors]
                date_text = f"{recording.recorded:%Y-%m-%dT%H:%M:%SZ}" if recording.recorded else ""
                writer.writerow([recording.name, date_text, q.of, q.quantity, q.unit, repr(value), *half_widths])
    return csv_buffer.getvalue().encode()


def _axis_positions_and_label(history: History) -> tuple[Float[np.ndarray, " recordings"], str]:
    """Position of each recording on the axis, and its label: the time since the first recording if all have a date and
    the dates ascend, else the order."""
    dates = [observation.recorded for observation in history.compared if observation.recorded]
    since_first_s = np.array([(date - dates[0]).total_seconds() for date in dates])
    if since_first_s.size < len(history.compared) or not np.all(np.diff(since_first_s) > 0):
        return np.arange(1.0, len(history.compared) + 1), ORDER_LABEL
    large_units = (time_unit for time_unit in TIME_UNITS_S if since_first_s[-1] >= 2 * time_unit[1])
    time_unit_name, unit_s = next(large_units, TIME_UNITS_S[-1])
    return since_first_s / unit_s, f"time since {dates[0]:%Y-%m-%d %H:%M} UTC, {time_unit_name}"


def history_figure(history: History) -> Picture:
    """Figure of clearance and stiffness of every contact over the recordings, as deviations from their means in %."""
    from identify.pages.style import BLUE, GREEN, GREY, RED, picture

    markers_and_colours = [("o-", BLUE), ("s-", RED), ("^-", GREEN), ("v-", GREY)]
    positions, axis_label = _axis_positions_and_label(history)

    def draw(figure: Any) -> None:
        panels = figure.subplots(2, 1, sharex=True)
        for axes, quantity in zip(panels, ("clearance_m", "stiffness_n_per_m"), strict=True):
            histories = [q for q in history.quantities if q.quantity == quantity]
            for k, (series, (fmt, colour)) in enumerate(zip(histories, cycle(markers_and_colours), strict=False)):
                values, errors = np.array([series.values, series.own_errors], dtype=float)
                x = positions + 0.08 * np.diff(positions).min() * (k - (len(histories) - 1) / 2)
                deviations, half_widths = 100 * (values / series.mean - 1), 100 * COVERED * errors / series.mean
                style = {"fmt": fmt, "color": colour, "label": series.of, "ms": 4, "lw": 0.8, "capsize": 2}
                axes.errorbar(x, deviations, half_widths, **style)
            axes.set_ylabel(f"{WORD_UNIT_FACTOR[quantity][0]} less its mean, % of the mean")
        panels[0].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        panels[1].set_xlabel(axis_label)
        if axis_label == ORDER_LABEL:
            panels[1].xaxis.get_major_locator().set_params(integer=True)

    return picture(draw)


def write_page(history: History, figure: Picture, path: Path) -> None:
    """Write history.html."""
    has_changes = any(quantity.changed for quantity in history.quantities)
    has_findings = any(observation.report.findings for observation in history.compared if observation.report)
    page.write(
        path,
        title=f"{history.rig}: {len(history.compared)} recordings compared",
        answer=page.Answer(
            "yellow" if has_findings or has_changes else "green",
            "not to be relied on" if has_findings else "changed" if has_changes else "no change",
            [sentence(history)],
        ),
        sections=_sections(history, figure),
        foot_text="Made by identify compare or identify history; the numbers are in history.csv and history.json.",
    )


def _sections(history: History, figure: Picture) -> list[tuple[str, str]]:
    """Sections of the page: headings and HTML."""
    caption = (
        "Every recording's value less the mean of all, in % of that. Bars: 95 % intervals of the differences between "
        "recordings, without what rig.json may have wrong, which is the same in all of them."
    )
    table_note = (
        f"<p>± 95 %. A trend is tested from {MIN_TREND_COUNT} recordings on. p is the chance of such a change, or of "
        f"such a trend, in a machine that does not change, corrected for the number of tests: in one history of "
        f"{1 / SIGNIFICANCE_LEVEL:.0f} any p falls below {SIGNIFICANCE_LEVEL:g} by chance.</p>"
    )
    recordings_html = page.table(("", "recording", "SHA-256", "recorded, UTC", "told"), _recording_rows(history))
    return [
        ("Over the recordings", page.figure("history", figure, caption)),
        ("What changed", table_note + page.table(*quantity_table(history))),
        ("The recordings", recordings_html),
    ]


def _recording_rows(history: History) -> Iterator[Sequence[str]]:
    """Yield for each recording its number if it is used, name, digits of the SHA-256, date and remark."""
    compared_count = 0
    for observation in history.observations:
        number_text, remark = "", f"left out: {observation.reason}"
        if observation.report is not None:
            compared_count += 1
            findings = "; ".join(finding.sentence for finding in observation.report.findings)
            number_text, remark = str(compared_count), f"not to be relied on: {findings}" if findings else "used"
        date_text = f"{observation.recorded:%Y-%m-%d %H:%M}" if observation.recorded else ""
        yield number_text, observation.name, observation.sha256[: page.SHOWN_DIGITS], date_text, remark
