"""Excitation of a user's rig from its rig.json, for `rig record FILE.json`."""

from dataclasses import dataclass

import msgspec
import numpy as np

from rig.errors import RigError
from rig.model.description import Rig
from rig.model.force_level import BAND_TO_SAMPLE_RATE, LOWEST_HZ, rattling_n
from rig.simulation.excitation import Excitation, excitation_of

MIN_STEP_RATE_HZ = 2.0**14
"""Least rate of a plant's steps, Hz; the rate is the next multiple of the sampling rate."""


class Drive(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of a recording of a user's rig; None stands for a value that follows from the rig."""

    duration_s: float = 60.0
    step_s: float | None = None
    excitation: str = "gaussian"
    rms_n: float | None = None
    low_hz: float = LOWEST_HZ
    high_hz: float | None = None
    seed: int = 1


@dataclass(frozen=True)
class OwnRig:
    """A user's rig with force, duration and step; the interface is that of the reference rigs."""

    machine: Rig
    drive: Drive

    @property
    def duration_s(self) -> float:
        return self.drive.duration_s

    @property
    def step_s(self) -> float:
        rate = self.machine.sample_rate_hz
        return self.drive.step_s or 1 / (rate * max(1, int(np.ceil(MIN_STEP_RATE_HZ / rate))))

    def rig(self) -> Rig:
        return self.machine

    def force(self) -> Excitation:
        drive, rate = self.drive, self.machine.sample_rate_hz
        high_hz = drive.high_hz or BAND_TO_SAMPLE_RATE * rate
        unit_free = excitation_of(drive.excitation, rms_n=0.0, low_hz=drive.low_hz, high_hz=high_hz, seed=drive.seed)
        rms_n = rattling_n(self.machine, drive.low_hz, high_hz) if drive.rms_n is None else drive.rms_n
        return msgspec.structs.replace(unit_free, rms_n=rms_n)


def own_rig(rig: Rig, settings: dict[str, str]) -> OwnRig:
    """User's rig with settings given as text; raises RigError for an unknown setting or an invalid value."""
    if unknown := sorted(set(settings) - set(Drive.__struct_fields__)):
        raise RigError(
            f"no setting {unknown[0]!r} for a rig of one's own, only {', '.join(Drive.__struct_fields__)}; change the "
            "rest in its file"
        )
    try:
        return OwnRig(rig, msgspec.convert(settings, Drive, strict=False))
    except msgspec.ValidationError as error:
        raise RigError(f"{error}; see `rig record --help` for the settings") from error


def plant_for(rig: Rig) -> str:
    """Name of the default plant: `ancf`, or `modal` if a body is a structure, which `ancf` cannot mesh."""
    return "ancf" if all(b.is_mass or b in rig.beams for b in rig.bodies) else "modal"
