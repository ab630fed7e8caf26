"""The second stage of a diagnosis: what effects may explain the recordings that are fitted."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from identify.gaps.decision.prepare import Prepared
from identify.gaps.residual.likelihood import Reference
from identify.gaps.residual.record import Record
from identify.gaps.search.candidates import Candidate, candidates, scale_of
from identify.gaps.search.hypothesis import Hypothesis, Search
from identify.gaps.search.nominal import fit_nuisance
from identify.gaps.search.pooled import fitted_together
from identify.gaps.search.sparse import search as search_sets


@dataclass(frozen=True)
class Searched:
    """Hypotheses, the believed rig among them, and the candidates among which they were found."""

    hypotheses: tuple[Hypothesis, ...]
    candidates: tuple[Candidate, ...]


def search(prepared: Prepared, progress: Callable[[float], None] = lambda _: None) -> Searched:
    """The hypotheses that explain most of the record of the strongest force; of several records, with the parameters
    that all that are fitted share."""
    strongest, share = prepared.searched, 0.6 if prepared.several else 1.0
    searched = search_record(strongest.record, strongest.reference, lambda x: progress(share * x))
    if not prepared.several:
        return searched
    records = [one.record for one in prepared.fitted]
    references = [one.reference for one in prepared.fitted]
    return replace(searched, hypotheses=tuple(fitted_together(records, references, one) for one in searched.hypotheses))


def search_record(record: Record, reference: Reference, progress: Callable[[float], None] = lambda _: None) -> Searched:
    linearization, residual = fit_nuisance(record, record.rig)
    known = candidates(scale_of(record, record.rig), [s.name for s in record.sensors], record.zero_known, record.forced)
    hypotheses = search_sets(Search(reference, linearization, residual, tuple(known)), progress)
    return Searched(tuple(hypotheses), tuple(known))
