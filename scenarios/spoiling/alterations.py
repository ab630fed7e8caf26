"""Ways in which instruments, cables, clocks, rig.json and other programs spoil a recording."""

from collections.abc import Iterator

import numpy as np
from msgspec.structs import replace
from scipy.signal import butter, cheby1, sosfilt, sosfiltfilt

from rig.model.beam import Beam
from rig.model.description import Body, Rig, Station
from rig.recording import Recording
from scenarios.spoiling.alteration import Alteration, Row, delayed, mapped, with_rig, with_rows, with_sensors

G = 9.80665


def alterations(rig: Rig, rng: np.random.Generator) -> Iterator[Alteration]:
    """All that a rig allows, each on channels that are drawn."""
    yield from _of_one_channel(rig, rng)
    yield from _of_several(rig, rng)
    yield from _of_the_force(rig, rng)
    yield from _of_clocks(rig, rng)
    yield from _of_description(rig, rng)
    yield from _of_processing(rig, rng)


def _of_one_channel(rig: Rig, rng: np.random.Generator) -> Iterator[Alteration]:
    names, rate = [s.name for s in rig.sensors], rig.sample_rate_hz

    def one(title, change, *causes, group="instruments"):
        name = str(rng.choice(names))
        if len(names) == 1 and {"unrelated", "gain"} & set(causes):  # nothing tells it from the force
            causes = (*causes, "force", "noise", "not at rest")
        return Alteration(title, mapped((name,), change), frozenset(causes), (name,), group=group)

    def noisy(row: Row, share: float) -> Row:
        return row + share * row.std() * np.random.default_rng(5).standard_normal(row.size)

    yield one("one polarity turned", lambda r: -r, "polarity")
    yield one("one channel dead", lambda r: np.zeros_like(r), "dead", group="cables")
    yield one("one channel dead at an offset", lambda r: np.full_like(r, 0.37), "dead", group="cables")
    yield one("one channel in g", lambda r: r / G, "units")
    yield one("one channel x 1000", lambda r: 1e3 * r, "units")
    yield one("one channel 10 % too large", lambda r: 1.1 * r, "gain")
    yield one("one channel 3 % too small", lambda r: 0.97 * r, "gain")
    yield one("one channel 1 ms late", lambda r: delayed(r, 1e-3, rate), "delay")
    yield one("one channel 0.2 ms early", lambda r: delayed(r, -2e-4, rate), "delay")
    yield one("one channel 20 ms late", lambda r: delayed(r, 2e-2, rate), "delay")
    yield one(
        "one channel clipped at half its peak", lambda r: np.clip(r, -0.5 * abs(r).max(), 0.5 * abs(r).max()), "clipped"
    )
    yield one("one channel clipped on one side", lambda r: np.minimum(r, 0.4 * r.max()), "clipped")
    yield one("one channel in coarse steps", lambda r: np.round(r / (0.1 * r.std())) * 0.1 * r.std(), "quantised")
    yield one("one channel with 20 % noise", lambda r: noisy(r, 0.2), "unrelated", "noise")
    yield one("one channel is noise", lambda r: r.std() * rng.standard_normal(r.size), "unrelated", group="cables")
    yield one("one channel offset", lambda r: r + 0.3 * r.std(), "offset")
    yield one("one channel drifts", lambda r: r + 0.5 * r.std() * np.linspace(0, 1, r.size) ** 2, "drift", "offset")
    yield one("one channel with spikes", _spiked, "spikes", group="cables")
    yield one("one channel with one large spike", _one_spike, "spikes", group="cables")
    yield one("one channel drops out for a second", lambda r: _gone(r, rate), "held samples", group="cables")
    yield one("one channel holds samples", lambda r: _held(r, rate), "held samples", group="cables")
    yield one("hum on one channel", lambda r: r + _tone(r, 50.0, rate, 0.1), "hum", group="cables")
    yield one("60 Hz hum on one channel", lambda r: r + _tone(r, 60.0, rate, 0.05), "hum", group="cables")
    yield one(
        "one channel low-passed at 60 Hz",
        lambda r: sosfilt(butter(2, 60, fs=rate, output="sos"), r),
        "filtered",
        "delay",
        group="processing",
    )
    yield one(
        "one channel high-passed at 5 Hz",
        lambda r: sosfilt(butter(1, 5, "high", fs=rate, output="sos"), r),
        "filtered",
        group="instruments",
    )
    yield one("one channel integrated", lambda r: _integrated(r, rate), "derivative", "units", group="processing")
    yield one(
        "one channel slips 20 samples",
        lambda r: np.r_[r[: r.size // 2], r[r.size // 2 + 20 :], r[-20:]],
        "slipped samples",
        "glitch",
        *(["force"] if len(names) == 1 else []),
        group="clock",
    )
    yield one("one channel wraps over", _wrapped, "spikes", "clipped", "unrelated", group="processing")
    yield one("one channel rectified", np.abs, "offset", "unrelated", "drift", group="processing")
    if len(names) > 1:
        first, second = _neighbours(rig, rng)
        yield Alteration(
            "a copy of its neighbour",
            lambda r: with_rows(r, {first: r[second].values}),
            frozenset({"copy", "station"}),
            (first, second),
        )
        a, b = _neighbours(rig, rng)
        yield Alteration(
            "a scaled copy with noise",
            lambda r: with_rows(r, {a: noisy(1.02 * r[b].values, 1e-3)}),
            frozenset({"copy", "station"}),
            (a, b),
        )
        c, d = _neighbours(rig, rng)
        yield Alteration(
            "two neighbours swapped",
            lambda r: with_rows(r, {c: r[d].values, d: r[c].values}),
            frozenset({"swapped"}),
            (c, d),
            group="cables",
        )
        e, f = (str(x) for x in rng.choice(names, 2, replace=False))
        yield Alteration(
            "two channels swapped",
            lambda r: with_rows(r, {e: r[f].values, f: r[e].values}),
            frozenset({"swapped"}),
            (e, f),
            group="cables",
        )
        g, h = (str(x) for x in rng.choice(names, 2, replace=False))
        if len(names) > 4:
            yield Alteration("two polarities turned", mapped((g, h), lambda r: -r), frozenset({"polarity"}), (g, h))


def _of_several(rig: Rig, rng: np.random.Generator) -> Iterator[Alteration]:
    names, rate = tuple(s.name for s in rig.sensors), rig.sample_rate_hz
    everything = frozenset({"units", "gain", "mass"})
    yield Alteration("all sensors in g", mapped(names, lambda r: r / G), frozenset({"units"}))
    yield Alteration("all sensors x 1000", mapped(names, lambda r: 1e3 * r), frozenset({"units"}))
    yield Alteration("all sensors 5 % too large", mapped(names, lambda r: 1.05 * r), everything)
    yield Alteration("all polarities turned", mapped(names, lambda r: -r), frozenset({"polarity"}))
    yield Alteration(
        "hum of 10 % in phase",
        mapped(names, lambda r: r + _tone(r, 50.0, rate, 0.1)),
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


def _of_the_force(rig: Rig, rng: np.random.Generator) -> Iterator[Alteration]:
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


def _of_clocks(rig: Rig, rng: np.random.Generator) -> Iterator[Alteration]:
    names, rate = (*(s.name for s in rig.sensors), "force"), rig.sample_rate_hz
    for share, said in ((0.01, "1 % fast"), (-0.02, "2 % slow"), (0.005, "0.5 % fast")):
        yield Alteration(
            f"clock {said}",
            mapped(names, lambda r, s=share: _stretched(r, 1 + s)),
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


def _of_description(rig: Rig, rng: np.random.Generator) -> Iterator[Alteration]:
    body = rig.bodies[int(rng.integers(len(rig.bodies)))]

    alone = len(rig.bodies) == 1  # then its mass and the force, its frequencies and the clock are told apart by nothing

    def put(make):
        return with_rig(lambda r: replace(r, bodies=tuple(make(b) if b.name == body.name else b for b in r.bodies)))

    about, channels = (body.name,), ("force",) if alone else ()
    yield Alteration(
        "mass 10 % off",
        put(lambda b: b.scale_mass(1.1)),
        frozenset({"mass", "gain"} if alone else {"mass"}),
        channels,
        about,
        group="rig.json",
    )
    yield Alteration(
        "density 10 % off",
        put(lambda b: b.scale_mass(1.1).scale_frequencies(1.1**-0.5)),
        frozenset({"mass", "gain"} if alone else {"mass"}),
        channels,
        about,
        group="rig.json",
    )
    yield Alteration(
        "frequencies 5 % off",
        put(lambda b: b.scale_frequencies(1.05)),
        frozenset({"frequency", "clock"} if alone else {"frequency"}),
        of=() if alone else about,
        group="rig.json",
    )
    yield Alteration(
        "frequencies 15 % off",
        put(lambda b: b.scale_frequencies(14 / 12)),
        frozenset({"frequency", "clock"} if alone else {"frequency"}),
        of=() if alone else about,
        group="rig.json",
    )
    yield Alteration(
        "damping four times", put(lambda b: b.scale_damping(4.0)), frozenset({"damping"}), of=about, group="rig.json"
    )
    if not body.is_mass:
        yield from _of_places(rig, body, rng)
    clamped = [b for b in rig.bodies if isinstance(b, Beam)]
    for beam in clamped:
        ends = "free-free" if beam.clamped else "clamped-free"
        turned = with_rig(
            lambda r, b=beam, e=ends: replace(
                r, bodies=tuple(replace(x, ends=e) if x.name == b.name else x for x in r.bodies)
            )
        )
        yield Alteration(
            f"{beam.name} described as {ends}", turned, frozenset({"ends", "model"}), of=(beam.name,), group="rig.json"
        )


def _of_places(rig: Rig, body: Body, rng: np.random.Generator) -> Iterator[Alteration]:
    own = [s for s in rig.sensors if s.station.body == body.name]
    at_contacts = {p for c in rig.contacts for p in (c.at, c.against) if p}
    free = [s for s in own if s.station not in at_contacts] or own
    moved = free[int(rng.integers(len(free)))]
    if isinstance(body, Beam):
        for by_m in (0.05, 0.01):

            def change(s, by=by_m):
                x = s.station.position_m
                return (
                    replace(s, station=Station(body.name, x - by if x >= by else x + by)) if s.name == moved.name else s
                )

            yield Alteration(
                f"one station {1e3 * by_m:g} mm off",
                with_sensors(change),
                frozenset({"station"}),
                (moved.name,),
                group="rig.json",
            )
    turned = with_sensors(
        lambda s: (
            replace(s, station=Station(body.name, body.length_m - s.station.position_m))
            if s.station.body == body.name
            else s
        )
    )
    places = sorted(s.station.position_m for s in own)
    if not np.allclose(places, sorted(body.length_m - p for p in places)) or not at_contacts:
        yield Alteration(
            "stations count from the other end",
            turned,
            frozenset({"mirrored", "model"}),
            tuple(s.name for s in own),
            of=(body.name,),
            group="rig.json",
        )
    at = rig.force_at
    if at.body == body.name:
        other = min((s.station for s in own if s.station != at), key=lambda p: abs(p.position_m - at.position_m))
        yield Alteration(
            "the force at the next station",
            with_rig(lambda r: replace(r, force_at=other)),
            frozenset({"force place"}),
            group="rig.json",
        )


def _of_processing(rig: Rig, rng: np.random.Generator) -> Iterator[Alteration]:
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


def _neighbours(rig: Rig, rng: np.random.Generator) -> tuple[str, str]:
    own = list(rig.sensors)
    first = own[int(rng.integers(len(own)))]
    same = [s for s in own if s.station.body == first.station.body and s is not first] or [
        s for s in own if s is not first
    ]
    return first.name, min(same, key=lambda s: abs(s.station.position_m - first.station.position_m)).name


def _tone(row: Row, hz: float, rate: float, share: float) -> Row:
    return np.asarray(share * np.sqrt(2) * row.std() * np.sin(2 * np.pi * hz * np.arange(row.size) / rate + 0.3))


def _spiked(row: Row) -> Row:
    found = row.copy()
    found[row.size // 3 :: row.size // 7] += 5 * row.std()
    return found


def _one_spike(row: Row) -> Row:
    found = row.copy()
    found[row.size // 2] += 20 * row.std()
    return found


def _gone(row: Row, rate: float) -> Row:
    found = row.copy()
    found[row.size // 2 : row.size // 2 + int(rate)] = 0.0
    return found


def _held(row: Row, rate: float) -> Row:
    found, width = row.copy(), int(0.01 * rate)
    for begin in range(row.size // 4, row.size - width, row.size // 9):
        found[begin : begin + width] = found[begin]
    return found


def _wrapped(row: Row) -> Row:
    most = 0.6 * np.abs(row).max()
    return np.asarray((row + most) % (2 * most) - most)


def _integrated(row: Row, rate: float) -> Row:
    spectrum = np.fft.rfft(row)
    omega = 2 * np.pi * np.fft.rfftfreq(row.size, 1 / rate)
    spectrum[1:] /= 1j * omega[1:]
    spectrum[omega < 2 * np.pi * 0.5] = 0
    return np.asarray(np.fft.irfft(spectrum, row.size))


def _stretched(row: Row, factor: float) -> Row:
    """Sampled at other times: sample k is taken at k factor, by cubic interpolation."""
    from scipy.interpolate import CubicSpline

    at = np.arange(int((row.size - 1) / max(factor, 1.0)) if factor > 1 else row.size) * factor
    return np.asarray(CubicSpline(np.arange(row.size), row)(at[at <= row.size - 1]))
