"""Measured data: the Silverbox benchmark, an electronic oscillator with a hardening spring, as a rig believed linear.

python -m scenarios.silverbox --data FOLDER --out out/silverbox

FOLDER holds SNLS80mV.csv; without it the package nonlinear_benchmarks fetches the data. Wigren and Schoukens, "Three
free data sets for development and benchmarking in nonlinear system identification", ECC 2013.
"""

from dataclasses import replace as with_fields
from functools import partial
from importlib import import_module
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
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares
from scipy.signal import welch

from identify.gaps.decision.answer import diagnose
from identify.gaps.page.report import write_all
from identify.pages.style import BLUE, GREY, RED, picture
from identify.signals.kinematics import kinematics
from identify.signals.spectra import force_band
from rig.commands.command_line import Force, progress_bar, refuse_existing, run
from rig.errors import RigError
from rig.files import write_bytes, write_json
from rig.model.description import Rig, Sensor, Station
from rig.model.modes import modes_of
from rig.model.oscillator import Oscillator
from rig.recording import Recording, Signals, channel_groups, read, writing
from scenarios.free_runs import SIMULATOR, free_run

FILE = "SNLS80mV.csv"
SAMPLE_RATE_HZ = 610.35
SAMPLES = 131072
FORCE_N_PER_V, DISPLACEMENT_M_PER_V = 1e4, 0.1
"""What a volt of the input and one of the output stand for: these make a rig of half a kilogram that moves by 5 mm."""
ARROW, FIT, VALIDATION = slice(0, 40575), slice(40575, 84000), slice(84000, 127400)
"""Noise that grows; then ten multisines, of which one half is for searching and the other for deciding."""
MILLIVOLTS = 1e3 / DISPLACEMENT_M_PER_V
SETTLED = 150
"""Samples at the start of the arrow that do not count, as is the custom with this benchmark."""
app = typer.Typer(pretty_exceptions_enable=False)


class JudgedRig(msgspec.Struct, frozen=True, kw_only=True):
    """The verdict, and root mean square errors (mV) of free runs on the arrow: of the linear rig, of the one that the
    diagnosis corrected, and of that with its mass, frequency, damping and spring identified again."""

    verdict: str
    effects: tuple[str, ...]
    linear_mv: float
    diagnosed_mv: float
    corrected_mv: float
    linear: Rig
    diagnosed: Rig
    corrected: Rig


@app.command()
def silverbox(
    data: Annotated[Path | None, typer.Option(help=f"Folder with {FILE}.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for the records, the results and the figures.")] = Path(
        "out/silverbox"
    ),
    force: Force = False,
) -> None:
    """Diagnoses measured multisines, and judges the corrected rig on a record that was not used before."""
    refuse_existing(out / "silverbox.json", force, new_folder=True)
    parts = zip(("fit", "validation", "arrow"), recordings(measured(data)), strict=True)
    out.mkdir(parents=True, exist_ok=True)
    fit, validation, arrow = (written(recording, out / f"{name}.mcap") for name, recording in parts)
    with progress_bar("diagnosing") as progress:
        gap, diagnosed = diagnose(fit, validation, SIMULATOR, None, lambda _, x: progress(x))
    corrected = identified(diagnosed, fit)
    errors = {name: errors_mv(rig, arrow) for name, rig in (("linear", fit.rig), ("corrected", corrected))}
    judged = JudgedRig(
        verdict=gap.verdict,
        effects=gap.causes[0].effects if gap.causes else (),
        linear_mv=rms(errors["linear"]),
        diagnosed_mv=rms(errors_mv(diagnosed, arrow)),
        corrected_mv=rms(errors["corrected"]),
        linear=fit.rig,
        diagnosed=diagnosed,
        corrected=corrected,
    )
    write_all(gap, diagnosed, "Silverbox", out)
    write_json(judged, out / "silverbox.json")
    drawn(validation, corrected, arrow, errors, out)
    console = Console()
    console.print(gap.sentence)
    console.print(table(judged))
    console.print(
        f"records, gap.html, gap.json, rig.json, silverbox.json, where.png, arrow.png: in {out}", soft_wrap=True
    )


def recordings(volts: Float[np.ndarray, "2 samples"]) -> tuple[Recording, Recording, Recording]:
    """For searching, for deciding, and the arrow; the instruments' zeros are the means of the first.

    The rig that they carry is linear, as it explains the first one best. Whatever the displacement holds above the
    force's band, where such a rig does not move, its owner takes for the sensor's noise, white.
    """
    zeroed = (volts - volts[:, FIT].mean(axis=1, keepdims=True)) * np.array([[FORCE_N_PER_V], [DISPLACEMENT_M_PER_V]])
    fit = recording_of(one_mass(1.0, 1.0, 0.0, 0.0), zeroed[:, FIT])
    hz, density = welch(displacement_m(fit), SAMPLE_RATE_HZ, nperseg=4096)
    above = hz > force_band(fit.force_n, SAMPLE_RATE_HZ)[1]
    guess = linear_guess(fit, float(np.sqrt(np.mean(density[above]))))
    believed = identified(guess, fit)
    first, second, third = (recording_of(believed, zeroed[:, part]) for part in (FIT, VALIDATION, ARROW))
    return first, second, third


def one_mass(mass_kg: float, frequency_hz: float, damping_ratio: float, noise_density: float) -> Rig:
    at = Station("mass")
    return Rig(
        name="silverbox",
        bodies=(Oscillator(name="mass", mass_kg=mass_kg, frequency_hz=frequency_hz, damping_ratio=damping_ratio),),
        contacts=(),
        force_at=at,
        sensors=(Sensor(name="displacement", station=at, quantity="displacement", noise_density=noise_density),),
        sample_rate_hz=SAMPLE_RATE_HZ,
    )


def linear_guess(recording: Recording, noise_density: float) -> Rig:
    """By least squares of F = m a + c v + k x over time."""
    motion = kinematics(recording)
    rows = (motion.acceleration_m_per_s2, motion.velocity_m_per_s, motion.displacement_m)
    mass, damping, stiffness = np.linalg.lstsq(np.concatenate(rows).T, motion.force_n, rcond=None)[0]
    natural = np.sqrt(stiffness / mass)
    return one_mass(float(mass), float(natural / (2 * np.pi)), float(damping / (2 * mass * natural)), noise_density)


def identified(rig: Rig, recording: Recording) -> Rig:
    """Mass, frequency, damping and cubic springs for which the free run leaves the least squares of error."""

    def changed(logarithms: Float[np.ndarray, " parameters"]) -> Rig:
        body, factors = mass_of(rig), [float(f) for f in np.exp(logarithms)]
        names = ("mass_kg", "frequency_hz", "damping_ratio")
        new = {name: factor * getattr(body, name) for name, factor in zip(names, factors, strict=False)}
        cubic = zip(rig.springs, factors[3:], strict=True)
        springs = tuple(replace(s, cubic_n_per_m3=factor * s.cubic_n_per_m3) for s, factor in cubic)
        return replace(rig, bodies=(replace(body, **new),), springs=springs)

    def error(logarithms: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " samples"]:
        return errors_mv(changed(logarithms), recording)

    return changed(least_squares(error, np.zeros(3 + len(rig.springs)), diff_step=1e-4, xtol=1e-6).x)


def errors_mv(rig: Rig, recording: Recording) -> Float[np.ndarray, " samples"]:
    """The measured output less a free run, after the start."""
    return MILLIVOLTS * (displacement_m(recording) - displacement_m(free_run(rig, recording.force_n)))[SETTLED:]


def rms(values: Float[np.ndarray, " samples"]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def table(judged: JudgedRig) -> Table:
    found = Table(title=f"Free run on the arrow; verdict: {judged.verdict}, {' + '.join(judged.effects)}")
    for heading in ("rig", "error, mV rms", "frequency, Hz", "damping", "mass, kg", "cubic spring, N/m^3"):
        found.add_column(heading, justify="right" if found.columns else "left")
    for name, rig, error in (
        ("linear", judged.linear, judged.linear_mv),
        ("diagnosed", judged.diagnosed, judged.diagnosed_mv),
        ("identified again", judged.corrected, judged.corrected_mv),
    ):
        body, cubic = mass_of(rig), sum(s.cubic_n_per_m3 for s in rig.springs)
        (natural_hz,) = modes_of(rig, body).frequencies_hz(1)
        mass_kg = body.mass_kg + sum(m.mass_kg for m in rig.masses)
        numbers = (error, natural_hz, body.damping_ratio, mass_kg, cubic)
        found.add_row(name, *(f"{n:.4g}" for n in numbers))
    return found


def measured(folder: Path | None) -> Float[np.ndarray, "2 samples"]:
    """Input and output, V, all of the record; raises RigError where it is not to be had."""
    if folder is not None:
        path = folder / FILE
        try:
            volts = np.loadtxt(path, delimiter=",", skiprows=1, usecols=(0, 1)).T
        except OSError as error:
            raise RigError(f"{path}: cannot be opened ({error.strerror}); give the folder that holds it") from error
        except ValueError as error:
            raise RigError(f"{path}: is not the benchmark's file ({error}); fetch it again") from error
    else:
        try:
            nonlinear_benchmarks = import_module("nonlinear_benchmarks")
        except ImportError as error:
            raise RigError(
                f"no data: give --data FOLDER with {FILE}, or pip install nonlinear_benchmarks, which fetches it"
            ) from error
        try:
            whole = nonlinear_benchmarks.Silverbox(train_test_split=False)
        except Exception as error:  # whatever a download raises
            raise RigError(
                f"nonlinear_benchmarks could not fetch the data ({error}); give --data FOLDER with {FILE}"
            ) from error
        volts = np.stack([whole.u, whole.y])
    if volts.shape[1] != SAMPLES:
        raise RigError(f"{FILE}: has {volts.shape[1]} samples instead of {SAMPLES}; give the benchmark's own file")
    return volts


def recording_of(rig: Rig, signals: Float[np.ndarray, "2 samples"]) -> Recording:
    """Recording of a force (N) and a displacement (m)."""
    rows = zip(channel_groups(rig).items(), signals, strict=True)
    named = {name: Signals(channels, 0.0, row[None]) for (name, channels), row in rows}
    return Recording(rig, named, {"source": f"Silverbox benchmark, {FILE}"})


def displacement_m(recording: Recording) -> Float[np.ndarray, " samples"]:
    return recording.signals["displacement"].values[0]


def mass_of(rig: Rig) -> Oscillator:
    (body,) = rig.bodies
    assert isinstance(body, Oscillator)
    return body


def written(recording: Recording, path: Path) -> Recording:
    """Recording read back from the file."""
    with writing(path, recording.rig, channel_groups(recording.rig), recording.provenance) as file:
        for name, signals in recording.signals.items():
            file.append(name, signals.values)
    return read(path)


def drawn(
    validation: Recording,
    corrected: Rig,
    arrow: Recording,
    errors: dict[str, Float[np.ndarray, " later"]],
    folder: Path,
) -> None:
    """Writes where.png and arrow.png; errors (mV) end with the arrow."""
    write_bytes(picture(partial(_force_over_displacement, validation, corrected)).png, folder / "where.png")
    write_bytes(picture(partial(_errors_over_time, arrow, errors)).png, folder / "arrow.png")


def _force_over_displacement(recording: Recording, corrected: Rig, figure: Figure) -> None:
    """The force beyond mass, damping and linear spring, F - m a - c v - k x, over the displacement."""
    motion, body = kinematics(with_fields(recording, rig=corrected)), mass_of(corrected)
    (x,), (v,), (a,) = motion.displacement_m, motion.velocity_m_per_s, motion.acceleration_m_per_s2
    beyond = motion.force_n - body.mass_kg * a - body.damping_n_s_per_m * v - body.stiffness_n_per_m * x
    at = np.linspace(x.min(), x.max(), 200)
    cubic = sum(s.cubic_n_per_m3 for s in corrected.springs)
    edges = np.quantile(x, np.linspace(0, 1, 31))
    cell = np.clip(np.searchsorted(edges, x) - 1, 0, 29)
    count = np.bincount(cell, minlength=30)
    centre, mean = (np.bincount(cell, values, minlength=30) / count for values in (x, beyond))
    axes = figure.subplots()
    axes.plot(1e3 * x, beyond, ".", ms=1, color=GREY, alpha=0.3, rasterized=True, label="measured")
    axes.plot(1e3 * centre, mean, "o", ms=4, color=BLUE, label="its means")
    axes.plot(1e3 * at, cubic * at**3, color=RED, label="cubic spring, as found")
    axes.set(xlabel="displacement, mm", ylabel="force beyond the linear part, N")
    axes.legend(markerscale=1.5)


def _errors_over_time(arrow: Recording, errors: dict[str, Float[np.ndarray, " later"]], figure: Figure) -> None:
    """The displacement, and the errors of both rigs."""
    above, below = figure.subplots(2, 1, sharex=True)
    rate = arrow.rig.sample_rate_hz
    moved_m = arrow.signals["displacement"].values[0]
    above.plot(np.arange(moved_m.size) / rate, 1e3 * moved_m, color=GREY, lw=0.4)
    for (name, error), colour in zip(errors.items(), (BLUE, RED), strict=True):
        time_s = np.arange(arrow.samples - error.size, arrow.samples) / rate
        below.semilogy(time_s, np.sqrt(uniform_filter1d(error**2, round(rate))), color=colour, label=name)
    above.set(ylabel="displacement, mm")
    below.set(xlabel="time, s", ylabel="error of the free run, mV\n(rms over 1 s)")
    below.legend()


if __name__ == "__main__":
    run(app, "scenarios.silverbox")
