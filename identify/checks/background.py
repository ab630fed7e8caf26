"""Background of a channel beside the motion: noise, mains hum, an offset, drift; motion before the record begins."""

from collections.abc import Sequence

import numpy as np

from identify.checks.findings import Finding
from identify.checks.spectra import quiet_samples
from identify.checks.waveforms import Row, Rows

HUMS = 3.0
"""Mains hum of more than so many times the neighbouring lines, and a hundredth of the channel, counts."""
HUM_SHARE = 2e-3
SLOW_HZ, SLOW = 0.25, 0.05
OFFSET = 0.05
MOVING = 0.3
ALIKE = 1.5
NOISY = 0.05


def noise(name: str, rate_hz: float, row: Row, force: Rows, forces: Sequence[str] = ("force",)) -> Finding | None:
    """Noise of the quiet start."""
    quiet = quiet_samples(force, rate_hz)
    share = float(row[:quiet].std() / row.std()) if quiet else 0.0
    if share < NOISY:
        return None
    fast, usual = (float(np.diff(part).std() / part.std()) for part in (row[:quiet], row[quiet:]))
    if fast < ALIKE * usual:
        return Finding(
            cause="force",
            channels=(*forces, name),
            evidence=f"{name} moves as it does later, with {100 * share:.2g} % of its root mean square, before "
            "the force begins",
            mend="check that the force is of this record and on its clock, or let the rig come to rest first",
        )
    return Finding(
        cause="noise",
        channels=(name,),
        evidence=f"{name} shows {100 * share:.2g} % of its root mean square before the force begins",
        mend="find the noise or the motion (cable, amplifier, range), or let the rig come to rest first",
    )


def mains(rate_hz: float, row: Row, force: Rows) -> tuple[float, float] | None:
    """Frequency and amplitude of a mains tone that stands out, in the quiet start if there is one; else None."""
    quiet = quiet_samples(force, rate_hz)
    part = row[:quiet] if quiet > 0.4 * rate_hz else row
    own = part - part.mean()
    size = np.abs(np.fft.rfft(own * np.hanning(own.size))) * 4 / own.size
    hz = np.fft.rfftfreq(own.size, 1 / rate_hz)
    width = hz[1]
    for base in (50.0, 60.0):
        near = np.abs(hz - base) <= max(0.15, 1.5 * width)
        beside = (np.abs(hz - base) > max(0.6, 3 * width)) & (np.abs(hz - base) < max(3.0, 9 * width))
        if not (near.any() and beside.any()):
            continue
        height, usual = float(size[near].max()), float(np.sqrt(np.mean(size[beside] ** 2)))
        if height > 2 * HUMS * usual and height > HUM_SHARE * float(row.std()):
            return float(hz[near][np.argmax(size[near])]), height
    return None


def hum(name: str, rate_hz: float, row: Row, force: Rows) -> Finding | None:
    tone, amplitude = mains(rate_hz, row, force), float(row.std() * np.sqrt(2))
    if tone is None or amplitude == 0:  # also of values so small that their squares are zero
        return None
    hz, height = tone
    return Finding(
        cause="hum",
        channels=(name,),
        evidence=f"{name} holds a tone of {hz:.3g} Hz, {100 * height / amplitude:.2g} % of its size, that the force "
        "does not make: mains hum",
        mend="ground the cables at one end, keep them away from mains cables, and record again",
    )


def offset(name: str, row: Row, usual: float | None = None) -> Finding | None:
    """Offset of samples whose mean should be zero: of an acceleration, or of any motion before the force begins."""
    mean, rms = (float(row.mean()), float(row.std())) if usual is None else (float(row.mean()), usual)
    if abs(mean) <= OFFSET * rms or not rms:
        return None
    return Finding(
        cause="offset",
        channels=(name,),
        evidence=f"{name} has a constant part of {mean:.3g}, {100 * abs(mean) / rms:.2g} % of its root mean square",
        mend="take the mean off, or couple it AC",
    )


def drift(name: str, rate_hz: float, row: Row) -> Finding | None:
    """Slow motion that an acceleration of a moving rig cannot have."""
    length = row.size
    size = np.abs(np.fft.rfft((row - row.mean()) * np.hanning(length))) ** 2
    slow = int(SLOW_HZ * length / rate_hz) + 1
    share = float(np.sqrt(np.sum(size[1:slow]) / np.sum(size)))
    if share < SLOW:
        return None
    return Finding(
        cause="drift",
        channels=(name,),
        evidence=f"{name} drifts: {100 * share:.2g} % of its root mean square lies below {SLOW_HZ:g} Hz",
        mend="let the amplifier warm up, keep it from temperature changes, or high-pass it",
    )


def not_at_rest(name: str, rate_hz: float, row: Row, first_s: float) -> Finding | None:
    """Finding: the channel moves by a part of its usual motion within the record's first moments."""
    first = row[: max(8, round(first_s * rate_hz))]
    if first.std() < MOVING * row.std():
        return None
    return Finding(
        cause="not at rest",
        channels=(name,),
        evidence=f"{name} moves already at the record's first samples",
        mend="begin the record with a second at rest, before the force; of a cut record, the beginning is missing",
    )


def backwards(names: tuple[str, ...]) -> Finding:
    """All motion stops with the force, without ringing, and does not begin from rest."""
    return Finding(
        cause="not at rest",
        channels=names,
        evidence="the motion does not begin at rest and stops at once where the force ends, as if time ran backwards",
        mend="put the samples of all channels in the order in which they were taken",
    )
