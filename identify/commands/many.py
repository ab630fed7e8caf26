"""Folder of recordings: each is a task of its own, the results of former runs are kept, one table holds all of them."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
import typer

from identify.commands.options import print_json
from identify.contacts.refusals import ContactRefusedError
from identify.history.observations import sorted_by_name
from identify.pages.tables import Row, save_rows
from rig.commands.command_line import refuse_existing, say
from rig.commands.tasks import outcomes_of_tasks, task_result_path
from rig.errors import RigError, one_line
from rig.files import contents, make_folder, sha256_of, write_json
from rig.recording import recordings_in

SETTINGS_NAME, KEPT_TASKS_FOLDER = "settings.json", "tasks"
REFUSED, FAILED = "refused", "failed"
"""Verdicts on a recording without a result: it does not allow one; something else went wrong, and is tried again."""
TEXT_COLUMNS = frozenset(
    {
        "recording",
        "rig",
        "contact",
        "verdict",
        "law",
        "sentence",
        "named",
        "effects",
        "places",
        "inclusion_probabilities",
        "code",
        "reason",
        "findings",
    }
)
"""Columns of text, empty where there is none."""


class RecordingTask(msgspec.Struct, frozen=True):
    """Recording to be answered, its content, and the folder of its files; `settings` are the command's, as JSON.

    shared is a file that tasks use together and one of them makes; empty where there is none.
    """

    file: str
    sha256: str
    out: str
    settings: msgspec.Raw
    shared: str = ""

    @property
    def path(self) -> Path:
        return Path(self.file)

    @property
    def folder(self) -> Path:
        return Path(self.out)


class TableRows(msgspec.Struct, frozen=True):
    """Rows of a recording in the table, and the verdict on the recording."""

    rows: tuple[dict[str, str | float | None], ...]
    is_refused: bool = False


def refused_row(path: Path, error: BaseException, verdict: str = REFUSED) -> TableRows:
    """Row of a recording without a result, with the reason and, where a contact was refused, its code."""
    code = error.refusal.code if isinstance(error, ContactRefusedError) else ""
    reason = one_line(str(error) if isinstance(error, RigError) else f"{type(error).__name__}: {error}")
    row: dict[str, str | float | None] = {"recording": path.name, "verdict": verdict, "code": code, "reason": reason}
    return TableRows((row,), is_refused=True)


def check_folder_options(folder: Path, out: Path | None, **single_file_options: object) -> Path:
    """Folder of the results; raises RigError without one, and for options that a single recording alone takes."""
    for option_name, option_value in single_file_options.items():
        if option_value:
            raise RigError(
                f"--{option_name.replace('_', '-')} is for recordings given by name; leave it out for a folder"
            )
    if out is None:
        raise RigError(f"{folder}: is a folder of recordings; give --out DIR for their results")
    return out


def recording_tasks(
    folder: Path, out: Path, settings: msgspec.Struct, result_names: Sequence[str], force: bool
) -> list[RecordingTask]:
    """Task of every recording in a folder, by name, after a check that nothing else would be overwritten.

    A folder of results goes on with the settings that it began with, which it keeps in SETTINGS_NAME; with `force` it
    begins anew. Raises RigError if there are no recordings, or the folder holds results by other settings.
    """
    recording_paths = sorted_by_name(recordings_in(folder))
    if not recording_paths:
        raise RigError(f"{folder}: holds no recordings (*.mcap); give another folder")
    settings_json, settings_path = msgspec.json.encode(settings), out / SETTINGS_NAME
    is_continued = settings_path.exists() and not force
    if is_continued and not _is_same_json(contents(settings_path), settings_json):
        raise RigError(
            f"{settings_path}: {out} holds results by other settings; give another folder, or --force to begin anew"
        )
    tasks = [
        RecordingTask(
            str(recording_path.absolute()),
            _sha256(recording_path),
            str((out / recording_path.stem).absolute()),
            msgspec.Raw(settings_json),
        )
        for recording_path in recording_paths
    ]
    for task in tasks if not is_continued else ():
        for result_name in result_names:
            refuse_existing(task.folder / result_name, force, task.path, new_folder=True)
    return tasks


def answer_all(
    answer_function: Callable[[RecordingTask], TableRows],
    stages: Sequence[Sequence[RecordingTask]],
    out: Path,
    settings: msgspec.Struct,
    last_file_name: str,
    dask: str | None,
    force: bool,
) -> list[TableRows]:
    """Rows of every task, stage after stage, those of former runs included where their files are still there.

    `last_file_name` is the file of a recording's folder that is written last.
    """
    make_folder(out)
    write_json(settings, out / SETTINGS_NAME)
    answers: list[TableRows] = []
    for tasks in stages:
        for task in tasks:
            answer_path = task_result_path(answer_function, task, out / KEPT_TASKS_FOLDER)
            if answer_path.exists() and (force or not _is_answer_kept(answer_path, task.folder / last_file_name)):
                answer_path.unlink()
            if not answer_path.exists():
                # of a run that was cut short, or of other samples
                (task.folder / last_file_name).unlink(missing_ok=True)
        outcomes = outcomes_of_tasks(answer_function, tasks, TableRows, out / KEPT_TASKS_FOLDER, dask)
        answers += [
            refused_row(task.path, outcome, FAILED) if isinstance(outcome, BaseException) else outcome
            for task, outcome in zip(tasks, outcomes, strict=True)
        ]
    return answers


def finish(
    answers: Sequence[TableRows], column_names: Sequence[str], out: Path, table_name: str, as_json: bool
) -> None:
    """Write the table and print where it is, or print its rows as JSON; exit with 1 if recordings were refused."""
    table_rows: list[Row] = [
        {column_name: row.get(column_name, "" if column_name in TEXT_COLUMNS else None) for column_name in column_names}
        for answer in answers
        for row in answer.rows
    ]
    parquet_note = save_rows(table_rows, column_names, out, table_name)
    refused_count = sum(answer.is_refused for answer in answers)
    if as_json:
        print_json(table_rows)
    else:
        say(
            f"{out / table_name}.csv{'' if parquet_note else ' and .parquet'}: {len(table_rows)} rows of "
            f"{len(answers)} recordings"
        )
        if parquet_note:
            say(f"note: {parquet_note}")
    if refused_count:
        print(
            f"identify: {refused_count} of {len(answers)} recordings were refused; {out / table_name}.csv says why",
            file=sys.stderr,
        )
        raise typer.Exit(1)


def _is_same_json(json_text: bytes, other_json_text: bytes) -> bool:
    try:
        return bool(msgspec.json.decode(json_text) == msgspec.json.decode(other_json_text))
    except msgspec.DecodeError:
        return False


def _is_answer_kept(answer_path: Path, result_path: Path) -> bool:
    """True if the kept answer can be read and the files that belong to it are there."""
    try:
        return msgspec.json.decode(answer_path.read_bytes(), type=TableRows).is_refused or result_path.exists()
    except msgspec.DecodeError:
        return False


def _sha256(path: Path) -> str:
    """SHA-256 of a file; empty where it cannot be read, which its task then says."""
    try:
        return sha256_of(path)
    except OSError:
        return ""
