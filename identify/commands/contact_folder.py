"""`identify contact` of a folder: contacts.csv and .parquet, a row for each recording and contact."""

from pathlib import Path

import msgspec
from rich.table import Table

from identify.commands.contact_files import RESULT_FILE_NAMES, ContactSettings, identify_file
from identify.commands.many import RecordingTask, TableRows, answer_all, finish, recording_tasks, refused_row
from identify.contacts.results import ContactEstimate, ContactReport, Estimate
from identify.pages.wording import interval
from rig.commands.command_line import literal_console, print_sentence
from rig.errors import RigError

TABLE_NAME = "contacts"
UNIT_BY_QUANTITY = {"clearance": "m", "lower_clearance": "m", "upper_clearance": "m", "stiffness": "n_per_m"}
UNIT_BY_QUANTITY |= {"damping": "n_s_per_m"}
COLUMN_NAMES = (
    "recording",
    "rig",
    "contact",
    "verdict",
    *(f"{name}{error}_{unit}" for name, unit in UNIT_BY_QUANTITY.items() for error in ("", "_standard_error")),
    "law",
    "exponent",
    "exponent_standard_error",
    "reference_depth_m",
    "closed_share",
    "code",
    "reason",
    "findings",
)
"""Columns of the table. Verdicts: identified, not_to_be_relied_on (there are findings), not_told, refused, failed."""


def contact_folder(
    folder: Path, out: Path, settings: ContactSettings, dask: str | None, as_json: bool, force: bool
) -> None:
    """Identify every recording of a folder, each with its files in DIR/NAME, and write the table of all contacts."""
    tasks = recording_tasks(folder, out, settings, RESULT_FILE_NAMES, force)
    answers = answer_all(contact_rows, [tasks], out, settings, RESULT_FILE_NAMES[0], dask, force)
    if not as_json:
        _print_contacts(answers)
    finish(answers, COLUMN_NAMES, out, TABLE_NAME, as_json)


def contact_rows(task: RecordingTask) -> TableRows:
    """Rows of a recording, or one row with the reason for its refusal; its files are written."""
    settings = msgspec.json.decode(task.settings, type=ContactSettings)
    try:
        file_answer = identify_file(task.path, settings)
    except RigError as error:
        return refused_row(task.path, error)
    file_answer.save(task.folder)
    return TableRows(tuple(_rows_of_report(task.path.name, file_answer.report)))


def _rows_of_report(recording_name: str, report: ContactReport) -> list[dict[str, str | float | None]]:
    findings_text = " | ".join(finding.sentence for finding in report.findings)
    verdict = "not_to_be_relied_on" if findings_text else "identified"
    common: dict[str, str | float | None] = {"recording": recording_name, "rig": report.rig, "findings": findings_text}
    common |= {"law": "", "code": "", "reason": ""}
    contact_cells = [common | {"contact": c.name, "verdict": verdict} | _estimate_cells(c) for c in report.contacts]
    for unanswered in report.unanswered:
        reason_cells: dict[str, str | float | None] = {"code": unanswered.code or "", "reason": unanswered.reason}
        contact_cells.append(common | {"contact": unanswered.name, "verdict": "not_told"} | reason_cells)
    return contact_cells


def _estimate_cells(contact: ContactEstimate) -> dict[str, str | float | None]:
    cells: dict[str, str | float | None] = {
        "law": contact.law,
        "reference_depth_m": contact.reference_depth_m,
        "closed_share": contact.closed_share,
    }
    for quantity_name, unit in UNIT_BY_QUANTITY.items():
        estimate: Estimate | None = getattr(contact, f"{quantity_name}_{unit}")
        if estimate is not None:
            cells[f"{quantity_name}_{unit}"] = estimate.value
            cells[f"{quantity_name}_standard_error_{unit}"] = estimate.standard_error
    if contact.exponent is not None:
        cells["exponent"], cells["exponent_standard_error"] = contact.exponent.value, contact.exponent.standard_error
    return cells


def _print_contacts(answers: list[TableRows]) -> None:
    """Print the table of all contacts, then a line for each that is undetermined or refused."""
    contact_table = Table("recording", "contact", "clearance, mm", "stiffness, N/m", "", title="Contacts, ± 95 %")
    reason_lines = []
    for row in (row for answer in answers for row in answer.rows):
        interval_texts = _interval_text(row, "clearance", "m", 1e3), _interval_text(row, "stiffness", "n_per_m", 1.0)
        recording, contact, verdict = row["recording"], row.get("contact") or "", str(row["verdict"]).replace("_", " ")
        contact_table.add_row(str(recording), str(contact), *interval_texts, verdict * (verdict != "identified"))
        if row.get("reason"):
            reason_lines.append(f"{recording}{contact and f', {contact}'}: {verdict}: {row['reason']}")
    console = literal_console()
    console.print(contact_table)
    for reason in reason_lines:
        print_sentence(reason, console)


def _interval_text(row: dict[str, str | float | None], quantity_name: str, unit: str, unit_factor: float) -> str:
    value, standard_error = row.get(f"{quantity_name}_{unit}"), row.get(f"{quantity_name}_standard_error_{unit}")
    if not isinstance(value, float) or not isinstance(standard_error, float):
        return ""
    return interval(unit_factor * value, unit_factor * standard_error, "1")
