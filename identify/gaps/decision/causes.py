"""Causes in gap.json: effects in words ("an added mass of 0.150 kg on the barrel at 1.00 m"), parameters, shares."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from identify.gaps.decision.comparison import ValidatedHypothesis, explained_share, explained_share_interval
from identify.gaps.decision.modal_changes import identifiable_change
from identify.gaps.decision.null_reference import NullReference, p_value
from identify.gaps.decision.verdict import RIVAL_PROBABILITY, WeightedHypothesis, strengths_of
from identify.gaps.residual.likelihood import Misfit
from identify.gaps.residual.record import Record
from identify.gaps.residual.scales import BAND_HZ
from identify.gaps.results import Band, Cause, Matters, UnexplainedShares, labels_of
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.hypothesis import Hypothesis
from identify.linear.joined import joined
from identify.pages.wording import number
from rig.model.description import Rig
from rig.model.parameters import Parameter
from rig.model.quantities import printed_unit
from rig.model.unmeasured_force import Value

MULTIPLE_RATIO = 2.0
"""Ratio from which a factor is stated as a multiple; nearer to one, it is larger or smaller by per cent."""
DIGITS = 3
"""Significant digits of a phrase. Display."""
UNKNOWN_STRENGTH, UNKNOWN_DIRECTION = "unknown strength", "elsewhere"


def phrase(candidate: Candidate, values: Float[np.ndarray, " parameters"], rig: Rig, with_strength: bool = True) -> str:
    """Phrase for an effect with its values in a rig, without its strength where that is not determined."""
    fields = {
        p.name: _strength_words(candidate, p, float(value), with_strength or p.neutral is None)
        for p, value in zip(candidate.parameters, values, strict=True)
    }
    for field, place in candidate.place.items():
        fields[field] = _place_words(field, place, rig)
    for field in candidate.typical.__struct_fields__:
        fields.setdefault(field, str(getattr(candidate.typical, field)))
    fields["at"] = ""
    if "relative_position" in candidate.parameters.names:
        share = float(values[candidate.parameters.names.index("relative_position")])
        body_name = candidate.place.get("body") or rig.forces[0].body
        fields["at"] = f" at {share * rig.body(body_name).length_m:.2f} m"
    return candidate.kind.words.format_map(fields)


def _strength_words(candidate: Candidate, parameter: Parameter, value: float, is_known: bool) -> str:
    """Value of a parameter, with its direction in words where it has one."""
    if parameter.name not in candidate.kind.signed_words:
        return _value_words(parameter, value) if is_known else UNKNOWN_STRENGTH
    negative, positive = candidate.kind.signed_words[parameter.name]
    return (
        f"{_value_words(parameter, abs(value))} {negative if value < 0 else positive}"
        if is_known
        else UNKNOWN_DIRECTION
    )


def _value_words(parameter: Parameter, value: float) -> str:
    if parameter.neutral == 1.0 and parameter.name == "factor":
        if not 1 / MULTIPLE_RATIO <= value <= MULTIPLE_RATIO:
            return f"{number(value, DIGITS)} times as large"
        return f"{number(100 * abs(value - 1), DIGITS)} % {'larger' if value > 1 else 'smaller'}"
    if parameter.unit == "1/min":
        return f"{number(100 * value, DIGITS)} % a minute"
    if parameter.unit in MILLI_UNITS and 0 < abs(value) < 1:
        return f"{number(1e3 * value, DIGITS)} m{parameter.unit}"
    return number(value, DIGITS) + ("" if parameter.unit == "1" else f" {printed_unit(parameter.unit)}")


MILLI_UNITS = ("m", "s")
"""Units that are stated in thousandths."""


def _place_words(field: str, place: str | None, rig: Rig) -> str:
    if field == "contact":
        return place or "all contacts"
    if field == "side":
        return str(place)
    if field == "sensor":
        return f"sensor {place or rig.sensors[-1].name}"
    return f"the {place}" if place else "all bodies"


def words_of(hypothesis: Hypothesis, rig: Rig) -> tuple[str, ...]:
    """Phrases of the effects of a hypothesis, with values and places."""
    return tuple(
        phrase(candidate, values, rig)
        for candidate, values in zip(hypothesis.candidates, hypothesis.split(), strict=True)
    )


LIMIT_MARGIN = 1e-3
"""Distance from the end of its range, as a share of the range, within which a parameter is at its limit."""


def unexplained_shares(misfit: Misfit, rig: Rig, p_value: float) -> UnexplainedShares:
    """Unexplained shares of a misfit, with its p-value and the largest deviation of a tolerance."""
    names = [c.name for c in joined(rig).contacts]
    return UnexplainedShares(
        share=misfit.share,
        contact_shares=dict(zip(names, misfit.contact_shares.tolist(), strict=True)),
        p_value=p_value,
        largest_pull=float(np.max(np.abs(misfit.pulls), initial=0.0)),
    )


def cause_of(
    weighted: WeightedHypothesis,
    all_weighted: Sequence[WeightedHypothesis],
    record: Record,
    null_reference: NullReference,
    matters: Matters,
) -> Cause:
    """Cause of gap.json: a hypothesis in words, its parameters, probability, explained share and what it leaves.

    Standard errors include model error: residuals were weighted by scales estimated from them.
    """
    validated, hypothesis = weighted.validated, weighted.validated.hypothesis
    parameters: dict[str, Value] = {}
    places: dict[str, str] = {}
    standard_errors = np.sqrt(np.maximum(np.diag(hypothesis.covariance), 0.0))
    words, first_column = [], 0
    for label, candidate in zip(labels_of(hypothesis.effects), hypothesis.candidates, strict=True):
        columns = slice(first_column, first_column + len(candidate.parameters))
        first_column = columns.stop
        values, errors = hypothesis.values[columns], standard_errors[columns]
        determined_change = identifiable_change(
            record.rig, candidate, values, hypothesis.covariance[columns, columns], record.highest_hz
        )
        words.append(phrase(candidate, values, record.rig, with_strength=not determined_change))
        for parameter, value, error in zip(candidate.parameters, values.tolist(), errors.tolist(), strict=True):
            margin = LIMIT_MARGIN * (parameter.high - parameter.low)
            limited = (
                value < parameter.low + margin and parameter.low != parameter.neutral
            ) or value > parameter.high - margin
            strength = parameter.neutral is not None
            parameters[f"{label}.{parameter.name}"] = Value(
                value, error, parameter.unit, limited, determined_change if strength else ""
            )
        places |= {f"{label}.{field}": place or "all" for field, place in candidate.place.items()}
    return Cause(
        effects=hypothesis.effects,
        words=tuple(words),
        strengths=strengths_of(hypothesis, all_weighted),
        probability=weighted.probability,
        parameters=parameters,
        places=places,
        explained=explained_share(validated.nominal_misfit, validated.misfit, matters),
        interval_95=explained_share_interval(validated.nominal_misfit, validated.misfit, matters),
        left=unexplained_shares(validated.misfit, validated.rig, p_value(null_reference, validated.misfit)),
        log_prior=validated.log_prior,
        minus_two_log=validated.misfit.minus_two_log,
    )


def bands_of(nominal: Misfit, corrected: Misfit, null_reference: NullReference) -> tuple[Band, ...]:
    """Unexplained shares by frequency band, with the nominal and the corrected rig and usual under the null."""
    return tuple(
        Band(low_hz=BAND_HZ * i, high_hz=BAND_HZ * (i + 1), before=float(b), after=float(a), usual=float(u))
        for i, (b, a, u) in enumerate(
            zip(nominal.shares, corrected.shares, null_reference.usual_shares(), strict=False)
        )
    )


def confirming_tests(causes: tuple[Cause, ...], ranked: list[ValidatedHypothesis]) -> tuple[str, ...]:
    """Tests that confirm or refute each effect of the causes that are likely or remove a part of the mismatch."""
    kinds = {candidate.kind.name: candidate.kind for j in ranked for candidate in j.hypothesis.candidates}
    likely = [c for i, c in enumerate(causes) if c.probability > RIVAL_PROBABILITY or (i == 0 and c.interval_95[0] > 0)]
    names = dict.fromkeys(effect for cause in likely for effect in cause.effects)
    return tuple(f"{name}: {kinds[name].separated_by}" for name in names)
