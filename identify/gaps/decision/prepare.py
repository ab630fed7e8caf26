"""Preparation and search: recordings of one rig with spectra and null references, and hypotheses that explain them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np

from identify.gaps.decision.null_reference import NullReference, null_reference_key, null_reference_of
from identify.gaps.decision.null_simulations import null_simulator
from identify.gaps.decision.recordings import ordered_recordings, without_faulty_channels
from identify.gaps.residual.likelihood import Misfit, NominalVariances, misfit, nominal_variances_of
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.candidates import Candidate, candidates, effect_range_scale
from identify.gaps.search.hypothesis import Hypothesis, Search
from identify.gaps.search.nominal import fit_nuisance
from identify.gaps.search.pooled import fitted_to_all_records
from identify.gaps.search.sparse import ranked_hypotheses
from rig.errors import RigError
from rig.model.description import Rig
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording
from rig.recording.interfaces import Predict, Simulate


@dataclass(frozen=True)
class Simulator:
    """Simulator of a rig under a measured force, its name, and a predictor from measured states, if there is one."""

    name: str
    simulate: Simulate
    predict: Predict | None = None


SIMULATORS, PREDICTORS = "identify.simulators", "identify.predictors"
"""Entry point groups under which packages offer simulators, and predictors from measured states."""
SelectCandidates = Callable[[list[Candidate], Rig], list[Candidate]]
DEFAULT_PREDICTOR_NAME = "modal"
"""Predictor for simulators whose package offers none of the same name."""


def simulator_named(name: str) -> Simulator:
    """Simulator that an installed package offers under this name; raises RigError if none does."""
    simulator_points = {entry_point.name: entry_point for entry_point in entry_points(group=SIMULATORS)}
    if name not in simulator_points:
        raise RigError(f"no simulator {name!r}; there are {', '.join(sorted(simulator_points))}")
    predictor_points = {entry_point.name: entry_point for entry_point in entry_points(group=PREDICTORS)}
    predictor_point = predictor_points.get(name) or predictor_points.get(DEFAULT_PREDICTOR_NAME)
    return Simulator(name, simulator_points[name].load(), predictor_point.load() if predictor_point else None)


@dataclass(frozen=True)
class PreparedRecording:
    """Recording with its spectra and the nominal variances in which hypotheses are compared on it."""

    recording: Recording
    record: Record
    nominal_variances: NominalVariances

    @property
    def force_rms_n(self) -> float:
        """Root mean square of all forces together, N; of a measured base of its acceleration, m/s^2."""
        return float(np.sqrt(np.sum(np.var(self.recording.forces_n, axis=1))))


@dataclass(frozen=True)
class PreparedRecordings:
    """Recordings of one rig in chronological order, each with the null reference of its level and length.

    The one at validation_index is not fitted. simulate makes recordings of that rig under a force, or of its free
    decay where no force was measured; predict runs it from measured states.
    """

    observations: tuple[PreparedRecording, ...]
    validation_index: int
    channel_faults: dict[str, str]
    simulate: Simulate
    predict: Predict | None
    null_references: tuple[NullReference, ...]

    @property
    def null_reference(self) -> NullReference:
        """Null reference of the validation record."""
        return self.null_references[self.validation_index]

    @property
    def validation_recording(self) -> PreparedRecording:
        return self.observations[self.validation_index]

    @property
    def fitted_recordings(self) -> tuple[PreparedRecording, ...]:
        index = self.validation_index
        return self.observations[:index] + self.observations[index + 1 :]

    @property
    def searched_recording(self) -> PreparedRecording:
        """Fitted recording of the strongest force, on which effects are searched."""
        return max(self.fitted_recordings, key=lambda observation: observation.force_rms_n)

    @property
    def fits_several_records(self) -> bool:
        """True if more than one recording is fitted."""
        return len(self.observations) > 2

    @property
    def record_titles(self) -> tuple[str, ...]:
        return tuple(
            f"{index + 1}, {observation.force_rms_n:.3g} {'m/s²' if observation.record.base else 'N'}"
            + ", validates" * (index == self.validation_index)
            for index, observation in enumerate(self.observations)
        )


def prepare_recordings(
    recordings: Recording | Sequence[Recording],
    validation: Recording | None,
    simulator: Simulator,
    null_reference_path: Path | None,
    tolerances: Tolerances | None,
    progress: Callable[[float], None] = lambda _: None,
) -> PreparedRecordings:
    """Recordings without faulty channels, their spectra, and the null reference of each.

    Tolerances default to those of the rig, then to a laboratory's. Raises RigError if the recordings do not fit
    together or allow no diagnosis.
    """
    ordered, validation_index = ordered_recordings(recordings, validation)
    tolerances = tolerances or ordered[0].rig.tolerances or LABORATORY
    ordered, channel_faults = without_faulty_channels(*ordered)
    observations = tuple(prepare_recording(recording, tolerances) for recording in ordered)
    simulators = [null_simulator(prepared.recording, prepared.record, simulator.simulate) for prepared in observations]
    null_keys = [
        null_reference_key(prepared.recording, prepared.record.counted_part, tolerances, simulator.name)
        for prepared in observations
    ]
    reference_by_key: dict[str, NullReference] = {}
    first_indices = {key: index for index, key in reversed(list(enumerate(null_keys)))}
    for key_number, (key, index) in enumerate(first_indices.items()):

        def report(share: float, key_number: int = key_number) -> None:
            progress((key_number + share) / len(first_indices))

        reference_by_key[key] = null_reference_of(
            observations[index].recording,
            tolerances,
            simulators[index],
            simulator.name,
            report,
            null_reference_path,
            predict=simulator.predict,
        )
    return PreparedRecordings(
        observations,
        validation_index,
        channel_faults,
        simulators[validation_index],
        simulator.predict,
        tuple(reference_by_key[key] for key in null_keys),
    )


def prepare_recording(recording: Recording, tolerances: Tolerances) -> PreparedRecording:
    """Spectra and nominal variances of a recording."""
    record = record_of(recording, tolerances=tolerances)
    return PreparedRecording(recording, record, nominal_variances_of(linearized(record, record.rig)))


@dataclass(frozen=True)
class SearchResult:
    """Hypotheses, the nominal rig among them, and the candidates from which they were selected.

    nominal_misfit is that of the nominal rig on the searched record.
    """

    hypotheses: tuple[Hypothesis, ...]
    candidates: tuple[Candidate, ...]
    nominal_misfit: Misfit


def search(
    prepared: PreparedRecordings,
    progress: Callable[[float], None] = lambda _: None,
    select_candidates: SelectCandidates | None = None,
) -> SearchResult:
    """Hypotheses that explain most of the record of the strongest force; of several fitted records, with shared
    parameters. `select_candidates` takes those of the library's candidates that a rig's records show."""
    strongest, search_share = prepared.searched_recording, 0.6 if prepared.fits_several_records else 1.0
    result = search_record(
        strongest.record, strongest.nominal_variances, lambda share: progress(search_share * share), select_candidates
    )
    if not prepared.fits_several_records:
        return result
    records = [observation.record for observation in prepared.fitted_recordings]
    variances_by_record = [observation.nominal_variances for observation in prepared.fitted_recordings]
    hypotheses = (fitted_to_all_records(records, variances_by_record, hypothesis) for hypothesis in result.hypotheses)
    return replace(result, hypotheses=tuple(hypotheses))


def search_record(
    record: Record,
    nominal_variances: NominalVariances,
    progress: Callable[[float], None] = lambda _: None,
    select_candidates: SelectCandidates | None = None,
) -> SearchResult:
    """Hypotheses from the search on one record, and its candidates."""
    linearization, residual = fit_nuisance(record, record.rig)
    library = candidates(
        effect_range_scale(record, record.rig), record.channel_names, record.zero_known, record.has_force
    )
    library = select_candidates(library, record.rig) if select_candidates else library
    hypotheses = ranked_hypotheses(Search(nominal_variances, linearization, residual, tuple(library)), progress)
    return SearchResult(tuple(hypotheses), tuple(library), misfit(record, nominal_variances, residual))
