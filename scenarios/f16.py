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
from rig.commands.command_line import Force, console_table, progress_bar, refuse_existing, run
from rig.errors import RigError
from rig.files import write_bytes, write_json
from rig.lab.importing import import_file
from rig.lab.modal.record import MeasuredResponse, fit_record
from rig.lab.starting import write_rig_and_map
from rig.lab.starting.measured import MeasuredRig
from rig.model.description import Rig
from rig.model.modes import modes_of
from rig.recording import Recording, read
from scenarios.measured_data import SIMULATOR, free_run

FILE = "F16Data_FullMSine_Level{}.mat"
LOWEST_LEVEL, LEVEL_PAIRS = "1", (("3", "2_Validation"), ("5", "4_Validation"))
"""The level that the modes are fitted to; and the levels that are diagnosed, each with the one that validates."""
RATE_HZ, PERIOD_SAMPLES = 400.0, 8192
PLACES_M = (0.0, 1.0, 1.2)
"""Positions of the sensors at the force, on the wing and on the payload at its joint: labels only, as no drawing is
published."""
SENSOR_PLACE_WORDS = ("at the force", "wing at the joint", "payload at the joint")
DIAGNOSED_SAMPLES = slice(0, 4 * PERIOD_SAMPLES)
"""Four periods of nine, from rest."""
JOINT_BAND_HZ = (6.9, 7.5)
"""Band of the natural frequency of the joint's mode."""
app = typer.Typer(pretty_exceptions_enable=False)


class FreeRun(msgspec.Struct, frozen=True, kw_only=True):
    """Rms errors of free runs on a level, % of the response's rms, at every output."""

    level: str
    believed: tuple[float, ...]
    corrected: tuple[float, ...]
    equivalent_linear: tuple[float, ...]


class LevelDiagnosis(msgspec.Struct, frozen=True, kw_only=True):
    """Diagnosis of a level, the joint's mode (Hz, damping ratio) before and after, and the errors of free runs."""

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
    """Fit a rig to the lowest level, diagnose levels 3 and 5 against it, and judge the corrected rigs."""
    refuse_existing(out / "f16.json", force, new_folder=True)
    start = measured_rig(data)
    believed, notes = start.rig_and_notes()
    write_rig_and_map(believed, start.map_text(believed), out)
    console = Console()
    for note in notes:
        console.print(note, highlight=False, soft_wrap=True)
    diagnoses = []
    for fitted_level, validation_level in LEVEL_PAIRS:
        recordings = {level: import_benchmark(data, level, out) for level in (fitted_level, validation_level)}
        with progress_bar(f"diagnosing level {fitted_level}") as progress:
            diagnosis, corrected = diagnose_level(
                believed, recordings, fitted_level, validation_level, out, lambda _, share: progress(share)
            )
        diagnoses.append(diagnosis)
        console.print(diagnosis.sentence, highlight=False, soft_wrap=True)
        console.print(error_table(diagnosis, fitted_level))
        free_runs = {
            name: free_run(rig, recordings[validation_level].force_n)
            for name, rig in (("rig of level 1", believed), ("corrected rig", corrected))
        }
        draw_spectra(recordings[validation_level], free_runs, PERIOD_SAMPLES, out / f"level{fitted_level}.png")
    write_json(diagnoses, out / "f16.json")
    console.print(f"records, rig.json, map.toml, f16.json, level*/gap.html, level*.png: in {out}", soft_wrap=True)


def measured_rig(data: Path) -> MeasuredRig:
    """Description of level 1 as `rig init measured` takes it."""
    return MeasuredRig(
        name="f16",
        from_record=data / FILE.format(LOWEST_LEVEL),
        force_column="Force",
        columns=tuple(f"Acceleration[{k}]" for k in (1, 2, 3)),
        unit="m/s^2",
        positions_m=PLACES_M,
        force_m=PLACES_M[0],
        sample_rate_hz=RATE_HZ,
    )


def import_benchmark(data: Path, level: str, out: Path) -> Recording:
    path = out / f"level{level[0]}.mcap"
    import_file(data / FILE.format(level), out / "map.toml", path)
    return read(path)


def diagnose_level(
    believed: Rig,
    recordings: Mapping[str, Recording],
    fitted_level: str,
    validation_level: str,
    out: Path,
    progress: Callable[[str, float], None],
) -> tuple[LevelDiagnosis, Rig]:
    """Diagnosis of a level, validated on another, with free runs on both; and the corrected rig."""
    fitted, validation = (excerpt(recordings[level], DIAGNOSED_SAMPLES) for level in (fitted_level, validation_level))
    assert believed.tolerances is not None
    matters = Matters(motion=believed.tolerances.unmodelled)
    gap, corrected = diagnose(fitted, validation, SIMULATOR, None, progress, None, matters)
    write_all(gap, corrected, f"F-16, level {fitted_level}", out / f"level{fitted_level}")
    refitted = equivalent_linear(believed, recordings[fitted_level])
    free_runs = tuple(
        FreeRun(
            level=level[0],
            **{
                name: errors_percent(rig, recordings[level])
                for name, rig in (("believed", believed), ("corrected", corrected), ("equivalent_linear", refitted))
            },
        )
        for level in (fitted_level, validation_level)
    )
    diagnosis = LevelDiagnosis(
        verdict=gap.verdict,
        sentence=gap.sentence,
        effects=gap.causes[0].effects if gap.causes else (),
        explained=gap.causes[0].explained if gap.causes else 0.0,
        joint_mode=joint_mode(believed),
        joint_mode_corrected=joint_mode(corrected),
        unknown=gap.unknown.sentence if gap.unknown else "",
        runs=free_runs,
    )
    return diagnosis, corrected


def excerpt(recording: Recording, samples: slice) -> Recording:
    """Recording of these samples alone."""
    signals = {name: with_parts(group, values=group.values[:, samples]) for name, group in recording.signals.items()}
    return with_parts(recording, signals=signals)


def equivalent_linear(believed: Rig, recording: Recording) -> Rig:
    """Rig with the modes fitted to the recording itself."""
    response = MeasuredResponse(recording.force_n, accelerations(recording), 2, RATE_HZ)
    (body,) = believed.bodies
    fit = fit_record(response, PLACES_M, 0, body.length_m, name=body.name)
    return replace(believed, bodies=(fit.body,))


def accelerations(recording: Recording) -> Float[np.ndarray, "sensors samples"]:
    return recording.signals["acceleration"].values


def errors_percent(rig: Rig, recording: Recording) -> tuple[float, ...]:
    """Rms error of a free run over the rms of each response, after the first period."""
    measured, simulated = (accelerations(r)[:, PERIOD_SAMPLES:] for r in (recording, free_run(rig, recording.force_n)))
    return tuple((100 * (measured - simulated).std(axis=1) / measured.std(axis=1)).tolist())


def joint_mode(rig: Rig) -> tuple[float, float]:
    """Natural frequency (Hz) and damping ratio of the mode that carries the joint."""
    (body,) = rig.bodies
    modes = modes_of(rig, body)
    natural_hz, damping_ratios = modes.frequencies_hz(body.max_modes), modes.damping_ratios(body.max_modes)
    mode_indices = np.flatnonzero((natural_hz > JOINT_BAND_HZ[0]) & (natural_hz < JOINT_BAND_HZ[1]))
    if not mode_indices.size:
        raise RigError(f"no mode from {JOINT_BAND_HZ[0]} to {JOINT_BAND_HZ[1]} Hz; give the benchmark's own files")
    return float(natural_hz[mode_indices[-1]]), float(damping_ratios[mode_indices[-1]])


def error_table(diagnosis: LevelDiagnosis, level: str) -> Table:
    (hz_before, ratio_before), (hz_after, ratio_after) = diagnosis.joint_mode, diagnosis.joint_mode_corrected
    title = (
        f"Level {level}: {diagnosis.verdict}, {' + '.join(diagnosis.effects)}; the joint's mode from {hz_before:.2f} "
        f"to {hz_after:.2f} Hz, damping ratio {100 * ratio_before:.2f} to {100 * ratio_after:.2f} %"
    )
    table = console_table(title, ("free run, error % rms", *SENSOR_PLACE_WORDS))
    for level_run in diagnosis.runs:
        for rig_name in ("believed", "corrected", "equivalent_linear"):
            cells = (f"{error:.1f}" for error in getattr(level_run, rig_name))
            table.add_row(f"level {level_run.level}, {rig_name.replace('_', ' ')}", *cells)
    return table


DRAWN_BAND_HZ = (2.0, 15.0)
MIN_EXCITATION_SHARE = 0.05
"""Lines of less than this share of the force's largest are left out."""


def draw_spectra(recording: Recording, free_runs: Mapping[str, Recording], period_samples: int, path: Path) -> None:
    """Draw the excited lines in the last period of a recording and of free runs under its force."""
    force_amplitudes = _amplitudes(recording.force_n, period_samples)
    frequency_hz = np.fft.rfftfreq(period_samples, 1 / recording.rig.sample_rate_hz)
    is_drawn = (frequency_hz >= DRAWN_BAND_HZ[0]) & (frequency_hz <= DRAWN_BAND_HZ[1])
    is_drawn &= force_amplitudes > MIN_EXCITATION_SHARE * force_amplitudes.max()
    curves = [("measured", recording, GREY, 2.5)]
    curves += [(name, r, colour, 1.0) for (name, r), colour in zip(free_runs.items(), (BLUE, RED), strict=True)]

    def draw(figure: Figure) -> None:
        panels = figure.subplots(len(recording.rig.sensors), 1, sharex=True)
        for sensor_row, (axes, sensor) in enumerate(zip(panels, recording.rig.sensors, strict=True)):
            for name, record, colour, line_width in curves:
                amplitudes = _amplitudes(record.signals["acceleration"].values[sensor_row], period_samples)
                axes.semilogy(frequency_hz[is_drawn], amplitudes[is_drawn], color=colour, lw=line_width, label=name)
            axes.set(ylabel="m/s²", title=sensor.name)
        panels[-1].set(xlabel="frequency, Hz")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=3)

    write_bytes(picture(draw, 7.2, 6.0).png, path)


def _amplitudes(values: Float[np.ndarray, " samples"], period_samples: int) -> Float[np.ndarray, " lines"]:
    return np.asarray(2 / period_samples * np.abs(np.fft.rfft(values[-period_samples:])))


if __name__ == "__main__":
    run(app, "scenarios.f16")
