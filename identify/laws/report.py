"""Contact laws as results: law.json, the page law.html, figures, and tables of the curves."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from identify.laws.identification import EDGE_SAMPLES, FoundLaw, Laws
from identify.laws.results import PIECEWISE, ContactLawEstimate, LawReport
from identify.pages import page
from identify.pages.style import BLUE, GREEN, GREY, RED, Picture, picture
from identify.pages.tables import Table
from identify.pages.wording import interval, number
from rig.files import make_folder, write_json

PLACES = 800
"""Count of relative displacements at which the laws are tabulated."""
SECTION_SAMPLES = 400
"""Count of force samples in the figure over time."""
_CAPTIONS = {
    "law": "The contact force over the relative displacement η, separated without assuming a law, and the laws found. "
    "Below: what is left of the force.",
    "law_over_time": "A section of the record around the largest contact force: the separated force, that of the law "
    "along the measured motion, and the motion.",
}


def write_results(laws: Laws, out: Path, title: str, sources: Sequence[Path] = ()) -> None:
    """Write law.html, the figures as PNG and, last of all, law.json."""
    make_folder(out)
    figures = law_figures(laws.found)
    for name, drawing in figures.items():
        drawing.save(out / f"{name}.png")
    write_page(laws.report, figures, title, out / "law.html", sources)
    write_json(laws.report, out / "law.json")


def write_page(
    report: LawReport, figures: Mapping[str, Picture], title: str, path: Path, sources: Sequence[Path] = ()
) -> None:
    """Write the page; the figures are those of `law_figures`, by their names."""
    laws, unanswered = report.laws, report.unanswered
    page.write(
        path,
        title=title,
        answer=page.Answer(
            "red" if not laws else "yellow" if report.findings or unanswered else "green",
            "not to be relied on"
            if report.findings
            else "contact law found"
            if not unanswered
            else f"the laws of {len(laws)} of {len(laws) + len(unanswered)} contacts found",
            [f"{law.contact}: {law.verdict}." for law in laws]
            or ["This record tells nothing of the contacts; below stands why, and what to do."],
        ),
        sections=[
            *(
                [("What speaks against it", page.listed(f.sentence for f in report.findings))]
                if report.findings
                else []
            ),
            *([("What was found", "".join(map(_law_section, laws)))] if laws else []),
            *(
                [("What was refused", page.table(("contact", "why"), [(s.name, s.reason) for s in unanswered]))]
                if unanswered
                else []
            ),
            *(
                [("Figures", "".join(page.figure(name, drawing, _CAPTIONS[name]) for name, drawing in figures.items()))]
                if figures
                else []
            ),
        ],
        foot="Every number of this page stands in law.json, unrounded.",
        sources=sources,
    )


def _law_section(law: ContactLawEstimate) -> str:
    """Section on one contact: the laws tried, and the values of friction or of the straight pieces."""
    rows = [
        (
            candidate.law + (" (the best)" if candidate.law == law.best else ""),
            number(candidate.held_out_error_n, 3),
            f"{100 * candidate.held_out_error_n / law.force_rms_n:.2g} %",
        )
        for candidate in law.candidates
    ]
    middle = "" if law.sides_known else " Knees count from the middle of the play, as no sensor tells its place."
    repeat = "" if law.repeatable else " Time ended the search, so the same seed will not repeat it exactly."
    return (
        f"<h3>{escape(law.contact)}</h3>"
        + page.table(("law", "left of held-out data, N rms", "of the force"), rows)
        + page.table(("", "value ± 95 %"), _values(law))
        + f"<p>{escape(law.formula)}</p>"
        + f"<p>The laws were fitted to one half of the record and judged by the other. Damping in the closed contact "
        f"explains {100 * law.hysteresis_share:.2g} % of the variance that is left.{middle}{repeat} The intervals hold "
        "the scatter alone; contact.json, of identify contact, has those with the tolerances.</p>"
    )


def _values(law: ContactLawEstimate) -> Iterator[tuple[str, str]]:
    """Names and values with 95 % intervals: of the friction where it is the best law, else of the straight pieces."""
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


def law_figures(laws: Sequence[FoundLaw]) -> dict[str, Picture]:
    """Figures of the laws by name; none without a law."""
    draws = {"law": _law, "law_over_time": _time} if laws else {}
    return {name: picture(partial(draw, laws=laws)) for name, draw in draws.items()}


def _law(figure: Any, laws: Sequence[FoundLaw]) -> None:
    """Draw each contact's force over eta: the points searched, formula and straight pieces, and their residual below.

    Where friction behind a backlash is the best law, draw that instead, along the course of eta.
    """
    upper, lower = figure.subplots(2, len(laws), squeeze=False, sharex="col", sharey="row", height_ratios=(3, 1))
    for axes, below, law in zip(upper, lower, laws, strict=True):
        if law.sliding is not None:
            _draw_sliding(axes, below, law)
            continue
        eta, knees = law.eta_m, law.pieces.knees_m
        span = np.linspace(eta.min(), eta.max(), 800)
        axes.plot(1e3 * eta, law.force_n, "o", ms=4, color=GREY, alpha=0.4, label="force, no law assumed")
        below.plot(1e3 * eta, law.force_n - law.pieces(eta), ".", ms=2, color=GREY, alpha=0.5)
        for panel, baseline in ((axes, 0.0), (below, law.pieces(span))):
            panel.plot(1e3 * span, law.formula(span) - baseline, color=BLUE, lw=1.4, label="formula found")
            panel.plot(1e3 * span, law.pieces(span) - baseline, color=RED, lw=1.4, ls="--", label="straight pieces")
        axes.plot(1e3 * knees, law.pieces(knees), "o", ms=8, mfc="none", mew=1.5, color=GREEN, label="knees")
        axes.set(title=law.result.contact)
        below.set(xlabel="η, mm")
    upper[0].set_ylabel("contact force, N")
    lower[0].set_ylabel("left over, N")
    _legend(figure, upper)


def _time(figure: Any, laws: Sequence[FoundLaw]) -> None:
    """Draw force, law and relative displacement over time around the largest force."""
    upper, lower = figure.subplots(2, len(laws), squeeze=False, sharex="col", sharey="row")
    for axes, below, law in zip(upper, lower, laws, strict=True):
        force = law.record.force_n
        middle = int(np.argmax(np.abs(force[EDGE_SAMPLES:-EDGE_SAMPLES]))) + EDGE_SAMPLES
        start = min(max(middle - SECTION_SAMPLES // 2, 0), max(force.size - SECTION_SAMPLES, 0))
        section = slice(start, start + SECTION_SAMPLES)
        axes.plot(law.time_s[section], force[section], color=GREY, lw=2.4, label="force, no law assumed")
        axes.plot(law.time_s[section], law.plotted_force_n[section], color=RED, lw=1.0, label=law.plotted_law)
        below.plot(law.time_s[section], 1e3 * law.record.eta_at_force_m[section], color=BLUE, lw=1.0)
        axes.set(title=law.result.contact)
        below.set(xlabel="time, s")
    upper[0].set_ylabel("contact force, N")
    lower[0].set_ylabel("η, mm")
    _legend(figure, upper)


def _legend(figure: Any, panels: Any) -> None:
    """Draw one legend for all panels, each label once."""
    named = {text: handle for axes in panels for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(named.values(), named.keys(), loc="outside upper center", ncols=4)


def _draw_sliding(axes: Any, below: Any, law: FoundLaw) -> None:
    eta, force, law_force = 1e3 * law.record.eta_at_force_m, law.record.force_n, law.plotted_force_n
    axes.plot(eta, force, color=GREY, lw=0.5, label="force, no law assumed")
    axes.plot(eta, law_force, color=RED, lw=0.9, label=law.plotted_law)
    below.plot(eta, force - law_force, color=GREY, lw=0.5)
    axes.set(title=law.result.contact)
    below.set(xlabel="η, mm")


def curves(laws: Sequence[FoundLaw]) -> dict[str, Table]:
    """Tables by name: `law_over_time` (relative displacement, separated force and low-passed force of the law) and, for
    the N-th contact, `law_N` (formula and straight pieces over relative displacement); none without a law."""
    tables = {f"law_{number}": _over_displacement(law) for number, law in enumerate(laws, start=1)}
    return tables | ({"law_over_time": _over_time(laws)} if laws else {})


def _over_time(laws: Sequence[FoundLaw]) -> Table:
    rows = min(law.record.force_n.size for law in laws)
    table: Table = {"time_s": laws[0].time_s[:rows]}
    for law in laws:
        name = law.result.contact
        table[f"{name} relative displacement m"] = law.record.eta_at_force_m[:rows]
        table[f"{name} contact force N"] = law.record.force_n[:rows]
        table[f"{name} {law.plotted_law} N"] = law.plotted_force_n[:rows]
    return table


def _over_displacement(law: FoundLaw) -> Table:
    name, eta = law.result.contact, np.linspace(law.eta_m.min(), law.eta_m.max(), PLACES)
    return {
        f"{name} relative displacement m": eta,
        f"{name} formula N": law.formula(eta),
        f"{name} straight pieces N": law.pieces(eta),
    }
