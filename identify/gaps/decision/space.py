"""Diagnosis of a rig in space: effects from the linear residual of both directions, rings by the contact fit.

Notes for maintainers
1. The records are those of the unfolded rig (`residual.unfolding`), whose contact forces no law is asked for
   (`free_contact_tolerances`). Search, fits, null reference and decision are those of a plane rig; simulations are in
   space, by the folded rig.
2. A ring's clearance, stiffness and damping come from the contact fit of `identify contact`, on the folded rig of each
   hypothesis. Their distances from rig.json decide as those of a plane rig's contacts do, and those that are off are
   effects beside the hypothesis (`with_ring_fits`).
3. Neither is the motion predicted, so that nothing vetoes, nor an unmeasured force looked for.
"""

import hashlib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace as with_numbers

from identify.gaps.decision.answer import DEFAULT_MATTERS, describe
from identify.gaps.decision.bounds import NominalDifference, share_bounds
from identify.gaps.decision.comparison import split_likelihood_ratio_p_value, with_model_averaged_covariance
from identify.gaps.decision.judge import Judgement, UnmeasuredCauses, nominal_misfits_of, validated_hypotheses
from identify.gaps.decision.notes import Attempt
from identify.gaps.decision.null_reference import combined_p_value, p_value_combined_with_bound, p_values
from identify.gaps.decision.predicted import PredictionCheckedDecision
from identify.gaps.decision.prepare import PreparedRecordings, SearchResult, Simulator, prepare_recordings, search
from identify.gaps.decision.rings import (
    RingFit,
    candidates_in_linear_residual,
    ring_contact_candidates,
    ring_parameter_distances,
    with_ring_fits,
)
from identify.gaps.decision.sentence import sentence
from identify.gaps.decision.verdict import Decision, decide
from identify.gaps.decision_table import USUAL_P_VALUE
from identify.gaps.residual.residual import SearchCache
from identify.gaps.residual.unfolding import (
    IN_Z,
    Unfolding,
    check_unfolds,
    free_contact_tolerances,
    transverse_station_indices,
)
from identify.gaps.results import FailedAnalysis, Gap, Matters, UnexplainedShares
from identify.gaps.search.candidates import candidates, effect_range_scale
from identify.gaps.search.nominal import fit_nuisance
from rig.errors import RigError
from rig.model.description import Rig, to_json
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording
from rig.recording.interfaces import Simulate

PLANE_ALONE_REASON = "made for rigs that move in one direction alone"
NO_FRICTION_REASON = "no tolerance states it; identify contact gives it with its interval"


@dataclass(frozen=True)
class SpaceSimulator:
    """Simulator of unfolded rigs, by that of rigs in space, whose sensors show shares of the motion across."""

    unfolding: Unfolding
    simulate: Simulate
    tolerances: Tolerances

    def __call__(self, _: Rig, actual_rig: Rig, forces_n: Float[np.ndarray, "forces samples"], seed: int) -> Recording:
        simulated = self.simulate(self.unfolding.space_rig, self.unfolding.space_rig_of(actual_rig), forces_n, seed)
        return self._with_cross_axis_sensitivity(
            self.unfolding.unfolded_recording(simulated), np.random.default_rng([seed, 80])
        )

    def _with_cross_axis_sensitivity(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """Recording whose sensors show random shares, within `cross_axis`, of what those across show."""
        signals = dict(recording.signals)
        for quantity in dict.fromkeys(sensor.quantity for sensor in recording.rig.sensors):
            sensors = [sensor for sensor in recording.rig.sensors if sensor.quantity == quantity]
            mixing = np.eye(len(sensors))
            for row, across in transverse_station_indices([sensor.station for sensor in sensors]).items():
                mixing[row, across] = self.tolerances.of_sensor(sensors[row].name).cross_axis * rng.standard_normal()
            signals[quantity] = replace(signals[quantity], values=mixing @ signals[quantity].values)
        return replace(recording, signals=signals)


def diagnose_in_space(
    recordings: Sequence[Recording],
    validation: Recording | None,
    simulator: Simulator,
    null_reference_path: Path | None = None,
    progress: Callable[[str, float], None] = lambda *_: None,
    tolerances: Tolerances | None = None,
    matters: Matters = DEFAULT_MATTERS,
    ask_next: bool = False,
) -> tuple[Gap, Rig]:
    """Diagnosis of recordings of a rig in space, and the corrected rig, as `answer.diagnose`.

    Raises RigError if the rig does not unfold, the records do not fit together or allow no diagnosis, or if the next
    experiment is asked for.
    """
    space_rig = recordings[0].rig
    check_unfolds(space_rig)
    if ask_next:
        raise RigError("next experiments are proposed for rigs that move in one direction; leave --next-experiment out")
    if not all(np.any(recording.forces_n) for recording in (*recordings, *([validation] if validation else []))):
        raise RigError(f"rig {space_rig.name!r} moves in two directions: identify gap needs the measured force there")
    unfolding = Unfolding(space_rig)
    space_tolerances = tolerances or space_rig.tolerances or LABORATORY
    unfolded_recordings = [unfolding.unfolded_recording(recording) for recording in recordings]
    held_back = next((u for u, r in zip(unfolded_recordings, recordings, strict=True) if r is validation), None)
    if validation is not None and held_back is None:
        held_back = unfolding.unfolded_recording(validation)
    rig_key = hashlib.sha256(to_json(space_rig)).hexdigest()[:16]
    simulate = SpaceSimulator(unfolding, simulator.simulate, space_tolerances)
    prepared = prepare_recordings(
        unfolded_recordings,
        held_back,
        Simulator(f"{simulator.name} in space {rig_key}", simulate),
        null_reference_path,
        free_contact_tolerances(space_tolerances),
        lambda done_share: progress("null_reference", done_share),
    )
    search_result = search(
        prepared, lambda done_share: progress("causes", 0.7 * done_share), candidates_in_linear_residual
    )
    judgement = _judge(prepared, search_result, RingFit(unfolding, space_tolerances), matters)
    progress("causes", 0.9)
    decision = judgement.decision
    gap = _answer_in_space(describe(prepared, search_result, judgement, matters))
    progress("causes", 1.0)
    corrected = decision.corrects_rig and decision.named_hypothesis
    return gap, unfolding.space_rig_of(corrected.rig) if corrected else space_rig


def _answer_in_space(gap: Gap) -> Gap:
    """Answer of an unfolded rig as one of the rig in space: stations by its bodies, and no unexplained shares of the
    contact forces, which no law was asked for."""

    def without_contact_shares(shares: UnexplainedShares) -> UnexplainedShares:
        return with_numbers(shares, contact_shares={})

    positions_m: dict[str, Counter[float]] = {}
    for body, share_by_position in gap.attribution.positions_m.items():
        positions_m.setdefault(body.removesuffix(IN_Z), Counter()).update(share_by_position)
    gap = with_numbers(
        gap,
        before=without_contact_shares(gap.before),
        after=without_contact_shares(gap.after),
        causes=tuple(with_numbers(cause, left=without_contact_shares(cause.left)) for cause in gap.causes),
        attribution=with_numbers(gap.attribution, positions_m={body: dict(c) for body, c in positions_m.items()}),
    )
    return with_numbers(gap, sentence=sentence(gap))


def _judge(prepared: PreparedRecordings, search_result: SearchResult, ring_fit: RingFit, matters: Matters) -> Judgement:
    """Judge the difference and every hypothesis on the validation record, with the rings of all records."""
    record = prepared.validation_recording.record
    linearization, residual = fit_nuisance(record, record.rig)
    linearization = replace(linearization, cache=SearchCache(record))
    library = candidates(
        effect_range_scale(record, record.rig), record.channel_names, record.zero_known, record.has_force
    )
    ring_effects = ring_contact_candidates(library, record.rig)
    all_candidates = [*search_result.candidates, *ring_effects]
    ranked = validated_hypotheses(prepared, search_result.hypotheses, all_candidates, residual)
    nominal_misfits = nominal_misfits_of(prepared, search_result.nominal_misfit, residual)
    record_p_values = p_values(prepared.null_references, nominal_misfits)
    distances_of_rings = ring_parameter_distances(prepared.observations, record.rig, ring_fit)
    difference = NominalDifference(
        p_value_combined_with_bound(
            combined_p_value(np.append(record_p_values, distances_of_rings.p_values)),
            split_likelihood_ratio_p_value(ranked),
        ),
        share_bounds(nominal_misfits[prepared.validation_index], (), matters)[0],
        contact_bounds=(),
        parameter_bounds=distances_of_rings.parameter_bounds,
    )
    ranked = with_model_averaged_covariance(with_ring_fits(prepared, all_candidates, ranked, ring_fit))
    decision = _with_remaining_ring_distances(
        decide(ranked, difference, prepared.null_reference, matters), prepared, ring_fit
    )
    prediction = PredictionCheckedDecision(
        ranked, decision, Attempt(None, (FailedAnalysis("rollout", PLANE_ALONE_REASON),))
    )
    notes = [FailedAnalysis("unmeasured_force", PLANE_ALONE_REASON)]
    notes += [FailedAnalysis("ring_friction", NO_FRICTION_REASON)] * bool(ring_effects)
    unmeasured = UnmeasuredCauses(notes=tuple(notes))
    return Judgement(decision, prediction, unmeasured, linearization, residual)


def _with_remaining_ring_distances(decision: Decision, prepared: PreparedRecordings, ring_fit: RingFit) -> Decision:
    """Decision whose evidence after correction holds the distances of the rings from the named set, too."""
    chosen, validation = decision.named_hypothesis or decision.nominal_hypothesis, prepared.validation_recording
    distances = ring_parameter_distances(prepared.observations, chosen.rig, ring_fit)
    remaining_p_values = p_values([prepared.null_reference], [chosen.misfit])
    held_back_p_values = ring_parameter_distances([validation], validation.record.rig, ring_fit).p_values
    rings_show = bool(held_back_p_values) and combined_p_value(np.array(held_back_p_values)) < USUAL_P_VALUE
    evidence = with_numbers(
        decision.evidence,
        held_back_shows=decision.evidence.held_back_shows or rings_show,
        p_value_after=combined_p_value(np.append(remaining_p_values, distances.p_values)),
        quantities_after=(*decision.evidence.quantities_after, *distances.parameter_bounds),
    )
    return replace(decision, evidence=evidence)
