"""A true machine and its instruments as a value; it knows nothing of rigs."""

from collections.abc import Callable
from typing import Any, Literal

import msgspec
from msgspec.structs import replace

from tests.campaigns.worlds.laws import StopLaw

MODES = 24
"""Of a beam."""
Quantity = Literal["displacement", "velocity", "acceleration"]


class Place(msgspec.Struct, frozen=True):
    """A point of a body, metres from its left end; a single mass has only 0."""

    body: str
    position_m: float = 0.0


class TrueBeam(msgspec.Struct, frozen=True, kw_only=True):
    """A uniform beam, clamped at its left end or free, with what is fixed to it.

    Every mode's frequency and damping ratio is multiplied by a factor of its own. The modulus falls steadily by the
    share `fall` over `fall_s`. A clamp with a rotational stiffness turns. masses and springs: position_m and kg, N/m.
    """

    name: str
    clamped: bool
    length_m: float
    width_m: float
    thickness_m: float
    youngs_modulus_pa: float
    density_kg_per_m3: float
    damping_ratio: float
    frequency_factors: tuple[float, ...] = (1.0,) * MODES
    damping_factors: tuple[float, ...] = (1.0,) * MODES
    clamp_n_m_per_rad: float | None = None
    masses: tuple[tuple[float, float], ...] = ()
    springs: tuple[tuple[float, float], ...] = ()
    fall: float = 0.0
    fall_s: float = 30.0

    @property
    def bending_stiffness_n_m2(self) -> float:
        return self.youngs_modulus_pa * self.width_m * self.thickness_m**3 / 12

    @property
    def mass_per_length_kg_per_m(self) -> float:
        return self.density_kg_per_m3 * self.width_m * self.thickness_m


class Lumped(msgspec.Struct, frozen=True, kw_only=True):
    """Masses in a row, each on a spring to the ground and springs between neighbours: one mass, a chain, a frame.

    Springs of 0 are none. Every mode's frequency and damping ratio is multiplied by a factor of its own; a mode of
    frequency 0 has no damping. Between two masses the body moves on a straight line. masses and springs: position_m and
    kg, N/m.
    """

    name: str
    positions_m: tuple[float, ...]
    masses_kg: tuple[float, ...]
    grounded_n_per_m: tuple[float, ...]
    between_n_per_m: tuple[float, ...] = ()
    damping_ratio: float
    frequency_factors: tuple[float, ...]
    damping_factors: tuple[float, ...]
    masses: tuple[tuple[float, float], ...] = ()
    springs: tuple[tuple[float, float], ...] = ()

    @property
    def length_m(self) -> float:
        return self.positions_m[-1]


class LooseMass(msgspec.Struct, frozen=True):
    """A mass that moves transversely and touches the beams by links alone."""

    name: str
    mass_kg: float


class Link(msgspec.Struct, frozen=True, kw_only=True):
    """A law between two places; eta is the displacement of `at` less that of `against` (None: the ground)."""

    name: str
    at: Place
    against: Place | None
    law: StopLaw


class MachineTone(msgspec.Struct, frozen=True, kw_only=True):
    """A force cosine_n cos(2 pi f t) + sine_n sin(2 pi f t) on a place, there before the record begins."""

    at: Place
    cosine_n: float
    sine_n: float
    frequency_hz: float


class Shaking(msgspec.Struct, frozen=True, kw_only=True):
    """Gaussian acceleration of the ground in a band."""

    acceleration_rms_m_per_s2: float
    low_hz: float
    high_hz: float


class MotionSensor(msgspec.Struct, frozen=True, kw_only=True):
    """A sensor's true place and chain.

    It delivers gain times the motion of delay_s ago, through a first-order high-pass (0: none), plus a share of the
    lateral motion, crosstalk times the signals of the channels before and after it, and noise of a one-sided
    density, in its unit per sqrt(Hz). A mounting of mount_hz resonates (0: rigid).
    """

    name: str
    at: Place
    gain: float = 1.0
    delay_s: float = 0.0
    highpass_hz: float = 0.0
    lateral_share: float = 0.0
    noise_density: float = 0.0
    mount_hz: float = 0.0
    mount_damping: float = 0.0
    quantity: Quantity = "acceleration"
    crosstalk: tuple[float, float] = (0.0, 0.0)


class ForceCell(msgspec.Struct, frozen=True, kw_only=True):
    """The measured force is gain times the true one of delay_s ago (below 0: of later), plus noise, N/sqrt(Hz).

    Of a base_kg above 0 no force acts: the ground is shaken by minus the force over base_kg, and sensors of
    displacement and velocity move with it.
    """

    gain: float = 1.0
    delay_s: float = 0.0
    noise_density: float = 0.0
    base_kg: float = 0.0


class Machine(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that is true of a case. Contacts are links with stops that rig.json knows; other links are not."""

    beams: tuple[TrueBeam, ...]
    contacts: tuple[Link, ...]
    force_at: Place
    sensors: tuple[MotionSensor, ...]
    cell: ForceCell = ForceCell()
    masses: tuple[LooseMass, ...] = ()
    links: tuple[Link, ...] = ()
    loads: tuple[tuple[Place, float], ...] = ()
    tones: tuple[MachineTone, ...] = ()
    shaking: Shaking | None = None
    lumped: tuple[Lumped, ...] = ()

    @property
    def bodies(self) -> tuple[TrueBeam | Lumped, ...]:
        return (*self.beams, *self.lumped)

    def body(self, name: str) -> TrueBeam | Lumped:
        return next(b for b in self.bodies if b.name == name)

    def contact(self, name: str) -> Link:
        return next(c for c in self.contacts if c.name == name)

    def sensor(self, name: str) -> MotionSensor:
        return next(s for s in self.sensors if s.name == name)

    def beam(self, name: str) -> TrueBeam:
        return next(b for b in self.beams if b.name == name)


def with_laws(machine: Machine, contact: str, change: Callable[[StopLaw], StopLaw]) -> Machine:
    """The machine with the law of one contact changed, or of all."""
    return replace(
        machine,
        contacts=tuple(replace(c, law=change(c.law)) if contact in ("all", c.name) else c for c in machine.contacts),
    )


def with_beams(machine: Machine, beam: str, change: Callable[[TrueBeam], TrueBeam]) -> Machine:
    """The machine with one beam changed, or all."""
    return replace(machine, beams=tuple(change(b) if beam in ("all", b.name) else b for b in machine.beams))


def with_bodies(machine: Machine, body: str, change: Callable[[Any], Any]) -> Machine:
    """The machine with one body changed, or all: what beams and masses in a row have in common."""
    beams, lumped = (
        tuple(change(b) if body in ("all", b.name) else b for b in bodies) for bodies in (machine.beams, machine.lumped)
    )
    return replace(machine, beams=beams, lumped=lumped)


def with_sensors(machine: Machine, sensor: str, change: Callable[[MotionSensor], MotionSensor]) -> Machine:
    """The machine with one sensor changed, or all."""
    return replace(machine, sensors=tuple(change(s) if sensor in ("all", s.name) else s for s in machine.sensors))


def with_link(machine: Machine, name: str, at: Place, law: StopLaw) -> Machine:
    """The machine with one more link to the ground."""
    return replace(machine, links=(*machine.links, Link(name=name, at=at, against=None, law=law)))


def with_hung(machine: Machine, name: str, at: Place, mass_kg: float, law: StopLaw) -> Machine:
    """The machine with a mass that hangs on a place of a beam by a law."""
    link = Link(name=name, at=at, against=Place(name), law=law)
    return replace(machine, masses=(*machine.masses, LooseMass(name, mass_kg)), links=(*machine.links, link))
