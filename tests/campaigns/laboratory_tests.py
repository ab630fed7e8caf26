"""Tests as laboratories do them: other forces, sensors and beginnings, of the reference rigs.

python -m tests.campaigns.laboratory_tests --out out/laboratory_tests
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from msgspec.structs import replace as changed
from rich.console import Console
from rich.progress import track
from rich.table import Table

import identify
from identify.contacts.results import Estimate
from identify.pages.wording import COVERED
from rig import RigError
from rig.commands.command_line import run
from rig.effects import effect_named
from rig.model.description import BaseMotion, Rig, Station, contact_stations
from rig.model.quantities import QUANTITIES
from rig.recording import Recording, read
from rig.simulation.excitation import Excitation, excitation_of
from rig.simulation.plants import modal
from rig.simulation.plants.loading import base_motion
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle, Sdof
from rig.simulation.sensors import plant_run_duration_s
from scenarios.jitter import jittered

NOISE = 1e-3
"""Of every accelerometer, m/s^2/sqrt(Hz)."""
WIDER, STIFFER = "contact_clearance:factor=1.2", "contact_stiffness:factor=1.3"
HEAVIER, HELD = "added_mass:mass_kg=0.1", "linear_spring:stiffness_n_per_m=1000"
SOFTER, LOSSY = "youngs_modulus:factor=0.95", "structural_damping:factor=3"
"""Effects of the library, each well above its limit."""
VALIDATES = 1.5
"""The level of the record that validates a diagnosis, over that of the one that is fitted."""
app = typer.Typer(pretty_exceptions_enable=False)


@dataclass(frozen=True)
class Test:
    """Settings of a reference rig, its force, what is changed of its rig.json, and what is cut off at its start.

    beside are the forces that act at the rig's further places.
    effect is what the machine has in the two records that are diagnosed, and rig.json not. The force channel of one
    that is unforced is zero. A base that shakes is not in rig.json: of one mass the recording
    holds the motion against it, and minus the mass times its acceleration as the force, else the motion alone.
    """

    settings: BarrelCradle | Sdof
    force: Excitation
    change: Callable[[Rig], Rig] = lambda rig: rig
    without_s: float = 0.0
    unforced: bool = False
    base: BaseMotion | None = None
    effect: str = WIDER
    beside: tuple[Excitation, ...] = ()

    @property
    def rig(self) -> Rig:
        return self.change(self.settings.rig())


def ac_coupled(corner_hz: float) -> Callable[[Rig], Rig]:
    """Every sensor has a high-pass of that corner, which its description says."""
    return lambda rig: changed(rig, sensors=tuple(changed(s, high_pass_hz=corner_hz) for s in rig.sensors))


def fewer_stations(count: int) -> Callable[[Rig], Rig]:
    """So many on each body: those at the contacts, then from the right end."""

    def change(rig: Rig) -> Rig:
        at_contacts = {s for c in rig.contacts for s in contact_stations(c)}
        kept = set()
        for body in rig.bodies:
            own = {s.station for s in rig.sensors if s.station.body == body.name}
            kept |= set(sorted(own, key=lambda s: (s not in at_contacts, -s.position_m))[:count])
        return changed(rig, sensors=tuple(s for s in rig.sensors if s.station in kept))

    return change


def driven_too(body: str, position_m: float, force: str = "gaussian", rms_n: float = 14.0) -> dict[str, Any]:
    """A further force there, over the same band."""
    at = Station(body, position_m)
    return {
        "change": lambda rig: changed(rig, force_at=(*rig.forces, at)),
        "beside": (excitation_of(force, rms_n=rms_n, low_hz=0.5, high_hz=100.0),),
    }


def without_contact_2(rig: Rig) -> Rig:
    """No sensor of the barrel stands at its contact 2."""
    return changed(rig, sensors=tuple(s for s in rig.sensors if s.station != rig.contacts[1].at))


def shaken(rms_m_per_s2: float) -> BaseMotion:
    return BaseMotion(acceleration_rms_m_per_s2=rms_m_per_s2, low_hz=1.0, high_hz=15.0)


def beams(
    force: str = "gaussian",
    *,
    sensors: str = "acceleration",
    rms_n: float = 14.0,
    low_hz: float = 0.5,
    high_hz: float = 100.0,
    **settings: Any,
) -> Test:
    noise = NOISE if sensors == "acceleration" else 0.0
    own = BarrelCradle(duration_s=30.0, sensors=sensors, noise_density=noise)
    return Test(own, excitation_of(force, rms_n=rms_n, low_hz=low_hz, high_hz=high_hz), **settings)


def mass(
    force: str = "gaussian",
    *,
    sensors: str = "acceleration",
    rms_n: float = 1.0,
    low_hz: float = 0.5,
    high_hz: float = 15.0,
    **settings: Any,
) -> Test:
    noise = NOISE if sensors == "acceleration" else 0.0
    own = Sdof(duration_s=40.0, step_s=2.0**-12, sensors=sensors, noise_density=noise)
    return Test(own, excitation_of(force, rms_n=rms_n, low_hz=low_hz, high_hz=high_hz), **settings)


RELEASED: dict[str, Any] = {"force": "free_decay", "rms_n": 500.0, "high_hz": 50.0, "without_s": 1.1, "unforced": True}
LET_GO: dict[str, Any] = {"force": "free_decay", "rms_n": 60.0, "high_hz": 5.0, "without_s": 1.2, "unforced": True}
"""A blow of 10 ms and of 100 ms at 1 s, which the record does not hold."""
TESTS = {
    "two beams, Gaussian force": beams(),
    "two beams, burst random": beams("burst", effect=HELD),
    "two beams, swept sine": beams("sweep", effect=SOFTER),
    "two beams, stepped sine": beams("stepped_sine", effect=STIFFER),
    "two beams, multisine": beams("multisine", effect=LOSSY),
    "two beams, a hammer's hit every two seconds": beams("hammer", effect=HEAVIER),
    "two beams, high-pass of 0.5 Hz": beams(change=ac_coupled(0.5), effect=HEAVIER),
    "two beams, high-pass of 2 Hz": beams(change=ac_coupled(2.0), effect=SOFTER),
    "two beams, no quiet start": beams(without_s=4.0, effect=HELD),
    "two beams, no quiet start, displacements": beams(sensors="displacement", without_s=4.0),
    "two beams, three stations each": beams(change=fewer_stations(3), effect=STIFFER),
    "two beams, two stations each": beams(change=fewer_stations(2), effect=HEAVIER),
    "two beams, one measured blow": beams("free_decay", rms_n=500.0, high_hz=50.0),
    "two beams, free decay, no force measured": beams(**RELEASED),
    "two beams, free decay, displacements": beams(sensors="displacement", effect=HEAVIER, **RELEASED),
    "one mass, Gaussian force": mass(),
    "one mass, swept sine": mass("sweep"),
    "one mass, stepped sine": mass("stepped_sine", effect=HEAVIER),
    "one mass, a hammer's hit every two seconds": mass("hammer", effect=STIFFER),
    "one mass, high-pass of 0.5 Hz": mass(change=ac_coupled(0.5), effect=HEAVIER),
    "one mass, no quiet start": mass(without_s=4.0),
    "one mass, no quiet start, displacement": mass(sensors="displacement", without_s=4.0, effect=HEAVIER),
    "one mass, one measured blow": mass("free_decay", rms_n=60.0, high_hz=5.0),
    "one mass, free decay, no force measured": mass(effect=STIFFER, **LET_GO),
    "one mass, free decay, displacement": mass(sensors="displacement", effect=HEAVIER, **LET_GO),
    "one mass, base excitation, motion against the base": mass(
        rms_n=0.0, base=shaken(1.0), without_s=1.0, effect=STIFFER
    ),
    "one mass, base excitation, displacement": mass(sensors="displacement", rms_n=0.0, base=shaken(1.0), without_s=1.0),
    "two beams, a shaker on each": beams(effect=STIFFER, **driven_too("cradle", 0.6)),
    "two beams, two shakers on the barrel": beams(effect=HEAVIER, **driven_too("barrel", 0.2)),
    "two beams, a shaker and a hammer": beams(**driven_too("cradle", 0.6, "hammer", 4.0)),
}
REFUSED = {
    "two beams, force not recorded": beams(unforced=True),
    "two beams, a blow that is not recorded": beams(**(RELEASED | {"without_s": 0.0})),
    "two beams, base excitation": beams(rms_n=0.0, base=shaken(20.0)),
    "two beams, base excitation in rig.json": beams(change=lambda rig: changed(rig, base_motion=shaken(20.0))),
    "two beams, displacements, no sensor at contact 2": beams(sensors="displacement", change=without_contact_2),
    "two beams, accelerometers, no sensor at contact 2": beams(change=without_contact_2),
    "one mass, force not recorded": mass(unforced=True),
}
"""What a record does not tell; `identify contact` says in one sentence why."""


def recorded(
    test: Test,
    path: Path,
    duration_s: float | None = None,
    jitter: int | None = None,
    *,
    effect: str = "",
    seed: int = 1,
    level: float = 1.0,
) -> Recording:
    """By the plant `modal`; with a seed of jitter, of a rig as a laboratory builds it, which rig.json does not know.

    Nor does it know the effect, if one is named. The excitation has another seed and another level if asked.
    """
    rig, step_s, duration_s = test.rig, test.settings.step_s, duration_s or test.settings.duration_s
    actual = effect_named(effect).applied_to(rig) if effect else rig
    actual = actual if jitter is None else jittered(actual, np.random.default_rng(jitter))
    if test.base:
        rms = level * test.base.acceleration_rms_m_per_s2
        actual = changed(actual, base_motion=changed(test.base, seed=seed, acceleration_rms_m_per_s2=rms))
    forces = [
        changed(force, seed=seed + 1000 * k, rms_n=level * force.rms_n)
        for k, force in enumerate((test.force, *test.beside))
    ]
    record(
        rig,
        forces,
        plant=modal.simulate,
        duration_s=duration_s,
        step_s=step_s,
        path=path,
        progress=lambda _: None,
        actual=actual,
    )
    whole = read(path)
    rows = {name: signals.values for name, signals in whole.signals.items()}
    if test.unforced:
        rows["force"] = np.zeros_like(rows["force"])
    if test.base and isinstance(test.settings, Sdof):
        samples = round(plant_run_duration_s(actual, duration_s) / step_s)
        every = slice(None, None, round(1 / (step_s * rig.sample_rate_hz)))
        base = [row[every][: whole.samples] for row in base_motion(actual, samples, step_s)]
        rows = {name: row - base[QUANTITIES[name].order] for name, row in rows.items() if name != "force"}
        rows["force"] = -test.settings.mass_kg * base[2][None]
    first = round(test.without_s * rig.sample_rate_hz)
    cut = {n: replace(s, values=np.ascontiguousarray(rows[n][:, first:])) for n, s in whole.signals.items()}
    return replace(whole, signals=cut)


@app.command()
def laboratory_tests(
    out: Annotated[Path, typer.Option(help="Folder for the recordings.")] = Path("out/laboratory_tests"),
    jitter: Annotated[int | None, typer.Option(help="Seed of what rig.json has wrong; none without it.")] = None,
    only: Annotated[str, typer.Option(help="Tests with this in their name.")] = "",
    diagnose: Annotated[bool, typer.Option("--diagnose", help="Diagnose an effect of each, in place of that.")] = False,
) -> None:
    """Identifies the contacts from every test, 30 s of two beams or 40 s of one mass.

    With --diagnose an effect of each instead, which rig.json does not know, from two records.
    """
    out.mkdir(parents=True, exist_ok=True)
    if diagnose:
        _diagnosed(out, jitter, only)
        return
    table = Table(title="Tests of the reference rigs: errors with 95 % intervals")
    for heading in ("test", "clearance off by, %", "stiffness off by, %", "findings"):
        table.add_column(heading)
    inside: list[bool] = []
    tests = [(k, *one) for k, one in enumerate((TESTS | REFUSED).items()) if only in one[0]]
    for number, name, test in track(tests, console=Console(stderr=True)):
        try:
            own = None if jitter is None else jitter + number
            report = identify.contact(recorded(test, out / f"{number}.mcap", jitter=own)).report
        except RigError as error:
            table.add_row(name, str(error))
            continue
        pairs = list(zip(report.contacts, test.rig.contacts, strict=True))
        clearances = [_off(found.clearance_m, contact.law.lower_clearance_m) for found, contact in pairs]
        stiffnesses = [_off(found.stiffness_n_per_m, contact.law.stiffness_n_per_m) for found, contact in pairs]
        inside += [abs(off) < reach for off, reach in clearances + stiffnesses]
        told = ["\n".join(f"{off:+.3f} ± {reach:.2f}" for off, reach in one) for one in (clearances, stiffnesses)]
        table.add_row(name, *told, "; ".join(f.cause for f in report.findings))
    Console().print(table)
    Console().print(f"{sum(inside)} of {len(inside)} values within their 95 % intervals", highlight=False)


def _diagnosed(out: Path, jitter: int | None, only: str) -> None:
    """The table of the effects."""
    table = Table(title="Tests of the reference rigs: the effect that rig.json lacks, with 95 % intervals")
    for heading in ("test", "effect", "verdict", "found", "closes, %"):
        table.add_column(heading)
    tests = [(k, *one) for k, one in enumerate((TESTS | REFUSED).items()) if only in one[0]]
    for number, name, test in track(tests, console=Console(stderr=True)):
        try:
            row = (name, test.effect, *gap_of(test, out / str(number), None if jitter is None else jitter + number))
        except RigError as error:
            row = (name, test.effect, str(error), "", "")
        Console(stderr=True).print(" | ".join(row), highlight=False, soft_wrap=True)
        table.add_row(*row)
    Console().print(table)


def gap_of(test: Test, path: Path, jitter: int | None, duration_s: float | None = None) -> tuple[str, str, str]:
    """Verdict, likeliest cause with its parameters, and what it closes. Raises RigError if the records allow none."""
    fit, validation = (
        recorded(
            test,
            path.with_name(f"{path.name}_{seed}.mcap"),
            duration_s,
            jitter,
            effect=test.effect,
            seed=seed,
            level=level,
        )
        for seed, level in ((2, 1.0), (3, VALIDATES))
    )
    found = identify.gap(fit, validation).report
    if not found.causes:
        return found.verdict, "", ""
    best = found.causes[0]
    numbers = "; ".join(f"{v.value:.4g} ± {COVERED * v.standard_error:.2g}" for v in best.parameters.values())
    return found.verdict, f"{' + '.join(best.effects)} {numbers}", f"{100 * best.explained:.0f}"


def _off(found: Estimate, true: float) -> tuple[float, float]:
    """Error and half the 95 % interval, in per cent of the true value."""
    return 100 * (found.value / true - 1), 196 * found.standard_error / true


if __name__ == "__main__":
    run(import_module("tests.campaigns.laboratory_tests").app, "tests.campaigns.laboratory_tests")
