"""`identify gap` of a folder: gaps.csv and .parquet, a row for each recording, which is diagnosed by itself."""

import hashlib
from pathlib import Path

import msgspec
from rich.table import Table

from identify.api import gap as diagnose
from identify.commands.many import RecordingTask, TableRows, answer_all, finish, recording_tasks, refused_row
from identify.gaps.decision.null_reference import NULL_REFERENCE_SUFFIX
from identify.gaps.page.report import curves
from identify.gaps.results import Gap, Matters
from identify.pages.tables import save_tables
from identify.pages.wording import COVERED, percent
from identify.results import GapResult
from rig.commands.command_line import literal_console, print_sentence, progress_spinner
from rig.errors import RigError
from rig.files import make_folder
from rig.model.description import from_json, to_json
from rig.model.tolerances import Tolerances
from rig.recording.segments import segments

TABLE_NAME, REFERENCE_FOLDER = "gaps", "null_references"
RESULT_FILE_NAMES = ("gap.json", "gap.html", "rig.json")
COLUMN_NAMES = (
    "recording",
    "rig",
    "verdict",
    "sentence",
    "named",
    "effects",
    "places",
    "probability",
    "inclusion_probabilities",
    "probability_nothing",
    "probability_unknown",
    "p_value",
    "p_value_after",
    "unexplained_share",
    "unexplained_share_after",
    "explained",
    "code",
    "reason",
    "findings",
)
"""Columns of every table; behind them stand the parameters of the likeliest causes, EFFECT.FIELD, and half the widths
of their 95 % intervals, EFFECT.FIELD_within_95."""
FIRST_SEGMENT_S = 1.0
"""Length of the segment from which a recording's rig is read."""


class GapSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Settings of `identify gap`, as its options have them; rig is the text of the rig.json that is believed."""

    simulator: str
    tolerances: Tolerances | None
    matters: Matters
    next_experiment: bool
    rig: str | None
    null_reference: str | None
    export: str | None


def gap_folder(folder: Path, out: Path, settings: GapSettings, dask: str | None, as_json: bool, force: bool) -> None:
    """Diagnose every recording of a folder, each with its files in DIR/NAME, and write the table of all.

    Recordings of one rig.json share a file of null references: the first of each rig makes it, then the others follow.
    """
    first_tasks: dict[str, RecordingTask] = {}
    tasks = []
    with progress_spinner(f"reading {folder}"):
        for task in recording_tasks(folder, out, settings, RESULT_FILE_NAMES, force):
            reference_file = settings.null_reference or str(_null_reference_path(out, task.path, settings.rig))
            tasks.append(msgspec.structs.replace(task, shared=reference_file))
            first_tasks.setdefault(reference_file, tasks[-1])
    make_folder(out / REFERENCE_FOLDER)
    stages = [list(first_tasks.values()), [task for task in tasks if task not in first_tasks.values()]]
    answers = answer_all(diagnose_recording_rows, stages, out, settings, RESULT_FILE_NAMES[0], dask, force)
    position_by_name = {task.path.name: position for position, task in enumerate(tasks)}
    answers.sort(key=lambda answer: position_by_name[str(answer.rows[0]["recording"])])
    if not as_json:
        _print_diagnoses(answers)
    parameter_columns = sorted({name for answer in answers for row in answer.rows for name in row} - set(COLUMN_NAMES))
    finish(answers, (*COLUMN_NAMES, *parameter_columns), out, TABLE_NAME, as_json)


def diagnose_recording_rows(task: RecordingTask) -> TableRows:
    """Row of a recording, or of the reason for its refusal; its files are written."""
    settings = msgspec.json.decode(task.settings, type=GapSettings)
    try:
        gap_result = diagnose(
            task.path,
            simulator=settings.simulator,
            null_reference=task.shared,
            tolerances=settings.tolerances,
            matters=settings.matters,
            next_experiment=settings.next_experiment,
            rig=None if settings.rig is None else from_json(settings.rig.encode(), "--rig"),
        )
    except RigError as error:
        return refused_row(task.path, error)
    gap_result.save(task.folder)
    if settings.export is not None:
        save_tables(curves(gap_result.report), task.folder, settings.export)
    return TableRows((_diagnosis_row(task.path.name, gap_result),))


def _diagnosis_row(recording_name: str, gap_result: GapResult) -> dict[str, str | float | None]:
    gap_report = gap_result.report
    row: dict[str, str | float | None] = {
        "recording": recording_name,
        "rig": gap_result.corrected.name,
        "verdict": gap_report.verdict,
        "sentence": gap_report.sentence,
        "named": " | ".join(gap_report.criteria.named),
        "effects": "",
        "places": "",
        "inclusion_probabilities": "",
        "probability_nothing": gap_report.probability_nothing,
        "probability_unknown": gap_report.probability_unknown,
        "p_value": gap_report.evidence.p_value,
        "p_value_after": gap_report.evidence.p_value_after,
        "unexplained_share": gap_report.before.share,
        "unexplained_share_after": gap_report.after.share,
        "code": "",
        "reason": "",
        "findings": " | ".join(finding.sentence for finding in gap_result.findings),
    }
    return row | _cause_cells(gap_report)


def _cause_cells(gap_report: Gap) -> dict[str, str | float | None]:
    """Cells of the likeliest cause; of the named effects if there are any."""
    if not gap_report.causes:
        return {}
    cause = gap_report.causes[0]
    cells: dict[str, str | float | None] = {
        "effects": " | ".join(cause.labels),
        "places": " | ".join(f"{field}={place}" for field, place in cause.places.items()),
        "probability": cause.probability,
        "inclusion_probabilities": " | ".join(f"{strength.inclusion_probability:.6g}" for strength in cause.strengths),
        "explained": cause.explained,
    }
    for parameter_name, estimate in cause.parameters.items():
        cells[parameter_name], cells[f"{parameter_name}_within_95"] = estimate.value, COVERED * estimate.standard_error
    return cells


def _null_reference_path(out: Path, recording: Path, rig_text: str | None) -> Path:
    """File of the null references of a recording's rig, named after the rig's description."""
    try:
        rig_json = rig_text.encode() if rig_text else to_json(next(iter(segments(recording, FIRST_SEGMENT_S, 0.0))).rig)
    except RigError:
        rig_json = b""  # its own task says what is wrong
    return (out / REFERENCE_FOLDER / f"{hashlib.sha256(rig_json).hexdigest()[:16]}{NULL_REFERENCE_SUFFIX}").absolute()


def _print_diagnoses(answers: list[TableRows]) -> None:
    """Print the table of verdicts and likeliest causes, then the sentences."""
    diagnosis_table = Table("recording", "verdict", "likeliest cause", "probability", title="Diagnoses")
    sentences = []
    for row in (row for answer in answers for row in answer.rows):
        probability = row.get("probability")
        diagnosis_table.add_row(
            str(row["recording"]),
            str(row["verdict"]).replace("_", " "),
            str(row.get("effects", "")),
            percent(probability) if isinstance(probability, float) else "",
        )
        sentences.append(f"{row['recording']}: {row.get('sentence') or row['reason']}")
    console = literal_console()
    console.print(diagnosis_table)
    for sentence in sentences:
        print_sentence(sentence, console)
