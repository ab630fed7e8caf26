"""Null reference: the misfit of the nominal rig on simulated recordings of itself, drawn within its tolerances.

It contains the effects of integration, chaos, sensors and tolerances, and turns a misfit into a p-value. It is made
once for a rig, its tolerances, a simulator and a level of force, and kept in a file.

Notes for maintainers
1. The contacts' part of -2 ln p and that of the worst 2 Hz band are judged apart from the rest, as one contact, or one
   sharp line, is a small share of the whole.
2. Every record has null simulations of its own level and length, of the same machines: statistics of several records
   are added machine by machine (`p_values`).
3. A further part enters the combination: chi-squared of the contact parameters' distance from rig.json (not where the
   rest is certain of a difference that is not bounded). The split likelihood ratio has its own share of the level
   (`p_value_combined_with_bound`): it bounds a p-value, is 1 for most machines, and would pull Cauchy's mean towards 1.
4. The key of a file holds rig, tolerances, simulator, level of force, length, and the versions of program and
   statistic.
"""

import hashlib
import importlib.metadata
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float
from msgspec.structs import replace
from scipy.stats import norm
from scipy.stats import t as student

from identify.gaps.decision.channel_errors import ChannelErrors, channel_errors_of, with_channel_errors
from identify.gaps.decision.null_simulations import draw_rig, is_impulsive, phase_randomized, standard_normals
from identify.gaps.residual.likelihood import Misfit, misfit, nominal_variances_of
from identify.gaps.residual.record import CountedBandAndEnd
from identify.gaps.residual.residual import Residual, linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.rollout.results import NullErrors
from identify.gaps.rollout.windows import null_errors
from identify.gaps.search.nominal import fit_nuisance
from rig.errors import RigError
from rig.files import check_target, contents, make_folder, write_bytes
from rig.model.description import Rig, to_json
from rig.model.tolerances import Tolerances
from rig.processes import mapped
from rig.recording import Recording
from rig.recording.interfaces import Predict, Simulate

NULL_SIMULATION_COUNT = 12
"""Number of simulations: their mean is known within 29 % of their standard deviation, that within 21 %, which Student's
distribution takes into account."""
NULL_REFERENCE_SUFFIX = ".null_reference.json"
LEVEL_FACTOR = 1.25
"""Forces within this factor of each other share a null reference. Set by hand."""
MAX_STORED_REFERENCES = 8
"""Largest number of null references in one file, the latest, for records of several levels and lengths."""
MAX_COMBINED_P_VALUE = 0.99
"""Upper limit of p-values in a combination, as Cauchy's tail near one would cancel small p-values."""

STATISTIC_EDITION = 3
"""Number of the misfit's definition within a version of the program: null references of another are made anew."""
BOUND_WEIGHT = 0.05
"""Share of the level of a test that is given to a bound of a p-value, which is small by orders where it is small."""


class NullSimulation(msgspec.Struct, frozen=True):
    """Result of one null simulation: -2 ln p, its parts of the contacts and of the worst band, and unexplained shares.

    The shares are by band, overall and by contact force. prediction holds the errors of predictions, where the rig can
    be predicted.
    """

    minus_two_log: float
    law: float
    peak: float
    shares: tuple[float, ...]
    share: float
    contact_shares: tuple[float, ...]
    prediction: NullErrors | None = None


class NullReference(msgspec.Struct, frozen=True):
    """Null simulations of one rig; `key` identifies rig, tolerances, simulator, force and program.

    checksum is that of the file's content.
    """

    key: str
    simulations: tuple[NullSimulation, ...]
    checksum: str = ""

    @property
    def cost_parts(self) -> Float[np.ndarray, "simulations 3"]:
        """-2 ln p without the contacts' part, the contacts' part, and that of the worst band, for every simulation."""
        return np.array([[null.minus_two_log - null.law, null.law, null.peak] for null in self.simulations])

    @property
    def predictions(self) -> tuple[NullErrors, ...]:
        """Prediction errors of the null simulations."""
        return tuple(simulation.prediction for simulation in self.simulations if simulation.prediction is not None)

    def null_share_upper_limits(self) -> Float[np.ndarray, " bands"]:
        """Upper 95 % prediction limit of the unexplained share of each band under the null."""
        # the bands of a record end where its force does
        band_count = min(len(simulation.shares) for simulation in self.simulations)
        shares = np.array([simulation.shares[:band_count] for simulation in self.simulations])
        limit_deviations = student.ppf(0.95, len(shares) - 1) * np.sqrt(1 + 1 / len(shares))
        return np.asarray(shares.mean(axis=0) + limit_deviations * shares.std(axis=0, ddof=1))


class _StoredReferences(msgspec.Struct, frozen=True):
    """Content of a null reference file."""

    null_references: tuple[NullReference, ...]


def p_values(references: Sequence[NullReference], misfits: Sequence[Misfit]) -> Float[np.ndarray, " parts"]:
    """p-values of the misfit of a rig on all records together, one for each statistic.

    The null simulations of several records are of the same machines, so their statistics are added machine by machine.
    With x a statistic of the measured records (the linear residual's part of -2 ln p, the contacts', the worst band's),
    and m and s its mean and standard deviation over n null machines, it is about a sum of nu = s^2 / 2 squares of
    normal variables, which is skewed where few tolerances make most of it. Made normal by Wilson and Hilferty's cube
    root (Proc. Natl. Acad. Sci. 17, 1931), Student's prediction gives

        p = P( t_(n-1) > (z(x) - (1 - min(nu, 1)) z(m)) / sqrt(1 + 1/n) )
        z(x) = ((1 + sqrt(2 / n_z) (x - m) / s)^(1/3) - 1 + 2 / (9 n_z)) / sqrt(2 / (9 n_z)),   n_z = max(nu, 1)

    with s at least 1. Of a statistic that hardly varies, the mean has p = 1/2, and the normal distribution takes the
    place of Student's, as no deviation is estimated.
    """
    null_statistics = np.sum([reference.cost_parts for reference in references], axis=0)
    measured = np.sum([[m.minus_two_log - m.contact_cost, m.contact_cost, m.peak_band_cost] for m in misfits], axis=0)
    is_used = [True, bool(np.any(null_statistics[:, 1])), True]
    null_statistics, measured = null_statistics[:, is_used], measured[is_used]
    deviations = null_statistics.std(axis=0, ddof=1)
    freedom = np.maximum(deviations**2 / 2, 1.0)
    standardised_excess = np.sqrt(2 / freedom) * (measured - null_statistics.mean(axis=0)) / np.maximum(deviations, 1.0)
    skew = 2 / (9 * freedom)
    normal_scores = (np.cbrt(np.maximum(1 + standardised_excess, 0.0)) - 1 + skew) / np.sqrt(skew)
    normal_scores -= (1 - np.minimum(deviations**2 / 2, 1.0)) * np.sqrt(skew)
    normal_scores /= np.sqrt(1 + 1 / len(null_statistics))
    return np.where(deviations < 1, norm.sf(normal_scores), student.sf(normal_scores, len(null_statistics) - 1))


def combined_p_value(p_values: Float[np.ndarray, " parts"]) -> float:
    """Combination of p-values under any dependence, by Cauchy's distribution.

    p = 1/2 - arctan( mean tan((1/2 - p_i) pi) ) / pi        (Liu and Xie, J. Am. Stat. Assoc. 115, 2020)
    """
    p_values = np.clip(p_values, 1e-300, MAX_COMBINED_P_VALUE)
    cauchy_values = np.where(p_values > 1e-12, np.tan((0.5 - p_values) * np.pi), 1 / (np.pi * p_values))
    mean_tangent = float(np.mean(cauchy_values))
    return 0.5 - float(np.arctan(mean_tangent)) / np.pi if mean_tangent < 1e12 else 1 / (np.pi * mean_tangent)


def p_value_combined_with_bound(p_value: float, p_bound: float) -> float:
    """Combination of a p-value with the upper bound of another, 1 where it says nothing: Bonferroni's, weighted.

    p = min(1, p_value / (1 - w), p_bound / w)        w = `BOUND_WEIGHT`
    """
    return min(1.0, p_value / (1 - BOUND_WEIGHT), p_bound / BOUND_WEIGHT)


def p_value(null_reference: NullReference, misfit: Misfit) -> float:
    """p-value of the misfit of a rig on one record."""
    return combined_p_value(p_values([null_reference], [misfit]))


def null_reference_of(
    measured_recording: Recording,
    tolerances: Tolerances,
    simulate: Simulate,
    simulator_name: str,
    progress: Callable[[float], None] = lambda _: None,
    path: Path | None = None,
    simulation_count: int = NULL_SIMULATION_COUNT,
    predict: Predict | None = None,
) -> NullReference:
    """Null reference of a recording's rig, length and force, read from the file `path`, or made and stored there.

    Each null simulation is also predicted from its measured states, if a predictor is given. In a folder, the file is
    named after the key, so that references of many rigs and levels can share it.
    """
    measured_record = record_of(measured_recording, tolerances=tolerances)
    counted_part = measured_record.counted_part
    key = null_reference_key(measured_recording, counted_part, tolerances, simulator_name, simulation_count)
    if path and path.is_dir():
        path = path / f"{key[:16]}.json"
    stored_references = _stored_references(path) if path else ()
    if stored_reference := next((reference for reference in stored_references if reference.key == key), None):
        return replace(stored_reference, checksum="")
    if path:
        check_target(path, new_folder=True)
    channel_errors = channel_errors_of(measured_record)
    null_simulations = mapped(
        _NullRun(measured_recording, tolerances, channel_errors, counted_part, simulate, predict),
        list(enumerate(standard_normals(measured_recording.rig, simulation_count))),
        report_finished=lambda finished_count: progress(finished_count / simulation_count),
    )
    null_reference = NullReference(key, tuple(null_simulations))
    if path:
        make_folder(path.parent)
        checked_reference = replace(null_reference, checksum=_checksum(null_reference))
        file_content = _StoredReferences((*stored_references[1 - MAX_STORED_REFERENCES :], checked_reference))
        write_bytes(msgspec.json.encode(file_content), path)
    return null_reference


@dataclass(frozen=True)
class _NullRun:
    """Null simulation of a recording as a function of its seed and of the standard normals that draw the machine."""

    measured_recording: Recording
    tolerances: Tolerances
    channel_errors: ChannelErrors
    counted_part: CountedBandAndEnd
    simulate: Simulate
    predict: Predict | None

    def __call__(self, seed_and_normals: tuple[int, Float[np.ndarray, " normals"]]) -> NullSimulation:
        """Record a machine that is drawn within the tolerances, and fit the nominal rig to it."""
        seed, normals = seed_and_normals
        recording = self._simulated_recording(seed, draw_rig(self.measured_recording.rig, self.tolerances, normals))
        record = record_of(recording, tolerances=self.tolerances, counted_part=self.counted_part)
        nominal_variances = nominal_variances_of(linearized(record, record.rig))
        residual = fit_nuisance(record, record.rig)[1]
        nominal_misfit = misfit(record, nominal_variances, residual)
        return NullSimulation(
            nominal_misfit.minus_two_log,
            nominal_misfit.contact_cost,
            nominal_misfit.peak_band_cost,
            tuple(nominal_misfit.share_by_band.tolist()),
            nominal_misfit.unexplained_share,
            tuple(nominal_misfit.unexplained_contact_shares.tolist()),
            _prediction_errors(recording, residual, self.predict),
        )

    def _simulated_recording(self, seed: int, drawn_rig: Rig) -> Recording:
        """Recording of a machine under a force of the measured one's spectrum, with the errors of its channels."""
        rng, silent_sample_count = np.random.default_rng([seed, 77]), self.channel_errors.silent_sample_count
        measured_rig, rate_hz = self.measured_recording.rig, self.measured_recording.rig.sample_rate_hz
        forces_n = [
            force_n if is_impulsive(force_n) else phase_randomized(force_n, silent_sample_count, rate_hz, rng)
            for force_n in self.measured_recording.forces_n
        ]
        recording = self.simulate(measured_rig, drawn_rig, np.array(forces_n), seed)
        return with_channel_errors(recording, self.channel_errors, seed)


def _prediction_errors(recording: Recording, residual: Residual, predict: Predict | None) -> NullErrors | None:
    """Errors of predictions; None without a predictor, and for a rig that it cannot predict."""
    if predict is None:
        return None
    try:
        return null_errors(recording, residual, predict)
    except RigError:
        return None


def null_reference_key(
    measured_recording: Recording,
    counted_part: CountedBandAndEnd,
    tolerances: Tolerances,
    simulator_name: str,
    simulation_count: int = NULL_SIMULATION_COUNT,
) -> str:
    """Key of the rig, its tolerances, the simulator, the program, and the level and length of the force.

    In a free decay the level is that of the motion. The length also counts how long the record is evaluated, in halves
    of a second, and up to which frequency.
    """
    rig, forces_n = measured_recording.rig, measured_recording.forces_n
    level_signal = forces_n if np.any(forces_n) else measured_recording.signals[rig.sensors[-1].quantity].values
    level_number = round(float(np.log(max(np.std(level_signal), 1e-300)) / np.log(LEVEL_FACTOR)))
    extent_words = f"{measured_recording.samples} {counted_part.decimation} {round(2 * counted_part.end_s)}"
    program_version = importlib.metadata.version("rig-identify")
    definition_words = f"{program_version} {STATISTIC_EDITION}"
    blow_words = " blows" * any(is_impulsive(force_n) for force_n in forces_n)
    key_parts = (
        to_json(replace(rig, tolerances=None)),
        msgspec.json.encode(tolerances),
        f"{simulator_name} {level_number} {extent_words} {simulation_count} {definition_words}{blow_words}".encode(),
    )
    return hashlib.sha256(b"\n".join(key_parts)).hexdigest()


def _stored_references(path: Path) -> tuple[NullReference, ...]:
    """Null references of a file with valid checksums; damaged ones are made anew.

    Raises RigError if the file cannot be read, or holds something else, which must not be overwritten.
    """
    if not path.exists():
        return ()
    content = contents(path)
    is_null_reference = content.startswith(b'{"null_references"') or path.name.endswith(NULL_REFERENCE_SUFFIX)
    if content and not is_null_reference:
        raise RigError(f"{path}: is no null reference, and is not written over; give another name, or remove it")
    try:
        stored_references = msgspec.json.decode(content, type=_StoredReferences).null_references
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return ()
    return tuple(reference for reference in stored_references if reference.checksum == _checksum(reference))


def _checksum(null_reference: NullReference) -> str:
    return hashlib.sha256(msgspec.json.encode(replace(null_reference, checksum=""))).hexdigest()
