"""Excitation of a user's rig from its rig.json, for `rig record FILE.json`."""

from dataclasses import dataclass
from functools import cached_property

import msgspec
import numpy as np

from rig.errors import RigError, hint
from rig.model.decoding import explained
from rig.model.description import Rig
from rig.model.force_level import BAND_TO_SAMPLE_RATE, LOWEST_HZ, ForceLevel, rattling_level
from rig.simulation.excitation import Excitation, excitation_of

MIN_STEP_RATE_HZ = 2.0**14
"""Least rate of a plant's steps, Hz; the rate is the next multiple of the sampling rate."""
SHAKER_N = 2000.0
"""Force, N rms, of a large shaker in a laboratory: modal shakers that push through a stinger give some 50 to 500 N,
air-cooled vibrators 1 to 3 kN; more needs a test house."""
SHAKER_EXCITATIONS = ("gaussian", "burst", "sweep", "multisine", "stepped_sine")
"""Excitations that a shaker gives; a blow's peak is not so limited."""


class UserRigSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of a recording of a user's rig; None stands for a value that follows from the rig."""

    duration_s: float = 60.0
    step_s: float | None = None
    excitation: str = "gaussian"
    rms_n: float | None = None
    low_hz: float = LOWEST_HZ
    high_hz: float | None = None
    seed: int = 1


@dataclass(frozen=True)
class UserRig:
    """A user's rig with force, duration and step; the interface is that of the reference rigs."""

    machine: Rig
    settings: UserRigSettings

    @property
    def duration_s(self) -> float:
        return self.settings.duration_s

    @property
    def step_s(self) -> float:
        rate_hz = self.machine.sample_rate_hz
        return self.settings.step_s or 1 / (rate_hz * max(1, int(np.ceil(MIN_STEP_RATE_HZ / rate_hz))))

    def rig(self) -> Rig:
        return self.machine

    @property
    def high_hz(self) -> float:
        return self.settings.high_hz or BAND_TO_SAMPLE_RATE * self.machine.sample_rate_hz

    def force(self) -> Excitation:
        settings = self.settings
        unscaled_excitation = excitation_of(
            settings.excitation, rms_n=0.0, low_hz=settings.low_hz, high_hz=self.high_hz, seed=settings.seed
        )
        return msgspec.structs.replace(unscaled_excitation, rms_n=self.level.rms_n)

    @cached_property
    def level(self) -> ForceLevel:
        """Level of the force, N rms, as set or else chosen; zero where the base alone shakes."""
        if self.machine.is_on_ground(self.machine.forces[0]):
            return ForceLevel(0.0, "as the base alone shakes the rig")
        if self.settings.rms_n is not None:
            return ForceLevel(self.settings.rms_n, "as set")
        return rattling_level(self.machine, self.settings.low_hz, self.high_hz)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentence on a force that is beyond a shaker; none otherwise."""
        rms_n = self.level.rms_n
        if rms_n <= SHAKER_N or self.settings.excitation not in SHAKER_EXCITATIONS:
            return ()
        return (
            f"{rms_n:g} N rms is more than a large laboratory shaker gives (about {SHAKER_N:g} N rms); check the "
            "description's clearances and masses, or give --set rms_n=N",
        )


def user_rig(rig: Rig, settings: dict[str, str]) -> UserRig:
    """User's rig with settings given as text; raises RigError for an unknown setting or an invalid value."""
    if unknown_settings := sorted(set(settings) - set(UserRigSettings.__struct_fields__)):
        setting_names = UserRigSettings.__struct_fields__
        raise RigError(
            f"no setting {unknown_settings[0]!r}{hint(unknown_settings[0], setting_names)} for a rig of one's own, "
            f"only {', '.join(setting_names)}; change the rest in its file"
        )
    try:
        return UserRig(rig, msgspec.convert(settings, UserRigSettings, strict=False))
    except msgspec.ValidationError as error:
        raise RigError(
            f"{explained(error, settings, UserRigSettings)}; see `rig record --help` for the settings"
        ) from error


def default_plant_name(rig: Rig) -> str:
    """Name of the default plant: `ancf`, or `modal` if a body is a structure, which `ancf` cannot mesh."""
    return "ancf" if all(body.is_mass or body in rig.beams for body in rig.bodies) else "modal"
