"""Records that are refused, and the same with the remedy done as it says, by code and remedy."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace

from identify.contacts.refusals import RefusalCode, RemedyCode
from rig.model.contact_laws import ContactLaw
from rig.model.contact_laws.spring import Spring
from rig.model.description import BaseMotion, PointDamper, Rig
from rig.recording import Recording, read
from rig.simulation.reference import BarrelCradleAnnular
from tests.campaigns import laboratory_tests
from tests.campaigns.topologies import NOISE, Topology, frame, one_mass, progressive_stop, recorded

Maker = Callable[[Path], Recording]


def made(
    believed: Rig,
    rms_n: float = 20.0,
    duration_s: float = 12.0,
    without_s: float = 0.0,
    of: Rig | None = None,
    change: Callable[[Recording], Recording] = lambda recording: recording,
) -> Maker:
    """Recording of a rig (of another one than rig.json says, if given) less its first seconds, then changed."""

    def make(folder: Path) -> Recording:
        actual = of or believed
        path = recorded(Topology(actual, rms_n, ""), folder / "r.mcap", duration_s=duration_s + without_s)
        recording = dataclasses.replace(read(path), rig=believed)
        return change(cut(recording, without_s))

    return make


def cut(recording: Recording, without_s: float) -> Recording:
    first = round(without_s * recording.rig.sample_rate_hz)
    return with_rows(recording, {name: s.values[:, first:] for name, s in recording.signals.items()})


def with_rows(recording: Recording, rows: dict[str, Any]) -> Recording:
    signals = {
        name: dataclasses.replace(s, values=np.ascontiguousarray(rows.get(name, s.values)))
        for name, s in recording.signals.items()
    }
    return dataclasses.replace(recording, signals=signals)


def silent(*names: str) -> Callable[[Recording], Recording]:
    """Channels of these quantities are dead; all if none is named."""
    return lambda r: with_rows(r, {n: 0.0 * s.values for n, s in r.signals.items() if not names or n in names})


def laboratory(test: laboratory_tests.Test, duration_s: float = 14.0) -> Maker:
    return lambda folder: laboratory_tests.recorded(test, folder / "r.mcap", duration_s=duration_s)


def one(quantity: str, **given: Any) -> Rig:
    return one_mass(4e-4, quantity=quantity, **given)


def with_law(rig: Rig, law: ContactLaw, count: int = 1) -> Rig:
    """The rig with this law in place of its contact's, or so many of them."""
    (contact,) = rig.contacts
    return replace(rig, contacts=tuple(replace(contact, name=f"c{k}", law=law) for k in range(count)))


def with_sensors(rig: Rig, **given: float) -> Rig:
    return replace(rig, sensors=tuple(replace(sensor, **given) for sensor in rig.sensors))


def framed(quantity: str, count: int) -> Rig:
    """A frame with sensors at the first floors alone."""
    rig = frame(3.0)
    sensors = tuple(replace(s, quantity=quantity, noise_density=NOISE[quantity]) for s in rig.sensors[:count])
    return replace(rig, sensors=sensors)


@dataclass(frozen=True)
class Case:
    """A record that is refused by a code with a remedy, and records in which that has been done."""

    code: RefusalCode
    remedy: RemedyCode
    refused: Maker
    mended: dict[str, Maker]


D, A = one("displacement"), one("acceleration")
RING = BarrelCradleAnnular(sensors="acceleration", noise_density=1e-3).rig()
FREE = one("acceleration", frequency_hz=0.0, damping_ratio=0.0)
ONE_SIDED = replace(FREE.contacts[0].law, lower_clearance_m=np.inf)
STRUT = Spring(stiffness_n_per_m=8e3, damping_n_s_per_m=5.0)
DAMPED = replace(A, dampers=(PointDamper(station=A.force_at, damping_n_s_per_m=2.0),))
NOISY = with_sensors(FREE, noise_density=3e-2)
SHAKEN = BaseMotion(acceleration_rms_m_per_s2=1.0, low_hz=1.0, high_hz=15.0)
BUMPER = progressive_stop("displacement")
ALIKE, COINCIDENT = (
    progressive_stop("displacement", *laws) for laws in (((7e-4, 3e4), (6.5e-4, 3e4)), ((7e-4, 8e3), (7e-4, 5e4)))
)
UNREACHED = progressive_stop("displacement", (2e-4, 8e3), (3e-3, 1e5))
FORCED, SHAKEN_MASS, LET_GO = (
    laboratory_tests.TESTS[f"one mass, {name}"]
    for name in ("Gaussian force", "base excitation, motion against the base", "free decay, no force measured")
)

CASES = {
    "no contact": Case(
        RefusalCode.NO_CONTACTS,
        RemedyCode.DESCRIBE_CONTACTS,
        made(replace(D, contacts=()), of=D),
        {"described": made(D)},
    ),
    "a damper to the ground in rig.json": Case(
        RefusalCode.NOT_MODELLED, RemedyCode.LEAVE_OUT_ATTACHMENTS, made(DAMPED), {"left out": made(A, of=DAMPED)}
    ),
    "a base that shakes": Case(
        RefusalCode.BASE_MOTION,
        RemedyCode.MEASURE_BASE,
        made(replace(A, base_motion=SHAKEN)),
        {"motion against the base": laboratory(SHAKEN_MASS)},
    ),
    "a ring with sensors in one direction": Case(
        RefusalCode.ONE_DIRECTION,
        RemedyCode.MEASURE_BOTH_DIRECTIONS,
        made(replace(RING, sensors=tuple(s for s in RING.sensors if s.station.direction == "y")), 60.0),
        {"in both": made(RING, 60.0)},
    ),
    "no displacement sensor at a contact": Case(
        RefusalCode.NO_SENSOR,
        RemedyCode.ADD_SENSOR,
        made(framed("displacement", 3), 60.0, 8.0),
        {"one there": made(framed("displacement", 4), 60.0, 8.0)},
    ),
    "no accelerometer at a contact": Case(
        RefusalCode.NO_ACCELEROMETER,
        RemedyCode.ADD_ACCELEROMETER,
        made(framed("acceleration", 3), 60.0),
        {"one there": made(framed("acceleration", 4), 60.0)},
    ),
    "a short record that begins in motion": Case(
        RefusalCode.TOO_SHORT,
        RemedyCode.RECORD_LONGER_OR_FROM_REST,
        made(D, duration_s=1.2, without_s=3.0),
        {"longer": made(D, duration_s=10.0, without_s=3.0), "from rest": made(D, duration_s=3.0)},
    ),
    "dead channels": Case(
        RefusalCode.ALL_ZERO, RemedyCode.CHECK_CHANNELS, made(D, change=silent()), {"alive": made(D)}
    ),
    "a force that was not recorded": Case(
        RefusalCode.FORCE_NOT_RECORDED,
        RemedyCode.RECORD_FORCE_OR_RELEASE,
        laboratory(dataclasses.replace(FORCED, unforced=True)),
        {"recorded": laboratory(FORCED), "released": laboratory(LET_GO)},
    ),
    "two springs at one place": Case(
        RefusalCode.TOO_MANY_CONTACTS,
        RemedyCode.DESCRIBE_FEWER_CONTACTS,
        made(with_law(D, STRUT, 2)),
        {"one, their sum": made(with_law(D, STRUT), of=with_law(D, STRUT, 2))},
    ),
    "a dead displacement sensor": Case(
        RefusalCode.STANDS_STILL,
        RemedyCode.CHECK_DISPLACEMENT_SENSOR,
        made(D, change=silent("displacement")),
        {"alive": made(D)},
    ),
    "a weak force": Case(
        RefusalCode.HARDLY_CLOSES, RemedyCode.EXCITE_MORE_OR_QUIETER, made(A, 0.5), {"stronger": made(A, 4.0)}
    ),
    "a noisy displacement sensor": Case(
        RefusalCode.HARDLY_CLOSES,
        RemedyCode.EXCITE_MORE_OR_QUIETER,
        made(with_sensors(D, noise_density=1e-6)),
        {"a quieter one": made(D)},
    ),
    "a stop that never opens": Case(
        RefusalCode.UNCERTAIN,
        RemedyCode.RECORD_LONGER_OR_EXCITE_MORE,
        made(D, of=with_law(D, STRUT)),
        {"described as a spring": made(with_law(D, STRUT), of=with_law(D, STRUT))},
    ),
    "a stop that never opens, by accelerometers": Case(
        RefusalCode.UNCERTAIN,
        RemedyCode.RECORD_LONGER_OR_OTHER_FORCE,
        made(A, of=with_law(A, STRUT)),
        {"described as a spring": made(with_law(A, STRUT), of=with_law(A, STRUT))},
    ),
    "a stop behind another that is not reached": Case(
        RefusalCode.NOT_REACHED, RemedyCode.EXCITE_MORE, made(UNREACHED, 4.0), {"stronger": made(UNREACHED, 60.0)}
    ),
    "a stop on one side, by accelerometers": Case(
        RefusalCode.ONE_STOP_TOUCHED,
        RemedyCode.EXCITE_MORE_OR_DISPLACEMENTS,
        made(with_law(FREE, ONE_SIDED), 6.0),
        {"displacements": made(with_law(one("displacement", frequency_hz=0.0, damping_ratio=0.0), ONE_SIDED), 6.0)},
    ),
    "accelerometers noisier than rig.json says": Case(
        RefusalCode.DRIFT_TOO_LARGE,
        RemedyCode.CHECK_NOISE_OR_EXCITE_MORE,
        made(FREE, 4.0, of=NOISY),
        {"noise as it is": made(NOISY, 4.0), "stronger": made(FREE, 40.0, of=NOISY)},
    ),
    "stops whose knees coincide": Case(
        RefusalCode.NOT_SEPARABLE,
        RemedyCode.EXCITE_MORE_OR_SEPARATE_STOPS,
        made(COINCIDENT, 12.0),
        {"stops that differ more": made(BUMPER, 12.0)},
    ),
    "stops that are believed alike": Case(
        RefusalCode.INTERCHANGEABLE,
        RemedyCode.SEPARATE_STOPS,
        made(ALIKE, 12.0, of=BUMPER),
        {"told apart in rig.json": made(BUMPER, 12.0)},
    ),
    "a spring described as a stop": Case(
        RefusalCode.NO_GAP,
        RemedyCode.DESCRIBE_SPRING,
        made(one_mass(0.0), of=with_law(D, STRUT)),
        {"described as a spring": made(with_law(D, STRUT))},
    ),
}
"""One case a code and remedy that one mass or a frame shows."""
WITHOUT_CASE = {
    RemedyCode.EXCITE_MORE_OR_CHECK_RIG: "no record of these rigs is refused so",
    RemedyCode.RECORD_LONGER_FROM_REST_OR_DISPLACEMENTS: "accelerometers' records of one mass are refused before, by "
    "what integration leaves of them",
}
"""Remedies that no simulated record here asks for, and why."""
