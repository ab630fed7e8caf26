"""Planned test: a rig under a Gaussian force, or on a base that shakes so, of a level, a band and a duration, without a
recording.

Notes for maintainers
1. The force is drawn at the sampling rate: a quiet second, which shows the noise, then independent Gaussian lines in
   the band, which set in smoothly. The simulator interpolates it. The motion of a base that shakes alone is the
   `base_motion` of the simulated rig; beside a force the base moves as rig.json says.
2. What the test is to be is never guessed silently: level and band that are not given are those of `rig record` for a
   rig.json, and those of the recording for a rig inside a recording.
"""

import msgspec
import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from identify.pages.wording import number
from identify.signals.kinematics import kinematics
from rig.errors import RigError
from rig.model.description import BaseMotion, Rig
from rig.model.force_level import BAND_TO_SAMPLE_RATE, LOWEST_HZ, rattling_level
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording
from rig.recording.interfaces import Simulate

QUIET_S, RISE_S = 1.0, 1 / 32
"""Quiet start, s, and time in which the force sets in, as in simulated recordings."""
DEFAULT_DURATION_S, SHORTEST_S, LONGEST_S = 60.0, 4.0, 1e5
"""Default, shortest and longest duration, s: in less than four seconds no contact is determined."""
MAX_BAND_TO_RATE = 0.25
"""Highest end of the band over the sampling rate: cubic interpolation of the force is right up to there."""
LOWEST_BASE_HZ, BASE_LOW_TO_HIGH_RATIO = 5.0, 0.25
"""Lower end of the band of a base, Hz, and its largest share of the upper end: at lower frequencies a table moves far,
bodies follow it, and gain errors of its sensors come near the clearances. Set by hand."""
BAND_POWER_SHARES = (0.01, 0.99)
"""Shares of a measured force's power that lie below the two ends of its band."""
FORCE_SEED_STREAM = 3
"""Last number of the force's seed: apart from that of the sensors' noise."""


class PlannedTest(msgspec.Struct, frozen=True, kw_only=True):
    """Test to be planned: rig, tolerances of its description, duration (s), and rms (N) of each force over its excited
    part, flat over the band (Hz). Where the base alone shakes the rig there is none, but its acceleration's rms."""

    rig: Rig
    tolerances: Tolerances
    duration_s: float
    force_rms_n: tuple[float, ...]
    base_rms_m_per_s2: float | None = None
    band_hz: tuple[float, float]

    def __post_init__(self) -> None:
        if not SHORTEST_S <= self.duration_s <= LONGEST_S:
            raise RigError(
                f"the planned test lasts {self.duration_s:g} s; give {SHORTEST_S:g} to {LONGEST_S:g} s with --duration"
            )
        is_shaken = self.base_rms_m_per_s2 is not None
        if not all(0 < rms < np.inf for rms in self.levels):
            option = "--base-rms" if is_shaken else "--force-rms"
            raise RigError(f"the planned level is {self.level_text}; give a finite one above zero with {option}")
        low_hz, high_hz = self.band_hz
        highest_hz = MAX_BAND_TO_RATE * self.rig.sample_rate_hz
        if not (0 <= low_hz < high_hz <= highest_hz) or (is_shaken and not low_hz):
            raise RigError(
                f"the planned band is {low_hz:g} to {high_hz:g} Hz; give 0 {'<' if is_shaken else '<='} low < high <= "
                f"{highest_hz:g} Hz, a quarter of sample_rate_hz, with --band"
            )
        if (high_hz - low_hz) * (self.duration_s - QUIET_S) < 2:
            raise RigError(
                f"the band {low_hz:g} to {high_hz:g} Hz holds no line of {self.duration_s:g} s; give a wider --band or "
                "a longer --duration"
            )

    def with_duration(self, duration_s: float) -> "PlannedTest":
        return replace(self, duration_s=duration_s)

    def with_level_factor(self, level_factor: float) -> "PlannedTest":
        """Test with every level that many times as high."""
        if self.base_rms_m_per_s2 is not None:
            return replace(self, base_rms_m_per_s2=level_factor * self.base_rms_m_per_s2)
        return replace(self, force_rms_n=tuple(level_factor * rms_n for rms_n in self.force_rms_n))

    @property
    def levels(self) -> tuple[float, ...]:
        """Rms of each force, N, or of the base's acceleration, m/s^2."""
        return self.force_rms_n if self.base_rms_m_per_s2 is None else (self.base_rms_m_per_s2,)

    @property
    def level_text(self) -> str:
        """Level of the forces, or of the base, in words."""
        rms_texts = " and ".join(number(rms, 3) for rms in dict.fromkeys(self.levels))
        return f"{rms_texts} {'N' if self.base_rms_m_per_s2 is None else 'm/s²'} rms"


def planned_test(
    source: Rig | Recording,
    duration_s: float | None = None,
    force_rms_n: float | None = None,
    band_hz: tuple[float, float] | None = None,
    tolerances: Tolerances | None = None,
    base_rms_m_per_s2: float | None = None,
) -> PlannedTest:
    """Planned test of a rig, or of the rig inside a recording, which then gives duration, levels and band, too.

    What is not given: 60 s, the band of `rig record`, and the force that moves the contacts by four clearances. Of a
    base that alone shakes the rig: what `base_motion` of rig.json says; else a band from 5 Hz on, and the acceleration
    that moves the contacts so.
    Raises RigError for values that make no test.
    """
    rig = source.rig if isinstance(source, Recording) else source
    is_shaken = rig.is_on_ground(rig.forces[0])
    given_level = base_rms_m_per_s2 if is_shaken else force_rms_n
    _check_level_option(rig, is_shaken, force_rms_n if is_shaken else base_rms_m_per_s2)
    levels: tuple[float, ...] | None = None if given_level is None else (given_level,) * len(rig.forces)
    if isinstance(source, Recording) and np.any(measured_excitations := _measured_excitations(source, is_shaken)):
        duration_s = duration_s or source.samples / rig.sample_rate_hz
        band_hz = band_hz or _measured_band_hz(measured_excitations, rig.sample_rate_hz)
        levels = levels or tuple(float(_excited_rms(row)) for row in measured_excitations)
    if is_shaken and rig.base_motion:
        levels = levels or (rig.base_motion.acceleration_rms_m_per_s2,)
        band_hz = band_hz or (rig.base_motion.low_hz, rig.base_motion.high_hz)
    high_hz = BAND_TO_SAMPLE_RATE * rig.sample_rate_hz
    band_hz = band_hz or (min(LOWEST_BASE_HZ, BASE_LOW_TO_HIGH_RATIO * high_hz) if is_shaken else LOWEST_HZ, high_hz)
    levels = levels or (rattling_level(rig, *band_hz).rms_n,) * len(rig.forces)
    return PlannedTest(
        rig=rig,
        tolerances=tolerances or rig.tolerances or LABORATORY,
        duration_s=DEFAULT_DURATION_S if duration_s is None else duration_s,
        force_rms_n=() if is_shaken else levels,
        base_rms_m_per_s2=levels[0] if is_shaken else None,
        band_hz=band_hz,
    )


def _check_level_option(rig: Rig, is_shaken: bool, other_level: float | None) -> None:
    """Raise RigError if the level of a force is given where the base shakes the rig, or the other way round."""
    if other_level is not None:
        shaker_words, option = ("its base alone", "--base-rms") if is_shaken else ("a measured force", "--force-rms")
        raise RigError(f"rig {rig.name!r} is shaken by {shaker_words}; give its level with {option}")


def _measured_excitations(recording: Recording, is_shaken: bool) -> Float[np.ndarray, "excitations samples"]:
    """Measured forces, N, or the inertial force on each kilogram by the motion of the base, N/kg."""
    return kinematics(recording, "auto").forces_n if is_shaken else recording.forces_n


def simulated_recording(test: PlannedTest, actual_rig: Rig, simulate: Simulate, seed: int) -> Recording:
    """Recording of the planned test, drawn with a seed, of an actual rig.

    Raises RigError where it cannot be simulated.
    """
    if test.base_rms_m_per_s2 is not None:
        (low_hz, high_hz), rms_m_per_s2 = test.band_hz, test.base_rms_m_per_s2
        base_motion = BaseMotion(
            acceleration_rms_m_per_s2=rms_m_per_s2, low_hz=low_hz, high_hz=high_hz, seed=seed, start_s=QUIET_S
        )
        actual_rig = replace(actual_rig, base_motion=base_motion)
    return simulate(test.rig, actual_rig, random_forces_n(test, seed), seed)


def random_forces_n(test: PlannedTest, seed: int) -> Float[np.ndarray, "forces samples"]:
    """Forces of the planned test, drawn with a seed, N; zero where the base alone shakes the rig."""
    rate_hz = test.rig.sample_rate_hz
    sample_count, quiet_count = round(test.duration_s * rate_hz), round(QUIET_S * rate_hz)
    excited_count = sample_count - quiet_count
    frequency_hz = np.fft.rfftfreq(excited_count, 1 / rate_hz)
    low_hz, high_hz = test.band_hz
    in_band_mask = (frequency_hz >= low_hz) & (frequency_hz <= high_hz) & (frequency_hz > 0)
    forces_n = np.zeros((len(test.rig.forces), sample_count))
    rise_weights = np.sin(np.pi / 2 * np.clip(np.arange(excited_count) / rate_hz / RISE_S, 0, 1)) ** 2
    for force_index, rms_n in enumerate(test.force_rms_n):
        line_parts = (
            np.random.default_rng([seed, force_index, FORCE_SEED_STREAM]).standard_normal((2, frequency_hz.size))
            * in_band_mask
        )
        gaussian_force = np.fft.irfft(line_parts[0] + 1j * line_parts[1], excited_count) * rise_weights
        forces_n[force_index, quiet_count:] = rms_n * gaussian_force / np.sqrt(np.mean(gaussian_force**2))
    return forces_n


def _excited_rms(excitation: Float[np.ndarray, " samples"]) -> float:
    """Root mean square of an excitation from its first to its last sample of a hundredth of the peak on."""
    indices = np.flatnonzero(np.abs(excitation) > 0.01 * np.max(np.abs(excitation), initial=0.0))
    return float(np.sqrt(np.mean(excitation[indices[0] : indices[-1] + 1] ** 2))) if indices.size else 0.0


def _measured_band_hz(excitations: Float[np.ndarray, "excitations samples"], rate_hz: float) -> tuple[float, float]:
    """Band that holds all but two hundredths of the power of the excitations, Hz."""
    cumulative_power = np.cumsum(np.sum(np.abs(np.fft.rfft(excitations, axis=1)) ** 2, axis=0)[1:])
    end_lines = np.searchsorted(cumulative_power, np.array(BAND_POWER_SHARES) * cumulative_power[-1]) + 1
    low_hz, high_hz = end_lines * rate_hz / excitations.shape[1]
    return float(low_hz), float(min(high_hz, MAX_BAND_TO_RATE * rate_hz))
