"""Results of an identification on disk: contact.json, the identified rig.json, the figures, and contact.html."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path

import msgspec
import numpy as np

from identify.contacts.assumptions import assumptions, recommendations, variance_shares
from identify.contacts.identification import Identification
from identify.contacts.paper_methods import results_or_notes_by_name
from identify.contacts.results import ContactEstimate, ContactReport, Estimate, identified_rig
from identify.pages import page
from identify.pages.drawing import drawing_html as rig_drawing_html
from identify.pages.drawing_texts import NO_BREAK
from identify.pages.style import Picture
from identify.pages.wording import COVERED, interval, joined, number, percent
from rig.files import make_folder, write_bytes, write_json
from rig.model.contact_laws import ContactLaw
from rig.model.description import Rig, to_json

_CAPTIONS = {
    "separated": "The contact forces over the relative displacements η: dots, measured, without assuming a law; line, "
    "the law, if one was found. Within the clearance no force acts; beyond it the slope is the stiffness. The measured "
    "forces are limited in frequency, so that their corners look rounded.",
    "histogram": "Left: the relative displacement over time. Right: how often each value occurs; a peak, if there is "
    "one, marks a stop.",
    "section": "What the main modal equation leaves for each contact, over its relative displacement. Ignore scatter "
    "from the first and last seconds of the record: there the filters ring.",
    "surface": "The restoring force that the main modal equation leaves, over its coordinates: flat between the stops, "
    "steep beyond them.",
    "stiffness": "The contact stiffness by NIFO over frequency, and its deviation from what is drawn dotted. The "
    "paper's form takes the spectra of blocks as they are: a mode that rings for longer than a block leaks. The weak "
    "form takes the derivatives of the window along as inputs, so that nothing leaks.",
    "frf": "The linear FRF that NIFO finds beside the contacts, and that of rig.json.",
    "outputs": "The main modal coordinate as measured, and as it would be without contacts.",
}
DECISIVE_FIGURE = "separated"
"""Figure beside the drawing of the rig: contact force over relative displacement, and the law found."""
VARIANCE_SOURCES = {
    "scatter": "scatter of the record",
    "tolerances": "tolerances of rig.json",
    "drift": "slow motion",
    "law": "misfit of the contact law",
}
"""Sources of variance in words."""
FOOT_TEXT = "Every identified value of this page stands in contact.json, unrounded, with its standard error."
Laws = Mapping[str, ContactLaw]


def write_results(
    result: Identification, out: Path, title: str, laws: Laws, laws_name: str, sources: Sequence[Path] = ()
) -> None:
    """Write contact.html, the figures, the identified rig.json and, last of all, contact.json.

    `laws` are the reference values of every contact, and `laws_name` names them: the true ones where they are known,
    else those of rig.json; a contact whose values nobody knows has none.
    """
    from identify.contacts.figures import contact_figures

    make_folder(out)
    reference_values = {name: (law.clearance_m, law.stiffness_n_per_m) for name, law in laws.items()}
    notes: list[str] = []
    figures = contact_figures(result, reference_values, laws_name, notes)
    result = replace(result, report=msgspec.structs.replace(result.report, notes=(*result.report.notes, *notes)))
    for name, picture in figures.items():
        picture.save(out / f"{name}.png")
    write_page(result, figures, title, laws, laws_name, out / "contact.html", sources)
    write_bytes(to_json(identified_rig(result.rig, result.report)), out / "rig.json")
    write_json(result.report, out / "contact.json")


def write_page(
    result: Identification,
    figures: Mapping[str, Picture],
    title: str,
    laws: Laws,
    laws_name: str,
    path: Path,
    sources: Sequence[Path] = (),
) -> None:
    """Write contact.html, with figures by the names of `identify.contacts.figures`."""
    report = result.report
    findings_html = page.list_html(finding.sentence for finding in report.findings) if report.findings else ""
    decisive_figures = {name: picture for name, picture in figures.items() if name == DECISIVE_FIGURE}
    decisive_html = _figures_html(decisive_figures, page.FIRST_PLOT_PX)
    further_html = _figures_html({name: picture for name, picture in figures.items() if name not in decisive_figures})
    folded_sections = [("Does it fit?", "".join(further_html))] if further_html else []
    if report.contacts:
        folded_sections.append(("How sure is it?", variance_html(_shares_by_quantity(result))))
    page.write(
        path,
        title=title,
        answer=answer(report, len(result.rig.contacts), laws, laws_name),
        top_blocks=[
            f"{findings_html}{drawing_html(result.rig, report)}{values_html(report, laws, laws_name)}",
            "".join(decisive_html),
        ],
        sections=[
            *([("What was refused", refusals_html(report))] if report.unanswered else []),
            ("What to do next", page.list_html(recommendations(result))),
        ],
        folded_sections=[
            *folded_sections,
            ("What was assumed", page.list_html(assumptions(result))),
            ("For comparison: the paper's methods", _methods_html(result)),
        ],
        foot_text=FOOT_TEXT,
        sources=sources,
    )


def drawing_html(rig: Rig, report: ContactReport) -> str:
    """Drawing of the rig, with what was identified beside each contact."""
    lines_by_contact: dict[str, tuple[str, ...]] = {}
    for contact in report.contacts:
        stiffness = _interval_text(contact.stiffness_n_per_m, "N/m")
        clearance = () if contact.is_spring else (_interval_text(contact.clearance_m, "mm", 1e3),)
        lines_by_contact[contact.name] = (*clearance, stiffness)
    lines_by_contact |= {unanswered.name: ("not determined by this record",) for unanswered in report.unanswered}
    interval_words = "; clearance and stiffness with 95 % intervals" if report.contacts else ""
    caption = f"<figcaption>The rig, to scale along the bodies{interval_words}.</figcaption>"
    return f"<figure>{rig_drawing_html(rig, lines_by_contact)}{caption}</figure>"


def _shares_by_quantity(result: Identification) -> dict[str, Mapping[str, float]]:
    """Shares of the variance of each estimated quantity by source."""
    return {
        f"{quantity} of {name}": shares
        for name, estimate in result.outcomes.estimates.items()
        for quantity, shares in variance_shares(estimate).items()
    }


def variance_html(shares_by_quantity: Mapping[str, Mapping[str, float]]) -> str:
    """Table of the share of each estimate's variance by source."""
    table_rows = [
        (quantity, *(percent(shares.get(source, 0.0)) for source in VARIANCE_SOURCES))
        for quantity, shares in shares_by_quantity.items()
    ]
    table = page.table(("value", *VARIANCE_SOURCES.values()), table_rows)
    return f"<p>What limits the accuracy: the shares of each value's variance.</p>{table}"


def answer(report: ContactReport, contact_count: int, laws: Laws, laws_name: str) -> page.Answer:
    """Answer that the page of a report on so many contacts begins with, and whether reference values agree with it."""
    count = len(report.contacts)
    words = "identified" if count == contact_count else f"{count} of {contact_count} contacts identified"
    return page.Answer(
        "red" if not count else "green" if count == contact_count and not report.findings else "yellow",
        "not to be relied on" if report.findings else words,
        [*_identified_value_sentences(report), *_agreement_sentences(report, laws, laws_name)],
    )


def _identified_value_sentences(report: ContactReport) -> list[str]:
    """Identified values in one sentence, or that there are none and why."""
    contacts = report.contacts
    if not contacts:
        reasons = [f"{unanswered.name}: {unanswered.reason}." for unanswered in report.unanswered]
        return ["This record determines no contact.", *reasons]
    clauses = []
    for contact in contacts:
        clearance = "" if contact.is_spring else f"clearance {_interval_text(contact.clearance_m, 'mm', 1e3)}, "
        law = f" ({contact.law})" if contact.law_sentence or contact.is_spring else ""
        stiffness = _interval_text(contact.stiffness_n_per_m, "N/m")
        clauses.append(f"{contact.name}: {clearance}stiffness {stiffness}{law}")
    return ["; ".join(clauses)]


def _agreement_sentences(report: ContactReport, laws: Laws, laws_name: str) -> list[str]:
    """Sentence on the reference values that lie outside the intervals, or that none does."""
    compared_count, differing = 0, list[str]()
    for contact in report.contacts:
        values = [v for v in _compared_values(contact, laws.get(contact.name)) if np.isfinite(v.reference)]
        compared_count += len(values)
        if names := [value.name for value in values if not _is_within_interval(value.estimate, value.reference)]:
            differing.append(f"{joined(names)} of {contact.name}")
    if differing:
        return [f"These {laws_name} values lie outside the 95 % intervals: {'; '.join(differing)}."]
    return [f"Every {laws_name} value lies inside its 95 % interval."] if compared_count else []


def _interval_text(estimate: Estimate, unit: str, scale: float = 1.0) -> str:
    return interval(scale * estimate.value, scale * estimate.standard_error, unit)


def values_html(report: ContactReport, laws: Laws, laws_name: str) -> str:
    """Table of the identified values with 95 % intervals beside the reference values, and sentences on other laws."""
    contacts = report.contacts
    if not contacts:
        return ""
    table_rows = [row for contact in contacts for row in _value_rows(contact, laws.get(contact.name))]
    law_sentences = [f"{contact.law_sentence}." for contact in contacts if contact.law_sentence]
    has_total_play = any(
        v.name == "clearance" for c in contacts if not c.ring for v in _compared_values(c, laws.get(c.name))
    )
    clearance_words = " The clearance is half the total play." if has_total_play else ""
    if any(c.lower_clearance_m and _is_twice_as_certain(c.clearance_m, c.lower_clearance_m) for c in contacts):
        clearance_words = (
            " The clearance is half the total play, which this record tells better than the clearance of either side."
        )
    table = page.table(("", "", "identified", laws_name, "differs by"), table_rows)
    note = "Identified: value ± 1.96 standard errors, the 95 % interval. A value beside it that lies within agrees."
    note = f"<p>{note}{clearance_words}</p>"
    return table + note + (page.list_html(law_sentences) if law_sentences else "")


def _is_twice_as_certain(estimate: Estimate, reference: Estimate) -> bool:
    """True if its standard error is less than half that of the reference."""
    return 2 * estimate.standard_error < reference.standard_error


@dataclass(frozen=True)
class _ComparedValue:
    """Identified quantity beside its reference value, both times `scale` in the printed unit."""

    name: str
    estimate: Estimate
    reference: float
    unit: str
    scale: float


def _compared_values(contact: ContactEstimate, law: ContactLaw | None) -> list[_ComparedValue]:
    """Every identified quantity; where a single stop is touched, its clearance by its side. NaN is an unknown value."""
    sides = (contact.lower_clearance_m, contact.upper_clearance_m)
    has_own_clearance = not contact.is_spring and (None in sides) == (sides == (None, None))
    quantities = (
        ("clearance", contact.clearance_m if has_own_clearance else None, _reference(law, "clearance_m"), "mm", 1e3),
        ("lower clearance", contact.lower_clearance_m, _reference(law, "lower_clearance_m"), "mm", 1e3),
        ("upper clearance", contact.upper_clearance_m, _reference(law, "upper_clearance_m"), "mm", 1e3),
        ("stiffness", contact.stiffness_n_per_m, _reference(law, "stiffness_n_per_m"), "N/m", 1.0),
        ("damping", contact.damping_n_s_per_m, _reference(law, "damping_n_s_per_m"), "N s/m", 1.0),
        ("friction", contact.friction_coefficient, _reference(law, "friction_coefficient"), "1", 1.0),
        ("sliding speed", contact.sliding_speed_m_per_s, _reference(law, "sliding_speed_m_per_s"), "mm/s", 1e3),
    )
    return [
        _ComparedValue(name, estimate, reference, unit, scale)
        for name, estimate, reference, unit, scale in quantities
        if estimate is not None
    ]


def _reference(law: ContactLaw | None, field: str) -> float:
    """Reference value of a law; zero of a field that it does not have, NaN without a law."""
    return np.nan if law is None else getattr(law, field, 0.0)


def _value_rows(contact: ContactEstimate, law: ContactLaw | None) -> Iterator[tuple[str, ...]]:
    """Row of each quantity: identified value, reference value, difference."""
    for row, value in enumerate(_compared_values(contact, law)):
        has_reference = np.isfinite(value.reference)
        yield (
            "" if row else contact.name,
            value.name if value.unit == "1" else f"{value.name}, {value.unit.replace(' ', NO_BREAK)}",
            _interval_text(value.estimate, "1", value.scale),
            number(value.scale * value.reference) if has_reference else "unknown" if law is None else "no stop",
            _difference_text(value.estimate, value.reference) if has_reference else "",
        )


def _is_within_interval(estimate: Estimate, reference: float) -> bool:
    """True if the 95 % interval holds the reference value."""
    return abs(estimate.value - reference) <= COVERED * estimate.standard_error


def _difference_text(estimate: Estimate, reference: float) -> str:
    """Difference from the reference value in per cent, if that is not zero, and whether the 95 % interval holds it."""
    difference_text = f"{round(100 * (estimate.value / reference - 1), 3):+.3g} %, " if reference else ""
    return f"{difference_text}{'agrees' if _is_within_interval(estimate, reference) else 'differs'}"


def refusals_html(report: ContactReport) -> str:
    """Table of the contacts that the record does not determine, and why."""
    rows = [(unanswered.name, unanswered.reason) for unanswered in report.unanswered]
    return page.table(("contact", "not determined by this record, because"), rows)


def _figures_html(figures: Mapping[str, Picture], height_px: int | None = None) -> list[str]:
    """HTML of the figures with their captions, and notes on those that failed."""
    notes: list[str] = []
    pairs = {name: (name, figures[name]) for name in _CAPTIONS if name in figures}
    html = results_or_notes_by_name(
        notes, "the figure", pairs, lambda pair: page.figure(*pair, _CAPTIONS[pair[0]], height_px)
    )
    return [*([page.list_html(notes)] if notes else []), *html.values()]


def _methods_html(result: Identification) -> str:
    """Section on NIFO, surface and histogram, which begins with the notes on methods that failed."""
    report = result.report
    bands_hz = [nifo.band_hz for nifo in report.nifo]  # each that of the forces on its body
    nifo_text = f"NIFO ({min(bands_hz)[0]:.3g} to {max(band[1] for band in bands_hz):.3g} Hz) and " if bands_hz else ""
    mode_rows = [
        (f"{mode.beam} {mode.index}", f"{mode.frequency_hz:.3f} Hz", f"{100 * mode.damping_ratio:.2f} %", mode.flag)
        for mode in report.modes
    ]
    return (
        (page.list_html(report.notes) if report.notes else "")
        + "<p>The response of the modes beyond the fitted ones, by the law found, is subtracted; then "
        f"{nifo_text}the restoring force surface are applied to every modal equation. Their values "
        "have no known error, and the answers above do not rest on them: each equation takes its mode of rig.json as "
        "right and does not see the others. The figures show "
        f"{escape(report.main_equation)}.</p><details><summary>All of them</summary>"
        + nifo_table_html(report)
        + page.table(("contact", "clearance by", "value"), sorted(_paper_clearance_rows(report)))
        + page.table(("mode", "frequency", "damping", ""), mode_rows)
        + "</details>"
    )


def nifo_table_html(report: ContactReport) -> str:
    """Table of the stiffnesses by NIFO of every modal equation."""
    return page.table(("equation", "contact", "stiffness by NIFO", "rms deviation", ""), _nifo_rows(report))


def _nifo_rows(report: ContactReport) -> Iterator[tuple[str, ...]]:
    for nifo in report.nifo:
        for stiffness in nifo.stiffness:
            mean_n_per_m = stiffness.mean_n_per_m.value
            deviation_text = f"{100 * stiffness.rms_deviation_n_per_m / abs(mean_n_per_m):.2g} %"
            note = "nearly invisible" if stiffness.contact in nifo.nearly_invisible else ""
            yield nifo.equation, stiffness.contact, f"{number(mean_n_per_m)} N/m", deviation_text, note
    for nifo in report.nifo:
        for name in nifo.nearly_invisible:
            if name not in {stiffness.contact for stiffness in nifo.stiffness}:
                yield nifo.equation, name, "not determined", "", "on a node of this mode"


def _paper_clearance_rows(report: ContactReport) -> Iterator[tuple[str, str, str]]:
    surface = report.surface
    by_method = [(f"surface of {s.equation}", clearance) for s in surface.surfaces for clearance in s.clearances]
    by_method += [("histogram", clearance) for clearance in surface.histogram]
    for method, clearance in by_method:
        yield clearance.contact, method, f"{number(1e3 * clearance.clearance_m.value)} mm"
    for contact in report.contacts:
        if contact.name not in {clearance.contact for clearance in surface.histogram}:
            yield contact.name, "histogram", "not determined"
