"""How well and how surely contacts are identified: many random barrel-cradle rigs, accelerometers with noise only.

python -m scenarios.identification_campaign --out out/campaign
"""

import tempfile
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Annotated

import matplotlib as mpl
import msgspec
import numpy as np
import typer
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from identify.contacts.acceptance import Contacts, find_contacts
from identify.pages.wording import COVERED
from rig.commands.command_line import run
from rig.commands.tasks import Dask, run_tasks
from rig.model.contact_laws import DeadZone
from rig.model.description import Rig
from rig.model.tolerances import EXACT, LABORATORY
from rig.recording import Recording, Signals, channel_groups, read
from rig.simulation.plants import modal, plant_named
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle
from scenarios.jitter import jittered

QUANTITIES = ("clearance", "stiffness", "damping")
app = typer.Typer(pretty_exceptions_enable=False)


class Task(msgspec.Struct, frozen=True):
    """One random rig."""

    seed: int
    plant: str
    jitter: bool
    duration_s: float


class FoundContact(msgspec.Struct, frozen=True):
    """True value, estimate and standard error of every quantity of one rig, or why there is none."""

    names: list[str]
    true: list[float]
    found: list[float]
    errors: list[float]
    unanswered: list[str]


class RigOutcome(msgspec.Struct, frozen=True):
    """What was found from six and from four stations a beam."""

    task: Task
    rms_n: float
    six: FoundContact
    four: FoundContact


@app.command()
def campaign(
    out: Annotated[Path, typer.Option(help="Folder for the results and figures.")] = Path("out/campaign"),
    rigs: Annotated[int, typer.Option(help="How many random rigs.")] = 40,
    seed: Annotated[int, typer.Option(help="Of the first rig; the others follow.")] = 1000,
    duration: Annotated[float, typer.Option(help="Length of each record, s.")] = 60.0,
    ancf_every: Annotated[int, typer.Option(help="Every how manyth rig is simulated with Exudyn; 0 for none.")] = 4,
    dask: Dask = None,
) -> None:
    """Records and identifies the rigs exactly as described, with jitter, and with four stations a beam."""
    tasks = [
        Task(seed + i, "ancf" if ancf_every and i % ancf_every == 0 else "modal", jitter, duration)
        for i in range(rigs)
        for jitter in (False, True)
    ]
    outcomes = run_tasks(one_rig, tasks, RigOutcome, out, dask)
    table = Table(title=f"Errors of {rigs} rigs; six or four stations a beam, accelerometers only")
    for heading in ("", "quantity", "median, %", "95th, %", "covered", "refused"):
        table.add_column(heading, justify="left" if heading in ("", "quantity") else "right")
    everything: list[FoundContact] = []
    for stations in ("six", "four"):
        for jitter in (False, True):
            kind = f"{stations}{', jitter' if jitter else ''}"
            chosen: list[FoundContact] = [getattr(o, stations) for o in outcomes if o.task.jitter == jitter]
            everything += chosen
            for quantity in QUANTITIES:
                table.add_row(kind, quantity, *figures_of(chosen, quantity))
            draw(chosen, out / f"{kind.replace(' ', '_').replace(',', '')}.png", kind)
    for plant in ("modal", "ancf"):
        chosen = [f for o in outcomes if o.task.plant == plant for f in (o.six, o.four)]
        if chosen:
            table.add_row(f"plant {plant}", "", "", "", _coverage(chosen), "")
    table.add_row("all", "", "", "", _coverage(everything), "")
    Console().print(table)


def one_rig(task: Task) -> RigOutcome:
    """Draws a rig, records it with the sensors of six and of four stations a beam, and identifies it from either."""
    rng = np.random.default_rng(task.seed)
    rms_n = float(rng.uniform(10, 40))
    settings = BarrelCradle(
        sensors="acceleration",
        noise_density=1e-3,
        rms_n=rms_n,
        duration_s=task.duration_s,
        step_s=2.0**-14 if task.plant == "ancf" else 2.0**-16,
        seed=task.seed,
    )
    six = settings.rig()
    four = msgspec.structs.replace(settings, stations=4).rig()
    both = msgspec.structs.replace(six, sensors=tuple(dict.fromkeys(six.sensors + four.sensors)))
    actual = _with_random_contacts(both, rng)
    if task.jitter:
        actual = jittered(actual, rng)
    # Exudyn's beams turn and its step is finite: to the identification's linear theory they are a laboratory's
    tolerances = EXACT if task.plant == "modal" and not task.jitter else LABORATORY
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.mcap"
        record(
            both,
            settings.force(),
            plant=plant_named("ancf") if task.plant == "ancf" else partial(modal.simulate, modes_per_beam=40),
            duration_s=settings.duration_s,
            step_s=settings.step_s,
            path=path,
            progress=lambda _: None,
            actual=actual,
        )
        recording = read(path)
    laws = [(c.name, c.law.clearance_m, c.law.stiffness_n_per_m, c.law.damping_n_s_per_m) for c in actual.contacts]
    found = [found_in(find_contacts(_seen_by(recording, rig), "acceleration", tolerances), laws) for rig in (six, four)]
    return RigOutcome(task, rms_n, *found)


def _seen_by(recording: Recording, rig: Rig) -> Recording:
    """The recording as the accelerometers of this rig alone would have made it."""
    signals = recording.signals["acceleration"]
    rows = [signals.channels.names.index(s.name) for s in rig.sensors]
    channels = channel_groups(rig)["acceleration"]
    seen = Signals(channels, signals.start_s, signals.values[rows])
    return Recording(rig, {**recording.signals, "acceleration": seen}, recording.provenance)


def found_in(contacts: Contacts, laws: Sequence[tuple[str, float, float, float]]) -> FoundContact:
    """Against the laws that are true: name, clearance (m), stiffness (N/m) and damping (N s/m) of each contact."""
    names, true, found, errors, refused = [], [], [], [], []
    for name, clearance, stiffness, damping in laws:
        if name in contacts.outcomes.refusals:
            refused.append(f"{name}: {contacts.outcomes.refusals[name].sentence}")
            continue
        answer = contacts.outcomes.estimates[name]
        _, _, of_stiffness, of_damping = answer.errors
        for quantity, value, estimate, error in (
            ("clearance", clearance, answer.clearance_m, answer.clearance_error_m),
            ("stiffness", stiffness, answer.stiffness_n_per_m, of_stiffness),
            ("damping", damping, answer.values[-1], of_damping),
        ):
            names.append(f"{name} {quantity}")
            true.append(value)
            found.append(float(estimate))
            errors.append(float(error))
    return FoundContact(names, true, found, errors, refused)


def _with_random_contacts(rig: Rig, rng: np.random.Generator) -> Rig:
    """Clearances of 3 to 7 mm each side, 5e4 to 3e5 N/m, 0 to 50 N s/m, different at every contact."""
    contacts = tuple(
        msgspec.structs.replace(
            contact,
            law=DeadZone(
                lower_clearance_m=float(rng.uniform(3e-3, 7e-3)),
                upper_clearance_m=float(rng.uniform(3e-3, 7e-3)),
                stiffness_n_per_m=float(rng.uniform(5e4, 3e5)),
                damping_n_s_per_m=float(rng.uniform(0, 50)),
            ),
        )
        for contact in rig.contacts
    )
    return msgspec.structs.replace(rig, contacts=contacts)


def _errors(found: list[FoundContact], quantity: str) -> tuple[np.ndarray, np.ndarray]:
    """Relative errors in per cent (of damping: in N s/m) and errors in standard errors."""
    rows = [
        (true, estimate, error)
        for one in found
        for name, true, estimate, error in zip(one.names, one.true, one.found, one.errors, strict=True)
        if name.endswith(quantity)
    ]
    true, estimate, error = np.array(rows).reshape(-1, 3).T
    off = estimate - true
    return (off if quantity == "damping" else 100 * off / true), off / error


def _coverage(found: list[FoundContact]) -> str:
    sigmas = np.concatenate([_errors(found, quantity)[1] for quantity in QUANTITIES])
    return f"{100 * np.mean(np.abs(sigmas) < COVERED):.1f} % of {sigmas.size}"


def figures_of(found: list[FoundContact], quantity: str) -> tuple[str, ...]:
    off, sigmas = _errors(found, quantity)
    unit = " N s/m" if quantity == "damping" else ""
    refused = sum(len(one.unanswered) for one in found)
    return (
        f"{np.median(np.abs(off)):.3f}{unit}",
        f"{np.quantile(np.abs(off), 0.95):.3f}{unit}",
        f"{100 * np.mean(np.abs(sigmas) < COVERED):.0f} %",
        str(refused),
    )


def draw(found: list[FoundContact], path: Path, kind: str) -> None:
    """Errors of every contact with their 95 % intervals, and how they compare with the intervals."""
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(8, 6), layout="constrained")
        axes = figure.subplots(2, 2, width_ratios=(2, 1))
        for row, quantity in zip(axes, ("clearance", "stiffness"), strict=True):
            off, sigmas = _errors(found, quantity)
            row[0].errorbar(
                np.arange(off.size), off, COVERED * np.abs(off / sigmas), fmt=".", color="#1f5fa8", elinewidth=0.8
            )
            row[0].axhline(0, color="k", lw=0.8)
            row[0].set(xlabel="contact", ylabel=f"error of the {quantity}, %")
            ordered = np.sort(np.abs(sigmas))
            expected = np.linspace(0, 5, 100)
            row[1].plot(ordered, np.linspace(0, 1, ordered.size), color="#1f5fa8", label="found")
            row[1].plot(
                expected,
                [np.mean(np.abs(np.random.default_rng(1).standard_normal(20000)) < e) for e in expected],
                "k:",
                label="Gaussian",
            )
            row[1].set(xlim=(0, 5), xlabel="|error| / standard error", ylabel="share of the contacts")
            row[1].legend(frameon=False)
        figure.suptitle(f"{kind}: errors with 95 % intervals")
        figure.savefig(path, dpi=130)


if __name__ == "__main__":  # under its own name, by which other processes find its tasks
    run(import_module("scenarios.identification_campaign").app, "scenarios.identification_campaign")
