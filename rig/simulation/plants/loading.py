"""Loads on a rig beside its measured force: true force, base motion, cubic springs, dampers, static loads."""

import numpy as np
import scipy
from jaxtyping import Complex, Float

from rig.errors import RigError
from rig.model.contact_laws import ContactLaw
from rig.model.description import RISE_S, Contact, Rig, Station, contact_stations
from rig.model.modes import modes_of
from rig.simulation.excitation import noise_spectrum
from rig.simulation.motion import ForceSignal

SPLINED = 64
"""So many samples to either side decide a spline's value to the last digit."""


def true_force(
    rig: Rig, measured_n: ForceSignal, step_s: float, now: slice = slice(None)
) -> Float[np.ndarray, " some"]:
    """The force on the rig, given the measured one at multiples of the step: F(t) = measured(t - lag) / gain.

    Before its first sample and behind its last the measured force is taken to stay as it is there.
    """
    sensor = rig.force_sensor
    if not sensor.lag_s:
        return measured_n[now] / sensor.gain
    first, stop, _ = now.indices(len(measured_n))
    shifted = np.arange(first, stop) - sensor.lag_s / step_s
    inside = np.clip(shifted, 0, len(measured_n) - 1)
    known = np.arange(max(0, int(inside[0]) - SPLINED), min(len(measured_n), int(inside[-1]) + SPLINED))
    between = scipy.interpolate.CubicSpline(known, measured_n[known[0] : known[-1] + 1])(inside)
    return np.where(shifted < 0, measured_n[:1], between) / sensor.gain


def base_motion(rig: Rig, samples: int, step_s: float) -> tuple[Float[np.ndarray, " samples"], ...]:
    """Displacement, velocity and acceleration of the base at multiples of the step, each the other's derivative.

    Empty where it stands still. It sets in from rest over half a second. Raises RigError if the band does not fit the
    record or the step.
    """
    base = rig.base_motion
    if base is None:
        return ()
    if base.high_hz * step_s > 0.25:
        raise RigError(f"step is {step_s} s; a base motion up to {base.high_hz} Hz needs at most 1/(4 high_hz)")
    spectrum = noise_spectrum(samples, step_s, base.low_hz, base.high_hz, base.seed)
    omega = 2 * np.pi * np.fft.rfftfreq(samples, step_s)
    velocity = np.divide(spectrum, 1j * omega, out=np.zeros_like(spectrum), where=omega > 0)
    displacement = np.divide(velocity, 1j * omega, out=np.zeros_like(spectrum), where=omega > 0)
    d, v, a = (_in_time(part, samples) for part in (displacement, velocity, spectrum))
    scale = base.acceleration_rms_m_per_s2 / np.sqrt(np.mean(a**2))
    s = np.clip(np.arange(samples) * step_s / RISE_S, 0, 1)
    rise, slope, bend = s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2, 60 * s * (1 - s) * (1 - 2 * s)
    slope, bend = slope / RISE_S, bend / RISE_S**2
    moved = (rise * d, slope * d + rise * v, bend * d + 2 * slope * v + rise * a)
    return tuple(scale * row for row in moved)


def connections(rig: Rig) -> tuple[Contact, ...]:
    """The contacts, then cubic springs and dampers, each a dead zone to the ground without clearance and stiffness."""

    springs = [s for s in rig.springs if s.cubic_n_per_m3]
    grounded = [(f"spring {i}", s.station, s.law) for i, s in enumerate(springs)]
    grounded += [(f"damper {i}", d.station, d.law) for i, d in enumerate(rig.dampers)]
    return (*rig.contacts, *(Contact(name=n, at=at, against=None, law=law) for n, at, law in grounded))


def softening_limits_m(rig: Rig) -> Float[np.ndarray, " connections"]:
    """Limit of each connection's motion, m: where a softening spring takes all of its body's stiffness.

    With the static stiffness k of the body at the spring, 1 / sum phi^2 / omega^2 over its modes, that is at
    sqrt(k / -k3): beyond, nothing pulls back. Infinite for all else, and for a body that contacts hold too.
    """
    limits = []
    touched = {station.body for contact in rig.contacts for station in contact_stations(contact)}
    for connection in connections(rig):
        cubic, station = getattr(connection.law, "cubic_n_per_m3", 0.0), connection.at
        free = cubic < 0 and station.body not in touched
        limits.append(np.sqrt(_static_stiffness(rig, station) / -cubic) if free else np.inf)
    return np.array(limits)


def check_softening(
    limits_m: Float[np.ndarray, " connections"], eta_m: Float[np.ndarray, "connections samples"]
) -> None:
    """Raises RigError if a softening spring has moved beyond its limit."""
    for limit, moved in zip(limits_m, eta_m, strict=True):
        if np.isfinite(limit) and np.abs(moved).max() > limit:
            raise RigError(
                f"a softening spring has let go: the body moved by {np.abs(moved).max():.3g} m, and beyond {limit:.3g} "
                "m nothing pulls it back; let it soften less, or excite less"
            )


def _static_stiffness(rig: Rig, station: Station) -> float:
    """Zero of a body that floats."""
    body = rig.body(station.body)
    modes, count = modes_of(rig, body), body.max_modes
    omega = 2 * np.pi * modes.frequencies_hz(count)
    if not np.all(omega > 0):
        return 0.0
    return float(1 / np.sum((modes.shapes(np.array([station.position_m]), count)[0] / omega) ** 2))


def equilibrium(
    squares: Float[np.ndarray, " modes"],
    across: Float[np.ndarray, "connections modes"],
    laws: tuple[ContactLaw, ...],
    load: Float[np.ndarray, " modes"],
) -> Float[np.ndarray, " modes"]:
    """Equilibrium of the rig under a static load, in modal coordinates, `squares` being omega^2.

    What floats unloaded stays at zero, and what floats under a load is pushed to where the stops hold it. A motion that
    nothing holds but friction or dampers begins at rest at zero, and the load moves it from there. Raises RigError if
    nothing resists it.
    """
    small = 1e-6 * float(np.linalg.norm(load))
    if not small:
        return np.zeros(load.size)
    q, unheld, stiffness = _least_energy(squares, across, laws, load)
    if np.linalg.norm(unheld) < small:
        return q
    motions = scipy.linalg.null_space(stiffness, rcond=1e-12)
    resisting = across[[law.acts_in_the_gap for law in laws]] @ motions
    pushing = unheld @ motions
    if np.linalg.norm(pushing - pushing @ np.linalg.pinv(resisting) @ resisting) > small:
        raise RigError("nothing holds a body against its static load; add a spring or a contact, or take the load off")
    held = load - unheld
    return _least_energy(squares, across, laws, held)[0] if np.linalg.norm(held) > small else np.zeros(load.size)


def _least_energy(
    squares: Float[np.ndarray, " modes"],
    across: Float[np.ndarray, "connections modes"],
    laws: tuple[ContactLaw, ...],
    load: Float[np.ndarray, " modes"],
) -> tuple[Float[np.ndarray, " modes"], Float[np.ndarray, " modes"], Float[np.ndarray, "modes modes"]]:
    """The least of the convex energy sum omega^2 q^2 / 2 + sum U_j(across_j q) - load q, reached by proximal steps from
    zero; the part of the load that nothing holds there, and the tangent stiffness."""
    q = np.zeros(load.size)

    def energy(at: Float[np.ndarray, " modes"]) -> float:
        stored = sum(float(law.energy_j(eta)) for law, eta in zip(laws, across @ at, strict=True))
        return float(squares @ at**2 / 2 + stored - load @ at)

    def slopes(at: Float[np.ndarray, " modes"]) -> tuple[Float[np.ndarray, " modes"], Float[np.ndarray, "modes modes"]]:
        both = list(zip(laws, across @ at, strict=True))
        forces = np.array([float(law.force_n(eta)) for law, eta in both])
        tangent = np.array([float(law.by_eta_n_per_m(eta)) for law, eta in both])
        return squares * at + forces @ across - load, np.diag(squares) + (across.T * tangent) @ across

    for hold in 100.0 * 0.7 ** np.arange(60):  # stiffness that ties every mode to where it was before
        anchor = q
        for _ in range(30):
            force, stiffness = slopes(q)
            force = force + hold * (q - anchor)
            if np.linalg.norm(force) < 1e-9 * np.linalg.norm(load):
                break
            step = np.linalg.solve(stiffness + hold * np.eye(q.size), force)
            before = energy(q) + hold * np.sum((q - anchor) ** 2) / 2
            while energy(q - step) + hold * np.sum((q - step - anchor) ** 2) / 2 > before + 1e-12 * abs(before):
                step = step / 2
            q = q - step
        if np.linalg.norm(q - anchor) < 1e-12 * np.linalg.norm(q):
            break
    for _ in range(3):
        force, stiffness = slopes(q)
        q = q - np.linalg.lstsq(stiffness, force, rcond=1e-12)[0]
    force, stiffness = slopes(q)
    return q, -force, stiffness


def _in_time(spectrum: Complex[np.ndarray, " lines"], samples: int) -> Float[np.ndarray, " samples"]:
    return np.fft.irfft(spectrum, samples)
