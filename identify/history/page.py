"""The history as a page, a figure and a table."""

import csv
from collections.abc import Iterator, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from identify.history.changes import FEWEST, LEVEL, UNITS, History, Observation, QuantityHistory
from identify.pages import page
from identify.pages.picture import Picture
from identify.pages.wording import COVERED, interval, number

ORDER = "recording, in order"
SPANS = (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0))
WORDS = {
    "clearance_m": ("clearance", "mm", 1e3),
    "stiffness_n_per_m": ("stiffness", "N/m", 1.0),
    "damping_n_s_per_m": ("damping", "N s/m", 1.0),
    "frequency_hz": ("frequency", "Hz", 1.0),
    "damping_ratio": ("damping", "%", 100.0),
}


def sentence(history: History) -> str:
    """Sentence on what changed, by how much and how probable that is by chance."""
    told = "; ".join(f"{name_of(q)} {_changed(q)}" for q in history.quantities if q.changed)
    count = f"{len(history.used)} recordings of {history.rig}"
    return f"{count}: {told}." if told else f"{count}: nothing changed by more than chance."


def name_of(quantity: QuantityHistory) -> str:
    return f"{quantity.of}: {WORDS[quantity.quantity][0]}"


def _changed(found: QuantityHistory) -> str:
    if found.p_trend is not None and found.p_trend < LEVEL:
        return f"drifts by {drift(found)} from the first to the last (p = {found.p_trend:.2g})"
    return f"differs between recordings (p = {found.p_different:.2g})"


def drift(found: QuantityHistory) -> str:
    """The change along the trend, in its unit and, where it is smaller, in per cent of the mean; ± 95 %."""
    if found.drift is None:
        return ""
    _, unit, scale = WORDS[found.quantity]
    change, error = found.drift.value, found.drift.standard_error
    share = f" ({100 * change / found.mean:+.2g} %)" if abs(change) < abs(found.mean) else ""
    return interval(scale * change, scale * error, unit) + share


def rows(history: History) -> Iterator[tuple[str, ...]]:
    """A row a quantity: mean, change along the trend, and the chances of both if nothing changed."""
    for found in history.quantities:
        _, unit, scale = WORDS[found.quantity]
        chances = ("" if p is None else f"{p:.2g}" if p > 0 else "< 1e-300" for p in (found.p_trend, found.p_different))
        yield name_of(found), f"{number(scale * found.mean)} {unit}", drift(found), *chances


def csv_of(history: History) -> bytes:
    """history.csv: a row a recording and quantity, half of the 95 % intervals of the value and of its differences."""
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["recording", "recorded", "of", "quantity", "unit", "value", "within_95", "own_within_95"])
    for found in history.quantities:
        columns = zip(history.used, found.values, found.standard_errors, found.own_errors, strict=True)
        for observation, value, *errors in columns:
            if value is not None:
                halves = ["" if not error else repr(COVERED * error) for error in errors]
                writer.writerow(
                    [observation.name, _when(observation), found.of, found.quantity, found.unit, repr(value), *halves]
                )
    return text.getvalue().encode()


def _when(observation: Observation) -> str:
    """Empty where it is not known."""
    return f"{observation.recorded:%Y-%m-%dT%H:%M:%SZ}" if observation.recorded else ""


def _along(history: History) -> tuple[Float[np.ndarray, " recordings"], str]:
    """Position of each recording on the axis, and its label: the time since the first if all tell theirs and it
    ascends, else the order."""
    dates = [observation.recorded for observation in history.used if observation.recorded]
    since_s = np.array([(date - dates[0]).total_seconds() for date in dates])
    if since_s.size < len(history.used) or not np.all(np.diff(since_s) > 0):
        return np.arange(1.0, len(history.used) + 1), ORDER
    unit, length_s = next(one for one in SPANS if since_s[-1] >= 2 * one[1] or one is SPANS[-1])
    return since_s / length_s, f"time since {dates[0]:%Y-%m-%d %H:%M} UTC, {unit}"


def drawn(history: History) -> Picture:
    """Clearance and stiffness of every contact over the recordings, in per cent off their means."""
    from identify.pages.style import BLUE, GREEN, GREY, RED, picture

    colours = (BLUE, RED, GREEN, GREY)
    names = list(dict.fromkeys(q.of for q in history.quantities if q.quantity in UNITS))
    along, label = _along(history)

    def draw(figure: Any) -> None:
        both = figure.subplots(2, 1, sharex=True)
        for axes, quantity in zip(both, ("clearance_m", "stiffness_n_per_m"), strict=True):
            own = [next(q for q in history.quantities if (q.of, q.quantity) == (name, quantity)) for name in names]
            for place, found in enumerate(own):
                values = np.array([np.nan if v is None else v for v in found.values])
                errors = np.array([np.nan if e is None else e for e in found.own_errors])
                at = along + 0.08 * np.diff(along).min() * (place - (len(own) - 1) / 2)
                off, reach = 100 * (values / found.mean - 1), 100 * COVERED * errors / found.mean
                colour = colours[place % len(colours)]
                axes.errorbar(at, off, reach, fmt="o-", ms=4, lw=0.8, color=colour, label=found.of, capsize=2)
            axes.set_ylabel(f"{WORDS[quantity][0]}, % off its mean")
        both[0].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        both[1].set_xlabel(label)
        if label == ORDER:
            both[1].xaxis.get_major_locator().set_params(integer=True)

    return picture(draw)


def write_page(history: History, figure: Picture, path: Path) -> None:
    """history.html."""
    changed = any(q.changed for q in history.quantities)
    findings = any(o.report.findings for o in history.used if o.report)
    page.write(
        path,
        title=f"{history.rig}: {len(history.used)} recordings compared",
        colour="red" if findings else "yellow" if changed else "green",
        verdict="not to be relied on" if findings else "changed" if changed else "no change",
        sentence=sentence(history),
        sections=_sections(history, figure),
        foot="Made by identify compare or identify history; the numbers are in history.csv and history.json.",
    )


def _sections(history: History, figure: Picture) -> list[tuple[str, str]]:
    """Headings and their HTML."""
    caption = (
        "Every recording's value against the mean of all. Bars: 95 % intervals of the differences between recordings, "
        "without what rig.json may have wrong, which is the same in all of them."
    )
    note = (
        f"<p>± 95 %. A trend is tested from {FEWEST} recordings on. p is the chance of such a trend, or of such "
        f"differences, in a machine that does not change, corrected for the number of tests: in one history of "
        f"{1 / LEVEL:.0f} any p falls below {LEVEL:g} by chance.</p>"
    )
    head = ("", "mean", "first to last, along the trend", "p of the trend", "p of the differences")
    found = [("Over the recordings", page.figure("history", figure, caption))]
    found.append(("What changed", note + page.table(head, rows(history))))
    found.append(
        ("The recordings", page.table(("", "recording", "SHA-256", "recorded, UTC", "told"), _recordings(history)))
    )
    return found


def _recordings(history: History) -> Iterator[Sequence[str]]:
    used = 0
    for observation in history.observations:
        place, told = "", f"left out: {observation.reason}"
        if observation.report is not None:
            used += 1
            findings = "; ".join(f.sentence for f in observation.report.findings)
            place, told = str(used), f"not to be relied on: {findings}" if findings else "used"
        recorded = f"{observation.recorded:%Y-%m-%d %H:%M}" if observation.recorded else ""
        yield place, observation.name, observation.sha256[: page.SHOWN_DIGITS], recorded, told
