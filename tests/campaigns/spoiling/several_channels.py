"""Faults of several channels, of the force, of clocks, and what other programs do to a record."""

from collections.abc import Iterator
from functools import partial

import numpy as np
from scipy.signal import butter, cheby1, sosfilt, sosfiltfilt

from identify.checks.findings import Cause
from rig.model.description import Rig
from tests.campaigns.spoiling import rows
from tests.campaigns.spoiling.alteration import Alteration, G, delayed, mapped, with_rows


def of_several(rig: Rig, rng: np.random.Generator) -> Iterator[Alteration]:
    names, rate = tuple(s.name for s in rig.sensors), rig.sample_rate_hz
    everything: frozenset[Cause] = frozenset({"units", "gain", "mass"})
    yield Alteration("all sensors in g", mapped(names, lambda r: r / G), frozenset({"units"}))
    yield Alteration("all sensors x 1000", mapped(names, lambda r: 1e3 * r), frozenset({"units"}))
    yield Alteration("all sensors 5 % too large", mapped(names, lambda r: 1.05 * r), everything)
    yield Alteration("all polarities turned", mapped(names, lambda r: -r), frozenset({"polarity"}))
    yield Alteration(
        "hum of 10 % in phase",
        mapped(names, lambda r: r + rows.tone(r, 50.0, rate, 0.1)),
        frozenset({"hum"}),
        names,
        group="cables",
    )
    if len(rig.bodies) > 1:
        body = str(rng.choice([b.name for b in rig.bodies]))
        own = tuple(s.name for s in rig.sensors if s.station.body == body)
        yield Alteration("one body's sensors in g", mapped(own, lambda r: r / G), frozenset({"units"}), own, (body,))
        yield Alteration(
            "one body's polarities turned", mapped(own, lambda r: -r), frozenset({"polarity"}), own, (body,)
        )
        yield Alteration(
            "one body's sensors 1 ms late",
            mapped(own, lambda r: delayed(r, 1e-3, rate)),
            frozenset({"delay"}),
            (*own, "force"),
            (body,),
            group="clock",
        )
        yield Alteration(
            "one body's sensors 5 % too large",
            mapped(own, lambda r: 1.05 * r),
            frozenset({"gain", "mass"}),
            own,
            (body,),
        )


def of_the_force(rig: Rig, rng: np.random.Generator) -> Iterator[Alteration]:
    rate, names = rig.sample_rate_hz, [s.name for s in rig.sensors]
    force = ("force",)
    yield Alteration("force turned", mapped(force, lambda r: -r), frozenset({"polarity"}), force)
    yield Alteration("force in kN", mapped(force, lambda r: 1e-3 * r), frozenset({"units"}))
    yield Alteration("force in pounds", mapped(force, lambda r: r / 4.4482216), frozenset({"units"}))
    yield Alteration("force 10 % too large", mapped(force, lambda r: 1.1 * r), frozenset({"gain", "mass"}))
    yield Alteration(
        "force 1 ms late", mapped(force, lambda r: delayed(r, 1e-3, rate)), frozenset({"delay"}), force, group="clock"
    )
    other = str(rng.choice(names))
    yield Alteration(
        "force taken from another channel",
        lambda r: with_rows(r, {"force": r[other].values}),
        frozenset({"force", "copy"}),
        ("force", other),
        group="cables",
    )
    yield Alteration(
        "force of another record",
        mapped(force, lambda r: np.r_[np.zeros(r.size // 20), r[r.size // 20 :][::-1]]),
        frozenset({"force"}),
        force,
        group="processing",
    )
    yield Alteration(
        "force clipped",
        mapped(force, lambda r: np.clip(r, -1.2 * r.std(), 1.2 * r.std())),
        frozenset({"clipped"}),
        force,
    )
    yield Alteration(
        "force low-passed",
        mapped(force, lambda r: sosfilt(butter(2, 40, fs=rate, output="sos"), r)),
        frozenset({"filtered", "delay", "force"}),
        force,
        group="processing",
    )


def of_clocks(rig: Rig) -> Iterator[Alteration]:
    names, rate = (*(s.name for s in rig.sensors), "force"), rig.sample_rate_hz
    for share, said in ((0.01, "1 % fast"), (-0.02, "2 % slow"), (0.005, "0.5 % fast")):
        yield Alteration(
            f"clock {said}",
            mapped(names, partial(rows.stretched, factor=1 + share)),
            frozenset({"clock", "frequency"} if len(rig.bodies) == 1 else {"clock"}),
            group="clock",
        )
    yield Alteration(
        "samples lost in all channels",
        mapped(names, lambda r: np.r_[r[: r.size // 2], r[r.size // 2 + int(0.05 * rate) :]]),
        frozenset({"jump"}),
        group="clock",
    )
    yield Alteration(
        "the first seconds cut off",
        mapped(names, lambda r: r[int(4 * rate) :]),
        frozenset({"not at rest"}),
        group="processing",
    )


def of_processing(rig: Rig) -> Iterator[Alteration]:
    names, rate = tuple(s.name for s in rig.sensors), rig.sample_rate_hz
    group = "processing"
    yield Alteration(
        "all sensors low-passed at 60 Hz",
        mapped(names, lambda r: sosfilt(butter(2, 60, fs=rate, output="sos"), r)),
        frozenset({"filtered", "delay", "force"}),
        (*names, "force"),
        group=group,
    )
    yield Alteration(
        "all low-passed without phase at 60 Hz",
        mapped(names, lambda r: sosfiltfilt(cheby1(2, 0.5, 60, fs=rate, output="sos"), r)),
        frozenset({"filtered", "force"}),
        (*names, "force"),
        group=group,
    )
    yield Alteration(
        "all sensors smoothed over 5 ms",
        mapped(names, lambda r: np.convolve(r, np.ones(int(0.005 * rate)) / int(0.005 * rate), "same")),
        frozenset({"filtered", "force"}),
        (*names, "force"),
        group=group,
    )
    if len(names) > 1:
        yield Alteration(
            "each channel over its own rms",
            mapped(names, lambda r: r / r.std()),
            frozenset({"units", "gain", "model"}),
            names,
            group=group,
        )
    yield Alteration(
        "time reversed",
        mapped((*names, "force"), lambda r: r[::-1].copy()),
        frozenset({"not at rest", "model"}),
        group=group,
    )
