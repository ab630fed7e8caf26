"""The time history of an unmeasured force whose place is known, and of the motion there; laws laid against it."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve

from identify.gaps.unmeasured_force.evidence import left, normal
from identify.gaps.unmeasured_force.location import Located
from identify.signals.kinematics import CORNER_HZ, integrated
from rig.model.description import Station

FINER = 4
"""Laws are evaluated at so many times the residual's rate, as their kinks widen the band."""
LAW_ERROR = 0.03
"""Share of the force that no law explains: beyond it nothing decides between laws."""
KNOTS_S = 0.25
"""Of the slow motion that integration loses."""


@dataclass(frozen=True)
class ForceHistory:
    """A located force in time: what laws of the motion at its place are regressed on.

    moved_m and rate_m_per_s are fine (`FINER`), along the whole transform; a pair's are relative. found_n is the free
    force (Wiener), gated. reduced costs are -2 ln L at the noise s of the free force, nuisances fitted each time:
    nothing, the free force, and what noise alone gains the free force.
    """

    located: Located
    moved_m: Float[np.ndarray, " fine"]
    rate_m_per_s: Float[np.ndarray, " fine"]
    found_n: Float[np.ndarray, " alltimes"]
    weights: Float[np.ndarray, " lines"]
    bare: Complex[np.ndarray, " lines"]
    nuisances: Complex[np.ndarray, "columns lines"]
    matrix: Float[np.ndarray, "columns columns"]
    rest: Float[np.ndarray, " columns"]

    @property
    def rate_hz(self) -> float:
        return self.located.observed.record.rate_hz

    @property
    def fine_s(self) -> Float[np.ndarray, " fine"]:
        return np.arange(self.moved_m.size) / (FINER * self.rate_hz)

    @property
    def counted(self) -> Float[np.ndarray, " alltimes"]:
        return self.located.observed.gate

    @cached_property
    def factor(self) -> tuple[Float[np.ndarray, "columns columns"], bool]:
        found, lower = cho_factor(self.matrix)
        return found, bool(lower)

    @cached_property
    def free_gain(self) -> float:
        """Gain of the free force beyond that from noise alone."""
        halves = _halves(self.nuisances * np.sqrt(self.weights))
        bare = _halves(self.bare * np.sqrt(self.weights))
        beside = self.matrix - halves @ halves.T
        rest = self.rest - halves @ bare
        without = float(self.rest @ cho_solve(self.factor, self.rest))
        freely = float(rest @ np.linalg.solve(beside, rest))
        own = self.located.observed
        noise = float(self.weights @ own.on_lines(self.located.after.noise))
        return float(bare @ bare) - without + freely - noise

    def spectra(self, fine_n: Float[np.ndarray, "*rows fine"]) -> Complex[np.ndarray, "*rows lines"]:
        """Spectra of forces given finely, in the direction of the located force's residual, gated."""
        record = self.located.observed.record
        lines = record.omega.size
        coarse = np.fft.irfft(np.fft.rfft(fine_n)[..., :lines] / FINER, record.length // record.factor)
        return self.coarsely(coarse)

    def coarsely(self, history_n: Float[np.ndarray, "*rows alltimes"]) -> Complex[np.ndarray, "*rows lines"]:
        own = self.located.observed
        found = np.fft.rfft(history_n * self.counted)[..., own.lines] * own.record.factor
        return np.asarray(found * self.located.after.size)

    def reduced(
        self, columns: Complex[np.ndarray, "columns lines"]
    ) -> tuple[Float[np.ndarray, "columns columns"], Float[np.ndarray, " columns"]]:
        """Normal equations of force columns with the nuisances eliminated."""
        weighted = _halves(columns * self.weights)
        coupled = weighted @ _halves(self.nuisances).T
        rest = weighted @ _halves(self.bare) - coupled @ cho_solve(self.factor, self.rest)
        return weighted @ _halves(columns).T - coupled @ cho_solve(self.factor, coupled.T), rest

    def gain(self, force: Complex[np.ndarray, " lines"]) -> float:
        """Decrease of -2 ln L with a given force."""
        matrix, rest = self.reduced(force[None])
        return float(2 * rest[0] - matrix[0, 0])

    @cached_property
    def slow(self) -> Float[np.ndarray, "alltimes knots"]:
        """Cubic B-splines over the record, zero behind it."""
        record = self.located.observed.record
        last = record.taken.stop / self.rate_hz
        inner = np.linspace(0, last, max(2, round(last / KNOTS_S) + 1))
        knots = np.concatenate([[0.0] * 3, inner, [last] * 3])
        at = np.arange(record.taken.stop) / self.rate_hz
        found = np.zeros((record.length // record.factor, knots.size - 4))
        found[: at.size] = BSpline.design_matrix(np.minimum(at, last), knots, 3).toarray()
        return found

    def finely(self, coarse: Float[np.ndarray, " alltimes"]) -> Float[np.ndarray, " fine"]:
        at = np.arange(coarse.size * FINER) / FINER
        return np.asarray(np.interp(at, np.arange(coarse.size), coarse))


def force_of(located: Located) -> Complex[np.ndarray, " alllines"]:
    """The likeliest force, or the likeliest signal of a sensor: S |g| t / (s + S |g|^2)."""
    own, after = located.observed, located.after
    noise, spectrum = own.on_lines(after.noise), own.on_lines(after.spectrum)
    force = np.zeros(own.record.omega.size, dtype=complex)
    force[own.lines] = spectrum * after.size * after.along / (noise + spectrum * after.size**2)
    return force


def history_of(located: Located) -> ForceHistory:
    """Time history of a force or a pair."""
    own, after = located.observed, located.after
    record, force = own.record, force_of(located)
    noise, spectrum = own.on_lines(after.noise), own.on_lines(after.spectrum)
    acceleration = np.zeros(record.omega.size, dtype=complex)
    for station, sign in zip(located.candidate.stations, (1.0, -1.0), strict=False):
        acceleration += sign * (own.motion(station) + sign * _beyond(located, station) * force)
    moved, rate = (
        _fine(acceleration * integrated(record.omega, power, CORNER_HZ), record.length // record.factor) / record.factor
        for power in (-2, -1)
    )
    weights = own.count / (noise + LAW_ERROR**2 * spectrum * after.size**2)
    direction = located.response.conj() / np.maximum(after.size, 1e-300)[:, None]
    matrix, rest = normal(own, after.noise)
    whole = ForceHistory(
        located=located,
        moved_m=moved,
        rate_m_per_s=rate,
        found_n=np.fft.irfft(force, record.length // record.factor) / record.factor,
        weights=own.count / noise,
        bare=np.einsum("lr,lr->l", direction, own.residual),
        nuisances=np.einsum("lr,clr->cl", direction, own.columns),
        matrix=matrix,
        rest=rest,
    )
    return weighing(whole, weights)


def softened(history: ForceHistory, law_error: float) -> ForceHistory:
    """History with a law trusted to this share of the force only."""
    own, after = history.located.observed, history.located.after
    noise, spectrum = own.on_lines(after.noise), own.on_lines(after.spectrum)
    return weighing(history, own.count / (noise + law_error**2 * spectrum * after.size**2))


def weighing(history: ForceHistory, weights: Float[np.ndarray, " lines"]) -> ForceHistory:
    """History with other weights of the lines in the direction of the force."""
    less = history.weights - weights
    halves = _halves(history.nuisances)
    return replace(
        history,
        weights=weights,
        matrix=history.matrix - _halves(history.nuisances * less) @ halves.T,
        rest=history.rest - _halves(history.nuisances * less) @ _halves(history.bare),
    )


def explained_share(located: Located) -> float:
    """Share of the mean square of the linear residual that nuisances leave."""
    own, after = located.observed, located.after
    power = np.abs(after.along) ** 2
    noise, spectrum = own.on_lines(after.noise), own.on_lines(after.spectrum)
    kept = 1 - (noise / (noise + spectrum * after.size**2)) ** 2
    theta = np.zeros(len(own.parameters))  # a drift has columns of its own
    theta[: located.before.theta.size] = located.before.theta
    before = float(np.sum(left(own, theta)))
    return 1 - (float(np.sum(left(own, after.theta))) - float(power @ kept)) / before


def _beyond(located: Located, station: Station) -> Complex[np.ndarray, " alllines"]:
    """Acceleration at a place by a force there, of those modes that the sensors do not show."""
    own = located.observed
    for response in own.model.responses:
        if response.body.name == station.body:
            low = sum(s.station.body == station.body for s in own.record.sensors)
            return np.asarray(response.shapes([station])[0, low:] ** 2 @ response.accelerance[low:])
    raise KeyError(station.body)


def _fine(spectrum: Complex[np.ndarray, " alllines"], length: int) -> Float[np.ndarray, " fine"]:
    return np.asarray(FINER * np.fft.irfft(spectrum, FINER * length))


def _halves(values: Complex[np.ndarray, "*rows lines"]) -> Float[np.ndarray, "*rows twice"]:
    return np.ascontiguousarray(values).view(float)
