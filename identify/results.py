"""Results of the public functions, each as text, dictionary, rows of a table, figures, and files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec

from identify.checks import Finding
from identify.contacts import Identification
from identify.contacts.results import ContactReport, Estimate, Unanswered, identified_rig
from identify.gaps.results import Gap
from identify.history import History
from identify.history import page as history_page
from identify.laws import Laws
from identify.laws.results import LawReport
from identify.pages.style import Picture
from identify.pages.wording import COVERED, interval
from identify.planning import page as plan_page
from identify.planning.expectation import QUANTITIES
from identify.planning.results import PlanReport
from rig.errors import RigError
from rig.files import make_folder, write_bytes, write_json
from rig.model.contact_laws import ContactLaw
from rig.model.description import Rig

Row = dict[str, str | float]


@dataclass(frozen=True)
class CheckResult:
    """Findings on a recording and its rig.json, each with channel, evidence and mend."""

    findings: tuple[Finding, ...]
    title: str

    @property
    def sound(self) -> bool:
        return not self.findings

    def to_dict(self) -> dict[str, Any]:
        return {"sound": self.sound, "findings": [_finding_fields(f) for f in self.findings]}

    def table(self) -> list[Row]:
        """Row of each finding."""
        return [
            {"cause": f.cause, "channels": ", ".join(f.channels), "evidence": f.evidence, "mend": f.mend}
            for f in self.findings
        ]

    def __str__(self) -> str:
        return "\n".join(f.sentence for f in self.findings) or "nothing wrong was found"


@dataclass(frozen=True)
class ContactResult:
    """Contacts by a recording. `report` has all estimates with standard errors, as contact.json has.

    `laws` are the reference laws of the contacts, and `laws_name` names them.
    """

    found: Identification = field(repr=False)
    title: str
    laws: Mapping[str, ContactLaw]
    laws_name: str = "rig.json"
    sources: tuple[Path, ...] = ()

    @property
    def report(self) -> ContactReport:
        return self.found.report

    @property
    def rig(self) -> Rig:
        """Rig of the recording with the identified contacts."""
        return identified_rig(self.found.rig, self.report)

    def to_dict(self) -> dict[str, Any]:
        """Dictionary as in contact.json."""
        return dict(msgspec.to_builtins(self.report))

    def table(self) -> list[Row]:
        """Row of each contact: values, and half their 95 % intervals; `pandas.DataFrame` takes it."""
        names = ("clearance_m", "stiffness_n_per_m", "damping_n_s_per_m")
        return [
            {"contact": c.name, **_interval_fields({n: getattr(c, n) for n in names})} for c in self.report.contacts
        ]

    @cached_property
    def figures(self) -> dict[str, Picture]:
        """All figures by their names."""
        from identify.contacts.figures import contact_figures

        marks = {name: (law.clearance_m, law.stiffness_n_per_m) for name, law in self.laws.items()}
        return contact_figures(self.found, marks, self.laws_name)

    def figure(self, name: str) -> Picture:
        return _figure_named(self.figures, name)

    def save(self, folder: str | Path) -> None:
        """Write contact.html, a self-contained page, the figures, the identified rig.json, and contact.json."""
        from identify.contacts.report import write_results

        write_results(self.found, Path(folder), self.title, self.laws, self.laws_name, self.sources)

    def __str__(self) -> str:
        lines = [
            f"{c.name}: clearance {interval(1e3 * c.clearance_m.value, 1e3 * c.clearance_m.standard_error, 'mm')}, "
            f"stiffness {interval(c.stiffness_n_per_m.value, c.stiffness_n_per_m.standard_error, 'N/m')}"
            for c in self.report.contacts
        ]
        laws = [f"{sentence}." for c in self.report.contacts if (sentence := c.law_sentence)]
        warnings = [f"not to be relied on: {f.sentence}" for f in self.report.findings]
        return "\n".join([*warnings, *lines, *laws, *_unanswered_lines(self.report.unanswered)])


@dataclass(frozen=True)
class LawResult:
    """Contact laws as formulae. `report` has the contents of law.json."""

    found: Laws = field(repr=False)
    title: str
    sources: tuple[Path, ...] = ()

    @property
    def report(self) -> LawReport:
        return self.found.report

    def to_dict(self) -> dict[str, Any]:
        """Dictionary as in law.json."""
        return dict(msgspec.to_builtins(self.report))

    def table(self) -> list[Row]:
        """Row of each contact and candidate law, with the error of the force that was held out."""
        return [
            {"contact": law.contact, "law": candidate.law, "held_out_error_n": candidate.held_out_error_n}
            for law in self.report.laws
            for candidate in law.candidates
        ]

    @cached_property
    def figures(self) -> dict[str, Picture]:
        """All figures by their names, if a law was found."""
        from identify.laws.report import law_figures

        return law_figures(self.found.found)

    def figure(self, name: str = "law") -> Picture:
        return _figure_named(self.figures, name)

    def save(self, folder: str | Path) -> None:
        """Write law.html, a self-contained page, the figures, and law.json."""
        from identify.laws.report import write_results

        write_results(self.found, Path(folder), self.title, self.sources)

    def __str__(self) -> str:
        lines = [f"{law.contact}: {law.verdict}; {law.formula}" for law in self.report.laws]
        return "\n".join([*lines, *_unanswered_lines(self.report.unanswered)])


@dataclass(frozen=True)
class GapResult:
    """Difference of the machine from its description. `report` has the contents of gap.json, `corrected` is the new
    rig.

    findings are those of the check of every recording, of which some may be the effect that is diagnosed.
    """

    report: Gap = field(repr=False)
    corrected: Rig = field(repr=False)
    title: str
    findings: tuple[Finding, ...] = ()
    sources: tuple[Path, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Dictionary as in gap.json."""
        return dict(msgspec.to_builtins(self.report))

    def table(self) -> list[Row]:
        """Row of each cause, the most probable first: its probability, and the share of the mismatch that it
        explains."""
        return [
            {"cause": " + ".join(cause.effects), "probability": cause.probability, "explained": cause.explained}
            for cause in self.report.causes
        ]

    @cached_property
    def figures(self) -> dict[str, Picture]:
        """All figures by their names."""
        from identify.gaps.page.pictures import pictures

        return pictures(self.report, self.corrected)

    def figure(self, name: str) -> Picture:
        return _figure_named(self.figures, name)

    def save(self, folder: str | Path) -> None:
        """Write gap.html, a self-contained page, gap.json and the corrected rig.json."""
        from identify.gaps.page.report import write_all

        sentences = tuple(finding.sentence for finding in self.findings)
        write_all(self.report, self.corrected, self.title, Path(folder), self.sources, sentences)

    def __str__(self) -> str:
        return self.report.sentence


@dataclass(frozen=True)
class HistoryResult:
    """Changes of a machine from recording to recording. `report` has the contents of history.json."""

    report: History = field(repr=False)

    @property
    def changed(self) -> bool:
        return any(q.changed for q in self.report.quantities)

    def to_dict(self) -> dict[str, Any]:
        """Dictionary as in history.json."""
        return dict(msgspec.to_builtins(self.report))

    def table(self) -> list[Row]:
        """Row of each quantity: mean, change from the first recording to the last, and the p-values of both tests."""
        names = ("quantity", "mean", "first_to_last", "p_trend", "p_different")
        return [dict(zip(names, row, strict=True)) for row in history_page.rows(self.report)]

    @cached_property
    def figures(self) -> dict[str, Picture]:
        """The only figure, by its name."""
        return {"history": history_page.history_figure(self.report)}

    def figure(self, name: str = "history") -> Picture:
        return _figure_named(self.figures, name)

    def save(self, folder: str | Path) -> None:
        """Write history.html, a self-contained page, history.csv and history.json."""
        out = Path(folder)
        make_folder(out)
        history_page.write_page(self.report, self.figure(), out / "history.html")
        write_bytes(history_page.csv_of(self.report), out / "history.csv")
        write_json(self.report, out / "history.json")

    def __str__(self) -> str:
        return history_page.sentence(self.report)


@dataclass(frozen=True)
class PlanResult:
    """Plan of a test. `report` has the contents of plan.json, `rig` is the rig that was planned with."""

    report: PlanReport
    rig: Rig = field(repr=False)
    sources: tuple[Path, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Dictionary as in plan.json."""
        return dict(msgspec.to_builtins(self.report))

    def table(self) -> list[Row]:
        """Row of each contact: believed values, and half their expected 95 % intervals."""
        rows: list[Row] = []
        for contact in self.report.contacts:
            row: Row = {"contact": contact.name}
            for name, quantity in zip(QUANTITIES, contact.quantities, strict=True):
                row[name], row[f"{name}_within"] = quantity.value, COVERED * quantity.standard_error
            rows.append(row)
        return rows

    def save(self, folder: str | Path) -> None:
        """Write plan.html, a self-contained page, and plan.json."""
        out = Path(folder)
        make_folder(out)
        plan_page.write_page(self.report, self.rig, out / "plan.html", self.sources)
        write_json(self.report, out / "plan.json")

    def __str__(self) -> str:
        return plan_page.sentence(self.report)


def _finding_fields(finding: Finding) -> dict[str, Any]:
    return {**msgspec.to_builtins(finding), "sentence": finding.sentence}


def _interval_fields(estimates: Mapping[str, Estimate]) -> Row:
    row: Row = {}
    for name, estimate in estimates.items():
        row[name], row[f"{name}_within"] = estimate.value, COVERED * estimate.standard_error
    return row


def _unanswered_lines(unanswered: Sequence[Unanswered]) -> list[str]:
    return [f"{contact.name}: not told by this record: {contact.reason}" for contact in unanswered]


def _figure_named(figures: Mapping[str, Picture], name: str) -> Picture:
    if name not in figures:
        raise RigError(f"there is no figure {name!r}; there are {', '.join(figures)}")
    return figures[name]
