"""What the studies of NIFO share: a long record of the barrel in its cradle, and the stiffness that NIFO finds in it.

The paper's setting (section 3.4): displacements and clearances are known, and there is one modal equation.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from jaxtyping import Float

from identify.kinematics import kinematics
from identify.modal import ModalEquation, modal_equations, relative_displacements, without_higher_modes
from identify.nifo import Form, Nifo, nifo
from identify.spectra import Averaging, blocks, decimated, penetration
from rig.description import Rig
from rig.excitation import QUIET_S, force_course
from rig.plants import modal
from rig.recording import Recording, Signals, channel_groups
from rig.reference import BarrelCradle
from rig.sensors import digitised, needed_duration_s

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
    noise_density: float = 0.0
    """Of the displacements, m/sqrt(Hz)."""

    @property
    def rig(self) -> Rig:
        rig = self.settings.rig()
        sensors = (msgspec.structs.replace(s, noise_density=self.noise_density) for s in rig.sensors)
        return msgspec.structs.replace(rig, sensors=tuple(sensors))

    @property
    def pieces(self) -> int:
        return int(np.ceil((QUIET_S + needed_s(max(self.block_s))) / PIECE_S))


class Estimate(msgspec.Struct, frozen=True, kw_only=True):
    """A contact's stiffness by one form of NIFO at one resolution: spectral mean, its standard error, rms spread."""

    form: Form
    block_s: float
    contact: str
    true_n_per_m: float
    mean_n_per_m: float
    error_n_per_m: float
    spread_n_per_m: float

    @property
    def off_percent(self) -> float:
        return 100 * (self.mean_n_per_m / self.true_n_per_m - 1)

    @property
    def error_percent(self) -> float:
        return 100 * self.error_n_per_m / self.true_n_per_m

    @property
    def spread_percent(self) -> float:
        return 100 * self.spread_n_per_m / self.true_n_per_m


class Outcome(msgspec.Struct, frozen=True):
    """Of one study: the estimates, and the share of the time for which each contact is closed."""

    estimates: tuple[Estimate, ...]
    contacts: tuple[str, ...]
    closed: tuple[float, ...]


@dataclass(frozen=True)
class Reduced:
    """A piece of a record as NIFO needs it: force, modal coordinate with two derivatives, penetrations, in rows."""

    equation: ModalEquation
    rows: Float[np.ndarray, "rows samples"]
    closed: Float[np.ndarray, " contacts"]


def needed_s(block_s: float) -> float:
    """What 40 blocks with half overlap cover."""
    return block_s * (1 + (AVERAGES - 1) / 2)


def estimated(study: Study) -> Outcome:
    """Simulates the record with the modal plant, reduces it piece by piece to the modal equation, and applies NIFO."""
    rig = study.rig
    found = [reduced(rig, piece) for piece in _pieces(study)]
    rows = np.concatenate([r.rows for r in found], axis=1)
    estimates = []
    for block_s in study.block_s:
        force_n, q, velocity, acceleration, *penetrations_m = rows[
            :, : round((QUIET_S + needed_s(block_s)) * REDUCED_HZ)
        ]
        averaging = Averaging(averages=AVERAGES, block_s=block_s)
        cut = blocks(force_n.size, REDUCED_HZ, averaging, (study.settings.low_hz, study.settings.high_hz))
        equation = replace(found[0].equation, displacement=q, velocity=velocity, acceleration=acceleration)
        for form in FORMS:
            estimates += _estimates(rig, nifo(equation, force_n, np.array(penetrations_m), cut, form), form, block_s)
    closed = np.mean([r.closed for r in found], axis=0).tolist()
    return Outcome(tuple(estimates), tuple(c.name for c in rig.contacts), tuple(closed))


def reduced(rig: Rig, delivered: Float[np.ndarray, "channels samples"]) -> Reduced:
    """A piece of a record: its force and displacements, with the margins that are left out of what comes back."""
    channels, rate = channel_groups(rig), rig.sample_rate_hz
    signals = {"force": delivered[:1], "displacement": delivered[1:]}
    recording = Recording(rig, {name: Signals(channels[name], 0.0, rows) for name, rows in signals.items()}, {})
    motion = kinematics(recording, "displacement")
    eta_m = relative_displacements(rig, motion)
    depth_m = np.array(
        [
            penetration(eta, contact.law.lower_clearance_m, contact.law.upper_clearance_m)
            for eta, contact in zip(eta_m, rig.contacts, strict=True)
        ]
    )
    stiffness = np.array([[contact.law.stiffness_n_per_m] for contact in rig.contacts])
    cleaned = without_higher_modes(rig, motion, stiffness * depth_m)
    equation = modal_equations(rig, cleaned, rig.body(BODY))[MODE - 1]
    mode = equation.displacement, equation.velocity, equation.acceleration
    wide = np.stack([cleaned.force_n, *mode, *depth_m[:, : cleaned.force_n.size]])
    rows = decimated(wide, round(rate / REDUCED_HZ))[:, _own(REDUCED_HZ)].copy()  # no view that holds the piece
    clearances = np.array([[contact.law.clearance_m] for contact in rig.contacts])
    return Reduced(
        equation=replace(equation, displacement=rows[1], velocity=rows[2], acceleration=rows[3]),
        rows=rows,
        closed=np.mean(np.abs(eta_m[:, _own(rate)]) > clearances, axis=1),
    )


def _own(rate_hz: float) -> slice:
    """A piece without its margins."""
    return slice(round(MARGIN_S * rate_hz), round((MARGIN_S + PIECE_S) * rate_hz))


def _pieces(study: Study) -> Iterator[Float[np.ndarray, "channels samples"]]:
    """Force and displacements of the record, from the plant through the sensors, piece by piece with margins."""
    settings, rig = study.settings, study.rig
    margin, own = round(MARGIN_S * rig.sample_rate_hz), round(PIECE_S * rig.sample_rate_hz)
    duration_s = needed_duration_s(rig, study.pieces * PIECE_S + MARGIN_S)
    force_n = force_course(settings.force(), duration_s, settings.step_s)
    moved = modal.simulate(rig, force_n, settings.step_s, lambda _: None)
    held, size = [np.zeros((1 + len(rig.sensors), margin))], margin
    for block in digitised(rig, moved, np.random.default_rng(settings.seed)):
        held.append(np.vstack([block.force_n, block.sensed["displacement"]]))
        size += block.force_n.size
        if size >= own + 2 * margin:
            rows = np.concatenate(held, axis=1)
            yield rows[:, : own + 2 * margin]
            held, size = [rows[:, own:]], size - own


def _estimates(rig: Rig, result: Nifo, form: Form, block_s: float) -> list[Estimate]:
    return [
        Estimate(
            form=form,
            block_s=block_s,
            contact=rig.contacts[j].name,
            true_n_per_m=rig.contacts[j].law.stiffness_n_per_m,
            mean_n_per_m=float(mean),
            error_n_per_m=float(error),
            spread_n_per_m=float(spread),
        )
        for j, mean, error, spread in zip(
            result.contacts, result.mean_n_per_m, result.stiffness_error_n_per_m, result.spread_n_per_m, strict=True
        )
    ]
