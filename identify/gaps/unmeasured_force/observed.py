"""The linear residual as the search for an unmeasured force sees it: whitened, with what is never known exactly along.

At every line the sensors' accelerations A, in standard deviations sigma, obey

    N^H (A - G_F F) / sigma = r = D theta + g f + e

N spans what the contacts' forces (and a base motion's) cannot reach, so that these stay free. G are accelerances, F the
measured force, f the unknown one. The noise of the force channel, of variance S_F a line, is whitened (of several
forces, each):
cov(e) = s (I + S_F g_F g_F^H), with s free in bands of 2 Hz. The nuisance columns D are frequency and damping of each
mode, gain and place of each sensor and the gain of the force, each by one tolerance, about the *measured* modal
accelerations q'' = Phi^+ (A - Phi_high q''_high): about the modelled ones they would lack what the unknown force does.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Complex, Float, Int

from identify.gaps.residual.linear import Linear, linear_model
from identify.gaps.residual.record import Record
from identify.linear.model import Response
from identify.linear.nuisance import Nuisance
from identify.linear.projection import complement
from identify.signals.beginning import NORMAL_BY_MEDIAN
from identify.signals.kinematics import taper
from rig.errors import RigError
from rig.model.description import Rig, Station

BAND_HZ = 2.0
FALL_S = 0.5
LOWEST_HZ = 0.75
"""Below, integration falsifies every motion."""
WELL_SEEN = 1e-2
"""Motion that the sensors show by less than this share of what they show best is left to the model."""


@dataclass(frozen=True)
class WhitenedRecord:
    """The whitened residual r (lines, rows) and nuisance columns D (columns, lines, rows) of a record.

    basis turns standardised accelerations into rows; squares, crossed and gram are |r|^2, Re D^H r and Re D^H D summed
    over each band of 2 Hz, which starts at the line in `starts`. count is how many independent real values a line's
    complex one stands for. force_modes are the principal directions of the force channels' noise, force_shares what
    whitening takes off each.
    """

    record: Record
    model: Linear
    lines: slice
    basis: Complex[np.ndarray, "lines rows sensors"]
    force_modes: Complex[np.ndarray, "lines rows modes"]
    force_shares: Float[np.ndarray, "lines modes"]
    residual: Complex[np.ndarray, "lines rows"]
    parameters: tuple[Nuisance, ...]
    columns: Complex[np.ndarray, "columns lines rows"]
    modal: tuple[Complex[np.ndarray, "_ alllines"], ...]
    starts: Int[np.ndarray, " bands"]
    squares: Float[np.ndarray, " bands"]
    crossed: Float[np.ndarray, "bands columns"]
    gram: Float[np.ndarray, "bands columns columns"]
    trace: Float[np.ndarray, " columns"]

    @property
    def omega(self) -> Float[np.ndarray, " lines"]:
        return self.record.omega[self.lines]

    @property
    def rows(self) -> int:
        return self.residual.shape[1]

    @property
    def count(self) -> float:
        """Count of the independent real values that a line's complex one stands for."""
        return 2.0 * float(np.sum(self.gate**2)) * self.record.factor / self.record.length

    @cached_property
    def gate(self) -> Float[np.ndarray, " alltimes"]:
        """One where the residual counts, falling smoothly to zero where the record's ends falsify it."""
        taken, record = self.record.taken, self.record
        gate = np.zeros(record.length // record.factor)
        shape = taper(taken.stop - taken.start, round(FALL_S * record.rate_hz))
        gate[taken] = shape if taken.start == 0 else shape * shape[::-1]
        return gate

    @property
    def sizes(self) -> Int[np.ndarray, " bands"]:
        """Lines in each band."""
        return np.diff(np.append(self.starts, self.residual.shape[0]))

    def on_lines(self, by_band: Float[np.ndarray, " bands"]) -> Float[np.ndarray, " lines"]:
        return np.repeat(by_band, self.sizes)

    def seen(self, accelerations: Complex[np.ndarray, "sensors alllines"]) -> Complex[np.ndarray, "lines rows"]:
        """Whitened residual of accelerations at the sensors, without the gate."""
        return self.whitened(
            self.rowed((self.model.sensor_response * accelerations / self.model.deviation)[:, self.lines])
        )

    def gated(self, standard: Complex[np.ndarray, "sensors alllines"]) -> Complex[np.ndarray, "lines rows"]:
        """Standardised deliveries of the sensors as rows of the whitened residual."""
        record = self.record
        free = np.zeros_like(standard)
        free[:, self.lines] = (self.basis.conj().transpose(0, 2, 1) @ self.rowed(standard[:, self.lines])[:, :, None])[
            :, :, 0
        ].T
        length = record.length // record.factor
        history = np.fft.irfft(free, length) * self.gate
        return self.whitened(self.rowed(np.fft.rfft(history)[:, self.lines]))

    def rowed(self, standard: Complex[np.ndarray, "sensors lines"]) -> Complex[np.ndarray, "lines rows"]:
        return np.asarray((self.basis @ standard.T[:, :, None])[:, :, 0])

    def whitened(self, rows: Complex[np.ndarray, "lines rows"]) -> Complex[np.ndarray, "lines rows"]:
        along = np.einsum("lrm,lr->lm", self.force_modes.conj(), rows)
        return np.asarray(rows - np.einsum("lrm,lm->lr", self.force_modes, self.force_shares * along))

    def accelerance(self, station: Station) -> Complex[np.ndarray, "sensors alllines"]:
        """Accelerations at the sensors by a force at a place."""
        found = np.zeros(self.model.sensor_response.shape, dtype=complex)
        places: list[Station | None] = [s.station for s in self.record.sensors]
        for response in self.model.responses:
            if response.body.name == station.body:
                weights = response.shapes(places) * response.shapes([station])[0]
                found += (weights @ np.ascontiguousarray(response.accelerance).view(float)).view(complex)
        return found

    def motion(self, station: Station) -> Complex[np.ndarray, " alllines"]:
        """The acceleration at a place: of the modes that the sensors show as measured, of the others as modelled."""
        for response, modal in zip(self.model.responses, self.modal, strict=True):
            if response.body.name == station.body:
                return np.asarray(response.shapes([station])[0] @ modal)
        raise KeyError(station.body)


def bare_residual(record: Record, rig: Rig) -> WhitenedRecord:
    """The residual of a rig's linear part against a record, without nuisance columns.

    Raises RigError if the contacts' free forces explain all that the sensors give.
    """
    silent = np.zeros_like(record.force_noise)  # that of the forces is whitened below; unmeasured ones are windowed
    record = replace(record, noise=plain_noise(record), force_noise=silent, windows_responses=False)
    model = linear_model(record, rig, record.tolerances.unmodelled)
    lines = slice(int(np.searchsorted(record.omega, 2 * np.pi * LOWEST_HZ)), record.omega.size)
    basis = complement(model.by_input[..., lines])
    rows = basis.shape[1]
    if not rows:
        raise RigError(
            f"{len(record.sensors)} sensors and {len(model.rig.contacts)} contacts leave nothing that could show an "
            "unmeasured force; add a sensor"
        )
    count, starts = basis.shape[0], _bands(record.omega[lines])
    modal = tuple(
        _measured(record, model, response, motion)
        for response, motion in zip(model.responses, model.modal, strict=True)
    )
    bare = WhitenedRecord(
        record=record,
        model=model,
        lines=lines,
        basis=basis,
        force_modes=np.zeros((count, rows, 0), dtype=complex),
        force_shares=np.zeros((count, 0)),
        residual=np.zeros((count, rows), dtype=complex),
        parameters=(),
        columns=np.zeros((0, count, rows), dtype=complex),
        modal=modal,
        starts=starts,
        squares=np.zeros(starts.size),
        crossed=np.zeros((starts.size, 0)),
        gram=np.zeros((starts.size, 0, 0)),
        trace=np.zeros(0),
    )
    pushed = np.stack([bare.seen(bare.accelerance(at) / rig.force_sensor.gain) for at in rig.forces], axis=2)
    modes, sizes, _ = np.linalg.svd(pushed * np.sqrt(force_noise(record)), full_matrices=False)
    whole = replace(bare, force_modes=modes, force_shares=1 - 1 / np.sqrt(1 + sizes**2))
    return replace(whole, residual=whole.gated(model.residual[: len(record.sensors)]))


def with_columns(
    bare: WhitenedRecord,
    parameters: tuple[Nuisance, ...],
    columns: Complex[np.ndarray, "columns lines rows"],
    trace: Float[np.ndarray, " columns"],
) -> WhitenedRecord:
    """Observation with these columns and the sums over bands. The columns are kept in single precision."""
    own = np.ascontiguousarray(bare.residual).view(float)
    ends = np.append(bare.starts, own.shape[0])
    squares, crossed, gram = [], [], []
    for first, last in pairwise(ends):
        part = np.ascontiguousarray(columns[:, first:last], dtype=complex).view(float).reshape(len(columns), -1)
        rest = own[first:last].ravel()
        squares.append(rest @ rest)
        crossed.append(part @ rest)
        gram.append(part @ part.T)
    return replace(
        bare,
        parameters=parameters,
        columns=columns.astype(np.complex64),
        squares=np.array(squares),
        crossed=np.array(crossed),
        gram=np.array(gram),
        trace=trace,
    )


def plain_noise(record: Record) -> Float[np.ndarray, "sensors lines"]:
    """The sensors' noise, no more than described: a force that works before the excitation begins is no noise."""
    found = record.noise.copy()
    for i, sensor in enumerate(record.sensors):
        if sensor.noise_density > 0:
            size = sensor.noise_density * record.omega ** (2 - sensor.measures.order)
            found[i] = np.minimum(found[i], record.samples * size**2 * record.sample_rate_hz / 2)
    return found


def force_noise(record: Record) -> Float[np.ndarray, " forces"]:
    """Variance of each line of the measured forces by their channels' noise: what the quiet start or the lines above
    the force's band show, whichever is less."""
    upper = np.abs(record.forces[:, record.omega.size // 2 :]) ** 2
    found = np.median(upper, axis=1) / np.log(2)
    quiet = record.time_s < record.excited_s - 0.05
    if np.count_nonzero(quiet) > 0.2 * record.rate_hz:
        size_n = NORMAL_BY_MEDIAN * np.median(np.abs(record.in_time(record.forces)[:, quiet]), axis=1)
        found = np.minimum(found, record.samples * size_n**2 * record.sample_rate_hz / record.rate_hz)
    return np.asarray(found)


def inverse_of(record: Record, response: Response) -> Float[np.ndarray, "low sensors"]:
    """Inverse from accelerations at the sensors to those of the lowest modes, one a sensor of the body."""
    rows = [i for i, s in enumerate(record.sensors) if s.station.body == response.body.name]
    low = min(len(rows), response.count)
    found = np.zeros((low, len(record.sensors)))
    if low:
        shapes = response.shapes([record.sensors[i].station for i in rows])[:, :low]
        found[:, rows] = np.linalg.pinv(shapes, rcond=WELL_SEEN)
    return found


def _measured(
    record: Record, model: Linear, response: Response, modelled: Complex[np.ndarray, "modes lines"]
) -> Complex[np.ndarray, "modes lines"]:
    """Modal accelerations: the lowest by the sensors, the others, and what the sensors show too badly, as modelled."""
    inverse = inverse_of(record, response)
    low = len(inverse)
    rest = record.delivered / model.sensor_response - response.shapes([s.station for s in record.sensors]) @ modelled
    return np.concatenate([modelled[:low] + inverse @ rest, modelled[low:]])


def _bands(omega: Float[np.ndarray, " lines"]) -> Int[np.ndarray, " bands"]:
    """The first line of each band."""
    number = np.floor(omega / (2 * np.pi * BAND_HZ)).astype(int)
    return np.flatnonzero(np.diff(number, prepend=-1))
