"""Observations of a machine: recordings that are identified, or a contact.json that exists already."""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from identify.contacts.results import ContactReport
from identify.contacts.space_identification import identify_recording
from identify.history.changes import Observation
from identify.signals.kinematics import MotionQuantity
from rig.errors import RigError
from rig.files import contents, sha256_of
from rig.limits import decoded_result
from rig.model.tolerances import Tolerances
from rig.recording import read, recorded_at, recordings_in

REPORT_NAME = "contact.json"


def sources_in(folder: Path) -> list[Path]:
    """Recordings in a folder, or else its subfolders with a contact.json, sorted by name (2 before 10).

    Raises RigError if it is no folder, or holds neither.
    """
    if not folder.is_dir():
        raise RigError(f"{folder}: is no folder; give the one with the recordings")
    sources = recordings_in(folder) or [path.parent for path in folder.glob(f"*/{REPORT_NAME}")]
    if not sources:
        raise RigError(f"{folder}: holds no recordings (*.mcap) and no folders with a {REPORT_NAME}; give another")
    return sorted_by_name(sources)


def sorted_by_name(paths: Iterable[Path]) -> list[Path]:
    """Paths sorted by name, 2 before 10."""

    def words_and_numbers(path: Path) -> list[str | int]:
        return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path.name)]

    return sorted(paths, key=words_and_numbers)


def observations(
    sources: Sequence[Path],
    use: MotionQuantity = "auto",
    tolerances: Tolerances | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> Iterator[Observation]:
    """Yield the observation of each source; one that cannot be read or identified holds the reason."""
    for source_index, source in enumerate(sources):
        try:
            yield _observation_of(source, use, tolerances)
        except RigError as error:
            yield Observation(name=source.name, reason=str(error))
        progress((source_index + 1) / len(sources))


def _observation_of(source: Path, use: MotionQuantity, tolerances: Tolerances | None) -> Observation:
    """Observation of a recording, or of a contact.json or its folder; raises RigError if there is none."""
    if source.suffix == ".mcap":
        recording = read(source)
        report = identify_recording(recording, use=use, tolerances=tolerances).report
        recorded_time = recorded_at(recording.provenance)
        return Observation(name=source.name, recorded=recorded_time, report=report, sha256=sha256_of(source))
    report_path = source / REPORT_NAME if source.is_dir() else source
    return Observation(name=source.name, report=_read_report(report_path), sha256=sha256_of(report_path))


def _read_report(path: Path) -> ContactReport:
    return decoded_result(contents(path), ContactReport, str(path), REPORT_NAME, "identify the recording again")
