"""Location of the mismatch: shares of the nominal rig's residual beyond noise and tolerances.

By channel, modal equation, station, frequency, contact state and time, and over displacement and velocity.
"""

from itertools import pairwise

import numpy as np
from jaxtyping import Float

from identify.gaps.residual.likelihood import Misfit
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Linearization, Residual
from identify.gaps.results import Attribution, ResidualMap, Share

BAND_EDGES_HZ = (0.0, 2.0, 5.0, 10.0, 20.0, 40.0, 60.0, 100.0, 150.0, 200.0, 400.0, 1000.0, 4000.0)
"""Edges of the bands in which the mismatch is shown. Display."""
TIME_INTERVALS = 10
"""Intervals of the time in which the mismatch is shown. Display."""
MAP_CELLS = 12
"""Cells along either axis of the map of the contact force. Display."""


def attribution(linearization: Linearization, residual: Residual, nominal_misfit: Misfit) -> Attribution:
    """Shares of the sum of squares of the residual in its nominal variances, less noise and tolerated model error."""
    record = linearization.record
    excess_levels = np.maximum(nominal_misfit.levels - 1, 0.0)
    share_by_channel = _shares_of_sum(
        dict(zip([observation.name for observation in record.sensors], excess_levels.sum(axis=0), strict=True))
    )
    linear_squares = np.sum(residual.linear_residual**2, axis=0)
    contact_squares = [
        contact_fit.residual[: observation.weights.size] ** 2
        for contact_fit, observation in zip(residual.contacts, linearization.observations, strict=True)
    ]
    total_squares = linear_squares + np.sum(contact_squares, axis=0)
    linear_share = float(linear_squares.sum() / max(total_squares.sum(), 1e-300))
    residual_shares = {"linear": linear_share}
    for contact, squares_of_contact in zip(linearization.model.rig.contacts, contact_squares, strict=True):
        residual_shares[contact.name] = float(squares_of_contact.sum() / max(total_squares.sum(), 1e-300))
    shares_by_station: dict[str, dict[float, float]] = {}
    for sensor in record.sensors:
        shares_by_position = shares_by_station.setdefault(sensor.station.body, {})
        position_m = sensor.station.position_m
        shares_by_position[position_m] = shares_by_position.get(position_m, 0.0) + share_by_channel[sensor.name]
    return Attribution(
        channels=share_by_channel,
        parts=residual_shares,
        modal_equations=_modal_equation_shares(record, residual),
        positions_m=shares_by_station,
        band_hz=_band_shares(excess_levels.sum(axis=1)),
        contact_state=_contact_state_shares(linearization, total_squares),
        time_s=tuple(
            Share(
                float(interval_times_s[0]),
                float(interval_times_s[-1]),
                float(interval_squares.sum() / max(total_squares.sum(), 1e-300)),
            )
            for interval_times_s, interval_squares in zip(
                np.array_split(record.residual_times_s, TIME_INTERVALS),
                np.array_split(total_squares, TIME_INTERVALS),
                strict=True,
            )
        ),
        surface={
            contact.name: _residual_map(
                contact_signals.eta_m[:: contact_signals.decimation],
                contact_signals.eta_rate_m_per_s[:: contact_signals.decimation],
                squares,
            )
            for contact, contact_signals, squares in zip(
                linearization.model.rig.contacts, residual.signals, contact_squares, strict=True
            )
        }
        or _mass_force_maps(record, residual),
    )


def _mass_force_maps(record: Record, residual: Residual) -> dict[str, ResidualMap]:
    """Squared force (N^2) that the linear model lacks, over displacement and velocity of each single mass."""
    map_by_mass = {}
    for response in residual.model.responses:
        for sensor_index, sensor in enumerate(record.sensors):
            if response.body.is_mass and sensor.station.body == response.body.name:
                shapes = response.shapes([sensor.station])
                missing_signals = residual.model.residual[sensor_index] * residual.model.error_deviation[sensor_index]
                missing_force_n = missing_signals / response.transfer(shapes, shapes)[0, 0]
                displacement_m, velocity_m_per_s, force_n = record.in_time(
                    np.stack(
                        [
                            record.displacement_signals[sensor_index],
                            1j * record.omega * record.displacement_signals[sensor_index],
                            missing_force_n,
                        ]
                    )
                )
                map_by_mass[response.body.name] = _residual_map(displacement_m, velocity_m_per_s, force_n**2)
    return map_by_mass


def _shares_of_sum(weight_by_name: dict[str, float]) -> dict[str, float]:
    """Weights divided by their sum; zeros where that is zero."""
    weight_sum = sum(weight_by_name.values())
    return {name: float(weight / weight_sum) if weight_sum > 0 else 0.0 for name, weight in weight_by_name.items()}


def _modal_equation_shares(record: Record, residual: Residual) -> dict[str, float]:
    """Shares by modal equation: mean squares of the residual modal accelerations over their error variances."""
    sensor_deviations = np.sqrt(np.mean(residual.model.error_deviation**2, axis=1))
    variance_ratios = {}
    for response in residual.model.responses:
        body_sensor_indices = [
            sensor_index
            for sensor_index, sensor in enumerate(record.sensors)
            if sensor.station.body == response.body.name
        ]
        mode_count = min(len(body_sensor_indices), response.mode_count)
        if not mode_count:
            continue
        shapes = response.shapes([record.sensors[sensor_index].station for sensor_index in body_sensor_indices])[
            :, :mode_count
        ]
        inverse_shapes = np.linalg.pinv(shapes)
        mean_squares = np.mean(
            (
                inverse_shapes
                @ (residual.linear_residual[body_sensor_indices] * sensor_deviations[body_sensor_indices, None])
            )
            ** 2,
            axis=1,
        )
        error_variances = np.sum((inverse_shapes * sensor_deviations[body_sensor_indices]) ** 2, axis=1)
        for mode_index in range(mode_count):
            equation_name = response.body.name if response.body.is_mass else f"{response.body.name} {mode_index + 1}"
            variance_ratios[equation_name] = float(mean_squares[mode_index] / error_variances[mode_index])
    return _shares_of_sum(variance_ratios)


def _band_shares(band_excess: Float[np.ndarray, " bands"]) -> tuple[Share, ...]:
    """Shares in `BAND_EDGES_HZ` of the excess in 2 Hz bands."""
    centre_hz = 2.0 * np.arange(band_excess.size) + 1.0
    excess_sum = max(float(band_excess.sum()), 1e-300)
    band_shares = []
    for low_hz, high_hz in pairwise(BAND_EDGES_HZ):
        is_in_band = (centre_hz >= low_hz) & (centre_hz < high_hz)
        if np.any(is_in_band):
            band_shares.append(
                Share(low_hz, min(high_hz, 2.0 * band_excess.size), float(band_excess[is_in_band].sum() / excess_sum))
            )
    return tuple(band_shares)


def _contact_state_shares(linearization: Linearization, total_squares: Float[np.ndarray, " times"]) -> dict[str, float]:
    """Shares by the set of closed contacts."""
    squares_by_state: dict[str, float] = {}
    closed_masks = [observation.closed_mask > 0 for observation in linearization.observations]
    contact_names = [mask.name for mask in linearization.model.rig.contacts]
    for state_code in range(2 ** len(contact_names)):
        is_contact_closed = [bool(state_code >> contact_index & 1) for contact_index in range(len(contact_names))]
        is_in_state = (
            np.all([mask == is_closed for mask, is_closed in zip(closed_masks, is_contact_closed, strict=True)], axis=0)
            if contact_names
            else np.ones(total_squares.size, bool)
        )
        closed_names = " and ".join(
            name for name, is_closed in zip(contact_names, is_contact_closed, strict=True) if is_closed
        )
        squares_by_state[f"{closed_names} closed" if closed_names else "open"] = float(total_squares[is_in_state].sum())
    return _shares_of_sum(squares_by_state)


def _residual_map(
    eta_m: Float[np.ndarray, " times"],
    eta_rate_m_per_s: Float[np.ndarray, " times"],
    residual_squares: Float[np.ndarray, " times"],
) -> ResidualMap:
    """Shares of the squares in `MAP_CELLS` x `MAP_CELLS` cells of relative displacement and velocity."""
    squares_by_cell, eta_edges, rate_edges = np.histogram2d(
        eta_m, eta_rate_m_per_s, bins=MAP_CELLS, weights=residual_squares
    )
    share_by_cell = squares_by_cell / max(float(squares_by_cell.sum()), 1e-300)
    return ResidualMap(
        tuple(eta_edges.tolist()),
        tuple(rate_edges.tolist()),
        tuple(tuple(cell_row) for cell_row in share_by_cell.tolist()),
    )
