"""All checks of a recording, in the order in which one fault hides another."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache

import numpy as np

from identify.checks import waveforms
from identify.checks.channels import unexplained_finding
from identify.checks.continuity import discontinuity_findings
from identify.checks.findings import Finding, merge_by_cause
from identify.checks.first_modes import first_mode_findings
from identify.checks.gross import SOUND_MISFIT, ToleranceQuestions, channel_delays, force_delays, gross_faults
from identify.checks.masses import mass_findings
from identify.checks.prediction import TUNED_KINDS, LinearCheck, linear_check, with_tuned_modes
from identify.checks.pulls import (
    BrokenTolerance,
    Pulls,
    broken_tolerances_and_pulls,
    cost_within_tolerances,
    misfit_over_time_within_tolerances,
    misfit_within_tolerances,
    tolerance_finding,
)
from identify.checks.rigs import Trial
from identify.checks.spectra import Spectra, quiet_sample_count, spectra_of
from identify.checks.waveforms import Row, Rows
from identify.checks.windows import window_finding
from identify.linear.joined import contact_groups, rig_with_joined_contacts
from identify.signals.kinematics import MotionQuantity, kinematics
from identify.signals.measured_base import body_force_count, excitation_names, excitations
from rig.errors import RigError
from rig.model.description import ON_GROUND, Direction, Rig, Sensor, contact_stations
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording, plane_recording

WAVEFORM_CAUSES = (
    "dead",
    "clipped",
    "quantised",
    "repeated values",
    "held samples",
    "windowed",
    "spikes",
    "hum",
    "noise",
    "drift",
    "offset",
    "not at rest",
)
"""Causes that a channel's samples show by themselves; only the first one of a channel is reported."""
EXCLUDING_CAUSES = (
    "dead",
    "copy",
    "clipped",
    "repeated values",
    "held samples",
    "windowed",
    "spikes",
    "quantised",
    "offset",
    "drift",
)
"""Causes for which a channel is excluded from the comparison with the model."""
MODEL_CAUSES = ("model", "unexplained", "unrelated", "mass", "frequency", "damping", "ends", "clock", "jump", "force")
"""Causes of which another first frequency is a better account."""
REST_S_BY_QUANTITY = {"acceleration": 0.02, "velocity": 0.05, "displacement": 0.1}
"""First moments of a record in which a rig at rest has not moved yet, by quantity."""
MIN_RINGING_S, MIN_RINGING_SHARE = 0.25, 0.02
"""A rig rings at least so long after its force, with at least this share of its motion's standard deviation."""
MODE_RELINEARIZATIONS, MAX_MODE_PULL = 3, 4.0
"""Linearisations about fitted modes at most, and their largest frequency or damping error, in tolerances. Set by hand:
three follow the sharp resonances of bare beams under blows."""
MOVING_CHANNELS_SHARE = 0.5
"""A record begins in motion if more than this share of its channels do."""


def check_recording(
    recording: Recording, use: MotionQuantity = "auto", tolerances: Tolerances | None = None
) -> tuple[Finding, ...]:
    """Findings on the channels, the clock and rig.json; empty for a sound recording.

    First each channel's samples by themselves, then all channels of each direction against the linear model of rig.json
    in it. A segment of a longer record does not begin at rest and is not compared with the model.
    """
    waveform_findings, tolerances = _waveform_findings(recording, use), tolerances or recording.rig.tolerances
    findings = list(waveform_findings)
    for direction in recording.rig.directions:
        first_findings = _first_mode_findings(recording, direction, waveform_findings)
        model_findings = _model_findings(recording, direction, use, tolerances or LABORATORY, waveform_findings)
        findings += first_findings
        # a first mode that lies elsewhere is why nothing else fits
        findings += [f for f in model_findings if not first_findings or f.cause not in MODEL_CAUSES]
    if not any(finding.cause in ("units", "gain") for finding in findings):
        findings += _out_of_range_findings(recording, use)
    return merge_by_cause(_without_explained_findings(findings, recording.force_names), recording.rig)


def unchecked_notes(rig: Rig) -> tuple[str, ...]:
    """Sentences on checks that a rig does not allow."""
    if not rig.base_sensors:
        return ()
    return (
        f"only the waveforms are checked: the base of {rig.name!r} shakes, and the comparison of all channels with the "
        "linear model knows forces alone",
    )


def _without_explained_findings(findings: list[Finding], force_names: Sequence[str]) -> list[Finding]:
    """Findings, without those on a channel's waveform for which another one gives a better reason."""
    if any(f.cause == "force" for f in findings):
        findings = [f for f in findings if f.cause != "noise"]
    single_linear_check_findings = (f for f in findings if f.cause not in WAVEFORM_CAUSES and len(f.channels) == 1)
    explained_names = {*force_names, *_channel_names(single_linear_check_findings)}

    def is_explained(finding: Finding) -> bool:
        return not set(finding.channels) <= {*force_names} and set(finding.channels) <= explained_names

    return [f for f in findings if f.cause not in ("noise", "drift", "offset", "force") or not is_explained(f)]


def _out_of_range_findings(recording: Recording, use: MotionQuantity) -> list[Finding]:
    """Findings on channels that exceed anything on a test rig."""
    finding_by_channel = [waveforms.out_of_range_finding(c.name, c.group, c.samples) for c in _channels(recording, use)]
    return [finding for finding in finding_by_channel if finding is not None]


@contextmanager
def adding_first_finding_to_error(findings: tuple[Finding, ...]) -> Iterator[None]:
    """Append the first finding to the message of a RigError, as its likely reason."""
    try:
        yield
    except RigError as error:
        if not findings:
            raise
        raise error.with_note(f"(the check of the record found: {findings[0].sentence})") from error


def _first_mode_findings(full: Recording, direction: Direction, waveform_findings: list[Finding]) -> list[Finding]:
    """Findings on first frequencies of one direction, if no sensor is faulty."""
    faulty_names = _channel_names(finding for finding in waveform_findings if finding.cause in EXCLUDING_CAUSES)
    if full.rig.base_sensors or faulty_names - {*full.force_names}:
        return []
    return list(first_mode_findings(plane_recording(full, direction)))


def _excluded_channel_names(finding: Finding, force_names: Sequence[str]) -> tuple[str, ...]:
    """Channels that a finding excludes: of two equal ones the second alone, unless one of them is a force."""
    is_copy = finding.cause == "copy" and not set(finding.channels) & {*force_names}
    return finding.channels[1:] if is_copy else finding.channels


def _model_findings(
    full: Recording, direction: Direction, use: MotionQuantity, tolerances: Tolerances, waveform_findings: list[Finding]
) -> list[Finding]:
    """Findings by the linear model of one direction of the full recording, after those by the waveforms."""
    force_names = full.rig.force_names_in(direction)
    plane_record = plane_recording(full, direction)
    plane_rig = plane_record.rig
    if plane_rig.base_sensors:
        return []  # the comparison takes forces alone
    excluding_findings = [finding for finding in waveform_findings if finding.cause in EXCLUDING_CAUSES]
    excluded_names = {name for finding in excluding_findings for name in _excluded_channel_names(finding, force_names)}
    compared_sensors = tuple(s for s in plane_rig.sensors if s.measures.translates and use in ("auto", s.quantity))
    is_moving = any(finding.cause == "not at rest" for finding in waveform_findings)
    if not compared_sensors or excluded_names & {*force_names} or is_moving:
        return []
    usable_indices = [i for i, sensor in enumerate(compared_sensors) if sensor.name not in excluded_names]
    try:
        if len(usable_indices) > len(contact_groups(plane_rig)) + 1:
            forces_n, rate_hz = plane_record.forces_n, plane_rig.sample_rate_hz
            is_moving = _moving_channel_share(plane_record, compared_sensors) > MOVING_CHANNELS_SHARE
            if is_moving or not quiet_sample_count(forces_n, rate_hz):
                return []  # it may ring of what was before, which no force explains
            across = plane_recording(full, "z" if direction == "y" else "y") if full.rig.in_space else None
            return _linear_check_findings(plane_record, across, compared_sensors, usable_indices, tolerances)
        # no single direction tells when a ring is open
        has_annular_contact = any(contact.law.spatial for contact in full.rig.contacts)
        if not waveform_findings and all(body.is_mass for body in plane_rig.bodies) and not has_annular_contact:
            record_s = plane_record.samples / plane_rig.sample_rate_hz
            return mass_findings(plane_rig, kinematics(plane_record, use), tolerances, record_s)
    except RigError:  # a record that allows no comparison is refused by what needs it
        pass
    return []


def _moving_channel_share(recording: Recording, sensors: Sequence[Sensor]) -> float:
    """Share of the channels that move before the force begins."""
    rate_hz, forces_n = recording.rig.sample_rate_hz, recording.forces_n
    return float(np.mean([waveforms.moves_before_force(rate_hz, recording.values_of(s), forces_n) for s in sensors]))


def _linear_check_findings(
    recording: Recording,
    across: Recording | None,
    sensors: tuple[Sensor, ...],
    usable_indices: list[int],
    tolerances: Tolerances,
) -> list[Finding]:
    """Findings on all channels against each other: first over time, then gross faults, then tolerances."""
    rig = rig_with_joined_contacts(recording.rig)

    @cache
    def all_line_spectra() -> Spectra:
        return spectra_of(recording, sensors, None, across)

    spectra = spectra_of(recording, sensors, across=across)
    continuity_findings = discontinuity_findings(rig, all_line_spectra(), usable_indices)
    if any(f.cause == "jump" for f in continuity_findings):
        return continuity_findings

    @cache
    def tolerance_fit(trusted_indices: tuple[int, ...]) -> tuple[LinearCheck, list[BrokenTolerance], Pulls]:
        check = linear_check(rig, all_line_spectra(), [*trusted_indices])
        return _broken_tolerances_at_tuned_modes(rig, check, [*trusted_indices], tolerances)

    def tolerances_explain() -> bool:
        check, broken, pulls = tolerance_fit(tuple(usable_indices))
        fit = (rig, check, usable_indices, tolerances, pulls)
        return (
            not broken and min(misfit_within_tolerances(*fit), misfit_over_time_within_tolerances(*fit)) < SOUND_MISFIT
        )

    def pull_and_distance_of(trial: Trial) -> tuple[float, float]:
        if trial.changed_rig is None:
            return 0.0, 0.0
        nominal_check, changed_rig = tolerance_fit(tuple(usable_indices))[0], trial.changed_rig
        changed_check = linear_check(changed_rig, all_line_spectra(), usable_indices)
        nominal_cost = cost_within_tolerances(rig, nominal_check, usable_indices, tolerances)
        changed_cost = cost_within_tolerances(changed_rig, changed_check, usable_indices, tolerances)
        return float(np.sqrt(max(nominal_cost - changed_cost, 0.0))), trial.distance_in_tolerances(tolerances)

    questions = ToleranceQuestions(tolerances, tolerances_explain, pull_and_distance_of)
    faults = gross_faults(rig, spectra, usable_indices, all_line_spectra, questions)
    findings = list(faults.findings) or continuity_findings
    if faults.is_sound and len(faults.trusted_indices) > len(rig.contacts) + 1:
        _, violations, _ = tolerance_fit(tuple(faults.trusted_indices))
        replacing_findings: tuple[Finding, ...] = ()
        if violations and not findings:
            doubted = gross_faults(rig, spectra, faults.trusted_indices, all_line_spectra, questions, is_doubted=True)
            replacing_findings = doubted.findings
        findings += replacing_findings or _tolerance_findings(rig, violations, faults.trusted_indices, all_line_spectra)
    return findings


def _tolerance_findings(
    rig: Rig, violations: Sequence[BrokenTolerance], channel_indices: list[int], all_line_spectra: Callable[[], Spectra]
) -> Iterator[Finding]:
    """Findings on broken tolerances: a delay that grows is of two clocks, and what takes little away is no cause."""
    spectra = all_line_spectra()
    material_channels = {violation.channel_index for violation in violations if violation.is_material}
    for violation in violations:
        kind, name = violation.suspect.kind, violation.suspect.of
        changing = None
        if kind == "delay":
            others = [i for i in channel_indices if i != violation.channel_index]
            changing = channel_delays(rig, all_line_spectra, violation.channel_index, others).finding(name)
        elif kind == "force delay":
            force_index = spectra.force_names.index(name)
            changing = force_delays(rig, all_line_spectra, force_index, channel_indices).finding(name)
        if changing or violation.is_material:
            yield changing or tolerance_finding(violation)
        elif violation.channel_index not in material_channels:
            yield unexplained_finding(spectra.sensors[violation.channel_index].name, violation.motion_share)


def _broken_tolerances_at_tuned_modes(
    rig: Rig, check: LinearCheck, channel_indices: list[int], tolerances: Tolerances
) -> tuple[LinearCheck, list[BrokenTolerance], Pulls]:
    """Check, broken tolerances and pulls; about the fitted modes if none is broken there within their tolerances."""
    broken, pulls = broken_tolerances_and_pulls(rig, check, channel_indices, tolerances)
    tuned_check, tuned_broken, tuned_pulls = check, broken, pulls
    total_pulls = dict.fromkeys((p for p in pulls if p.kind in TUNED_KINDS), 0.0)
    for _ in range(MODE_RELINEARIZATIONS):
        total_pulls = {parameter: total + tuned_pulls[parameter] for parameter, total in total_pulls.items()}
        if not tuned_broken or max(map(abs, total_pulls.values()), default=np.inf) > MAX_MODE_PULL:
            break
        tuned_check = with_tuned_modes(rig, tuned_check, tuned_pulls, tolerances)
        tuned_broken, tuned_pulls = broken_tolerances_and_pulls(rig, tuned_check, channel_indices, tolerances)
    return (check, broken, pulls) if tuned_broken else (tuned_check, tuned_broken, tuned_pulls)


@dataclass(frozen=True)
class _Channel:
    """Samples of one channel in a group (a quantity or "force"), with what excites the rig.

    impact_sensor_names are the other sensors that show an impact of this channel.
    """

    group: str
    name: str
    samples: Row
    rate_hz: float
    excitation: Rows
    force_names: tuple[str, ...]
    impact_sensor_names: frozenset[str]
    known: waveforms.KnownChannel

    @property
    def is_force(self) -> bool:
        return self.group == "force"


def _waveform_findings(recording: Recording, use: MotionQuantity) -> list[Finding]:
    """First fault of every channel's samples; then faults that several channels show together."""
    channels = list(_channels(recording, use))
    faults = [fault for fault in map(_first_fault, channels) if fault is not None]
    dead_names = _channel_names(fault for fault in faults if fault.cause == "dead")
    live_channels = [channel for channel in channels if channel.name not in dead_names]
    excitation = excitations(recording)
    has_quiet_start = quiet_sample_count(excitation, recording.rig.sample_rate_hz) > 0
    may_begin_moving = recording.start_s > 0 or has_quiet_start or not np.any(excitation)  # before any force, freely
    motion_findings = [] if may_begin_moving else _not_at_rest_findings(live_channels)
    if recording.start_s == 0 and _is_time_reversed(live_channels, excitation, recording.rig.sample_rate_hz):
        motion_findings = [waveforms.reversed_time_finding(tuple(c.name for c in live_channels if not c.is_force))]
    findings = motion_findings or [*faults, *_spike_findings(live_channels, _channel_names(faults))]
    return [*findings, *waveforms.copy_findings([c.name for c in live_channels], [c.samples for c in live_channels])]


def _channel_names(findings: Iterable[Finding]) -> set[str]:
    """Names of the channels that findings concern."""
    return {name for finding in findings for name in finding.channels}


def _channels(recording: Recording, use: MotionQuantity) -> Iterator[_Channel]:
    """Channels of the forces on bodies, and of the sensors of the quantity in use."""
    rig = recording.rig
    used_names = {*recording.force_names[: body_force_count(rig)]}
    used_names |= {sensor.name for sensor in rig.sensors if use in ("auto", sensor.quantity)}
    rate_hz, excitation, force_names = rig.sample_rate_hz, excitations(recording), excitation_names(rig)
    for group, group_signals in recording.signals.items():
        usual_rms = float(np.median(group_signals.values.std(axis=1)))
        for name, samples in zip(group_signals.channels.names, group_signals.values, strict=True):
            if name in used_names:
                impact_names, known = _impact_sensor_names(rig, name), _known_channel(rig, name, usual_rms)
                yield _Channel(group, name, samples, rate_hz, excitation, force_names, impact_names, known)


def _known_channel(rig: Rig, channel_name: str, usual_rms: float) -> waveforms.KnownChannel:
    """What rig.json knows of a channel. A body rests at zero if something holds it there, without its weight."""
    sensor = next((s for s in rig.sensors if s.name == channel_name), None)
    if sensor is None:
        return waveforms.KnownChannel()
    is_held = sensor.station == ON_GROUND or rig.body(sensor.station.body).rigid_modes == 0
    return waveforms.KnownChannel(
        noise_rms=sensor.noise_density * float(np.sqrt(rig.sample_rate_hz / 2)),
        usual_rms=usual_rms,
        rests_at_zero=is_held and not rig.gravity_m_per_s2,
    )


def _impact_sensor_names(rig: Rig, channel_name: str) -> frozenset[str]:
    """Other sensors on the body of a sensor, and on the bodies that it meets at stops; of a force, all sensors."""
    sensor = next((s for s in rig.sensors if s.name == channel_name), None)
    body_names = {body.name for body in rig.bodies} if sensor is None else {sensor.station.body}
    for contact in rig.contacts:
        joined_body_names = {station.body for station in contact_stations(contact)}
        if sensor is not None and sensor.station.body in joined_body_names and contact.law.has_stops:
            body_names |= joined_body_names
    return frozenset(s.name for s in rig.sensors if s.station.body in body_names and s.name != channel_name)


def _first_fault(channel: _Channel) -> Finding | None:
    """First fault that a channel's samples show by themselves; it hides the later ones."""
    if channel.is_force and not np.any(channel.excitation):
        return None  # zeros stand for no force, as in a free decay
    channel_name, samples, rate_hz = channel.name, channel.samples, channel.rate_hz
    excitation, force_names = channel.excitation, channel.force_names
    fault_checks: list[Callable[[], Finding | None]] = [
        lambda: waveforms.dead_finding(channel_name, samples),
        lambda: waveforms.clipped_finding(channel_name, samples),
        lambda: waveforms.repeated_values_finding(channel_name, rate_hz, samples),
        lambda: waveforms.quantised_finding(channel_name, samples),
        lambda: waveforms.held_samples_finding(channel_name, samples, excitation, force_names),
    ]
    if not channel.is_force:
        fault_checks += [
            lambda: window_finding(channel_name, rate_hz, samples, excitation),
            lambda: waveforms.hum_finding(channel_name, rate_hz, samples, excitation),
            lambda: waveforms.noise_finding(channel_name, rate_hz, samples, excitation, force_names, channel.known),
        ]
    if channel.group == "acceleration":
        fault_checks += [
            lambda: waveforms.drift_finding(channel_name, rate_hz, samples),
            lambda: waveforms.offset_finding(channel_name, samples),
        ]
    elif (
        not channel.is_force
        and channel.known.rests_at_zero
        and (quiet_count := quiet_sample_count(excitation, rate_hz))
    ):
        fault_checks.append(lambda: waveforms.offset_finding(channel_name, samples[:quiet_count], float(samples.std())))
    return next((fault for check in fault_checks if (fault := check()) is not None), None)


def _spike_findings(channels: Sequence[_Channel], faulty_channel_names: set[str]) -> Iterator[Finding]:
    """Findings on spikes in the channels that show no fault of another kind."""
    deviation_by_channel = {c.name: waveforms.relative_neighbour_deviation(c.samples) for c in channels}
    for channel in channels:
        if channel.name not in faulty_channel_names:
            other_deviations = [d for name, d in deviation_by_channel.items() if name in channel.impact_sensor_names]
            finding = waveforms.spikes_finding(channel.name, deviation_by_channel[channel.name], other_deviations)
            if finding is not None:
                yield finding


def _is_time_reversed(channels: Sequence[_Channel], excitation: Rows, rate_hz: float) -> bool:
    """True if all motion ends with the force, without ringing: time then seems to run backwards."""
    quiet_count = 0 if quiet_sample_count(excitation, rate_hz) else quiet_sample_count(excitation[..., ::-1], rate_hz)
    ringing_slice = slice(max(0, quiet_count - round(MIN_RINGING_S * rate_hz)), quiet_count)
    motion_rows = [channel.samples for channel in channels if channel.group in REST_S_BY_QUANTITY]
    stops_dead = (float(row[::-1][ringing_slice].std()) < MIN_RINGING_SHARE * float(row.std()) for row in motion_rows)
    return bool(quiet_count and motion_rows and all(stops_dead))


def _not_at_rest_findings(channels: Sequence[_Channel]) -> list[Finding]:
    """Findings on channels that move from the record's first samples on; none if only few do."""
    finding_by_channel = [
        waveforms.initial_motion_finding(
            channel.name,
            channel.rate_hz,
            channel.samples,
            REST_S_BY_QUANTITY[channel.group],
            channel.known.noise_rms,
        )
        for channel in channels
        if channel.group in REST_S_BY_QUANTITY
    ]
    findings = [f for f in finding_by_channel if f is not None]
    return findings if len(findings) > MOVING_CHANNELS_SHARE * len(finding_by_channel) else []
