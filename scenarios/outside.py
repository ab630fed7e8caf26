"""Realities that the library of effects does not have: what a diagnosis has to refuse to name.

Each is a frozen class with a magnitude between `weak` (moderately there) and `strong` (clearly there).
"""

from collections.abc import Iterator
from functools import partial, wraps
from typing import Any, ClassVar, no_type_check

import msgspec
import numpy as np
from scipy.signal import bilinear, lfilter, lfilter_zi

from rig.description import Rig, Station
from rig.errors import RigError
from rig.motion import Motion, Plant, Progress
from rig.plants import ancf
from rig.plants.connectors import ChangingModulus, Extra, GroundedForce

MOVING = 0.6
"""From this share of their length on, both beams of the barrel-cradle move by some millimetres."""


class Outside(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An effect outside the library: extra forces for the ancf plant, or something between it and the sensors."""

    name: ClassVar[str]
    magnitude: ClassVar[str]
    weak: ClassVar[float]
    strong: ClassVar[float]

    def extra(self) -> tuple[Extra, ...]:
        return ()

    def seen(self, _rig: Rig, blocks: Iterator[Motion], /) -> Iterator[Motion]:
        """What reaches the sensors' chain of the true motion."""
        return blocks


class OnBody(Outside, frozen=True):
    """One that acts between a place on a body and the ground."""

    body: str
    position_m: float

    def force_n(self, functions: Any, time_s: Any, w_m: Any, rate_m_per_s: Any) -> Any:
        """The force against the displacement w; see `rig.plants.connectors.GroundedForce`."""
        raise NotImplementedError

    def extra(self) -> tuple[Extra, ...]:
        return (GroundedForce(Station(self.body, self.position_m), self.force_n),)


class QuadraticDrag(OnBody, frozen=True):
    """Drag c |v| v at a place of a body, as of a fluid."""

    name: ClassVar[str] = "quadratic_drag"
    magnitude: ClassVar[str] = "drag_n_s2_per_m2"
    weak: ClassVar[float] = 4.0
    strong: ClassVar[float] = 15.0
    drag_n_s2_per_m2: float

    @no_type_check
    def force_n(self, functions, _time_s, _w_m, rate_m_per_s):
        return self.drag_n_s2_per_m2 * functions.abs(rate_m_per_s) * rate_m_per_s


class MainsForce(OnBody, frozen=True):
    """An unmeasured force A sin(2 pi 50 Hz t) on a body, there from the start."""

    name: ClassVar[str] = "mains_force"
    magnitude: ClassVar[str] = "amplitude_n"
    weak: ClassVar[float] = 0.1
    strong: ClassVar[float] = 1.0
    amplitude_n: float

    @no_type_check
    def force_n(self, functions, time_s, _w_m, _rate_m_per_s):
        return -self.amplitude_n * functions.sin(2 * np.pi * 50.0 * time_s)


class ThirdContact(OnBody, frozen=True):
    """A third stop, between a body and the ground: k times the depth beyond a clearance on either side."""

    name: ClassVar[str] = "third_contact"
    magnitude: ClassVar[str] = "stiffness_n_per_m"
    weak: ClassVar[float] = 1e3
    strong: ClassVar[float] = 1e5
    stiffness_n_per_m: float
    clearance_m: float

    @no_type_check
    def force_n(self, functions, _time_s, w_m, _rate_m_per_s):
        d = self.clearance_m
        inside = 0.5 * (functions.abs(w_m + d) - functions.abs(w_m - d))  # w clipped to -d..d
        return self.stiffness_n_per_m * (w_m - inside)


class SofteningSupport(OnBody, frozen=True):
    """A support whose force k w0 tanh(w / w0) yields."""

    name: ClassVar[str] = "softening_support"
    magnitude: ClassVar[str] = "stiffness_n_per_m"
    weak: ClassVar[float] = 300.0
    strong: ClassVar[float] = 5e3
    stiffness_n_per_m: float
    yield_m: float

    @no_type_check
    def force_n(self, functions, _time_s, w_m, _rate_m_per_s):
        return self.stiffness_n_per_m * self.yield_m * functions.tanh(w_m / self.yield_m)


class ThermalDrift(Outside, frozen=True):
    """Young's modulus of a beam falls steadily, by this share over the record."""

    name: ClassVar[str] = "thermal_drift"
    magnitude: ClassVar[str] = "fall"
    weak: ClassVar[float] = 0.06
    strong: ClassVar[float] = 0.2
    fall: float
    beam: str
    duration_s: float

    def extra(self) -> tuple[Extra, ...]:
        return (ChangingModulus(self.beam, lambda time_s: 1 - self.fall * time_s / self.duration_s),)


class LooseSensor(Outside, frozen=True):
    """A sensor on a mounting that resonates: it follows x'' + 2 zeta w x' + w^2 x = 2 zeta w u' + w^2 u."""

    name: ClassVar[str] = "loose_sensor"
    magnitude: ClassVar[str] = "frequency_hz"
    weak: ClassVar[float] = 300.0
    strong: ClassVar[float] = 60.0
    frequency_hz: float
    damping_ratio: float
    sensor: str

    def seen(self, rig: Rig, blocks: Iterator[Motion]) -> Iterator[Motion]:
        row = [s.name for s in rig.sensors].index(self.sensor)
        omega = 2 * np.pi * self.frequency_hz
        rate = 2 * self.damping_ratio * omega
        state = None
        for block in blocks:
            b, a = bilinear([rate, omega**2], [1.0, rate, omega**2], 1 / block.step_s)
            sensed = block.sensed.copy()
            if state is None:
                state = lfilter_zi(b, a) * sensed[row, 0]
            sensed[row], state = lfilter(b, a, sensed[row], zi=state)
            yield Motion(
                start_s=block.start_s,
                step_s=block.step_s,
                force_n=block.force_n,
                sensed=sensed,
                displacement_m=block.displacement_m,
                eta_m=block.eta_m,
                contact_force_n=block.contact_force_n,
            )


OUTSIDE: dict[str, type[Outside]] = {
    kind.name: kind for kind in (QuadraticDrag, MainsForce, ThirdContact, SofteningSupport, ThermalDrift, LooseSensor)
}


def outside_drawn(name: str, rig: Rig, duration_s: float, rng: np.random.Generator) -> Outside:
    """One of that name, its magnitude log-uniform from weak to strong, its place among the rig's."""
    kind = OUTSIDE[name]
    body = rig.bodies[int(rng.integers(len(rig.bodies)))]
    given: dict[str, Any] = {
        kind.magnitude: float(kind.weak * (kind.strong / kind.weak) ** rng.uniform()),
        "body": body.name,
        "position_m": float(rng.uniform(MOVING, 1.0) * body.length_m),
        "beam": body.name,
        "sensor": str(rng.choice([s.name for s in rig.sensors])),
        "clearance_m": float(rng.uniform(2e-3, 5e-3)),
        "yield_m": float(rng.uniform(1e-3, 4e-3)),
        "damping_ratio": float(rng.uniform(0.02, 0.05)),
        "duration_s": duration_s,
    }
    return kind(**{field: given[field] for field in kind.__struct_fields__})


def strength_of(outside: Outside) -> float:
    """Where the magnitude lies between weak (0) and strong (1), on a logarithmic scale."""
    value = getattr(outside, outside.magnitude)
    return float(np.log(value / outside.weak) / np.log(outside.strong / outside.weak))


def plant(outside: Outside | None, elements: int) -> Plant:
    """The ancf plant with this many elements a beam and, if there is one, the effect in it.

    It bears the name of the ancf plant, so that a recording does not tell.
    """
    extra = outside.extra() if outside else ()
    simulate = partial(ancf.simulate, elements=elements, extra=extra)

    @wraps(ancf.simulate)
    def motion(rig: Rig, force_n: Any, step_s: float, progress: Progress) -> Iterator[Motion]:
        blocks = simulate(rig, force_n, step_s, progress)
        return outside.seen(rig, blocks) if outside else blocks

    return motion


def described(effect: msgspec.Struct, name: str) -> str:
    """NAME:FIELD=VALUE,... with every field that has a value, as `rig.effects.effect_named` reads it."""
    fields = {f: getattr(effect, f) for f in effect.__struct_fields__}
    words = ",".join(f"{f}={v}" for f, v in fields.items() if v is not None)
    return f"{name}:{words}"


def outside_named(text: str) -> Outside:
    """The effect that `described` wrote; raises RigError if there is none of that name."""
    name, _, words = text.partition(":")
    if name not in OUTSIDE:
        raise RigError(f"no effect outside the library is called {name!r}; there are {', '.join(OUTSIDE)}")
    return msgspec.convert(dict(w.split("=", 1) for w in words.split(",")), OUTSIDE[name], strict=False)
