"""Results of an identification on disk: contact.json, the identified rig.json, the figures, and contact.html."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path

import msgspec
import numpy as np

from identify.contacts.assumptions import assumptions, recommendations, variance_shares
from identify.contacts.identification import Identification
from identify.contacts.paper_methods import results_by_name
from identify.contacts.results import ContactEstimate, ContactReport, Estimate, identified_rig
from identify.pages import page
from identify.pages.machine import rig_drawing
from identify.pages.style import Picture
from identify.pages.wording import interval, number, percent
from rig.files import make_folder, write_bytes, write_json
from rig.model.contact_laws import ContactLaw
from rig.model.description import Rig, to_json

_CAPTIONS = {
    "separated": "The contact forces over the relative displacements η: dots, separated without assuming a law; line, "
    "the law, if one was found. Between the stops no force acts, and half their distance is the clearance; beyond them "
    "the slope is the stiffness. The forces are separated up to a highest frequency, which rounds the corners of the "
    "dots.",
    "histogram": "The relative displacements, and how often each occurs. The stops stand where it piles up.",
    "section": "What the main modal equation leaves for each contact, over its relative displacement. Dots that fan "
    "out at one place belong to the ends of the record, where derivatives ring.",
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
    "law": "what the law leaves",
}
"""Sources of variance in words."""
Laws = Mapping[str, ContactLaw]


def write_results(
    result: Identification, out: Path, title: str, laws: Laws, laws_name: str, sources: Sequence[Path] = ()
) -> None:
    """Write contact.html, the figures, the identified rig.json and, last of all, contact.json.

    `laws` are the reference values of every contact, and `laws_name` names them: the true ones where they are known,
    else those of rig.json.
    """
    from identify.contacts.figures import contact_figures

    make_folder(out)
    references = {name: (law.clearance_m, law.stiffness_n_per_m) for name, law in laws.items()}
    notes: list[str] = []
    figures = contact_figures(result, references, laws_name, notes)
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
    findings = page.list_html(finding.sentence for finding in report.findings)
    page.write(
        path,
        title=title,
        answer=answer(report, len(result.rig.contacts)),
        top_blocks=[
            f"{findings if report.findings else ''}{drawing(result.rig, report)}{values(report, laws, laws_name)}",
            "".join(
                _figures_html(
                    {name: contents for name, contents in figures.items() if name == DECISIVE_FIGURE},
                    page.FIRST_PLOT_PX,
                )
            ),
        ],
        sections=[
            *([("What was refused", refusals(report))] if report.unanswered else []),
            ("What would make it surer", page.list_html(recommendations(result))),
        ],
        folded_sections=[
            *(
                [("Does it fit?", "".join(other_figures))]
                if (
                    other_figures := _figures_html(
                        {name: contents for name, contents in figures.items() if name != DECISIVE_FIGURE}
                    )
                )
                else []
            ),
            *([("How sure is it?", _variance_table(result))] if report.contacts else []),
            ("What was assumed", page.list_html(assumptions(result))),
            ("For comparison: the paper's methods", _methods_html(result)),
        ],
        foot_text="Every identified value of this page stands in contact.json, unrounded, with its standard error.",
        sources=sources,
    )


def drawing(rig: Rig, report: ContactReport) -> str:
    """Drawing of the rig, with what was identified beside each contact."""
    contact_lines: dict[str, tuple[str, ...]] = {
        contact.name: (
            *([] if contact.is_spring else [_interval_text(contact.clearance_m, "mm", 1e3)]),
            _interval_text(contact.stiffness_n_per_m, "N/m"),
        )
        for contact in report.contacts
    }
    contact_lines |= {unanswered.name: ("not told by this record",) for unanswered in report.unanswered}
    found_words = "; clearance and stiffness found (± 95 %)" if report.contacts else ""
    caption = f"<figcaption>The rig, to scale along the bodies{found_words}.</figcaption>"
    return f"<figure>{rig_drawing(rig, contact_lines)}{caption}</figure>"


def _variance_table(result: Identification) -> str:
    """Table of the share of each estimate's variance by source."""
    rows = [
        (f"{quantity} of {name}", *(percent(shares.get(source, 0.0)) for source in VARIANCE_SOURCES))
        for name, estimate in result.outcomes.estimates.items()
        for quantity, shares in variance_shares(estimate).items()
    ]
    return "<p>Where the variance of each value comes from.</p>" + page.table(
        ("value", *VARIANCE_SOURCES.values()), rows
    )


def answer(report: ContactReport, total_count: int) -> page.Answer:
    """Answer that the page of a report on so many contacts begins with."""
    identified_count = len(report.contacts)
    return page.Answer(
        "red"
        if not identified_count
        else "green"
        if identified_count == total_count and not report.findings
        else "yellow",
        "not to be relied on"
        if report.findings
        else "identified"
        if identified_count == total_count
        else f"{identified_count} of {total_count} contacts identified",
        _sentences(report),
    )


def _sentences(report: ContactReport) -> list[str]:
    """Identified values in one sentence, or that there are none and why."""
    contacts = report.contacts
    if not contacts:
        reasons = [f"{unanswered.name}: {unanswered.reason}." for unanswered in report.unanswered]
        return ["This record determines no contact.", *reasons]
    values_by_contact = (
        f"{contact.name}: "
        + ("" if contact.is_spring else f"clearance {_interval_text(contact.clearance_m, 'mm', 1e3)}, ")
        + f"stiffness {_interval_text(contact.stiffness_n_per_m, 'N/m')}"
        + (f" ({contact.law})" if contact.law_sentence or contact.is_spring else "")
        for contact in contacts
    )
    return ["; ".join(values_by_contact)]


def _interval_text(estimate: Estimate, unit: str, unit_scale: float = 1.0) -> str:
    return interval(unit_scale * estimate.value, unit_scale * estimate.standard_error, unit)


def values(report: ContactReport, laws: Laws, laws_name: str) -> str:
    """Table of the identified values with 95 % intervals beside the reference values, and sentences on other laws."""
    contacts = report.contacts
    if not contacts:
        return ""
    rows = [row for contact in contacts for row in _rows(contact, laws[contact.name])]
    law_sentences = [f"{contact.law_sentence}." for contact in contacts if contact.law_sentence]
    half_play_words = "" if all(contact.ring for contact in contacts) else " The clearance is half the total play."
    if any(
        contact.lower_clearance_m and _is_surer(contact.clearance_m, contact.lower_clearance_m) for contact in contacts
    ):
        half_play_words = (
            " The clearance is half the total play, which this record tells better than the clearance of either side."
        )
    note = f"<p>Value ± 1.96 standard errors: 95 % interval.{half_play_words}</p>"
    return (
        page.table(("", "", "identified", laws_name, "differs by"), rows)
        + note
        + (page.list_html(law_sentences) if law_sentences else "")
    )


def _is_surer(estimate: Estimate, reference: Estimate) -> bool:
    """True if its standard error is less than half that of the reference."""
    return 2 * estimate.standard_error < reference.standard_error


def _rows(contact: ContactEstimate, law: ContactLaw) -> Iterator[tuple[str, ...]]:
    """Row of each quantity: identified value, reference value, difference."""
    first_quantity = "stiffness" if contact.is_spring else "clearance"
    for name, estimate, reference_value, unit, unit_scale in (
        ("clearance", contact.clearance_m, law.clearance_m, "mm", 1e3),
        ("lower clearance", contact.lower_clearance_m, law.lower_clearance_m, "mm", 1e3),
        ("upper clearance", contact.upper_clearance_m, law.upper_clearance_m, "mm", 1e3),
        ("stiffness", contact.stiffness_n_per_m, law.stiffness_n_per_m, "N/m", 1.0),
        ("damping", contact.damping_n_s_per_m, law.damping_n_s_per_m, "N s/m", 1.0),
        ("friction", contact.friction_coefficient, getattr(law, "friction_coefficient", 0.0), "1", 1.0),
        ("sliding speed", contact.sliding_speed_m_per_s, getattr(law, "sliding_speed_m_per_s", 0.0), "mm/s", 1e3),
    ):
        if estimate is not None and not (contact.is_spring and name == "clearance"):
            is_comparable = reference_value and np.isfinite(reference_value)
            difference = f"{100 * (estimate.value / reference_value - 1):+.3f} %" if is_comparable else ""
            yield (
                contact.name if name == first_quantity else "",
                name if unit == "1" else f"{name}, {unit}",
                _interval_text(estimate, "1", unit_scale),
                number(unit_scale * reference_value) if np.isfinite(reference_value) else "no stop",
                difference,
            )


def refusals(report: ContactReport) -> str:
    """Table of the contacts that the record does not determine, and why."""
    return page.table(
        ("contact", "not told by this record, because"),
        [(unanswered.name, unanswered.reason) for unanswered in report.unanswered],
    )


def _figures_html(figures: Mapping[str, Picture], height_px: int | None = None) -> list[str]:
    """HTML of the figures with their captions, and notes on those that failed."""
    notes: list[str] = []
    figure_by_name = {name: (name, figures[name]) for name in _CAPTIONS if name in figures}
    figure_html = results_by_name(
        notes, "the figure", figure_by_name, lambda pair: page.figure(*pair, _CAPTIONS[pair[0]], height_px)
    )
    return [*([page.list_html(notes)] if notes else []), *figure_html.values()]


def _methods_html(result: Identification) -> str:
    """Section on NIFO, surface and histogram, which begins with the notes on methods that failed."""
    report = result.report
    bands = [nifo.band_hz for nifo in report.nifo]  # each that of the forces on its body
    nifo_bands = f"NIFO ({min(bands)[0]:.3g} to {max(band[1] for band in bands):.3g} Hz) and " if bands else ""
    modes = [
        (f"{mode.beam} {mode.index}", f"{mode.frequency_hz:.3f} Hz", f"{100 * mode.damping_ratio:.2f} %", mode.flag)
        for mode in report.modes
    ]
    return (
        (page.list_html(report.notes) if report.notes else "")
        + "<p>The response of the modes beyond the fitted ones, by the law found, is subtracted; then "
        f"{nifo_bands}the restoring force surface are applied to every modal equation. Their values "
        "have no known error, and the answers above do not rest on them: each equation takes its mode of rig.json as "
        "right and does not see the others. The figures show "
        f"{escape(report.main_equation)}.</p><details><summary>All of them</summary>"
        + page.table(("equation", "contact", "stiffness by NIFO", "rms deviation", ""), _nifo_rows(report))
        + page.table(("contact", "clearance by", "value"), sorted(_clearance_rows(report)))
        + page.table(("mode", "frequency", "damping", ""), modes)
        + "</details>"
    )


def _nifo_rows(report: ContactReport) -> Iterator[tuple[str, ...]]:
    for nifo in report.nifo:
        for stiffness in nifo.stiffness:
            deviation_percent = f"{100 * stiffness.rms_deviation_n_per_m / abs(stiffness.mean_n_per_m.value):.2g} %"
            visibility_note = "nearly invisible" if stiffness.contact in nifo.nearly_invisible else ""
            yield (
                nifo.equation,
                stiffness.contact,
                f"{number(stiffness.mean_n_per_m.value)} N/m",
                deviation_percent,
                visibility_note,
            )
    for nifo in report.nifo:
        for name in nifo.nearly_invisible:
            if name not in {stiffness.contact for stiffness in nifo.stiffness}:
                yield nifo.equation, name, "not told", "", "on a node of this mode"


def _clearance_rows(report: ContactReport) -> Iterator[tuple[str, str, str]]:
    clearances = [
        (f"surface of {surface.equation}", clearance)
        for surface in report.surface.surfaces
        for clearance in surface.clearances
    ]
    clearances += [("histogram", clearance) for clearance in report.surface.histogram]
    for method, clearance in clearances:
        yield clearance.contact, method, f"{number(1e3 * clearance.clearance_m.value)} mm"
    for contact in report.contacts:
        if contact.name not in {clearance.contact for clearance in report.surface.histogram}:
            yield contact.name, "histogram", "not told"
