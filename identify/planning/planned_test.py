"""Planned test: a rig under a Gaussian force of a level, a band and a duration, without a recording.

Notes for maintainers
1. The force is drawn at the sampling rate: a quiet second, which shows the noise, then independent Gaussian lines in
   the band, which set in smoothly. The simulator interpolates it.
2. What the test is to be is never guessed silently: level and band that are not given are those of `rig record` for a
   rig.json, and those of the recording for a rig inside a recording.
"""

import msgspec
import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from identify.pages.wording import number
from identify.signals.measured_base import refuse_measured_base
from rig.errors import RigError
from rig.model.description import Rig
from rig.model.force_level import BAND_TO_SAMPLE_RATE, LOWEST_HZ, rattling_level
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording

QUIET_S, RISE_S = 1.0, 1 / 32
"""Quiet start, s, and time in which the force sets in, as in simulated recordings."""
DEFAULT_DURATION_S, SHORTEST_S, LONGEST_S = 60.0, 4.0, 1e5
"""Default, shortest and longest duration, s: in less than four seconds no contact is determined."""
MAX_BAND_TO_RATE = 0.25
"""Highest end of the band over the sampling rate: cubic interpolation of the force is right up to there."""
BAND_POWER_SHARES = (0.01, 0.99)
"""Shares of a measured force's power that lie below the two ends of its band."""
FORCE_SEED_STREAM = 3
"""Last number of the force's seed: apart from that of the sensors' noise."""


class PlannedTest(msgspec.Struct, frozen=True, kw_only=True):
    """Test to be planned: rig, tolerances of its description, duration (s), and rms (N) of each force over its excited
    part, flat over the band (Hz)."""

    rig: Rig
    tolerances: Tolerances
    duration_s: float
    force_rms_n: tuple[float, ...]
    band_hz: tuple[float, float]

    def __post_init__(self) -> None:
        if not SHORTEST_S <= self.duration_s <= LONGEST_S:
            raise RigError(
                f"the planned test lasts {self.duration_s:g} s; give {SHORTEST_S:g} to {LONGEST_S:g} s with --duration"
            )
        if not all(0 < rms_n < np.inf for rms_n in self.force_rms_n):
            level_text = ", ".join(f"{rms_n:g}" for rms_n in self.force_rms_n)
            raise RigError(f"the planned force is {level_text} N rms; give a finite level above zero with --force-rms")
        low_hz, high_hz = self.band_hz
        highest_hz = MAX_BAND_TO_RATE * self.rig.sample_rate_hz
        if not (0 <= low_hz < high_hz <= highest_hz):
            raise RigError(
                f"the planned force has the band {low_hz:g} to {high_hz:g} Hz; give 0 <= low < high <= "
                f"{highest_hz:g} Hz, a quarter of sample_rate_hz, with --band"
            )
        if (high_hz - low_hz) * (self.duration_s - QUIET_S) < 2:
            raise RigError(
                f"the band {low_hz:g} to {high_hz:g} Hz holds no line of {self.duration_s:g} s; give a wider --band or "
                "a longer --duration"
            )

    def with_duration(self, duration_s: float) -> "PlannedTest":
        return replace(self, duration_s=duration_s)

    @property
    def level_text(self) -> str:
        """Level of the forces in words."""
        rms_texts = " and ".join(number(rms_n, 3) for rms_n in dict.fromkeys(self.force_rms_n))
        return f"{rms_texts} N rms"


def planned_test(
    source: Rig | Recording,
    duration_s: float | None = None,
    force_rms_n: float | None = None,
    band_hz: tuple[float, float] | None = None,
    tolerances: Tolerances | None = None,
) -> PlannedTest:
    """Planned test of a rig, or of the rig inside a recording, which then gives duration, levels and band, too.

    What is not given: 60 s, the band of `rig record`, and the force that moves the contacts by four clearances.
    Raises RigError for values that make no test.
    """
    rig = source.rig if isinstance(source, Recording) else source
    refuse_measured_base(rig, "identify plan")
    levels_n: tuple[float, ...] | None = None if force_rms_n is None else (force_rms_n,) * len(rig.forces)
    if isinstance(source, Recording) and np.any(source.forces_n):
        duration_s = duration_s or source.samples / rig.sample_rate_hz
        band_hz = band_hz or _measured_band_hz(source.forces_n, rig.sample_rate_hz)
        levels_n = levels_n or tuple(float(_excited_rms_n(row)) for row in source.forces_n)
    band_hz = band_hz or (LOWEST_HZ, BAND_TO_SAMPLE_RATE * rig.sample_rate_hz)
    return PlannedTest(
        rig=rig,
        tolerances=tolerances or rig.tolerances or LABORATORY,
        duration_s=DEFAULT_DURATION_S if duration_s is None else duration_s,
        force_rms_n=levels_n or (rattling_level(rig, *band_hz).rms_n,) * len(rig.forces),
        band_hz=band_hz,
    )


def drawn_forces_n(test: PlannedTest, seed: int) -> Float[np.ndarray, "forces samples"]:
    """Forces of the planned test, drawn with a seed, N."""
    rate_hz = test.rig.sample_rate_hz
    sample_count, quiet_count = round(test.duration_s * rate_hz), round(QUIET_S * rate_hz)
    excited_count = sample_count - quiet_count
    frequency_hz = np.fft.rfftfreq(excited_count, 1 / rate_hz)
    low_hz, high_hz = test.band_hz
    in_band = (frequency_hz >= low_hz) & (frequency_hz <= high_hz) & (frequency_hz > 0)
    forces_n = np.zeros((len(test.force_rms_n), sample_count))
    rise_weights = np.sin(np.pi / 2 * np.clip(np.arange(excited_count) / rate_hz / RISE_S, 0, 1)) ** 2
    for force_index, rms_n in enumerate(test.force_rms_n):
        line_values = (
            np.random.default_rng([seed, force_index, FORCE_SEED_STREAM]).standard_normal((2, frequency_hz.size))
            * in_band
        )
        gaussian_force = np.fft.irfft(line_values[0] + 1j * line_values[1], excited_count) * rise_weights
        forces_n[force_index, quiet_count:] = rms_n * gaussian_force / np.sqrt(np.mean(gaussian_force**2))
    return forces_n


def _excited_rms_n(force_n: Float[np.ndarray, " samples"]) -> float:
    """Root mean square of a force from its first to its last sample of a hundredth of the peak on, N."""
    excited = np.flatnonzero(np.abs(force_n) > 0.01 * np.max(np.abs(force_n), initial=0.0))
    return float(np.sqrt(np.mean(force_n[excited[0] : excited[-1] + 1] ** 2))) if excited.size else 0.0


def _measured_band_hz(forces_n: Float[np.ndarray, "forces samples"], rate_hz: float) -> tuple[float, float]:
    """Band that holds all but two hundredths of the power of the forces, Hz."""
    cumulative_power = np.cumsum(np.sum(np.abs(np.fft.rfft(forces_n, axis=1)) ** 2, axis=0)[1:])
    edge_lines = np.searchsorted(cumulative_power, np.array(BAND_POWER_SHARES) * cumulative_power[-1]) + 1
    low_hz, high_hz = edge_lines * rate_hz / forces_n.shape[1]
    return float(low_hz), float(min(high_hz, MAX_BAND_TO_RATE * rate_hz))
