"""The null reference: what the believed rig leaves of recordings of itself, built within its tolerances.

Integration, chaos, sensors and tolerances are in it; it turns what is left of a record into a p-value. Made once for a
rig, its tolerances, a simulator and a level of force, it is kept.
"""

import hashlib
import importlib.metadata
from collections.abc import Callable, Sequence
from dataclasses import replace as with_fields
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float
from msgspec.structs import replace
from scipy.stats import t as student

from identify.gaps.decision.null_machine import drawn, standard_normals, with_crosstalk
from identify.gaps.residual.likelihood import Misfit, misfit, reference_of
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Linearization, Residual, linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.rollout.results import NullErrors
from identify.gaps.rollout.windows import Predict, null_errors
from identify.gaps.search.nominal import fit_nuisance
from rig.errors import RigError
from rig.files import check_target, contents, make_folder, write_bytes
from rig.model.description import Rig, to_json
from rig.model.tolerances import Tolerances
from rig.recording import Recording

NULL_SIMULATIONS = 12
"""Their mean is known within 29 % of their standard deviation, that within 21 %: Student's distribution knows."""
NULL_REFERENCE_SUFFIX = ".null_reference.json"
RISE_S = 0.1
MOST, BLOWS = 0.9, 0.1
"""A force of which a smaller share of the samples holds so much of the energy is one of blows."""
LEVEL = 1.25
"""Forces within this factor of each other share a null reference."""
KEPT = 8
"""Null references that one file holds at most, the latest: of records of so many levels and lengths."""
LIKELIEST = 0.99
"""A p-value above it counts as this in a combination, as Cauchy's tail on that side would cancel the other."""

Simulate = Callable[[Rig, Rig, Float[np.ndarray, "forces samples"], int], Recording]
"""The recording of the believed rig (first) that the actual one makes under a measured force, noise from a seed: the
simulator that the diagnosis is handed."""


class NullSimulation(msgspec.Struct, frozen=True):
    """Result of one null simulation: -2 ln p, the contacts' part of it and that of the worst band, and the
    unexplained shares by band, overall, and of each contact force; its figures in familiar terms; and the errors of
    predictions of it, where its rig can be predicted."""

    minus_two_log: float
    law: float
    peak: float
    shares: tuple[float, ...]
    share: float
    contact_shares: tuple[float, ...]
    figures: dict[str, float]
    prediction: NullErrors | None = None


class NullReference(msgspec.Struct, frozen=True):
    """The null simulations of one rig; `key` says of which rig, tolerances, simulator, force and program.

    `checksum` is of what is kept in a file.
    """

    key: str
    simulations: tuple[NullSimulation, ...]
    checksum: str = ""

    @property
    def statistics(self) -> Float[np.ndarray, "simulations 3"]:
        """Statistics of every null simulation: -2 ln p less the contacts' part, that part, the worst band's."""
        return np.array([[n.minus_two_log - n.law, n.law, n.peak] for n in self.simulations])

    @property
    def predictions(self) -> tuple[NullErrors, ...]:
        """Errors of predictions of the null simulations."""
        return tuple(n.prediction for n in self.simulations if n.prediction is not None)

    def by_chance(self, figure: str) -> float:
        """95 % prediction half-width of a figure under the null, in its unit."""
        values = np.array([n.figures[figure] for n in self.simulations])
        return float(student.ppf(0.975, values.size - 1) * np.sqrt(1 + 1 / values.size) * values.std(ddof=1))

    def usual_shares(self) -> Float[np.ndarray, " bands"]:
        """Shares by band that 95 % of null simulations stay below."""
        common = min(len(n.shares) for n in self.simulations)  # the bands of a record end where its force does
        rows = np.array([n.shares[:common] for n in self.simulations])
        beyond = student.ppf(0.95, len(rows) - 1) * np.sqrt(1 + 1 / len(rows))
        return np.asarray(rows.mean(axis=0) + beyond * rows.std(axis=0, ddof=1))


class _KeptReferences(msgspec.Struct, frozen=True):
    """The content of a file."""

    null_references: tuple[NullReference, ...]


def p_values(records: Sequence[tuple[NullReference, Misfit]]) -> Float[np.ndarray, " parts"]:
    """p-values of the misfit that a rig leaves of all records together, part by part.

    The null simulations of several records are of the same machines, so their statistics are added machine by machine.
    With x one of the statistics of the measured records (the linear residual's part of -2 ln p, the contacts', the
    worst band's), m and s mean and standard deviation of it over n null machines, Student's prediction gives

        p = P( t_(n-1) > (x - m) / (s sqrt(1 + 1/n)) )        s at least 1
    """
    nulls = np.sum([reference.statistics for reference, _ in records], axis=0)
    measured = np.sum([[left.minus_two_log - left.law, left.law, left.peak] for _, left in records], axis=0)
    used = [True, bool(np.any(nulls[:, 1])), True]
    nulls, measured = nulls[:, used], measured[used]
    deviations = np.maximum(nulls.std(axis=0, ddof=1) * np.sqrt(1 + 1 / len(nulls)), 1.0)
    return np.asarray(student.sf((measured - nulls.mean(axis=0)) / deviations, len(nulls) - 1))


def combined(each: Float[np.ndarray, " parts"]) -> float:
    """One p-value of several, whatever their dependence: Cauchy's combination.

    p = 1/2 - arctan( mean tan((1/2 - p_i) pi) ) / pi        Liu and Xie, J. Am. Stat. Assoc. 115, 2020
    """
    each = np.clip(each, 1e-300, LIKELIEST)
    tangents = np.where(each > 1e-12, np.tan((0.5 - each) * np.pi), 1 / (np.pi * each))
    mean = float(np.mean(tangents))
    return 0.5 - float(np.arctan(mean)) / np.pi if mean < 1e12 else 1 / (np.pi * mean)


def p_value(reference: NullReference, misfit: Misfit) -> float:
    """p-value of the misfit that a rig leaves of one record."""
    return combined(p_values([(reference, misfit)]))


def null_reference_of(
    measured: Recording,
    tolerances: Tolerances,
    simulate: Simulate,
    simulator: str,
    progress: Callable[[float], None] = lambda _: None,
    kept: Path | None = None,
    simulations: int = NULL_SIMULATIONS,
    predict: Predict | None = None,
) -> NullReference:
    """Null reference of a recording's rig, length and force, read from the file `kept`, or made and kept.

    Each null simulation is also predicted from its measured states, if a predictor is given. Of a folder it is the
    file named after the key, so that many rigs and levels have theirs in one.
    """
    seen = record_of(measured, tolerances=tolerances)
    key = null_key(measured, seen.counted_until_s, tolerances, simulator, simulations)
    if kept and kept.is_dir():
        kept = kept / f"{key[:16]}.json"
    others = _read(kept) if kept else ()
    if found := next((one for one in others if one.key == key), None):
        return replace(found, checksum="")
    if kept:
        check_target(kept, new_folder=True)
    densities = np.sqrt(seen.force_noise / seen.samples)
    gain = tolerances.force_gain if len(densities) > 1 else 0.0  # of one force the rig that is drawn has it
    start = round(seen.excited_s * seen.sample_rate_hz)
    rows = []
    for seed, normals in enumerate(standard_normals(measured.rig, simulations)):
        rng = np.random.default_rng([seed, 77])
        actual = drawn(measured.rig, tolerances, normals)
        forces_n = np.array(
            [
                row if is_impulsive(row) else phase_randomized(row, start, measured.rig.sample_rate_hz, rng)
                for row in measured.forces_n
            ]
        )
        made = simulate(measured.rig, actual, forces_n, seed)
        shown = with_crosstalk(_instrumented(made, densities, gain, rng), tolerances.crosstalk, rng)
        record = record_of(shown, tolerances=tolerances, counted_until_s=seen.counted_until_s)
        rows.append(_null_simulation(shown, record, predict))
        progress((seed + 1) / simulations)
    reference = NullReference(key, tuple(rows))
    if kept:
        make_folder(kept.parent)
        holds = _KeptReferences((*others[1 - KEPT :], replace(reference, checksum=_checksum(reference))))
        write_bytes(msgspec.json.encode(holds), kept)
    return reference


def is_impulsive(force_n: Float[np.ndarray, " samples"]) -> bool:
    """True of a hammer's force, or of none: it is taken as it is, as noise of its spectrum is another test."""
    energy = np.cumsum(np.sort(force_n**2)[::-1])
    return bool(np.searchsorted(energy, MOST * energy[-1]) < BLOWS * force_n.size)


def phase_randomized(
    force_n: Float[np.ndarray, " samples"], start: int, sample_rate_hz: float, rng: np.random.Generator
) -> Float[np.ndarray, " samples"]:
    """A force of the same spectrum with other phases, after silence up to the sample `start`."""
    excited = force_n[start:]
    spectrum = np.fft.rfft(excited)
    turned = np.fft.irfft(np.abs(spectrum) * np.exp(2j * np.pi * rng.uniform(size=spectrum.size)), excited.size)
    rise = min(round(RISE_S * sample_rate_hz), excited.size)
    turned[:rise] *= np.sin(np.linspace(0, np.pi / 2, rise)) ** 2
    return np.concatenate([np.zeros(start), turned])


def _instrumented(
    made: Recording,
    force_noise_n: Float[np.ndarray, " forces"],
    force_gain: float,
    rng: np.random.Generator,
) -> Recording:
    """Recording with noise and gains of the force channels, which the simulator does not know."""
    group = made.signals["force"]
    values = group.values + force_noise_n[:, None] * rng.standard_normal(group.values.shape)
    values = values * (1 + force_gain * rng.standard_normal((len(values), 1)))
    return with_fields(made, signals={**made.signals, "force": with_fields(group, values=values)})


def _null_simulation(recording: Recording, record: Record, predict: Predict | None) -> NullSimulation:
    linearization = linearized(record, record.rig)
    reference = reference_of(linearization)
    residual = fit_nuisance(record, record.rig, rounds=1)[1]
    left = misfit(record, reference, residual)
    return NullSimulation(
        left.minus_two_log,
        left.law,
        left.peak,
        tuple(left.shares.tolist()),
        left.share,
        tuple(left.contact_shares.tolist()),
        {name: value for name, (value, _) in familiar_figures(linearization).items()},
        _prediction(recording, residual, predict),
    )


def _prediction(recording: Recording, residual: Residual, predict: Predict | None) -> NullErrors | None:
    """None without a predictor, and of a rig that it cannot predict."""
    if predict is None:
        return None
    try:
        return null_errors(recording, residual, predict)
    except RigError:
        return None


def null_key(
    measured: Recording,
    counted_until_s: float,
    tolerances: Tolerances,
    simulator: str,
    simulations: int = NULL_SIMULATIONS,
) -> str:
    """Key of the rig, its tolerances, the simulator, the force's (in a free decay the motion's) level and length, how
    long the record counts (in halves of a second), and the program.
    """
    driven = (
        measured.forces_n if np.any(measured.forces_n) else measured.signals[measured.rig.sensors[-1].quantity].values
    )
    level = round(float(np.log(max(np.std(driven), 1e-300)) / np.log(LEVEL)))
    version = importlib.metadata.version("rig-identify")
    counted = round(2 * counted_until_s)
    kind = " blows" * any(is_impulsive(row) for row in measured.forces_n)
    parts = (
        to_json(replace(measured.rig, tolerances=None)),
        msgspec.json.encode(tolerances),
        f"{simulator} {level} {measured.samples} {counted} {simulations} {version}{kind}".encode(),
    )
    return hashlib.sha256(b"\n".join(parts)).hexdigest()


def _read(path: Path) -> tuple[NullReference, ...]:
    """Null references of a file, as far as it is undamaged; damaged ones are made anew.

    Raises RigError if it cannot be read, or is a file of something else, which is not to be lost.
    """
    if not path.exists():
        return ()
    content = contents(path)
    if content and not content.startswith(b'{"null_references"') and not path.name.endswith(NULL_REFERENCE_SUFFIX):
        raise RigError(f"{path}: is no null reference, and is not written over; give another name, or remove it")
    try:
        found = msgspec.json.decode(content, type=_KeptReferences).null_references
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return ()
    return tuple(one for one in found if one.checksum == _checksum(one))


def _checksum(reference: NullReference) -> str:
    return hashlib.sha256(msgspec.json.encode(replace(reference, checksum=""))).hexdigest()


def familiar_figures(linearization: Linearization) -> dict[str, tuple[float, str]]:
    """Value and unit by name; contacts as the linearisation's rig has them."""
    accelerations = linearization.record.in_time(linearization.record.delivered)
    found = {"acceleration, rms of all sensors": (float(np.sqrt(np.mean(accelerations**2))), "m/s^2")}
    seconds = accelerations.shape[1] / linearization.record.rate_hz
    for contact, seen in zip(linearization.model.rig.contacts, linearization.seen, strict=True):
        found[f"time that a force of {contact.name} stands out"] = 100 * float(np.mean(seen.closed)), "%"
        found[f"impacts of {contact.name} that stand out"] = float(np.sum(np.diff(seen.closed) > 0)) / seconds, "1/s"
    return found
