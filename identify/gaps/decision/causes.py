"""Causes in gap.json: effects in words ("an added mass of 150 ± 12 g on the barrel at 1.000 ± 0.013 m"), with
parameters and shares."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from identify.gaps.decision.comparison import ValidatedHypothesis, explained_share, explained_share_interval
from identify.gaps.decision.modal_changes import identifiable_change_words
from identify.gaps.decision.null_reference import NullReference, p_value
from identify.gaps.decision.verdict import RIVAL_PROBABILITY, WeightedHypothesis, strengths_of
from identify.gaps.residual.likelihood import Misfit
from identify.gaps.residual.record import Record
from identify.gaps.residual.scales import BAND_WIDTH_HZ
from identify.gaps.results import Band, Cause, Matters, UnexplainedShares, unique_effect_labels
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.hypothesis import Hypothesis
from identify.linear.joined import rig_with_joined_contacts
from identify.pages.wording import estimate_words
from rig.model.description import Rig
from rig.model.parameters import Parameter
from rig.model.unmeasured_force import Value

LEAST_MULTIPLE = 2.0
"""Ratio from which a factor is stated as a multiple; nearer to one, it is larger or smaller by per cent."""
UNKNOWN_STRENGTH_WORDS = "unknown strength"


def phrase(
    candidate: Candidate,
    effect_values: Float[np.ndarray, " parameters"],
    rig: Rig,
    with_strength: bool = True,
    standard_errors: Float[np.ndarray, " parameters"] | None = None,
) -> str:
    """Phrase for an effect with its values in a rig, without its strength where that is not determined; with 95 %
    intervals where standard errors are given."""
    errors = np.zeros(len(effect_values)) if standard_errors is None else standard_errors
    words_by_field = {
        parameter.name: _strength_words(candidate, parameter, value, error, with_strength or parameter.neutral is None)
        for parameter, value, error in zip(candidate.parameters, effect_values.tolist(), errors.tolist(), strict=True)
    }
    words_by_field |= {field: _place_words(field, place, rig) for field, place in candidate.place.items()}
    for field in candidate.typical_effect.__struct_fields__:
        words_by_field.setdefault(field, str(getattr(candidate.typical_effect, field)))
    words_by_field["at"] = ""
    if "relative_position" in candidate.parameters.names:
        index = candidate.parameters.names.index("relative_position")
        length_m = rig.body(candidate.place.get("body") or rig.first_driven_body).length_m
        position_m, position_error_m = length_m * float(effect_values[index]), length_m * float(errors[index])
        words_by_field["at"] = f" at {estimate_words(position_m, position_error_m, 'm', f'{position_m:.2f} m')}"
    return candidate.kind.words.format_map(words_by_field)


def _strength_words(
    candidate: Candidate, parameter: Parameter, value: float, standard_error: float, is_known: bool
) -> str:
    """Value of a parameter, with its direction in words where it has one."""
    if parameter.name not in candidate.kind.signed_words:
        return _value_words(parameter, value, standard_error) if is_known else UNKNOWN_STRENGTH_WORDS
    negative, positive, undetermined = candidate.kind.signed_words[parameter.name]
    direction = negative if value < 0 else positive
    return f"{_value_words(parameter, abs(value), standard_error)} {direction}" if is_known else undetermined


def _value_words(parameter: Parameter, value: float, standard_error: float) -> str:
    if parameter.neutral == 1.0 and parameter.name == "factor":
        if not 1 / LEAST_MULTIPLE <= value <= LEAST_MULTIPLE:
            return f"{estimate_words(value, standard_error, '1')} times as large"
        change_words = estimate_words(100 * abs(value - 1), 100 * standard_error, "%")
        return f"{change_words} {'larger' if value > 1 else 'smaller'}"
    if parameter.unit == "1/min":
        return f"{estimate_words(100 * value, 100 * standard_error, '%')} a minute"
    if parameter.unit in MILLI_UNITS and 0 < abs(value) < 1:
        return estimate_words(1e3 * value, 1e3 * standard_error, MILLI_UNITS[parameter.unit])
    return estimate_words(value, standard_error, parameter.unit)


MILLI_UNITS = {"m": "mm", "s": "ms", "kg": "g"}
"""Units of values below one that are stated in thousandths."""


def _place_words(field: str, place: str | None, rig: Rig) -> str:
    if field == "contact":
        return place or "all contacts"
    if field == "side":
        return str(place)
    if field == "sensor":
        return f"sensor {place or rig.sensors[-1].name}"
    return f"the {place}" if place else "all bodies"


def effect_phrases(hypothesis: Hypothesis, rig: Rig) -> tuple[str, ...]:
    """Phrases of the effects of a hypothesis, with values and places."""
    effects = zip(hypothesis.candidates, hypothesis.values_by_candidate(), strict=True)
    return tuple(phrase(candidate, values, rig) for candidate, values in effects)


LIMIT_MARGIN_SHARE = 1e-3
"""Distance from the end of its range, as a share of the range, within which a parameter is at its limit."""


def is_at_limit(parameter: Parameter, parameter_value: float) -> bool:
    """True if the true value may lie beyond the range: at an end that is neither neutral nor the end of a body."""
    margin = LIMIT_MARGIN_SHARE * (parameter.high - parameter.low)
    is_at_low_end = parameter_value < parameter.low + margin and parameter.low != parameter.neutral
    return parameter.name != "relative_position" and (is_at_low_end or parameter_value > parameter.high - margin)


def unexplained_shares(misfit: Misfit, rig: Rig, null_reference: NullReference) -> UnexplainedShares:
    """Unexplained shares of a misfit of the validation record, its p-value and the largest deviation of a tolerance."""
    contact_names = [contact.name for contact in rig_with_joined_contacts(rig).contacts]
    return UnexplainedShares(
        share=misfit.unexplained_share,
        contact_shares=dict(zip(contact_names, misfit.unexplained_contact_shares.tolist(), strict=True)),
        p_value=p_value(null_reference, misfit),
        largest_pull=float(np.max(np.abs(misfit.pulls), initial=0.0)),
    )


def cause_of(
    weighted: WeightedHypothesis,
    weighted_hypotheses: Sequence[WeightedHypothesis],
    record: Record,
    null_reference: NullReference,
    matters: Matters,
) -> Cause:
    """Cause of gap.json: a hypothesis in words, its parameters, probability, explained share and what it leaves.

    Standard errors include model error: residuals were weighted by scales estimated from them.
    """
    validated, hypothesis = weighted.validated, weighted.validated.hypothesis
    misfit_pair = validated.nominal_misfit, validated.misfit
    parameters: dict[str, Value] = {}
    places: dict[str, str] = {}
    standard_errors = np.sqrt(np.maximum(np.diag(hypothesis.covariance), 0.0))
    words, stop = [], 0
    for label, candidate in zip(unique_effect_labels(hypothesis.effects), hypothesis.candidates, strict=True):
        column_slice = slice(stop, stop := stop + len(candidate.parameters))
        values, covariance = hypothesis.values[column_slice], hypothesis.covariance[column_slice, column_slice]
        change_words = identifiable_change_words(record.rig, candidate, values, covariance, record.highest_hz)
        errors = standard_errors[column_slice]
        words.append(phrase(candidate, values, record.rig, not change_words, errors))
        for parameter, value, standard_error in zip(
            candidate.parameters, values.tolist(), errors.tolist(), strict=True
        ):
            parameters[f"{label}.{parameter.name}"] = Value(
                value,
                standard_error,
                parameter.unit,
                is_at_limit(parameter, value),
                "" if parameter.neutral is None else change_words,
            )
        places |= {f"{label}.{field}": place or "all" for field, place in candidate.place.items()}
    return Cause(
        effects=hypothesis.effects,
        words=tuple(words),
        strengths=strengths_of(hypothesis, weighted_hypotheses),
        probability=weighted.probability,
        parameters=parameters,
        places=places,
        explained=explained_share(*misfit_pair, matters),
        interval_95=explained_share_interval(*misfit_pair, matters),
        left=unexplained_shares(validated.misfit, validated.rig, null_reference),
        log_prior=validated.log_prior,
        minus_two_log=validated.misfit.minus_two_log,
    )


def unexplained_bands(
    nominal_misfit: Misfit, corrected_misfit: Misfit, null_reference: NullReference
) -> tuple[Band, ...]:
    """Unexplained shares by frequency band, with the nominal and the corrected rig and usual under the null."""
    shares_by_band = zip(
        nominal_misfit.share_by_band,
        corrected_misfit.share_by_band,
        null_reference.null_share_upper_limits(),
        np.sqrt(nominal_misfit.power_by_band / max(nominal_misfit.power_by_band.sum(), 1e-300)),
        strict=False,
    )
    return tuple(
        Band(
            low_hz=BAND_WIDTH_HZ * band_index,
            high_hz=BAND_WIDTH_HZ * (band_index + 1),
            before=float(before),
            after=float(after),
            usual=float(usual),
            motion_share=float(motion_share),
        )
        for band_index, (before, after, usual, motion_share) in enumerate(shares_by_band)
    )


def confirming_tests(causes: tuple[Cause, ...], ranked_hypotheses: list[ValidatedHypothesis]) -> tuple[str, ...]:
    """Tests that confirm or refute each effect of the causes that are likely or remove a part of the mismatch."""
    kinds_by_name = {
        candidate.kind.name: candidate.kind
        for validated in ranked_hypotheses
        for candidate in validated.hypothesis.candidates
    }
    likely_causes = [
        cause
        for cause_index, cause in enumerate(causes)
        if cause.probability > RIVAL_PROBABILITY or (cause_index == 0 and cause.interval_95[0] > 0)
    ]
    effect_names = dict.fromkeys(effect for cause in likely_causes for effect in cause.effects)
    return tuple(f"{name}: {kinds_by_name[name].separating_test}" for name in effect_names)
