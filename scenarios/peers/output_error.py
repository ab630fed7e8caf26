"""Output error by multiple shooting with scipy: least squares over contacts and the initial state of every window."""

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from identify.pages.wording import COVERED
from scenarios.peers.peer_data import START_CLEARANCE, START_STIFFNESS, ContactAnswer, PeerData
from scenarios.peers.rollouts import Stepper, roll_out, stepper

WINDOWS_S = {1: (1 / 16, 1 / 4), 2: (1 / 64, 1 / 16)}
"""Windows by the number of contacts: of the first pass, within which a wrong clearance still lets the motion be
followed, and of the last."""
STEP_RATE_HZ = {1: 4096, 2: 8192}
"""Steps a second of the rollouts, by the number of contacts."""
OUTPUT_RATE_HZ = {1: 512, 2: 1024}
ROLLED_MODES_PER_BEAM = 8
"""Modes whose motion is rolled out; those above follow statically."""
DAMPING_SCALE_S = 1e-4
"""Unit of the damping's parameter: the damping over the stiffness that the search starts from."""
DIFF_STEP = 1e-6
"""Relative step of the numerical derivatives."""


@dataclass(frozen=True)
class Windows:
    """Windows of a recording: forces, measured outputs and initial states, and the model that simulates them."""

    system: Stepper
    scales: Float[np.ndarray, "contacts 3"]
    force_n: Float[np.ndarray, "windows times"]
    measured: Float[np.ndarray, "windows samples outputs"]
    starts: Float[np.ndarray, "windows states"]
    steps_per_output: int

    def residuals(
        self, laws: Float[np.ndarray, " parameters"], states: Float[np.ndarray, "windows states"]
    ) -> Float[np.ndarray, "windows residuals"]:
        """Simulated less measured outputs over the size of these; laws are shares of the scales."""
        values = self.scales * laws.reshape(self.scales.shape)
        outputs = roll_out(self.system, values, states, self.force_n, self.steps_per_output)
        return np.asarray((outputs - self.measured).reshape(len(states), -1) / np.std(self.measured))


def output_error(recording: PeerData) -> tuple[ContactAnswer, ...]:
    """Clearance and stiffness of every contact, with intervals by the residuals and their derivatives.

    One mass is fitted to its acceleration; two beams to the displacements, as accelerations hold more than the modes
    that are rolled out. Measured displacements and velocities give the initial states to start from.
    """
    contact_count = len(recording.names)
    stiffness_n_per_m = START_STIFFNESS * recording.true_stiffness_n_per_m
    scales = np.stack(
        [START_CLEARANCE * recording.true_clearance_m, stiffness_n_per_m, DAMPING_SCALE_S * stiffness_n_per_m], axis=1
    )
    laws = np.tile([1.0, 1.0, 0.0], contact_count)
    for window_s in WINDOWS_S[contact_count]:
        laws, standard_errors = _fit_windows(_windows(recording, scales, window_s), laws)
    estimates, half_widths = (scales * v.reshape(contact_count, 3) for v in (laws, COVERED * standard_errors))
    return tuple(
        ContactAnswer(
            contact=name,
            clearance_m=float(estimates[j, 0]),
            stiffness_n_per_m=float(estimates[j, 1]),
            clearance_half_width_m=float(half_widths[j, 0]),
            stiffness_half_width_n_per_m=float(half_widths[j, 1]),
        )
        for j, name in enumerate(recording.names)
    )


def _windows(recording: PeerData, scales: Float[np.ndarray, "contacts 3"], window_s: float) -> Windows:
    model, one_mass = recording.model, recording.model.omega.size == 1
    output_hz, step_hz = OUTPUT_RATE_HZ[len(recording.names)], STEP_RATE_HZ[len(recording.names)]
    modes_by_body = {body: np.flatnonzero(np.array(model.bodies) == body) for body in model.bodies}
    is_moving = np.zeros(model.omega.size, dtype=bool)
    for modes in modes_by_body.values():
        is_moving[modes[:ROLLED_MODES_PER_BEAM]] = True
    decimation = round(recording.sample_rate_hz / output_hz)
    outputs = (recording.acceleration_m_per_s2 if one_mass else recording.displacement_m)[:, ::decimation]
    output_count, steps_per_output = round(window_s * output_hz), step_hz // output_hz
    first_outputs = np.arange(0, outputs.shape[1] - output_count, output_count)
    sample_times_s = np.arange(recording.force_n.size) / recording.sample_rate_hz
    step_times_s = first_outputs[:, None] / output_hz + np.arange(output_count * steps_per_output + 1) / step_hz
    start_states = np.zeros((2, first_outputs.size, model.omega.size))
    for body, modes in modes_by_body.items():
        stations = np.flatnonzero(np.array(recording.station_bodies) == body)
        fitted_modes = modes[: stations.size]
        to_modes = np.linalg.pinv(model.sensor_rows[np.ix_(stations, fitted_modes)])
        for order, signal in enumerate((recording.displacement_m, recording.velocity_m_per_s)):
            start_states[order][:, fitted_modes] = (to_modes @ signal[np.ix_(stations, first_outputs * decimation)]).T
    return Windows(
        system=stepper(model, is_moving, 1 / step_hz, one_mass),
        scales=scales,
        force_n=CubicSpline(sample_times_s, recording.force_n)(step_times_s),
        measured=np.moveaxis(outputs[:, first_outputs[:, None] + np.arange(output_count + 1)], 0, -1),
        starts=np.hstack([start_states[0][:, is_moving], start_states[1][:, is_moving]]),
        steps_per_output=steps_per_output,
    )


def _fit_windows(
    windows: Windows, laws: Float[np.ndarray, " parameters"]
) -> tuple[Float[np.ndarray, " parameters"], Float[np.ndarray, " parameters"]]:
    """Laws that fit all windows, and their standard errors.

    Steps in the state of a window are taken along the columns of its triangular factor, so that scipy's iterative
    solver meets windows without ill-conditioned states.
    """
    window_count, state_count = windows.starts.shape
    state_scales = np.maximum(np.std(windows.starts, axis=0), 1e-3 * np.std(windows.starts, axis=0).max())
    directions = np.tile(np.diag(state_scales), (window_count, 1, 1))
    by_state, _ = _derivatives(windows, laws, windows.starts, directions)
    triangular_factors = np.linalg.qr(by_state, mode="r")
    directions = directions @ np.linalg.pinv(triangular_factors, rcond=1e-7)

    def unpacked(x: Float[np.ndarray, " all"]) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "windows states"]]:
        steps = x[laws.size :].reshape(window_count, state_count)
        return x[: laws.size], windows.starts + np.einsum("wij,wj->wi", directions, steps)

    def jacobian(x: Float[np.ndarray, " all"]) -> scipy.sparse.csr_matrix:
        by_state, by_law = _derivatives(windows, *unpacked(x), directions)
        return scipy.sparse.hstack(
            [scipy.sparse.csr_matrix(by_law.reshape(-1, laws.size)), scipy.sparse.block_diag(list(by_state))], "csr"
        )

    optimum = least_squares(
        lambda x: windows.residuals(*unpacked(x)).ravel(),
        np.append(laws, np.zeros(window_count * state_count)),
        jac=jacobian,
        tr_solver="lsmr",
        tr_options={"atol": 1e-10, "btol": 1e-10},
        xtol=1e-6,
        ftol=1e-8,
        max_nfev=25,
    )
    fitted_laws, fitted_starts = unpacked(optimum.x)
    by_state, by_law = _derivatives(windows, fitted_laws, fitted_starts, directions)
    state_basis, _ = np.linalg.qr(by_state)
    # what no initial state can take over
    law_residuals = by_law - state_basis @ (np.swapaxes(state_basis, 1, 2) @ by_law)
    information = np.einsum("wri,wrj->ij", law_residuals, law_residuals)
    variance = 2 * optimum.cost / (optimum.fun.size - optimum.x.size)
    return fitted_laws, np.sqrt(variance * np.diag(np.linalg.inv(information)))


def _derivatives(
    windows: Windows,
    laws: Float[np.ndarray, " parameters"],
    starts: Float[np.ndarray, "windows states"],
    directions: Float[np.ndarray, "windows states states"],
) -> tuple[Float[np.ndarray, "windows residuals states"], Float[np.ndarray, "windows residuals parameters"]]:
    """Differences of the residuals along every state's direction, in all windows at once, and along every law."""
    residuals = windows.residuals(laws, starts)
    step = DIFF_STEP * np.abs(starts).max() / np.abs(directions).max()
    by_state = [
        (windows.residuals(laws, starts + step * directions[:, :, i]) - residuals) / step
        for i in range(starts.shape[1])
    ]
    by_law = [(windows.residuals(laws + DIFF_STEP * row, starts) - residuals) / DIFF_STEP for row in np.eye(laws.size)]
    return np.stack(by_state, axis=-1), np.stack(by_law, axis=-1)
