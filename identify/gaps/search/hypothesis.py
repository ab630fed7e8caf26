"""Effects in a rig as a hypothesis on a record: how they are fitted, and what they leave."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from identify.gaps.residual.fit import Values, fit
from identify.gaps.residual.likelihood import Misfit, Reference, misfit
from identify.gaps.residual.nuisance import LIMIT
from identify.gaps.residual.residual import Linearization, Residual, rescaled, scales_at
from identify.gaps.residual.scales import Scales, prior_scales
from identify.gaps.residual.tuning import KINDS
from identify.gaps.search.base_excitation import fit_base_excitation
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.nominal import extra_relinearizations, fitted, stated_scale_refits
from identify.signals.refit import refit_until_settled
from rig.errors import RigError
from rig.model.description import Rig
from rig.model.parameters import ParameterSet

WORTH = 20.0
"""An effect that gains less of -2 ln p is not fitted: a good third of what the priors of one among some 26, at some 4
places, and the temperature of the comparison ask of it, 2 * 6 * ln(0.3 * 26 * 4 / 0.35) = 54."""
SHORT, ROUNDS, SETTLED, STILL = 3, 4, 1.0, 0.1
"""Steps of a first fit; at most so many rounds to the end, until one gains less than this of -2 ln p, by scales that
are the same within this share."""
FAR = 200.0
"""Hypotheses whose -2 ln p is larger by so much than the best one's are not fitted to the end, nor compared on another
record, where the odds of a single one are e^(200 / (2 * 6)) = 2e7."""
AT_LIMIT = 0.99
PULLED = 3.0
"""Stated standard deviations by which no tolerance is off by chance: what pulls one so far may be an effect."""

Build = Callable[[Values], Rig]
"""The rig of some values of the parameters."""


@dataclass(frozen=True)
class Hypothesis:
    """Effects in the rig, with their parameters fitted on a record one after the other; none: the believed rig."""

    parts: tuple[Candidate, ...]
    values: Float[np.ndarray, " parameters"]
    covariance: Float[np.ndarray, "parameters parameters"]
    misfit: Misfit

    @property
    def effects(self) -> tuple[str, ...]:
        return tuple(p.kind.name for p in self.parts)

    @property
    def key(self) -> tuple[str, ...]:
        """The names of its effects and their places, in no order; one may stand twice."""
        return tuple(sorted(p.name for p in self.parts))

    @property
    def cost(self) -> float:
        """Cost on the record that it was fitted to."""
        return self.misfit.minus_two_log

    @property
    def leaves_something(self) -> bool:
        """True if more is left above noise and tolerated shares than an effect must gain, or a tolerance is pulled
        far off, where it hides what is left."""
        return self.misfit.excess > WORTH or float(np.max(np.abs(self.misfit.pulls), initial=0.0)) > PULLED

    @property
    def at_limit(self) -> bool:
        """True if a tolerance stands at its limit."""
        return bool(np.any(np.abs(self.misfit.pulls) > AT_LIMIT * LIMIT))

    def split(self) -> list[Float[np.ndarray, " parameters"]]:
        """The values of each part."""
        return _split(self.parts, self.values)

    @property
    def parameters(self) -> ParameterSet:
        return parameters_of(self.parts)

    def applied_to(self, rig: Rig) -> Rig:
        return applied(rig, self.parts, self.values)


@dataclass(frozen=True)
class Tried:
    """A hypothesis while it is fitted: with linearisation and residual, which take much memory."""

    hypothesis: Hypothesis
    linearization: Linearization
    residual: Residual

    @property
    def cost(self) -> float:
        return self.hypothesis.cost


def applied(rig: Rig, parts: Sequence[Candidate], values: Float[np.ndarray, " parameters"]) -> Rig:
    """The rig with several effects, whose parameters stand one after the other."""
    for part, own in zip(parts, _split(parts, values), strict=True):
        rig = part.applied(rig, own)
    return rig


def _split(parts: Sequence[Candidate], values: Float[np.ndarray, " parameters"]) -> list[Float[np.ndarray, " own"]]:
    return np.split(values, np.cumsum([len(p.parameters) for p in parts])[:-1]) if parts else []


@dataclass(frozen=True)
class Search:
    """Data that a search on one record shares: linearisation and residual of the nominal rig, the variances."""

    reference: Reference
    linearization: Linearization
    at: Residual
    known: tuple[Candidate, ...]

    def nothing(self) -> Tried:
        return _tried(self, (), np.zeros(0), np.zeros((0, 0)), self.linearization, self.at)


def fit_effects(
    context: Search,
    parts: tuple[Candidate, ...],
    values: Float[np.ndarray, " parameters"],
    start: Residual,
    least: float = np.inf,
) -> Tried:
    """Effects fitted to the end from some values, and from the nuisance parameters and drifts of a residual."""
    return refined(context, fit_briefly(context, parts, values, reset_saturated_nuisance(start)), least)


def fit_briefly(
    context: Search,
    parts: tuple[Candidate, ...],
    values: Float[np.ndarray, " parameters"],
    start: Residual | None,
    linearization: Linearization | None = None,
) -> Tried:
    """Gauss-Newton for a few steps at the scales of a linearisation (the believed rig's unless one is given).

    Without a start, nothing was bent to do without the effects: then the linearisation is about their values.
    """
    linearization, build = linearization or context.linearization, partial(applied, context.linearization.rig, parts)
    if start is None:
        linearization = linearization.about(build(values), None, linearization.scales, linearization.seen)
    done = fit(linearization, build, values, steps_of(parts), parameters_of(parts).bounds, start, SHORT)
    return _tried(context, parts, done.values, done.covariance, linearization, done.residual)


def fit_afresh(context: Search, parts: tuple[Candidate, ...], values: Float[np.ndarray, " parameters"]) -> Tried:
    """Gauss-Newton from the contact scales that the tolerances state, and a slow motion that followed no other law.

    A decay counts for few seconds: scales that the believed law made would not come down with the rounds of `refined`.
    """
    record, rig = context.linearization.record, context.linearization.rig
    build = partial(applied, rig, parts)
    scales = replace(context.linearization.scales, contacts=prior_scales(record).contacts)
    linearization = context.linearization.about(build(values), None, scales)
    done = fit(linearization, build, values, steps_of(parts), parameters_of(parts).bounds)
    return _tried(context, parts, done.values, done.covariance, linearization, done.residual)


def refined(context: Search, one: Tried, least: float = np.inf) -> Tried:
    """Fitted to the end, with scales and linearisation renewed about where the parameters have come to.

    What is known by its spectrum alone keeps its values. It ends where the cost stays `FAR` above the least of others.
    """
    parts, rig = one.hypothesis.parts, context.linearization.rig
    if any(p.kind.stochastic for p in parts):
        return one
    return relinearised(context, partial(applied, rig, parts), one, ROUNDS + extra_relinearizations(rig), least)


def fit_from(context: Search, build: Build, parts: tuple[Candidate, ...], values: Values, rounds: int) -> Tried:
    """Effects fitted to the end in rigs that `build` makes of values, from where a fit of another rig has come to."""
    linearization = context.linearization.about(build(values), None, context.linearization.scales)
    done = fit(
        linearization, build, values, steps_of(parts), parameters_of(parts).bounds, reset_saturated_nuisance(context.at)
    )
    return relinearised(
        context, build, _tried(context, parts, done.values, done.covariance, linearization, done.residual), rounds
    )


def relinearised(context: Search, build: Build, first: Tried, rounds: int, least: float = np.inf) -> Tried:
    """The best of refits, each linearised at the parameters and with the scales of the one before, until they settle.

    Scales that an effect has made superfluous come down over some refits, of which the first may gain nothing. Without
    contacts refits at the stated scales follow: larger ones leave what a linearised resonance errs.
    """
    parts, fits, record = first.hypothesis.parts, [first], context.linearization.record
    resonant = stated_scale_refits(context.linearization.rig)

    def refit(before: Tried) -> Tried:
        return refit_at(before, scales_at(before.linearization, before.residual))

    def refit_at(before: Tried, scales: Scales) -> Tried:
        values, start = before.hypothesis.values, reset_mode_nuisance(before.residual) if resonant else before.residual
        linearization = before.linearization.about(build(values), start, scales)
        done = fit(linearization, build, values, steps_of(parts), parameters_of(parts).bounds, start)
        fits.append(_tried(context, parts, done.values, done.covariance, linearization, done.residual))
        return fits[-1]

    def settled(before: Tried, after: Tried) -> bool:
        still = before.linearization.scales.distance(after.linearization.scales) < STILL
        return (still and abs(before.cost - after.cost) < SETTLED) or after.cost > least + FAR

    last = refit_until_settled(first, refit, settled, rounds=rounds)
    if resonant and last.cost <= least + FAR:
        start = min(fits, key=lambda one: one.cost)
        last = refit_until_settled(start, lambda before: refit_at(before, prior_scales(record)), rounds=resonant)
        refit_until_settled(last, refit, settled, rounds=rounds)
    return min(fits, key=lambda one: one.cost)


def steps_of(parts: tuple[Candidate, ...]) -> Float[np.ndarray, " parameters"]:
    return np.concatenate([np.zeros(0), *(p.steps for p in parts)])


def parameters_of(parts: Sequence[Candidate]) -> ParameterSet:
    """Parameters of several effects, one after the other; each belongs to its part by name."""
    return sum((p.parameters.belonging_to(p.name) for p in parts), ParameterSet())


def _tried(
    context: Search,
    parts: tuple[Candidate, ...],
    values: Float[np.ndarray, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    linearization: Linearization,
    at: Residual,
) -> Tried:
    left = misfit(linearization.record, context.reference, at)
    return Tried(Hypothesis(parts, values, covariance, left), linearization, at)


def fit_spectrum(context: Search, nothing: Tried, candidate: Candidate) -> Tried | None:
    """An effect of which only the spectrum is known: its values are not fitted over time."""
    if not nothing.hypothesis.leaves_something:
        return None
    found = fit_base_excitation(nothing.linearization, nothing.residual, candidate, WORTH)
    if found is None:
        return None
    values, deviations = found
    try:
        rig = candidate.applied(context.linearization.rig, values)
    except RigError:
        return None
    linearization = context.linearization.about(rig, nothing.residual, nothing.linearization.scales)
    linearization = rescaled(linearization, fitted(linearization, nothing.residual).residual)
    at = fitted(linearization, nothing.residual).residual
    return _tried(context, (candidate,), values, np.diag(deviations**2), linearization, at)


def reset_saturated_nuisance(residual: Residual) -> Residual:
    """Residual at which a fit of an effect starts: if a nuisance parameter stands at its limit, all are reset."""
    if np.max(np.abs(residual.pulls), initial=0.0) < LIMIT - 1e-6:
        return residual
    straight = tuple(replace(c, unknowns=c.believed) for c in residual.contacts)
    return replace(residual, nuisance=np.zeros_like(residual.nuisance), contacts=straight)


def reset_mode_nuisance(residual: Residual) -> Residual:
    """The residual with frequencies and damping of all modes at their nominal values, if a tolerance went far for one.

    An effect on frequencies and these tolerances are nearly the same change of the rig: fitted together they advance by
    a part of the resonance's width a step.
    """
    of_modes = np.array([p.kind in KINDS for p in residual.parameters], dtype=bool)
    if np.max(np.abs(residual.nuisance[of_modes]), initial=0.0) < PULLED:
        return residual
    return replace(residual, nuisance=np.where(of_modes, 0.0, residual.nuisance))


def beside(first: Tried, second: Tried) -> Hypothesis:
    """A pair of which the second was fitted with the first held, as one is known by its spectrum alone."""
    one, other = first.hypothesis, second.hypothesis
    values = np.concatenate([one.values, other.values])
    return Hypothesis((*one.parts, *other.parts), values, block_diag(one.covariance, other.covariance), other.misfit)
