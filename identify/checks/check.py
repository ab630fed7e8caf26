"""All checks of a recording, in the order in which one hides the other."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
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
from identify.checks.waveforms import Row, Rows
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
RINGS_S, AT_REST = 0.25, 0.02
"""A rig rings so long after its force has ended, by more than this share of its motion's standard deviation."""
MOST_REST = 0.5
"""A record begins in motion if more than this share of its channels do."""


def check_recording(
    recording: Recording, use: Use = "auto", tolerances: Tolerances | None = None
) -> tuple[Finding, ...]:
    """Findings on the channels, the clock and rig.json; empty of a sound recording.

    First each channel's samples by themselves, then all channels against the linear model of rig.json, but of a segment
    of a longer record, which does not begin at rest.
    """
    believed = tolerances or recording.rig.tolerances or LABORATORY
    found = _waveforms(recording, use)
    found += _against_model(recording, use, believed, found)
    if not any(f.cause in ("units", "gain") for f in found):
        found += _beyond_machines(recording, use)
    return merged(_without_explained(found, recording.force_names), recording.rig)


def _without_explained(findings: list[Finding], forces: Sequence[str]) -> list[Finding]:
    """Findings without those of a channel's waveform for which another gives a better reason."""
    if any(f.cause == "force" for f in findings):
        findings = [f for f in findings if f.cause != "noise"]
    explained = {*forces, *_concerned(f for f in findings if f.cause not in HIDE and len(f.channels) == 1)}

    def is_explained(finding: Finding) -> bool:
        return not set(finding.channels) <= {*forces} and set(finding.channels) <= explained

    return [f for f in findings if f.cause not in ("noise", "drift", "offset", "force") or not is_explained(f)]


def _beyond_machines(recording: Recording, use: Use) -> list[Finding]:
    judged = [waveforms.beyond_machines(c.name, c.group, c.samples) for c in _channels(recording, use)]
    return [f for f in judged if f is not None]


@contextmanager
def naming(findings: tuple[Finding, ...]) -> Iterator[None]:
    """Puts the first finding behind the sentence of a RigError: it may be the reason."""
    try:
        yield
    except RigError as error:
        if not findings:
            raise
        raise error.noting(f"(the check of the record found: {findings[0].sentence})") from error


def _left_out(found: Finding, forces: Sequence[str]) -> tuple[str, ...]:
    """Channels left out: of two that are the same one may be right, but for a force."""
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


@dataclass(frozen=True)
class _Channel:
    """Samples of one channel, in a group (a quantity or "force"), and the force beside them."""

    group: str
    name: str
    samples: Row
    rate_hz: float
    forces_n: Rows
    force_names: tuple[str, ...]

    @property
    def is_force(self) -> bool:
        return self.group == "force"


def _waveforms(recording: Recording, use: Use) -> list[Finding]:
    """Findings by waveform: the first fault of every channel's samples; then what several channels show together."""
    channels = list(_channels(recording, use))
    first = [fault for fault in map(_first_fault, channels) if fault is not None]
    live = [c for c in channels if c.name not in _concerned(f for f in first if f.cause == "dead")]
    cut = recording.start_s > 0 or not np.any(recording.forces_n)  # a free decay begins in motion
    in_motion = [] if cut else _in_motion(live)
    if recording.start_s == 0 and _runs_backwards(live, recording.forces_n, recording.rig.sample_rate_hz):
        in_motion = [background.backwards(tuple(c.name for c in live if not c.is_force))]
    found = in_motion or [*first, *_spikes(live, _concerned(first))]
    return [*found, *waveforms.copies([c.name for c in live], [c.samples for c in live])]


def _concerned(findings: Iterable[Finding]) -> set[str]:
    """Names of their channels."""
    return {name for f in findings for name in f.channels}


def _channels(recording: Recording, use: Use) -> Iterator[_Channel]:
    """The forces, and the sensors of the quantity that is used."""
    rig = recording.rig
    used = {*recording.force_names, *(s.name for s in rig.sensors if use in ("auto", s.quantity))}
    for group, signals in recording.signals.items():
        for name, samples in zip(signals.channels.names, signals.values, strict=True):
            if name in used:
                yield _Channel(group, name, samples, rig.sample_rate_hz, recording.forces_n, recording.force_names)


def _first_fault(channel: _Channel) -> Finding | None:
    """First fault that a channel's samples show by themselves; it hides those behind it."""
    name, samples, rate_hz = channel.name, channel.samples, channel.rate_hz
    force, forces = channel.forces_n, channel.force_names
    checks: list[Callable[[], Finding | None]] = [
        lambda: waveforms.dead(name, samples, forces),
        lambda: waveforms.clipped(name, samples),
        lambda: waveforms.quantised(name, samples),
        lambda: waveforms.held(name, samples, force, forces),
    ]
    if not channel.is_force:
        checks += [
            lambda: background.hum(name, rate_hz, samples, force),
            lambda: background.noise(name, rate_hz, samples, force, forces),
        ]
    if channel.group == "acceleration":
        checks += [lambda: background.drift(name, rate_hz, samples), lambda: background.offset(name, samples)]
    elif not channel.is_force and (quiet := quiet_samples(force, rate_hz)):
        checks.append(lambda: background.offset(name, samples[:quiet], float(samples.std())))
    return next((fault for check in checks if (fault := check()) is not None), None)


def _spikes(channels: Sequence[_Channel], faulty: set[str]) -> Iterator[Finding]:
    """Spikes in the channels that show no fault of another kind."""
    off = {c.name: waveforms.off_neighbours(c.samples) for c in channels}
    for channel in channels:
        if channel.name not in faulty:
            others = [o for name, o in off.items() if name not in (channel.name, *channel.force_names)]
            spiked = waveforms.spikes(channel.name, off[channel.name], others)
            if spiked is not None:
                yield spiked


def _runs_backwards(channels: Sequence[_Channel], force: Rows, rate_hz: float) -> bool:
    """True if all motion ends with the force, as it begins with it where time runs forwards: nothing rings on."""
    quiet = 0 if quiet_samples(force, rate_hz) else quiet_samples(force[..., ::-1], rate_hz)
    after = slice(max(0, quiet - round(RINGS_S * rate_hz)), quiet)
    rows = [c.samples for c in channels if c.group in FIRST_S]
    return bool(quiet and rows and all(float(row[::-1][after].std()) < AT_REST * float(row.std()) for row in rows))


def _in_motion(channels: Sequence[_Channel]) -> list[Finding]:
    """The channels that move from the record's first samples on; none if a few do."""
    judged = [
        background.not_at_rest(c.name, c.rate_hz, c.samples, FIRST_S[c.group]) for c in channels if c.group in FIRST_S
    ]
    found = [f for f in judged if f is not None]
    return found if len(found) > MOST_REST * len(judged) else []
