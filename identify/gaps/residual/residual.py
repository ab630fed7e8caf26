"""The one residual of the diagnosis: a rig's model against a record, with the nuisance parameters free.

cost = |linear residual|^2 + sum over contacts |contact residual|^2 + sample_ratio |nuisance|^2 + log determinant
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from identify.gaps.residual.grounded import pushed_by_motion
from identify.gaps.residual.law import (
    ContactResidual,
    ContactSignals,
    contact_residual,
    contact_signals_of,
    start_of,
)
from identify.gaps.residual.linear import Linear, linear_model
from identify.gaps.residual.lines import standing_out, without_lines
from identify.gaps.residual.nuisance import Columns, apply_nuisance, columns_of, counted, with_nuisance
from identify.gaps.residual.observation import ContactObservation, seen_contacts
from identify.gaps.residual.record import Record
from identify.gaps.residual.scales import Scales, estimated_scales, prior_scales
from identify.gaps.residual.tuning import TunedModes, tuned_modes
from identify.linear.joined import joined_contacts, joined_laws
from identify.linear.model import Recent, ResponseCache
from identify.linear.nuisance import Nuisance
from rig.model.description import Rig


class SearchCache:
    """Cache that the models of one search share on one record: responses of its bodies, and the columns used last, as
    they are large. It lives as long as the linearisations that hold it.
    """

    def __init__(self, record: Record) -> None:
        self.responses = ResponseCache(record.omega)
        self._columns = Recent[Columns](2)

    def columns(self, model: Linear) -> Columns:
        return self._columns.get(model, lambda: columns_of(model.record, model))


@dataclass(frozen=True)
class Linearization:
    """A record and the rig about which it is linearised: what every residual of the record shares.

    put are the nuisance parameters that are in the rig already where it is linearised; None: all zero. tuned are those
    of single modes that are in the linear model too: of a free decay, which tells them.
    """

    record: Record
    rig: Rig
    scales: Scales
    model: Linear
    seen: tuple[ContactObservation, ...]
    put: Float[np.ndarray, " nuisances"] | None
    tuned: TunedModes
    cache: SearchCache

    def about(
        self,
        rig: Rig,
        at: "Residual | None" = None,
        scales: Scales | None = None,
        seen: tuple[ContactObservation, ...] | None = None,
    ) -> "Linearization":
        """The linearisation of the same record about another rig, as `linearized`, with the same cache."""
        return linearized(self.record, rig, at, scales, seen, self.cache)

    @cached_property
    def expansion_point(self) -> Float[np.ndarray, " nuisances"]:
        """The nuisance parameters that are in the model already where it is linearised."""
        parameters = self.columns.parameters
        put = np.zeros(len(parameters)) if self.put is None else self.put
        return put + np.array([self.tuned.pulls.get(p, 0.0) for p in parameters]) if self.tuned.pulls else put

    @cached_property
    def gram(self) -> Float[np.ndarray, "nuisances nuisances"]:
        """The products of the linear residual's columns."""
        return self.columns.products(self.columns.flat)

    @cached_property
    def lines(self) -> tuple[float, ...]:
        """The frequencies, per sample, of the lines that stand out of its own rig's residual; none of a free decay,
        which rings as sharply."""
        if not self.record.forced:
            return ()
        sensors = len(self.record.sensors)
        return standing_out(counted(self.record, self.model.residual[:sensors]), self.record.repeats)

    @property
    def columns(self) -> Columns:
        """Computed again if others were used since."""
        return self.cache.columns(self.model)


@dataclass(frozen=True)
class Residual:
    """A rig against a record. linear is in standard deviations, over time, with the nuisance parameters taken in.

    quiet is what of it is fitted, and tells the scale of the unmodelled: of a rig without tones, linear without the
    lines that stand out. They are no error of a model, so nothing else is to follow them.
    """

    rig: Rig
    model: Linear
    signals: tuple[ContactSignals, ...]
    bare: Float[np.ndarray, "rows times"]
    linear: Float[np.ndarray, "rows times"]
    quiet: Float[np.ndarray, "rows times"]
    contacts: tuple[ContactResidual, ...]
    nuisance: Float[np.ndarray, " nuisances"]
    parameters: tuple[Nuisance, ...]
    sample_ratio: float

    @property
    def rows(self) -> int:
        """The cost of noise alone."""
        return int(self.linear.size + sum(c.residual.size for c in self.contacts))

    @property
    def pulls(self) -> Float[np.ndarray, " pulls"]:
        """Pulls of nuisance parameters and the contacts' own: (estimate - prior mean) / prior standard deviation."""
        return np.concatenate([self.nuisance, *(c.pulls for c in self.contacts)])

    @property
    def corrected_rig(self) -> Rig:
        """The rig with what was fitted beside it: nuisance parameters and the contacts' tolerances."""
        found = with_nuisance(self.rig, self.parameters, self.nuisance, self.model.record.tolerances)
        contacts = list(found.contacts)
        for place, fit in zip(joined_contacts(found), self.contacts, strict=True):
            for j, law in zip(place.members, fit.fitted, strict=True):
                contacts[j] = replace(contacts[j], law=law)
        return replace(found, contacts=tuple(contacts))

    @property
    def contact_levels(self) -> tuple[float, ...]:
        """Mean square of each contact's residual while the rig moves, in the variances that it was weighed by."""
        found = []
        for contact in self.contacts:
            moving = contact.seen.weights > 0
            own = contact.residual[: moving.size][moving]
            found.append(float(np.mean(own**2)) if own.size else 0.0)
        return tuple(found)

    @property
    def cost(self) -> float:
        return (
            float(np.sum(self.quiet**2) + self.sample_ratio * self.nuisance @ self.nuisance)
            + sum(c.cost for c in self.contacts)
            + self.model.log_determinant * self.linear.shape[1] / self.model.deviation.shape[1]
        )


def linearized(
    record: Record,
    rig: Rig,
    at: Residual | None = None,
    scales: Scales | None = None,
    seen: tuple[ContactObservation, ...] | None = None,
    cache: SearchCache | None = None,
) -> Linearization:
    """The linearisation about a rig, with the nuisance parameters of a residual of the record in it, if one is given.

    `scales` and `seen` of another linearisation of the record keep their costs comparable.
    """
    scales, cache = scales or prior_scales(record), cache or SearchCache(record)
    there, put = apply_nuisance(rig, at.parameters, at.nuisance, record.tolerances) if at else (rig, None)
    tuned = tuned_modes(record, there, at.parameters if at else None, at.nuisance if at else None)
    model = linear_model(record, there, scales.discrepancy, cache.responses, tuned.factors)
    seen = seen or seen_contacts(record, model, joined_laws(there), scales.contacts)
    return Linearization(record, rig, scales, model, seen, put, tuned, cache)


def rescaled(linearization: Linearization, at: Residual) -> Linearization:
    """The linearisation with the scales that a residual of it shows."""
    return linearization.about(linearization.rig, at, scales_at(linearization, at))


def scales_at(linearization: Linearization, at: Residual) -> Scales:
    """Scales of what no model explains, as a residual shows them."""
    return estimated_scales(linearization.record, linearization.scales, at.quiet, at.contact_levels)


def linear_of(linearization: Linearization, rig: Rig) -> Linear:
    """The linear model of a rig, with the nuisance parameters in it that the linearisation has in its own."""
    record = linearization.record
    if linearization.put is not None and linearization.put.any():
        rig, _ = apply_nuisance(rig, linearization.columns.parameters, linearization.put, record.tolerances)
    scales, cache = linearization.scales, linearization.cache
    return linear_model(record, rig, scales.discrepancy, cache.responses, linearization.tuned.factors)


def residual_of(
    linearization: Linearization,
    rig: Rig,
    nuisance: Float[np.ndarray, " nuisances"] | None = None,
    unknowns: tuple[Float[np.ndarray, " _"], ...] | None = None,
    like: Residual | None = None,
) -> Residual:
    """The residual of a rig at some nuisance parameters (none: those of the linearisation) and contact unknowns (none:
    zero), without any fit.

    `like` is a residual of the same linearisation, of which nothing is computed again that is the same.
    """
    record, parameters, laws = linearization.record, linearization.columns.parameters, joined_laws(rig)
    nuisance = linearization.expansion_point if nuisance is None else nuisance
    if like is not None and same_but_laws(like.rig, rig):
        model, signals, bare = like.model, like.signals, like.bare
    else:
        model = linearization.model if same_but_laws(linearization.rig, rig) else linear_of(linearization, rig)
        signals = contact_signals_of(record, model)
        bare = counted(record, model.residual)
    if unknowns is None:
        unknowns = tuple(
            start_of(at, s, law, record.rate_hz) for at, s, law in zip(signals, linearization.seen, laws, strict=True)
        )
    beside = nuisance - linearization.expansion_point
    same = like if like is not None and model is like.model and nuisance is like.nuisance else None
    linear = same.linear if same else bare
    if beside.any() and not same:
        linear = bare - linearization.columns.along(beside)
    quiet = same.quiet if same else linear if rig.tones else without_lines(linear, linearization.lines)

    slow_m = [s.curve.value @ u[: s.curve.knots] for s, u in zip(linearization.seen, unknowns, strict=True)]
    others = model.slow_n_per_m - np.diag(np.diag(model.slow_n_per_m))

    def contact(j: int) -> ContactResidual:
        law, told_by = laws[j], {j, *np.flatnonzero(others[j])}
        if same and same.contacts[j].law == law and all(same.contacts[i].unknowns is unknowns[i] for i in told_by):
            return same.contacts[j]
        more_n, more_m = (-beside @ c[:, j] for c in (linearization.columns.contact_n, linearization.columns.eta_m))
        more_n -= sum(others[j, i] * slow_m[i] for i in told_by)
        return contact_residual(signals[j], linearization.seen[j], law, unknowns[j], more_n, more_m)

    contacts = tuple(contact(j) for j in range(len(laws)))
    return Residual(rig, model, signals, bare, linear, quiet, contacts, nuisance, parameters, record.sample_ratio)


def same_but_sensors(one: Rig, other: Rig) -> bool:
    """True if two rigs differ in their sensors' gains and delays at most, and no force follows from what they show."""
    return replace(one, sensors=other.sensors) == other and not pushed_by_motion(one)


def same_but_laws(one: Rig, other: Rig) -> bool:
    """True if two rigs differ in their contact laws at most."""
    if one is other:
        return True
    laws = tuple(c.law for c in other.contacts)
    return replace(one, contacts=tuple(replace(c, law=law) for c, law in zip(one.contacts, laws, strict=True))) == other
