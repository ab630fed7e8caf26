"""Two tubes that move in two directions and touch in rings, simulated by functions that the product does not share.

Modes of cubic Hermite elements, the same in both directions. Each step turns every mode by its exact rotation over one
step and kicks it by the forces there, with the velocity in the middle of the kick (Strang's splitting, second order).
Accelerations are second differences over four steps, forces the means that these take of them.
With eta = (eta_y, eta_z) less the ring's centre, r = |eta|, e = eta / r and the tangent t, a ring gives

    f = f_n e + mu f_n tanh(v_t / v_0) t,    f_n = max(0, k (r - d) + c v_r min(1, (r - d) / onset))    where r > d
"""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit
from scipy.fft import next_fast_len

from tests.campaigns.worlds.beams import modes_of
from tests.campaigns.worlds.machine import MODES, TrueBeam
from tests.campaigns.worlds.sampling import Sampler

STEP_S = 2.0**-17
SENSED_STEPS = 4
"""Steps between two values that the sampling filter gets."""
HIGHEST_HZ = 4e4
"""Of the modes that are simulated: those beyond give a ring's place less than 1e-4 of its softness."""
GRAVITY_M_PER_S2 = 9.81
BEGINS_S, RISE_S, BAND_HZ = 1.0, 0.1, (0.5, 100.0)
LEAD_S = 0.05
"""Rest before the record, for the sampling filter."""
TAIL_S = 0.05


@dataclass(frozen=True)
class Tube:
    """A steel tube, clamped at its left end or free; factors on frequency and damping of each mode and direction, and
    point masses on it (position_m, kg)."""

    name: str
    clamped: bool
    length_m: float
    outer_m: float
    inner_m: float
    density_kg_per_m3: float = 7850.0
    damping_ratio: float = 0.01
    frequency_factors: Float[np.ndarray, "2 modes"] | None = None
    damping_factors: Float[np.ndarray, "2 modes"] | None = None
    masses: tuple[tuple[float, float], ...] = ()

    @property
    def rectangle_m(self) -> tuple[float, float]:
        """Width and thickness of the rectangle of the same area and second moment."""
        area = np.pi / 4 * (self.outer_m**2 - self.inner_m**2)
        moment = np.pi / 64 * (self.outer_m**4 - self.inner_m**4)
        thickness = float(np.sqrt(12 * moment / area))
        return float(area / thickness), thickness


@dataclass(frozen=True)
class Ring:
    """A ring of the cradle around the barrel: places along both, and its law; its damping sets in over `onset_m`."""

    name: str
    barrel_m: float
    cradle_m: float
    clearance_m: float
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    friction: float
    sliding_speed_m_per_s: float
    onset_m: float = 1e-5


@dataclass(frozen=True)
class Accelerometer:
    """A two-axis accelerometer: true place, and of each axis gain, delay, corner of its high-pass, share of the other
    axis, and noise density."""

    body: str
    position_m: float
    gain: tuple[float, float] = (1.0, 1.0)
    delay_s: tuple[float, float] = (0.0, 0.0)
    highpass_hz: tuple[float, float] = (0.0, 0.0)
    crossing: tuple[float, float] = (0.0, 0.0)
    noise_density: float = 1e-3


@dataclass(frozen=True)
class SpaceMachine:
    """Barrel and cradle with their rings, instruments, and the place of both shakers on the barrel."""

    barrel: Tube
    cradle: Tube
    rings: tuple[Ring, ...]
    sensors: tuple[Accelerometer, ...]
    force_m: float
    force_gain: tuple[float, float] = (1.0, 1.0)
    gravity: bool = True


@dataclass(frozen=True)
class SpaceRecord:
    """What a laboratory has: forces and accelerations, direction by direction; and the truth beside it.

    eta_m and rings_n are the relative displacements and the forces in the rings.
    open_share and angle_share by ring: shares of the time, and of 36 angles, in which it is open and is touched. rest_m
    is eta less the centre before the shakers begin.
    """

    forces_n: Float[np.ndarray, "2 samples"]
    accelerations: Float[np.ndarray, "2 sensors samples"]
    eta_m: Float[np.ndarray, "2 rings samples"]
    rings_n: Float[np.ndarray, "2 rings samples"]
    open_share: Float[np.ndarray, " rings"]
    angle_share: Float[np.ndarray, " rings"]
    rest_m: Float[np.ndarray, "rings 2"]


@dataclass(frozen=True)
class _Modes:
    """Modes of both bodies in a row, by direction, and their shapes at rings (barrel less cradle), forces, sensors."""

    omega: Float[np.ndarray, "2 modes"]
    damping: Float[np.ndarray, "2 modes"]
    rings: Float[np.ndarray, "rings modes"]
    force: Float[np.ndarray, " modes"]
    sensors: Float[np.ndarray, "sensors modes"]
    carried: Float[np.ndarray, " modes"]
    rigid: Float[np.ndarray, " modes"]


def simulated(machine: SpaceMachine, rms_n: float, samples: int, rate_hz: float, seed: int) -> SpaceRecord:
    """One record under two Gaussian forces of that root mean square, which begin after `BEGINS_S` at rest."""
    of_force, of_noise = np.random.default_rng(seed).spawn(2)
    modes, factor = _modes(machine), round(1 / (STEP_S * rate_hz * SENSED_STEPS))
    steps = round((LEAD_S + TAIL_S + samples / rate_hz) / STEP_S)
    forces = np.array([_force(steps, rms_n, of_force) for _ in range(2)])
    start, rest_m = _at_rest(machine, modes)
    sensed, touched, open_steps, angles = _run(
        np.array([_rotation(modes, direction) for direction in range(2)]),
        modes.rings,
        modes.rings @ modes.rings.T,
        modes.force,
        -GRAVITY_M_PER_S2 * machine.gravity * modes.carried,
        modes.sensors,
        _laws(machine),
        forces,
        start,
    )
    delays = [[s.delay_s[direction] for s in machine.sensors] for direction in range(2)]
    count, rings = len(machine.sensors), len(machine.rings)
    sampler = Sampler(factor, np.r_[0.0, 0.0, np.ravel(delays), np.zeros(4 * rings)] / (STEP_S * SENSED_STEPS))
    skipped = round(LEAD_S / (STEP_S * SENSED_STEPS)) - sampler.reach
    accelerations = np.diff(sensed, 2, prepend=sensed[..., :1], append=sensed[..., -1:]) / (SENSED_STEPS * STEP_S) ** 2
    rows = [_between(forces), accelerations.reshape(2 * count, -1), touched.reshape(4 * rings, -1)]
    sampler.add(np.concatenate(rows)[:, skipped:])
    taken = sampler.samples()[:, :samples]
    moved, (eta_m, rings_n) = taken[2 : 2 + 2 * count], taken[2 + 2 * count :].reshape(2, 2, rings, -1)
    return SpaceRecord(
        forces_n=np.array(machine.force_gain)[:, None] * taken[:2],
        accelerations=_delivered(machine, moved.reshape(2, count, -1), rate_hz, of_noise),
        eta_m=eta_m,
        rings_n=rings_n,
        open_share=open_steps / steps,
        angle_share=angles.mean(axis=1),
        rest_m=rest_m,
    )


def _modes(machine: SpaceMachine) -> _Modes:
    bodies = (machine.barrel, machine.cradle)
    found = []
    for tube in bodies:
        width_m, thickness_m = tube.rectangle_m
        beam = TrueBeam(
            name=tube.name,
            clamped=tube.clamped,
            length_m=tube.length_m,
            width_m=width_m,
            thickness_m=thickness_m,
            youngs_modulus_pa=210e9,
            density_kg_per_m3=tube.density_kg_per_m3,
            damping_ratio=tube.damping_ratio,
            masses=tube.masses,
        )
        found.append(modes_of(beam))
    kept = [m.omega_rad_per_s < 2 * np.pi * HIGHEST_HZ for m in found]

    def row(body: int, position_m: float, sign: float) -> Float[np.ndarray, " modes"]:
        shapes = [np.zeros(int(k.sum())) for k in kept]
        shapes[body] = sign * found[body].shapes(position_m)[kept[body]]
        return np.concatenate(shapes)

    def factors(name: str) -> Float[np.ndarray, "2 modes"]:
        rows = [getattr(tube, name) for tube in bodies]
        rows = [np.ones((2, MODES)) if r is None else r for r in rows]
        return np.concatenate([r[:, k] for r, k in zip(rows, kept, strict=True)], axis=1)

    omega = np.concatenate([m.omega_rad_per_s[k] for m, k in zip(found, kept, strict=True)])
    damping = np.concatenate([m.damping_ratio[k] for m, k in zip(found, kept, strict=True)])
    names = [tube.name for tube in bodies]
    return _Modes(
        omega=omega * factors("frequency_factors"),
        damping=damping * factors("damping_factors"),
        rings=np.array([row(0, r.barrel_m, 1.0) + row(1, r.cradle_m, -1.0) for r in machine.rings]),
        force=row(0, machine.force_m, 1.0),
        sensors=np.array([row(names.index(s.body), s.position_m, 1.0) for s in machine.sensors]),
        carried=np.concatenate([m.carried[k] for m, k in zip(found, kept, strict=True)]),
        rigid=omega == 0,
    )


def _laws(machine: SpaceMachine) -> Float[np.ndarray, "rings 6"]:
    return np.array(
        [
            [r.clearance_m, r.stiffness_n_per_m, r.damping_n_s_per_m, r.friction, r.sliding_speed_m_per_s, r.onset_m]
            for r in machine.rings
        ]
    )


def _force(steps: int, rms_n: float, rng: np.random.Generator) -> Float[np.ndarray, " steps"]:
    """Band-limited Gaussian force that rises after the quiet second."""
    length = next_fast_len(steps, real=True)
    hz = np.fft.rfftfreq(length, STEP_S)
    inside = (hz >= BAND_HZ[0]) & (hz <= BAND_HZ[1])
    lines = np.zeros(hz.size, dtype=complex)
    lines[inside] = rng.standard_normal((2, int(inside.sum()))).T @ np.array([1, 1j])
    signal = np.fft.irfft(lines, length)[:steps]
    rise = np.clip((np.arange(steps) * STEP_S - LEAD_S - BEGINS_S) / RISE_S, 0, 1)
    return np.asarray(rms_n / signal.std() * signal * (3 * rise**2 - 2 * rise**3))


def _between(forces: Float[np.ndarray, "2 steps"]) -> Float[np.ndarray, "2 some"]:
    """Means of the forces that a second difference over `SENSED_STEPS` takes of what moves: a triangle."""
    triangle = np.convolve(np.ones(SENSED_STEPS), np.ones(SENSED_STEPS)) / SENSED_STEPS**2
    return np.array([np.convolve(row, triangle, "same")[::SENSED_STEPS] for row in forces])


def _at_rest(machine: SpaceMachine, modes: _Modes) -> tuple[Float[np.ndarray, "2 modes"], Float[np.ndarray, "rings 2"]]:
    """Modal coordinates at rest, and eta there: the barrel lies in two rings, or floats in their middle."""
    start, rest_m = np.zeros_like(modes.omega), np.zeros((len(machine.rings), 2))
    if not machine.gravity:
        return start, rest_m
    weight = -GRAVITY_M_PER_S2 * modes.carried
    rings_n = np.linalg.solve(modes.rings[:, modes.rigid].T, weight[modes.rigid])  # forces that the rings take
    laws = _laws(machine)
    rest_m[:, 0] = np.sign(rings_n) * (laws[:, 0] + np.abs(rings_n) / laws[:, 1])
    elastic = ~modes.rigid
    net = weight - modes.rings.T @ rings_n
    omega = modes.omega[0, elastic]
    start[0, elastic] = net[elastic] * STEP_S / 2 / (omega * np.tan(omega * STEP_S / 2))  # at rest from kick to kick
    left_m = rest_m[:, 0] - modes.rings @ start[0]
    start[0, modes.rigid] = np.linalg.solve(modes.rings[:, modes.rigid], left_m)
    return start, rest_m


def _rotation(modes: _Modes, direction: int) -> Float[np.ndarray, "modes 4"]:
    """Exact free motion of each mode over one step: (q, v) to (q, v)."""
    rows = []
    for omega, zeta in zip(modes.omega[direction], modes.damping[direction], strict=True):
        if omega == 0:
            rows.append([1.0, STEP_S, 0.0, 1.0])
            continue
        decay, turning = zeta * omega, omega * np.sqrt(1 - zeta**2)
        shrink, c, s = np.exp(-decay * STEP_S), np.cos(turning * STEP_S), np.sin(turning * STEP_S)
        rows.append(
            [
                shrink * (c + decay / turning * s),
                shrink * s / turning,
                -shrink * omega**2 / turning * s,
                shrink * (c - decay / turning * s),
            ]
        )
    return np.array(rows)


@njit(cache=True, fastmath=True)
@no_type_check
def _ring_force(law, y, z, vy, vz, softness):
    """Force of a ring that itself changes the velocity by -softness times it: implicit, as friction is steep."""
    d, k, c, mu, v0, onset = law
    r = np.sqrt(y * y + z * z)
    depth = r - d
    if depth <= 0.0:
        return 0.0, 0.0
    ey, ez = y / r, z / r
    along, across = ey * vy + ez * vz, ey * vz - ez * vy
    damping = c * min(1.0, depth / onset)
    normal = max(0.0, (k * depth + damping * along) / (1.0 + softness * damping))
    low, high = min(across, 0.0), max(across, 0.0)
    slid = across
    for _ in range(40):  # slid + softness mu f_n tanh(slid / v0) = across, by Newton within its bracket
        turned = np.tanh(slid / v0)
        left = slid + softness * mu * normal * turned - across
        if left > 0.0:
            high = slid
        else:
            low = slid
        if abs(left) < 1e-12:
            break
        slid -= left / (1.0 + softness * mu * normal * (1.0 - turned * turned) / v0)
        if not low < slid < high:
            slid = 0.5 * (low + high)
    rub = mu * normal * np.tanh(slid / v0)
    return normal * ey - rub * ez, normal * ez + rub * ey


@njit(cache=True, fastmath=True)
@no_type_check
def _run(rotation, rings, softness, force_shape, weight, sensors, laws, forces, start):  # noqa: PLR0912
    steps, count, modes = forces.shape[1], rings.shape[0], rings.shape[1]
    sensed = np.zeros((2, sensors.shape[0], (steps + SENSED_STEPS - 1) // SENSED_STEPS))
    touched = np.zeros((2, 2, count, sensed.shape[2]))
    open_steps, angles = np.zeros(count), np.zeros((count, 36))
    q, v = start.copy(), np.zeros_like(start)
    eta, rate, push = np.zeros((2, count)), np.zeros((2, count)), np.zeros((2, count))
    half = STEP_S / 2
    by_force = rings @ force_shape
    by_weight = rings @ weight
    for step in range(steps):
        for direction in range(2):
            for j in range(count):
                position, speed = 0.0, 0.0
                for m in range(modes):
                    position += rings[j, m] * q[direction, m]
                    speed += rings[j, m] * v[direction, m]
                eta[direction, j] = position
                outer = by_force[j] * forces[direction, step] + (by_weight[j] if direction == 0 else 0.0)
                rate[direction, j] = speed + half * outer
        for _ in range(4):  # the velocity in the middle of the kick, with the rings' forces
            for j in range(count):
                vy, vz = rate[0, j], rate[1, j]
                for i in range(count):
                    if i == j:
                        continue
                    vy -= half * softness[j, i] * push[0, i]
                    vz -= half * softness[j, i] * push[1, i]
                push[0, j], push[1, j] = _ring_force(laws[j], eta[0, j], eta[1, j], vy, vz, half * softness[j, j])
        if step % SENSED_STEPS == 0:
            taken = step // SENSED_STEPS
            for direction in range(2):
                touched[0, direction, :, taken] = eta[direction]
                touched[1, direction, :, taken] = push[direction]
                for i in range(sensors.shape[0]):
                    position = 0.0
                    for m in range(modes):
                        position += sensors[i, m] * q[direction, m]
                    sensed[direction, i, taken] = position
        for j in range(count):
            if push[0, j] == 0.0 and push[1, j] == 0.0:
                open_steps[j] += 1
            else:
                angles[j, int((np.arctan2(eta[1, j], eta[0, j]) / (2 * np.pi) + 0.5) * 36) % 36] = 1
        for direction in range(2):
            for m in range(modes):
                drive = force_shape[m] * forces[direction, step] + (weight[m] if direction == 0 else 0.0)
                for j in range(count):
                    drive -= rings[j, m] * push[direction, j]
                kicked = v[direction, m] + STEP_S * drive
                if step == 0:
                    kicked = half * drive  # the middle of the first kick is at rest
                a, b, c, e = rotation[direction, m]
                position = q[direction, m]
                q[direction, m] = a * position + b * kicked
                v[direction, m] = c * position + e * kicked
    return sensed, touched, open_steps, angles


def _delivered(
    machine: SpaceMachine, motion: Float[np.ndarray, "2 sensors samples"], rate_hz: float, rng: np.random.Generator
) -> Float[np.ndarray, "2 sensors samples"]:
    """Signals of the accelerometers: gain, the other axis, the high-pass (over the record's lines), noise."""
    samples = motion.shape[2]
    hz = np.fft.rfftfreq(2 * samples, 1 / rate_hz)
    delivered = np.empty_like(motion)
    for direction in range(2):
        for i, sensor in enumerate(machine.sensors):
            row = motion[direction, i] + sensor.crossing[direction] * motion[1 - direction, i]
            if corner_hz := sensor.highpass_hz[direction]:
                passed = 1j * hz / (1j * hz + corner_hz)
                row = np.fft.irfft(np.fft.rfft(row, 2 * samples) * passed, 2 * samples)[:samples]
            noise = sensor.noise_density * np.sqrt(rate_hz / 2) * rng.standard_normal(samples)
            delivered[direction, i] = sensor.gain[direction] * row + noise
    return delivered
