"""Measured data: the ground vibration test of an F-16, whose payload's joint has clearance and friction.

python -m scenarios.f16 --data FOLDER --out out/f16

FOLDER holds the benchmark's F16Data_FullMSine_Level*.mat. Noël and Schoukens, "F-16 aircraft benchmark based on ground
vibration test data", Workshop on Nonlinear System Identification Benchmarks, 2017.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace as with_parts
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import typer
from jaxtyping import Float
from matplotlib.figure import Figure
from msgspec.structs import replace
from rich.console import Console
from rich.table import Table

from identify.gaps.decision.answer import diagnose
from identify.gaps.page.report import write_all
from identify.gaps.results import Matters
from identify.pages.style import BLUE, GREY, RED, picture
from rig.commands.command_line import Force, progress_bar, refuse_existing, run
from rig.errors import RigError
from rig.files import write_bytes, write_json
from rig.lab.importing import import_file
from rig.lab.modal.record import MeasuredResponse, fit_record
from rig.lab.starting import write_start
from rig.lab.starting.measured import MeasuredRig
from rig.model.description import Rig
from rig.model.modes import modes_of
from rig.recording import Recording, read
from scenarios.free_runs import SIMULATOR, free_run

FILE = "F16Data_FullMSine_Level{}.mat"
LOW, PAIRS = "1", (("3", "2_Validation"), ("5", "4_Validation"))
"""The level that the modes are fitted to; and the levels that are diagnosed, each with the one that validates."""
RATE_HZ, PERIOD = 400.0, 8192
PLACES_M = (0.0, 1.0, 1.2)
"""Of the sensors, at the force, on the wing and on the payload at its joint: labels, as no drawing is published."""
OUTPUTS = ("at the force", "wing at the joint", "payload at the joint")
DIAGNOSED = slice(0, 4 * PERIOD)
"""Four periods of nine, from rest."""
JOINT_HZ = (6.9, 7.5)
"""Where the mode lies that the joint belongs to."""
app = typer.Typer(pretty_exceptions_enable=False)


class FreeRun(msgspec.Struct, frozen=True, kw_only=True):
    """Rms errors of free runs on a level, % of the response's rms, at every output."""

    level: str
    believed: tuple[float, ...]
    corrected: tuple[float, ...]
    equivalent_linear: tuple[float, ...]


class Judged(msgspec.Struct, frozen=True, kw_only=True):
    """A diagnosis, and what its corrected rig leaves; the joint's mode (Hz, ratio) before and after."""

    verdict: str
    sentence: str
    effects: tuple[str, ...]
    explained: float
    joint_mode: tuple[float, float]
    joint_mode_corrected: tuple[float, float]
    unknown: str
    runs: tuple[FreeRun, ...]


@app.command()
def f16(
    data: Annotated[Path, typer.Option(help=f"Folder with {FILE.format('1')} and the other levels.")],
    out: Annotated[Path, typer.Option(help="Folder for the records, the results and the figures.")] = Path("out/f16"),
    force: Force = False,
) -> None:
    """Fits a rig to the lowest level, diagnoses levels 3 and 5 against it, and judges the corrected rigs."""
    refuse_existing(out / "f16.json", force, new_folder=True)
    start = start_of(data)
    believed, notes = start.rig_and_notes()
    write_start(believed, start.map_text(believed), out)
    console = Console()
    for note in notes:
        console.print(note, highlight=False, soft_wrap=True)
    found = []
    for fitted, validating in PAIRS:
        records = {level: imported(data, level, out) for level in (fitted, validating)}
        with progress_bar(f"diagnosing level {fitted}") as progress:
            judged, corrected = judge(believed, records, fitted, validating, out, shown_by(progress))
        found.append(judged)
        console.print(judged.sentence, highlight=False, soft_wrap=True)
        console.print(table(judged, fitted))
        runs = {
            name: free_run(rig, records[validating].force_n)
            for name, rig in (("rig of level 1", believed), ("corrected rig", corrected))
        }
        drawn(records[validating], runs, PERIOD, out / f"level{fitted}.png")
    write_json(found, out / "f16.json")
    console.print(f"records, rig.json, map.toml, f16.json, level*/gap.html, level*.png: in {out}", soft_wrap=True)


def shown_by(progress: Callable[[float], None]) -> Callable[[str, float], None]:
    return lambda _, share: progress(share)


def start_of(data: Path) -> MeasuredRig:
    """What `rig init measured` is told of level 1."""
    return MeasuredRig(
        name="f16",
        from_record=data / FILE.format(LOW),
        force_column="Force",
        columns=tuple(f"Acceleration[{k}]" for k in (1, 2, 3)),
        unit="m/s^2",
        positions_m=PLACES_M,
        force_m=PLACES_M[0],
        sample_rate_hz=RATE_HZ,
    )


def imported(data: Path, level: str, out: Path) -> Recording:
    path = out / f"level{level[0]}.mcap"
    import_file(data / FILE.format(level), out / "map.toml", path)
    return read(path)


def judge(
    believed: Rig,
    records: Mapping[str, Recording],
    fitted: str,
    validating: str,
    out: Path,
    progress: Callable[[str, float], None],
) -> tuple[Judged, Rig]:
    """The diagnosis of a level, validated on another, and free runs on both; the corrected rig."""
    first, second = (part_of(records[level], DIAGNOSED) for level in (fitted, validating))
    assert believed.tolerances is not None
    matters = Matters(motion=believed.tolerances.unmodelled)
    gap, corrected = diagnose(first, second, SIMULATOR, None, progress, None, matters)
    write_all(gap, corrected, f"F-16, level {fitted}", out / f"level{fitted}")
    linear = equivalent_linear(believed, records[fitted])
    runs = tuple(
        FreeRun(
            level=level[0],
            **{
                name: errors_percent(rig, records[level])
                for name, rig in (("believed", believed), ("corrected", corrected), ("equivalent_linear", linear))
            },
        )
        for level in (fitted, validating)
    )
    judged = Judged(
        verdict=gap.verdict,
        sentence=gap.sentence,
        effects=gap.causes[0].effects if gap.causes else (),
        explained=gap.causes[0].explained if gap.causes else 0.0,
        joint_mode=joint_mode(believed),
        joint_mode_corrected=joint_mode(corrected),
        unknown=gap.unknown.sentence if gap.unknown else "",
        runs=runs,
    )
    return judged, corrected


def part_of(recording: Recording, samples: slice) -> Recording:
    signals = {name: with_parts(one, values=one.values[:, samples]) for name, one in recording.signals.items()}
    return with_parts(recording, signals=signals)


def equivalent_linear(believed: Rig, recording: Recording) -> Rig:
    """The modes fitted to the record itself."""
    measured = MeasuredResponse(recording.force_n, accelerations(recording), 2, RATE_HZ)
    (body,) = believed.bodies
    found = fit_record(measured, PLACES_M, 0, body.length_m, name=body.name)
    return replace(believed, bodies=(found.body,))


def accelerations(recording: Recording) -> Float[np.ndarray, "sensors samples"]:
    return recording.signals["acceleration"].values


def errors_percent(rig: Rig, recording: Recording) -> tuple[float, ...]:
    """Rms error of a free run over the rms of each response, after the first period."""
    measured = accelerations(recording)
    error = measured - accelerations(free_run(rig, recording.force_n))
    return tuple((100 * error[:, PERIOD:].std(axis=1) / measured[:, PERIOD:].std(axis=1)).tolist())


def joint_mode(rig: Rig) -> tuple[float, float]:
    """Natural frequency (Hz) and damping ratio of the mode that carries the joint."""
    (body,) = rig.bodies
    modes = modes_of(rig, body)
    hz, ratios = modes.frequencies_hz(body.max_modes), modes.damping_ratios(body.max_modes)
    inside = np.flatnonzero((hz > JOINT_HZ[0]) & (hz < JOINT_HZ[1]))
    if not inside.size:
        raise RigError(f"no mode from {JOINT_HZ[0]} to {JOINT_HZ[1]} Hz; give the benchmark's own files")
    return float(hz[inside[-1]]), float(ratios[inside[-1]])


def table(judged: Judged, fitted: str) -> Table:
    (before_hz, before), (after_hz, after) = judged.joint_mode, judged.joint_mode_corrected
    found = Table(
        title=f"Level {fitted}: {judged.verdict}, {' + '.join(judged.effects)}; the joint's mode from {before_hz:.2f} "
        f"to {after_hz:.2f} Hz, damping ratio {100 * before:.2f} to {100 * after:.2f} %"
    )
    for heading in ("free run, error % rms", *OUTPUTS):
        found.add_column(heading, justify="right" if found.columns else "left")
    for one in judged.runs:
        for name in ("believed", "corrected", "equivalent_linear"):
            found.add_row(f"level {one.level}, {name.replace('_', ' ')}", *(f"{x:.1f}" for x in getattr(one, name)))
    return found


BAND_HZ = (2.0, 15.0)
EXCITED = 0.05
"""Lines of less than this share of the force's largest are left out."""


def drawn(recording: Recording, runs: Mapping[str, Recording], period: int, path: Path) -> None:
    """The lines that the force excites, of the last period, of the record and of free runs under its force."""
    force = _lines(recording.force_n, period)
    hz = np.fft.rfftfreq(period, 1 / recording.rig.sample_rate_hz)
    excited = (hz >= BAND_HZ[0]) & (hz <= BAND_HZ[1]) & (force > EXCITED * force.max())
    shown = [("measured", recording, GREY, 2.5)]
    shown += [(name, one, colour, 1.0) for (name, one), colour in zip(runs.items(), (BLUE, RED), strict=True)]

    def draw(figure: Figure) -> None:
        panels = figure.subplots(len(recording.rig.sensors), 1, sharex=True)
        for row, (axes, sensor) in enumerate(zip(panels, recording.rig.sensors, strict=True)):
            for name, one, colour, width in shown:
                size = _lines(one.signals["acceleration"].values[row], period)
                axes.semilogy(hz[excited], size[excited], color=colour, lw=width, label=name)
            axes.set(ylabel="m/s²", title=sensor.name)
        panels[-1].set(xlabel="frequency, Hz")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=3)

    write_bytes(picture(draw, 7.2, 6.0).png, path)


def _lines(values: Float[np.ndarray, " samples"], period: int) -> Float[np.ndarray, " lines"]:
    return np.asarray(2 / period * np.abs(np.fft.rfft(values[-period:])))


if __name__ == "__main__":
    run(app, "scenarios.f16")
