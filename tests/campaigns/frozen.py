"""Numbers frozen before the program is changed: small recordings and blind cases, identified and diagnosed.

python -m tests.campaigns.frozen --out out/frozen --against tests/campaigns/frozen.json
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from threadpoolctl import threadpool_limits

import identify
import rig
from identify.contacts.results import ContactReport, Estimate
from identify.gaps.results import Gap
from rig import BarrelCradle, Recording, Sdof
from rig.commands.command_line import progress_spinner, run
from rig.effects.added_mass import AddedMass
from rig.effects.base import Effect
from rig.files import write_json
from rig.model.unmeasured_force import Value
from tests.campaigns.blind_comparison import decoded
from tests.campaigns.blind_diagnosis import gap_of
from tests.campaigns.frozen_table import Frozen, Number, Told, compared, shown
from tests.campaigns.worlds.making import made, planned
from tests.campaigns.worlds.truth import World

app = typer.Typer(pretty_exceptions_enable=False)

BLIND_SEED, BLIND_S = 60001, 12.0


@dataclass(frozen=True)
class Step:
    """What makes recordings in a folder, and what is told of them."""

    make: Callable[[Path], tuple[Recording, ...]]
    tell: Callable[..., Told]


@app.command()
def frozen(
    out: Annotated[Path, typer.Option(help="Folder for recordings, kept if there, and frozen.json.")] = Path(
        "out/frozen"
    ),
    against: Annotated[
        Path | None, typer.Option(help="A frozen.json of before; every number is set beside its own there.")
    ] = None,
    only: Annotated[str | None, typer.Option(help="One step by its name.")] = None,
    shake: Annotated[
        float, typer.Option(min=0, help="Every sample is off by about this share; 1e-15 shows what rounding does.")
    ] = 0.0,
) -> None:
    """Records, identifies and diagnoses, writes the numbers, and sets them beside those of before.

    Recordings that are in the folder already are taken as they are: the motion is chaotic, so that a plant that rounds
    otherwise makes others.
    """
    before = decoded(against, Frozen) if against else None
    now: Frozen = {}
    for name, step in STEPS.items() if only is None else [(only, STEPS[only])]:
        (out / name).mkdir(parents=True, exist_ok=True)
        with progress_spinner(name), threadpool_limits(1):  # the number of threads changes the order of sums
            now[name] = step.tell(*(shaken(one, shake) for one in step.make(out / name)))
    write_json(now, out / "frozen.json")
    print(f"numbers of {len(now)} steps in {out / 'frozen.json'}")
    if before is not None:
        shown(compared(before, now), str(against))


def recorded(settings: Sdof | BarrelCradle, effects: tuple[Effect, ...], folder: Path) -> tuple[Recording]:
    """By the plant `modal`; with effects of which the recording's rig knows nothing."""
    path, actual = folder / "recording.mcap", settings.rig()
    if path.exists():
        return (rig.read(path),)
    for effect in effects:
        actual = effect.applied_to(actual)
    recording = rig.record(
        settings.rig(),
        path,
        force=settings.force(),
        duration_s=settings.duration_s,
        step_s=settings.step_s,
        actual=actual,
    )
    return (recording,)


def blind(world: World, number: int, folder: Path) -> tuple[Recording, ...]:
    """The recordings to fit and to validate of a case, as `tests.campaigns.blind_gap make` makes them."""
    if not (folder / "recordings").exists():
        for place in (folder / "recordings", folder / "sealed" / "work"):
            place.mkdir(parents=True)
        made(planned(folder, world, BLIND_SEED, number + 1, BLIND_S)[number])
    return tuple(rig.read(path) for path in sorted((folder / "recordings").glob("*.mcap")))


def shaken(recording: Recording, share: float) -> Recording:
    rng = np.random.default_rng(1)
    signals = {
        name: replace(group, values=group.values * (1 + share * rng.standard_normal(group.values.shape)))
        for name, group in recording.signals.items()
    }
    return replace(recording, signals=signals) if share else recording


def identified(recording: Recording) -> Told:
    return told_of_contacts(recording, identify.contact(recording).report)


def diagnosed(recording: Recording) -> Told:
    return told_of_gap(recording, identify.gap(recording).report)


def blind_diagnosed(fit: Recording, validate: Recording) -> Told:
    """As `tests.campaigns.blind_gap diagnose` does it, with a null reference made anew."""
    with tempfile.TemporaryDirectory() as null_reference:
        return told_of_gap(fit, gap_of(fit, validate, Path(null_reference), None))


def told_of_contacts(recording: Recording, report: ContactReport) -> Told:
    """The joint estimates, and those of the paper's methods in the main equation."""
    words = {"main equation": report.main_equation} | {u.name: "not told" for u in report.unanswered}
    numbers = rms_of(recording)
    for contact in report.contacts:
        fields = {field: getattr(contact, field) for field in contact.__struct_fields__}
        numbers |= {f"{contact.name} {f}": number(e) for f, e in fields.items() if isinstance(e, Estimate)}
    for nifo in (one for one in report.nifo if one.equation == report.main_equation):
        for stiffness in nifo.stiffness:
            numbers[f"{stiffness.contact} stiffness_n_per_m by NIFO"] = number(stiffness.mean_n_per_m)
    for surface in (one for one in report.surface.surfaces if one.equation == report.main_equation):
        for clearance in surface.clearances:
            numbers[f"{clearance.contact} clearance_m by the surface"] = number(clearance.clearance_m)
    return Told(words, numbers)


def told_of_gap(recording: Recording, gap: Gap) -> Told:
    """The verdict and the first cause, if it explains something; of an unmeasured force what it is and where."""
    words: dict[str, str] = {"verdict": gap.verdict}
    numbers = rms_of(recording) | {
        "p-value of the believed rig": Number(gap.evidence.p_value),
        "-2 ln p of the believed rig": Number(gap.nothing_minus_two_log),
        "probability of the believed rig": Number(gap.probability_nothing),
        "probability of something unknown": Number(gap.probability_unknown),
    }
    if gap.causes and gap.verdict != "unexplained":
        cause = gap.causes[0]
        words |= {"likeliest cause": " + ".join(cause.effects)} | cause.places
        numbers |= {name: number(value) for name, value in cause.parameters.items()} | {
            "probability of the likeliest cause": Number(cause.probability),
            "closure by the likeliest cause": Number(cause.explained),
            "-2 ln p with the likeliest cause": Number(cause.minus_two_log),
        }
    if gap.unknown:
        words |= {"unknown is": gap.unknown.kind, "unknown goes against": gap.unknown.against}
        numbers |= {"unknown rms_n": Number(gap.unknown.rms_n), "unknown explains": Number(gap.unknown.explained)}
        if gap.unknown.position_m is not None:
            numbers["unknown position_m"] = Number(gap.unknown.position_m, gap.unknown.position_error_m or 0.0)
    return Told(words, numbers)


def rms_of(recording: Recording) -> dict[str, Number]:
    """Of each quantity; they change with the simulation alone."""
    return {f"rms of {q}": Number(float(np.sqrt(np.mean(s.values**2)))) for q, s in recording.signals.items()}


def number(estimate: Estimate | Value) -> Number:
    return Number(estimate.value, estimate.standard_error)


MASS = partial(Sdof, contact_damping_n_s_per_m=2.0, duration_s=20.0)
NOISY_BEAMS = partial(BarrelCradle, sensors="acceleration", noise_density=1e-3)
STEPS = {
    "mass_displacement": Step(partial(recorded, MASS(sensors="displacement", seed=11), ()), identified),
    "mass_accelerometer": Step(
        partial(recorded, MASS(sensors="acceleration", noise_density=1e-3, seed=12), ()), identified
    ),
    "beams_displacement": Step(
        partial(recorded, BarrelCradle(sensors="displacement", duration_s=12.0, seed=13), ()), identified
    ),
    "beams_accelerometers": Step(
        partial(recorded, NOISY_BEAMS(contact_damping_n_s_per_m=20.0, duration_s=12.0, seed=14), ()), identified
    ),
    "beams_added_mass": Step(  # a diagnosis cuts its only record in two, and needs 10 s of each part
        partial(recorded, NOISY_BEAMS(duration_s=24.0, seed=15), (AddedMass(mass_kg=0.2, relative_position=0.8),)),
        diagnosed,
    ),
    "beams_null": Step(partial(recorded, NOISY_BEAMS(duration_s=24.0, seed=16), ()), diagnosed),
    "blind_own_single": Step(partial(blind, "own", 0), blind_diagnosed),  # a Hertz stop
    "blind_wide_pair": Step(partial(blind, "wide", 2), blind_diagnosed),  # a common gain and a contact position
    "blind_other_outside": Step(partial(blind, "other", 6), blind_diagnosed),  # a third contact
}


if __name__ == "__main__":
    run(app, "tests.campaigns.frozen")
