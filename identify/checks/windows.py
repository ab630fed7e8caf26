"""Windows of an analyser in a history: blocks in which all that a channel shows rises and falls alike.

The deviation of each sample from the cubic through its neighbours is what a channel shows at its highest frequencies,
noise mostly. Its level over time, folded at the length of a block, shows the window.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.checks.findings import Finding
from identify.checks.waveforms import Row, Rows, neighbour_deviation

FRAME_SAMPLES, FRAME_COUNT = 16, 500
"""Least samples of a frame whose level is taken, and the number of frames that a record has at most."""
MIN_BLOCK_FRAMES, MIN_BLOCKS = 10, 3
"""Frames of the shortest block, and blocks of a record."""
MIN_FOLDED_SHARE, MIN_LEVEL_FACTOR = 0.4, 3.0
"""Least share of the levels' variance that a window explains, and least factor of the levels in a block. Set by hand:
hits every two seconds explain 0.17, and change the levels by a factor of 20."""
MIN_EXPONENTIAL_SHARE, MIN_OTHER_SHARE = 0.8, 0.6
"""Least share of a window's logarithm that a line explains, if it is exponential; least share of the levels' variance
that another window explains."""
HIT_SHARE = 0.05
"""Share of its peak from which on a force acts."""


@dataclass(frozen=True)
class _Fold:
    """Mean logarithm of the level by the frame of a block, and the share of the variance that it explains."""

    block_frames: float
    profile: Float[np.ndarray, " bins"]
    explained_share: float

    @property
    def jump_bin(self) -> int:
        """Bin before which the level rises most."""
        return int(np.argmax(np.diff(self.profile, prepend=self.profile[-1])))

    def exponential_decay_frames(self) -> float | None:
        """Frames in which an exponential window falls to 37 %; None if the window has another form."""
        begun_at_jump = np.roll(self.profile, -self.jump_bin)[1:-1]  # the jump may lie within a bin
        phases = np.arange(begun_at_jump.size) / self.profile.size
        slope, level = np.polyfit(phases, begun_at_jump, 1)
        left_share = float(np.var(begun_at_jump - level - slope * phases) / np.var(self.profile))
        return -self.block_frames / float(slope) if slope < 0 and left_share < 1 - MIN_EXPONENTIAL_SHARE else None


def window_finding(name: str, rate_hz: float, samples: Row, forces_n: Rows) -> Finding | None:
    """Finding: blocks of the channel were multiplied by a window. Blocks that begin with a hit may as well ring."""
    deviations = np.abs(neighbour_deviation(samples))
    frame_samples = max(FRAME_SAMPLES, deviations.size // FRAME_COUNT)
    frame_count = deviations.size // frame_samples
    levels = np.median(deviations[: frame_count * frame_samples].reshape(frame_count, frame_samples), axis=1)
    if frame_count < MIN_BLOCKS * MIN_BLOCK_FRAMES:
        return None
    first_frame = int(np.argmax(levels > 0.1 * np.median(levels)))  # a start without noise is no block
    log_levels = np.log(np.maximum(levels[first_frame:], 1e-9 * levels.max()))
    if log_levels.size < MIN_BLOCKS * MIN_BLOCK_FRAMES or not levels.max():
        return None
    fold = _best_fold(log_levels)
    level_factor, decay_frames = float(np.exp(np.ptp(fold.profile))), fold.exponential_decay_frames()
    min_share = MIN_OTHER_SHARE if decay_frames is None else MIN_FOLDED_SHARE
    if fold.explained_share < min_share or level_factor < MIN_LEVEL_FACTOR:
        return None
    if _jumps_with_hits(fold, first_frame, frame_samples, forces_n):
        return None
    frame_s = frame_samples / rate_hz
    window_words = "a window" if decay_frames is None else f"exp(-t / {decay_frames * frame_s:.2g} s)"
    return Finding(
        cause="windowed",
        channels=(name,),
        evidence=f"all that {name} shows, its noise too, changes by a factor of {level_factor:.2g} within every "
        f"{fold.block_frames * frame_s:.3g} s and begins anew, as blocks of an analyser times {window_words}",
        mend="record, or export, without windows on force and response; no model of a machine fits windowed histories",
    )


def _best_fold(log_levels: Float[np.ndarray, " frames"]) -> _Fold:
    """Fold at the block that explains most of the levels; of a block and its multiples, the shortest."""
    block_frames, folds = float(MIN_BLOCK_FRAMES), []
    while block_frames <= log_levels.size / MIN_BLOCKS:
        folds.append(_fold(log_levels, block_frames))
        block_frames += 0.25 * block_frames**2 / log_levels.size  # a quarter of a frame over the record
    best_share = max(fold.explained_share for fold in folds)
    return next(fold for fold in folds if fold.explained_share >= best_share - 0.1 * abs(best_share))


def _fold(log_levels: Float[np.ndarray, " frames"], block_frames: float) -> _Fold:
    """Profile of one block, and the share of the variance that it explains, less what as many means do by chance."""
    bin_count = int(block_frames)
    bins = (np.arange(log_levels.size) % block_frames / block_frames * bin_count).astype(int)
    profile = np.bincount(bins, log_levels, bin_count) / np.maximum(np.bincount(bins, minlength=bin_count), 1)
    variance_left = np.sum((log_levels - profile[bins]) ** 2) / (log_levels.size - bin_count)
    return _Fold(block_frames, profile, float(1 - variance_left / max(float(np.var(log_levels, ddof=1)), 1e-300)))


def _jumps_with_hits(fold: _Fold, first_frame: int, frame_samples: int, forces_n: Rows) -> bool:
    """True if most jumps of the level come with a force that begins there, after none."""
    is_acting = np.abs(forces_n) > HIT_SHARE * np.abs(forces_n).max(axis=-1, keepdims=True)
    is_acting = is_acting.reshape(-1, is_acting.shape[-1]).any(axis=0)
    block_count = int((is_acting.size / frame_samples - first_frame) / fold.block_frames)
    phase = fold.jump_bin / fold.profile.size
    jumps = ((first_frame + (np.arange(block_count) + phase) * fold.block_frames) * frame_samples).astype(int)
    begins = [
        is_acting[max(0, k - frame_samples) : k + 2 * frame_samples].any()
        and not is_acting[max(0, k - 3 * frame_samples) : max(0, k - frame_samples)].any()
        for k in jumps.tolist()
    ]
    return bool(np.mean(begins) > 0.5) if begins else False
