"""The results of the public functions: each as text, dictionary, rows of a table, figures, and files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec

from identify.checks import Finding
from identify.contacts import Identification
from identify.contacts.identified_rig import identified_rig
from identify.contacts.results import ContactReport, Estimate, Unanswered
from identify.gaps.results import Gap
from identify.history import History
from identify.history import page as history_page
from identify.laws import Laws
from identify.laws.results import LawReport
from identify.pages.picture import Picture
from identify.pages.wording import COVERED, interval
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
        return {"sound": self.sound, "findings": [_told(f) for f in self.findings]}

    def table(self) -> list[Row]:
        """A row a finding."""
        return [
            {"cause": f.cause, "channels": ", ".join(f.channels), "evidence": f.evidence, "mend": f.mend}
            for f in self.findings
        ]

    def __str__(self) -> str:
        return "\n".join(f.sentence for f in self.findings) or "nothing wrong was found"


@dataclass(frozen=True)
class ContactResult:
    """Contacts by a recording. `report` has it all, with standard errors, as contact.json has.

    Beside the identified values stand those of `laws`, which are what `laws_name` says.
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
        """The recording's rig with the identified contacts."""
        return identified_rig(self.found.rig, self.report)

    def to_dict(self) -> dict[str, Any]:
        """Dictionary as in contact.json."""
        return dict(msgspec.to_builtins(self.report))

    def table(self) -> list[Row]:
        """A row a contact: each value, and half its 95 % interval; `pandas.DataFrame` takes it."""
        names = ("clearance_m", "stiffness_n_per_m", "damping_n_s_per_m")
        return [{"contact": c.name, **_interval({n: getattr(c, n) for n in names})} for c in self.report.contacts]

    @cached_property
    def figures(self) -> dict[str, Picture]:
        """All figures by their names."""
        from identify.contacts.figures import drawn

        marks = {name: (law.clearance_m, law.stiffness_n_per_m) for name, law in self.laws.items()}
        return drawn(self.found, marks, self.laws_name)

    def figure(self, name: str) -> Picture:
        return _named(self.figures, name)

    def save(self, folder: str | Path) -> None:
        """Writes contact.html, a page that stands alone, the figures, the identified rig.json, and contact.json."""
        from identify.contacts.report import write_results

        write_results(self.found, Path(folder), self.title, self.laws, self.laws_name, self.sources)

    def __str__(self) -> str:
        lines = [
            f"{c.name}: clearance {interval(1e3 * c.clearance_m.value, 1e3 * c.clearance_m.standard_error, 'mm')}, "
            f"stiffness {interval(c.stiffness_n_per_m.value, c.stiffness_n_per_m.standard_error, 'N/m')}"
            for c in self.report.contacts
        ]
        laws = [f"{said}." for c in self.report.contacts if (said := c.law_sentence)]
        doubts = [f"not to be relied on: {f.sentence}" for f in self.report.findings]
        return "\n".join([*doubts, *lines, *laws, *_silent(self.report.unanswered)])


@dataclass(frozen=True)
class LawResult:
    """The contact laws as formulae. `report` has what law.json has."""

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
        """A row a contact and law that was tried, with what it leaves of the force that was held out."""
        return [
            {"contact": one.contact, "law": tried.law, "held_out_error_n": tried.held_out_error_n}
            for one in self.report.laws
            for tried in one.candidates
        ]

    @cached_property
    def figures(self) -> dict[str, Picture]:
        """All figures by their names, if a law was found."""
        from identify.laws.figures import drawn

        return drawn(self.found.found)

    def figure(self, name: str = "law") -> Picture:
        return _named(self.figures, name)

    def save(self, folder: str | Path) -> None:
        """Writes law.html, a page that stands alone, the figures, and law.json."""
        from identify.laws.report import write_results

        write_results(self.found, Path(folder), self.title, self.sources)

    def __str__(self) -> str:
        lines = [f"{one.contact}: {one.verdict}; {one.formula}" for one in self.report.laws]
        return "\n".join([*lines, *_silent(self.report.unanswered)])


@dataclass(frozen=True)
class GapResult:
    """Difference of the machine from its description. `report` has what gap.json has, `corrected` is the mended rig.

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
        """A row a cause, the likeliest first: its probability, and the share of the gap that it explains."""
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
        return _named(self.figures, name)

    def save(self, folder: str | Path) -> None:
        """Writes gap.html, a page that stands alone, gap.json and the corrected rig.json."""
        from identify.gaps.page.report import write_all

        write_all(self.report, self.corrected, self.title, Path(folder), self.sources)

    def __str__(self) -> str:
        return self.report.sentence


@dataclass(frozen=True)
class HistoryResult:
    """Changes of a machine from recording to recording. `report` has what history.json has."""

    report: History = field(repr=False)

    @property
    def changed(self) -> bool:
        return any(q.changed for q in self.report.quantities)

    def to_dict(self) -> dict[str, Any]:
        """Dictionary as in history.json."""
        return dict(msgspec.to_builtins(self.report))

    def table(self) -> list[Row]:
        """A row a quantity: its mean, change from the first recording to the last, and the p-values of both tests."""
        names = ("quantity", "mean", "first_to_last", "p_trend", "p_different")
        return [dict(zip(names, row, strict=True)) for row in history_page.rows(self.report)]

    @cached_property
    def figures(self) -> dict[str, Picture]:
        """All figures by their names: one."""
        return {"history": history_page.drawn(self.report)}

    def figure(self, name: str = "history") -> Picture:
        return _named(self.figures, name)

    def save(self, folder: str | Path) -> None:
        """Writes history.html, a page that stands alone, history.csv and history.json."""
        out = Path(folder)
        make_folder(out)
        history_page.write_page(self.report, self.figure(), out / "history.html")
        write_bytes(history_page.csv_of(self.report), out / "history.csv")
        write_json(self.report, out / "history.json")

    def __str__(self) -> str:
        return history_page.sentence(self.report)


def _told(finding: Finding) -> dict[str, Any]:
    return {**msgspec.to_builtins(finding), "sentence": finding.sentence}


def _interval(estimates: Mapping[str, Estimate]) -> Row:
    found: Row = {}
    for name, estimate in estimates.items():
        found[name], found[f"{name}_within"] = estimate.value, COVERED * estimate.standard_error
    return found


def _silent(unanswered: Sequence[Unanswered]) -> list[str]:
    return [f"{one.name}: not told by this record: {one.reason}" for one in unanswered]


def _named(figures: Mapping[str, Picture], name: str) -> Picture:
    if name not in figures:
        raise RigError(f"there is no figure {name!r}; there are {', '.join(figures)}")
    return figures[name]
