"""Measured data: the Silverbox benchmark, an electronic oscillator with a hardening spring, as a rig believed linear.

python -m scenarios.silverbox --data FOLDER --out out/silverbox

FOLDER holds SNLS80mV.csv; without it the package nonlinear_benchmarks fetches the data. Wigren and Schoukens, "Three
free data sets for development and benchmarking in nonlinear system identification", ECC 2013.
"""

from collections.abc import Sequence
from functools import partial
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

from identify.gap.diagnose import Outcome, diagnosed
from identify.gap.floor import floor_of
from identify.gap.spectra import record_of
from identify.kinematics import kinematics
from identify.spectra import force_band
from identify.tolerances import Tolerances
from rig.command_line import Force, progress_bar, refuse_existing, run
from rig.description import Rig, Sensor, Station
from rig.errors import RigError
from rig.oscillator import Oscillator
from rig.plants.modal import simulate as modal
from rig.recording import Recording, Signals, channel_groups, writing
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


class Judged(msgspec.Struct, frozen=True):
    """Root mean square errors of free runs on the arrow, mV: the linear rig, with the diagnosed effects put into it,
    and with its linear part identified anew beside them."""

    verdict: str
    effects: tuple[str, ...]
    linear_mv: float
    diagnosed_mv: float
    corrected_mv: float
    linear: Rig
    corrected: Rig


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
    return Recording(rig, {name: Signals(c, 0.0, row[None]) for (name, c), row in rows}, {"source": f"Silverbox {FILE}"})


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
    run = free_run(rig, recording.force_n)
    return MILLIVOLTS * (displacement_m(recording) - displacement_m(run))[SETTLED:]


def rms(values: Float[np.ndarray, " samples"]) -> float:
    return float(np.sqrt(np.mean(values**2)))
