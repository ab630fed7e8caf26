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
from scipy.stats import binned_statistic

from identify.gaps.decision.answer import diagnose
from identify.gaps.page.report import write_all
from identify.pages.style import BLUE, GREY, RED, picture
from identify.signals.kinematics import kinematics
from identify.signals.spectra import force_band_hz
from rig.commands.command_line import Force, console_table, progress_bar, refuse_existing, run
from rig.errors import RigError
from rig.files import write_bytes, write_json
from rig.model.description import Rig
from rig.model.modes import modes_of
from rig.model.oscillator import Oscillator
from rig.recording import Recording
from scenarios.measured_data import SIMULATOR, free_run, one_mass_rig, recording_of, write_and_read

FILE = "SNLS80mV.csv"
SOURCE = f"Silverbox benchmark, {FILE}"
SAMPLE_RATE_HZ = 610.35
SAMPLE_COUNT = 131072
FORCE_N_PER_V, DISPLACEMENT_M_PER_V = 1e4, 0.1
"""Scales of the input and of the output, which make a rig of half a kilogram that moves by 5 mm."""
ARROW_SAMPLES, FIT_SAMPLES, VALIDATION_SAMPLES = slice(0, 40575), slice(40575, 84000), slice(84000, 127400)
"""Noise that grows; then ten multisines, of which one half is for searching and the other for deciding."""
MV_PER_M = 1e3 / DISPLACEMENT_M_PER_V
TRANSIENT_SAMPLES = 150
"""Samples at the start of the arrow that do not count, as is the custom with this benchmark."""
app = typer.Typer(pretty_exceptions_enable=False)


class SilverboxDiagnosis(msgspec.Struct, frozen=True, kw_only=True):
    """Verdict, and root mean square errors (mV) of free runs on the arrow: of the linear rig, of the one that the
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
    """Diagnose measured multisines, and judge the corrected rig on a record that was not used before."""
    refuse_existing(out / "silverbox.json", force, new_folder=True)
    named_recordings = zip(("fit", "validation", "arrow"), recordings(read_volts(data)), strict=True)
    out.mkdir(parents=True, exist_ok=True)
    fit, validation, arrow = (write_and_read(recording, out / f"{name}.mcap") for name, recording in named_recordings)
    with progress_bar("diagnosing") as progress:
        gap, diagnosed = diagnose(fit, validation, SIMULATOR, None, lambda _, x: progress(x))
    corrected = fit_free_run(diagnosed, fit)
    errors_mv_by_rig = {name: errors_mv(rig, arrow) for name, rig in (("linear", fit.rig), ("corrected", corrected))}
    diagnosis = SilverboxDiagnosis(
        verdict=gap.verdict,
        effects=gap.causes[0].effects if gap.causes else (),
        linear_mv=rms(errors_mv_by_rig["linear"]),
        diagnosed_mv=rms(errors_mv(diagnosed, arrow)),
        corrected_mv=rms(errors_mv_by_rig["corrected"]),
        linear=fit.rig,
        diagnosed=diagnosed,
        corrected=corrected,
    )
    write_all(gap, diagnosed, "Silverbox", out)
    write_json(diagnosis, out / "silverbox.json")
    draw_figures(validation, corrected, arrow, errors_mv_by_rig, out)
    console = Console()
    console.print(gap.sentence)
    console.print(error_table(diagnosis))
    console.print(
        f"records, gap.html, gap.json, rig.json, silverbox.json, where.png, arrow.png: in {out}", soft_wrap=True
    )


def recordings(volts: Float[np.ndarray, "2 samples"]) -> tuple[Recording, Recording, Recording]:
    """Recordings for fitting and for validation, and the arrow; the instruments' zeros are the means of the first.

    The rig that they carry is linear, as it explains the first one best. Whatever the displacement holds above the
    force's band, where such a rig does not move, its owner takes for the sensor's noise, white.
    """
    scales = np.array([[FORCE_N_PER_V], [DISPLACEMENT_M_PER_V]])
    signals = (volts - volts[:, FIT_SAMPLES].mean(axis=1, keepdims=True)) * scales
    unmodelled = recording_of(one_mass(1.0, 1.0, 0.0, 0.0), signals[:, FIT_SAMPLES], SOURCE)
    frequency_hz, density = welch(displacement_m(unmodelled), SAMPLE_RATE_HZ, nperseg=4096)
    is_noise_line = frequency_hz > force_band_hz(unmodelled.force_n, SAMPLE_RATE_HZ)[1]
    start_rig = linear_guess(unmodelled, float(np.sqrt(np.mean(density[is_noise_line]))))
    believed = fit_free_run(start_rig, unmodelled)
    fit, validation, arrow = (
        recording_of(believed, signals[:, samples], SOURCE)
        for samples in (FIT_SAMPLES, VALIDATION_SAMPLES, ARROW_SAMPLES)
    )
    return fit, validation, arrow


def one_mass(mass_kg: float, frequency_hz: float, damping_ratio: float, noise_density: float) -> Rig:
    """Rig of a mass on a spring, with the noise density of its displacement sensor, m/sqrt(Hz)."""
    mass = Oscillator(name="mass", mass_kg=mass_kg, frequency_hz=frequency_hz, damping_ratio=damping_ratio)
    rig = one_mass_rig("silverbox", mass, SAMPLE_RATE_HZ)
    return replace(rig, sensors=(replace(rig.sensors[0], noise_density=noise_density),))


def linear_guess(recording: Recording, noise_density: float) -> Rig:
    """One-mass rig by least squares of F = m a + c v + k x over time."""
    motion = kinematics(recording)
    state_rows = (motion.acceleration_m_per_s2, motion.velocity_m_per_s, motion.displacement_m)
    mass, damping, stiffness = np.linalg.lstsq(np.concatenate(state_rows).T, motion.force_n, rcond=None)[0]
    omega = np.sqrt(stiffness / mass)
    return one_mass(float(mass), float(omega / (2 * np.pi)), float(damping / (2 * mass * omega)), noise_density)


def fit_free_run(rig: Rig, recording: Recording) -> Rig:
    """Rig whose mass, frequency, damping and cubic springs minimise the squared error of its free run."""

    def scaled_rig(log_factors: Float[np.ndarray, " parameters"]) -> Rig:
        body, factors = mass_of(rig), [float(f) for f in np.exp(log_factors)]
        field_names = ("mass_kg", "frequency_hz", "damping_ratio")
        fields = {name: factor * getattr(body, name) for name, factor in zip(field_names, factors, strict=False)}
        springs_and_factors = zip(rig.springs, factors[3:], strict=True)
        springs = tuple(replace(s, cubic_n_per_m3=factor * s.cubic_n_per_m3) for s, factor in springs_and_factors)
        return replace(rig, bodies=(replace(body, **fields),), springs=springs)

    def error_mv(log_factors: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " samples"]:
        return errors_mv(scaled_rig(log_factors), recording)

    return scaled_rig(least_squares(error_mv, np.zeros(3 + len(rig.springs)), diff_step=1e-4, xtol=1e-6).x)


def errors_mv(rig: Rig, recording: Recording) -> Float[np.ndarray, " samples"]:
    """Measured output less that of a free run, mV, after the transient at the start."""
    return MV_PER_M * (displacement_m(recording) - displacement_m(free_run(rig, recording.force_n)))[TRANSIENT_SAMPLES:]


def rms(values: Float[np.ndarray, " samples"]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def error_table(diagnosis: SilverboxDiagnosis) -> Table:
    headings = ("rig", "error, mV rms", "frequency, Hz", "damping", "mass, kg", "cubic spring, N/m^3")
    title = f"Free run on the arrow; verdict: {diagnosis.verdict}, {' + '.join(diagnosis.effects)}"
    table = console_table(title, headings)
    for rig_name, rig, error_mv in (
        ("linear", diagnosis.linear, diagnosis.linear_mv),
        ("diagnosed", diagnosis.diagnosed, diagnosis.diagnosed_mv),
        ("identified again", diagnosis.corrected, diagnosis.corrected_mv),
    ):
        body, cubic_n_per_m3 = mass_of(rig), sum(spring.cubic_n_per_m3 for spring in rig.springs)
        (natural_hz,) = modes_of(rig, body).frequencies_hz(1)
        mass_kg = body.mass_kg + sum(mass.mass_kg for mass in rig.masses)
        cells = (error_mv, natural_hz, body.damping_ratio, mass_kg, cubic_n_per_m3)
        table.add_row(rig_name, *(f"{cell:.4g}" for cell in cells))
    return table


def read_volts(folder: Path | None) -> Float[np.ndarray, "2 samples"]:
    """Input and output of the whole record, V; raises RigError if there is none."""
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
            benchmark = nonlinear_benchmarks.Silverbox(train_test_split=False)
        except Exception as error:  # whatever a download raises
            raise RigError(
                f"nonlinear_benchmarks could not fetch the data ({error}); give --data FOLDER with {FILE}"
            ) from error
        volts = np.stack([benchmark.u, benchmark.y])
    if volts.shape[1] != SAMPLE_COUNT:
        raise RigError(f"{FILE}: has {volts.shape[1]} samples instead of {SAMPLE_COUNT}; give the benchmark's own file")
    return volts


def displacement_m(recording: Recording) -> Float[np.ndarray, " samples"]:
    return recording.signals["displacement"].values[0]


def mass_of(rig: Rig) -> Oscillator:
    (body,) = rig.bodies
    assert isinstance(body, Oscillator)
    return body


def draw_figures(
    validation: Recording,
    corrected: Rig,
    arrow: Recording,
    errors_mv: dict[str, Float[np.ndarray, " later"]],
    folder: Path,
) -> None:
    """Write where.png and arrow.png; the errors (mV) end with the arrow."""
    write_bytes(picture(partial(_force_over_displacement, validation, corrected)).png, folder / "where.png")
    write_bytes(picture(partial(_errors_over_time, arrow, errors_mv)).png, folder / "arrow.png")


def _force_over_displacement(recording: Recording, corrected: Rig, figure: Figure) -> None:
    """Draw the force beyond mass, damping and linear spring, F - m a - c v - k x, over the displacement x."""
    motion, body = kinematics(with_fields(recording, rig=corrected)), mass_of(corrected)
    (x,), (v,), (a,) = motion.displacement_m, motion.velocity_m_per_s, motion.acceleration_m_per_s2
    remaining_n = motion.force_n - body.mass_kg * a - body.damping_n_s_per_m * v - body.stiffness_n_per_m * x
    grid_m = np.linspace(x.min(), x.max(), 200)
    cubic_n_per_m3 = sum(spring.cubic_n_per_m3 for spring in corrected.springs)
    edges_m = np.quantile(x, np.linspace(0, 1, 31))
    centres_m, means_n = (binned_statistic(x, values, bins=edges_m).statistic for values in (x, remaining_n))
    axes = figure.subplots()
    axes.plot(1e3 * x, remaining_n, ".", ms=1, color=GREY, alpha=0.3, rasterized=True, label="measured")
    axes.plot(1e3 * centres_m, means_n, "o", ms=4, color=BLUE, label="its means")
    axes.plot(1e3 * grid_m, cubic_n_per_m3 * grid_m**3, color=RED, label="identified cubic spring")
    axes.set(xlabel="displacement, mm", ylabel="force beyond the linear part, N")
    axes.legend(markerscale=1.5)


def _errors_over_time(arrow: Recording, errors_mv: dict[str, Float[np.ndarray, " later"]], figure: Figure) -> None:
    """Draw the displacement, and the errors of both rigs (rms over 1 s), over time."""
    motion_axes, error_axes = figure.subplots(2, 1, sharex=True)
    sample_rate_hz = arrow.rig.sample_rate_hz
    displacement_m = arrow.signals["displacement"].values[0]
    motion_axes.plot(np.arange(displacement_m.size) / sample_rate_hz, 1e3 * displacement_m, color=GREY, lw=0.4)
    for (rig_name, error_mv), colour in zip(errors_mv.items(), (BLUE, RED), strict=True):
        time_s = np.arange(arrow.samples - error_mv.size, arrow.samples) / sample_rate_hz
        rms_mv = np.sqrt(uniform_filter1d(error_mv**2, round(sample_rate_hz)))
        error_axes.semilogy(time_s, rms_mv, color=colour, label=rig_name)
    motion_axes.set(ylabel="displacement, mm")
    error_axes.set(xlabel="time, s", ylabel="error of the free run, mV\n(rms over 1 s)")
    error_axes.legend()


if __name__ == "__main__":
    run(app, "scenarios.silverbox")
