"""Measured data: the Silverbox benchmark, an electronic oscillator with a hardening spring, as a rig believed linear.

python -m scenarios.silverbox --data FOLDER --out out/silverbox

FOLDER holds SNLS80mV.csv; without it the package nonlinear_benchmarks fetches the data. Wigren and Schoukens, "Three
free data sets for development and benchmarking in nonlinear system identification", ECC 2013.
"""

from pathlib import Path
from typing import Annotated

import matplotlib as mpl
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

from identify.gap.answer import diagnose
from identify.kinematics import kinematics
from identify.results import write_json
from identify.spectra import force_band
from identify.tolerances import Tolerances
from rig.command_line import Force, progress_bar, refuse_existing, run
from rig.description import Rig, Sensor, Station
from rig.errors import RigError
from rig.oscillator import Oscillator
from rig.plants.modal import simulate as modal
from rig.recording import Recording, Signals, channel_groups, read, writing
from rig.replay import replayed

FILE = "SNLS80mV.csv"
SAMPLE_RATE_HZ = 610.35
SAMPLES = 131072
FORCE_N_PER_V, DISPLACEMENT_M_PER_V = 1e4, 0.1
"""What a volt of the input and one of the output stand for: these make a rig of half a kilogram that moves by 5 mm."""
ARROW, FIT, VALIDATION = slice(0, 40575), slice(40575, 84000), slice(84000, 127400)
"""Noise that grows; then ten multisines, of which one half is for searching and the other for deciding."""
SETTLED = 150
"""Samples at the start of the arrow that do not count, as is the custom with this benchmark."""
OVERSAMPLED = 8
FITTED = Tolerances(gain=0.02, position_m=0.0, frequency=0.02, damping=0.12)
"""How exactly a linear rig is believed that comes from a fit which leaves an eighth of the motion unexplained."""
MILLIVOLTS = 1e3 / DISPLACEMENT_M_PER_V

app = typer.Typer(pretty_exceptions_enable=False)


class Judged(msgspec.Struct, frozen=True, kw_only=True):
    """The verdict, and root mean square errors (mV) of free runs on the arrow: of the linear rig, of it with what was
    diagnosed put into it, and of that with its mass, frequency, damping and spring identified again."""

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
    refuse_existing(out / "silverbox.json", force)
    out.mkdir(parents=True, exist_ok=True)
    parts = dict(zip(("fit", "validation", "arrow"), recordings(measured(data)), strict=True))
    fit, validation, arrow = (written(recording, out / f"{name}.mcap") for name, recording in parts.items())
    with progress_bar("diagnosing") as progress:
        gap, diagnosed = diagnose(fit, validation, simulated, None, lambda _, x: progress(x), FITTED)
    corrected = identified(diagnosed, fit)
    errors = {name: errors_mv(rig, arrow) for name, rig in (("linear", fit.rig), ("corrected", corrected))}
    judged = Judged(
        verdict=gap.verdict,
        effects=gap.causes[0].effects if gap.causes else (),
        linear_mv=rms(errors["linear"]),
        diagnosed_mv=rms(errors_mv(diagnosed, arrow)),
        corrected_mv=rms(errors["corrected"]),
        linear=fit.rig,
        diagnosed=diagnosed,
        corrected=corrected,
    )
    write_json(gap, out / "gap.json")
    write_json(judged, out / "silverbox.json")
    with mpl.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        where_figure(fit.rig, corrected, validation).savefig(out / "where.png", dpi=140)
        arrow_figure(arrow, errors).savefig(out / "arrow.png", dpi=140)
    console = Console()
    console.print(gap.sentence)
    console.print(table(judged))
    console.print(f"records, gap.json, silverbox.json, where.png and arrow.png in {out}", soft_wrap=True)


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
            import nonlinear_benchmarks
        except ImportError as error:
            raise RigError(
                f"no data: give --data FOLDER with {FILE}, or pip install nonlinear_benchmarks, which fetches it"
            ) from error
        whole = nonlinear_benchmarks.Silverbox(train_test_split=False)
        volts = np.stack([whole.u, whole.y])
    if volts.shape[1] != SAMPLES:
        raise RigError(f"{FILE}: has {volts.shape[1]} samples instead of {SAMPLES}; give the benchmark's own file")
    return volts


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


def recording_of(rig: Rig, signals: Float[np.ndarray, "2 samples"]) -> Recording:
    """Of a force (N) and a displacement (m)."""
    rows = zip(channel_groups(rig).items(), signals, strict=True)
    named = {name: Signals(channels, 0.0, row[None]) for (name, channels), row in rows}
    return Recording(rig, named, {"source": f"Silverbox benchmark, {FILE}"})


def displacement_m(recording: Recording) -> Float[np.ndarray, " samples"]:
    return recording.signals["displacement"].values[0]


def linear_guess(recording: Recording, noise_density: float) -> Rig:
    """By least squares of F = m a + c v + k x over time."""
    motion = kinematics(recording)
    rows = (motion.acceleration_m_per_s2, motion.velocity_m_per_s, motion.displacement_m)
    mass, damping, stiffness = np.linalg.lstsq(np.concatenate(rows).T, motion.force_n, rcond=None)[0]
    natural = np.sqrt(stiffness / mass)
    return one_mass(float(mass), float(natural / (2 * np.pi)), float(damping / (2 * mass * natural)), noise_density)


def free_run(rig: Rig, force_n: Float[np.ndarray, " samples"]) -> Recording:
    """From rest under a measured force, interpolated by a cubic, without the sensor's noise."""
    silent = replace(rig, sensors=tuple(replace(s, noise_density=0.0) for s in rig.sensors))
    return simulated(silent, silent, force_n, 1)


def simulated(believed: Rig, actual: Rig, force_n: Float[np.ndarray, " samples"], seed: int) -> Recording:
    return replayed(believed, actual, force_n, modal, 1 / (OVERSAMPLED * SAMPLE_RATE_HZ), seed)


def identified(rig: Rig, recording: Recording) -> Rig:
    """Mass, frequency, damping and cubic springs for which the free run leaves the least squares of error."""

    def changed(logarithms: Float[np.ndarray, " parameters"]) -> Rig:
        (body,), factors = rig.bodies, [float(f) for f in np.exp(logarithms)]
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


def written(recording: Recording, path: Path) -> Recording:
    """What is read back from the file."""
    with writing(path, recording.rig, channel_groups(recording.rig), recording.provenance) as file:
        for name, signals in recording.signals.items():
            file.append(name, signals.values)
    return read(path)


def table(judged: Judged) -> Table:
    found = Table(title=f"Free run on the arrow; verdict: {judged.verdict}, {' + '.join(judged.effects)}")
    for heading in ("rig", "error, mV rms", "frequency, Hz", "damping", "mass, kg", "cubic spring, N/m^3"):
        found.add_column(heading, justify="right" if found.columns else "left")
    for name, rig, error in (
        ("linear", judged.linear, judged.linear_mv),
        ("with what was diagnosed", judged.diagnosed, judged.diagnosed_mv),
        ("... and identified again", judged.corrected, judged.corrected_mv),
    ):
        (body,), cubic = rig.bodies, sum(s.cubic_n_per_m3 for s in rig.springs)
        numbers = (error, body.frequency_hz, body.damping_ratio, body.mass_kg, cubic)
        found.add_row(name, *(f"{n:.4g}" for n in numbers))
    return found


def where_figure(linear: Rig, corrected: Rig, recording: Recording) -> Figure:
    """The force that the linear rig lacks, F - m a - c v - k x, over the displacement."""
    motion = kinematics(recording)
    (x,), (v,), (a,) = motion.displacement_m, motion.velocity_m_per_s, motion.acceleration_m_per_s2
    (was,), (now,) = linear.bodies, corrected.bodies
    lacking = motion.force_n - was.mass_kg * a - was.damping_n_s_per_m * v - was.stiffness_n_per_m * x
    at = np.linspace(x.min(), x.max(), 200)
    softer = now.stiffness_n_per_m - was.stiffness_n_per_m
    cubic = sum(s.cubic_n_per_m3 for s in corrected.springs)
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    axes = figure.subplots()
    axes.plot(1e3 * x, lacking, ".", ms=1, color="#8a8a8a", alpha=0.3, rasterized=True, label="measured")
    axes.plot(1e3 * at, softer * at + cubic * at**3, color="#c8402f", label="stiffness and cubic spring found")
    axes.set(xlabel="displacement, mm", ylabel="force that the linear rig lacks, N")
    axes.legend(frameon=False)
    return figure


def arrow_figure(arrow: Recording, errors: dict[str, Float[np.ndarray, " samples"]]) -> Figure:
    """Output and errors of both rigs over time."""
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    time_s = np.arange(SETTLED, arrow.samples) / SAMPLE_RATE_HZ
    above.plot(time_s, MILLIVOLTS * displacement_m(arrow)[SETTLED:], color="#8a8a8a", lw=0.4)
    for (name, error), colour in zip(errors.items(), ("#1f5fa8", "#c8402f"), strict=True):
        below.semilogy(time_s, np.sqrt(uniform_filter1d(error**2, 610)), color=colour, label=name)
    above.set(ylabel="output, mV")
    below.set(xlabel="time, s", ylabel="error, mV rms of 1 s")
    below.legend(frameon=False)
    return figure


if __name__ == "__main__":
    run(app, "scenarios.silverbox")
