"""Sparse regression (pysindy): accelerations on a library of linear terms and of dead zones on a grid of clearances.

The greedy selection (FROLS) picks dead zones from a coarse grid, then from finer ones around the clearance found. Two
neighbours of the grid together are a dead zone between them: stiffness is the sum of their coefficients, clearance
their mean by these. Intervals are the spread over an ensemble of bootstraps, as `EnsembleOptimizer` makes it.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from identify.pages.wording import COVERED
from scenarios.peers.peer_data import ContactAnswer, PeerData, dead_zone

COARSE_COUNT, FINE_COUNT = 40, 9
"""Clearances of the first grid, over all displacements, and of the finer ones, around the clearance found before."""
HALF_WIDTHS = (1 / 4, 1 / 10, 1 / 40, 1 / 40, 1 / 160, 1 / 640)
"""Half-widths of the finer grids, as shares of the largest displacement."""
PICK_COUNT = 3
"""Dead zones a contact that the greedy selection may take beside the linear terms."""
BOOTSTRAPS = 20
REGRESSION_HZ = 512.0
"""Samples a second that the regression takes; more of them only take longer."""


def sparse_regression(recording: PeerData) -> tuple[ContactAnswer, ...]:
    """Clearance and stiffness of every contact from measured displacements, velocities and accelerations.

    One mass: its acceleration. Two beams: the accelerations of the struck body's first four modes, by the pseudoinverse
    of the shapes at its stations; a contact's stiffness is its coefficient over minus the mode's shape there.
    """
    mode_indices = [i for i, body in enumerate(recording.model.bodies) if body == recording.station_bodies[-1]]
    station_indices = [i for i, body in enumerate(recording.station_bodies) if body == recording.station_bodies[-1]]
    resolved_indices = mode_indices[: len(station_indices)]
    decimation = max(1, round(recording.sample_rate_hz / REGRESSION_HZ))
    to_modes = np.linalg.pinv(recording.model.sensor_rows[np.ix_(station_indices, resolved_indices)])[:4]
    modal_signals = [
        (to_modes @ signal[station_indices, ::decimation]).T
        for signal in (recording.displacement_m, recording.velocity_m_per_s, recording.acceleration_m_per_s2)
    ]
    eta_m, force_n = recording.eta_m[:, ::decimation].T, recording.force_n[::decimation, None]
    shapes = recording.model.contact_rows[:, resolved_indices[:4]].T

    amplitudes_m = np.abs(eta_m).max(axis=0)
    library_inputs = (np.hstack([*modal_signals[:2]]), force_n, eta_m)
    grids_m = [np.linspace(0.02, 0.98, COARSE_COUNT) * amplitude_m for amplitude_m in amplitudes_m]
    for half_width in (*HALF_WIDTHS, None):
        (coefficients,) = _coefficients(library_inputs, modal_signals[2], grids_m, bootstrap_count=0)
        clearance_m, stiffness_n_per_m = _joined_modes(coefficients, grids_m, shapes)
        if half_width:
            grids_m = [
                np.clip(center_m, half_width * amplitude_m, (0.95 - half_width) * amplitude_m)
                + half_width * amplitude_m * np.linspace(-1, 1, FINE_COUNT)
                for center_m, amplitude_m in zip(clearance_m, amplitudes_m, strict=True)
            ]
    ensemble = [
        _joined_modes(c, grids_m, shapes) for c in _coefficients(library_inputs, modal_signals[2], grids_m, BOOTSTRAPS)
    ]
    spread_m, spread_n_per_m = (np.std(values, axis=0, ddof=1) for values in zip(*ensemble, strict=True))
    return tuple(
        ContactAnswer(
            contact=name,
            clearance_m=float(clearance_m[j]),
            stiffness_n_per_m=float(stiffness_n_per_m[j]),
            clearance_half_width_m=COVERED * float(spread_m[j]),
            stiffness_half_width_n_per_m=COVERED * float(spread_n_per_m[j]),
        )
        for j, name in enumerate(recording.names)
    )


def _coefficients(
    library_inputs: tuple[Float[np.ndarray, "samples _"], ...],
    acceleration: Float[np.ndarray, "samples modes"],
    grids_m: list[Float[np.ndarray, " clearances"]],
    bootstrap_count: int,
) -> list[Float[np.ndarray, "modes terms"]]:
    """Coefficients of the library's terms in every modal acceleration, by one fit or by each of the bootstraps.

    pysindy regresses as many derivatives as it has states, so the states are the modal velocities; displacements, force
    and relative displacements come as controls.
    """
    import pysindy

    modal_states, force_n, eta_m = library_inputs
    mode_count = acceleration.shape[1]
    velocity, controls = modal_states[:, mode_count:], np.hstack([modal_states[:, :mode_count], force_n, eta_m])
    linear_terms = list(range(2 * mode_count + force_n.shape[1]))
    libraries = [pysindy.PolynomialLibrary(degree=1, include_bias=False)]
    libraries += [pysindy.CustomLibrary([_penetration(clearance_m) for clearance_m in grid]) for grid in grids_m]
    library = pysindy.GeneralizedLibrary(
        libraries, inputs_per_library=[linear_terms, *([len(linear_terms) + j] for j in range(len(grids_m)))]
    )
    greedy = pysindy.FROLS(normalize_columns=True, alpha=1e-12, max_iter=len(linear_terms) + PICK_COUNT * len(grids_m))
    optimizer = pysindy.EnsembleOptimizer(greedy, bagging=True, n_models=bootstrap_count) if bootstrap_count else greedy
    model = pysindy.SINDy(optimizer=optimizer, feature_library=library)
    model.fit(velocity, t=1 / REGRESSION_HZ, x_dot=acceleration, u=controls)
    return [c[:, len(linear_terms) :] for c in (optimizer.coef_list if bootstrap_count else [model.coefficients()])]


def _penetration(clearance_m: float) -> Callable[[Any], Any]:
    def penetration(eta_m: Any) -> Any:
        return dead_zone(eta_m, clearance_m)

    return penetration


def _joined_modes(
    coefficients: Float[np.ndarray, "modes terms"],
    grids_m: list[Float[np.ndarray, " clearances"]],
    shapes: Float[np.ndarray, "modes contacts"],
) -> tuple[Float[np.ndarray, " contacts"], Float[np.ndarray, " contacts"]]:
    """Clearance and stiffness of every contact by all modal equations, weighted with the squares of the shapes."""
    clearance_m, stiffness_n_per_m, first_term = [], [], 0
    for j, grid in enumerate(grids_m):
        by_clearance = -shapes[:, j] @ coefficients[:, first_term : first_term + grid.size] / np.sum(shapes[:, j] ** 2)
        first_term += grid.size
        stiffness_n_per_m.append(by_clearance.sum())
        clearance_m.append(by_clearance @ grid / by_clearance.sum())
    return np.array(clearance_m), np.array(stiffness_n_per_m)
