"""All checks of a recording, in the order in which one hides the other."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache

import numpy as np

from identify.checks import background, waveforms
from identify.checks.broken import broken_finding
from identify.checks.continuity import breaks
from identify.checks.findings import Finding, merged
from identify.checks.gross import gross
from identify.checks.masses import mass_findings
from identify.checks.prediction import linear_check
from identify.checks.pulls import broken
from identify.checks.spectra import Spectra, quiet_samples, spectra_of
from identify.linear.joined import joined, joined_contacts
from identify.signals.kinematics import Use, kinematics
from rig.errors import RigError
from rig.model.description import Sensor
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording

HIDE = ("dead", "clipped", "quantised", "held samples", "spikes", "hum", "noise", "drift", "offset", "not at rest")
"""Of a channel's waveform only the first of these is told."""
SPOILS = ("dead", "copy", "clipped", "held samples", "spikes", "quantised", "offset", "drift")
"""A channel with such a fault is left out of what follows."""
FIRST_S = {"acceleration": 0.02, "velocity": 0.05, "displacement": 0.1}
"""In which motion at rest has not begun yet."""
MOST_REST = 0.5
"""A record begins in motion if more than this share of its channels do."""


def check_recording(
    recording: Recording, use: Use = "auto", tolerances: Tolerances | None = None
) -> tuple[Finding, ...]:
    """What of the channels, the clock or rig.json cannot be right; empty of a sound recording.

    First each channel's samples by themselves, then all channels against the linear model of rig.json, but of a segment
    of a longer record, which does not begin at rest.
    """
    believed = tolerances or recording.rig.tolerances or LABORATORY
    forces = recording.force_names
    found = _waveforms(recording, use)
    found += _against_model(recording, use, believed, found)
    if any(f.cause == "force" for f in found):
        found = [f for f in found if f.cause != "noise"]
    told = {*forces, *(c for f in found if f.cause not in HIDE for c in f.channels if len(f.channels) == 1)}
    found = [f for f in found if f.cause not in ("noise", "drift", "offset", "force") or not _told(f, forces, told)]
    return merged(found, recording.rig)


def _told(found: Finding, forces: Sequence[str], told: set[str]) -> bool:
    """Whether a better reason is known for what one channel's waveform shows."""
    return not set(found.channels) <= {*forces} and set(found.channels) <= told


@contextmanager
def naming(findings: tuple[Finding, ...]) -> Iterator[None]:
    """Puts the first finding behind the sentence of a RigError: it may be the reason."""
    try:
        yield
    except RigError as error:
        if not findings:
            raise
        raise RigError(f"{error} (the check of the record found: {findings[0].sentence})") from error


def _left_out(found: Finding, forces: Sequence[str]) -> tuple[str, ...]:
    """Of two channels that are the same one may be right, but for a force."""
    return found.channels[1:] if found.cause == "copy" and not set(found.channels) & {*forces} else found.channels


def _against_model(recording: Recording, use: Use, believed: Tolerances, shown: list[Finding]) -> list[Finding]:
    """After what the waveforms show."""
    rig, forces = recording.rig, recording.force_names
    spoilt = {c for f in shown if f.cause in SPOILS for c in _left_out(f, forces)}
    sensors = tuple(s for s in rig.sensors if s.measures.translates and use in ("auto", s.quantity))
    if not sensors or spoilt & {*forces} or any(f.cause == "not at rest" for f in shown):
        return []
    usable = [i for i, s in enumerate(sensors) if s.name not in spoilt]
    try:
        if len(usable) > len(joined_contacts(rig)) + 1:
            if not quiet_samples(recording.forces_n, rig.sample_rate_hz):
                return []  # it may ring of what was before, which no force explains
            return _of_channels(recording, sensors, usable, believed)
        if not shown and all(b.is_mass for b in rig.bodies):
            return mass_findings(rig, kinematics(recording, use), believed)
    except RigError:  # a record that allows no comparison is refused by what needs it
        pass
    return []


def _of_channels(
    recording: Recording, sensors: tuple[Sensor, ...], usable: list[int], believed: Tolerances
) -> list[Finding]:
    """All channels against each other; first over time, then gross faults, then tolerances."""
    rig = joined(recording.rig)

    @cache
    def fine() -> Spectra:
        return spectra_of(recording, sensors, None)

    spectra = spectra_of(recording, sensors)
    broke = breaks(rig, fine(), usable)
    if any(f.cause == "jump" for f in broke):
        return broke
    coarse = gross(rig, spectra, usable, fine)
    found = list(coarse.findings) or broke
    if coarse.sound and len(coarse.kept) > len(rig.contacts) + 1:
        off, _ = broken(rig, linear_check(rig, fine(), coarse.kept), coarse.kept, believed)
        instead = gross(rig, spectra, coarse.kept, fine, doubted=True) if off and not found else None
        found += instead.findings if instead and instead.findings else [broken_finding(b) for b in off]
    return found


def _waveforms(recording: Recording, use: Use) -> list[Finding]:
    """Of every channel the first fault that its samples show; then what several channels show together."""
    rig, rate, force = recording.rig, recording.rig.sample_rate_hz, recording.forces_n
    forces = recording.force_names
    measured = {s.name for s in rig.sensors if use in ("auto", s.quantity)}
    found: list[Finding] = []
    names, rows, offs, moving = [], [], [], []
    for group, signals in recording.signals.items():
        for name, row in zip(signals.channels.names, signals.values, strict=True):
            if group != "force" and name not in measured:
                continue
            if (one := waveforms.dead(name, row, forces)) is not None:
                found.append(one)
                continue
            off = waveforms.off_neighbours(row)
            names.append(name)
            rows.append(row)
            offs.append(off)
            checks = [
                waveforms.clipped(name, row),
                waveforms.quantised(name, row),
                waveforms.held(name, row, force, forces),
            ]
            if group != "force":
                checks += [background.hum(name, rate, row, force), background.noise(name, rate, row, force, forces)]
            if group == "acceleration":
                checks += [background.drift(name, rate, row), background.offset(name, row)]
            elif group != "force" and (quiet := quiet_samples(force, rate)):
                checks.append(background.offset(name, row[:quiet], float(row.std())))
            if group in FIRST_S and recording.start_s == 0:
                moving.append(background.not_at_rest(name, rate, row, FIRST_S[group]))
            found += [f for f in checks if f is not None][:1]
    told = {c for f in found for c in f.channels}
    for i, name in enumerate(names):
        others = [o for n, o in zip(names, offs, strict=True) if n not in (name, *forces)]
        spiked = waveforms.spikes(name, offs[i], others)
        if spiked is not None and name not in told:
            found.append(spiked)
    if moving and np.mean([f is not None for f in moving]) > MOST_REST:
        found = [f for f in moving if f is not None]
    return [*found, *waveforms.copies(names, rows)]
