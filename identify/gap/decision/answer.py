"""From recordings to a diagnosis in words and numbers: the content of gap.json."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from identify.gap.candidates import Candidate, candidates, scale_of
from identify.gap.decision.attribution import attribution
from identify.gap.decision.comparison import Judged, closed, closed_interval, judged, log_priors
from identify.gap.decision.differences import differences
from identify.gap.decision.experiment import next_experiments
from identify.gap.decision.null_reference import NullReference, Simulate, null_reference
from identify.gap.decision.response_comparison import compared
from identify.gap.decision.sentence import sentence
from identify.gap.decision.verdict import HALF, Decision, decided, unknown_gain
from identify.gap.faults import sound_channels
from identify.gap.likelihood import Misfit, Reference, reference_of
from identify.gap.residual import Residual, base_of
from identify.gap.results import Band, Cause, Gap, Left, Matters, MeanForce, NextExperiment, Unknown, Value
from identify.gap.scales import BAND_HZ
from identify.gap.search.joint import Hypothesis, Search, search
from identify.gap.search.nominal import fit_nuisance
from identify.gap.search.pooled import fitted_together
from identify.gap.spectra import Record, record_of
from identify.gap.unknown import UnknownForce, likeliest_force
from identify.gap.unknown import sentence as described
from identify.gap.unknown.play import Breathing, breathing
from rig.description import Rig, to_json
from rig.errors import RigError
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording, Signals

FIT_SHARE = 0.55
"""Of a single record, what is fitted on; the rest validates."""
ALIKE = 0.05
"""Causes that are likelier than this beside the best one cannot be told apart from it."""
AT_LIMIT = 1e-3
"""A parameter within this share of its range from an end stands there."""
MATTERS = Matters()

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Simulator:
    """What simulates a rig under a measured force, and its name."""

    name: str
    simulate: Simulate


def diagnose(
    recordings: Recording | Sequence[Recording],
    validation: Recording | None,
    simulator: Simulator,
    kept: Path | None = None,
    progress: Progress = lambda *_: None,
    tolerances: Tolerances | None = None,
    matters: Matters = MATTERS,
    ask_next: bool = False,
) -> tuple[Gap, Rig]:
    """The diagnosis, and the rig corrected by it (the believed one, if no effect explains the gap at least in part).

    `validation` may be one of the recordings, or another; None: the last of several, or the last part of a single one.
    Of several that are fitted, the one of the strongest force is searched; then all share the parameters of what was
    found there, and what differs between the records is told. The null reference is made by the simulator, or read from
    `kept` (see `null_reference`); tolerances say how exactly the rig is believed (else the rig itself does, else they
    are a laboratory's). Raises RigError if the records do not fit together or allow no diagnosis. With ask_next the
    next experiment is computed where two causes stay alike.
    """
    parts, last = _parts(recordings, validation)
    believed = tolerances or parts[0].rig.tolerances or LABORATORY
    parts, faults = sound(*parts)
    every = [record_of(part, tolerances=believed) for part in parts]
    other, record = parts[last], every[last]
    fitted = [k for k in range(len(parts)) if k != last]
    searched_on = max(fitted, key=lambda k: float(np.std(parts[k].force_n)))
    fit_record = every[searched_on]
    nulls = null_reference(other, believed, simulator.simulate, simulator.name, lambda x: progress("nulls", x), kept)
    several = len(fitted) > 1
    hypotheses, known = searched(fit_record, lambda x: progress("causes", (0.4 if several else 0.7) * x))
    reference = _reference(record)
    if several:
        seen = [_reference(one) for one in every]
        shared = [every[k] for k in fitted], [seen[k] for k in fitted]
        hypotheses = [fitted_together(*shared, one) for one in hypotheses]
    priors = log_priors(hypotheses, known)
    base, at = fit_nuisance(record, record.rig, rounds=1)
    ranked = judged(record, reference, at, hypotheses, priors, lambda x: progress("causes", 0.7 + 0.2 * x))
    decision, unknown, swinging = _decided(fit_record, record, at, ranked, nulls, matters)
    between = None
    if several:
        cause = decision.best if decision.verdict in ("explained", "partly_explained") else None
        names = [f"{k + 1}, {np.std(p.force_n):.3g} N{', validates' * (k == last)}" for k, p in enumerate(parts)]
        between = differences(every, seen, cause, known, names, lambda x: progress("causes", 0.9 + 0.05 * x))
    progress("causes", 0.95)
    likeliest = decision.best.corrected if decision.best else other.rig
    figures, curves = compared(other, other.rig, likeliest, simulator.simulate)
    progress("causes", 1.0)
    causes = tuple(
        _cause(j, p, nulls, matters) for j, p in zip(ranked, decision.probabilities, strict=True) if j.hypothesis.parts
    )
    nothing = decision.nothing
    further: tuple[NextExperiment, ...] = ()
    rivals = _rivals(ranked, decision) if ask_next else None
    if rivals:
        further = next_experiments(record, other.force_n, rivals, simulator.simulate)
    after = decision.best.misfit if decision.best else nothing.misfit
    without = decision.best.without if decision.best else nothing.misfit
    gap = Gap(
        verdict=decision.verdict,
        sentence="",
        before=_left(without, other.rig, decision.p_before),
        after=_left(after, other.rig, decision.p_after),
        matters=matters,
        causes=causes,
        probability_nothing=decision.probabilities[ranked.index(nothing)],
        probability_unknown=decision.unknown,
        nothing_minus_two_log=nothing.misfit.minus_two_log,
        unknown_gain=unknown_gain(unknown, record.strictness),
        unknown=_described(other.rig, unknown, swinging),
        bands=_bands(without, after, nulls),
        equivalent=equivalent(causes) if causes else (),
        separate_by=_experiments(causes, ranked),
        next_experiments=further,
        next_between=tuple(" + ".join(one.effects) or "nothing" for one in rivals or ()),
        attribution=attribution(base, at, nothing.misfit),
        figures=figures,
        curves=curves,
        between=between,
        channel_faults=faults,
    )
    helps = decision.verdict in ("explained", "partly_explained")
    return sentence(gap, decision.criterion), likeliest if helps else other.rig


def searched(
    record: Record, progress: Callable[[float], None] = lambda _: None
) -> tuple[list[Hypothesis], list[Candidate]]:
    """Hypotheses on a record, and the candidates among which they were found."""
    reference = _reference(record)
    base, at = fit_nuisance(record, record.rig)
    known = candidates(scale_of(record, record.rig), [s.name for s in record.sensors], record.zero_known)
    return search(Search(reference, base, at, tuple(known)), progress), known


def _reference(record: Record) -> Reference:
    return reference_of(base_of(record, record.rig))


def sound(*recordings: Recording) -> tuple[list[Recording], dict[str, str]]:
    """All recordings without the channels that are dead or clipped in any."""
    faults: dict[str, str] = {}
    for one in recordings:
        faults |= sound_channels(one, without=tuple(faults))[1]
    return [sound_channels(one, without=tuple(faults))[0] for one in recordings], faults


def _parts(recordings: Recording | Sequence[Recording], validation: Recording | None) -> tuple[list[Recording], int]:
    """All recordings in their order, and which of them validates."""
    parts = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if not parts:
        raise RigError("no recording to diagnose; give one or more of the rig")
    if validation is None and len(parts) == 1:
        return list(_halves(parts[0])), 1
    if validation is not None and not any(validation is one for one in parts):
        parts.append(validation)
    for k, one in enumerate(parts):
        if to_json(one.rig) != to_json(parts[0].rig):
            raise RigError(f"recording {k + 1} is of another rig (their rig.json differ); give recordings of one rig")
        if any(_same(one, earlier) for earlier in parts[:k]):
            raise RigError(f"recording {k + 1} is the same as an earlier one; give each recording once")
    last = next((k for k, one in enumerate(parts) if one is validation), len(parts) - 1)
    if len(parts) == 1:
        raise RigError("the only recording cannot validate itself; leave --validate out, or give another recording")
    return parts, last


def _same(one: Recording, other: Recording) -> bool:
    """Whether two recordings hold the same samples."""
    return all(np.array_equal(s.values, other.signals[name].values) for name, s in one.signals.items())


def _halves(recording: Recording) -> tuple[Recording, Recording]:
    """One record cut in two."""
    cut = round(FIT_SHARE * recording.samples)

    def part(keep: slice) -> Recording:
        signals = {n: Signals(s.channels, 0.0, s.values[:, keep]) for n, s in recording.signals.items()}
        return Recording(recording.rig, signals, recording.provenance)

    return part(slice(0, cut)), part(slice(cut, None))


def _decided(
    fit_record: Record, record: Record, at: Residual, ranked: list[Judged], nulls: NullReference, matters: Matters
) -> tuple[Decision, UnknownForce | None, Breathing | None]:
    """The verdict; and of a gap that no effect explains, what acts unmeasured: beside the likeliest effects, if those
    explain it in part."""
    decision = decided(ranked, None, record.strictness, nulls, matters)
    if decision.verdict not in ("partly_explained", "unknown"):
        return decision, None, None
    unknown = _unknown(fit_record, record, record.rig)
    decision = decided(ranked, unknown, record.strictness, nulls, matters)
    best = decision.best
    if best and decision.verdict != "no_gap" and closed(best.without, best.misfit, matters) >= HALF:
        beside = _unknown(fit_record, record, best.rig)
        decision = decided(ranked, unknown, record.strictness, nulls, matters, beside)
        if decision.verdict == "partly_explained":
            unknown, at = beside, fit_nuisance(record, best.rig, rounds=1)[1]
    return decision, unknown, breathing(record, at)


def _unknown(fit_record: Record, record: Record, rig: Rig) -> UnknownForce | None:
    """What acts unmeasured beside a rig."""
    try:
        return likeliest_force(fit_record, rig, record)
    except RigError:
        return None  # too few sensors to show a force beside the contacts'


def _left(left: Misfit, rig: Rig, p_value: float) -> Left:
    names = [c.name for c in rig.contacts]
    return Left(
        share=left.share,
        contact_shares=dict(zip(names, left.contact_shares.tolist(), strict=True)),
        p_value=p_value,
    )


def _cause(one: Judged, probability: float, nulls: NullReference, matters: Matters) -> Cause:
    """Standard errors hold what the effect leaves: residuals were weighed by the scales estimated from it."""
    parameters: dict[str, Value] = {}
    places: dict[str, str] = {}
    spread = np.sqrt(np.maximum(np.diag(one.hypothesis.covariance), 0.0))
    at = 0
    for part in one.hypothesis.parts:
        low, high = part.bounds
        for k, (name, about) in enumerate(part.parameters.items()):
            value, error = float(one.hypothesis.values[at]), float(spread[at])
            margin = AT_LIMIT * (high[k] - low[k])
            limited = (value < low[k] + margin and low[k] != about.neutral) or value > high[k] - margin
            parameters[f"{part.kind.name}.{name}"] = Value(value, error, about.unit, bool(limited))
            at += 1
        places |= {f"{part.kind.name}.{field}": place or "all" for field, place in part.place.items()}
    return Cause(
        effects=one.hypothesis.effects,
        probability=probability,
        parameters=parameters,
        places=places,
        explained=closed(one.without, one.misfit, matters),
        interval_95=closed_interval(one.without, one.misfit, matters),
        left=_left(one.misfit, one.rig, nulls.p_value(one.misfit)),
        log_prior=one.log_prior,
        minus_two_log=one.misfit.minus_two_log,
    )


def _bands(without: Misfit, after: Misfit, nulls: NullReference) -> tuple[Band, ...]:
    return tuple(
        Band(low_hz=BAND_HZ * i, high_hz=BAND_HZ * (i + 1), before=float(b), after=float(a), usual=float(u))
        for i, (b, a, u) in enumerate(zip(without.shares, after.shares, nulls.usual_shares(), strict=False))
    )


def equivalent(causes: tuple[Cause, ...]) -> tuple[tuple[str, ...], ...]:
    """Each effect of the likeliest cause with those that stand in its place in causes that are likely too."""
    best, *likely = dict.fromkeys(frozenset(c.effects) for i, c in enumerate(causes) if not i or c.probability > ALIKE)
    classes = []
    for effect in causes[0].effects:
        instead = [one - best for one in likely if len(one) == len(best) and best - one == {effect}]
        classes.append((effect, *(other for others in instead for other in others)))
    return tuple(names for names in classes if len(names) > 1)


def _rivals(ranked: list[Judged], decision: Decision) -> tuple[Hypothesis, Hypothesis] | None:
    """The two likeliest, if both are likelier than `ALIKE`: causes, or a cause and the believed rig.

    That stands for something unknown too, which nobody can simulate.
    """
    shares = dict(zip((id(j) for j in ranked), decision.probabilities, strict=True))
    shares[id(decision.nothing)] += decision.unknown
    likely = sorted((j for j in ranked if shares[id(j)] > ALIKE), key=lambda j: -shares[id(j)])
    return (likely[0].hypothesis, likely[1].hypothesis) if len(likely) > 1 else None


def _experiments(causes: tuple[Cause, ...], ranked: list[Judged]) -> tuple[str, ...]:
    """What would confirm or refute each effect of the causes that are likely, or close part of the gap."""
    kinds = {part.kind.name: part.kind for j in ranked for part in j.hypothesis.parts}
    likely = [c for i, c in enumerate(causes) if c.probability > ALIKE or (i == 0 and c.interval_95[0] > 0)]
    names = dict.fromkeys(effect for cause in likely for effect in cause.effects)
    return tuple(f"{name}: {kinds[name].separated_by}" for name in names)


def _described(rig: Rig, found: UnknownForce | None, swinging: Breathing | None) -> Unknown | None:
    """The force, unless it explains little where a clearance swings clearly."""
    if swinging and (found is None or found.validation_explained_share < swinging.share):
        contact = rig.contact(swinging.contact)
        return Unknown(
            sentence=swinging.sentence,
            kind="contact",
            body=contact.at.body,
            position_m=contact.at.position_m,
            position_error_m=0.0,
            against_body=contact.against.body if contact.against else None,
            against_position_m=contact.against.position_m if contact.against else None,
            sensor=None,
            contact=swinging.contact,
            frequency_hz=swinging.frequency_hz,
            band_hz=(swinging.frequency_hz, swinging.frequency_hz),
            rms_n=0.0,
            when="always",
            against="none",
            law=f"{1e3 * swinging.amplitude_m:.3g} mm at {swinging.frequency_hz:.4g} Hz",
            explained=swinging.share,
        )
    if found is None:
        return None
    at_place = found.kind in ("force", "pair")
    seen = found.surface
    return Unknown(
        sentence=described(found),
        kind=found.kind,
        body=found.body or None,
        position_m=found.position_m.value if at_place else None,
        position_error_m=found.position_m.standard_error if at_place else None,
        against_body=found.against_body or None,
        against_position_m=found.against_position_m if found.against_body else None,
        sensor=found.sensor or None,
        growth=dict(zip(found.bodies, found.growth, strict=True)),
        same_place=found.same_place,
        frequency_hz=found.frequency_hz,
        band_hz=found.band_hz,
        rms_n=found.rms.value,
        amplitude_n=found.amplitude_n,
        when=found.when,
        before_excitation=found.before_excitation,
        by_time=found.by_time,
        against=found.against,
        law=found.law,
        explained=found.validation_explained_share,
        over_motion=MeanForce(seen.eta_m, seen.rate_m_per_s, seen.share) if seen else None,
        spectrum_hz=found.spectrum_hz,
        spectrum=found.spectrum,
    )
