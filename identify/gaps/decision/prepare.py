"""Preparation and search: recordings of one rig with spectra and null references, and hypotheses that explain them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np

from identify.gaps.decision.null_reference import NullReference, null_key, null_reference_of
from identify.gaps.decision.null_simulations import null_simulator
from identify.gaps.decision.recordings import ordered_recordings, without_faulty_channels
from identify.gaps.residual.likelihood import Misfit, NominalVariances, misfit, nominal_variances_of
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.candidates import Candidate, candidates, scale_of
from identify.gaps.search.hypothesis import Hypothesis, Search
from identify.gaps.search.nominal import fit_nuisance
from identify.gaps.search.pooled import fitted_together
from identify.gaps.search.sparse import ranked_hypotheses
from rig.errors import RigError
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
PREDICTOR = "modal"
"""Predictor for simulators whose package offers none of the same name."""


def simulator_named(name: str) -> Simulator:
    """Simulator that an installed package offers under this name; raises RigError if none does."""
    offered = {point.name: point for point in entry_points(group=SIMULATORS)}
    if name not in offered:
        raise RigError(f"no simulator {name!r}; there are {', '.join(sorted(offered))}")
    predictors = {point.name: point for point in entry_points(group=PREDICTORS)}
    predictor = predictors.get(name) or predictors.get(PREDICTOR)
    return Simulator(name, offered[name].load(), predictor.load() if predictor else None)


@dataclass(frozen=True)
class PreparedRecording:
    """Recording with its spectra and the nominal variances in which hypotheses are compared on it."""

    recording: Recording
    record: Record
    nominal_variances: NominalVariances

    @property
    def force_rms_n(self) -> float:
        """Root mean square of all forces together, N."""
        return float(np.sqrt(np.sum(np.var(self.recording.forces_n, axis=1))))


@dataclass(frozen=True)
class Prepared:
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
    def validation(self) -> PreparedRecording:
        return self.observations[self.validation_index]

    @property
    def fitted(self) -> tuple[PreparedRecording, ...]:
        return tuple(observation for k, observation in enumerate(self.observations) if k != self.validation_index)

    @property
    def searched(self) -> PreparedRecording:
        """Fitted recording of the strongest force, on which effects are searched."""
        return max(self.fitted, key=lambda observation: observation.force_rms_n)

    @property
    def fits_several(self) -> bool:
        """True if more than one recording is fitted."""
        return len(self.observations) > 2

    @property
    def titles(self) -> tuple[str, ...]:
        return tuple(
            f"{k + 1}, {observation.force_rms_n:.3g} N{', validates' * (k == self.validation_index)}"
            for k, observation in enumerate(self.observations)
        )


def prepare(
    recordings: Recording | Sequence[Recording],
    validation: Recording | None,
    simulator: Simulator,
    null_reference_path: Path | None,
    tolerances: Tolerances | None,
    progress: Callable[[float], None] = lambda _: None,
) -> Prepared:
    """Recordings without faulty channels, their spectra, and the null reference of each.

    Tolerances default to those of the rig, then to a laboratory's. Raises RigError if the recordings do not fit
    together or allow no diagnosis.
    """
    ordered, validating = ordered_recordings(recordings, validation)
    rig_tolerances = tolerances or ordered[0].rig.tolerances or LABORATORY
    ordered, channel_faults = without_faulty_channels(*ordered)
    observations = tuple(prepare_recording(recording, rig_tolerances) for recording in ordered)
    simulate_functions = [null_simulator(o.recording, o.record, simulator.simulate) for o in observations]
    keys = [
        null_key(observation.recording, observation.record.counted, rig_tolerances, simulator.name)
        for observation in observations
    ]
    references_by_key: dict[str, NullReference] = {}
    first_indices = {key: index for index, key in reversed(list(enumerate(keys)))}
    for number, (key, index) in enumerate(first_indices.items()):

        def report(share: float, number: int = number) -> None:
            progress((number + share) / len(first_indices))

        recording, simulate = observations[index].recording, simulate_functions[index]
        references_by_key[key] = null_reference_of(
            recording, rig_tolerances, simulate, simulator.name, report, null_reference_path, predict=simulator.predict
        )
    references = tuple(references_by_key[key] for key in keys)
    return Prepared(
        observations, validating, channel_faults, simulate_functions[validating], simulator.predict, references
    )


def prepare_recording(recording: Recording, tolerances: Tolerances) -> PreparedRecording:
    """Spectra and nominal variances of a recording."""
    record = record_of(recording, tolerances=tolerances)
    return PreparedRecording(recording, record, nominal_variances_of(linearized(record, record.rig)))


@dataclass(frozen=True)
class Searched:
    """Hypotheses, the nominal rig among them, and the candidates from which they were selected.

    nominal_misfit is that of the nominal rig on the searched record.
    """

    hypotheses: tuple[Hypothesis, ...]
    candidates: tuple[Candidate, ...]
    nominal_misfit: Misfit


def search(prepared: Prepared, progress: Callable[[float], None] = lambda _: None) -> Searched:
    """Hypotheses that explain most of the record of the strongest force; of several fitted records, with shared
    parameters."""
    strongest, share = prepared.searched, 0.6 if prepared.fits_several else 1.0
    searched = search_record(strongest.record, strongest.nominal_variances, lambda x: progress(share * x))
    if not prepared.fits_several:
        return searched
    records = [observation.record for observation in prepared.fitted]
    variances = [observation.nominal_variances for observation in prepared.fitted]
    return replace(
        searched,
        hypotheses=tuple(fitted_together(records, variances, hypothesis) for hypothesis in searched.hypotheses),
    )


def search_record(
    record: Record, nominal_variances: NominalVariances, progress: Callable[[float], None] = lambda _: None
) -> Searched:
    """Hypotheses from the search on one record, and its candidates."""
    linearization, residual = fit_nuisance(record, record.rig)
    library = candidates(
        scale_of(record, record.rig), [sensor.name for sensor in record.sensors], record.zero_known, record.forced
    )
    hypotheses = ranked_hypotheses(Search(nominal_variances, linearization, residual, tuple(library)), progress)
    return Searched(tuple(hypotheses), tuple(library), misfit(record, nominal_variances, residual))
