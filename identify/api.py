"""Public functions of `identify`, which the commands call."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

from threadpoolctl import threadpool_limits

from identify.checks import Finding, check_recording, unchecked_notes
from identify.contacts.acceptance import without_dead_force_channel_findings
from identify.contacts.space_contacts import space_recording_findings
from identify.contacts.space_identification import identify_recording
from identify.gaps.decision.answer import diagnose
from identify.gaps.decision.null_reference import NULL_REFERENCE_SUFFIX
from identify.gaps.decision.prepare import simulator_named
from identify.gaps.decision.space import diagnose_in_space
from identify.gaps.results import Matters
from identify.history import history_of
from identify.history.observations import observations
from identify.laws import identify_law
from identify.planning.plan_result import PlanResult
from identify.planning.planned_test import planned_test
from identify.planning.ranking import MAX_CHANGE_COUNT, ranked_plan
from identify.results import CheckResult, ContactResult, GapResult, HistoryResult, LawResult
from identify.signals.kinematics import MotionQuantity
from identify.signals.spectra import Averaging
from rig.errors import RigError
from rig.files import check_target
from rig.model.description import Rig, read_rig, to_json
from rig.model.space import check_plane
from rig.model.tolerances import Tolerances, tolerances_named
from rig.recording import Recording, channel_groups, read

Source = Recording | str | Path
MAX_NAME_SIZE = 100
Progress = Callable[[float], None]


def check(
    recording: Source, *, use: MotionQuantity = "auto", tolerances: Tolerances | str | None = None
) -> CheckResult:
    """Check whether the channels fit each other, the force and rig.json (as `identify.checks.check_recording`).

    Raises RigError if the recording cannot be read.
    """
    record = _recording(recording)
    with threadpool_limits(1):
        if not record.rig.in_space:
            check_plane(record.rig, "identify check without annular contacts")
        findings = _findings_of(record, _tolerances(tolerances), use)
    return CheckResult(findings, _title([recording], record), unchecked_notes(record.rig))


def contact(
    recording: Source,
    *,
    use: MotionQuantity = "auto",
    averaging: Averaging | None = None,
    equation: str | None = None,
    tolerances: Tolerances | str | None = None,
    progress: Progress = lambda _: None,
) -> ContactResult:
    """Clearance, stiffness and damping of every contact (`identify.contacts` says how).

    tolerances are the uncertainties of the recording's rig: `laboratory`, `exact`, a TOML file, or the rig's own.
    Raises RigError if the recording does not allow it.
    """
    record = _recording(recording)
    identification = identify_recording(
        record,
        use=use,
        averaging=averaging,
        equation=equation,
        tolerances=_tolerances(tolerances),
        progress=progress,
    )
    is_believed = record.rig.tolerances is None or record.rig.tolerances.contacts_known
    law_by_contact = {contact.name: contact.law for contact in record.rig.contacts if is_believed}
    return ContactResult(identification, _title([recording], record), law_by_contact, sources=_paths([recording]))


def law(
    recording: Source,
    *,
    contact: str | None = None,
    use: MotionQuantity = "auto",
    seconds: float = 60.0,
    seed: int = 0,
    tolerances: Tolerances | str | None = None,
    progress: Progress = lambda _: None,
) -> LawResult:
    """Law of every contact, or of the named one, as a formula (`identify.laws.identify_law` says how).

    Needs the package pyoperon. Raises RigError if the recording does not allow it.
    """
    record = _recording(recording)
    check_plane(record.rig, "identify law")
    laws = identify_law(
        record,
        contact=contact,
        use=use,
        seconds=seconds,
        seed=seed,
        tolerances=_tolerances(tolerances),
        progress=progress,
    )
    return LawResult(laws, _title([recording], record), _paths([recording]))


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
    """Diagnose where the nominal rig differs from reality, which effects cause it, how far the mismatch shrinks.

    The validation record is not fitted: one of the recordings, or another; by default the last of several, or the last
    part of a single one. `rig`, a value or a rig.json, replaces the nominal rig of the recordings. `null_reference` is
    a file, or a folder for it, that keeps the null reference for the next time.
    Raises RigError if the recordings do not fit together or allow no diagnosis.
    """
    sources = [recordings] if isinstance(recordings, Recording | str | Path) else list(recordings)
    source_by_identity = {_source_identity(source): source for source in sources}
    if len(source_by_identity) < len(sources):
        raise RigError("a recording is given twice; give each once")
    nominal = read_rig(Path(rig)) if isinstance(rig, str | Path) else rig
    records = {identity: _with_rig(source, nominal, rig) for identity, source in source_by_identity.items()}
    first_record = next(iter(records.values()))
    if not first_record.rig.in_space:
        check_plane(first_record.rig, "identify gap without annular contacts")
    reference_path = None if null_reference is None else Path(null_reference)
    if reference_path and reference_path.is_dir():
        reference_path /= f"{quote(first_record.rig.name, safe=' ')[:MAX_NAME_SIZE]}-{simulator}{NULL_REFERENCE_SUFFIX}"
    if reference_path:
        input_paths = [Path(source) for source in (*sources, validation, rig) if isinstance(source, str | Path)]
        check_target(reference_path, *input_paths, new_folder=True)
    with threadpool_limits(1):  # the matrices are small
        findings_by_record = [_findings_of(record, _tolerances(tolerances)) for record in records.values()]
        report, corrected_rig = (diagnose_in_space if first_record.rig.in_space else diagnose)(
            list(records.values()),
            None
            if validation is None
            else records.get(_source_identity(validation)) or _with_rig(validation, nominal, rig),
            simulator_named(simulator),
            reference_path,
            progress,
            _tolerances(tolerances),
            matters or Matters(),
            next_experiment,
        )
        remaining_findings = [
            _findings_with_corrected_rig(record_findings, record, corrected_rig, _tolerances(tolerances))
            for record_findings, record in zip(findings_by_record, records.values(), strict=True)
        ]
    all_sources = sources if validation is None else [*sources, validation]
    all_findings = [finding for record_findings in remaining_findings for finding in record_findings]
    # zeros: the force of a free decay
    unique_findings = dict.fromkeys(without_dead_force_channel_findings(all_findings, first_record.force_names))
    return GapResult(report, corrected_rig, _title(sources, first_record), tuple(unique_findings), _paths(all_sources))


def _findings_of(record: Recording, tolerances: Tolerances | None, use: MotionQuantity = "auto") -> tuple[Finding, ...]:
    """Findings of the check of a record, in both directions of a rig in space."""
    find = space_recording_findings if record.rig.in_space else check_recording
    return tuple(find(record, use, tolerances))


def _findings_with_corrected_rig(
    findings: Sequence[Finding], record: Recording, corrected_rig: Rig, tolerances: Tolerances | None
) -> Sequence[Finding]:
    """Findings of the check of a record that it also has with the corrected rig; all where that cannot be checked."""
    if not findings or to_json(corrected_rig) == to_json(record.rig):
        return findings
    try:
        corrected_findings = _findings_of(replace(record, rig=corrected_rig), tolerances)
    except RigError:
        return findings
    remaining_keys = {(finding.cause, finding.channels, finding.of) for finding in corrected_findings}
    return [finding for finding in findings if (finding.cause, finding.channels, finding.of) in remaining_keys]


def compare(
    sources: Sequence[str | Path],
    *,
    use: MotionQuantity = "auto",
    tolerances: Tolerances | str | None = None,
    progress: Progress = lambda _: None,
) -> HistoryResult:
    """Clearances, stiffnesses, dampings and modes over recordings of one machine, and whether they changed.

    The sources are recordings, or folders with a contact.json, in their order (`identify.history` says how they are
    compared). Raises RigError if fewer than two can be identified, or they are of different rigs.
    """
    paths = [Path(source) for source in sources]
    if len({path.resolve() for path in paths}) < len(paths):
        raise RigError("a recording is given twice; give each once")
    with threadpool_limits(1):
        history = history_of(list(observations(paths, use, _tolerances(tolerances), progress)))
    return HistoryResult(history)


def plan(
    source: Rig | Source,
    *,
    duration_s: float | None = None,
    force_rms_n: float | None = None,
    band_hz: tuple[float, float] | None = None,
    tolerances: Tolerances | str | None = None,
    simulator: str = "modal",
    most_changes: int = MAX_CHANGE_COUNT,
    workers: int = 1,
    base_rms_m_per_s2: float | None = None,
    progress: Progress = lambda _: None,
) -> PlanResult:
    """Plan of a test: expected intervals of every contact, and what would shorten them (`identify.planning` says how).

    The source is a rig, a rig.json, or a recording, which then gives duration, force and band, too. Several workers are
    processes: a script that asks for them needs `if __name__ == "__main__"`.
    Raises RigError if the rig or the values make no test.
    """
    rig_or_recording: Rig | Recording
    if isinstance(source, str | Path):
        rig_or_recording = read(Path(source)) if Path(source).suffix == ".mcap" else read_rig(Path(source))
    else:
        rig_or_recording = source
    rig = rig_or_recording if isinstance(rig_or_recording, Rig) else rig_or_recording.rig
    if not rig.in_space:
        check_plane(rig, "identify plan without annular contacts")
    test = planned_test(rig_or_recording, duration_s, force_rms_n, band_hz, _tolerances(tolerances), base_rms_m_per_s2)
    report = ranked_plan(test, simulator, most_changes, workers, progress)
    return PlanResult(report, test.rig, (Path(source),) if isinstance(source, str | Path) else ())


def _source_identity(source: Source) -> Path | int:
    """Identity of a recording: its path, or that of the object."""
    return id(source) if isinstance(source, Recording) else Path(source).resolve()


def _recording(source: Source) -> Recording:
    return source if isinstance(source, Recording) else read(Path(source))


def _with_rig(source: Source, rig: Rig | None, rig_source: Rig | str | Path | None) -> Recording:
    """Recording with another nominal rig if one is given; raises RigError if their channels differ."""
    recording = _recording(source)
    if rig is None:
        return recording
    groups = channel_groups(rig)
    expected_names_and_rates = {quantity: (c.names, c.sample_rate_hz) for quantity, c in groups.items()}
    if expected_names_and_rates != {
        quantity: (s.channels.names, s.channels.sample_rate_hz) for quantity, s in recording.signals.items()
    }:
        rig_name = rig_source if isinstance(rig_source, str | Path) else f"rig {rig.name!r}"
        file = "the recording" if isinstance(source, Recording) else source
        raise RigError(
            f"{rig_name}: its forces, sensors or their sampling rate are not those of {file}; give one with the same"
        )
    signals_by_quantity = {quantity: replace(s, channels=groups[quantity]) for quantity, s in recording.signals.items()}
    return replace(recording, rig=rig, signals=signals_by_quantity)


def _tolerances(tolerances: Tolerances | str | None) -> Tolerances | None:
    return tolerances_named(tolerances) if isinstance(tolerances, str) else tolerances


def _title(sources: Sequence[Source], first_record: Recording) -> str:
    file_names = ", ".join(Path(source).name for source in sources if not isinstance(source, Recording))
    return f"{first_record.rig.name}: {file_names}" if file_names else first_record.rig.name


def _paths(sources: Sequence[Source]) -> tuple[Path, ...]:
    return tuple(dict.fromkeys(Path(source) for source in sources if not isinstance(source, Recording)))
