"""Faults that a channel's samples show by themselves, without any model of the rig.

Of the digitisation: dead, clipped, quantised, held, spikes, copies. Of what is added to the motion: noise, mains hum,
offset, drift. Of the record: motion before it begins, or samples in reverse order.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.checks.findings import Finding, names_in_words
from identify.checks.spectra import converter_step, quiet_sample_count
from rig.model.quantities import QUANTITIES

MIN_CLIPPED_SHARE = 1e-3
"""A channel is clipped if it has its largest or smallest value for a larger share of the record."""
MAX_NEXT_LEVEL_SHARE = 0.2
"""Samples one step below a value at which a channel is clipped, over those at it. A sine has 0.41 of them."""
MAX_STEP_SHARE = 0.005
"""Largest step of a quantiser, as a share of the channel's largest distance from its mean. Of the 2048 steps of a
12-bit converter, a tenth of the range has 200."""
MIN_RECURRENCE = 3.0
"""Levels that recur less often are not those of a quantiser."""
LARGEST_FORCE_N = 1e9
MIN_HELD_SAMPLES = 8
"""Shortest run of repeated values that counts as held."""
MIN_HELD_STEPS = 3.0
"""Steps of the converter by which a channel moves into a held value, and out of it: at rest it does not."""
MAX_REPEATED_SHARE, MIN_HELD_JUMP = 0.02, 2.0
"""Share of samples like the one before from which on values repeat often; the step out of a held value is then larger
than the next ones by the second factor."""
MIN_SLOW_RATIO, REGULAR_COUNT, MIN_REGULAR_SHARE = 1.2, 32, 0.5
"""Samples that a value of a slower channel is repeated for, the number of its values that come regularly in a row, and
the least share of all changes that do."""
MIN_SPIKE_RATIO = 25.0
"""Smallest deviation of a spike from its neighbours, over the usual one."""
MIN_IMPACT_RATIO, SPIKE_TO_IMPACT_RATIO, MAX_SPIKES = 8.0, 2.0, 60
"""Deviation of another channel that makes an impact of a spike; size of a spike over that of impacts; most spikes that
are single faults."""
TONE_TO_BACKGROUND_RATIO = 3.0
"""Mains hum is larger than twice this multiple of the neighbouring lines."""
MIN_TONE_SHARE = 2e-3
"""Smallest hum, as a share of the channel's standard deviation."""
DRIFT_BELOW_HZ, MIN_DRIFT_SHARE = 0.25, 0.05
"""Drift has a larger share of the root mean square below this frequency."""
MAX_OFFSET_SHARE = 0.05
"""Largest mean, as a share of the root mean square."""
MIN_MOVING_SHARE = 0.3
"""Smallest share of its usual motion with which a channel moves from the first sample on."""
NOISE_ROUGHNESS_RATIO = 1.5
"""Noise is rougher than motion by this factor."""
MAX_QUIET_SHARE = 0.05
"""Largest share of its root mean square in a channel's quiet start."""

MAX_STATED_NOISES = 2.0
"""Noise up to this multiple of what rig.json states is as stated."""

Row = Float[np.ndarray, " samples"]
Rows = Float[np.ndarray, "*rows samples"]


@dataclass(frozen=True)
class KnownChannel:
    """What is known of a channel without its samples: its noise by rig.json, the usual motion of channels of its
    quantity (both rms), and whether rig.json has it rest at zero."""

    noise_rms: float = 0.0
    usual_rms: float = 0.0
    rests_at_zero: bool = True


def dead_finding(name: str, samples: Row) -> Finding | None:
    """Finding: the channel is constant."""
    if np.ptp(samples) > 1e-9 * max(abs(float(samples[0])), 1e-300) and np.ptp(samples) > 0:
        return None
    return Finding(
        cause="dead",
        channels=(name,),
        evidence=f"{name} stands at {samples[0]:.4g} throughout",
        mend="check its cable and amplifier, or take it out of rig.json",
    )


def out_of_range_finding(name: str, group: str, samples: Row) -> Finding | None:
    """Finding: values larger than anything on a test rig (100 m, 1e4 m/s, 1e7 m/s^2, a strain of 10, 1e9 N).

    The model is linear except for the clearances, and cannot tell if all channels are too large by the same factor.
    """
    max_plausible, unit = LARGEST_FORCE_N, "N"
    if group != "force":
        max_plausible, unit = QUANTITIES[group].largest, QUANTITIES[group].unit
    largest = float(np.abs(samples).max())
    if largest <= max_plausible:
        return None
    return Finding(
        cause="units",
        channels=(name,),
        evidence=f"{name} reaches {largest:.3g} {unit}, and nothing on a test rig exceeds {max_plausible:g} {unit}",
        mend="check the unit and the scale that it was recorded or imported with",
    )


def clipped_finding(name: str, samples: Row) -> Finding | None:
    """Finding: the signal rests at its largest or smallest value, and hardly at those next to it.

    A sine in a coarse converter rests at both.
    """
    next_width = 1.5 * converter_step(samples)
    for side, extreme in (("largest", samples.max()), ("smallest", samples.min())):
        is_extreme, is_next = samples == extreme, np.abs(samples - extreme) < next_width
        share = float(np.mean(is_extreme))
        stands_out = np.sum(is_next & ~is_extreme) < MAX_NEXT_LEVEL_SHARE * np.sum(is_extreme)
        is_frequent = share > MIN_CLIPPED_SHARE and share * samples.size >= 4
        if is_frequent and stands_out and abs(extreme - samples.mean()) > samples.std():
            return Finding(
                cause="clipped",
                channels=(name,),
                evidence=f"{name} stands at its {side} value, {extreme:.4g}, for {100 * share:.2g} % of the record",
                mend="take a larger measuring range or a weaker excitation, and record again",
            )
    return None


def quantised_finding(name: str, samples: Row) -> Finding | None:
    """Finding: the usual step between levels is large, and levels recur, unlike those of a single blow."""
    value_levels, level_counts = np.unique(samples[:: max(1, samples.size // 20_000)], return_counts=True)
    mean_recurrence = (level_counts.sum() - level_counts.max()) / value_levels.size
    if value_levels.size > 2000 or value_levels.size < 3 or mean_recurrence < MIN_RECURRENCE:
        return None
    level_step, largest = float(np.median(np.diff(value_levels))), float(np.abs(samples - samples.mean()).max())
    if level_step < MAX_STEP_SHARE * largest:
        return None
    return Finding(
        cause="quantised",
        channels=(name,),
        evidence=f"{name} moves in steps of {level_step:.3g}, {100 * level_step / largest:.2g} % of its largest value",
        mend="take a smaller measuring range or more bits, and record again",
    )


def repeated_values_finding(name: str, rate_hz: float, samples: Row) -> Finding | None:
    """Finding: the channel changes at regular times alone, as one that was sampled more slowly, each value repeated."""
    change_indices = np.flatnonzero(np.diff(samples)) + 1
    window_count = change_indices.size // REGULAR_COUNT
    if not window_count:
        return None
    windows = change_indices[: window_count * REGULAR_COUNT].reshape(window_count, REGULAR_COUNT)
    ranks = np.arange(REGULAR_COUNT) - (REGULAR_COUNT - 1) / 2
    intervals = windows @ ranks / (ranks @ ranks)
    usual_interval = float(np.median(intervals))
    if usual_interval < MIN_SLOW_RATIO:
        return None
    deviations = windows - usual_interval * ranks
    is_regular = np.ptp(deviations, axis=1) <= 1.0 + 1e-9
    if np.mean(is_regular) < MIN_REGULAR_SHARE:
        return None
    return Finding(
        cause="repeated values",
        channels=(name,),
        evidence=f"{name} repeats each value {usual_interval:.3g} times: it was sampled at "
        f"{rate_hz / usual_interval:.4g} Hz, and not at {rate_hz:g} Hz",
        mend="resample it to the record's rate, or import it at its own rate; it comes half an interval late as it is",
    )


def held_samples_finding(
    name: str, samples: Row, forces_n: Rows, force_names: Sequence[str] = ("force",)
) -> Finding | None:
    """Finding: runs of equal samples in a channel that otherwise moves: lost samples that were filled.

    A converter whose signal rests, or turns, repeats a value too: the channel moves into a held value, and leaves it,
    by several of the converter's steps. Where values repeat often, it leaves a held one by more than it goes on.
    """
    is_repeated = np.diff(samples) == 0
    run_edges = np.flatnonzero(np.diff(np.r_[0, is_repeated.astype(np.int8), 0]))
    run_starts, run_stops = run_edges[::2], run_edges[1::2]
    if not run_starts.size or np.mean(is_repeated) > 0.9:
        return None
    force_sizes = np.abs(np.atleast_2d(forces_n))
    onset_index = int(np.argmax((force_sizes > 0.05 * force_sizes.max(axis=1, keepdims=True)).any(axis=0)))
    is_held_run = (
        (run_stops - run_starts >= MIN_HELD_SAMPLES)
        & (run_starts > onset_index)
        & ~np.isin(samples[run_starts], (samples.max(), samples.min()))
    )
    if name in force_names:
        is_held_run &= samples[run_starts] != 0
    min_step = MIN_HELD_STEPS * converter_step(samples)
    repeats_often = (
        np.sum(is_repeated) - np.sum((run_stops - run_starts)[is_held_run]) > MAX_REPEATED_SHARE * samples.size
    )
    for run in np.flatnonzero(is_held_run).tolist():
        start, stop = int(run_starts[run]), int(run_stops[run])
        before = samples[max(0, start - MIN_HELD_SAMPLES) : start]
        moves_in = np.abs(before - samples[start]).max(initial=0.0) > min_step
        steps_out = np.abs(np.diff(samples[stop : stop + 4]))
        min_step_out = min_step
        if repeats_often:
            min_step_out = max(min_step, MIN_HELD_JUMP * float(steps_out[1:].max(initial=0.0)))
        is_held_run[run] = moves_in and (not steps_out.size or steps_out[0] > min_step_out)
    if not is_held_run.any():
        return None
    longest = int(np.max((run_stops - run_starts)[is_held_run])) + 1
    return Finding(
        cause="held samples",
        channels=(name,),
        evidence=f"{name} repeats one value {longest} times in a row, in {int(is_held_run.sum())} places, "
        f"first at sample {int(run_starts[is_held_run][0])}: samples were lost there",
        mend="record again, or leave that part of the record out",
    )


def neighbour_deviation(samples: Row) -> Float[np.ndarray, " inner"]:
    """Deviation of each sample from the cubic through its four neighbours; the two at each end have none."""
    return np.asarray(samples[2:-2] - (4 * (samples[1:-3] + samples[3:-1]) - samples[:-4] - samples[4:]) / 6)


def relative_neighbour_deviation(samples: Row) -> Row:
    """Deviation of each sample from the cubic through its four neighbours, over the usual deviation nearby, and over a
    quarter of the converter's step."""
    deviation = np.abs(neighbour_deviation(samples))
    usual_deviation = np.maximum(_moving_mean(deviation, 201), 0.02 * deviation.mean() + 1e-300)
    usual_deviation = np.maximum(usual_deviation, 0.25 * converter_step(samples))
    return np.asarray(np.r_[0, 0, deviation / usual_deviation, 0, 0])


def spikes_finding(name: str, deviation: Row, other_deviations: list[Row]) -> Finding | None:
    """Finding: single samples that their neighbours do not explain; not at the record's ends.

    A jump that another channel shows too is an impact. So is one if most of the jumps of at least half its size in this
    channel are impacts. In an only channel, spikes stand out from all impacts.
    """
    margin_count = deviation.size // 50
    interior = deviation[margin_count:-margin_count]
    jump_indices = margin_count + np.flatnonzero(interior > MIN_SPIKE_RATIO / SPIKE_TO_IMPACT_RATIO)
    jump_indices = jump_indices[[_is_single_sample_spike(deviation, int(k)) for k in jump_indices]]
    jump_deviations = deviation[jump_indices]
    spike_indices = [int(k) for k in jump_indices[jump_deviations > MIN_SPIKE_RATIO]]
    if other_deviations and spike_indices:
        other_peaks = np.array([max(float(d[k - 3 : k + 4].max()) for d in other_deviations) for k in jump_indices])
        is_unshared = other_peaks < MIN_IMPACT_RATIO
        spike_indices = [
            int(k)
            for k, size in zip(jump_indices[is_unshared], jump_deviations[is_unshared], strict=True)
            if size > MIN_SPIKE_RATIO and np.mean(is_unshared[jump_deviations > size / SPIKE_TO_IMPACT_RATIO]) > 0.5
        ]
    elif spike_indices:
        middle = interior[1:-1]
        peak_deviations = np.sort(middle[(middle > interior[:-2]) & (middle > interior[2:])])[::-1][: MAX_SPIKES + 1]
        peak_ratios = peak_deviations[:-1] / np.maximum(peak_deviations[1:], 1e-300)
        gap_index = int(np.argmax(peak_ratios))
        stands_out = peak_ratios[gap_index] > SPIKE_TO_IMPACT_RATIO
        spike_indices = [k for k in spike_indices if stands_out and deviation[k] >= peak_deviations[gap_index]]
    if not 0 < len(spike_indices) <= MAX_SPIKES:
        return None
    return Finding(
        cause="spikes",
        channels=(name,),
        evidence=f"{name} jumps for single samples in {len(spike_indices)} places, first at sample {spike_indices[0]}",
        mend="check cables and connectors, and record again",
    )


def _is_single_sample_spike(deviation: Row, k: int) -> bool:
    """True if sample k alone is off: two thirds of its deviation then show at its neighbours, a sixth at the next."""
    nearest_pair, second_pair = deviation[[k - 1, k + 1]], deviation[[k - 2, k + 2]]
    return bool(
        deviation[k] > 1.3 * nearest_pair.max()
        and nearest_pair.min() > 0.45 * deviation[k]
        and second_pair.max() < 0.35 * deviation[k]
    )


def _moving_mean(samples: Row, window_count: int) -> Row:
    """Moving mean of both sides, without the middle sample."""
    cumsums = np.cumsum(np.r_[0.0, samples])
    low_index = np.clip(np.arange(samples.size) - window_count // 2, 0, samples.size)
    high_index = np.clip(np.arange(samples.size) + window_count // 2 + 1, 0, samples.size)
    return np.asarray((cumsums[high_index] - cumsums[low_index] - samples) / np.maximum(high_index - low_index - 1, 1))


def copy_findings(names: list[str], sample_rows: list[Row]) -> Iterator[Finding]:
    """Findings: channels that are the same up to a factor."""
    thinned = (row[:: max(1, row.size // 8192)] for row in sample_rows)
    centred = (row - row.mean() for row in thinned)
    unit_vectors = np.array([row / (float(np.linalg.norm(row)) or 1.0) for row in centred])
    correlation = np.abs(unit_vectors @ unit_vectors.T)
    for i, channel_name in enumerate(names):
        for k in range(i):
            if correlation[i, k] > 1 - 1e-9:
                yield Finding(
                    cause="copy",
                    channels=(names[k], channel_name),
                    evidence=f"{names_in_words((names[k], channel_name))} hold the same samples",
                    mend="check the channel map: one of them was recorded or imported twice",
                )


def noise_finding(
    name: str,
    rate_hz: float,
    samples: Row,
    forces_n: Rows,
    force_names: Sequence[str] = ("force",),
    known: KnownChannel | None = None,
) -> Finding | None:
    """Finding: noise in the quiet start; or motion that sets in there, if it is as smooth as later motion.

    Noise is measured by the usual motion of such channels, as a station may rest. Noise that is stated is none, nor is
    motion that lasts from the record's first samples on: the rig was not at rest.
    """
    known = known or KnownChannel()
    quiet_count = quiet_sample_count(forces_n, rate_hz)
    if not quiet_count:
        return None
    quiet_samples, driven_samples = samples[:quiet_count], samples[quiet_count:]
    quiet_share = float(quiet_samples.std() / samples.std())
    is_large = quiet_samples.std() > MAX_QUIET_SHARE * max(float(samples.std()), known.usual_rms)
    if not is_large or quiet_samples.std() < MAX_STATED_NOISES * known.noise_rms:
        return None
    if _is_smooth(quiet_samples, driven_samples):
        first_samples = quiet_samples[: max(8, quiet_count // 10)]
        from_mean = float(np.sqrt(np.mean((first_samples - quiet_samples.mean()) ** 2)))
        moves_at_once = first_samples.std() > MAX_QUIET_SHARE * quiet_samples.std()
        if moves_at_once and from_mean > MIN_MOVING_SHARE * quiet_samples.std():
            return None
        return Finding(
            cause="force",
            channels=(*force_names, name),
            evidence=f"{name} moves as it does later, with {100 * quiet_share:.2g} % of its root mean square, before "
            "the force begins",
            mend="check that the force is of this record and on its clock, or let the rig come to rest first",
        )
    return Finding(
        cause="noise",
        channels=(name,),
        evidence=f"{name} shows {100 * quiet_share:.2g} % of its root mean square before the force begins",
        mend="find the noise or the motion (cable, amplifier, range), or let the rig come to rest first",
    )


def _is_smooth(quiet_samples: Float[np.ndarray, " quiet"], driven_samples: Float[np.ndarray, " driven"]) -> bool:
    """True if what is there before the force is as smooth as the motion later, and no noise."""
    quiet_roughness, driven_roughness = (
        float(np.diff(part).std() / (part.std() or 1.0)) for part in (quiet_samples, driven_samples)
    )
    return quiet_roughness < NOISE_ROUGHNESS_RATIO * driven_roughness


def moves_before_force(rate_hz: float, samples: Row, forces_n: Rows) -> bool:
    """True if the channel moves smoothly, by a part of its later motion, before the force begins."""
    quiet_count = quiet_sample_count(forces_n, rate_hz)
    quiet_samples, driven_samples = samples[:quiet_count], samples[quiet_count:]
    if not quiet_count or quiet_samples.std() < MAX_QUIET_SHARE * samples.std():
        return False
    return _is_smooth(quiet_samples, driven_samples)


def mains_tone_hz_and_amplitude(rate_hz: float, samples: Row, forces_n: Rows) -> tuple[float, float] | None:
    """Frequency and amplitude of a mains tone that stands out, in the quiet start if there is one."""
    quiet_count = quiet_sample_count(forces_n, rate_hz)
    quiet_part = samples[:quiet_count] if quiet_count > 0.4 * rate_hz else samples
    centred_samples = quiet_part - quiet_part.mean()
    line_amplitudes = np.abs(np.fft.rfft(centred_samples * np.hanning(centred_samples.size))) * 4 / centred_samples.size
    line_hz = np.fft.rfftfreq(centred_samples.size, 1 / rate_hz)
    resolution_hz = line_hz[1]
    for mains_hz in (50.0, 60.0):
        distance_hz = np.abs(line_hz - mains_hz)
        tone_mask = distance_hz <= max(0.15, 1.5 * resolution_hz)
        beside_mask = (distance_hz > max(0.6, 3 * resolution_hz)) & (distance_hz < max(3.0, 9 * resolution_hz))
        if not (tone_mask.any() and beside_mask.any()):
            continue
        amplitude = float(line_amplitudes[tone_mask].max())
        background_amplitude = float(np.sqrt(np.mean(line_amplitudes[beside_mask] ** 2)))
        if amplitude > max(2 * TONE_TO_BACKGROUND_RATIO * background_amplitude, MIN_TONE_SHARE * float(samples.std())):
            return float(line_hz[tone_mask][np.argmax(line_amplitudes[tone_mask])]), amplitude
    return None


def hum_finding(name: str, rate_hz: float, samples: Row, forces_n: Rows) -> Finding | None:
    """Finding: a mains tone."""
    tone_hz_and_amplitude, channel_amplitude = (
        mains_tone_hz_and_amplitude(rate_hz, samples, forces_n),
        float(samples.std() * np.sqrt(2)),
    )
    if tone_hz_and_amplitude is None or channel_amplitude == 0:  # also of values so small that their squares are zero
        return None
    tone_hz, amplitude = tone_hz_and_amplitude
    return Finding(
        cause="hum",
        channels=(name,),
        evidence=f"{name} holds a tone of {tone_hz:.3g} Hz, {100 * amplitude / channel_amplitude:.2g} % of its size, "
        "that the force does not make: mains hum",
        mend="ground the cables at one end, keep them away from mains cables, and record again",
    )


def offset_finding(name: str, samples: Row, usual_rms: float | None = None) -> Finding | None:
    """Finding: samples with a mean that should have none: of an acceleration, or of motion before the force begins."""
    mean, rms = float(samples.mean()), float(samples.std()) if usual_rms is None else usual_rms
    if abs(mean) <= MAX_OFFSET_SHARE * rms or not rms:
        return None
    return Finding(
        cause="offset",
        channels=(name,),
        evidence=f"{name} has a constant part of {mean:.3g}, {100 * abs(mean) / rms:.2g} % of its root mean square",
        mend="take the mean off, or couple it AC",
    )


def drift_finding(name: str, rate_hz: float, samples: Row) -> Finding | None:
    """Finding: slow motion that the acceleration of a moving rig cannot have."""
    sample_count = samples.size
    weights = np.hanning(sample_count + 2)[1:-1]  # none of them zero, of few samples either
    mean = np.average(samples, weights=weights)  # that of all samples is no drift of a decay's quiet end
    power_by_line = np.abs(np.fft.rfft((samples - mean) * weights)) ** 2
    slow_line_end = int(DRIFT_BELOW_HZ * sample_count / rate_hz) + 1
    slow_share = float(np.sqrt(np.sum(power_by_line[1:slow_line_end]) / (np.sum(power_by_line) or 1.0)))
    if slow_share < MIN_DRIFT_SHARE:
        return None
    return Finding(
        cause="drift",
        channels=(name,),
        evidence=f"{name} drifts: {100 * slow_share:.2g} % of its root mean square lies below {DRIFT_BELOW_HZ:g} Hz",
        mend="let the amplifier warm up, keep it from temperature changes, or high-pass it",
    )


def initial_motion_finding(
    name: str, rate_hz: float, samples: Row, rest_s: float, noise_rms: float = 0.0
) -> Finding | None:
    """Finding: the channel moves by a part of its usual motion, beyond stated noise, in the record's first moments."""
    beginning_samples = samples[: max(8, round(rest_s * rate_hz))]
    if beginning_samples.std() < max(MIN_MOVING_SHARE * samples.std(), MAX_STATED_NOISES * noise_rms):
        return None
    return Finding(
        cause="not at rest",
        channels=(name,),
        evidence=f"{name} moves already at the record's first samples",
        mend="begin the record with a second at rest, before the force; of a cut record, the beginning is missing",
    )


def reversed_time_finding(names: tuple[str, ...]) -> Finding:
    """Finding: all motion stops with the force, without ringing, and does not begin from rest."""
    return Finding(
        cause="not at rest",
        channels=names,
        evidence="the motion does not begin at rest and stops at once where the force ends, as if time ran backwards",
        mend="put the samples of all channels in the order in which they were taken",
    )
