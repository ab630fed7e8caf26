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

BANDS_HZ = (0.0, 2.0, 5.0, 10.0, 20.0, 40.0, 60.0, 100.0, 150.0, 200.0, 400.0, 1000.0, 4000.0)
"""Edges of the bands in which the mismatch is shown. Display."""
TIME_INTERVALS = 10
"""Intervals of the time in which the mismatch is shown. Display."""
MAP_CELLS = 12
"""Cells along either axis of the map of the contact force. Display."""


def attribution(linearization: Linearization, residual: Residual, nominal_misfit: Misfit) -> Attribution:
    """Shares of the sum of squares of the residual in its nominal variances, less noise and tolerated model error."""
    record = linearization.record
    excess = np.maximum(nominal_misfit.levels - 1, 0.0)
    channels = _normalized(dict(zip([s.name for s in record.sensors], excess.sum(axis=0), strict=True)))
    linear = np.sum(residual.linear**2, axis=0)
    contacts = [
        c.residual[: s.weights.size] ** 2 for c, s in zip(residual.contacts, linearization.observations, strict=True)
    ]
    total = linear + np.sum(contacts, axis=0)
    linear_share = float(linear.sum() / max(total.sum(), 1e-300))
    residual_shares = {"linear": linear_share}
    for contact, squares in zip(linearization.model.rig.contacts, contacts, strict=True):
        residual_shares[contact.name] = float(squares.sum() / max(total.sum(), 1e-300))
    positions: dict[str, dict[float, float]] = {}
    for sensor in record.sensors:
        shares_by_position = positions.setdefault(sensor.station.body, {})
        position_m = sensor.station.position_m
        shares_by_position[position_m] = shares_by_position.get(position_m, 0.0) + channels[sensor.name]
    return Attribution(
        channels=channels,
        parts=residual_shares,
        modal_equations=_modal_equation_shares(record, residual),
        positions_m=positions,
        band_hz=_band_shares(excess.sum(axis=1)),
        contact_state=_contact_state_shares(linearization, total),
        time_s=tuple(
            Share(float(t[0]), float(t[-1]), float(interval_squares.sum() / max(total.sum(), 1e-300)))
            for t, interval_squares in zip(
                np.array_split(record.time_s, TIME_INTERVALS), np.array_split(total, TIME_INTERVALS), strict=True
            )
        ),
        surface={
            contact.name: _residual_map(
                signals.eta_m[:: signals.factor], signals.rate_m_per_s[:: signals.factor], squares
            )
            for contact, signals, squares in zip(
                linearization.model.rig.contacts, residual.signals, contacts, strict=True
            )
        }
        or _mass_force_maps(record, residual),
    )


def _mass_force_maps(record: Record, residual: Residual) -> dict[str, ResidualMap]:
    """Squared force (N^2) that the linear model lacks, over displacement and velocity of each single mass."""
    maps = {}
    for response in residual.model.responses:
        for i, sensor in enumerate(record.sensors):
            if response.body.is_mass and sensor.station.body == response.body.name:
                missing_force_n = residual.model.residual[i] * residual.model.deviation[i] / response.accelerance[0]
                eta, rate, force = record.in_time(
                    np.stack([record.displaced[i], 1j * record.omega * record.displaced[i], missing_force_n])
                )
                maps[response.body.name] = _residual_map(eta, rate, force**2)
    return maps


def _normalized(weights: dict[str, float]) -> dict[str, float]:
    """Weights divided by their sum; zeros where that is zero."""
    total = sum(weights.values())
    return {name: float(weight / total) if total > 0 else 0.0 for name, weight in weights.items()}


def _modal_equation_shares(record: Record, residual: Residual) -> dict[str, float]:
    """Shares by modal equation: mean squares of the residual modal accelerations over their error variances."""
    deviations = np.sqrt(np.mean(residual.model.deviation**2, axis=1))
    variance_ratios = {}
    for response in residual.model.responses:
        rows = [i for i, s in enumerate(record.sensors) if s.station.body == response.body.name]
        modes = min(len(rows), response.count)
        if not modes:
            continue
        shapes = response.shapes([record.sensors[i].station for i in rows])[:, :modes]
        inverse = np.linalg.pinv(shapes)
        mean_squares = np.mean((inverse @ (residual.linear[rows] * deviations[rows, None])) ** 2, axis=1)
        error_variances = np.sum((inverse * deviations[rows]) ** 2, axis=1)
        for m in range(modes):
            name = response.body.name if response.body.is_mass else f"{response.body.name} {m + 1}"
            variance_ratios[name] = float(mean_squares[m] / error_variances[m])
    return _normalized(variance_ratios)


def _band_shares(excess: Float[np.ndarray, " bands"]) -> tuple[Share, ...]:
    """Shares in `BANDS_HZ` of the excess in 2 Hz bands."""
    centre_hz = 2.0 * np.arange(excess.size) + 1.0
    total = max(float(excess.sum()), 1e-300)
    shares = []
    for low_hz, high_hz in pairwise(BANDS_HZ):
        in_band = (centre_hz >= low_hz) & (centre_hz < high_hz)
        if np.any(in_band):
            shares.append(Share(low_hz, min(high_hz, 2.0 * excess.size), float(excess[in_band].sum() / total)))
    return tuple(shares)


def _contact_state_shares(linearization: Linearization, total: Float[np.ndarray, " times"]) -> dict[str, float]:
    """Shares by the set of closed contacts."""
    squares: dict[str, float] = {}
    closed = [observation.closed > 0 for observation in linearization.observations]
    names = [c.name for c in linearization.model.rig.contacts]
    for code in range(2 ** len(names)):
        state = [bool(code >> j & 1) for j in range(len(names))]
        in_state = (
            np.all([c == is_closed for c, is_closed in zip(closed, state, strict=True)], axis=0)
            if names
            else np.ones(total.size, bool)
        )
        label = " and ".join(name for name, is_closed in zip(names, state, strict=True) if is_closed)
        squares[f"{label} closed" if label else "open"] = float(total[in_state].sum())
    return _normalized(squares)


def _residual_map(
    eta_m: Float[np.ndarray, " times"],
    rate_m_per_s: Float[np.ndarray, " times"],
    squares: Float[np.ndarray, " times"],
) -> ResidualMap:
    """Shares of the squares in `MAP_CELLS` x `MAP_CELLS` cells of relative displacement and velocity."""
    table, rows, columns = np.histogram2d(eta_m, rate_m_per_s, bins=MAP_CELLS, weights=squares)
    share = table / max(float(table.sum()), 1e-300)
    return ResidualMap(tuple(rows.tolist()), tuple(columns.tolist()), tuple(tuple(row) for row in share.tolist()))
