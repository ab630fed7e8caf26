"""How well contacts are identified on recordings of the blind check's independent simulator.

python -m tests.campaigns.blind_gap make --world wide --cases 30 --nulls-only --seed 7100 --out out/nulls
python -m tests.campaigns.blind_contacts --cases out/nulls --out out/contacts
"""

from importlib import import_module
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.table import Table

from identify.contacts.acceptance import estimated_contacts
from rig.commands.command_line import run
from rig.commands.tasks import Dask, run_tasks
from rig.model.tolerances import LABORATORY
from rig.recording import read
from scenarios.identification_campaign import QUANTITIES, EstimateErrors, draw, error_statistics, estimate_errors
from tests.campaigns.worlds.machine import Machine
from tests.campaigns.worlds.truth import Key

app = typer.Typer(pretty_exceptions_enable=False)


class Task(msgspec.Struct, frozen=True):
    """One recording, and the machine that it was made of."""

    recording: str
    true: Machine


@app.command()
def blind_contacts(
    cases: Annotated[Path, typer.Option(help="Folder of `blind_gap make`.")] = Path("out/nulls"),
    out: Annotated[Path, typer.Option(help="Folder for the results and the figure.")] = Path("out/contacts"),
    dask: Dask = None,
) -> None:
    """Identifies the contacts of every null case, with the tolerances of a laboratory."""
    key = msgspec.json.decode((cases / "sealed" / "key.json").read_bytes(), type=Key)
    tasks = [
        Task(str(cases / "recordings" / record.file), case.true)
        for case in key.cases
        if case.kind == "null"
        for record in case.records
    ]
    found = run_tasks(one_recording, tasks, EstimateErrors, out, dask)
    table = Table(title=f"Errors on {len(tasks)} recordings of world {key.world}, accelerometers alone")
    for heading in ("quantity", "median, %", "95th, %", "covered", "refused"):
        table.add_column(heading, justify="left" if heading == "quantity" else "right")
    for quantity in QUANTITIES:
        table.add_row(quantity, *error_statistics(found, quantity))
    draw(found, out / f"{key.world}.png", f"world {key.world}")
    Console().print(table)


def one_recording(task: Task) -> EstimateErrors:
    laws = [
        (
            contact.name,
            (contact.law.lower_m + contact.law.upper_m) / 2,
            (contact.law.stiffness_below_n_per_m + contact.law.stiffness_above_n_per_m) / 2,
            contact.law.damping_n_s_per_m,
        )
        for contact in task.true.contacts
    ]
    return estimate_errors(estimated_contacts(read(Path(task.recording)), "acceleration", LABORATORY), laws)


if __name__ == "__main__":  # under its own name, by which other processes find its tasks
    run(import_module("tests.campaigns.blind_contacts").app, "tests.campaigns.blind_contacts")
