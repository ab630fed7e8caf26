"""Files of a diagnosis: gap.html (needs no other file), with what differs marked on the drawing of the rig, gap.json,
the corrected rig.json, and its curves as tables."""

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np

from identify.gaps.decision.sentence import sentences
from identify.gaps.decision_table import Verdict
from identify.gaps.page.screen import COLOUR_BY_VERDICT
from identify.gaps.page.sections import (
    cause_tables_html,
    decision_html,
    failed_analyses_html,
    location_html,
    mismatch_size_html,
    next_steps_list,
    prediction_html,
    record_differences_html,
    unknown_force_html,
)
from identify.gaps.residual.unfolding import IN_Z
from identify.gaps.results import Gap
from identify.gaps.wording import (
    MIN_DESCRIPTION_SHARE,
    MIN_HINT_SHARE,
    capitalised,
    check_findings_introduction,
    parameter_words,
    verdict_words,
)
from identify.pages import page
from identify.pages.drawing import drawing_html
from identify.pages.machine import DrawnMark
from identify.pages.style import Picture
from identify.pages.tables import Table
from identify.pages.wording import change_words, estimate_words, number, percent
from rig.effects import effects
from rig.files import make_folder, write_bytes, write_json
from rig.model.description import Rig, Station, to_json
from rig.model.layout import station_named

CAPTION_BY_FIGURE = {
    "next_experiments": "Each further recording was simulated with either of the two, and the other one fitted to it. "
    "The bar is the gain of the logarithm of odds that is expected, the mean over which of them is true. "
    "Grey: the same setting again.",
    "large_bands": "The error in each band of frequency: the share of the rms of the acceleration there that a rig "
    "leaves unexplained. Tolerances and noise alone stay below the dotted line in 95 % of cases. Where a curve is "
    "missing, noise hides the error.",
    "decided_quantities": "What decides: the error of the motion and of the contact forces (the unexplained share of "
    "the rms), and how far the contact parameters are off. A line goes to the 97.5 % upper bound, or to the right edge "
    "where nothing bounds it. A quantity is settled as too small to matter if its line ends left of the dashed one, at "
    "its limit. Differences below a hundredth of the limit stand at a hundredth.",
    "prediction_motion": "Simulated from the measured state at the beginning of the window, under the measured force: "
    "the sensor that rig.json predicts worst, in the window of median error; of a long window its end.",
    "unknown_law": "Dots: the force that would explain the rest, at the marked place, over the motion there, without "
    "assuming a law (mean values); unless the law is linear, less a part that is linear in the motion, which "
    "tolerances may take up. Line: the law that the sentence names.",
}
"""Captions of the wide pictures; the others carry their titles."""
DECISIVE_FIGURES: dict[Verdict, tuple[str, ...]] = dict.fromkeys(Verdict, ("decided_quantities", "large_bands")) | {
    Verdict.EXPLAINED: ("large_bands",),
    Verdict.UNEXPLAINED: ("unknown_law", "large_bands"),
}
"""Figures beside the drawing of the rig, by verdict: the first that there is."""

UNLOCATED_VERDICTS = {Verdict.CONSISTENT, Verdict.CANNOT_TELL}
"""Verdicts that locate no difference."""

QUANTITY_ROW_PX = 34
"""Height of a quantity in the decisive figure, px. Display."""
MAX_FINDINGS = 2
"""Findings of the check that the page lists. Display."""


def write_all(
    gap: Gap, corrected_rig: Rig, title: str, folder: Path, sources: Sequence[Path] = (), findings: Sequence[str] = ()
) -> None:
    """Write gap.html, the corrected rig.json and gap.json, each atomically; `findings` are those of the check."""
    from identify.gaps.page.pictures import pictures

    make_folder(folder)
    drawing = captioned_drawing(gap, corrected_rig)
    write_page(gap, pictures(gap), title, folder / "gap.html", sources, findings, drawing)
    write_bytes(to_json(corrected_rig), folder / "rig.json")
    write_json(gap, folder / "gap.json")


def captioned_drawing(gap: Gap, corrected_rig: Rig) -> str:
    """Drawing of the rig with what differs marked, and its caption, as HTML."""
    drawn_marks = marks(gap, corrected_rig)
    caption = f"The rig, to scale along the bodies{'; what differs is marked at its place' * bool(drawn_marks)}."
    caption_html = page.unbroken_html(escape(caption + _undetermined_strength_sentence(gap)))
    return f"{drawing_html(corrected_rig, {}, drawn_marks)}<figcaption>{caption_html}</figcaption>"


def marks(gap: Gap, rig: Rig) -> tuple[DrawnMark, ...]:
    """Marks of what the verdict names and of what stays unexplained, where that is certain, and of dead channels.

    The ground, on which a sensor may stand, has no place in the drawing.
    """
    located_marks = () if gap.verdict in UNLOCATED_VERDICTS else (*_effect_marks(gap, rig), *_force_marks(gap, rig))
    return tuple(mark for mark in (*located_marks, *_channel_marks(gap, rig)) if not rig.is_on_ground(mark.station))


def _channel_marks(gap: Gap, rig: Rig) -> Iterator[DrawnMark]:
    """Marks of channels that were left out."""
    for channel_name, fault in gap.channel_faults.items():
        if station := station_named(rig, channel_name):
            yield DrawnMark(station, f"{channel_name} is {fault}")


def _effect_marks(gap: Gap, rig: Rig) -> Iterator[DrawnMark]:
    """Marks of the named effects of the likeliest cause, the first of several contacts with words.

    An effect of the whole rig has none. One with which the rig predicts no better is doubtful.
    """
    is_doubtful = gap.evidence.vetoed and gap.verdict == Verdict.UNEXPLAINED
    for cause in gap.causes[:1]:
        for effect, label, words, strength in zip(
            cause.effects, cause.labels, cause.words, cause.strengths, strict=True
        ):
            if not strength.is_named:
                continue
            position_share = cause.parameters.get(f"{label}.relative_position")
            names = [name.removesuffix(IN_Z) for key, name in cause.places.items() if key.partition(".")[0] == label]
            beam_names = [body.name for body in rig.bodies if body.name in names and body.length_m]
            stations = [station for name in beam_names for station in effects()[effect].stations_on(rig, name)]
            of_whole_body = not stations and position_share is None and bool(beam_names)
            if not stations:
                length_share = 0.5 if position_share is None else position_share.value
                stations = [*filter(None, (station_named(rig, name, length_share) for name in names))][:1]
            if not stations and cause.places.get(f"{label}.contact") == "all":
                stations = [contact.at for contact in rig.contacts]
            for index, station in enumerate(stations):
                mark_words = "likewise" if index else f"{'doubtful: ' * is_doubtful}{words}"
                yield DrawnMark(station, mark_words, of_whole_body=of_whole_body)


def _force_marks(gap: Gap, rig: Rig) -> Iterator[DrawnMark]:
    """Marks of the unmeasured force that describes the rest: at its place, its channel, its contact or its bodies.

    None where it explains as little as in null simulations; a hint where it explains less than half.
    """
    unknown = gap.unknown
    if unknown is None or unknown.explained < MIN_HINT_SHARE:
        return
    is_hint = unknown.explained < MIN_DESCRIPTION_SHARE
    hint = f"a hint (explains {percent(unknown.explained)} of the mean square): " * is_hint
    if (name := unknown.contact or unknown.sensor) and (station := station_named(rig, name)):
        fault = "clearance that swings" if unknown.contact else "fault of the sensor"
        yield DrawnMark(station, f"{hint}{name}: {fault}", is_hint)
    for body_name, growth in unknown.growth.items():
        change = change_words(growth.value, growth.standard_error)
        middle = Station(body_name, rig.body(body_name).length_m / 2)
        words = f"{hint}stiffness of the {body_name} changes by {change}"
        yield DrawnMark(middle, words, is_hint, of_whole_body=True)
    against = None
    if unknown.against_body is not None and unknown.against_position_m is not None:
        against = Station(unknown.against_body, unknown.against_position_m)
    if unknown.body is not None and unknown.position_m is not None:
        force_words = "unmeasured pair of forces" if against else "unmeasured force"
        position_words = estimate_words(
            unknown.position_m, unknown.position_error_m or 0.0, "m", f"{unknown.position_m:.2f} m"
        )
        place_words = "" if rig.body(unknown.body).is_mass else f", near {position_words}"
        size_words = f"{hint}{force_words}, {number(unknown.rms_n, 3)} N rms{place_words}"
        yield DrawnMark(Station(unknown.body, unknown.position_m), size_words, is_hint)
    if against:
        yield DrawnMark(against, "its opposite", is_hint)


def _decisive_height_px(figure_name: str, gap: Gap) -> int:
    """Height of the decisive figure; of the quantities, such that each has room for a name of two lines."""
    row_count = len(gap.evidence.quantities) if figure_name == "decided_quantities" else 0
    return max(page.FIRST_PLOT_PX, QUANTITY_ROW_PX * row_count)


def write_page(
    gap: Gap,
    figure_by_name: Mapping[str, Picture],
    title: str,
    path: Path,
    sources: Sequence[Path] = (),
    findings: Sequence[str] = (),
    drawing: str = "",
) -> None:
    """Write the page atomically, pictures included; `findings` of the check stand above the drawing of the rig, and
    below what to do next where a difference matters, which may be what causes them.

    The first word of a figure's name is its section, as named in `identify.gaps.page.pictures`.
    """
    pictures = dict(figure_by_name)
    findings_html = _findings_html(gap, findings) if findings else ""
    first_column = f"<figure>{drawing}</figure>" if drawing else ""
    first_column += f"<h2>What to do next</h2>{next_steps_list(gap)}"
    first_column = first_column + findings_html if gap.evidence.difference_matters else findings_html + first_column
    second_column = ""
    if decisive := next((name for name in _decisive_figures(gap) if name in pictures), None):
        caption = CAPTION_BY_FIGURE.get(decisive, "")
        second_column = page.figure(decisive, pictures.pop(decisive), caption, _decisive_height_px(decisive, gap))
    experiment_figures = _figures_html(pictures, "next")
    sections = [
        ("How large is the difference?", "large", mismatch_size_html(gap)),
        ("What causes it?", "why", cause_tables_html(gap)),
    ]
    if gap.rollout:
        sections.append(("Does the model move as the machine?", "prediction", prediction_html(gap.rollout)))
    sections.append(("How was it decided?", "decided", decision_html(gap)))
    if gap.between:
        sections.append(("What differs between the records?", "between", record_differences_html(gap.between)))
    if gap.unknown:
        is_rest = gap.verdict == Verdict.PARTLY_EXPLAINED
        heading = "What the rest looks like" if is_rest else "What is not explained"
        sections.append((heading, "unknown", unknown_force_html(gap.unknown)))
    sections.append(("Where does it lie?", "where", location_html(gap.attribution)))
    if gap.notes:
        sections.append(("What could not be computed", "notes", failed_analyses_html(gap)))
    page.write(
        path,
        title=title,
        answer=page.Answer(COLOUR_BY_VERDICT[gap.verdict], verdict_words(gap), sentences(gap)),
        top_blocks=[first_column, second_column],
        sections=[("Which further recording?", experiment_figures)] if experiment_figures else [],
        folded_sections=[
            (heading, f"{section_html}\n{_figures_html(pictures, section_key)}")
            for heading, section_key, section_html in sections
        ],
        foot_text="Every number of this page stands in gap.json, unrounded.",
        sources=sources,
    )


def _decisive_figures(gap: Gap) -> tuple[str, ...]:
    """Names of the figures that may stand beside the drawing; of quantities if another than the motion decides."""
    if gap.evidence.vetoed and gap.verdict in (Verdict.PARTLY_EXPLAINED, Verdict.UNEXPLAINED):
        return ("prediction_motion", *DECISIVE_FIGURES[gap.verdict])
    ratios = {
        quantity.name: quantity.value / quantity.threshold
        for quantity in gap.evidence.quantities
        if quantity.value is not None and not quantity.holds
    }
    if max(ratios, key=lambda name: ratios[name], default="motion") != "motion":
        return ("decided_quantities", *DECISIVE_FIGURES[gap.verdict])
    return DECISIVE_FIGURES[gap.verdict]


def _undetermined_strength_sentence(gap: Gap) -> str:
    """Sentence on what the records determine in place of a strength of the likeliest cause, if that is named."""
    if not (gap.causes and gap.causes[0].named):
        return ""
    parameters = gap.causes[0].parameters.items()
    words = [f"{parameter_words(name)}: {value.instead}" for name, value in parameters if value.instead]
    return f" {capitalised('; '.join(words))}." if words else ""


def _findings_html(gap: Gap, findings: Sequence[str]) -> str:
    """Findings of the check, the first `MAX_FINDINGS` of them, so that the drawing stays in sight."""
    more = [f"{len(findings) - MAX_FINDINGS} more: identify check lists them."] * (len(findings) > MAX_FINDINGS)
    return f"<p>{escape(check_findings_introduction(gap))}</p>{page.list_html([*findings[:MAX_FINDINGS], *more])}"


def _figures_html(figure_by_name: Mapping[str, Picture], section_key: str) -> str:
    """Figures of a section: the wide ones with their captions, then the small ones side by side."""
    wide_figures = small_figures = ""
    for name, picture in figure_by_name.items():
        if name.split("_")[0] == section_key and name in CAPTION_BY_FIGURE:
            wide_figures += page.figure(name, picture, CAPTION_BY_FIGURE[name])
        elif name.split("_")[0] == section_key:
            small_figures += page.figure(name, picture)
    return wide_figures + (f'<div class="pictures">\n{small_figures}</div>' if small_figures else "")


def curves(gap: Gap) -> dict[str, Table]:
    """Table `bands`: unexplained shares of the acceleration by frequency, as far as the diagnosis has them."""
    headings = {
        "low_hz": "from Hz",
        "high_hz": "to Hz",
        "before": "unexplained by the model as it is",
        "after": "unexplained with the likeliest cause",
        "usual": "95 % of null simulations stay below",
    }
    bands = {heading: np.array([getattr(band, field) for band in gap.bands]) for field, heading in headings.items()}
    return {"bands": bands} if gap.bands else {}
