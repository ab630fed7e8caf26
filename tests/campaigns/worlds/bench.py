"""The world "bench": machines of other kinds, how each is excited, and the effects that make sense on it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from tests.campaigns.worlds import bench_machines as machines
from tests.campaigns.worlds.bench_sizes import sized
from tests.campaigns.worlds.forces import Blows, Excitation, Gaussian, Release
from tests.campaigns.worlds.kinds import Kind
from tests.campaigns.worlds.machine import Machine
from tests.campaigns.worlds.simulator import Model, model_of

LOUDER = (1.3, 1.7)
"""The second record's level over the first one's."""
BEYOND, HIGHEST, HELD = 1.5, 4.0, 8.0
"""Motion at the first contact, were it not there, in clearances: root mean square under a Gaussian force, the largest
after a blow, at rest before a release."""
FREE_M = {"gaussian": 1e-3, "hits": 2e-3, "decay": 4e-3}
"""The same where there is no contact, at the force's place."""
CARRIAGE_M = 0.03
APART_S, LONGEST_S = (3.0, 5.0), 120.0
"""Between blows; no record is longer."""
BEFORE_S = 0.05
"""A decay's record begins so long after the release or the blow."""
Excited = Literal["gaussian", "hits", "decay"]


@dataclass(frozen=True)
class Bench:
    """One machine, what excites its two records, and every effect that it may have, in sizes that suit it."""

    name: str
    nominal: Machine
    sample_rate_hz: float
    excitations: tuple[Excitation, Excitation]
    kinds: Mapping[str, Kind]


@dataclass(frozen=True)
class Response:
    """What a linear machine does at the watched place (its first contact, or the force's place) per newton.

    rms_m and rms_m_per_s: of a force of 1 N rms in the band; held_m: of a constant force; struck_m: the largest after 1
    N s; bent_m: of the modes under a constant force, regardless of their signs (a constant force at its foot does not
    part the upper storeys of a frame); period_s: the period of the mode that a blow moves most.
    """

    rms_m: float
    rms_m_per_s: float
    held_m: float
    struck_m: float
    bent_m: float
    period_s: float


@dataclass(frozen=True)
class BenchKind:
    """A kind of machine under one kind of excitation."""

    name: str
    machine: Callable[[np.random.Generator], Machine]
    excited: Excited
    sample_rate_hz: float
    band_hz: tuple[float, float]
    effects: tuple[str, ...]
    outside: tuple[str, ...]

    def drawn(self, of_machine: np.random.Generator, of_records: np.random.Generator) -> Bench:
        machine = self.machine(of_machine)
        response = response_of(machine, self.band_hz)
        clearances = [min(c.law.lower_m, c.law.upper_m) for c in machine.contacts]
        target_m = CARRIAGE_M if self.name == "carriage" else FREE_M[self.excited]
        if clearances:
            target_m = {"gaussian": BEYOND, "hits": HIGHEST, "decay": HELD}[self.excited] * clearances[0]
        louder = float(of_records.uniform(*LOUDER))
        first, force_n = self._excitation(response, target_m, of_records)
        second, _ = self._excitation(response, target_m * louder, of_records)
        typical_m = target_m if self.excited == "gaussian" else target_m / 3
        speed = response.rms_m_per_s / response.rms_m * typical_m
        kinds = sized(machine, force_n, typical_m, speed, self.sample_rate_hz, self.band_hz)
        cell = with_force_noise(machine, force_n) if first.measured else machine
        return Bench(self.name, cell, self.sample_rate_hz, (first, second), kinds)

    def _excitation(self, response: Response, target_m: float, rng: np.random.Generator) -> tuple[Excitation, float]:
        """What moves the machine that far, and the force in it that effects are measured by, N."""
        if self.excited == "gaussian":
            level_n = target_m / response.rms_m
            return Gaussian(rms_n=level_n, begins_s=1.0, band_hz=self.band_hz), level_n
        width_s = response.period_s * float(rng.uniform(0.05, 0.15))
        peak_n = target_m / response.struck_m / (2 / np.pi * width_s)
        working_n = target_m / 3 / response.bent_m
        if self.excited == "hits":
            times_s = 1.0 + np.concatenate([[0.0], np.cumsum(rng.uniform(*APART_S, round(LONGEST_S / APART_S[0])))])
            peaks_n = peak_n * rng.uniform(0.8, 1.2, times_s.size)
            blows = tuple(zip(times_s.tolist(), peaks_n.tolist(), strict=True))
            return Blows(blows=blows, width_s=width_s, begins_s=1.0), working_n
        if rng.uniform() < 0.5:
            return Release(held_n=target_m / response.held_m, before_s=BEFORE_S), working_n
        return Blows(blows=((-BEFORE_S - width_s, peak_n),), width_s=width_s), working_n


def with_force_noise(machine: Machine, force_n: float) -> Machine:
    """The machine with a force cell whose noise is 90 dB below the force in a band of 100 Hz."""
    return replace(machine, cell=replace(machine.cell, noise_density=3e-6 * force_n))


def response_of(machine: Machine, band_hz: tuple[float, float]) -> Response:
    """The linear response of the machine without its contacts, from its modes."""
    model: Model = model_of(machine)
    watched = model.rows[0] if machine.contacts else model.gains[0]
    weights: Float[np.ndarray, " modes"] = watched * model.gains[0]
    turns = 2 * np.pi * np.geomspace(*band_hz, 20_000)
    lines = np.zeros(turns.size, dtype=complex)
    for weight, omega, zeta in zip(weights, model.omega, model.zeta, strict=True):
        lines += weight / (omega**2 - turns**2 + 2j * zeta * omega * turns)
    width = turns[-1] - turns[0]
    squares = [np.trapezoid(np.abs(lines * turns**k) ** 2, turns) / width for k in (0, 1)]
    moved = np.abs(weights / model.omega)
    return Response(
        rms_m=float(np.sqrt(squares[0])),
        rms_m_per_s=float(np.sqrt(squares[1])),
        held_m=float(abs(np.sum(weights / model.omega**2))),
        struck_m=float(np.sqrt(np.sum(moved**2))),
        bent_m=float(np.sum(moved / model.omega)),
        period_s=float(2 * np.pi / model.omega[np.argmax(moved)]),
    )


HELD_BODIES = (
    "added_mass",
    "ground_damper",
    "ground_friction",
    "hardening_spring",
    "linear_spring",
    "structural_damping",
)
FORCED = ("force_gain", "force_shift", "sensor_gain", "tone")
BEAMS = ("base_motion", "clamp_compliance", "youngs_modulus")
STOPS = (
    "clearance_wear",
    "contact_clearance",
    "contact_damping",
    "contact_stiffness",
    "coulomb_friction",
    "hertz_stop",
)
TWO_STOPS = (*STOPS, "nonlinear_contact", "one_stop")
BODY_OUTSIDE = ("quadratic_drag", "softening_support")
STOP_OUTSIDE = ("power_law_stop", "stop_without_pull")
LOW, MIDDLE, HIGH = (0.05, 4.0), (0.5, 40.0), (0.5, 100.0)
"""Bands of the forces, Hz."""

BENCHES: dict[str, BenchKind] = {
    kind.name: kind
    for kind in (
        BenchKind(
            "carriage",
            machines.carriage,
            "gaussian",
            512.0,
            LOW,
            ("added_mass", "ground_damper", "ground_friction", "linear_spring", "preload", "force_gain", "sensor_gain"),
            BODY_OUTSIDE,
        ),
        *(
            BenchKind(name, machine, "gaussian", 1024.0, MIDDLE, (*HELD_BODIES, *FORCED, *TWO_STOPS), outside)
            for name, machine, outside in (
                ("two_masses", machines.two_masses, (*BODY_OUTSIDE, *STOP_OUTSIDE)),
                ("three_masses", machines.three_masses, (*BODY_OUTSIDE, *STOP_OUTSIDE)),
                ("chain", machines.chain, (*BODY_OUTSIDE, *STOP_OUTSIDE)),
                ("frame", machines.frame, (*BODY_OUTSIDE, *STOP_OUTSIDE)),
            )
        ),
        BenchKind(
            "cantilever",
            machines.cantilever,
            "gaussian",
            2048.0,
            HIGH,
            (*HELD_BODIES, *FORCED, *BEAMS, *TWO_STOPS),
            (*BODY_OUTSIDE, *STOP_OUTSIDE),
        ),
        BenchKind(
            "cantilever_one_sided",
            machines.cantilever_one_sided,
            "gaussian",
            2048.0,
            HIGH,
            (*HELD_BODIES, *FORCED, *BEAMS, *STOPS),
            (*BODY_OUTSIDE, *STOP_OUTSIDE),
        ),
        BenchKind(
            "shaken_mass",
            machines.shaken_mass,
            "gaussian",
            1024.0,
            MIDDLE,
            (
                "ground_damper",
                "ground_friction",
                "hardening_spring",
                "linear_spring",
                "asymmetric_clearance",
                *TWO_STOPS,
            ),
            STOP_OUTSIDE,
        ),
        BenchKind(
            "supported_beam",
            machines.supported_beam,
            "gaussian",
            4096.0,
            (0.5, 200.0),
            (*HELD_BODIES, *FORCED, *BEAMS, "support_position"),
            ("mass_moved", "quadratic_drag"),
        ),
        BenchKind(
            "cantilever_hit",
            machines.cantilever,
            "hits",
            2048.0,
            HIGH,
            (*HELD_BODIES, "force_gain", "force_shift", "sensor_gain", *BEAMS[1:], *TWO_STOPS),
            (*BODY_OUTSIDE, *STOP_OUTSIDE),
        ),
        BenchKind(
            "bare_cantilever_hit",
            machines.bare_cantilever,
            "hits",
            2048.0,
            HIGH,
            (*HELD_BODIES, "force_gain", "force_shift", "sensor_gain", *BEAMS[1:]),
            BODY_OUTSIDE,
        ),
        BenchKind(
            "frame_hit",
            machines.frame,
            "hits",
            1024.0,
            MIDDLE,
            (*HELD_BODIES, "force_gain", "sensor_gain", *TWO_STOPS),
            (*BODY_OUTSIDE, *STOP_OUTSIDE),
        ),
        BenchKind(
            "bare_cantilever_decay",
            machines.bare_cantilever,
            "decay",
            2048.0,
            HIGH,
            (*HELD_BODIES, *BEAMS[1:]),
            BODY_OUTSIDE,
        ),
        BenchKind(
            "cantilever_decay",
            machines.cantilever,
            "decay",
            2048.0,
            HIGH,
            (*HELD_BODIES, *BEAMS[1:], "contact_clearance", "contact_damping", "contact_stiffness"),
            (*BODY_OUTSIDE, *STOP_OUTSIDE),
        ),
        BenchKind(
            "mass_decay",
            machines.held_mass,
            "decay",
            1024.0,
            MIDDLE,
            ("ground_damper", "ground_friction", "structural_damping", "contact_clearance", "contact_stiffness"),
            STOP_OUTSIDE,
        ),
        BenchKind(
            "three_masses_decay",
            machines.three_masses,
            "decay",
            1024.0,
            MIDDLE,
            ("added_mass", "linear_spring", "structural_damping", "contact_clearance", "contact_stiffness"),
            STOP_OUTSIDE,
        ),
    )
}
"""By name; a case has the machine that its number deals."""
