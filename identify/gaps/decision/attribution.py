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
INTERVAL_COUNT = 10
"""Intervals of the time in which the mismatch is shown. Display."""
MAP_CELLS = 12
"""Cells along either axis of the map of the contact force. Display."""


def attribution(linearization: Linearization, residual: Residual, nominal_misfit: Misfit) -> Attribution:
    """Shares of the sum of squares of the residual in its nominal variances, less noise and tolerated model error."""
    record, contacts = linearization.record, linearization.model.rig.contacts
    excess_levels = np.maximum(nominal_misfit.mean_squares - 1, 0.0)
    sensor_names = [sensor.name for sensor in record.sensors]
    channel_shares = _shares_of_sum(dict(zip(sensor_names, excess_levels.sum(axis=0), strict=True)))
    linear_squares = np.sum(residual.linear_residual**2, axis=0)
    contact_squares = [
        contact_fit.residual[: observation.force_weights.size] ** 2
        for contact_fit, observation in zip(residual.contacts, linearization.observations, strict=True)
    ]
    total_squares = linear_squares + np.sum(contact_squares, axis=0)
    share_by_part, contact_maps = {"linear": _share_of_sum(linear_squares, total_squares)}, {}
    for contact, signals, squares in zip(contacts, residual.signals, contact_squares, strict=True):
        share_by_part[contact.name] = _share_of_sum(squares, total_squares)
        eta_m, eta_rate_m_per_s = (eta[:: signals.decimation] for eta in (signals.eta_m, signals.eta_rate_m_per_s))
        contact_maps[contact.name] = _residual_map(eta_m, eta_rate_m_per_s, squares)
    station_shares: dict[str, dict[float, float]] = {}
    for sensor in record.sensors:
        body_shares, position_m = station_shares.setdefault(sensor.station.body, {}), sensor.station.position_m
        body_shares[position_m] = body_shares.get(position_m, 0.0) + channel_shares[sensor.name]
    intervals = zip(
        *(np.array_split(series, INTERVAL_COUNT) for series in (record.residual_times_s, total_squares)), strict=True
    )
    return Attribution(
        channels=channel_shares,
        parts=share_by_part,
        modal_equations=_modal_equation_shares(record, residual),
        positions_m=station_shares,
        band_hz=_band_shares(excess_levels.sum(axis=1)),
        contact_state=_contact_state_shares(linearization, total_squares),
        time_s=tuple(
            Share(float(times_s[0]), float(times_s[-1]), _share_of_sum(squares, total_squares))
            for times_s, squares in intervals
        ),
        surface=contact_maps or _missing_force_map_by_mass(record, residual),
    )


def _share_of_sum(squares: Float[np.ndarray, "*some"], total_squares: Float[np.ndarray, "*all"]) -> float:
    """Sum of squares over that of all; zero where that is zero."""
    return float(squares.sum() / max(total_squares.sum(), 1e-300))


def _missing_force_map_by_mass(record: Record, residual: Residual) -> dict[str, ResidualMap]:
    """Squared force (N^2) that the linear model lacks, over displacement and velocity of each single mass."""
    residual_maps, motions = {}, record.displacement_signals
    for response in residual.model.responses:
        for sensor_index, sensor in enumerate(record.sensors):
            if response.body.is_mass and sensor.station.body == response.body.name:
                shapes = response.shapes([sensor.station])
                missing_signals = residual.model.residual[sensor_index] * residual.model.error_deviation[sensor_index]
                missing_force_n = missing_signals / response.transfer(shapes, shapes)[0, 0]
                displacement_m, velocity_m_per_s, force_n = record.in_time(
                    np.stack([motions[sensor_index], 1j * record.omega * motions[sensor_index], missing_force_n])
                )
                residual_maps[response.body.name] = _residual_map(displacement_m, velocity_m_per_s, force_n**2)
    return residual_maps


def _shares_of_sum(weight_by_name: dict[str, float]) -> dict[str, float]:
    """Weights divided by their sum; zeros where that is zero."""
    weight_sum = sum(weight_by_name.values())
    return {name: float(weight / weight_sum) if weight_sum > 0 else 0.0 for name, weight in weight_by_name.items()}


def _modal_equation_shares(record: Record, residual: Residual) -> dict[str, float]:
    """Shares by modal equation: mean squares of the residual modal accelerations over their error variances."""
    sensor_deviations = np.sqrt(np.mean(residual.model.error_deviation**2, axis=1))
    variance_ratios = {}
    for response in residual.model.responses:
        body = response.body
        sensor_indices = record.motion_sensor_indices_on(body.name)
        mode_count = min(len(sensor_indices), response.mode_count)
        if not mode_count:
            continue
        shapes = response.shapes([record.sensors[index].station for index in sensor_indices])[:, :mode_count]
        inverse_shapes = np.linalg.pinv(shapes)
        body_residual = residual.linear_residual[sensor_indices] * sensor_deviations[sensor_indices, None]
        mean_squares = np.mean((inverse_shapes @ body_residual) ** 2, axis=1)
        error_variances = np.sum((inverse_shapes * sensor_deviations[sensor_indices]) ** 2, axis=1)
        for mode_index in range(mode_count):
            equation_name = body.name if body.is_mass else f"{body.name} {mode_index + 1}"
            variance_ratios[equation_name] = float(mean_squares[mode_index] / error_variances[mode_index])
    return _shares_of_sum(variance_ratios)


def _band_shares(band_excess: Float[np.ndarray, " bands"]) -> tuple[Share, ...]:
    """Shares in `BAND_EDGES_HZ` of the excess in 2 Hz bands."""
    centre_hz = 2.0 * np.arange(band_excess.size) + 1.0
    band_shares = []
    for low_hz, high_hz in pairwise(BAND_EDGES_HZ):
        is_in_band = (centre_hz >= low_hz) & (centre_hz < high_hz)
        if np.any(is_in_band):
            share = _share_of_sum(band_excess[is_in_band], band_excess)
            band_shares.append(Share(low_hz, min(high_hz, 2.0 * band_excess.size), share))
    return tuple(band_shares)


def _contact_state_shares(linearization: Linearization, total_squares: Float[np.ndarray, " times"]) -> dict[str, float]:
    """Shares by the set of closed contacts."""
    state_squares: dict[str, float] = {}
    closed_masks = [observation.closed_mask > 0 for observation in linearization.observations]
    contact_names = [contact.name for contact in linearization.model.rig.contacts]
    for state_code in range(2 ** len(contact_names)):
        is_in_state, closed_names = np.ones(total_squares.size, bool), []
        for index, (name, mask) in enumerate(zip(contact_names, closed_masks, strict=True)):
            is_closed = bool(state_code >> index & 1)
            is_in_state &= mask == is_closed
            closed_names += [name] * is_closed
        state_words = f"{' and '.join(closed_names)} closed" if closed_names else "open"
        state_squares[state_words] = float(total_squares[is_in_state].sum())
    return _shares_of_sum(state_squares)


def _residual_map(
    eta_m: Float[np.ndarray, " times"],
    eta_rate_m_per_s: Float[np.ndarray, " times"],
    residual_squares: Float[np.ndarray, " times"],
) -> ResidualMap:
    """Shares of the squares in `MAP_CELLS` x `MAP_CELLS` cells of relative displacement and velocity."""
    squares, eta_edges, rate_edges = np.histogram2d(eta_m, eta_rate_m_per_s, bins=MAP_CELLS, weights=residual_squares)
    shares = squares / max(float(squares.sum()), 1e-300)
    return ResidualMap(
        tuple(eta_edges.tolist()), tuple(rate_edges.tolist()), tuple(tuple(row) for row in shares.tolist())
    )
