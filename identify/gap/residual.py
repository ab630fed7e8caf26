"""The one residual of the diagnosis: a rig against a record, with everything that is always in doubt left free.

cost = |linear residual|^2 + sum over contacts |contact residual|^2 + strictness |doubts|^2 + log determinant
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.gap.doubts import Doubts, doubts_of, moved, residual_scale
from identify.gap.law import Contact, Laid, Seen, contact_residual, laid_out, seen_contacts, start_of
from identify.gap.linear import Linear, linear_model
from identify.gap.spectra import Record
from rig.description import Rig

MODEL_ERROR = 5e-4
"""Share of each acceleration that no model of this kind explains."""


@dataclass(frozen=True)
class Base:
    """A record and the rig about which it is linearised: what every residual of the record shares.

    about are the doubts that are in the rig already where it is linearised.
    """

    record: Record
    rig: Rig
    model: Linear
    seen: tuple[Seen, ...]
    doubts: Doubts
    doubts_gram: Float[np.ndarray, "doubts doubts"]
    about: Float[np.ndarray, " doubts"]


@dataclass(frozen=True)
class Residual:
    """A rig against a record. linear is in standard deviations, over time, with the doubts taken in."""

    rig: Rig
    model: Linear
    laid: tuple[Laid, ...]
    bare: Float[np.ndarray, "rows times"]
    linear: Float[np.ndarray, "rows times"]
    contacts: tuple[Contact, ...]
    doubts: Float[np.ndarray, " doubts"]
    names: tuple[str, ...]
    strictness: float

    @property
    def rows(self) -> int:
        """The cost of noise alone."""
        return int(self.linear.size + sum(c.residual.size for c in self.contacts))

    @property
    def strain(self) -> float:
        """The largest doubt or contact tolerance, in standard deviations."""
        own = [c.unknowns[-3:] for c in self.contacts]
        return float(np.max(np.abs(np.concatenate([self.doubts, *own])), initial=0.0))

    @property
    def cost(self) -> float:
        return (
            float(np.sum(self.linear**2) + self.strictness * self.doubts @ self.doubts)
            + sum(c.cost for c in self.contacts)
            + self.model.log_determinant * self.linear.shape[1] / self.model.spread.shape[1]
        )


def base_of(
    record: Record,
    rig: Rig,
    seen: tuple[Seen, ...] | None = None,
    about: Residual | None = None,
    levels: Sequence[float] | None = None,
) -> Base:
    """The linearisation about a rig, with the doubts of a residual of the record in it, if one is given.

    `seen` of another base of the record keeps their costs comparable; otherwise levels are
    the mean squares of the contact residuals in null recordings.
    """
    there, put = moved(rig, about.names, about.doubts, record.tolerances) if about else (rig, None)
    model = linear_model(record, there, MODEL_ERROR)
    doubts = doubts_of(record, model, record.tolerances)
    columns = doubts.residual.reshape(len(doubts.names), -1)
    put = np.zeros(len(doubts.names)) if put is None else put
    return Base(record, rig, model, seen or seen_contacts(record, model, levels), doubts, columns @ columns.T, put)


def residual_of(
    base: Base,
    rig: Rig,
    doubts: Float[np.ndarray, " doubts"] | None = None,
    unknowns: tuple[Float[np.ndarray, " _"], ...] | None = None,
    like: Residual | None = None,
) -> Residual:
    """The residual of a rig at some doubts and contact unknowns (none of either: zero), without any fit.

    `like` is a residual of the same linear rig, whose linear part is then not computed again.
    """
    record = base.record
    doubts = np.zeros(len(base.doubts.names)) if doubts is None else doubts
    if like is not None and same_but_laws(like.rig, rig):
        model, laid, bare = like.model, like.laid, like.bare
    else:
        there = moved(rig, base.doubts.names, base.about, record.tolerances)[0] if base.about.any() else rig
        model = linear_model(record, there, MODEL_ERROR)
        laid = laid_out(record, model)
        bare = residual_scale(record) * record.in_time(model.residual)
    if unknowns is None:
        unknowns = tuple(start_of(at, s, record.rate_hz) for at, s in zip(laid, base.seen, strict=True))
    beside = doubts - base.about
    linear = bare - np.tensordot(beside, base.doubts.residual, 1) if beside.any() else bare
    more_n, more_m = (-np.tensordot(beside, c, 1) for c in (base.doubts.contact_n, base.doubts.eta_m))
    contacts = tuple(
        contact_residual(laid[j], base.seen[j], rig.contacts[j].law, unknowns[j], more_n[j], more_m[j])
        for j in range(len(rig.contacts))
    )
    return Residual(rig, model, laid, bare, linear, contacts, doubts, base.doubts.names, record.strictness)


def same_but_laws(one: Rig, other: Rig) -> bool:
    """Whether two rigs differ in their contact laws at most."""
    if one is other:
        return True
    laws = tuple(c.law for c in other.contacts)
    from msgspec.structs import replace

    return replace(one, contacts=tuple(replace(c, law=law) for c, law in zip(one.contacts, laws, strict=True))) == other
