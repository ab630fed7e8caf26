"""What the studies of NIFO share: a long record of the barrel in its cradle, and the stiffness that NIFO finds in it.

The paper's setting (section 3.4): displacements and clearances are known, and there is one modal equation.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from jaxtyping import Float

from identify.linear.modal import ModalEquation, modal_equations, relative_motion
from identify.paper.nifo import Form, Nifo, nifo
from identify.signals.kinematics import kinematics
from identify.signals.law_evaluation import penetration
from identify.signals.spectra import Averaging, Blocks, Term, blocks, decimated
from rig.model.description import Rig
from rig.recording import Recording, Signals, channel_groups
from rig.simulation.excitation import QUIET_S, force_signal
from rig.simulation.plants import modal
from rig.simulation.reference import BarrelCradle
from rig.simulation.sensors import digitise, needed_duration_s

FORMS: tuple[Form, Form] = ("paper", "weak")
AVERAGES = 40
BODY, MODE = "barrel", 3
"""The paper's modal equation: the barrel's first bending."""
PIECE_S, MARGIN_S = 120.0, 2.0
"""Pieces in which a record is worked on; the margin on either side is longer than the modes beyond the fitted ring."""
REDUCED_HZ = 256.0
"""The rate at which force, modal coordinate and penetrations are kept: above twice the band of the force."""
LONG = BarrelCradle(sensors="displacement", sample_rate_hz=2048.0, step_s=2.0**-13)
"""The reference rig as the studies record it, at a step for whose error see tests/benchmarks/modal_plant.py."""


class Study(msgspec.Struct, frozen=True, kw_only=True):
    """A record with 40 averages, half overlapping, of its longest block; shorter blocks take as much as they need."""

    settings: BarrelCradle
    block_s: tuple[float, ...]
    noise_densities: tuple[float, ...] = (0.0,)
    """Of the displacements, m/sqrt(Hz): the same motion is measured with each."""

    @property
    def pieces(self) -> int:
        return int(np.ceil((QUIET_S + needed_s(max(self.block_s))) / PIECE_S))


class NifoEstimate(msgspec.Struct, frozen=True, kw_only=True):
    """A contact's stiffness by one form of NIFO at one resolution: spectral mean, its standard error, rms spread."""

    form: Form
    block_s: float
    noise_density: float
    contact: str
    true_n_per_m: float
    mean_n_per_m: float
    error_n_per_m: float
    deviation_n_per_m: float

    @property
    def off_percent(self) -> float:
        return 100 * (self.mean_n_per_m / self.true_n_per_m - 1)

    @property
    def error_percent(self) -> float:
        return 100 * self.error_n_per_m / self.true_n_per_m

    @property
    def spread_percent(self) -> float:
        return 100 * self.deviation_n_per_m / self.true_n_per_m


class NifoOutcome(msgspec.Struct, frozen=True):
    """Of one study: the estimates, and the share of the time for which each contact is closed.

    `free` are the `incoherent_shares` of force and penetrations, without noise.
    """

    estimates: tuple[NifoEstimate, ...]
    contacts: tuple[str, ...]
    closed: tuple[float, ...]
    free: tuple[float, ...]


@dataclass(frozen=True)
class ReducedRecord:
    """A piece of a record as NIFO needs it: force, modal coordinate with two derivatives, penetrations, in rows."""

    equation: ModalEquation
    rows: Float[np.ndarray, "rows samples"]
    closed: Float[np.ndarray, " contacts"]


def needed_s(block_s: float) -> float:
    """What 40 blocks with half overlap cover."""
    return block_s * (1 + (AVERAGES - 1) / 2)


def estimated(study: Study) -> NifoOutcome:
    """Simulates the record with the modal plant, reduces it piece by piece to the modal equation, and applies NIFO."""
    rig = study.settings.rig()
    found = list(_reduced_pieces(study, rig))
    closed = np.mean([piece[0].closed for piece in found], axis=0)
    estimates = []
    for k, density in enumerate(study.noise_densities):
        rows = np.concatenate([piece[k].rows for piece in found], axis=1)
        for block_s in study.block_s:
            force_n, q, velocity, acceleration, *depths_m = rows[:, : round((QUIET_S + needed_s(block_s)) * REDUCED_HZ)]
            averaging = Averaging(averages=AVERAGES, block_s=block_s)
            cut = blocks(force_n.size, REDUCED_HZ, averaging, (study.settings.low_hz, study.settings.high_hz))
            equation = replace(found[0][k].equation, displacement=q, velocity=velocity, acceleration=acceleration)
            for form in FORMS:
                result = nifo(equation, force_n, np.array(depths_m), cut, form)
                estimates += _estimates(rig, result, form, block_s, density)
            if k == 0 and block_s == max(study.block_s):
                free = incoherent_shares([force_n, *depths_m], cut)
    return NifoOutcome(tuple(estimates), tuple(c.name for c in rig.contacts), tuple(closed.tolist()), free)


def incoherent_shares(signals: Sequence[Float[np.ndarray, " samples"]], cut: Blocks) -> tuple[float, ...]:
    """The amplitude of each signal that is no linear response to the others, as a share: rms over frequency.

    With the normal matrix G of their spectra over the blocks, sqrt(1 / (G_jj (G^-1)_jj)) at each line.
    """
    spectra = cut.spectra_of_sums([[Term(signal)] for signal in signals], cut.starts)
    normal = np.einsum("ibl,jbl->lij", spectra.conj(), spectra)
    size = np.sqrt(np.einsum("lii->li", normal).real)
    inverse = np.linalg.inv(normal / (size[:, :, None] * size[:, None, :]))
    return tuple(np.sqrt(np.mean(1 / np.einsum("lii->li", inverse).real, axis=0)).tolist())


def reduced(rig: Rig, delivered: Float[np.ndarray, "channels samples"]) -> ReducedRecord:
    """A piece of a record: its force and displacements, with the margins that are left out of what comes back."""
    channels, rate = channel_groups(rig), rig.sample_rate_hz
    signals = {"force": delivered[:1], "displacement": delivered[1:]}
    recording = Recording(rig, {name: Signals(channels[name], 0.0, rows) for name, rows in signals.items()}, {})
    motion = kinematics(recording, "displacement")
    eta_m = relative_motion(rig, motion, motion.displacement_m)
    depth_m = np.array(
        [
            penetration(eta, contact.law.lower_clearance_m, contact.law.upper_clearance_m, rate)
            for eta, contact in zip(eta_m, rig.contacts, strict=True)
        ]
    )
    stiffness = np.array([[contact.law.stiffness_n_per_m] for contact in rig.contacts])
    equation = modal_equations(rig, motion, rig.body(BODY), contact_force_n=stiffness * depth_m)[MODE - 1]
    mode = equation.displacement, equation.velocity, equation.acceleration
    samples = mode[0].size
    wide = np.stack([motion.force_n[:samples], *mode, *depth_m[:, :samples]])
    rows = decimated(wide, round(rate / REDUCED_HZ))[:, _own(REDUCED_HZ)].copy()  # no view that holds the piece
    clearances = np.array([[contact.law.clearance_m] for contact in rig.contacts])
    return ReducedRecord(
        equation=replace(equation, displacement=rows[1], velocity=rows[2], acceleration=rows[3]),
        rows=rows,
        closed=np.mean(np.abs(eta_m[:, _own(rate)]) > clearances, axis=1),
    )


def _own(rate_hz: float) -> slice:
    """A piece without its margins."""
    return slice(round(MARGIN_S * rate_hz), round((MARGIN_S + PIECE_S) * rate_hz))


def _reduced_pieces(study: Study, rig: Rig) -> Iterator[list[ReducedRecord]]:
    """Every piece of the record, reduced, once for each noise."""
    sensors, band = len(rig.sensors), np.sqrt(rig.sample_rate_hz / 2)
    for rows in _pieces(study, rig):
        measured, noise = rows[: 1 + sensors], rows[1 + sensors :]
        found = []
        for density in study.noise_densities:
            delivered = measured.copy()
            if density:
                delivered[1:] += density * band * noise
            found.append(reduced(rig, delivered))
        yield found


def _pieces(study: Study, rig: Rig) -> Iterator[Float[np.ndarray, "rows samples"]]:
    """Force and displacements of the record, from the plant through the sensors, piece by piece with margins.

    Behind them white noise of unit variance for every displacement, if the study wants any.
    """
    settings, rng = study.settings, np.random.default_rng(study.settings.seed)
    sensors, noises = len(rig.sensors), len(rig.sensors) * any(study.noise_densities)
    margin, own = round(MARGIN_S * rig.sample_rate_hz), round(PIECE_S * rig.sample_rate_hz)
    duration_s = needed_duration_s(rig, study.pieces * PIECE_S + MARGIN_S)
    force_n = force_signal(settings.force(), duration_s, settings.step_s)
    moved = modal.simulate(rig, force_n, settings.step_s, lambda _: None)
    held, size = [np.zeros((1 + sensors + noises, margin))], margin
    for block in digitise(rig, moved, rng):
        samples = block.force_n.size
        held.append(np.vstack([block.force_n, block.sensed["displacement"], rng.standard_normal((noises, samples))]))
        size += samples
        if size >= own + 2 * margin:
            rows = np.concatenate(held, axis=1)
            yield rows[:, : own + 2 * margin]
            held, size = [rows[:, own:]], size - own


def _estimates(rig: Rig, result: Nifo, form: Form, block_s: float, noise_density: float) -> list[NifoEstimate]:
    return [
        NifoEstimate(
            form=form,
            block_s=block_s,
            noise_density=noise_density,
            contact=rig.contacts[j].name,
            true_n_per_m=rig.contacts[j].law.stiffness_n_per_m,
            mean_n_per_m=float(mean),
            error_n_per_m=float(error),
            deviation_n_per_m=float(spread),
        )
        for j, mean, error, spread in zip(
            result.contacts, result.mean_n_per_m, result.stiffness_error_n_per_m, result.deviation_n_per_m, strict=True
        )
    ]
