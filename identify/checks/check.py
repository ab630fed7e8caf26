"""All checks of a recording, in the order in which one hides the other."""

from collections.abc import Callable
from functools import partial

from identify.checks import waveforms
from identify.checks.findings import Finding
from identify.checks.gross import gross
from identify.checks.prediction import linear_check
from identify.checks.pulls import broken, broken_finding
from identify.checks.spectra import spectra_of
from identify.signals.kinematics import Use
from rig.errors import RigError
from rig.model.description import Rig
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording

SPOILS = ("dead", "copy", "clipped", "held samples", "spikes")
"""A channel with such a fault is left out of what follows."""


def check_recording(
    recording: Recording, use: Use = "auto", tolerances: Tolerances | None = None
) -> tuple[Finding, ...]:
    """What of the channels, the clock or rig.json cannot be right; empty of a sound recording."""
    rig = recording.rig
    believed = tolerances or rig.tolerances or LABORATORY
    found = list(_waveforms(recording, use))
    if any("force" in f.channels and f.cause in SPOILS for f in found):
        return tuple(found)
    spoilt = {c for f in found if f.cause in SPOILS for c in (f.channels[1:] if f.cause == "copy" else f.channels)}
    sensors = tuple(s for s in rig.sensors if s.measures.translates and use in ("auto", s.quantity))
    try:
        spectra = spectra_of(recording, sensors)
    except RigError:
        return tuple(found)
    usable = [i for i, s in enumerate(sensors) if s.name not in spoilt]
    coarse = gross(rig, spectra, usable)
    found += coarse.findings
    if coarse.sound and len(coarse.kept) > len(rig.contacts) + 1:
        check = linear_check(rig, spectra_of(recording, sensors, None), coarse.kept)
        off, _ = broken(rig, check, coarse.kept, believed)
        found += [broken_finding(b) for b in off]
    return tuple(found)


def _waveforms(recording: Recording, use: Use) -> list[Finding]:
    rig, rate, force = recording.rig, recording.rig.sample_rate_hz, recording.force_n
    measured = {s.name: s for s in rig.sensors if use in ("auto", s.quantity)}
    found: list[Finding] = []
    names, rows = [], []
    for group, signals in recording.signals.items():
        for name, row in zip(signals.channels.names, signals.values, strict=True):
            if group != "force" and name not in measured:
                continue
            if (one := waveforms.dead(name, row)) is not None:
                found.append(one)
                continue
            names.append(name)
            rows.append(row)
            checks: list[Callable[..., Finding | None]] = [
                waveforms.clipped,
                waveforms.quantised,
                waveforms.held,
                waveforms.spikes,
            ]
            if group == "acceleration":
                checks += [
                    partial(_with_rate, waveforms.drift, rate),
                    waveforms.offset,
                    partial(_with_rate, waveforms.not_at_rest, rate),
                ]
            found += [f for check in checks if (f := check(name, row)) is not None]
            if group != "force" and (tone := waveforms.hum(name, rate, row, force)) is not None:
                found.append(tone)
    found += waveforms.copies(names, rows)
    return found


def _with_rate(check: Callable[..., Finding | None], rate_hz: float, name: str, row: object) -> Finding | None:
    return check(name, rate_hz, row)
