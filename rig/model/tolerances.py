"""Tolerances (standard deviations) of a rig's description, and their defaults."""

from pathlib import Path

import msgspec
import numpy as np

from rig.errors import RigError
from rig.model.toml_file import read_toml

UNKNOWN = 1.0
"""Relative standard deviation from which on a value is no belief."""


def _check_tolerances(label: str, tolerances: msgspec.Struct) -> None:
    for field in tolerances.__struct_fields__:
        value = getattr(tolerances, field)
        if isinstance(value, (int, float)) and not (np.isfinite(value) and value >= 0):
            raise RigError(f"{label}: {field} is {value}; give a finite standard deviation, zero or above")


class SensorTolerance(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Tolerances of one sensor, where it differs from the others."""

    gain: float | None = None
    position_m: float | None = None
    delay_s: float | None = None
    cross_axis: float | None = None
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
    """Gain of every sensor, relative."""
    position_m: float = 1e-3
    """Position of every sensor."""
    delay_s: float = 1e-5
    """Delay of every sensor against the force."""
    cross_axis: float = 0.01
    """Share of the motion across its direction that every sensor shows, by its transverse sensitivity and the angle at
    which it is mounted; used by `identify contact` and `gap` where both directions are measured at one place."""
    high_pass_hz: float = 0.1
    """Corner of the first-order high-pass of an AC-coupled accelerometer that the description does not mention."""
    crosstalk: float = 2e-3
    """Share of a neighbouring channel's signal in every channel; used by `identify gap`."""
    lateral_motion: float = 1e-3
    """Motion across its axis that every accelerometer shows, relative to that along it; used by `identify gap`. A
    cross-axis share of 1 %, and lateral motion of a tenth."""
    force_gain: float = 3e-3
    force_noise_density: float = 0.0
    """One-sided, N/sqrt(Hz), for records without a quiet start that determines it."""
    mass: float = 3e-3
    """Mass of every body, relative."""
    frequency: float = 2e-3
    """Frequency, relative: common to all modes of a body, and of each mode."""
    damping: float = 0.3
    """Damping ratio, relative; likewise."""
    truncation: float = 1.0
    """What the modes that the description leaves out add to a sensor's signal, relative to what the highest three
    fifths of those that it has do, as far as they lie beyond the band; of every force at every place. Used by `identify
    check` and `contact`, and of strain gauges by `gap`."""
    clearance: float = 0.01
    """Clearance of every contact, relative; UNKNOWN or more where the value believed is nothing but a start."""
    stiffness: float = 0.01
    """Stiffness of every contact, likewise."""
    contact_damping_s: float = 1e-5
    """Damping of a contact over its stiffness."""
    unmodelled: float = 5e-4
    """Prior scale of the unexplained share of each acceleration; the record determines its value."""
    unmodelled_contact: float = 2e-3
    """Prior scale of the unexplained share of each contact force; likewise."""
    highest_hz: float | None = None
    """Frequency up to which the modes are valid; None: the whole band of the sensors."""
    sensors: dict[str, SensorTolerance] = {}
    """Tolerances of single sensors by name."""
    modes: dict[str, ModeTolerance] = {}
    """Tolerances of single modes by body and number: "barrel 3"."""

    def __post_init__(self) -> None:
        _check_tolerances("tolerances", self)
        for name, tolerance in (*self.sensors.items(), *self.modes.items()):
            _check_tolerances(f"tolerances of {name}", tolerance)

    @property
    def contacts_known(self) -> bool:
        """True if the description states clearances and stiffnesses that its author believes."""
        return max(self.clearance, self.stiffness) < UNKNOWN

    def of_sensor(self, name: str) -> "Tolerances":
        """Tolerances with the sensor's own values in place of the common ones."""
        return self._overridden(self.sensors.get(name))

    def of_mode(self, body_name: str, mode_number: int) -> "Tolerances":
        """Tolerances with the mode's own values in place of the common ones; modes count from 1."""
        return self._overridden(self.modes.get(f"{body_name} {mode_number}"))

    def _overridden(self, overrides: msgspec.Struct | None) -> "Tolerances":
        if overrides is None:
            return self
        values = {
            field: getattr(overrides, field)
            for field in overrides.__struct_fields__
            if getattr(overrides, field) is not None
        }
        return msgspec.structs.replace(self, **values)


LABORATORY = Tolerances()
EXACT = Tolerances(
    gain=0.0,
    position_m=0.0,
    delay_s=0.0,
    cross_axis=0.0,
    high_pass_hz=0.0,
    crosstalk=0.0,
    lateral_motion=0.0,
    force_gain=0.0,
    mass=0.0,
    frequency=0.0,
    damping=0.0,
    truncation=0.0,
    clearance=0.0,
    stiffness=0.0,
    contact_damping_s=0.0,
)
"""For a simulation of exactly this rig."""
TOLERANCES_BY_NAME = {"laboratory": LABORATORY, "exact": EXACT}


def tolerances_named(text: str) -> Tolerances:
    """`laboratory`, `exact`, or those of a TOML file; raises RigError for anything else."""
    if text in TOLERANCES_BY_NAME:
        return TOLERANCES_BY_NAME[text]
    if not Path(text).exists():
        raise RigError(f"{text}: no tolerances can be read there; give {', '.join(TOLERANCES_BY_NAME)} or a TOML file")
    return read_toml(Path(text), Tolerances, "file of tolerances", "identify/README.md")
