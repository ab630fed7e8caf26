"""Studies of NIFO: a long record of the barrel in its cradle, and the stiffness by NIFO in one modal equation.

The paper's setting (section 3.4): displacements and clearances are known.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from jaxtyping import Float

from identify.linear.modal import ModalEquation, modal_equations, signals_across_contacts
from identify.paper.nifo import Nifo, NifoForm, nifo
from identify.signals.kinematics import kinematics
from identify.signals.law_evaluation import penetration
from identify.signals.spectra import Averaging, Blocks, WindowedTerm, blocks, decimated
from rig.model.description import Rig
from rig.recording import Recording, Signals, channel_groups
from rig.simulation.excitation import QUIET_S, force_signal
from rig.simulation.plants import modal
from rig.simulation.reference import BarrelCradle
from rig.simulation.sensors import digitise, plant_run_duration_s

FORMS: tuple[NifoForm, NifoForm] = ("paper", "weak")
AVERAGE_COUNT = 40
EQUATION_BODY, EQUATION_MODE = "barrel", 3
"""The paper's modal equation: the barrel's first bending."""
PIECE_S, MARGIN_S = 120.0, 2.0
"""Length of the pieces in which a record is worked on, and of the margin on either side, longer than the modes beyond
the fitted ones ring."""
REDUCED_HZ = 256.0
"""Rate at which force, modal coordinate and penetrations are kept: above twice the band of the force."""
LONG_RECORD_RIG = BarrelCradle(sensors="displacement", sample_rate_hz=2048.0, step_s=2.0**-13)
"""Reference rig as the studies record it; for the error of its step see tests/benchmarks/modal_plant.py."""


class Study(msgspec.Struct, frozen=True, kw_only=True):
    """Record with 40 averages, half overlapping, of its longest block; shorter blocks take as much as they need."""

    settings: BarrelCradle
    block_s: tuple[float, ...]
    noise_densities: tuple[float, ...] = (0.0,)
    """Noise densities of the displacements, m/sqrt(Hz): the same motion is measured with each."""

    @property
    def piece_count(self) -> int:
        return int(np.ceil((QUIET_S + record_length_s(max(self.block_s))) / PIECE_S))


class NifoEstimate(msgspec.Struct, frozen=True, kw_only=True):
    """Stiffness of a contact by one form of NIFO at one resolution: spectral mean, its standard error, rms spread."""

    form: NifoForm
    block_s: float
    noise_density: float
    contact: str
    true_n_per_m: float
    mean_n_per_m: float
    error_n_per_m: float
    deviation_n_per_m: float

    @property
    def mean_error_percent(self) -> float:
        return 100 * (self.mean_n_per_m / self.true_n_per_m - 1)

    @property
    def standard_error_percent(self) -> float:
        return 100 * self.error_n_per_m / self.true_n_per_m

    @property
    def spread_percent(self) -> float:
        return 100 * self.deviation_n_per_m / self.true_n_per_m


class NifoOutcome(msgspec.Struct, frozen=True):
    """Result of a study: the estimates, and the share of the time for which each contact is closed.

    incoherent_rms_shares are those of force and penetrations, without noise.
    """

    estimates: tuple[NifoEstimate, ...]
    contacts: tuple[str, ...]
    closed_shares: tuple[float, ...]
    incoherent_rms_shares: tuple[float, ...]


@dataclass(frozen=True)
class ReducedRecord:
    """Piece of a record as NIFO needs it: rows of force, modal coordinate with two derivatives, penetrations."""

    equation: ModalEquation
    rows: Float[np.ndarray, "rows samples"]
    closed_shares: Float[np.ndarray, " contacts"]


def record_length_s(block_s: float) -> float:
    """Length of 40 blocks with half overlap, s."""
    return block_s * (1 + (AVERAGE_COUNT - 1) / 2)


def nifo_outcome(study: Study) -> NifoOutcome:
    """Simulate the record with the modal plant, reduce it piece by piece to the modal equation, and apply NIFO."""
    rig = study.settings.rig()
    pieces = list(_reduced_pieces(study, rig))
    closed_shares = np.mean([piece[0].closed_shares for piece in pieces], axis=0)
    estimates = []
    for noise_index, noise_density in enumerate(study.noise_densities):
        rows = np.concatenate([piece[noise_index].rows for piece in pieces], axis=1)
        for block_s in study.block_s:
            stop_index = round((QUIET_S + record_length_s(block_s)) * REDUCED_HZ)
            force_n, displacement, velocity, acceleration, *penetrations_m = rows[:, :stop_index]
            averaging = Averaging(averages=AVERAGE_COUNT, block_s=block_s)
            block_set = blocks(force_n.size, REDUCED_HZ, averaging, (study.settings.low_hz, study.settings.high_hz))
            equation = replace(
                pieces[0][noise_index].equation, displacement=displacement, velocity=velocity, acceleration=acceleration
            )
            for form in FORMS:
                nifo_result = nifo(equation, force_n, np.array(penetrations_m), block_set, form)
                estimates += _estimates(rig, nifo_result, form, block_s, noise_density)
            if noise_index == 0 and block_s == max(study.block_s):
                incoherent = incoherent_rms_shares([force_n, *penetrations_m], block_set)
    return NifoOutcome(tuple(estimates), tuple(c.name for c in rig.contacts), tuple(closed_shares.tolist()), incoherent)


def incoherent_rms_shares(signals: Sequence[Float[np.ndarray, " samples"]], block_set: Blocks) -> tuple[float, ...]:
    """Share of each signal's amplitude that is no linear response to the others: rms over frequency.

    With the normal matrix G of their spectra over the blocks, sqrt(1 / (G_jj (G^-1)_jj)) at each line.
    """
    spectra = block_set.spectra_of_sums([[WindowedTerm(signal)] for signal in signals], block_set.starts)
    normal_matrix = np.einsum("ibl,jbl->lij", spectra.conj(), spectra)
    norms = np.sqrt(np.einsum("lii->li", normal_matrix).real)
    inverse_normal = np.linalg.inv(normal_matrix / (norms[:, :, None] * norms[:, None, :]))
    return tuple(np.sqrt(np.mean(1 / np.einsum("lii->li", inverse_normal).real, axis=0)).tolist())


def reduced_piece(rig: Rig, channel_values: Float[np.ndarray, "channels samples"]) -> ReducedRecord:
    """Piece of a record from its force and displacements with margins; the result is without the margins."""
    channels, rate_hz = channel_groups(rig), rig.sample_rate_hz
    signals = {"force": channel_values[:1], "displacement": channel_values[1:]}
    recording = Recording(rig, {name: Signals(channels[name], 0.0, rows) for name, rows in signals.items()}, {})
    motion = kinematics(recording, "displacement")
    eta_m = signals_across_contacts(rig, motion, motion.displacement_m)
    penetrations_m = np.array(
        [
            penetration(eta, contact.law.lower_clearance_m, contact.law.upper_clearance_m, rate_hz)
            for eta, contact in zip(eta_m, rig.contacts, strict=True)
        ]
    )
    contact_force_n = np.array([[contact.law.stiffness_n_per_m] for contact in rig.contacts]) * penetrations_m
    equation = modal_equations(rig, motion, rig.body(EQUATION_BODY), contact_force_n=contact_force_n)[EQUATION_MODE - 1]
    mode_signals = equation.displacement, equation.velocity, equation.acceleration
    sample_count = mode_signals[0].size
    full_rate_rows = np.stack([motion.force_n[:sample_count], *mode_signals, *penetrations_m[:, :sample_count]])
    reduced_rows = decimated(full_rate_rows, round(rate_hz / REDUCED_HZ))
    rows = reduced_rows[:, _within_margins(REDUCED_HZ)].copy()  # no view that holds the piece
    clearances_m = np.array([[contact.law.clearance_m] for contact in rig.contacts])
    return ReducedRecord(
        equation=replace(equation, displacement=rows[1], velocity=rows[2], acceleration=rows[3]),
        rows=rows,
        closed_shares=np.mean(np.abs(eta_m[:, _within_margins(rate_hz)]) > clearances_m, axis=1),
    )


def _within_margins(rate_hz: float) -> slice:
    """Samples of a piece without its margins, at this rate."""
    return slice(round(MARGIN_S * rate_hz), round((MARGIN_S + PIECE_S) * rate_hz))


def _reduced_pieces(study: Study, rig: Rig) -> Iterator[list[ReducedRecord]]:
    """Every piece of the record, reduced, once for each noise density."""
    sensor_count, noise_bandwidth = len(rig.sensors), np.sqrt(rig.sample_rate_hz / 2)
    for rows in _pieces(study, rig):
        signals, noise = rows[: 1 + sensor_count], rows[1 + sensor_count :]
        pieces = []
        for noise_density in study.noise_densities:
            values = signals.copy()
            if noise_density:
                values[1:] += noise_density * noise_bandwidth * noise
            pieces.append(reduced_piece(rig, values))
        yield pieces


def _pieces(study: Study, rig: Rig) -> Iterator[Float[np.ndarray, "rows samples"]]:
    """Rows of force and displacements, from the plant through the sensors, piece by piece with margins.

    White noise of unit variance for every displacement follows them, if the study has noise.
    """
    settings, rng = study.settings, np.random.default_rng(study.settings.seed)
    sensor_count, noise_count = len(rig.sensors), len(rig.sensors) * any(study.noise_densities)
    margin_count, samples_per_piece = round(MARGIN_S * rig.sample_rate_hz), round(PIECE_S * rig.sample_rate_hz)
    duration_s = plant_run_duration_s(rig, study.piece_count * PIECE_S + MARGIN_S)
    force_n = force_signal(settings.force(), duration_s, settings.step_s)
    motion = modal.simulate(rig, force_n, settings.step_s, lambda _: None)
    queued_rows, queued_count = [np.zeros((1 + sensor_count + noise_count, margin_count))], margin_count
    for block in digitise(rig, motion, rng):
        sample_count = block.force_n.size
        unit_noise = rng.standard_normal((noise_count, sample_count))
        queued_rows.append(np.vstack([block.force_n, block.sensed["displacement"], unit_noise]))
        queued_count += sample_count
        if queued_count >= samples_per_piece + 2 * margin_count:
            rows = np.concatenate(queued_rows, axis=1)
            yield rows[:, : samples_per_piece + 2 * margin_count]
            queued_rows, queued_count = [rows[:, samples_per_piece:]], queued_count - samples_per_piece


def _estimates(rig: Rig, fit: Nifo, form: NifoForm, block_s: float, noise_density: float) -> list[NifoEstimate]:
    return [
        NifoEstimate(
            form=form,
            block_s=block_s,
            noise_density=noise_density,
            contact=rig.contacts[contact_index].name,
            true_n_per_m=rig.contacts[contact_index].law.stiffness_n_per_m,
            mean_n_per_m=float(mean),
            error_n_per_m=float(error),
            deviation_n_per_m=float(deviation),
        )
        for contact_index, mean, error, deviation in zip(
            fit.contact_indices, fit.mean_n_per_m, fit.stiffness_error_n_per_m, fit.deviation_n_per_m, strict=True
        )
    ]
