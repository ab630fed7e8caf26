"""Contact laws on disk: law.json, the figures, and law.html, a page."""

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path

from identify.laws.figures import drawn
from identify.laws.identification import PIECEWISE, Laws
from identify.laws.results import ContactLawEstimate, LawReport
from identify.pages import page
from identify.pages.picture import Picture
from identify.pages.wording import interval, number
from rig.files import make_folder, write_json

_CAPTIONS = {
    "law": "The contact force over the relative displacement η, separated without assuming a law, and the laws found. "
    "Below: what is left of the force.",
    "law_over_time": "A section of the record around the largest contact force: the separated force, that of the law "
    "along the measured motion, and the motion.",
}


def write_results(found: Laws, out: Path, title: str, sources: Sequence[Path] = ()) -> None:
    """Writes law.html, the figures as PNG and, last of all, law.json."""
    make_folder(out)
    figures = drawn(found.found)
    for name, picture in figures.items():
        picture.save(out / f"{name}.png")
    write_page(found.report, figures, title, out / "law.html", sources)
    write_json(found.report, out / "law.json")


def write_page(
    report: LawReport, figures: Mapping[str, Picture], title: str, path: Path, sources: Sequence[Path] = ()
) -> None:
    """Writes the page; figures by the names of `identify.laws.figures`."""
    told, silent = report.laws, report.unanswered
    page.write(
        path,
        title=title,
        colour="red" if report.findings or not told else "yellow" if silent else "green",
        verdict="not to be relied on"
        if report.findings
        else "contact law found"
        if not silent
        else f"the laws of {len(told)} of {len(told) + len(silent)} contacts found",
        sentence="; ".join(f"{law.contact}: {law.verdict}" for law in told)
        or "This record tells nothing of the contacts; below stands why, and what to do.",
        sections=[
            *(
                [("What speaks against it", page.listed(f.sentence for f in report.findings))]
                if report.findings
                else []
            ),
            *([("What was found", "".join(map(_found, told)))] if told else []),
            *(
                [("What was refused", page.table(("contact", "why"), [(s.name, s.reason) for s in silent]))]
                if silent
                else []
            ),
            *(
                [("Figures", "".join(page.figure(n, shown, _CAPTIONS[n]) for n, shown in figures.items()))]
                if figures
                else []
            ),
        ],
        foot="Every number of this page stands in law.json, unrounded.",
        sources=sources,
    )


def _found(law: ContactLawEstimate) -> str:
    """Table of what was tried, and values of the best law and of the straight pieces with 95 % intervals."""
    tried = [
        (
            one.law + (" (the best)" if one.law == law.best else ""),
            number(one.held_out_error_n, 3),
            f"{100 * one.held_out_error_n / law.force_rms_n:.2g} %",
        )
        for one in law.candidates
    ]
    middle = "" if law.sides_known else " Knees count from the middle of the play, as no sensor tells its place."
    repeat = "" if law.repeatable else " Time ended the search, so the same seed will not repeat it exactly."
    return (
        f"<h3>{escape(law.contact)}</h3>"
        + page.table(("law", "left of held-out data, N rms", "of the force"), tried)
        + page.table(("", "value ± 95 %"), _values(law))
        + f"<p>{escape(law.formula)}</p>"
        + f"<p>The laws were fitted to one half of the record and judged by the other. Damping in the closed contact "
        f"explains {100 * law.hysteresis_share:.2g} % of the variance that is left.{middle}{repeat} The intervals hold "
        "the scatter alone; contact.json, of identify contact, has those with the tolerances.</p>"
    )


def _values(law: ContactLawEstimate) -> Iterator[tuple[str, str]]:
    if law.sliding is not None:
        for name, estimate, unit, scale in (
            ("slides one way at", law.sliding.upper_n, "N", 1.0),
            ("slides the other way at", law.sliding.lower_n, "N", 1.0),
            ("backlash", law.sliding.backlash_m, "mm", 1e3),
            ("stiffness", law.sliding.stiffness_n_per_m, "N/m", 1.0),
        ):
            yield name, interval(scale * estimate.value, scale * estimate.standard_error, unit)
        return
    for count, knee in enumerate(law.fitted_knees_m, start=1):
        yield f"{PIECEWISE}, knee {count}", interval(1e3 * knee.value, 1e3 * knee.standard_error, "mm")
    for count, slope in enumerate(law.fitted_slopes_n_per_m, start=1):
        yield f"{PIECEWISE}, slope {count}", interval(slope.value, slope.standard_error, "N/m")
