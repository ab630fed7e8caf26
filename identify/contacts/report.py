"""An identification on disk: contact.json, the identified rig.json, the figures, and contact.html, a page."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path

import msgspec

from identify.contacts.advice import assumed, recommendations
from identify.contacts.identification import Identification
from identify.contacts.identified_rig import identified_rig
from identify.contacts.paper_methods import attempted
from identify.contacts.results import ContactEstimate, ContactReport, Estimate
from identify.pages import page
from identify.pages.picture import Picture
from identify.pages.wording import interval, number
from rig.files import make_folder, write_bytes, write_json
from rig.model.contact_laws import ContactLaw
from rig.model.description import to_json

_CAPTIONS = {
    "separated": "The contact forces over the relative displacements, separated without assuming a law, and the law "
    "found.",
    "histogram": "The relative displacements, and how often each occurs. The stops stand where it piles up.",
    "section": "What the main modal equation leaves for each contact, over its relative displacement.",
    "surface": "The restoring force surface of the main modal equation.",
    "stiffness": "The contact stiffness by NIFO over frequency, and its deviation from what is drawn dotted. The "
    "paper's form takes the spectra of blocks as they are: a mode that rings for longer than a block leaks. The weak "
    "form takes the derivatives of the window along as inputs, so that nothing leaks.",
    "frf": "The linear FRF that NIFO finds beside the contacts, and that of rig.json.",
    "outputs": "The main modal coordinate as measured, and as it would be without contacts.",
}
Laws = Mapping[str, ContactLaw]


def write_results(
    found: Identification, out: Path, title: str, laws: Laws, laws_name: str, sources: Sequence[Path] = ()
) -> None:
    """Writes contact.html, the figures, the identified rig.json and, last of all, contact.json.

    `laws` has for every contact what stands beside the identified values, and `laws_name` says what they are: the true
    ones where they are known, else those of rig.json.
    """
    from identify.contacts.figures import drawn

    make_folder(out)
    marks = {name: (law.clearance_m, law.stiffness_n_per_m) for name, law in laws.items()}
    notes: list[str] = []
    figures = drawn(found, marks, laws_name, notes)
    found = replace(found, report=msgspec.structs.replace(found.report, notes=(*found.report.notes, *notes)))
    for name, picture in figures.items():
        picture.save(out / f"{name}.png")
    write_page(found, figures, title, laws, laws_name, out / "contact.html", sources)
    write_bytes(to_json(identified_rig(found.rig, found.report)), out / "rig.json")
    write_json(found.report, out / "contact.json")


def write_page(
    found: Identification,
    figures: Mapping[str, Picture],
    title: str,
    laws: Laws,
    laws_name: str,
    path: Path,
    sources: Sequence[Path] = (),
) -> None:
    """Writes the page; figures by the names of `identify.contacts.figures`."""
    report = found.report
    told, count = len(report.contacts), len(found.rig.contacts)
    page.write(
        path,
        title=title,
        colour="red" if report.findings or not told else "green" if told == count else "yellow",
        verdict="not to be relied on"
        if report.findings
        else "identified"
        if told == count
        else f"{told} of {count} contacts identified",
        sentence=_sentence(found),
        sections=[
            *(
                [("What speaks against it", page.listed(f.sentence for f in report.findings))]
                if report.findings
                else []
            ),
            ("What was found", _values(found, laws, laws_name)),
            *([("What was refused", _refused(found))] if report.unanswered else []),
            ("What would make it surer", page.listed(recommendations(found))),
            ("What was assumed", page.listed(assumed(found))),
            ("Figures", _figures(figures)),
            ("Beside it: the paper's methods", _methods(found)),
        ],
        foot="Every identified value of this page stands in contact.json, unrounded, with its standard error.",
        sources=sources,
    )


def _sentence(found: Identification) -> str:
    contacts = found.report.contacts
    if not contacts:
        return "This record tells nothing of the contacts; below stands why, and what to do."
    return "; ".join(
        f"{c.name}: clearance {_said(c.clearance_m, 'mm', 1e3)}, stiffness {_said(c.stiffness_n_per_m, 'N/m')}"
        + (f" ({c.law})" if c.law_sentence else "")
        for c in contacts
    )


def _said(estimate: Estimate, unit: str, scale: float = 1.0) -> str:
    return interval(scale * estimate.value, scale * estimate.standard_error, unit)


def _values(found: Identification, laws: Laws, laws_name: str) -> str:
    tables = [
        f"<h3>{escape(c.name)}</h3>" + page.table(("", "identified", laws_name, "differs by"), _rows(c, laws[c.name]))
        for c in found.report.contacts
    ]
    if not tables:
        return "<p>Nothing.</p>"
    note = "<p>Value ± 1.96 standard errors: 95 % interval. The clearance is half the total play.</p>"
    asked = [f"{c.law_sentence}." for c in found.report.contacts if c.law_sentence]
    return note + "".join(tables) + (page.listed(asked) if asked else "")


def _rows(found: ContactEstimate, law: ContactLaw) -> Iterator[tuple[str, ...]]:
    """A row a quantity: what was identified, what stands beside it, and by how much the two differ."""
    for name, estimate, beside, unit, scale in (
        ("clearance", found.clearance_m, law.clearance_m, "mm", 1e3),
        ("lower clearance", found.lower_clearance_m, law.lower_clearance_m, "mm", 1e3),
        ("upper clearance", found.upper_clearance_m, law.upper_clearance_m, "mm", 1e3),
        ("stiffness", found.stiffness_n_per_m, law.stiffness_n_per_m, "N/m", 1.0),
        ("damping", found.damping_n_s_per_m, law.damping_n_s_per_m, "N s/m", 1.0),
    ):
        if estimate is not None:
            off = f"{100 * (estimate.value / beside - 1):+.3f} %" if beside else ""
            yield f"{name}, {unit}", _said(estimate, "1", scale), number(scale * beside), off


def _refused(found: Identification) -> str:
    return page.table(
        ("contact", "not told by this record, because"), [(u.name, u.reason) for u in found.report.unanswered]
    )


def _figures(figures: Mapping[str, Picture]) -> str:
    notes: list[str] = []
    named = {name: (name, figures[name]) for name in _CAPTIONS if name in figures}
    shown = attempted(notes, "the figure", named, lambda one: page.figure(*one, _CAPTIONS[one[0]]))
    return (page.listed(notes) if notes else "") + "".join(shown.values())


def _methods(found: Identification) -> str:
    """NIFO, surface and histogram, which the answers above do not rest on; first what of them could not be made."""
    report = found.report
    bands = [n.band_hz for n in report.nifo]  # each that of the forces on its body
    by_nifo = f"NIFO ({min(bands)[0]:.3g} to {max(b[1] for b in bands):.3g} Hz) and " if bands else ""
    modes = [
        (f"{m.beam} {m.index}", f"{m.frequency_hz:.3f} Hz", f"{100 * m.damping_ratio:.2f} %", m.flag)
        for m in report.modes
    ]
    return (
        (page.listed(report.notes) if report.notes else "")
        + "<p>With the law found, the response of the modes beyond the fitted ones is taken off; then "
        f"{by_nifo}the restoring force surface are applied to every modal equation. Their values "
        "have no known error, and the answers above do not rest on them: each equation believes in its mode of "
        "rig.json and is blind to the others. The figures show "
        f"{escape(report.main_equation)}.</p><details><summary>All of them</summary>"
        + page.table(("equation", "contact", "stiffness by NIFO", "rms deviation", ""), _nifo_rows(report))
        + page.table(("contact", "clearance by", "value"), sorted(_clearance_rows(report)))
        + page.table(("mode", "frequency", "damping", ""), modes)
        + "</details>"
    )


def _nifo_rows(report: ContactReport) -> Iterator[tuple[str, ...]]:
    for each in report.nifo:
        for s in each.stiffness:
            deviation = f"{100 * s.rms_deviation_n_per_m / abs(s.mean_n_per_m.value):.2g} %"
            hidden = "nearly invisible" if s.contact in each.nearly_invisible else ""
            yield each.equation, s.contact, f"{number(s.mean_n_per_m.value)} N/m", deviation, hidden
    for each in report.nifo:
        for name in each.nearly_invisible:
            if name not in {s.contact for s in each.stiffness}:
                yield each.equation, name, "not told", "", "on a node of this mode"


def _clearance_rows(report: ContactReport) -> Iterator[tuple[str, str, str]]:
    ways = [(f"surface of {s.equation}", c) for s in report.surface.surfaces for c in s.clearances]
    ways += [("histogram", c) for c in report.surface.histogram]
    for way, c in ways:
        yield c.contact, way, f"{number(1e3 * c.clearance_m.value)} mm"
    for contact in report.contacts:
        if contact.name not in {c.contact for c in report.surface.histogram}:
            yield contact.name, "histogram", "not told"
