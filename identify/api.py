"""The public functions of `identify`; the commands are a skin over them."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

from threadpoolctl import threadpool_limits

from identify.checks import check_recording
from identify.contacts import identify_contact
from identify.contacts.acceptance import without_dead_force
from identify.gaps.decision.answer import diagnose
from identify.gaps.decision.null_reference import NULL_REFERENCE_SUFFIX
from identify.gaps.decision.prepare import simulator_named
from identify.gaps.results import Matters
from identify.history import history_of
from identify.history.observed import observations
from identify.laws import identify_law
from identify.results import CheckResult, ContactResult, GapResult, HistoryResult, LawResult
from identify.signals.kinematics import Use
from identify.signals.spectra import Averaging
from rig.errors import RigError
from rig.files import check_target
from rig.model.description import Rig, read_rig
from rig.model.tolerances import Tolerances, tolerances_named
from rig.recording import Recording, channel_groups, read

Source = Recording | str | Path
LONGEST_NAME = 100
Progress = Callable[[float], None]


def check(recording: Source, *, use: Use = "auto", tolerances: Tolerances | str | None = None) -> CheckResult:
    """Check whether the channels fit each other, the force and rig.json (as `identify.checks.check_recording`).

    Raises RigError if the recording cannot be read.
    """
    given = _recording(recording)
    with threadpool_limits(1):
        findings = check_recording(given, use, _believed(tolerances))
    return CheckResult(findings, _title([recording], given))


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
    """Diagnose where the nominal rig differs from reality, which effects cause it, how far the mismatch shrinks.

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
    """Identity by which a recording is known again."""
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
