"""Tolerances of a rig's description, and their defaults: the one place where they are written."""

from pathlib import Path

import msgspec
import numpy as np

from rig.errors import RigError
from rig.model.toml_file import read_toml


def _check(what: str, given: msgspec.Struct) -> None:
    for field in given.__struct_fields__:
        value = getattr(given, field)
        if isinstance(value, (int, float)) and not (np.isfinite(value) and value >= 0):
            raise RigError(f"{what}: {field} is {value}; give a finite standard deviation, zero or above")


class SensorTolerance(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Tolerances of one sensor, where it differs from the others."""

    gain: float | None = None
    position_m: float | None = None
    delay_s: float | None = None
    high_pass_hz: float | None = None


class ModeTolerance(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Tolerances of one mode, where it differs from the others."""

    frequency: float | None = None
    damping: float | None = None


class Tolerances(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Standard deviations of what the description states; relative ones are shares of the value believed.

    The defaults fit a laboratory that works with care: calibrated sensors, stations measured with a ruler, modes from a
    model that was compared with a test.
    """

    gain: float = 2e-3
    """Of every sensor."""
    position_m: float = 1e-3
    """Of every sensor's station."""
    delay_s: float = 1e-5
    """Of every sensor against the force."""
    high_pass_hz: float = 0.1
    """Corner of the first-order high-pass of an AC-coupled accelerometer that the description does not mention."""
    crosstalk: float = 2e-3
    """Share of the signal of a channel beside it that every channel shows; where `identify gap` looks for effects."""
    force_gain: float = 3e-3
    force_noise_density: float = 0.0
    """One-sided, N/sqrt(Hz), where no quiet start of the record tells it."""
    mass: float = 3e-3
    """Of every body."""
    frequency: float = 2e-3
    """Of all modes of a body together, and of each mode by itself."""
    damping: float = 0.3
    """Likewise."""
    clearance: float = 0.01
    stiffness: float = 0.01
    contact_damping_s: float = 1e-5
    """Damping of a contact over its stiffness."""
    unmodelled: float = 5e-4
    """Share of each acceleration that no model of this kind explains: the prior scale; the record tells the rest."""
    unmodelled_contact: float = 2e-3
    """Share of each contact force that no law of this kind explains: likewise."""
    highest_hz: float | None = None
    """Up to where the modes are believed; None: all that the sensors tell."""
    sensors: dict[str, SensorTolerance] = {}
    """By the sensor's name."""
    modes: dict[str, ModeTolerance] = {}
    """By body and number: "barrel 3"."""

    def __post_init__(self) -> None:
        _check("tolerances", self)
        for name, one in (*self.sensors.items(), *self.modes.items()):
            _check(f"tolerances of {name}", one)

    def of_sensor(self, name: str) -> "Tolerances":
        """Tolerances with the sensor's own values in place of the common ones."""
        return self._with(self.sensors.get(name))

    def of_mode(self, body: str, number: int) -> "Tolerances":
        """Tolerances with the mode's own values in place of the common ones; modes count from 1."""
        return self._with(self.modes.get(f"{body} {number}"))

    def _with(self, own: msgspec.Struct | None) -> "Tolerances":
        if own is None:
            return self
        given = {field: getattr(own, field) for field in own.__struct_fields__ if getattr(own, field) is not None}
        return msgspec.structs.replace(self, **given)


LABORATORY = Tolerances()
EXACT = Tolerances(
    gain=0.0,
    position_m=0.0,
    delay_s=0.0,
    high_pass_hz=0.0,
    crosstalk=0.0,
    force_gain=0.0,
    mass=0.0,
    frequency=0.0,
    damping=0.0,
    clearance=0.0,
    stiffness=0.0,
    contact_damping_s=0.0,
)
"""The description holds exactly: a simulation of the very rig."""
NAMED = {"laboratory": LABORATORY, "exact": EXACT}


def tolerances_named(text: str) -> Tolerances:
    """`laboratory`, `exact`, or those of a TOML file; raises RigError for anything else."""
    if text in NAMED:
        return NAMED[text]
    if not Path(text).exists():
        raise RigError(f"{text}: no tolerances can be read there; give {', '.join(NAMED)} or a TOML file")
    return read_toml(Path(text), Tolerances, "file of tolerances", "rig.model.tolerances")
