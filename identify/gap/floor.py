"""The floor: what null recordings (of the believed rig as a laboratory builds it) leave in the same chain.

Integration, chaos, sensors and a laboratory's tolerances are in it. Made once for a rig and a simulator, it is kept.
"""

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float
from msgspec.structs import replace
from scipy.signal.windows import hann
from scipy.stats import t as student

from identify.gap.candidates import candidates, scale_of
from identify.gap.residual import Base, Residual
from identify.gap.search import looks, settled
from identify.gap.shaking import shaken
from identify.gap.spectra import Record, record_of
from identify.tolerances import jittered
from rig.description import Rig, to_json
from rig.errors import RigError
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording

NULLS = 6
"""At each level."""
BAND_HZ = 2.0
SEGMENT_S = 1.0
LEVELS = (0.45, 0.65, 0.9, 1.25)
"""Nulls are made with the largest force times these: large motion is less linear, and no two forces move alike."""
RISE_S = 0.1
MARGIN = 3.0
"""A gain counts from this multiple of the largest that a null recording showed for that effect."""
NOTHING = 1e-3
"""A smaller mean square is none: so many contacts as sensors leave no linear residual."""
EXACT = 0.01
"""No law is believed to leave less than this of the mean square that its error is put at."""
ORDINARY = 2.0
"""So many standard deviations of a tolerance are ordinary."""
FALSE_ALARMS = 0.05
"""So often may a null exceed one of the four limits, were they independent."""
LEAST_SPREAD = 0.1
"""Logarithms of remainders scatter by this much at least."""

Simulate = Callable[[Rig, Rig, Float[np.ndarray, " samples"], int], Recording]
"""The recording of the believed rig (first) that the actual one makes under a measured force, noise from a seed: the
simulator that the diagnosis is handed."""


class Floor(msgspec.Struct, frozen=True):
    """Mean squares of null residuals by band (2 Hz) and sensor, and by contact; what their remainders and gains reach.

    It is that of motions up to motion_m (root mean square). limits are those of a null's `Remainder`: overall, in the
    worst band, in the worst contact, and of the largest use of a tolerance.
    """

    motion_m: float
    sensors: list[str]
    linear: list[list[float]]
    contacts: list[float]
    limits: tuple[float, float, float, float]
    gains: dict[str, float]


class Floors(msgspec.Struct, frozen=True):
    """The floors of a rig, the smallest motion first: the larger it is, the less linear."""

    rig_sha256: str
    nulls: int
    levels: list[Floor]

    def of(self, record: Record) -> Floor:
        """The first level that holds a motion as large as a record's, or the last one."""
        large = [f for f in self.levels if f.motion_m >= record.motion_m]
        return large[0] if large else self.levels[-1]

    def hold(self, record: Record) -> bool:
        """Whether nulls moved as much as a record."""
        return record.motion_m <= self.levels[-1].motion_m


class Remainder(msgspec.Struct, frozen=True):
    """A residual in units of the floor: overall, in the worst 2 Hz, in the worst contact.

    strain is how far the worst tolerance is used, in its standard deviations.
    """

    overall: float
    band: float
    contact: float
    strain: float

    @property
    def each(self) -> tuple[float, float, float, float]:
        return self.overall, self.band, self.contact, self.strain

    @property
    def size(self) -> float:
        """The larger of the linear and the contact part."""
        return max(self.overall, self.contact)

    def at_floor(self, floor: Floor) -> bool:
        """Whether each is within its limit."""
        return all(mine <= limit for mine, limit in zip(self.each, floor.limits, strict=True))


def remainder(base: Base, at: Residual, floor: Floor) -> Remainder:
    """What a residual leaves, by the floor; the base must know the floor's levels of the contacts."""
    own = [floor.sensors.index(s.name) for s in base.record.sensors]
    levels = band_levels(base.record, at)
    nulls = np.maximum(np.array(floor.linear)[:, own], NOTHING)
    bands = min(len(levels), len(nulls))
    linear = levels[:bands] / nulls[:bands]
    return Remainder(
        float(linear.mean()),
        float(linear.mean(axis=1).max(initial=0.0)),
        max(contact_levels(base, at), default=0.0),
        at.strain,
    )


def band_levels(record: Record, at: Residual) -> Float[np.ndarray, "bands sensors"]:
    """Mean square of the linear residual in bands of 2 Hz: the median over seconds, as large motion comes in bursts."""
    rows = at.linear[: len(record.sensors)]
    length = round(SEGMENT_S * record.rate_hz)
    count = rows.shape[1] // length
    pieces = rows[:, : count * length].reshape(len(rows), count, length)
    weights = hann(length, sym=False)
    power = np.median(np.abs(np.fft.rfft(pieces * weights)) ** 2, axis=1) / np.sum(weights**2)
    wide = round(BAND_HZ * SEGMENT_S)
    bands = power.shape[1] // wide
    return np.asarray(power[:, : bands * wide].reshape(len(rows), bands, wide).mean(axis=2).T)


def contact_levels(base: Base, at: Residual) -> list[float]:
    """Mean square of each contact's residual: the median over seconds."""
    length = round(SEGMENT_S * base.record.rate_hz)
    found = []
    for contact, seen in zip(at.contacts, base.seen, strict=True):
        squares = contact.residual[: seen.weights.size] ** 2
        count = squares.size // length
        found.append(float(np.median(squares[: count * length].reshape(count, length).mean(axis=1))))
    return found


def floors_of(
    rig: Rig,
    force_n: Float[np.ndarray, " samples"],
    simulate: Simulate,
    progress: Callable[[float], None],
    kept: Path | None = None,
    tolerances: Tolerances = LABORATORY,
    nulls: int = NULLS,
) -> Floors:
    """The floors of a rig by a simulator, for records under forces up to such a one; read from the file `kept`, if one
    is given and is there.

    Raises RigError if that file is of another rig.
    """
    if kept and kept.exists():
        return read_floors(kept, rig)
    records = []
    for i, times in enumerate(LEVELS):
        for k in range(nulls):
            rng = np.random.default_rng([i, k, 77])
            force = times * another(force_n, rig.sample_rate_hz, rng)
            made = simulate(rig, jittered(rig, rng), force, i * nulls + k)
            records.append(record_of(made, tolerances=tolerances))
            progress(0.6 * len(records) / (nulls * len(LEVELS)))
    records.sort(key=lambda r: r.motion_m)
    levels, left = [], []
    for first in range(0, len(records), nulls):
        level, remainders = _floor(rig, records[first : first + nulls])
        levels.append(level)
        left.append(remainders)
        progress(0.6 + 0.4 * len(levels) / len(LEVELS))
    limits = limits_of(np.array(left))
    floors = Floors(_mark(rig), nulls, [replace(f, limits=tuple(row)) for f, row in zip(levels, limits, strict=True)])
    if kept:
        kept.parent.mkdir(parents=True, exist_ok=True)
        part = kept.with_suffix(".part")
        part.write_bytes(msgspec.json.encode(floors))
        part.replace(kept)
    return floors


def another(
    force_n: Float[np.ndarray, " samples"], sample_rate_hz: float, rng: np.random.Generator
) -> Float[np.ndarray, " samples"]:
    """A force of the same spectrum and strength with other phases, after the same silence.

    How large the motion gets, and with it what is not linear, differs from one force to the next.
    """
    start = int(np.argmax(np.abs(force_n) > 0.0))
    excited = force_n[start:]
    spectrum = np.fft.rfft(excited)
    turned = np.fft.irfft(spectrum * np.exp(2j * np.pi * rng.uniform(size=spectrum.size)), excited.size)
    rise = min(round(RISE_S * sample_rate_hz), excited.size)
    turned[:rise] *= np.sin(np.linspace(0, np.pi / 2, rise)) ** 2
    return np.concatenate([force_n[:start], turned])


def limits_of(left: Float[np.ndarray, "levels nulls kinds"]) -> list[list[float]]:
    """What the remainder of one more null exceeds, of each kind, with a probability of FALSE_ALARMS over the kinds.

    The upper prediction limit of a lognormal distribution whose mean is each level's own and whose spread is common.
    """
    levels, nulls, kinds = left.shape
    logs = np.log(np.maximum(left, NOTHING))
    means = logs.mean(axis=1)
    freedom = max(1, levels * (nulls - 1))
    spread = np.sqrt(np.sum((logs - means[:, None]) ** 2, axis=(0, 1)) / freedom)
    beyond = student.ppf(1 - FALSE_ALARMS / kinds, freedom) * np.sqrt(1 + 1 / nulls)
    found: list[list[float]] = np.exp(means + beyond * np.maximum(spread, LEAST_SPREAD)).tolist()
    return found


def _floor(rig: Rig, records: Sequence[Record]) -> tuple[Floor, Float[np.ndarray, "nulls kinds"]]:
    """Of nulls of similar motion, with what is left of each; its limits are yet to be set.

    The second time the contacts are weighed by what nulls leave there.
    """
    first = [contact_levels(*settled(record, rig)) for record in records]
    mean_contact = np.maximum(np.mean(first, axis=0), EXACT).tolist()
    bands, contacts, strains = [], [], []
    gains: dict[str, float] = {}
    for record in records:
        base, at = settled(record, rig, levels=mean_contact)
        bands.append(band_levels(record, at))
        contacts.append(contact_levels(base, at))
        strains.append(at.strain)
        for kind, gain in null_gains(base, at).items():
            gains[kind] = max(gains.get(kind, 0.0), gain)
    fewest = min(len(b) for b in bands)
    levels = np.array([b[:fewest] for b in bands])
    others = (levels.sum(axis=0) - levels) / max(1, len(levels) - 1)  # each null against those that it has no part in
    relative = levels / np.maximum(others, 1e-300)
    floor = Floor(
        motion_m=max(r.motion_m for r in records),
        sensors=[s.name for s in records[0].sensors],
        linear=levels.mean(axis=0).tolist(),
        contacts=mean_contact,
        limits=(0.0, 0.0, 0.0, 0.0),
        gains=gains,
    )
    worst = [max(c, default=1.0) for c in contacts]
    kinds = (relative.mean(axis=(1, 2)), relative.mean(axis=2).max(axis=1), worst, np.maximum(strains, ORDINARY))
    return floor, np.stack(kinds, axis=1)


def read_floors(path: Path, rig: Rig) -> Floors:
    """The floors of a rig; raises RigError if the file is of another rig, or of none."""
    try:
        floors = msgspec.json.decode(path.read_bytes(), type=Floors)
    except (OSError, msgspec.DecodeError) as error:
        raise RigError(f"{path}: no floor can be read from it ({error}); remove it, and it is made anew") from error
    if floors.rig_sha256 != _mark(rig):
        raise RigError(f"{path}: is the floor of another rig; name another file, or remove it")
    return floors


def _mark(rig: Rig) -> str:
    return hashlib.sha256(to_json(rig)).hexdigest()


def null_gains(base: Base, at: Residual) -> dict[str, float]:
    """What each effect gains on a recording that has none, by its name."""
    known = candidates(scale_of(base.record, base.rig), [s.name for s in base.record.sensors], base.record.zero_known)
    gains: dict[str, float] = {}
    steady = [c for c in known if not c.kind.stochastic]
    for look in looks(base, at, steady, bounded=False):
        gains[look.candidate.kind.name] = max(gains.get(look.candidate.kind.name, 0.0), look.gain)
    for candidate in known:
        if candidate not in steady and (found := shaken(base, at, candidate)):
            gains[candidate.kind.name] = max(found.gain, 0.0)
    return gains
