"""Do the two plants agree? The same force through both: trajectories while contact is young, statistics of a minute.

python -m tests.campaigns.engines --seeds 4
"""

from dataclasses import astuple, dataclass
from functools import partial
from typing import Annotated

import msgspec
import numpy as np
import typer
from jaxtyping import Float
from rich.console import Console
from rich.table import Table

from rig.commands.command_line import progress_bar, run
from rig.model.description import Station
from rig.simulation.excitation import QUIET_S, force_history
from rig.simulation.motion import Forces, Motion, Plant, concatenated
from rig.simulation.plants import ancf, modal
from rig.simulation.reference import BarrelCradle
from rig.simulation.sensors import digitise

SMALL = 0.01
"""Of the reference's clearance and force: with slopes so small the beams of both plants are linear."""
YOUNG_S = 0.15
"""After the first contact; the motion is chaotic, and two exact solvers part within some 0.3 s."""
MODE_COUNTS = (8, 12, 16, 24)
CHANCE_SEEDS = 10

app = typer.Typer(pretty_exceptions_enable=False)


@dataclass(frozen=True)
class Statistics:
    """Of a recording: mean share of time in contact, rms of the contact forces, rms of all accelerometers."""

    contact_fraction: float
    contact_force_n: float
    acceleration_m_per_s2: float


def young_motion(plant: Plant, step_s: float, scale: float = SMALL, beside: Station | None = None) -> Motion:
    """The barrel and its cradle until some 0.2 s after their first contact, from the moment the force sets in.

    A further force, of another seed, acts at the place `beside`.
    """
    base = BarrelCradle()
    clearance_m = scale * base.clearance_1_m
    settings = msgspec.structs.replace(
        base, sensors="acceleration", clearance_1_m=clearance_m, clearance_2_m=clearance_m
    )
    rig, excitations = settings.rig(), [settings.force()]
    if beside:
        rig = msgspec.structs.replace(rig, force_at=(*rig.forces, beside))
        excitations.append(msgspec.structs.replace(settings.force(), seed=2))
    begun = slice(round(QUIET_S / step_s), None)
    forces_n = Forces(tuple(scale * force_history(one, QUIET_S + 0.5, step_s)[begun] for one in excitations))
    return concatenated(plant(rig, forces_n, step_s, lambda _: None))


def tip_difference(motion: Motion, reference: Motion) -> dict[str, float]:
    """rms of the difference in tip acceleration over rms, while contact is young; both at the same step."""
    first = int(np.argmax(reference.contact_force_n.any(axis=0)))
    young = slice(first, first + round(YOUNG_S / reference.step_s))
    tips = {s.station.body: k for k, s in enumerate(BarrelCradle(sensors="acceleration").rig().sensors)}  # last of each
    return {
        body: float(_rms((motion.sensed - reference.sensed)[row, young]) / _rms(reference.sensed[row, young]))
        for body, row in tips.items()
    }


def statistics(plant: Plant, settings: BarrelCradle, seed: int, description: str) -> Statistics:
    """What a recording of that length would say."""
    rig = settings.rig()
    excitation = msgspec.structs.replace(settings.force(), seed=seed)
    force_n = force_history(excitation, settings.duration_s, settings.step_s)
    closed, force_squares, acceleration_squares = [], [], []
    with progress_bar(description) as progress:
        for part in digitise(rig, plant(rig, force_n, settings.step_s, progress), np.random.default_rng(seed)):
            contact_n, acceleration = part.truth["contact_force"], part.sensed["acceleration"]
            closed.append(np.count_nonzero(contact_n) / len(contact_n))
            force_squares.append(np.sum(contact_n**2) / len(contact_n))
            acceleration_squares.append(np.sum(acceleration**2) / len(acceleration))
    samples = settings.duration_s * settings.sample_rate_hz
    return Statistics(
        contact_fraction=float(sum(closed) / samples),
        contact_force_n=float(np.sqrt(sum(force_squares) / samples)),
        acceleration_m_per_s2=float(np.sqrt(sum(acceleration_squares) / samples)),
    )


@app.command()
def engines(
    duration_s: Annotated[float, typer.Option(help="Length of the statistics' records, seconds.")] = 60.0,
    seeds: Annotated[int, typer.Option(help="How many forces both plants are given for the statistics.", min=1)] = 1,
) -> None:
    """Compares Exudyn's beams with the assumed modes at the barrel and its cradle."""
    console = Console()
    console.print(_trajectories())
    console.print(_long_run(BarrelCradle(sensors="acceleration", duration_s=duration_s), seeds))


def _long_run(settings: BarrelCradle, seeds: int) -> Table:
    """The difference of the plants beside that of two modal plants whose mode counts differ: what chaos alone does."""

    def runs(plant: Plant, name: str, count: int) -> Float[np.ndarray, "runs quantities"]:
        return np.array([astuple(statistics(plant, settings, k, f"{name}, seed {k}")) for k in range(1, count + 1)])

    count = max(CHANCE_SEEDS, seeds)
    linear = runs(modal.simulate, "modal", count)
    twin = runs(partial(modal.simulate, modes_per_beam=24), "24 modes", count)
    finite_elements = runs(ancf.simulate, "ancf", seeds)
    chance = 100 * np.std(twin / linear - 1, axis=0, ddof=1) / np.sqrt(seeds)
    table = Table(title=f"{seeds} x {settings.duration_s:g} s at step 1/{round(1 / settings.step_s)} s, 14 N")
    for heading in ("", "ancf", "modal", "difference, %", "by chance, %"):
        table.add_column(heading, justify="right" if heading else "left")
    names = ("contact fraction", "contact force rms, N", "acceleration rms, m/s^2")
    for name, a, m, by_chance in zip(names, finite_elements.T, linear[:seeds].T, chance, strict=True):
        difference = 100 * np.mean(a / m - 1)
        table.add_row(name, f"{a.mean():.4g}", f"{m.mean():.4g}", f"{difference:+.1f}", f"{by_chance:.1f}")
    return table


def _trajectories() -> Table:
    table = Table(title=f"Tip acceleration, ancf against modal, first {YOUNG_S} s of contact, clearance 0.05 mm")
    for heading in ("step, s", "modes", "cradle, %", "barrel, %"):
        table.add_column(heading, justify="right")
    for power in (13, 14, 15, 16):
        step_s = 2.0**-power
        finite_elements = young_motion(ancf.simulate, step_s)
        for modes in MODE_COUNTS:
            differences = tip_difference(
                finite_elements, young_motion(partial(modal.simulate, modes_per_beam=modes), step_s)
            )
            table.add_row(f"2^-{power}", str(modes), *(f"{100 * differences[b]:.2f}" for b in ("cradle", "barrel")))
    return table


def _rms(values: Float[np.ndarray, " samples"]) -> float:
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    run(app, "tests.campaigns.engines")
