"""The contact forces, each by itself and over time, without assuming a law: from all stations and the linear model."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float
from scipy.fft import next_fast_len
from scipy.ndimage import uniform_filter1d

from identify.signals.kinematics import CORNER_HZ, TAPER_S, Kinematics, integrated, taper
from identify.signals.spectra import decimated
from identify.structure.modal import transformation
from identify.structure.response import Response, across, response_of
from rig.errors import RigError
from rig.model.description import Body, Rig
from rig.model.tolerances import Tolerances

SMOOTHED_HZ = 1.0
LEFT_OUT_S = 2.5
"""At the end of a record, where the beams' ringing is cut off, the separated forces are wrong."""
RING_S = 12.0

NuisanceSignal = tuple[Float[np.ndarray, "contacts fewer"], Float[np.ndarray, "contacts samples"]]


@dataclass(frozen=True)
class ContactForces:
    """Contact forces (N), low-passed and sampled at the record's rate over `factor`.

    Each doubt is what one standard deviation of one uncertain thing (a gain, a position, a modal parameter) would do to
    the forces and to the relative displacements. spring_n_per_m is the linear spring to the ground under the contacts.
    """

    force_n: Float[np.ndarray, "contacts fewer"]
    factor: int
    nuisance_signals: tuple[NuisanceSignal, ...]
    spring_n_per_m: float

    def after(self, fewer: int) -> "ContactForces":
        """Without the first samples, so many of the forces."""
        more = fewer * self.factor
        nuisance_signals = tuple((force[:, fewer:], eta[:, more:]) for force, eta in self.nuisance_signals)
        return replace(self, force_n=self.force_n[:, fewer:], nuisance_signals=nuisance_signals)


def separated_forces(
    rig: Rig, motion: Kinematics, factor: int, noise: Float[np.ndarray, " stations"], tolerances: Tolerances
) -> ContactForces:
    """The contact forces between bodies from all their stations, or of one mass from its equation of motion.

    Raises RigError if the stations cannot tell the contacts apart, or the contacts hold more than can float.
    """
    if rig.bodies[0].is_mass and len(rig.bodies) == len(rig.contacts) == 1:
        return _on_mass(rig.bodies[0], motion, factor, tolerances)
    return _between_bodies(rig, motion, factor, noise, tolerances)


def _on_mass(mass: Body, motion: Kinematics, factor: int, tolerances: Tolerances) -> ContactForces:
    """F - m a - c v - k x."""
    natural, ratio = 2 * np.pi * mass.frequencies_hz(1)[0], mass.damping_ratios(1)[0]
    stiffness_n_per_m = float(mass.mass_kg * natural**2)
    inertia = mass.mass_kg * motion.acceleration_m_per_s2[:1]
    damping = 2 * ratio * mass.mass_kg * natural * motion.velocity_m_per_s[:1]
    spring = stiffness_n_per_m * motion.displacement_m[:1]
    nothing = np.zeros_like(spring)
    nuisance_signals = (
        (-tolerances.gain * (inertia + damping + spring), tolerances.gain * motion.displacement_m[:1]),
        (-2 * tolerances.frequency * spring, nothing),
        (-tolerances.damping * damping, nothing),
    )
    return ContactForces(
        force_n=decimated(motion.force_n - inertia - damping - spring, factor),
        factor=factor,
        nuisance_signals=tuple((decimated(force, factor), eta) for force, eta in nuisance_signals if np.any(force)),
        spring_n_per_m=stiffness_n_per_m,
    )


def _between_bodies(
    rig: Rig, motion: Kinematics, factor: int, noise: Float[np.ndarray, " stations"], tolerances: Tolerances
) -> ContactForces:
    """Generalised least squares, frequency by frequency, of all stations' accelerations A on the contact forces f:

        A = G_F F - sum_j G_j f_j + error

    with G the accelerances of the rig's description (all modes), and the error's covariance the sensors' noise plus
    what the tolerances do to each channel and each mode at the response that was measured.

    noise is the standard deviation per sample of each station's acceleration (m/s^2).

    Raises RigError if the stations cannot tell the contacts apart, or the contacts hold more than can float.
    """
    samples, rate = motion.force_n.size, motion.sample_rate_hz
    length = factor * next_fast_len(-(-(samples + round(RING_S * rate)) // factor), real=True)
    kept = (samples - round(LEFT_OUT_S * rate)) // factor
    lines = length // factor // 2 + 1
    omega = 2 * np.pi * np.arange(lines) * rate / length
    force, measured = (_spectrum(x, rate, length)[..., :lines] for x in (motion.force_n, motion.acceleration_m_per_s2))
    responses = tuple(response_of(rig, body, omega) for body in rig.bodies)
    drives = _accelerances(rig, motion, responses)
    to_contacts = -drives[:, :, 1:]
    told = int(np.linalg.matrix_rank(to_contacts[0]))
    if told < len(rig.contacts):
        raise RigError(
            f"accelerations tell the constant forces of {told} of the {len(rig.contacts)} contacts, as constant forces "
            "only move bodies that float; describe fewer contacts, and a body that floats by its modes at 0 Hz"
        )
    covariance = np.zeros((lines, *[len(motion.stations)] * 2), dtype=complex)
    index = np.arange(len(motion.stations))
    covariance[:, index, index] = (samples * noise**2)[None, :] + tolerances.gain**2 * _smoothed(
        measured, rate, length
    ).T
    of_sensors: list[Complex[np.ndarray, "stations lines"]] = (
        [tolerances.gain * measured[i] * (index == i)[:, None] for i in index] if tolerances.gain else []
    )
    of_model: list[Complex[np.ndarray, "stations lines"]] = []
    for response in responses:
        rows, coordinates = _modal_response(rig, response.body, motion, measured)
        told_modes, stations = len(coordinates), [motion.stations[row] for row in rows]
        slopes, shapes = response.slopes(stations)[:, :told_modes], response.shapes(stations)[:, :told_modes]
        power = _smoothed(coordinates, rate, length)
        covariance[:, rows, rows] += tolerances.position_m**2 * (slopes**2 @ power).T
        if tolerances.position_m:
            moved = slopes @ coordinates
            for i, row in enumerate(rows):
                change = np.zeros_like(measured)
                change[row] = tolerances.position_m * moved[i]
                of_sensors.append(change)
        for kind, sensitivity in response.sensitivities.items():
            off = getattr(tolerances, kind) * sensitivity[:told_modes]
            if not np.any(off):
                continue
            covariance[:, rows[:, None], rows[None, :]] += np.einsum(
                "sm,mf,tm->fst", shapes, np.abs(off) ** 2 * power, shapes
            )
            for own in (np.ones(len(off)), *np.eye(len(off))):  # all modes together, and each by itself
                change = np.zeros_like(measured)
                change[rows] = (shapes * own) @ (off * coordinates)
                if np.any(change):
                    of_model.append(change)
    floor = 1e-9 * np.einsum("fii->f", covariance).real.mean() / len(index)
    covariance[:, index, index] += max(floor, 1e-12 * float(np.mean(np.abs(measured) ** 2)))
    weighted = np.linalg.solve(covariance, to_contacts)
    normal = weighted.conj().transpose(0, 2, 1) @ to_contacts
    condition = np.linalg.cond(normal[len(normal) // 4])
    if not np.isfinite(condition) or condition > 1e12:
        raise RigError("the stations cannot tell the contact forces apart; measure more stations on both bodies")
    inverse = np.linalg.inv(normal)
    gain = inverse @ weighted.conj().transpose(0, 2, 1)
    known = measured - drives[:, :, 0].T * force

    def in_time(spectra: Complex[np.ndarray, "stations lines"]) -> Float[np.ndarray, "contacts fewer"]:
        found = np.einsum("fjs,sf->jf", gain, spectra)
        found[:, 0] = found[:, 0].real
        return np.asarray(np.fft.irfft(found, length // factor)[:, :kept] / factor)

    return ContactForces(
        force_n=in_time(known),
        factor=factor,
        nuisance_signals=(
            *((in_time(c), _eta_change(rig, motion, c, length)) for c in of_sensors),
            *((in_time(c), np.zeros((len(rig.contacts), motion.force_n.size))) for c in of_model),
        ),
        spring_n_per_m=0.0,
    )


def _accelerances(
    rig: Rig, motion: Kinematics, responses: tuple[Response, ...]
) -> Complex[np.ndarray, "lines stations inputs"]:
    """Acceleration of every station per newton at the exciting force (first) and in each contact's direction."""
    found = sum(
        r.transfer(r.shapes(motion.stations), np.concatenate([r.shapes([rig.force_at]), across(rig, r)]))
        for r in responses
    )
    return np.ascontiguousarray(np.transpose(found, (2, 1, 0)))


def _modal_response(
    rig: Rig, body: Body, motion: Kinematics, measured: Complex[np.ndarray, "stations lines"]
) -> tuple[np.ndarray, Complex[np.ndarray, "modes lines"]]:
    """The body's station rows and its modal accelerations."""
    transform = transformation(rig, body, motion)
    rows = np.array(transform.rows)
    return rows, transform.inverse @ measured[rows]


def _eta_change(
    rig: Rig, motion: Kinematics, change: Complex[np.ndarray, "stations lines"], length: int
) -> Float[np.ndarray, "contacts samples"]:
    """What a change of the measured accelerations does to the relative displacements; slow motion aside."""
    omega = 2 * np.pi * np.arange(change.shape[1]) * motion.sample_rate_hz / length
    displaced = np.zeros((change.shape[0], length // 2 + 1), dtype=complex)
    displaced[:, : omega.size] = change * integrated(omega, -2, CORNER_HZ)
    found = np.zeros((len(rig.contacts), motion.force_n.size))
    for j, contact in enumerate(rig.contacts):
        for station, sign in ((contact.at, 1.0), (contact.against, -1.0)):
            row = None if station is None else motion.row(station)
            if row is not None and np.any(change[row]):
                found[j] += sign * np.fft.irfft(displaced[row], length)[: motion.force_n.size]
    return found


def _spectrum(
    signals: Float[np.ndarray, "*rows samples"], rate: float, length: int
) -> Complex[np.ndarray, "*rows lines"]:
    """With its end tapered off and silence behind, so that what rings on after it does not wrap round to its start."""
    return np.asarray(np.fft.rfft(signals * taper(signals.shape[-1], round(TAPER_S * rate)), length))


def _smoothed(spectra: Complex[np.ndarray, "rows lines"], rate: float, samples: int) -> Float[np.ndarray, "rows lines"]:
    return np.asarray(uniform_filter1d(np.abs(spectra) ** 2, max(1, round(SMOOTHED_HZ * samples / rate)), axis=1))
