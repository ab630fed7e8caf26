"""A machine that shares no line with the project: modes, one contact with two stops, and a force (numpy, scipy, pyuff).

q_r'' + 2 zeta_r w_r q_r' + w_r^2 q_r = phi_r(force) F - phi_r(contact) f(eta), eta = sum_r phi_r(contact) q_r. The
contact force f is zero for |eta| < d and k (|eta| - d) beyond, against eta. Between two changes of contact this is
linear and is solved by matrix exponentials, exactly for a force that is linear between its samples; a step during which
the contact changes is halved until the moment of the change is known to 2^-14 of it.
"""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.signal import firwin, oaconvolve

OVERSAMPLED = 8
HALVINGS = 14


@dataclass(frozen=True)
class Machine:
    """Mass-normalised shapes (1/sqrt(kg)), modes by columns: rows of the sensors, at the force, at the contact."""

    frequencies_hz: np.ndarray
    ratios: np.ndarray
    sensors: np.ndarray
    at_force: np.ndarray
    at_contact: np.ndarray
    clearance_m: float
    stiffness_n_per_m: float


def mass(mass_kg: float, frequency_hz: float, ratio: float, clearance_m: float, stiffness_n_per_m: float) -> Machine:
    """One mass on a spring, all at one place."""
    shape = np.array([1 / np.sqrt(mass_kg)])
    modes = np.array([frequency_hz]), np.array([ratio])
    return Machine(*modes, shape[None], shape, shape, clearance_m, stiffness_n_per_m)


def cantilever_modes(
    length_m: float, width_m: float, height_m: float, count: int, places_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (Hz) and mass-normalised shapes (places, modes) of a clamped steel beam, by Bernoulli's theory."""
    young, density = 210e9, 7850.0
    area, inertia = width_m * height_m, width_m * height_m**3 / 12
    roots = [brentq(lambda z: np.cos(z) + 1 / np.cosh(z), (n + 0.1) * np.pi, (n + 0.9) * np.pi) for n in range(count)]
    kl = np.array(roots)
    frequencies = kl**2 / (2 * np.pi * length_m**2) * np.sqrt(young * inertia / (density * area))
    x = np.multiply.outer(places_m / length_m, kl)
    ratio = (np.cos(kl) + np.cosh(kl)) / (np.sin(kl) + np.sinh(kl))
    shapes = np.cosh(x) - np.cos(x) - ratio * (np.sinh(x) - np.sin(x))  # mean square over the length is 1
    return frequencies, shapes / np.sqrt(density * area * length_m)


def noise_force(rms_n: float, band_hz: tuple[float, float], rate_hz: float, duration_s: float, seed: int) -> np.ndarray:
    """Band-limited Gaussian noise at the rate of the steps, after one quiet second."""
    count = round(rate_hz * OVERSAMPLED * duration_s)
    frequency = np.fft.rfftfreq(count, 1 / (rate_hz * OVERSAMPLED))
    inside = (frequency >= band_hz[0]) & (frequency <= band_hz[1])
    rng = np.random.default_rng(seed)
    spectrum = inside * (rng.standard_normal(frequency.size) + 1j * rng.standard_normal(frequency.size))
    force = np.fft.irfft(spectrum, count)
    time_s = np.arange(count) / (rate_hz * OVERSAMPLED)
    return rms_n * force / force.std() * np.clip((time_s - 1) / 0.1, 0, 1)


def motion(machine: Machine, force_n: np.ndarray, rate_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Displacements (m) and accelerations (m/s^2), one row a sensor, at the rate of the steps, from rest."""
    states = _states(machine, force_n, 1 / (rate_hz * OVERSAMPLED))
    count = machine.frequencies_hz.size
    eta = states[:, :count] @ machine.at_contact
    pressed = np.clip(eta, -machine.clearance_m, machine.clearance_m) - eta
    rigid, loss = _modal(machine)
    modal = -states[:, :count] * rigid - states[:, count:] * loss + np.multiply.outer(force_n, machine.at_force)
    modal += machine.stiffness_n_per_m * np.multiply.outer(pressed, machine.at_contact)
    return machine.sensors @ states[:, :count].T, machine.sensors @ modal.T


def measured(signal: np.ndarray, noise_density: float, rate_hz: float, seed: int) -> np.ndarray:
    """Filtered (linear phase, without delay), sampled at the rate, with white noise (one-sided density)."""
    taps = firwin(64 * OVERSAMPLED + 1, 0.9 / OVERSAMPLED)
    rows = [oaconvolve(row, taps, mode="same")[::OVERSAMPLED] for row in np.atleast_2d(signal)]
    noise = np.random.default_rng(seed).standard_normal((len(rows), rows[0].size))
    return np.array(rows) + noise_density * np.sqrt(rate_hz / 2) * noise


def write_csv(path: Path, names: Sequence[str], columns: Sequence[np.ndarray], rate_hz: float) -> None:
    """Time and columns, with a line of names."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["time", *names])
        time_s = np.arange(columns[0].size) / rate_hz
        writer.writerows(zip(*([f"{v:.9g}" for v in column] for column in (time_s, *columns)), strict=True))


def write_mode_shapes(
    path: Path, places_m: np.ndarray, frequencies_hz: np.ndarray, ratio: float, shapes: np.ndarray
) -> None:
    """Datasets 15 (nodes along x) and 55 (shapes in z of modal mass one), as an analysis writes them."""
    import pyuff

    nodes = np.arange(1, len(places_m) + 1)
    zeros = np.zeros(len(places_m))
    coordinates = dict(zip("xyz", (places_m, zeros, zeros), strict=True))
    sets = [{"type": 15, "node_nums": nodes, "def_cs": zeros, "disp_cs": zeros, "color": zeros, **coordinates}]
    for number, (frequency, shape) in enumerate(zip(frequencies_hz, shapes.T, strict=True), start=1):
        told = {"type": 55, "id1": f"mode {number}", "analysis_type": 2, "data_type": 2, "data_ch": 2}
        told |= {"spec_data_type": 8, "n_data_per_node": 3, "load_case": 1, "mode_n": number}
        told |= {"modal_m": 1.0, "freq": frequency, "modal_damp_vis": ratio, "modal_damp_his": 0.0}
        sets.append({**told, "model_type": 1, "node_nums": nodes, "r1": zeros, "r2": zeros, "r3": shape})
    path.unlink(missing_ok=True)
    pyuff.UFF(str(path)).write_sets(sets, mode="add")


def _modal(machine: Machine) -> tuple[np.ndarray, np.ndarray]:
    circular = 2 * np.pi * machine.frequencies_hz
    return circular**2, 2 * machine.ratios * circular


def _states(machine: Machine, force_n: np.ndarray, step_s: float) -> np.ndarray:
    """(steps, 2 modes), modal coordinates and velocities, one row a force sample."""
    count = machine.frequencies_hz.size
    row, clearance = np.concatenate([machine.at_contact, np.zeros(count)]), machine.clearance_m
    pieces = {side: _propagators(machine, side, step_s) for side in (-1, 0, 1)}

    def side(x: np.ndarray) -> int:
        eta = row @ x
        return int(eta > clearance) - int(eta < -clearance)

    def advanced(x: np.ndarray, force: float, slope: float, level: int) -> np.ndarray:
        begins = side(x)
        matrix, constant, by_force, by_slope = pieces[begins][level]
        after = matrix @ x + (constant + by_force * force + by_slope * slope)
        if level == HALVINGS or side(after) == begins:
            return np.asarray(after)
        half = advanced(x, force, slope / 2, level + 1)
        return advanced(half, force + slope / 2, slope / 2, level + 1)

    states = np.zeros((force_n.size, 2 * count))
    for n in range(1, force_n.size):
        states[n] = advanced(states[n - 1], force_n[n - 1], force_n[n] - force_n[n - 1], 0)
    return states


def _propagators(machine: Machine, side: int, step_s: float) -> list[tuple[np.ndarray, ...]]:
    """x after a step of step_s / 2^level is matrix x + constant + by_force F + by_slope dF, F linear over the step."""
    rigid, loss = _modal(machine)
    count = rigid.size
    pushed = abs(side) * machine.stiffness_n_per_m * machine.at_contact
    system = np.zeros((2 * count + 3, 2 * count + 3))  # x, 1, F, dF/dt
    system[:count, count : 2 * count] = np.eye(count)
    system[count : 2 * count, :count] = -np.diag(rigid) - np.multiply.outer(machine.at_contact, pushed)
    system[count : 2 * count, count : 2 * count] = -np.diag(loss)
    system[count : 2 * count, 2 * count] = side * pushed * machine.clearance_m
    system[count : 2 * count, 2 * count + 1] = machine.at_force
    system[2 * count + 1, 2 * count + 2] = 1.0
    pieces: list[tuple[np.ndarray, ...]] = []
    for level in range(HALVINGS + 1):
        h = step_s / 2**level
        whole = expm(system * h)[: 2 * count]
        pieces.append((whole[:, : 2 * count], whole[:, -3], whole[:, -2], whole[:, -1] / h))
    return pieces
