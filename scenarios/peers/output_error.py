"""Output error by multiple shooting with scipy: least squares over contacts and the initial state of every window."""

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from scenarios.peers.given import START_CLEARANCE, START_STIFFNESS, ContactAnswer, Given
from scenarios.peers.rollouts import Stepper, rolled_out, stepper

WINDOWS_S = {1: (1 / 16, 1 / 4), 2: (1 / 64, 1 / 16)}
"""Windows by the number of contacts: of the first pass, within which a wrong clearance still lets the motion be
followed, and of the last."""
STEPS_HZ = {1: 4096, 2: 8192}
"""Steps a second of the rollouts, by the number of contacts."""
OUTPUTS_HZ = {1: 512, 2: 1024}
MODES_A_BEAM = 8
"""Modes whose motion is rolled out; those above follow statically."""
DAMPING_S = 1e-4
"""Unit of the damping's parameter: the damping over the stiffness that the search starts from."""
DIFFERENCE = 1e-6
COVERED = 1.96


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
        outputs = rolled_out(self.system, values, states, self.force_n, self.steps_per_output)
        return np.asarray((outputs - self.measured).reshape(len(states), -1) / np.std(self.measured))


def output_error(recording: Given) -> tuple[ContactAnswer, ...]:
    """Clearance and stiffness of every contact, with intervals by the residuals and their derivatives.

    One mass is fitted to its acceleration; two beams to the displacements, as accelerations hold more than the modes
    that are rolled out. Measured displacements and velocities give the initial states to start from.
    """
    contacts = len(recording.names)
    stiffness_n_per_m = START_STIFFNESS * recording.true_stiffness_n_per_m
    scales = np.stack(
        [START_CLEARANCE * recording.true_clearance_m, stiffness_n_per_m, DAMPING_S * stiffness_n_per_m], axis=1
    )
    laws = np.tile([1.0, 1.0, 0.0], contacts)
    for window_s in WINDOWS_S[contacts]:
        laws, errors = _fitted(_windows(recording, scales, window_s), laws)
    values, reach = (scales * v.reshape(contacts, 3) for v in (laws, COVERED * errors))
    return tuple(
        ContactAnswer(
            contact=name,
            clearance_m=float(values[j, 0]),
            stiffness_n_per_m=float(values[j, 1]),
            clearance_reach_m=float(reach[j, 0]),
            stiffness_reach_n_per_m=float(reach[j, 1]),
        )
        for j, name in enumerate(recording.names)
    )


def _windows(recording: Given, scales: Float[np.ndarray, "contacts 3"], window_s: float) -> Windows:
    contacts, model = len(recording.names), recording.model
    one_mass = model.omega.size == 1
    of_bodies = {body: np.flatnonzero(np.array(model.bodies) == body) for body in model.bodies}
    is_moving = np.zeros(model.omega.size, dtype=bool)
    for modes in of_bodies.values():
        is_moving[modes[:MODES_A_BEAM]] = True
    every_sample = round(recording.sample_rate_hz / OUTPUTS_HZ[contacts])
    outputs = (recording.acceleration_m_per_s2 if one_mass else recording.displacement_m)[:, ::every_sample]
    length, steps_per_output = round(window_s * OUTPUTS_HZ[contacts]), STEPS_HZ[contacts] // OUTPUTS_HZ[contacts]
    firsts = np.arange(0, outputs.shape[1] - length, length)
    samples_s = np.arange(recording.force_n.size) / recording.sample_rate_hz
    times_s = firsts[:, None] / OUTPUTS_HZ[contacts] + np.arange(length * steps_per_output + 1) / STEPS_HZ[contacts]
    starts = np.zeros((2, firsts.size, model.omega.size))
    for body, modes in of_bodies.items():
        stations = np.flatnonzero(np.array(recording.station_bodies) == body)
        lowest = modes[: stations.size]
        to_modes = np.linalg.pinv(model.sensor_rows[np.ix_(stations, lowest)])
        for order, signal in enumerate((recording.displacement_m, recording.velocity_m_per_s)):
            starts[order][:, lowest] = (to_modes @ signal[np.ix_(stations, firsts * every_sample)]).T
    return Windows(
        system=stepper(model, is_moving, 1 / STEPS_HZ[contacts], one_mass),
        scales=scales,
        force_n=CubicSpline(samples_s, recording.force_n)(times_s),
        measured=np.moveaxis(outputs[:, firsts[:, None] + np.arange(length + 1)], 0, -1),
        starts=np.hstack([starts[0][:, is_moving], starts[1][:, is_moving]]),
        steps_per_output=steps_per_output,
    )


def _fitted(
    windows: Windows, laws: Float[np.ndarray, " parameters"]
) -> tuple[Float[np.ndarray, " parameters"], Float[np.ndarray, " parameters"]]:
    """Laws that fit all windows, and their standard errors.

    Steps in the state of a window are taken along the columns of its triangular factor, so that scipy's iterative
    solver meets windows without ill-conditioned states.
    """
    count, states = windows.starts.shape
    size = np.maximum(np.std(windows.starts, axis=0), 1e-3 * np.std(windows.starts, axis=0).max())
    directions = np.tile(np.diag(size), (count, 1, 1))
    by_state, _ = _derivatives(windows, laws, windows.starts, directions)
    factors = np.linalg.qr(by_state, mode="r")
    directions = directions @ np.linalg.pinv(factors, rcond=1e-7)

    def unpacked(x: Float[np.ndarray, " all"]) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "windows states"]]:
        steps = x[laws.size :].reshape(count, states)
        return x[: laws.size], windows.starts + np.einsum("wij,wj->wi", directions, steps)

    def jacobian(x: Float[np.ndarray, " all"]) -> scipy.sparse.csr_matrix:
        by_state, by_law = _derivatives(windows, *unpacked(x), directions)
        return scipy.sparse.hstack(
            [scipy.sparse.csr_matrix(by_law.reshape(-1, laws.size)), scipy.sparse.block_diag(list(by_state))], "csr"
        )

    optimum = least_squares(
        lambda x: windows.residuals(*unpacked(x)).ravel(),
        np.append(laws, np.zeros(count * states)),
        jac=jacobian,
        tr_solver="lsmr",
        tr_options={"atol": 1e-10, "btol": 1e-10},
        xtol=1e-6,
        ftol=1e-8,
        max_nfev=25,
    )
    fitted, starts = unpacked(optimum.x)
    by_state, by_law = _derivatives(windows, fitted, starts, directions)
    state_basis, _ = np.linalg.qr(by_state)
    # what no initial state can take over
    by_law_alone = by_law - state_basis @ (np.swapaxes(state_basis, 1, 2) @ by_law)
    information = np.einsum("wri,wrj->ij", by_law_alone, by_law_alone)
    variance = 2 * optimum.cost / (optimum.fun.size - optimum.x.size)
    return fitted, np.sqrt(variance * np.diag(np.linalg.inv(information)))


def _derivatives(
    windows: Windows,
    laws: Float[np.ndarray, " parameters"],
    starts: Float[np.ndarray, "windows states"],
    directions: Float[np.ndarray, "windows states states"],
) -> tuple[Float[np.ndarray, "windows residuals states"], Float[np.ndarray, "windows residuals parameters"]]:
    """Differences of the residuals along every state's direction, in all windows at once, and along every law."""
    residuals = windows.residuals(laws, starts)
    step = DIFFERENCE * np.abs(starts).max() / np.abs(directions).max()
    by_state = [
        (windows.residuals(laws, starts + step * directions[:, :, i]) - residuals) / step
        for i in range(starts.shape[1])
    ]
    by_law = [
        (windows.residuals(laws + DIFFERENCE * row, starts) - residuals) / DIFFERENCE for row in np.eye(laws.size)
    ]
    return np.stack(by_state, axis=-1), np.stack(by_law, axis=-1)
