"""Rings of a rig in space in its diagnosis: what moves them as effects, and their values by the contact fit.

A ring's clearance, stiffness and damping come from the fit that `identify contact` makes, on the folded rig of each
hypothesis (`residual.unfolding`). The linear residual holds nothing of them, as its contact forces are free.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from msgspec.structs import replace as with_numbers

from identify.contacts.annular_estimate import AnnularEstimate
from identify.contacts.annular_law import CLEARANCE, DAMPING, STIFFNESS
from identify.contacts.law_form import DAMPING_GRADIENT, LAW, STIFFNESS_GRADIENT
from identify.contacts.refusals import ContactRefusedError
from identify.contacts.space_contacts import space_contacts
from identify.gaps.decision.bounds import ContactParameterDistances, contact_parameter_distances
from identify.gaps.decision.comparison import ValidatedHypothesis, log_priors, nominal_hypothesis_of, probabilities
from identify.gaps.decision.contact_evidence import CONTACT_EFFECTS, hypothesis_with_contact_effects, with_contact_cost
from identify.gaps.decision.prepare import PreparedRecording, PreparedRecordings
from identify.gaps.decision.verdict import RIVAL_PROBABILITY
from identify.gaps.residual.unfolding import IN_Z, Unfolding, with_rig
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.contact_laws import LawEstimate, LawOutcomes
from rig.errors import RigError
from rig.model.description import Rig, to_json
from rig.model.tolerances import Tolerances
from rig.recording import Recording

SHARED_FIELDS = ("bodies", "masses", "supports", "clamps", "contacts")
"""Fields of a rig for what both directions share."""
RING_GRADIENTS = (
    LAW.vector({"lower_clearance_m": 0.5, "upper_clearance_m": 0.5}),
    STIFFNESS_GRADIENT,
    DAMPING_GRADIENT,
)
"""Clearance, stiffness and damping of a ring as linear functions of the law of its dead zone."""


@dataclass(frozen=True)
class RingFit:
    """Contact fit of a record of an unfolded rig, by the tolerances of the rig in space."""

    unfolding: Unfolding
    tolerances: Tolerances
    outcomes_by_rig: dict[tuple[int, bytes], LawOutcomes] = field(default_factory=dict)

    def __call__(self, recording: Recording, rig: Rig, _: Tolerances) -> LawOutcomes:
        """Estimates of the rings that a record determines with the linear model of `rig`, and why not the others."""
        folded_rig = self.unfolding.space_rig_of(rig)
        nominal_laws = [contact.law for contact in self.unfolding.space_rig.contacts]
        contacts = (with_numbers(c, law=law) for c, law in zip(folded_rig.contacts, nominal_laws, strict=True))
        folded_rig = with_numbers(folded_rig, contacts=tuple(contacts), tones=())
        cache_key = id(recording), to_json(folded_rig)
        if cache_key not in self.outcomes_by_rig:
            self.outcomes_by_rig[cache_key] = self._outcomes_of(with_rig(recording, folded_rig))
        return self.outcomes_by_rig[cache_key]

    def _outcomes_of(self, recording: Recording) -> LawOutcomes:
        try:
            contacts = space_contacts(recording, "auto", self.tolerances)
        except ContactRefusedError as error:
            return LawOutcomes((), {contact.name: error.refusal for contact in recording.rig.contacts})
        except RigError:
            return LawOutcomes()
        return LawOutcomes(
            tuple(_law_estimate(name, estimate) for name, estimate in contacts.annular.items()), contacts.refusals
        )


def _law_estimate(contact_name: str, estimate: AnnularEstimate) -> LawEstimate:
    fitted_indices = [CLEARANCE, STIFFNESS, DAMPING]
    return LawEstimate(
        contact_name,
        np.array(RING_GRADIENTS),
        estimate.values[fitted_indices],
        estimate.covariance[np.ix_(fitted_indices, fitted_indices)],
        estimate.covariances["tolerances"][np.ix_(fitted_indices, fitted_indices)],
    )


def candidates_in_linear_residual(library_candidates: list[Candidate], rig: Rig) -> list[Candidate]:
    """Candidates that the linear residual of an unfolded rig shows, those on what both directions share with their
    twin."""
    linear = []
    for candidate in _with_places_in_both_directions(library_candidates, rig):
        changed_rig = candidate.applied(rig, candidate.typical_values)
        same_laws = all(c.law == n.law for c, n in zip(changed_rig.contacts, rig.contacts, strict=True))
        if same_laws and changed_rig.loads == rig.loads and changed_rig.base_motion == rig.base_motion:
            linear.append(candidate)
    return linear


def ring_contact_candidates(library_candidates: list[Candidate], rig: Rig) -> list[Candidate]:
    """Candidates that the contact fit of single rings shows."""
    return [
        candidate
        for candidate in _with_places_in_both_directions(library_candidates, rig)
        if candidate.kind.name in CONTACT_EFFECTS
    ]


def _with_places_in_both_directions(library_candidates: list[Candidate], rig: Rig) -> list[Candidate]:
    """Candidates on one direction or the whole rig, and on bodies and contacts of both with their twin's place."""
    with_twins = []
    for candidate in library_candidates:
        changed_rig = candidate.applied(rig, candidate.typical_values)
        is_shared = any(getattr(changed_rig, name) != getattr(rig, name) for name in SHARED_FIELDS)
        if not (candidate.place and is_shared):
            with_twins.append(candidate)
            continue
        places = {name: place for name, place in candidate.place.items() if name in ("body", "beam", "contact")}
        if places and all(place and not place.endswith(IN_Z) for place in places.values()):
            twin_place = {**candidate.place, **{name: f"{place}{IN_Z}" for name, place in places.items()}}
            with_twins.append(replace(candidate, twin_place=twin_place))
    return with_twins


def ring_parameter_distances(
    observations: Sequence[PreparedRecording], rig: Rig, ring_fit: RingFit
) -> ContactParameterDistances:
    """Distances of the rings' parameters from those of an unfolded rig, by the contact fit pooled over the records."""
    rings = tuple(contact for contact in rig.contacts if not contact.name.endswith(IN_Z))
    recordings, tolerances = [observation.recording for observation in observations], ring_fit.tolerances

    def outcomes_of(recording: Recording, _: Rig, __: Tolerances) -> LawOutcomes:
        return ring_fit(recording, rig, tolerances)

    return contact_parameter_distances(recordings, with_numbers(rig, contacts=rings), tolerances, outcomes_of)


def with_ring_fits(
    prepared: PreparedRecordings,
    all_candidates: Sequence[Candidate],
    ranked_hypotheses: Sequence[ValidatedHypothesis],
    ring_fit: RingFit,
) -> list[ValidatedHypothesis]:
    """Hypotheses with -2 ln p of the rings by the contact fit on their own linear model, and each with effects on the
    parameters that this fit puts more than `CHANCE_PULL` standard deviations off; the likeliest first.

    Hypotheses less likely than `RIVAL_PROBABILITY` by the linear residual are left out, but for the nominal rig.
    """
    record, nominal = prepared.validation_recording.record, nominal_hypothesis_of(ranked_hypotheses)
    linear_probabilities = probabilities(np.array([validated.log_posterior for validated in ranked_hypotheses]))
    hypotheses_with_rings = []
    for validated, probability in zip(ranked_hypotheses, linear_probabilities, strict=True):
        if probability > RIVAL_PROBABILITY or validated is nominal:
            estimates = ring_parameter_distances(prepared.observations, validated.rig, ring_fit).law_estimates
            hypotheses_with_rings.append(with_contact_cost(validated, estimates, record))
            fitted = hypothesis_with_contact_effects(
                prepared, all_candidates, estimates, validated.hypothesis, ring_fit
            )
            if fitted:
                prior, rig = log_priors([fitted], all_candidates)[fitted.effect_names], fitted.applied_to(record.rig)
                variant = replace(validated, hypothesis=fitted, rig=rig, log_prior=prior)
                hypotheses_with_rings.append(with_contact_cost(variant, estimates, record))
    return sorted(hypotheses_with_rings, key=lambda validated: -validated.log_posterior)
