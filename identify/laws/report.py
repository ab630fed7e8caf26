"""Contact laws as results: law.json, the page law.html, figures, and tables of the curves."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, Literal

import numpy as np

from identify.laws.identification import EDGE_SAMPLE_COUNT, ContactLawFit, Laws
from identify.laws.results import FORMULA, MAX_LEFT_SHARE, PIECEWISE, ContactLawEstimate, LawReport, estimate_interval
from identify.pages import page
from identify.pages.style import BLUE, GREEN, GREY, RED, Picture, picture
from identify.pages.tables import Table
from identify.pages.wording import joined, number, percent
from rig.files import make_folder, write_json

TABULATED_POINT_COUNT = 800
"""Count of relative displacements at which the laws are tabulated."""
SECTION_SAMPLE_COUNT = 400
"""Count of force samples in the figure over time."""
_CAPTION_BY_FIGURE = {
    "law": "The contact force over the relative displacement η, separated without assuming a law, and the laws found. "
    "Below: what is left of the force.",
    "law_over_time": "A section of the record around the largest contact force: the separated force, that of the law "
    "along the measured motion, and the motion.",
}


def write_results(laws: Laws, out: Path, title: str, sources: Sequence[Path] = ()) -> None:
    """Write law.html, the figures as PNG and, last of all, law.json."""
    make_folder(out)
    figures = law_figures(laws.fits)
    for figure_name, figure in figures.items():
        figure.save(out / f"{figure_name}.png")
    write_page(laws.report, figures, title, out / "law.html", sources)
    write_json(laws.report, out / "law.json")


def write_page(
    report: LawReport, figures: Mapping[str, Picture], title: str, path: Path, sources: Sequence[Path] = ()
) -> None:
    """Write the page; the figures are those of `law_figures`, by their names."""
    law_estimates, unanswered = report.laws, report.unanswered
    headline, all_fit = "contact law found", all(law.fits for law in law_estimates)
    if report.findings:
        headline = "not to be relied on"
    elif not all_fit:
        headline = joined([law.contact for law in law_estimates if not law.fits]) + ": none of the laws fits"
    elif unanswered:
        headline = f"the laws of {len(law_estimates)} of {len(law_estimates) + len(unanswered)} contacts found"
    sentences = [f"{law.contact}: {law.verdict}." for law in law_estimates]
    sentences = sentences or ["This record does not determine the contacts; why, and what to do, is said below."]
    colour: Literal["green", "yellow", "red"] = "green"
    if not law_estimates:
        colour = "red"
    elif report.findings or unanswered or not all_fit:
        colour = "yellow"
    findings_html = page.list_html(finding.sentence for finding in report.findings) if report.findings else ""
    laws_html = f"<h2>What was found</h2>{''.join(map(_law_section, law_estimates))}" if law_estimates else ""
    law_html, sections = "", []
    if unanswered:
        refusals_html = page.table(("contact", "why"), [(refusal.name, refusal.reason) for refusal in unanswered])
        sections.append(("What was refused", refusals_html))
    for figure_name, figure in figures.items():
        if figure_name == "law":
            law_html = page.figure(figure_name, figure, _CAPTION_BY_FIGURE[figure_name], page.FIRST_PLOT_PX)
        else:
            sections.append(("Over time", page.figure(figure_name, figure, _CAPTION_BY_FIGURE[figure_name])))
    page.write(
        path,
        title=title,
        answer=page.Answer(colour, headline, sentences),
        top_blocks=[f"{findings_html}{laws_html}", law_html],
        sections=sections,
        foot_text="Every number of this page stands in law.json, unrounded.",
        sources=sources,
    )


def _law_section(law: ContactLawEstimate) -> str:
    """Section on one contact: the laws tried, and the values of the one that fits: friction, or straight pieces."""
    law_rows = [
        (
            candidate.law + (" (the best)" if candidate.law == law.best else ""),
            number(candidate.held_out_error_n, 3),
            percent(candidate.left_share),
        )
        for candidate in law.candidates
    ]
    pieces_note = (
        " They are as long as those of contact.html, whose values are of one dead zone, fitted with the tolerances, "
        "and differ within the intervals. Damping in the closed contact explains "
        f"{100 * law.hysteresis_share:.2g} % of the variance that straight pieces leave."
    )
    if not law.sides_known:
        pieces_note += " Knees count from the middle of the play, as no sensor tells its place."
    repeat_note = "" if law.repeatable else " Time ended the search, so the same seed will not repeat it exactly."
    value_rows = list(_law_values(law))
    formula_html = f"<p>{escape(law.formula)}</p>" if law.candidate(FORMULA).fits else ""
    return (
        f"<h3>{escape(law.contact)}</h3>"
        + page.table(("law", "left of held-out data, N rms", "of the force, beyond the sensors' noise"), law_rows)
        + (page.table(("", "value ± 95 %"), value_rows) if value_rows else "")
        + formula_html
        + f"<p>The laws were fitted to one half of the record and judged by the other; one that leaves more than "
        f"{100 * MAX_LEFT_SHARE:.3g} % of the force does not fit.{repeat_note} The intervals hold scatter, misfit of "
        f"the law, and tolerances.{'' if law.sliding else pieces_note}</p>"
    )


def _law_values(law: ContactLawEstimate) -> Iterator[tuple[str, str]]:
    """Names and values with 95 % intervals: of the friction where it is the best law, else of straight pieces that
    fit."""
    if law.sliding is not None:
        yield from law.sliding.value_texts
        for field in law.sliding.undetermined:
            yield law.sliding.names[field], "not told by this record"
    elif law.candidate(PIECEWISE).fits:
        for ordinal, knee in enumerate(law.fitted_knees_m, start=1):
            yield f"{PIECEWISE}, knee {ordinal}", estimate_interval(knee, "mm", 1e3)
        for ordinal, slope in enumerate(law.fitted_slopes_n_per_m, start=1):
            yield f"{PIECEWISE}, slope {ordinal}", estimate_interval(slope, "N/m")


def law_figures(laws: Sequence[ContactLawFit]) -> dict[str, Picture]:
    """Figures of the laws by name; none without a law."""
    if not laws:
        return {}
    return {
        "law": picture(partial(_draw_law, laws=laws)),
        "law_over_time": picture(partial(_draw_over_time, laws=laws)),
    }


def _draw_law(figure: Any, laws: Sequence[ContactLawFit]) -> None:
    """Draw each contact's force over eta: the points searched, formula and straight pieces, and their residual below.

    Where friction is the best law, draw that instead, along the course of eta.
    """
    force_panels, residual_panels = figure.subplots(
        2, len(laws), squeeze=False, sharex="col", sharey="row", height_ratios=(3, 1)
    )
    for force_axes, residual_axes, law in zip(force_panels, residual_panels, laws, strict=True):
        if law.sliding is not None:
            _draw_sliding(force_axes, residual_axes, law)
            continue
        eta_m, knees_m = law.searched_eta_m, law.pieces.knees_m
        eta_grid_m = np.linspace(eta_m.min(), eta_m.max(), 800)
        formula_n, pieces_n = law.formula(eta_grid_m), law.pieces(eta_grid_m)
        force_axes.plot(
            1e3 * eta_m, law.searched_force_n, "o", ms=4, color=GREY, alpha=0.4, label="force, no law assumed"
        )
        residual_axes.plot(1e3 * eta_m, law.searched_force_n - law.pieces(eta_m), ".", ms=2, color=GREY, alpha=0.5)
        for axes, subtracted_n in ((force_axes, 0.0), (residual_axes, pieces_n)):
            axes.plot(1e3 * eta_grid_m, formula_n - subtracted_n, color=BLUE, lw=1.4, label="formula found")
            axes.plot(1e3 * eta_grid_m, pieces_n - subtracted_n, color=RED, lw=1.4, ls="--", label="straight pieces")
        force_axes.plot(1e3 * knees_m, law.pieces(knees_m), "o", ms=8, mfc="none", mew=1.5, color=GREEN, label="knees")
        force_axes.set(title=law.result.contact)
        residual_axes.set(xlabel="η, mm")
    force_panels[0].set_ylabel("contact force, N")
    residual_panels[0].set_ylabel("left over, N")
    _draw_legend(figure, force_panels)


def _draw_over_time(figure: Any, laws: Sequence[ContactLawFit]) -> None:
    """Draw force, law and relative displacement over time around the largest force."""
    force_panels, motion_panels = figure.subplots(2, len(laws), squeeze=False, sharex="col", sharey="row")
    for force_axes, motion_axes, law in zip(force_panels, motion_panels, laws, strict=True):
        force_n = law.record.force_n
        largest_index = int(np.argmax(np.abs(force_n[EDGE_SAMPLE_COUNT:-EDGE_SAMPLE_COUNT]))) + EDGE_SAMPLE_COUNT
        start = min(max(largest_index - SECTION_SAMPLE_COUNT // 2, 0), max(force_n.size - SECTION_SAMPLE_COUNT, 0))
        section = slice(start, start + SECTION_SAMPLE_COUNT)
        time_s, eta_mm = law.time_s[section], 1e3 * law.record.eta_at_force_m[section]
        force_axes.plot(time_s, force_n[section], color=GREY, lw=2.4, label="force, no law assumed")
        force_axes.plot(time_s, law.plotted_force_n[section], color=RED, lw=1.0, label=law.plotted_law)
        motion_axes.plot(time_s, eta_mm, color=BLUE, lw=1.0)
        force_axes.set(title=law.result.contact)
        motion_axes.set(xlabel="time, s")
    force_panels[0].set_ylabel("contact force, N")
    motion_panels[0].set_ylabel("η, mm")
    _draw_legend(figure, force_panels)


def _draw_legend(figure: Any, panels: Any) -> None:
    """Draw one legend for all panels, each label once."""
    handles: dict[str, Any] = {}
    for axes in panels:
        handles |= {label: handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=4)


def _draw_sliding(force_axes: Any, residual_axes: Any, law: ContactLawFit) -> None:
    eta_mm, force_n, law_force_n = 1e3 * law.record.eta_at_force_m, law.record.force_n, law.plotted_force_n
    force_axes.plot(eta_mm, force_n, color=GREY, lw=0.5, label="force, no law assumed")
    force_axes.plot(eta_mm, law_force_n, color=RED, lw=0.9, label=law.plotted_law)
    residual_axes.plot(eta_mm, force_n - law_force_n, color=GREY, lw=0.5)
    force_axes.set(title=law.result.contact)
    residual_axes.set(xlabel="η, mm")


def curves(laws: Sequence[ContactLawFit]) -> dict[str, Table]:
    """Tables by name: `law_over_time` (relative displacement, separated force and low-passed force of the law) and, for
    the N-th contact, `law_N` (formula and straight pieces over relative displacement); none without a law."""
    tables = {
        f"law_{contact_number}": _law_over_displacement_table(law) for contact_number, law in enumerate(laws, start=1)
    }
    return tables | ({"law_over_time": _law_over_time_table(laws)} if laws else {})


def _law_over_time_table(laws: Sequence[ContactLawFit]) -> Table:
    row_count = min(law.record.force_n.size for law in laws)
    columns: Table = {"time_s": laws[0].time_s[:row_count]}
    for law in laws:
        contact_name = law.result.contact
        columns[f"{contact_name} relative displacement m"] = law.record.eta_at_force_m[:row_count]
        columns[f"{contact_name} contact force N"] = law.record.force_n[:row_count]
        columns[f"{contact_name} {law.plotted_law} N"] = law.plotted_force_n[:row_count]
    return columns


def _law_over_displacement_table(law: ContactLawFit) -> Table:
    contact_name, eta_m = (
        law.result.contact,
        np.linspace(law.searched_eta_m.min(), law.searched_eta_m.max(), TABULATED_POINT_COUNT),
    )
    return {
        f"{contact_name} relative displacement m": eta_m,
        f"{contact_name} formula N": law.formula(eta_m),
        f"{contact_name} straight pieces N": law.pieces(eta_m),
    }
