"""Results of the public functions, each as text, dictionary, rows of a table, figures, and files."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec

from identify.checks import Finding
from identify.contacts import Identification
from identify.contacts.identified_contact import IdentifiedContact, identified_contact
from identify.contacts.results import ContactReport, Estimate, Unanswered, identified_rig
from identify.contacts.space_identification import SpaceIdentification
from identify.gaps.results import Gap
from identify.history import History
from identify.history import page as history_page
from identify.laws import Laws
from identify.laws.results import FORMULA, LawReport
from identify.pages.style import Picture
from identify.pages.summary import Summarized, Summary
from identify.pages.wording import COVERED, number, percent
from rig.errors import RigError
from rig.files import make_folder, write_bytes, write_json
from rig.model.contact_laws import ContactLaw
from rig.model.description import Rig

Row = dict[str, str | float]
MAX_CAUSE_COUNT = 5
"""Causes of a diagnosis in its summary, the most probable first. Display."""


@dataclass(frozen=True)
class CheckResult(Summarized):
    """Findings on a recording and its rig.json, each with channel, evidence and mend."""

    findings: tuple[Finding, ...]
    """Findings, none if nothing is wrong."""
    title: str
    """Name of the rig, with the files that were checked."""
    notes: tuple[str, ...] = ()
    """Sentences on what was not checked."""

    @property
    def sound(self) -> bool:
        """True if nothing wrong was found."""
        return not self.findings

    def to_dict(self) -> dict[str, Any]:
        """Dictionary with `sound` and the findings."""
        fields = {"sound": self.sound, "findings": [_finding_fields(finding) for finding in self.findings]}
        return fields | ({"notes": list(self.notes)} if self.notes else {})

    def table(self) -> list[Row]:
        """Row of each finding."""
        return [
            {"cause": f.cause, "channels": ", ".join(f.channels), "evidence": f.evidence, "mend": f.mend}
            for f in self.findings
        ]

    def summary(self) -> Summary:
        """Each finding with its cause and its sentence."""
        if self.sound:
            return Summary(above=("nothing wrong was found",))
        return Summary(tuple({"cause": f.cause, "finding": f.sentence} for f in self.findings))


class Illustrated(Summarized):
    """Result with figures by their names."""

    @cached_property
    @abstractmethod
    def figures(self) -> dict[str, Picture]:
        """All figures by their names."""

    def figure(self, name: str | None = None) -> Picture:
        """Figure of that name, by default the first, which a notebook shows and `.save(path)` writes as PNG."""
        name = next(iter(self.figures), "") if name is None else name
        if name not in self.figures:
            raise RigError(f"there is no figure {name!r}; there are {', '.join(self.figures)}")
        return self.figures[name]


@dataclass(frozen=True)
class ContactResult(Illustrated):
    """Contacts by a recording: `found["contact_1"].clearance` has `.value`, `.interval`, `.unit`, `.standard_error`."""

    identification: Identification | SpaceIdentification = field(repr=False)
    """Estimates with the signals from which the figures are drawn."""
    title: str
    """Name of the rig, with the file of the recording."""
    laws: Mapping[str, ContactLaw]
    """Reference laws by contact, which the figures mark."""
    laws_name: str = "rig.json"
    """Name of the reference laws."""
    sources: tuple[Path, ...] = ()
    """Files of the recordings."""

    def __getitem__(self, name: str) -> IdentifiedContact:
        """Contact of that name; raises RigError if the recording does not determine it, or there is none."""
        contact_by_name = {contact.name: contact for contact in self.contacts}
        if name in contact_by_name:
            return contact_by_name[name]
        for contact in self.report.unanswered:
            if contact.name == name:
                raise RigError(f"contact {name!r} is not determined by this record: {contact.reason}")
        raise RigError(f"there is no contact {name!r}; there are {', '.join(contact_by_name) or 'none'}")

    @property
    def contacts(self) -> tuple[IdentifiedContact, ...]:
        """Identified contacts."""
        return tuple(map(identified_contact, self.report.contacts))

    @property
    def report(self) -> ContactReport:
        """All estimates with standard errors: the contents of contact.json."""
        return self.identification.report

    @property
    def rig(self) -> Rig:
        """Rig of the recording with the identified contacts."""
        return identified_rig(self.identification.rig, self.report)

    def to_dict(self) -> dict[str, Any]:
        """Dictionary as in contact.json."""
        return dict(msgspec.to_builtins(self.report))

    def table(self) -> list[Row]:
        """Row of each contact: values, and half their 95 % intervals; `pandas.DataFrame` takes it."""
        quantity_names = ("clearance_m", "stiffness_n_per_m", "damping_n_s_per_m", "friction_coefficient")
        return [
            {"contact": c.name, **_interval_fields({n: e for n in quantity_names if (e := getattr(c, n)) is not None})}
            for c in self.report.contacts
        ]

    @cached_property
    def figures(self) -> dict[str, Picture]:
        """All figures by their names."""
        from identify.contacts.drawn_results import figures_of

        return figures_of(self.identification, self.laws, self.laws_name)

    def save(self, folder: str | Path) -> None:
        """Write contact.html, a self-contained page, the figures, the identified rig.json, and contact.json."""
        from identify.contacts.drawn_results import write_files

        write_files(self.identification, Path(folder), self.title, self.laws, self.laws_name, self.sources)

    def summary(self) -> Summary:
        """Clearance, stiffness and damping of each contact ± half their 95 % intervals, and what is not told."""
        law_sentences = [f"{sentence}." for contact in self.report.contacts if (sentence := contact.law_sentence)]
        return Summary(
            tuple(contact.cells for contact in self.contacts),
            above=tuple(f"not to be relied on: {finding.sentence}" for finding in self.report.findings),
            below=(*law_sentences, *_unanswered_lines(self.report.unanswered)),
        )


@dataclass(frozen=True)
class LawResult(Illustrated):
    """Contact laws as formulae."""

    identification: Laws = field(repr=False)
    """Laws with the signals from which the figures are drawn."""
    title: str
    """Name of the rig, with the file of the recording."""
    sources: tuple[Path, ...] = ()
    """Files of the recordings."""

    @property
    def report(self) -> LawReport:
        """Laws with all values: the contents of law.json."""
        return self.identification.report

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

        return law_figures(self.identification.fits)

    def save(self, folder: str | Path) -> None:
        """Write law.html, a self-contained page, the figures, and law.json."""
        from identify.laws.report import write_results

        write_results(self.identification, Path(folder), self.title, self.sources)

    def summary(self) -> Summary:
        """Laws tried on each contact with what they leave of the held-out force, and the verdicts with the formulae."""
        rows = tuple(
            {
                "contact": law.contact,
                "law": tried.law,
                "left of held-out data, N rms": number(tried.held_out_error_n, 3),
                "of the force": percent(tried.left_share),
            }
            for law in self.report.laws
            for tried in law.candidates
        )
        formulas = [f"; {law.formula}" if law.candidate(FORMULA).fits else "" for law in self.report.laws]
        verdicts = tuple(
            f"{law.contact}: {law.verdict}{formula}" for law, formula in zip(self.report.laws, formulas, strict=True)
        )
        return Summary(rows, below=(*verdicts, *_unanswered_lines(self.report.unanswered)))


@dataclass(frozen=True)
class GapResult(Illustrated):
    """Difference of the machine from its description."""

    report: Gap = field(repr=False)
    """Verdict, causes and evidence: the contents of gap.json."""
    corrected: Rig = field(repr=False)
    """Rig with the named effects in it; the nominal rig where none is named."""
    title: str
    """Name of the rig, with the files of the recordings."""
    findings: tuple[Finding, ...] = ()
    """Findings of the check of every recording, of which some may be the effect that is diagnosed."""
    sources: tuple[Path, ...] = ()
    """Files of the recordings."""

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

        return pictures(self.report)

    def save(self, folder: str | Path) -> None:
        """Write gap.html, a self-contained page, gap.json and the corrected rig.json."""
        from identify.gaps.page.report import write_all

        sentences = tuple(finding.sentence for finding in self.findings)
        write_all(self.report, self.corrected, self.title, Path(folder), self.sources, sentences)

    def summary(self) -> Summary:
        """Sentence of the verdict, and the likeliest causes with the share of the difference that each removes."""
        rows = tuple(
            {
                "cause": "; ".join(cause.words),
                "probability": percent(cause.probability),
                "difference removed": percent(cause.explained),
            }
            for cause in self.report.causes[:MAX_CAUSE_COUNT]
        )
        return Summary(rows, above=(self.report.sentence,))


@dataclass(frozen=True)
class HistoryResult(Illustrated):
    """Changes of a machine from recording to recording."""

    report: History = field(repr=False)
    """Values by recording, with the tests: the contents of history.json."""

    @property
    def changed(self) -> bool:
        """True if a quantity changed by more than chance."""
        return any(quantity.changed for quantity in self.report.quantities)

    def to_dict(self) -> dict[str, Any]:
        """Dictionary as in history.json."""
        return dict(msgspec.to_builtins(self.report))

    def table(self) -> list[Row]:
        """Row of each quantity: mean, largest change with its p-value, and change along the trend with its own."""
        column_names = ("quantity", "mean", "largest_change", "p_different", "first_to_last", "p_trend")
        return [dict(zip(column_names, row, strict=True)) for row in history_page.quantity_rows(self.report)]

    @cached_property
    def figures(self) -> dict[str, Picture]:
        """The only figure, by its name."""
        return {"history": history_page.history_figure(self.report)}

    def save(self, folder: str | Path) -> None:
        """Write history.html, a self-contained page, history.csv and history.json."""
        folder_path = Path(folder)
        make_folder(folder_path)
        history_page.write_page(self.report, self.figure(), folder_path / "history.html")
        write_bytes(history_page.history_csv(self.report), folder_path / "history.csv")
        write_json(self.report, folder_path / "history.json")

    @property
    def sentence(self) -> str:
        """Sentence on the quantities that changed."""
        return history_page.sentence(self.report)

    def summary(self) -> Summary:
        """Sentence on what changed, and each quantity with its changes and their p-values."""
        headings, rows_of_texts = history_page.quantity_table(self.report)
        rows = tuple(dict(zip(["quantity", *headings[1:]], row, strict=True)) for row in rows_of_texts)
        return Summary(rows, above=(self.sentence,))


def _finding_fields(finding: Finding) -> dict[str, Any]:
    return {**msgspec.to_builtins(finding), "sentence": finding.sentence}


def _interval_fields(estimates: Mapping[str, Estimate]) -> Row:
    row: Row = {}
    for quantity_name, estimate in estimates.items():
        row[quantity_name], row[f"{quantity_name}_within"] = estimate.value, COVERED * estimate.standard_error
    return row


def _unanswered_lines(unanswered: Sequence[Unanswered]) -> list[str]:
    return [f"{contact.name}: not determined by this record: {contact.reason}" for contact in unanswered]
