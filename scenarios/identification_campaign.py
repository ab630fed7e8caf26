"""Errors and coverage of the identification: many random barrel-cradle rigs, noisy accelerometers alone.

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
from scipy.special import erf

from identify.contacts.acceptance import AcceptedContacts, estimated_contacts
from identify.pages.wording import COVERED
from rig.commands.command_line import console_table, run
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
    """Random rig: its seed, plant and length of record, and whether it is built with jitter."""

    seed: int
    plant: str
    jitter: bool
    duration_s: float


class EstimateErrors(msgspec.Struct, frozen=True):
    """True value, estimate and standard error of every quantity of one rig, or why there is none."""

    names: list[str]
    true_values: list[float]
    estimates: list[float]
    standard_errors: list[float]
    refusals: list[str]


class RigOutcome(msgspec.Struct, frozen=True):
    """Estimates of a random rig from six and from four stations a beam."""

    task: Task
    rms_n: float
    six_stations: EstimateErrors
    four_stations: EstimateErrors


@app.command()
def campaign(
    out: Annotated[Path, typer.Option(help="Folder for the results and figures.")] = Path("out/campaign"),
    rigs: Annotated[int, typer.Option(help="How many random rigs.")] = 40,
    seed: Annotated[int, typer.Option(help="Of the first rig; the others follow.")] = 1000,
    duration: Annotated[float, typer.Option(help="Length of each record, s.")] = 60.0,
    ancf_every: Annotated[int, typer.Option(help="Every how manyth rig is simulated with Exudyn; 0 for none.")] = 4,
    dask: Dask = None,
) -> None:
    """Record and identify the rigs exactly as described, with jitter, and with four stations a beam."""
    tasks = [
        Task(seed + i, "ancf" if ancf_every and i % ancf_every == 0 else "modal", jitter, duration)
        for i in range(rigs)
        for jitter in (False, True)
    ]
    outcomes = run_tasks(identify_random_rig, tasks, RigOutcome, out, dask)
    headings = ("", "quantity", "median, %", "95th, %", "covered", "refused")
    table = console_table(f"Errors of {rigs} rigs; six or four stations a beam, accelerometers only", headings, 2)
    all_errors: list[EstimateErrors] = []
    for stations in ("six", "four"):
        for jitter in (False, True):
            case = f"{stations}{', jitter' if jitter else ''}"
            errors: list[EstimateErrors] = [
                getattr(outcome, f"{stations}_stations") for outcome in outcomes if outcome.task.jitter == jitter
            ]
            all_errors += errors
            for quantity in QUANTITIES:
                table.add_row(case, quantity, *error_statistics(errors, quantity))
            draw(errors, out / f"{case.replace(' ', '_').replace(',', '')}.png", case)
    for plant in ("modal", "ancf"):
        errors = [f for o in outcomes if o.task.plant == plant for f in (o.six_stations, o.four_stations)]
        if errors:
            table.add_row(f"plant {plant}", "", "", "", _coverage(errors), "")
    table.add_row("all", "", "", "", _coverage(all_errors), "")
    Console().print(table)


def identify_random_rig(task: Task) -> RigOutcome:
    """Draw a rig, record it with the sensors of six and of four stations a beam, and identify it from either."""
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
    six_stations = settings.rig()
    four_stations = msgspec.structs.replace(settings, stations=4).rig()
    sensors = dict.fromkeys(six_stations.sensors + four_stations.sensors)
    all_stations = msgspec.structs.replace(six_stations, sensors=tuple(sensors))
    actual = _with_random_contacts(all_stations, rng)
    if task.jitter:
        actual = jittered(actual, rng)
    # Exudyn's beams turn and its step is finite: to the identification's linear theory they are a laboratory's
    tolerances = EXACT if task.plant == "modal" and not task.jitter else LABORATORY
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.mcap"
        record(
            all_stations,
            settings.force(),
            plant=plant_named("ancf") if task.plant == "ancf" else partial(modal.simulate, modes_per_beam=40),
            duration_s=settings.duration_s,
            step_s=settings.step_s,
            path=path,
            progress=lambda _: None,
            actual=actual,
        )
        recording = read(path)
    true_laws = [(c.name, c.law.clearance_m, c.law.stiffness_n_per_m, c.law.damping_n_s_per_m) for c in actual.contacts]
    recordings = (_with_sensors_of(recording, rig) for rig in (six_stations, four_stations))
    contacts = (estimated_contacts(r, "acceleration", tolerances) for r in recordings)
    return RigOutcome(task, rms_n, *(estimate_errors(contact, true_laws) for contact in contacts))


def _with_sensors_of(recording: Recording, rig: Rig) -> Recording:
    """Recording with the accelerometers of this rig alone."""
    signals = recording.signals["acceleration"]
    channel_rows = [signals.channels.names.index(sensor.name) for sensor in rig.sensors]
    channels = channel_groups(rig)["acceleration"]
    accelerations = Signals(channels, signals.start_s, signals.values[channel_rows])
    return Recording(rig, {**recording.signals, "acceleration": accelerations}, recording.provenance)


def estimate_errors(contacts: AcceptedContacts, true_laws: Sequence[tuple[str, float, float, float]]) -> EstimateErrors:
    """Estimates beside true laws: name, clearance (m), stiffness (N/m) and damping (N s/m) of each contact."""
    names, true_values, estimates, standard_errors, refusals = [], [], [], [], []
    for contact, clearance_m, stiffness_n_per_m, damping_n_s_per_m in true_laws:
        if contact in contacts.outcomes.refusals:
            refusals.append(f"{contact}: {contacts.outcomes.refusals[contact].sentence}")
            continue
        law = contacts.outcomes.estimates[contact]
        _, _, stiffness_error, damping_error = law.errors
        for quantity, true_value, estimate, standard_error in (
            ("clearance", clearance_m, law.clearance_m, law.clearance_error_m),
            ("stiffness", stiffness_n_per_m, law.stiffness_n_per_m, stiffness_error),
            ("damping", damping_n_s_per_m, law.values[-1], damping_error),
        ):
            names.append(f"{contact} {quantity}")
            true_values.append(true_value)
            estimates.append(float(estimate))
            standard_errors.append(float(standard_error))
    return EstimateErrors(names, true_values, estimates, standard_errors, refusals)


def _with_random_contacts(rig: Rig, rng: np.random.Generator) -> Rig:
    """Rig with random contacts: clearances of 3 to 7 mm each side, 5e4 to 3e5 N/m, 0 to 50 N s/m."""
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


def _relative_errors(rigs: list[EstimateErrors], quantity: str) -> tuple[np.ndarray, np.ndarray]:
    """Errors in per cent (of damping: in N s/m), and errors in standard errors."""
    value_rows = [
        row
        for rig in rigs
        for name, *row in zip(rig.names, rig.true_values, rig.estimates, rig.standard_errors, strict=True)
        if name.endswith(quantity)
    ]
    true_values, estimates, standard_errors = np.array(value_rows).reshape(-1, 3).T
    differences = estimates - true_values
    return (differences if quantity == "damping" else 100 * differences / true_values), differences / standard_errors


def _coverage(rigs: list[EstimateErrors]) -> str:
    """Share of the 95 % intervals that hold the true value, and their number."""
    normalised_errors = np.concatenate([_relative_errors(rigs, quantity)[1] for quantity in QUANTITIES])
    return f"{100 * np.mean(np.abs(normalised_errors) < COVERED):.1f} % of {normalised_errors.size}"


def error_statistics(rigs: list[EstimateErrors], quantity: str) -> tuple[str, ...]:
    """Cells of a table: median and 95th percentile of the errors, coverage of the intervals, refusals."""
    errors, normalised_errors = _relative_errors(rigs, quantity)
    unit = " N s/m" if quantity == "damping" else ""
    refusal_count = sum(len(rig.refusals) for rig in rigs)
    return (
        f"{np.median(np.abs(errors)):.3f}{unit}",
        f"{np.quantile(np.abs(errors), 0.95):.3f}{unit}",
        f"{100 * np.mean(np.abs(normalised_errors) < COVERED):.0f} %",
        str(refusal_count),
    )


def draw(rigs: list[EstimateErrors], path: Path, case: str) -> None:
    """Draw the errors of every contact with 95 % intervals, and their distribution in standard errors."""
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(8, 6), layout="constrained")
        panel_rows = figure.subplots(2, 2, width_ratios=(2, 1))
        for panels, quantity in zip(panel_rows, ("clearance", "stiffness"), strict=True):
            errors, normalised_errors = _relative_errors(rigs, quantity)
            half_widths = COVERED * np.abs(errors / normalised_errors)
            panels[0].errorbar(np.arange(errors.size), errors, half_widths, fmt=".", color="#1f5fa8", elinewidth=0.8)
            panels[0].axhline(0, color="k", lw=0.8)
            panels[0].set(xlabel="contact", ylabel=f"error of the {quantity}, %")
            sorted_sizes = np.sort(np.abs(normalised_errors))
            size_limits = np.linspace(0, 5, 100)
            panels[1].plot(sorted_sizes, np.linspace(0, 1, sorted_sizes.size), color="#1f5fa8", label="identified")
            panels[1].plot(size_limits, erf(size_limits / np.sqrt(2)), "k:", label="Gaussian")
            panels[1].set(xlim=(0, 5), xlabel="|error| / standard error", ylabel="share of the contacts")
            panels[1].legend(frameon=False)
        figure.suptitle(f"{case}: errors with 95 % intervals")
        figure.savefig(path, dpi=130)


if __name__ == "__main__":  # under its own name, by which other processes find its tasks
    run(import_module("scenarios.identification_campaign").app, "scenarios.identification_campaign")
