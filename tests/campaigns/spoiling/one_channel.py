"""Faults of one channel: its instrument, its cable, its processing."""

from collections.abc import Callable, Iterator

import numpy as np
from scipy.signal import butter, sosfilt

from identify.checks.findings import Cause
from rig.model.description import Rig
from tests.campaigns.spoiling import rows
from tests.campaigns.spoiling.alteration import Alteration, G, Row, delayed, mapped, with_rows


def of_one_channel(rig: Rig, rng: np.random.Generator) -> Iterator[Alteration]:
    names, rate = [s.name for s in rig.sensors], rig.sample_rate_hz

    alone: tuple[Cause, ...] = ("force",) if len(names) == 1 else ()

    def one(title: str, change: Callable[[Row], Row], *causes: Cause, group: str = "instruments") -> Alteration:
        name = str(rng.choice(names))
        if len(names) == 1 and {"unrelated", "gain"} & set(causes):  # nothing tells it from the force
            causes = (*causes, "force", "noise", "not at rest")
        return Alteration(title, mapped((name,), change), frozenset(causes), (name,), group=group)

    yield one("one polarity turned", lambda r: -r, "polarity")
    yield one("one channel dead", lambda r: np.zeros(r.size), "dead", group="cables")
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
    yield one("one channel with 20 % noise", lambda r: rows.noisy(r, 0.2), "unrelated", "noise")
    yield one("one channel is noise", lambda r: r.std() * rng.standard_normal(r.size), "unrelated", group="cables")
    yield one("one channel offset", lambda r: r + 0.3 * r.std(), "offset")
    yield one("one channel drifts", lambda r: r + 0.5 * r.std() * np.linspace(0, 1, r.size) ** 2, "drift", "offset")
    yield one("one channel with spikes", rows.spiked, "spikes", group="cables")
    yield one("one channel with one large spike", rows.one_spike, "spikes", group="cables")
    yield one("one channel drops out for a second", lambda r: rows.gone(r, rate), "held samples", group="cables")
    yield one("one channel holds samples", lambda r: rows.held(r, rate), "held samples", group="cables")
    yield one("hum on one channel", lambda r: r + rows.tone(r, 50.0, rate, 0.1), "hum", group="cables")
    yield one("60 Hz hum on one channel", lambda r: r + rows.tone(r, 60.0, rate, 0.05), "hum", group="cables")
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
    yield one("one channel integrated", lambda r: rows.integrated(r, rate), "derivative", "units", group="processing")
    yield one(
        "one channel slips 20 samples",
        lambda r: np.r_[r[: r.size // 2], r[r.size // 2 + 20 :], r[-20:]],
        "slipped samples",
        "glitch",
        *alone,
        group="clock",
    )
    yield one("one channel wraps over", rows.wrapped, "spikes", "clipped", "unrelated", group="processing")
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
            lambda r: with_rows(r, {a: rows.noisy(1.02 * r[b].values, 1e-3)}),
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


def _neighbours(rig: Rig, rng: np.random.Generator) -> tuple[str, str]:
    own = list(rig.sensors)
    first = own[int(rng.integers(len(own)))]
    same = [s for s in own if s.station.body == first.station.body and s is not first] or [
        s for s in own if s is not first
    ]
    return first.name, min(same, key=lambda s: abs(s.station.position_m - first.station.position_m)).name
