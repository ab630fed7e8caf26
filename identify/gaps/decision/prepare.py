"""The first stage of a diagnosis: recordings of one rig with their spectra, and what its tolerances and noise leave."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np

from identify.gaps.decision.null_reference import NullReference, Simulate, null_key, null_reference_of
from identify.gaps.decision.recordings import parts_of, sound
from identify.gaps.decision.release import released
from identify.gaps.residual.likelihood import Reference, reference_of
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.rollout.windows import Predict
from rig.errors import RigError
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording


@dataclass(frozen=True)
class Simulator:
    """Simulator of a rig under a measured force, its name, and the predictor from measured states, if there is one."""

    name: str
    simulate: Simulate
    predict: Predict | None = None


SIMULATORS, PREDICTORS = "identify.simulators", "identify.predictors"
"""The entry points by which packages offer what simulates a rig, and what predicts it from measured states."""
PREDICTOR = "modal"
"""Predicts where the simulator's package offers no predictor of the same name."""


def simulator_named(name: str) -> Simulator:
    """The simulator that an installed package offers under this name; raises RigError if none does."""
    offered = {point.name: point for point in entry_points(group=SIMULATORS)}
    if name not in offered:
        raise RigError(f"no simulator {name!r}; there are {', '.join(sorted(offered))}")
    predictors = {point.name: point for point in entry_points(group=PREDICTORS)}
    predictor = predictors.get(name) or predictors.get(PREDICTOR)
    return Simulator(name, offered[name].load(), predictor.load() if predictor else None)


@dataclass(frozen=True)
class PreparedRecording:
    """A recording with what belongs to it: its spectra, and the variances in which hypotheses are compared on it."""

    recording: Recording
    record: Record
    reference: Reference

    @property
    def force_rms_n(self) -> float:
        """Rms of all forces together, N."""
        return float(np.sqrt(np.sum(np.var(self.recording.forces_n, axis=1))))


@dataclass(frozen=True)
class Prepared:
    """Observations of one rig in the order of their time; the one at `validating` is fitted by no effect.

    simulate makes recordings of that rig under a force, or of its free decay where no force was measured; predict runs
    it from measured states. Each observation has the null reference of its level and length.
    """

    observations: tuple[PreparedRecording, ...]
    validating: int
    channel_faults: dict[str, str]
    simulate: Simulate
    predict: Predict | None
    null_references: tuple[NullReference, ...]

    @property
    def null_reference(self) -> NullReference:
        """Null reference of the record that validates."""
        return self.null_references[self.validating]

    @property
    def validation(self) -> PreparedRecording:
        return self.observations[self.validating]

    @property
    def fitted(self) -> tuple[PreparedRecording, ...]:
        return tuple(one for k, one in enumerate(self.observations) if k != self.validating)

    @property
    def searched(self) -> PreparedRecording:
        """Recording of the strongest force among those that are fitted."""
        return max(self.fitted, key=lambda one: one.force_rms_n)

    @property
    def several(self) -> bool:
        """True if more than one recording is fitted."""
        return len(self.observations) > 2

    @property
    def titles(self) -> tuple[str, ...]:
        return tuple(
            f"{k + 1}, {one.force_rms_n:.3g} N{', validates' * (k == self.validating)}"
            for k, one in enumerate(self.observations)
        )


def prepare(
    recordings: Recording | Sequence[Recording],
    validation: Recording | None,
    simulator: Simulator,
    kept: Path | None,
    tolerances: Tolerances | None,
    progress: Callable[[float], None] = lambda _: None,
) -> Prepared:
    """Recordings without faulty channels, their spectra, and the null reference of each.

    Tolerances say how exactly the rig is believed (else the rig itself does, else they are a laboratory's). Raises
    RigError if the recordings do not fit together or allow no diagnosis.
    """
    parts, validating = parts_of(recordings, validation)
    believed = tolerances or parts[0].rig.tolerances or LABORATORY
    parts, channel_faults = sound(*parts)
    observations = tuple(observed(part, believed) for part in parts)
    simulates = [
        simulator.simulate if one.record.forced else released(one.recording, simulator.simulate) for one in observations
    ]
    keys = [null_key(one.recording, one.record.counted_until_s, believed, simulator.name) for one in observations]
    known: dict[str, NullReference] = {}
    first = {key: k for k, key in reversed(list(enumerate(keys)))}
    for number, (key, k) in enumerate(first.items()):

        def told(share: float, number: int = number) -> None:
            progress((number + share) / len(first))

        recording, simulate = observations[k].recording, simulates[k]
        known[key] = null_reference_of(
            recording, believed, simulate, simulator.name, told, kept, predict=simulator.predict
        )
    references = tuple(known[key] for key in keys)
    return Prepared(observations, validating, channel_faults, simulates[validating], simulator.predict, references)


def observed(recording: Recording, tolerances: Tolerances) -> PreparedRecording:
    record = record_of(recording, tolerances=tolerances)
    return PreparedRecording(recording, record, reference_of(linearized(record, record.rig)))
