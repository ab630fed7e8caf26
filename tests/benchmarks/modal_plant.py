"""The modal plant: how fast at an error of 1e-4, against its arithmetic, and against scipy's solvers.

Error: rms of the difference in the relative displacements over their rms, in the first 0.2 s of contact under each of
four forces, against a step of 2^-18 s. The barrel in its cradle with 16 + 16 modes, two contacts, and its twelve
displacements and twelve accelerations. A solver that needs longer than one before it is stopped, and not listed.
"""

import time
from collections.abc import Iterator
from functools import cache

import msgspec
import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from rig.simulation.excitation import QUIET_S, force_history
from rig.simulation.motion import Motion, concatenated
from rig.simulation.plants import modal
from rig.simulation.reference import BarrelCradle
from tests.benchmarks.measuring import Figure, least_cpu_s

SETTINGS = BarrelCradle()
RIG = SETTINGS.rig()
FINE, LONG_S, MODES = 18, 32.0, 16
ERROR = 1e-4
SEEDS = (1, 2, 3, 4)
METHODS = ("RK45", "DOP853", "LSODA", "Radau", "BDF")


def figures() -> Iterator[Figure]:
    errors = {power: error([young(power, seed).eta_m for seed in SEEDS], 2.0**-power) for power in range(11, 15)}
    for power, found in errors.items():
        yield Figure(f"error at a step of 2^-{power} s", found)
    power = next(p for p in errors if max(errors[q] for q in errors if q >= p) <= ERROR)
    force_n = force_history(SETTINGS.force(), LONG_S, 2.0**-power)
    motion = concatenated(modal.simulate(RIG, force_n, 2.0**-power, lambda _: None))
    cpu_s = least_cpu_s(lambda: _run_through(force_n, 2.0**-power), times=10)
    yield Figure(f"simulated s per CPU s at 2^-{power} s", LONG_S / cpu_s, at_least=300)
    steps = force_n.size
    yield Figure("time per step", 1e9 * cpu_s / steps, "ns")
    floor_s = steps * _operations(motion) / _operations_per_s()
    yield Figure("time over that of the model's arithmetic", cpu_s / floor_s)
    rates = {}
    for method in METHODS:
        found = _fastest(method, min(rates.values(), default=np.inf))
        if found:
            rates[method] = found
            yield Figure(f"CPU s per simulated s of {method} at that error", found)
    yield Figure("times faster than the fastest of solve_ivp", min(rates.values()) * LONG_S / cpu_s, at_least=1000)


def _run_through(force_n: Float[np.ndarray, " samples"], step_s: float) -> None:
    """The sensors' rows come unasked; the relative displacements do not."""
    for block in modal.simulate(RIG, force_n, step_s, lambda _: None, modes_per_beam=MODES):
        block.eta_m[:, :]


@cache
def _force_n(seed: int) -> Float[np.ndarray, " samples"]:
    """The force of all steps is that of the finest."""
    excitation = msgspec.structs.replace(SETTINGS.force(), seed=seed)
    return force_history(excitation, QUIET_S + 0.5, 2.0**-FINE)[round(QUIET_S * 2**FINE) :]


@cache
def young(power: int, seed: int) -> Motion:
    force_n = _force_n(seed)[:: 2 ** (FINE - power)]
    return concatenated(modal.simulate(RIG, force_n, 2.0**-power, lambda _: None, modes_per_beam=MODES))


def _contact_s(seed: int) -> float:
    return float(np.argmax(young(FINE, seed).contact_force_n.any(axis=0))) * 2.0**-FINE


def error(found_m: list[Float[np.ndarray, "contacts samples"]], step_s: float) -> float:
    """Of the relative displacements under the first forces, from time 0 on, at a dyadic step."""
    wrong, size = 0.0, 0.0
    for seed, eta_m in zip(SEEDS, found_m, strict=False):
        begin_s = _contact_s(seed)
        now = slice(round(begin_s / step_s), round((begin_s + 0.2) / step_s))
        true_m = young(FINE, seed).eta_m[:, :: round(step_s * 2**FINE)][:, now]
        wrong += float(np.sum((eta_m[:, now] - true_m) ** 2))
        size += float(np.sum(true_m**2))
    return float(np.sqrt(wrong / size))


def _operations(motion: Motion) -> float:
    """Multiplications and additions that a step cannot do without, by the share of steps with each contact closed.

    A mode is advanced from q, q' and the force; q, q' are projected on every contact, and where it is closed its force
    and the bend of it on every mode; the rows asked for are projections of q, those of accelerations of q and q'.
    """
    modes, contacts = 2 * MODES, len(RIG.contacts)
    closed = np.count_nonzero(motion.contact_force_n) / motion.contact_force_n.shape[1]
    advance = 2 * modes * (2 + 3)
    across = 2 * modes * contacts + 2 * modes * 3 * closed
    displacements = modes * (sum(s.quantity == "displacement" for s in RIG.sensors) + contacts)
    accelerations = 2 * modes * sum(s.quantity == "acceleration" for s in RIG.sensors)
    return 2 * (advance + across + displacements + accelerations)


def _operations_per_s() -> float:
    """What this processor reaches in a product of two matrices, where nothing waits for memory."""
    size = 512
    a = np.random.default_rng(1).standard_normal((size, size))
    return 2 * size**3 / least_cpu_s(lambda: a @ a, times=10)


class _SlowError(Exception):
    pass


def _fastest(method: str, limit: float) -> float | None:
    """CPU seconds per simulated second at the loosest tolerance that gives the error; None if that is above a limit."""
    for exponent in range(3, 10):
        try:
            cpu_s, eta = _solved(method, 10.0**-exponent, limit)
        except _SlowError:
            return None
        if error([eta], 2.0**-12) <= ERROR:
            return cpu_s
    return None


def _solved(method: str, tolerance: float, limit: float) -> tuple[float, Float[np.ndarray, "contacts samples"]]:
    """The same modes and contacts as a right-hand side in numpy, the force as a spline."""
    model = modal.model_of(RIG, False, MODES)
    drive, across = model.modal_force_by_input[0], model.eta_rows
    squares, damping = model.omega**2, 2 * model.zeta * model.omega
    laws, count = [c.law for c in RIG.contacts], model.omega.size
    upper, lower, stiffness = (
        np.array([getattr(law, n) for law in laws])
        for n in ("upper_clearance_m", "lower_clearance_m", "stiffness_n_per_m")
    )
    force_n = _force_n(SEEDS[0])[:: 2 ** (FINE - 12)]
    force = CubicSpline(np.arange(force_n.size) * 2.0**-12, force_n)
    until = _contact_s(SEEDS[0]) + 0.2
    begin = time.process_time()

    def rates(time_s: float, state: Float[np.ndarray, " states"]) -> Float[np.ndarray, " states"]:
        if time.process_time() - begin > limit * until:
            raise _SlowError
        q, v = state[:count], state[count:]
        eta = across @ q
        contact_n = stiffness * (eta - np.minimum(np.maximum(eta, -lower), upper))
        return np.concatenate([v, drive * force(time_s) - across.T @ contact_n - damping * v - squares * q])

    times_s = np.arange(int(until * 2**12) + 1) * 2.0**-12
    start = np.zeros(2 * count)
    solution = solve_ivp(
        rates, (0, times_s[-1]), start, method=method, t_eval=times_s, rtol=tolerance, atol=1e-3 * tolerance
    )
    return (time.process_time() - begin) / until, across @ solution.y[:count]
