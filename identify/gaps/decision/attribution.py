"""Location of the mismatch: shares of the nominal rig's residual beyond noise and tolerances, cut in every way."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float

from identify.gaps.residual.likelihood import Misfit
from identify.gaps.residual.linear import Linear
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Linearization, Residual
from identify.gaps.results import Attribution, ResidualMap, Share

BANDS_HZ = (0.0, 2.0, 5.0, 10.0, 20.0, 40.0, 60.0, 100.0, 150.0, 200.0, 400.0, 1000.0, 4000.0)
PARTS = 10
CELLS = 12


def attribution(linearization: Linearization, at: Residual, left: Misfit) -> Attribution:
    """Shares of the residual's sum of squares in its reference variances; noise and tolerated shares are taken off."""
    record = linearization.record
    beyond = np.maximum(left.levels - 1, 0.0)
    channels = _shared(dict(zip([s.name for s in record.sensors], beyond.sum(axis=0), strict=True)))
    linear = np.sum(at.linear**2, axis=0)
    contacts = [c.residual[: s.weights.size] ** 2 for c, s in zip(at.contacts, linearization.seen, strict=True)]
    total = linear + np.sum(contacts, axis=0)
    linear_share = float(linear.sum() / max(total.sum(), 1e-300))
    parts = {"linear": linear_share}
    for contact, squares in zip(linearization.model.rig.contacts, contacts, strict=True):
        parts[contact.name] = float(squares.sum() / max(total.sum(), 1e-300))
    positions: dict[str, dict[float, float]] = {}
    for sensor in record.sensors:
        place = positions.setdefault(sensor.station.body, {})
        position_m = sensor.station.position_m
        place[position_m] = place.get(position_m, 0.0) + channels[sensor.name]
    return Attribution(
        channels=channels,
        parts=parts,
        modal_equations=_modal(record, at.model, at),
        positions_m=positions,
        band_hz=_bands(beyond.sum(axis=1)),
        contact_state=_states(linearization, total),
        time_s=tuple(
            Share(float(t[0]), float(t[-1]), float(part.sum() / max(total.sum(), 1e-300)))
            for t, part in zip(np.array_split(record.time_s, PARTS), np.array_split(total, PARTS), strict=True)
        ),
        surface={
            contact.name: _surface(moved.eta_m[:: moved.factor], moved.rate_m_per_s[:: moved.factor], squares)
            for contact, moved, squares in zip(linearization.model.rig.contacts, at.signals, contacts, strict=True)
        }
        or _of_masses(record, at),
    )


def _of_masses(record: Record, at: Residual) -> dict[str, ResidualMap]:
    """The force that the linear model lacks, over the displacement and velocity of each single mass."""
    found = {}
    for response in at.model.responses:
        for i, sensor in enumerate(record.sensors):
            if response.body.is_mass and sensor.station.body == response.body.name:
                lacking = at.model.residual[i] * at.model.deviation[i] / response.accelerance[0]
                eta, rate, force = record.in_time(
                    np.stack([record.displaced[i], 1j * record.omega * record.displaced[i], lacking])
                )
                found[response.body.name] = _surface(eta, rate, force**2)
    return found


def _shared(sizes: dict[str, float]) -> dict[str, float]:
    whole = sum(sizes.values())
    return {name: float(size / whole) if whole > 0 else 0.0 for name, size in sizes.items()}


def _modal(record: Record, model: Linear, at: Residual) -> dict[str, float]:
    """Shares by modal equation: residual modal accelerations, in units of the sensors' errors there."""
    deviations = np.sqrt(np.mean(model.deviation**2, axis=1))
    found = {}
    for response in model.responses:
        rows = [i for i, s in enumerate(record.sensors) if s.station.body == response.body.name]
        modes = min(len(rows), response.count)
        if not modes:
            continue
        shapes = response.shapes([record.sensors[i].station for i in rows])[:, :modes]
        inverse = np.linalg.pinv(shapes)
        size = np.mean((inverse @ (at.linear[rows] * deviations[rows, None])) ** 2, axis=1)
        error = np.sum((inverse * deviations[rows]) ** 2, axis=1)
        for m in range(modes):
            name = response.body.name if response.body.is_mass else f"{response.body.name} {m + 1}"
            found[name] = float(size[m] / error[m])
    return _shared(found)


def _bands(by_band: Float[np.ndarray, " bands"]) -> tuple[Share, ...]:
    middle = 2.0 * np.arange(by_band.size) + 1.0
    whole = max(float(by_band.sum()), 1e-300)
    found = []
    for low, high in pairwise(BANDS_HZ):
        inside = (middle >= low) & (middle < high)
        if np.any(inside):
            found.append(Share(low, min(high, 2.0 * by_band.size), float(by_band[inside].sum() / whole)))
    return tuple(found)


def _states(linearization: Linearization, total: Float[np.ndarray, " times"]) -> dict[str, float]:
    """Shares by the contacts that are closed."""
    sizes: dict[str, float] = {}
    closed = [s.closed > 0 for s in linearization.seen]
    names = [c.name for c in linearization.model.rig.contacts]
    for code in range(2 ** len(names)):
        shut = [bool(code >> j & 1) for j in range(len(names))]
        inside = (
            np.all([c == s for c, s in zip(closed, shut, strict=True)], axis=0) if names else np.ones(total.size, bool)
        )
        label = " and ".join(n for n, s in zip(names, shut, strict=True) if s)
        sizes[f"{label} closed" if label else "open"] = float(total[inside].sum())
    return _shared(sizes)


def _surface(
    eta_m: Float[np.ndarray, " times"],
    rate_m_per_s: Float[np.ndarray, " times"],
    squares: Float[np.ndarray, " times"],
) -> ResidualMap:
    table, rows, columns = np.histogram2d(eta_m, rate_m_per_s, bins=CELLS, weights=squares)
    share = table / max(float(table.sum()), 1e-300)
    return ResidualMap(tuple(rows.tolist()), tuple(columns.tolist()), tuple(tuple(row) for row in share.tolist()))
