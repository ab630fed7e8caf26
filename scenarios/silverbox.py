"""Measured data: the Silverbox benchmark, an electronic oscillator with a hardening spring, as a rig believed linear.

python -m scenarios.silverbox --data FOLDER --out out/silverbox

FOLDER holds SNLS80mV.csv; without it the package nonlinear_benchmarks fetches the data. Wigren and Schoukens, "Three
free data sets for development and benchmarking in nonlinear system identification", ECC 2013.
"""

from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import typer
from jaxtyping import Float
from msgspec.structs import replace
from rich.console import Console
from rich.table import Table
from scipy.optimize import least_squares
from scipy.signal import welch

from identify.gaps.decision.answer import diagnose
from identify.gaps.page.report import write_all
from identify.signals.kinematics import kinematics
from identify.signals.spectra import force_band
from rig.commands.command_line import Force, progress_bar, refuse_existing, run
from rig.files import write_json
from rig.model.description import Rig, Sensor, Station
from rig.model.modes import modes_of
from rig.model.oscillator import Oscillator
from rig.recording import Recording
from scenarios.free_runs import SIMULATOR, free_run
from scenarios.silverbox_data import (
    ARROW,
    DISPLACEMENT_M_PER_V,
    FILE,
    FIT,
    FORCE_N_PER_V,
    MILLIVOLTS,
    SAMPLE_RATE_HZ,
    VALIDATION,
    displacement_m,
    mass_of,
    measured,
    recording_of,
    written,
)
from scenarios.silverbox_figures import drawn

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


if __name__ == "__main__":
    run(app, "scenarios.silverbox")
