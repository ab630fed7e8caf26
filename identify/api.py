"""The public functions of `identify`, and their results; the commands are a skin over them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import quote

import msgspec
from threadpoolctl import threadpool_limits

from identify.checks import Finding, check_recording
from identify.contacts import Identification, identify_contact
from identify.contacts.identified_rig import identified_rig
from identify.contacts.results import ContactReport, Estimate, Unanswered
from identify.contacts.unforced import without_dead_force
from identify.gaps.decision.answer import diagnose
from identify.gaps.decision.null_reference import NULL_REFERENCE_SUFFIX
from identify.gaps.decision.simulators import simulator_named
from identify.gaps.results import Gap, Matters
from identify.history import History, history_of
from identify.history import page as history_page
from identify.history.observed import observations
from identify.laws import Laws, identify_law
from identify.laws.results import LawReport
from identify.pages.picture import Picture
from identify.pages.wording import COVERED, interval
from identify.signals.kinematics import Use
from identify.signals.spectra import Averaging
from rig.errors import RigError
from rig.files import check_target, make_folder, write_bytes, write_json
from rig.model.contact_laws import ContactLaw
from rig.model.description import Rig, read_rig
from rig.model.tolerances import Tolerances, tolerances_named
from rig.recording import Recording, channel_groups, read

Source = Recording | str | Path
LONGEST_NAME = 100
Row = dict[str, str | float]
Progress = Callable[[float], None]


@dataclass(frozen=True)
class CheckResult:
    """What of a recording or of its rig.json cannot be right: a finding each, with channel, evidence and mend."""

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
    """What a recording tells of the contacts. `report` has it all, with standard errors, as contact.json has.

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
        """As in contact.json."""
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
        doubts = [f"not to be relied on: {f.sentence}" for f in self.report.findings]
        return "\n".join([*doubts, *lines, *_silent(self.report.unanswered)])


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
        """As in law.json."""
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
    """How the machine differs from its description. `report` has what gap.json has, `corrected` is the mended rig.

    findings are those of the check of every recording, of which some may be the effect that is diagnosed.
    """

    report: Gap = field(repr=False)
    corrected: Rig = field(repr=False)
    title: str
    findings: tuple[Finding, ...] = ()
    sources: tuple[Path, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """As in gap.json."""
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
    """What changed of a machine from recording to recording. `report` has what history.json has."""

    report: History = field(repr=False)

    @property
    def changed(self) -> bool:
        return any(q.changed for q in self.report.quantities)

    def to_dict(self) -> dict[str, Any]:
        """As in history.json."""
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


def check(recording: Source, *, use: Use = "auto", tolerances: Tolerances | str | None = None) -> CheckResult:
    """Whether the channels fit each other, the force and rig.json (`identify.checks.check_recording` says how).

    Raises RigError if the recording cannot be read.
    """
    given = _recording(recording)
    with threadpool_limits(1):
        findings = check_recording(given, use, _believed(tolerances))
    return CheckResult(findings, _title([recording], given))


def _told(finding: Finding) -> dict[str, Any]:
    return {**msgspec.to_builtins(finding), "sentence": finding.sentence}


def contact(
    recording: Source,
    *,
    use: Use = "auto",
    averaging: Averaging | None = None,
    equation: str | None = None,
    tolerances: Tolerances | str | None = None,
    progress: Progress = lambda _: None,
) -> ContactResult:
    """Clearance, stiffness and damping of every contact (`identify.contacts.identify_contact` says how).

    tolerances say how exactly the recording's rig is believed: `laboratory`, `exact`, a TOML file, or the rig's own.
    Raises RigError if the recording does not allow it.
    """
    given = _recording(recording)
    found = identify_contact(
        given,
        use=use,
        averaging=averaging,
        equation=equation,
        tolerances=_believed(tolerances),
        progress=progress,
    )
    laws = {c.name: c.law for c in given.rig.contacts}
    return ContactResult(found, _title([recording], given), laws, sources=_files([recording]))


def law(
    recording: Source,
    *,
    contact: str | None = None,
    use: Use = "auto",
    seconds: float = 60.0,
    seed: int = 0,
    tolerances: Tolerances | str | None = None,
    progress: Progress = lambda _: None,
) -> LawResult:
    """The contact law of every contact, or the one named, as a formula (`identify.laws.identify_law` says how).

    Needs the package pyoperon. Raises RigError if the recording does not allow it.
    """
    given = _recording(recording)
    found = identify_law(
        given,
        contact=contact,
        use=use,
        seconds=seconds,
        seed=seed,
        tolerances=_believed(tolerances),
        progress=progress,
    )
    return LawResult(found, _title([recording], given), _files([recording]))


def gap(
    recordings: Source | Sequence[Source],
    validation: Source | None = None,
    *,
    simulator: str = "modal",
    null_reference: str | Path | None = None,
    tolerances: Tolerances | str | None = None,
    matters: Matters | None = None,
    next_experiment: bool = False,
    rig: Rig | str | Path | None = None,
    progress: Callable[[str, float], None] = lambda *_: None,
) -> GapResult:
    """Where the believed rig differs from reality, which effect causes it, how far the gap shrinks with it.

    The validation is not fitted: one of the recordings, or another; without it the last of several, or the last part of
    a single one. `rig` is believed instead of the rig that is in the recordings: a value, or a rig.json.
    `null_reference` is a file, or a folder for it, that keeps the null reference for the next time.
    Raises RigError if the recordings do not fit together or allow no diagnosis.
    """
    every = [recordings] if isinstance(recordings, Recording | str | Path) else list(recordings)
    known = {_identity(one): one for one in every}
    if len(known) < len(every):
        raise RigError("a recording is given twice; give each once")
    believed = read_rig(Path(rig)) if isinstance(rig, str | Path) else rig
    given = {identity: _of_rig(one, believed, rig) for identity, one in known.items()}
    first = next(iter(given.values()))
    kept = None if null_reference is None else Path(null_reference)
    if kept and kept.is_dir():
        kept /= f"{quote(first.rig.name, safe=' ')[:LONGEST_NAME]}-{simulator}{NULL_REFERENCE_SUFFIX}"
    if kept:
        sources = [Path(one) for one in (*every, validation, rig) if isinstance(one, str | Path)]
        check_target(kept, *sources, new_folder=True)
    with threadpool_limits(1):  # the matrices are small
        findings = [f for one in given.values() for f in check_recording(one, tolerances=_believed(tolerances))]
        found, corrected = diagnose(
            list(given.values()),
            None if validation is None else given.get(_identity(validation)) or _of_rig(validation, believed, rig),
            simulator_named(simulator),
            kept,
            progress,
            _believed(tolerances),
            matters or Matters(),
            next_experiment,
        )
    used = every if validation is None else [*every, validation]
    told = dict.fromkeys(without_dead_force(findings, first.force_names))  # zeros were taken as a free decay's force
    return GapResult(found, corrected, _title(every, first), tuple(told), _files(used))


def compare(
    sources: Sequence[str | Path],
    *,
    use: Use = "auto",
    tolerances: Tolerances | str | None = None,
    progress: Progress = lambda _: None,
) -> HistoryResult:
    """Clearances, stiffnesses, dampings and modes over recordings of one machine, and whether they changed.

    The sources are recordings, or folders with a contact.json, in their order (`identify.history` says how they are
    compared). Raises RigError if fewer than two tell anything, or they are of different rigs.
    """
    paths = [Path(one) for one in sources]
    if len({path.resolve() for path in paths}) < len(paths):
        raise RigError("a recording is given twice; give each once")
    with threadpool_limits(1):
        found = history_of(list(observations(paths, use, _believed(tolerances), progress)))
    return HistoryResult(found)


def _identity(source: Source) -> Path | int:
    """By which one recording is known again."""
    return id(source) if isinstance(source, Recording) else Path(source).resolve()


def _recording(source: Source) -> Recording:
    return source if isinstance(source, Recording) else read(Path(source))


def _of_rig(source: Source, rig: Rig | None, name: Rig | str | Path | None) -> Recording:
    """The recording, with another rig believed if one is given; raises RigError if its channels are others."""
    recording = _recording(source)
    if rig is None:
        return recording
    groups = channel_groups(rig)
    known = {quantity: (c.names, c.sample_rate_hz) for quantity, c in groups.items()}
    if known != {quantity: (s.channels.names, s.channels.sample_rate_hz) for quantity, s in recording.signals.items()}:
        told = name if isinstance(name, str | Path) else f"rig {rig.name!r}"
        file = "the recording" if isinstance(source, Recording) else source
        raise RigError(
            f"{told}: its forces, sensors or their sampling rate are not those of {file}; give one with the same"
        )
    signals = {quantity: replace(s, channels=groups[quantity]) for quantity, s in recording.signals.items()}
    return replace(recording, rig=rig, signals=signals)


def _believed(tolerances: Tolerances | str | None) -> Tolerances | None:
    return tolerances_named(tolerances) if isinstance(tolerances, str) else tolerances


def _title(sources: Sequence[Source], first: Recording) -> str:
    files = ", ".join(Path(one).name for one in sources if not isinstance(one, Recording))
    return f"{first.rig.name}: {files}" if files else first.rig.name


def _files(sources: Sequence[Source]) -> tuple[Path, ...]:
    return tuple(dict.fromkeys(Path(one) for one in sources if not isinstance(one, Recording)))


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
