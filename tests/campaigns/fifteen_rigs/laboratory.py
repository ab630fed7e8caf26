"""A machine as a laboratory builds and measures it: off by its stated tolerances, through sensors with faults of
their own, in a CSV file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from scipy.signal import bilinear, lfilter, oaconvolve

from tests.campaigns.fifteen_rigs.bodies import ModalBody
from tests.campaigns.fifteen_rigs.piecewise_linear import OPEN_M, Pickup, PiecewiseMachine, TwoSidedStop, motion

GAIN, PLACE_M, DELAY_S, HIGH_PASS_HZ = 2e-3, 1e-3, 1e-5, 0.1
FORCE_GAIN, MASS, FREQUENCY, DAMPING = 3e-3, 3e-3, 2e-3, 0.3
"""The default tolerances as identify/README.md states them, standard deviations."""
QUIET_S, RISE_S, TAIL_S = 1.0, 0.3, 0.1
FORCE_NOISE = 2e-4
"""Of the force cell, N/sqrt(Hz)."""
GROUND = "ground"
Places = Sequence[tuple[str, float]]


@dataclass(frozen=True)
class Instrument:
    """A sensor by its believed place; of a strain gauge its distance from the neutral fibre."""

    name: str
    body: str
    position_m: float
    quantity: str
    noise_density: float
    fibre_m: float = 0.0


@dataclass(frozen=True)
class TrueContact:
    """What is true of a contact between two places (against None: the ground)."""

    name: str
    at: tuple[str, float]
    against: tuple[str, float] | None
    lower_m: float | None
    upper_m: float | None
    stiffness_n_per_m: float
    damping_n_s_per_m: float


@dataclass(frozen=True)
class Assembly:
    """Bodies by name, their contacts, and the places of the forces; lengths_m of those along which a sensor can be
    misplaced."""

    bodies: Mapping[str, ModalBody]
    contacts: Sequence[TrueContact]
    forces: Places = ()
    lengths_m: Mapping[str, float] = field(default_factory=dict)

    def row(self, body: str, position_m: float, fibre_m: float = 0.0) -> Float[np.ndarray, " modes"]:
        """Displacement, or of a fibre the strain -h w'', per modal coordinate."""
        rows = []
        for name, modal in self.bodies.items():
            own = np.zeros(modal.frequencies_hz.size)
            if name == body:
                own = modal.shapes(position_m)
                if fibre_m:
                    assert modal.curvatures is not None
                    own = -fibre_m * modal.curvatures(position_m)
            rows.append(own)
        return np.concatenate(rows)

    def machine(self) -> PiecewiseMachine:
        """Inputs: the forces, then minus the ground's acceleration by the participations, where all have them."""
        bodies = list(self.bodies.values())
        inputs = [self.row(*place) for place in self.forces]
        if not self.forces:
            inputs = [-np.concatenate([b.participations for b in bodies])]
        stops = tuple(
            TwoSidedStop(
                c.name,
                self.row(*c.at) - (self.row(*c.against) if c.against else 0.0),
                OPEN_M if c.lower_m is None else c.lower_m,
                OPEN_M if c.upper_m is None else c.upper_m,
                c.stiffness_n_per_m,
                c.damping_n_s_per_m,
            )
            for c in self.contacts
        )
        return PiecewiseMachine(
            2 * np.pi * np.concatenate([b.frequencies_hz for b in bodies]),
            np.concatenate([b.ratios for b in bodies]),
            np.array(inputs),
            stops,
        )


@dataclass(frozen=True)
class Grid:
    """Samples a second, record length, and steps of the simulation a sample."""

    rate_hz: float
    duration_s: float
    steps_per_sample: int = 8

    @property
    def step_s(self) -> float:
        return 1 / (self.rate_hz * self.steps_per_sample)

    @property
    def time_s(self) -> Float[np.ndarray, " steps"]:
        """Of the steps, a little beyond the record's end."""
        return np.arange(round((self.duration_s + TAIL_S) / self.step_s)) * self.step_s


@dataclass(frozen=True)
class Measured:
    """Columns of a record as the logger has them, and the share of the time for which each contact is closed."""

    forces_n: Float[np.ndarray, "forces samples"]
    columns: dict[str, Float[np.ndarray, " samples"]]
    closed_share: dict[str, float]


def built(body: ModalBody, rng: np.random.Generator) -> ModalBody:
    """The body as it is: mass, frequencies and damping off by their tolerances, common and of each mode."""
    modes = body.frequencies_hz.size
    common, each = 1 + FREQUENCY * rng.standard_normal(), 1 + FREQUENCY * rng.standard_normal(modes)
    damping = np.clip(1 + DAMPING * rng.standard_normal(modes), 0.2, None) * max(
        0.2, 1 + DAMPING * rng.standard_normal()
    )
    heavier = body.scaled(1 + MASS * rng.standard_normal())
    return replace(heavier, frequencies_hz=body.frequencies_hz * common * each, ratios=body.ratios * damping)


def recorded(
    assembly: Assembly,
    instruments: Sequence[Instrument],
    inputs: Float[np.ndarray, "inputs steps"],
    grid: Grid,
    rng: np.random.Generator,
    ground: Float[np.ndarray, "2 steps"] | None = None,
    displaced: Float[np.ndarray, " modes"] | None = None,
) -> Measured:
    """The record of an assembly under its inputs; ground: displacement and acceleration of the base."""
    pickups = []
    for sensor in instruments:
        place_m = sensor.position_m
        if sensor.body in assembly.lengths_m:
            off_m = PLACE_M * rng.standard_normal()
            place_m = float(np.clip(place_m + off_m, 0.0, assembly.lengths_m[sensor.body]))
        none = np.zeros_like(assembly.machine().omega_rad_per_s)
        row = none if sensor.body == GROUND else assembly.row(sensor.body, place_m, sensor.fibre_m)
        pickups.append(Pickup(row, 1 if sensor.quantity == "acceleration" else 0))
    moved, closed = motion(assembly.machine(), pickups, inputs.T, grid.step_s, displaced)
    for row, pickup in zip(moved, pickups, strict=True):
        if pickup.order:
            row[:] = _rate(row, grid.step_s)
    if ground is not None:
        moved += [ground[1] if pickup.order else ground[0] for pickup in pickups]
    columns = through_instruments(instruments, moved, grid, rng)
    force = np.array([_sampled(row, grid, 0.0) for row in inputs])
    force = force * (1 + FORCE_GAIN * rng.standard_normal((len(force), 1)))
    force = force + _white(FORCE_NOISE, force.shape, grid, rng)
    shares = {c.name: float(s) for c, s in zip(assembly.contacts, closed, strict=True)}
    return Measured(force, columns, shares)


def through_instruments(
    instruments: Sequence[Instrument],
    moved: Float[np.ndarray, "sensors steps"],
    grid: Grid,
    rng: np.random.Generator,
) -> dict[str, Float[np.ndarray, " samples"]]:
    """What the sensors deliver of the true motion: gain, high-pass of accelerometers, delay, sampling, noise."""
    columns = {}
    for sensor, true_motion in zip(instruments, moved, strict=True):
        gain, delay_s = 1 + GAIN * rng.standard_normal(), DELAY_S * rng.standard_normal()
        signal = gain * true_motion
        corner = 2 * np.pi * HIGH_PASS_HZ * abs(rng.standard_normal())
        if sensor.quantity == "acceleration":
            signal = lfilter(*bilinear([1.0, 0.0], [1.0, corner], 1 / grid.step_s), signal)
        row = _sampled(signal, grid, delay_s)
        columns[sensor.name] = row + _white(sensor.noise_density, row.shape, grid, rng)
    return columns


def _rate(velocity: Float[np.ndarray, " steps"], step_s: float) -> Float[np.ndarray, " steps"]:
    """Acceleration by central differences of the eighth order. At a stop it jumps within a step, and at the steps it
    would fold back into the band; the velocity, which only bends, hardly does."""
    halves = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])
    return np.convolve(velocity, np.r_[-halves[::-1], 0.0, halves][::-1] / step_s, mode="same")


def _sampled(signal: Float[np.ndarray, " steps"], grid: Grid, delay_s: float) -> Float[np.ndarray, " samples"]:
    """A windowed sinc of 64 samples with its edge at 0.45 of the rate, centred late by the delay."""
    half = 32 * grid.steps_per_sample
    place = np.arange(-half, half + 1) - delay_s / grid.step_s
    edge = 0.9 / grid.steps_per_sample
    taps = edge * np.sinc(edge * place) * np.kaiser(2 * half + 1, 8.0)
    samples = round(grid.duration_s * grid.rate_hz)
    return oaconvolve(signal, taps / taps.sum(), mode="same")[:: grid.steps_per_sample][:samples]


def _white(density: float, shape: tuple[int, ...], grid: Grid, rng: np.random.Generator) -> Float[np.ndarray, "..."]:
    return density * np.sqrt(grid.rate_hz / 2) * rng.standard_normal(shape)


def gaussian(
    rms: float, band_hz: tuple[float, float], grid: Grid, rng: np.random.Generator
) -> Float[np.ndarray, " steps"]:
    """Noise in a band after a quiet second."""
    time_s = grid.time_s
    lines_hz = np.fft.rfftfreq(time_s.size, grid.step_s)
    inside = (lines_hz >= band_hz[0]) & (lines_hz <= band_hz[1])
    spectrum = inside * (rng.standard_normal(lines_hz.size) + 1j * rng.standard_normal(lines_hz.size))
    force = np.fft.irfft(spectrum, time_s.size)
    return rms * force / force.std() * np.clip((time_s - QUIET_S) / RISE_S, 0, 1)


def blows(
    peak_n: float, width_s: float, every_s: float, grid: Grid, rng: np.random.Generator
) -> Float[np.ndarray, " steps"]:
    """Half-sines of a hammer, 0.5 to 1 of the peak, at intervals that vary by a tenth."""
    time_s, force, at_s = grid.time_s, np.zeros(grid.time_s.size), QUIET_S
    while at_s < grid.duration_s - every_s:
        inside = (time_s >= at_s) & (time_s <= at_s + width_s)
        force[inside] = peak_n * rng.uniform(0.5, 1.0) * np.sin(np.pi * (time_s[inside] - at_s) / width_s)
        at_s += every_s * rng.uniform(0.9, 1.1)
    return force


def shaken_ground(
    rms_m_per_s2: float, band_hz: tuple[float, float], grid: Grid, rng: np.random.Generator
) -> Float[np.ndarray, "2 steps"]:
    """Displacement and acceleration of a base, noise in a band that sets in smoothly after a quiet second."""
    time_s = grid.time_s
    lines = 2j * np.pi * np.fft.rfftfreq(time_s.size, grid.step_s)
    inside = (np.abs(lines) >= 2 * np.pi * band_hz[0]) & (np.abs(lines) <= 2 * np.pi * band_hz[1])
    spectrum = inside * (rng.standard_normal(lines.size) + 1j * rng.standard_normal(lines.size))
    spectrum[inside] /= lines[inside] ** 2
    w, v, a = (np.fft.irfft(lines**order * spectrum, time_s.size) for order in range(3))
    scale = rms_m_per_s2 / a.std()
    s = np.clip((time_s - QUIET_S) / RISE_S, 0, 1)
    rise, slope = s**3 * (10 - 15 * s + 6 * s**2), 30 * (s - s**2) ** 2 / RISE_S
    bend = 60 * s * (1 - s) * (1 - 2 * s) / RISE_S**2
    return scale * np.array([rise * w, bend * w + 2 * slope * v + rise * a])
