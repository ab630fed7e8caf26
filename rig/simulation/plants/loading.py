"""Loads on a rig besides its measured force: true force, base motion, cubic springs, dampers, static loads."""

from collections.abc import Iterator, Sequence

import numpy as np
import scipy
from jaxtyping import Float

from rig.errors import RigError
from rig.model.contact_laws import ContactLaw
from rig.model.description import RISE_S, Contact, Rig, Station, contact_rows, contact_stations
from rig.model.modes import modes_of
from rig.model.space import in_plane
from rig.simulation.excitation import noise_spectrum
from rig.simulation.motion import Forces, ForceSignal

SPLINE_SUPPORT = 64
"""Samples on either side that determine a cubic spline to rounding."""

ConnectionVector = Float[np.ndarray, " connections"]
ModalVector = Float[np.ndarray, " modes"]
EtaRows = Float[np.ndarray, "connections modes"]
ModalMatrix = Float[np.ndarray, "modes modes"]


def true_force(
    rig: Rig, measured_force_n: ForceSignal, step_s: float, span: slice = slice(None)
) -> Float[np.ndarray, " some"]:
    """True force F(t) = measured(t - lag) / gain (N) from the measured one at multiples of the step.

    Before its first and after its last sample the measured force is taken as constant.
    """
    force_sensor = rig.force_sensor
    if not force_sensor.lag_s:
        return measured_force_n[span] / force_sensor.gain
    first_step, end_step, _ = span.indices(len(measured_force_n))
    shifted_steps = np.arange(first_step, end_step) - force_sensor.lag_s / step_s
    clipped_steps = np.clip(shifted_steps, 0, len(measured_force_n) - 1)
    knots_start, knots_end = int(clipped_steps[0]) - SPLINE_SUPPORT, int(clipped_steps[-1]) + SPLINE_SUPPORT
    knots = np.arange(max(0, knots_start), min(len(measured_force_n), knots_end))
    interpolated_n = scipy.interpolate.CubicSpline(knots, measured_force_n[knots[0] : knots[-1] + 1])(clipped_steps)
    return np.where(shifted_steps < 0, measured_force_n[:1], interpolated_n) / force_sensor.gain


def base_motion(rig: Rig, sample_count: int, step_s: float) -> tuple[Float[np.ndarray, " samples"], ...]:
    """Consistent displacement, velocity and acceleration of the base at multiples of the step, by its description.

    Empty without base motion. The motion rises from rest over RISE_S from its start on. Raises RigError if the band
    does not fit the record or the step.
    """
    description = rig.base_motion
    if description is None:
        return ()
    if description.high_hz * step_s > 0.25:
        raise RigError(f"step is {step_s} s; a base motion up to {description.high_hz} Hz needs at most 1/(4 high_hz)")
    accel_spectrum = noise_spectrum(sample_count, step_s, description.low_hz, description.high_hz, description.seed)
    omega = 2 * np.pi * np.fft.rfftfreq(sample_count, step_s)
    velocity_spectrum = np.divide(accel_spectrum, 1j * omega, out=np.zeros_like(accel_spectrum), where=omega > 0)
    displacement_spectrum = np.divide(velocity_spectrum, 1j * omega, out=np.zeros_like(accel_spectrum), where=omega > 0)
    spectra = (displacement_spectrum, velocity_spectrum, accel_spectrum)
    d, v, a = (np.fft.irfft(transform, sample_count) for transform in spectra)
    rms_factor = description.acceleration_rms_m_per_s2 / np.sqrt(np.mean(a**2))
    rise_share = np.clip((np.arange(sample_count) * step_s - description.start_s) / RISE_S, 0, 1)
    rise = rise_share**3 * (10 - 15 * rise_share + 6 * rise_share**2)
    rise_slope = 30 * rise_share**2 * (1 - rise_share) ** 2 / RISE_S
    rise_curvature = 60 * rise_share * (1 - rise_share) * (1 - 2 * rise_share) / RISE_S**2
    unscaled_signals = (rise * d, rise_slope * d + rise * v, rise_curvature * d + 2 * rise_slope * v + rise * a)
    return tuple(rms_factor * unscaled_signal for unscaled_signal in unscaled_signals)


def base_motion_from_rig_or_force(
    rig: Rig, force_n: Forces, step_s: float
) -> tuple[Float[np.ndarray, " samples"], ...]:
    """Displacement, velocity and acceleration of the base at multiples of the step.

    They are those of `base_motion`, unless the force is on the ground and is not zero: it is then the inertial force
    on each kilogram (N/kg), minus the base's acceleration, which is integrated from rest by straight lines.
    """
    if rig.is_on_ground(rig.forces[0]) and np.any(inertial_n_per_kg := force_n.signals[0][:]):
        acceleration = -np.asarray(inertial_n_per_kg)
        velocity = scipy.integrate.cumulative_trapezoid(acceleration, dx=step_s, initial=0)
        return scipy.integrate.cumulative_trapezoid(velocity, dx=step_s, initial=0), velocity, acceleration
    return base_motion(rig, len(force_n), step_s)


def connections(rig: Rig) -> tuple[Contact, ...]:
    """Contacts by components (`contact_rows`), then cubic springs and dampers as dead zones to the ground without
    clearance and linear stiffness."""
    cubic_springs = [spring for spring in rig.springs if spring.cubic_n_per_m3]
    grounded = [(f"spring {i}", spring.station, spring.law) for i, spring in enumerate(cubic_springs)]
    grounded += [(f"damper {i}", damper.station, damper.law) for i, damper in enumerate(rig.dampers)]
    return (*contact_rows(rig), *(Contact(name=n, at=station, against=None, law=law) for n, station, law in grounded))


def softening_limits_m(rig: Rig) -> Float[np.ndarray, " connections"]:
    """Limit of each connection's motion, m: where a softening spring takes all of its body's stiffness.

    With the static stiffness k of the body at the spring, 1 / sum phi^2 / omega^2 over its modes, that is at
    sqrt(k / -k3): beyond, nothing pulls back. Infinite for all else, and for a body that contacts hold too.
    """
    limits_m = []
    touched_bodies = {station.body for contact in rig.contacts for station in contact_stations(contact)}
    for connection in connections(rig):
        cubic_n_per_m3, station = getattr(connection.law, "cubic_n_per_m3", 0.0), connection.at
        is_free = cubic_n_per_m3 < 0 and station.body not in touched_bodies
        limits_m.append(np.sqrt(_static_stiffness_n_per_m(rig, station) / -cubic_n_per_m3) if is_free else np.inf)
    return np.array(limits_m)


def check_softening_limits(
    limits_m: Float[np.ndarray, " connections"], eta_m: Float[np.ndarray, "connections samples"]
) -> None:
    """Raise RigError if a softening spring has moved beyond its limit."""
    for limit_m, connection_eta_m in zip(limits_m, eta_m, strict=True):
        if np.isfinite(limit_m) and np.abs(connection_eta_m).max() > limit_m:
            raise RigError(
                f"a softening spring has let go: the body moved by {np.abs(connection_eta_m).max():.3g} m, and beyond "
                f"{limit_m:.3g} m nothing pulls it back; let it soften less, or excite less"
            )


def _static_stiffness_n_per_m(rig: Rig, station: Station) -> float:
    """Static stiffness of a body at a station, N/m; zero if it has a rigid-body mode."""
    body = rig.body(station.body)
    modes, mode_count = modes_of(in_plane(rig, station.direction), body), body.max_modes
    omega = 2 * np.pi * modes.frequencies_hz(mode_count)
    if not np.all(omega > 0):
        return 0.0
    return float(1 / np.sum((modes.shapes(np.array([station.position_m]), mode_count)[0] / omega) ** 2))


def has_static_load(rig: Rig) -> bool:
    """True if constant forces or gravity act on a rig."""
    return bool(rig.loads or rig.gravity_m_per_s2)


def law_row_spans(laws: Sequence[ContactLaw]) -> Iterator[tuple[ContactLaw, slice]]:
    """Every law with its rows among the connections: one, or two of a law of both directions, which stands twice."""
    first_row = 0
    while first_row < len(laws):
        yield laws[first_row], slice(first_row, first_row + 1 + laws[first_row].spatial)
        first_row += 1 + laws[first_row].spatial


def connection_forces_n(
    laws: Sequence[ContactLaw], eta_m: ConnectionVector, rate_m_per_s: ConnectionVector, time_s: float = 0.0
) -> ConnectionVector:
    """Force of every connection at its relative displacement and rate, N."""
    forces_n = [law.force_n(eta_m[row_span], rate_m_per_s[row_span], time_s) for law, row_span in law_row_spans(laws)]
    return np.concatenate([np.zeros(0), *forces_n])


def equilibrium(
    omega_squared: ModalVector, eta_rows: EtaRows, laws: tuple[ContactLaw, ...], modal_load: ModalVector
) -> ModalVector:
    """Equilibrium of the rig under a static load, in modal coordinates.

    A floating motion without load stays at zero; a loaded one is pushed against the stops. A motion that only friction
    or dampers resist starts at rest at zero and is moved by the load. Raises RigError if nothing resists the load.
    """
    load_tolerance = 1e-6 * float(np.linalg.norm(modal_load))
    if not load_tolerance:
        return np.zeros(modal_load.size)
    rest_q, unbalanced_load, tangent_stiffness = _energy_minimum(omega_squared, eta_rows, laws, modal_load)
    if np.linalg.norm(unbalanced_load) < load_tolerance:
        return rest_q
    unresisted_motions = scipy.linalg.null_space(tangent_stiffness, rcond=1e-12)
    gap_law_rows = eta_rows[[law.acts_in_the_gap for law in laws]] @ unresisted_motions
    unresisted_load = unbalanced_load @ unresisted_motions
    if np.linalg.norm(unresisted_load - unresisted_load @ np.linalg.pinv(gap_law_rows) @ gap_law_rows) > load_tolerance:
        raise RigError("nothing holds a body against its static load; add a spring or a contact, or take the load off")
    resisted_load = modal_load - unbalanced_load
    if np.linalg.norm(resisted_load) > load_tolerance:
        return _energy_minimum(omega_squared, eta_rows, laws, resisted_load)[0]
    return np.zeros(modal_load.size)


def _energy_minimum(
    omega_squared: ModalVector, eta_rows: EtaRows, laws: tuple[ContactLaw, ...], modal_load: ModalVector
) -> tuple[ModalVector, ModalVector, ModalMatrix]:
    """Minimum of the convex energy sum omega^2 q^2 / 2 + sum U_j(eta_rows_j q) - modal_load q.

    Found by proximal Newton steps from zero. Returns the coordinates q, the unbalanced part of the load, and the
    tangent stiffness.
    """
    q = np.zeros(modal_load.size)

    def energy_j(trial_q: ModalVector) -> float:
        eta_m = eta_rows @ trial_q
        contact_energy_j = sum(float(np.sum(law.energy_j(eta_m[row_span]))) for law, row_span in law_row_spans(laws))
        return float(omega_squared @ trial_q**2 / 2 + contact_energy_j - modal_load @ trial_q)

    def gradient_and_stiffness(trial_q: ModalVector) -> tuple[ModalVector, ModalMatrix]:
        eta_m = eta_rows @ trial_q
        connection_stiffness = np.zeros(len(eta_rows))
        coupling = np.zeros((modal_load.size, modal_load.size))
        connection_forces = connection_forces_n(laws, eta_m, np.zeros(eta_m.size))
        for law, rows in law_row_spans(laws):
            law_stiffness = law.by_eta_n_per_m(eta_m[rows])
            connection_stiffness[rows] = np.diag(law_stiffness) if law.spatial else law_stiffness
            if law.spatial:
                coupling += law_stiffness[0, 1] * (np.outer(*eta_rows[rows]) + np.outer(*eta_rows[rows][::-1]))
        tangent_stiffness = np.diag(omega_squared) + (eta_rows.T * connection_stiffness) @ eta_rows
        if coupling.any():
            tangent_stiffness = tangent_stiffness + coupling
        return omega_squared * trial_q + connection_forces @ eta_rows - modal_load, tangent_stiffness

    for tie_stiffness in 100.0 * 0.7 ** np.arange(60):  # stiffness that ties every mode to where it was before
        anchor_q = q

        def tied_energy_j(trial_q: ModalVector, tie: float = tie_stiffness, anchor: ModalVector = anchor_q) -> float:
            return float(energy_j(trial_q) + tie * np.sum((trial_q - anchor) ** 2) / 2)

        for _ in range(30):
            gradient, tangent_stiffness = gradient_and_stiffness(q)
            gradient = gradient + tie_stiffness * (q - anchor_q)
            if np.linalg.norm(gradient) < 1e-9 * np.linalg.norm(modal_load):
                break
            q_step = np.linalg.solve(tangent_stiffness + tie_stiffness * np.eye(q.size), gradient)
            energy_before_j = tied_energy_j(q)
            while tied_energy_j(q - q_step) > energy_before_j + 1e-12 * abs(energy_before_j):
                q_step = q_step / 2
            q = q - q_step
        if np.linalg.norm(q - anchor_q) < 1e-12 * np.linalg.norm(q):
            break
    for _ in range(3):
        gradient, tangent_stiffness = gradient_and_stiffness(q)
        q = q - np.linalg.lstsq(tangent_stiffness, gradient, rcond=1e-12)[0]
    gradient, tangent_stiffness = gradient_and_stiffness(q)
    return q, -gradient, tangent_stiffness
