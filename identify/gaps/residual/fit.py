"""Gauss-Newton on the residual: parameters of effects, with nuisance parameters, drifts and contact tolerances."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Complex, Float
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear
from scipy.sparse.linalg import SuperLU

from identify.gaps.residual.linear import sensor_response_of
from identify.gaps.residual.nuisance import LIMIT, at_contacts, counted
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import (
    Linearization,
    Residual,
    linear_of,
    residual_of,
    same_but_laws,
    same_but_sensors,
)
from identify.signals.descent import Step, descended
from rig.errors import RigError
from rig.model.description import Rig

STEPS = 12
FINE = 1e-3
"""Derivatives are by this share of a candidate's steps: little is left once nuisance parameters are eliminated."""
ROUNDING, SINGLE = 1e-9, 1e-6
SETTLED = 3e-5
"""A step of Gauss-Newton is the last if the cost falls by a smaller share, a tenth of the errors; ..."""
UNFIT = 1e-3
"""... or by a smaller share of what no noise explains."""

Column = tuple[Float[np.ndarray, "rows times"], list[Float[np.ndarray, " _"]]]
Values = Float[np.ndarray, " parameters"]
Build = Callable[[Values], Rig]


@dataclass(frozen=True)
class Fit:
    """The parameters at which the residual is least, and their covariance.

    The samples count for `Record.sample_ratio` times fewer.
    """

    values: Float[np.ndarray, " parameters"]
    covariance: Float[np.ndarray, "parameters parameters"]
    residual: Residual

    @property
    def cost(self) -> float:
        return self.residual.cost


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations of nuisance parameters and parameters with the contacts' own unknowns eliminated."""

    matrix: Float[np.ndarray, "global global"]
    gradient: Float[np.ndarray, " global"]
    eliminated: tuple[tuple[Float[np.ndarray, " _"], Float[np.ndarray, "_ global"]], ...]
    without: float
    """What the contacts' own unknowns alone lower the cost by."""

    def promised(self, step: Float[np.ndarray, " global"]) -> float:
        """Decrease of the cost by a step, were the residual linear."""
        return float(self.without + 2 * self.gradient @ step - step @ self.matrix @ step)

    def unknowns(self, step: Float[np.ndarray, " global"]) -> list[Float[np.ndarray, " _"]]:
        """The steps of the contacts' unknowns that go with a step of the others."""
        return [start - coupled @ step for start, coupled in self.eliminated]


def derivative(linearization: Linearization, moved: Rig, at: Residual) -> Column:
    """Decrease of the linear and the contact residuals by a rig that differs by little.

    Another law is evaluated. Another linear model changes the contact forces and the relative displacements, of which
    the law at hand takes its slope. The contact forces are projected out with the weights of the rig at hand (Kaufman,
    BIT 15, 1975), as for the nuisance parameters: a parameter that is the like of one of them then has its column.
    """
    record, old = linearization.record, at.model
    if same_but_laws(at.rig, moved):
        there = residual_of(linearization, moved, at.nuisance, tuple(c.unknowns for c in at.contacts), like=at)
        contacts = [a.residual - b.residual for a, b in zip(at.contacts, there.contacts, strict=True)]
        return at.linear - there.linear, contacts
    if same_but_sensors(at.rig, moved):
        return _by_sensors(linearization, moved, at)
    new = linear_of(linearization, moved)
    sensors = len(record.sensors)
    change = old.residual - new.residual
    inputs = np.concatenate([old.contact_n - new.contact_n, change[sensors:]])
    less = change[:sensors] + np.einsum("isl,il->sl", old.by_input, inputs)
    left, less_n = old.projection.of(less * old.deviation)
    less_force = record.in_time(less_n) + (old.holding_n - new.holding_n)[:, None]
    for by_one, contact in zip((new.slow_n_per_m - old.slow_n_per_m).T, at.contacts, strict=True):
        less_force += np.outer(by_one, contact.slow_m)
    contacts = _by_motion(record, at, less_force, old.eta_m - new.eta_m)
    return counted(record, left), contacts


def _by_sensors(linearization: Linearization, moved: Rig, at: Residual) -> Column:
    """Other gains and delays: what the sensors would deliver of the same motion."""
    record, model = linearization.record, at.model
    ratio = sensor_response_of(record, moved) / sensor_response_of(record, at.rig) - 1
    explained = record.delivered - model.residual[: len(record.sensors)] * model.deviation
    left, force = model.projection.of(ratio * explained)
    less_eta = at_contacts(record, model, ratio * record.displaced / model.sensor_response)
    contacts = _by_motion(record, at, record.in_time(force), less_eta)
    return counted(record, left), contacts


def _by_motion(
    record: Record,
    at: Residual,
    less_force_n: Float[np.ndarray, "contacts times"],
    less_eta_m: Complex[np.ndarray, "contacts lines"],
) -> list[Float[np.ndarray, " _"]]:
    """Decrease of the contact residuals by smaller contact forces and relative displacements, by the laws' slopes."""
    less_m = record.sampled(less_eta_m, beyond=False) if np.any(less_eta_m) else None
    found = []
    for j, contact in enumerate(at.contacts):
        less_n = less_force_n[j]
        if less_m is not None:
            less_n = less_n - contact.sloped_n(less_m[j])
        column = np.zeros(contact.residual.size)
        column[: less_n.size] = contact.seen.weights * less_n
        found.append(column)
    return found


@dataclass(frozen=True)
class Eliminated:
    """One contact's own unknowns, eliminated from the normal equations of the nuisance parameters.

    rows are the contact residual's derivatives by the nuisance parameters, coupled the products with those by the
    unknowns, solved their solution and that of the gradient, free.
    """

    solver: SuperLU
    rows: Float[np.ndarray, "_ nuisances"]
    coupled: Float[np.ndarray, "unknowns nuisances"]
    solved: Float[np.ndarray, "unknowns nuisances"]
    free: Float[np.ndarray, " unknowns"]
    solved_free: Float[np.ndarray, " unknowns"]


@dataclass(frozen=True)
class Reduced:
    """Normal equations of the nuisance parameters at a residual; columns join them.

    The contacts' own unknowns are eliminated.
    """

    linearization: Linearization
    at: Residual
    matrix: Float[np.ndarray, "nuisances nuisances"]
    gradient: Float[np.ndarray, " nuisances"]
    contacts: tuple[Eliminated, ...]

    def with_lines(self) -> "Reduced":
        """Normal equations in which the lines that stand out count too, for what may explain them."""
        at = replace(self.at, quiet=self.at.linear)
        more = self.linearization.columns.products((at.quiet - self.at.quiet).ravel())
        return replace(self, at=at, gradient=self.gradient + more)

    def joined(self, columns: list[Column]) -> NormalEquations:
        """Over the nuisance parameters, then the columns."""
        count, size = len(self.gradient), len(self.gradient) + len(columns)
        matrix, gradient = np.zeros((size, size)), np.zeros(size)
        matrix[:count, :count], gradient[:count] = self.matrix, self.gradient
        own = np.array([c[0].ravel() for c in columns]).reshape(len(columns), self.at.linear.size)
        matrix[:count, count:] = self.linearization.columns.products(own)
        matrix[count:, count:] = own @ own.T
        gradient[count:] = own @ self.at.quiet.ravel()
        back = []
        for j, (contact, eliminated) in enumerate(zip(self.at.contacts, self.contacts, strict=True)):
            mine = np.array([c[1][j] for c in columns]).reshape(len(columns), contact.residual.size).T
            coupled = contact.columns.T @ mine
            solved = eliminated.solver.solve(coupled)
            matrix[:count, count:] += eliminated.rows.T @ mine - eliminated.coupled.T @ solved
            matrix[count:, count:] += mine.T @ mine - coupled.T @ solved
            gradient[count:] += mine.T @ contact.residual - solved.T @ eliminated.free
            back.append((eliminated.solved_free, np.concatenate([eliminated.solved, solved], axis=1)))
        matrix[count:, :count] = matrix[:count, count:].T
        without = float(sum(e.free @ e.solved_free for e in self.contacts))
        return NormalEquations(matrix, gradient, tuple(back), without)


def reduced(linearization: Linearization, at: Residual) -> Reduced:
    """The nuisance parameters' part of the normal equations."""
    count = len(linearization.columns.parameters)
    matrix = linearization.gram + linearization.record.sample_ratio * np.eye(count)
    gradient = linearization.columns.products(at.quiet.ravel()) - linearization.record.sample_ratio * at.nuisance
    found = []
    for j, contact in enumerate(at.contacts):
        solver, rows = contact.solver(), by_nuisance(linearization, at, j)
        free, coupled = contact.columns.T @ contact.residual, contact.columns.T @ rows
        solved = solver.solve(coupled)
        matrix = matrix + rows.T @ rows - coupled.T @ solved
        gradient = gradient + rows.T @ contact.residual - solved.T @ free
        found.append(Eliminated(solver, rows, coupled, solved, free, solver.solve(free)))
    return Reduced(linearization, at, matrix, gradient, tuple(found))


def by_nuisance(linearization: Linearization, at: Residual, contact: int) -> Float[np.ndarray, "_ nuisances"]:
    """Decrease of a contact's residual with each nuisance parameter."""
    weights, one = linearization.seen[contact].weights, at.contacts[contact]
    forces, eta = linearization.columns.contact_n[:, contact].T, linearization.columns.eta_m[:, contact].T
    rows = np.zeros((one.residual.size, len(linearization.columns.parameters)))
    rows[: weights.size] = weights[:, None] * forces - (weights * one.by_eta)[:, None] * eta
    return rows


def fit(
    linearization: Linearization,
    build: Build,
    values: Values,
    steps: Values,
    bounds: tuple[Values, Values],
    start: Residual | None = None,
    most: int = STEPS,
) -> Fit:
    """Descends from `values`, each parameter within its bounds; `steps` are small changes of each for derivatives.

    `start` gives nuisance parameters and contact unknowns to begin at.
    """
    nuisance, unknowns = _state(start) if start else (None, None)
    if nuisance is not None and linearization.tuned.pulls and not nuisance.any():
        nuisance = None  # those of the modes are where the record asks for them
    first = _At(values, residual_of(linearization, build(values), nuisance, unknowns))
    step_from = partial(_step, linearization, build, steps, bounds)
    at, step = descended(first, step_from, _settled, most)
    if linearization.record.modes:  # a part of a sharp mode's width further the nuisance parameters' columns are others
        step = step_from(first)
    return Fit(at.values, step.covariance, at.residual)


@dataclass(frozen=True)
class _At:
    values: Values
    residual: Residual

    @property
    def cost(self) -> float:
        return self.residual.cost


@dataclass(frozen=True)
class _Step(Step[_At]):
    covariance: Float[np.ndarray, "parameters parameters"]


def _settled(at: _At) -> float:
    return max(SETTLED * at.cost, UNFIT * (at.cost - at.residual.rows))


def _step(linearization: Linearization, build: Build, steps: Values, bounds: tuple[Values, Values], at: _At) -> _Step:
    """The step within bounds, and the covariance of the parameters by this linearisation."""
    values, residual, count = at.values, at.residual, len(linearization.columns.parameters)
    inside = FINE * np.where(values + steps > bounds[1], -steps, steps)
    along = [_along(linearization, build, values, s, residual) for s in np.eye(values.size) * inside]
    normal = reduced(linearization, residual).joined(along)
    held = normal.matrix + np.diag(np.r_[np.zeros(count), 1e-9 * np.diag(normal.matrix)[count:] + 1e-300])
    ends = [
        np.concatenate([sign * LIMIT - residual.nuisance, np.sort((np.stack(bounds) - values) / inside, axis=0)[k]])
        for k, sign in enumerate((-1.0, 1.0))
    ]
    whole = bounded(held, normal.gradient, ends[0], ends[1])

    def after(share: float) -> _At | None:
        part = share * whole
        moved = np.clip(values + part[count:] * inside, *bounds)
        part[count:] = (moved - values) / inside
        unknowns = [
            c.unknowns + share * u for c, u in zip(residual.contacts, normal.unknowns(part / share), strict=True)
        ]
        try:
            rig = build(moved)
            return _At(
                moved, residual_of(linearization, rig, residual.nuisance + part[:count], tuple(unknowns), like=residual)
            )
        except RigError:  # no such rig
            return None

    inverse = scaled_inverse(normal.matrix)[count:, count:]
    covariance = linearization.record.sample_ratio * inverse * np.outer(inside, inside)
    return _Step(after, normal.promised(whole), covariance)


def _along(linearization: Linearization, build: Build, values: Values, step: Values, at: Residual) -> Column:
    """Decrease of the residuals by a step; where sharp modes ring, from two rigs, 2 r(x) - r(2 x) / 2.

    A shift by a part of a resonance's width is bent, and what is bent nuisance parameters would not take up.
    """
    first = derivative(linearization, build(values + step), at)
    if not linearization.record.modes:
        return first
    linear, contacts = derivative(linearization, build(values + 2 * step), at)
    return 2 * first[0] - linear / 2, [2 * one - other / 2 for one, other in zip(first[1], contacts, strict=True)]


def scaled_inverse(matrix: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """The inverse of normal equations whose unknowns differ by orders of magnitude; zero where nothing is known."""
    size = np.sqrt(np.diag(matrix))
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    both = np.outer(scale, scale)
    return np.asarray(np.linalg.pinv(matrix * both, hermitian=True) * both)


def bounded(
    matrix: Float[np.ndarray, "n n"],
    gradient: Float[np.ndarray, " n"],
    low: Float[np.ndarray, " n"],
    high: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """The x within bounds at which x'Mx/2 - g'x is least."""
    if not (np.isfinite(matrix).all() and np.isfinite(gradient).all()):
        raise RigError(
            "rig.json's contacts or modes are beyond any that this recording can be compared with; check its numbers"
        )
    factor = _cholesky(matrix)
    wanted = solve_triangular(factor, gradient, lower=True)
    low = np.minimum(low, 0.0) - ROUNDING
    return np.asarray(lsq_linear(factor.T, wanted, (low, np.maximum(high, 0.0) + ROUNDING), "bvls").x)


def _cholesky(matrix: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """Cholesky factor of products in single precision, whose rounding may hide the priors where a mismatch is large."""
    for rounding in (0.0, SINGLE):
        with suppress(np.linalg.LinAlgError):
            return np.asarray(np.linalg.cholesky(matrix + rounding * np.diag(np.diag(matrix))))
    raise RigError(
        "the recording does not tell contact forces and tolerances of this rig apart; measure more stations, or "
        "describe fewer contacts in rig.json"
    )


def _state(start: Residual) -> tuple[Float[np.ndarray, " nuisances"], tuple[Float[np.ndarray, " _"], ...]]:
    return start.nuisance, tuple(c.unknowns for c in start.contacts)
