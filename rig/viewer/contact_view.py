"""A contact in the viewer: close up, over time, and its events."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import rerun as rr
from jaxtyping import Bool, Float, Int, UInt8
from scipy.ndimage import maximum_filter1d

from rig.model.contact_laws import ContactLaw
from rig.model.description import Contact
from rig.viewer.blueprint import TRAIL_S
from rig.viewer.drawing import (
    BELIEVED,
    CLOSED,
    FAINT,
    FOUND,
    FREE,
    LINES,
    STEEL,
    TIMELINE,
    Colour,
    entity,
    pixels,
    send,
    send_labels,
    send_legend,
    send_lines,
    style,
)

TRAIL_POINTS = 60
HATCHES = 16
DASHES = 24
MAX_CLOSINGS = 20_000
"""In the log, which nobody reads to its end."""
MAX_KEPT = 1_000_000
NEAR_S = 0.005
"""So long before and after a contact every sample is drawn."""
OTHERS: dict[str, Colour] = {"believed": BELIEVED, "identified": FOUND}
SIDES = {-1: "upper", 1: "lower"}
COLUMNS = (1.85, -1.85, 0.55)
"""Where the figures of the walls and of the others stand, of the reach."""


Known = Literal["true", "identified", "believed"]


@dataclass(frozen=True)
class Play:
    """A contact over the record. Its own law is drawn as walls, and says when it is closed; walls says whose it is.

    others are laws drawn over it, by name; force_n is the contact force where it is known. The samples may be some of
    the record's: what was identified begins later and ends at until_s. frames are those that are drawn, and one of
    `stride` samples is in the time series, but all near a contact.
    """

    contact: Contact
    walls: Known
    others: Mapping[Known, ContactLaw]
    time_s: Float[np.ndarray, " samples"]
    until_s: float | None
    relative_m: Float[np.ndarray, " samples"]
    force_n: Float[np.ndarray, " samples"] | None
    frames: Int[np.ndarray, " frames"]
    stride: int

    @cached_property
    def reach_mm(self) -> float:
        """Reach of the views of the contact, mm."""
        law, largest = self.contact.law, float(np.abs(self.relative_m).max())
        return 1.2e3 * max(law.lower_clearance_m, law.upper_clearance_m, largest) or 1.0

    @cached_property
    def depth_m(self) -> Float[np.ndarray, " samples"]:
        return np.asarray(self.contact.law.penetration_m(self.relative_m, self.time_s))

    @cached_property
    def closed(self) -> Bool[np.ndarray, " samples"]:
        return self.depth_m != 0

    @property
    def rate_hz(self) -> float:
        return float((self.time_s.size - 1) / (self.time_s[-1] - self.time_s[0])) if self.time_s.size > 1 else 1.0

    @cached_property
    def kept(self) -> Int[np.ndarray, " kept"]:
        """Every sample near a contact, one of `stride` and the frames elsewhere; of more than a million some are."""
        wide = max(1, round(NEAR_S * self.rate_hz))
        chosen = maximum_filter1d(self.closed.view(np.uint8), 2 * wide + 1, mode="constant").view(bool)
        chosen[:: self.stride] = True
        chosen[self.frames] = True
        kept = np.flatnonzero(chosen)
        return kept[:: -(-kept.size // MAX_KEPT)] if kept.size else kept

    @property
    def colours(self) -> UInt8[np.ndarray, "frames 3"]:
        return np.where(self.closed[self.frames, None], CLOSED, FREE).astype(np.uint8)


def send_close_up(stream: rr.RecordingStream, play: Play) -> None:
    """The relative displacement in mm, upwards, between its two walls, with what it was just before to its left.

    The figures of a wall stand beyond it, so that they cannot be taken for the other's however close both are; those
    of each law in a column of their own: right, left and before the trail.
    """
    path, law, across = entity("close_up", play.contact.name), play.contact.law, 1.1 * play.reach_mm
    time_s = play.time_s[play.frames]
    edges = np.linspace(-across, across, HATCHES + 1)
    for level, out in _levels(law):
        hatches = [[[x, level], [x - 0.05 * across, level + out * 0.05 * across]] for x in edges[1:]]
        walls = [[[-across, level], [across, level]], *hatches]
        style(stream, f"{path}/{SIDES[out]}", rr.LineStrips2D(walls, colors=[STEEL], radii=pixels(1.5)))
    _send_levels(stream, f"{path}/{play.walls}", play, law, COLUMNS[0], STEEL)
    for column, (name, other) in zip(COLUMNS[1:], play.others.items(), strict=False):
        ends = np.linspace(-across, across, 2 * DASHES).reshape(DASHES, 2)
        dashes = [[[a, level], [b, level]] for level, _ in _levels(other) for a, b in ends]
        drawn = rr.LineStrips2D(dashes, colors=[OTHERS[name]], radii=pixels(1.25), draw_order=40.0)
        style(stream, f"{path}/{name}", drawn)
        _send_levels(stream, f"{path}/{name}", play, other, column, OTHERS[name])
    now_x = 0.15 * across
    back = np.linspace(-TRAIL_S * play.rate_hz, 0, TRAIL_POINTS).round().astype(int)
    trail = np.empty((play.frames.size, TRAIL_POINTS, 2))
    trail[..., 0] = now_x + (across + now_x) * back / -back[0]
    trail[..., 1] = -1e3 * play.relative_m[np.maximum(play.frames[:, None] + back, 0)]
    middle = rr.LineStrips2D([[[-across, 0], [across, 0]]], colors=[FAINT], radii=pixels(0.5))
    style(stream, f"{path}/middle", middle)
    style(stream, f"{path}/trail", rr.LineStrips2D.from_fields(colors=[LINES[0]], radii=[pixels(0.75)]))
    send(stream, f"{path}/trail", time_s, rr.LineStrips2D, strips=trail)
    style(stream, f"{path}/point", rr.Points2D.from_fields(radii=[pixels(7.0)]))
    send(stream, f"{path}/point", time_s, rr.Points2D, positions=trail[:, -1], colors=play.colours)
    above = [[0, -1.5 * play.reach_mm]]
    style(stream, f"{path}/reading", rr.Points2D.from_fields(positions=above, radii=[0]))
    send(stream, f"{path}/reading", time_s, rr.Points2D, labels=_readings(play), colors=play.colours)
    if play.until_s is not None:
        stream.set_time(TIMELINE, duration=play.until_s)
        for part in ("trail", "point"):
            stream.log(f"{path}/{part}", rr.Clear(recursive=False))
        stream.log(f"{path}/reading", rr.Points2D.from_fields(labels=["not identified"], colors=[STEEL]))


def _levels(law: ContactLaw) -> list[tuple[float, int]]:
    """Levels of the upper and the lower wall in the view, mm (y points downwards), and which way is beyond them."""
    return [(-1e3 * law.upper_clearance_m, -1), (1e3 * law.lower_clearance_m, 1)]


def _send_levels(
    stream: rr.RecordingStream, path: str, play: Play, law: ContactLaw, column: float, colour: Colour
) -> None:
    name = path.rpartition("/")[2]
    for level, out in _levels(law):
        place = [column * play.reach_mm, level - 0.28 * play.reach_mm * (out < 0)]
        send_labels(stream, f"{path}/{SIDES[out]}", [place], [f"{name} {-level:+.4g} mm"], colour)


def _readings(play: Play) -> list[str]:
    """Relative displacement, penetration and force of every frame, in words."""
    words = []
    for frame in play.frames:
        force = "" if play.force_n is None else f", {play.force_n[frame]:+.1f} N"
        deep = f"{1e3 * abs(play.depth_m[frame]):.2f} mm deep{force}, closed" if play.closed[frame] else "free"
        words.append(f"{1e3 * play.relative_m[frame]:+.2f} mm, {deep}")
    return words


def send_over_time(stream: rr.RecordingStream, play: Play) -> None:
    """The relative displacement with all walls; where it closes and opens is marked."""
    path, ends = entity("relative_displacement", play.contact.name), play.time_s[[0, -1]]
    legend = [(play.contact.name, LINES[0])]
    for name, law in (("walls", play.contact.law), *play.others.items()):
        colour = OTHERS.get(name, CLOSED)
        limits = 1e3 * np.array([law.upper_clearance_m, -law.lower_clearance_m])
        names = [f"{play.walls if name == 'walls' else name} {limit:+.5g} mm" for limit in limits]
        send_lines(stream, f"{path}/{name}", ends, np.tile(limits[:, None], 2), names, (colour,))
        legend += [(name, colour) for name in names]
    value = 1e3 * play.relative_m[None, play.kept]
    send_lines(stream, f"{path}/value", play.time_s[play.kept], value, [play.contact.name], LINES)
    for name, samples, colour in (("closes", _changes(play)[0], CLOSED), ("opens", _changes(play)[1], FREE)):
        style(stream, f"{path}/{name}", rr.SeriesPoints(colors=[colour], names=[name], marker_sizes=[3.0]))
        send(stream, f"{path}/{name}", play.time_s[samples], rr.Scalars, scalars=1e3 * play.relative_m[samples])
        legend.append((f"● {name}", colour))
    send_legend(stream, path, legend)


def send_events(stream: rr.RecordingStream, play: Play) -> None:
    """A line in the log, and a mark on the timeline, at every sample at which the contact has closed or opened.

    Of more than 20 000 closings the first are listed, and how many follow.
    """
    every = _changes(play)
    closes, opens = (samples[:MAX_CLOSINGS] for samples in every)
    words = [f"{play.contact.name} closes at its {'upper' if play.depth_m[s] > 0 else 'lower'} stop" for s in closes]
    starts = np.concatenate([[0], closes])[np.searchsorted(closes, opens)]  # an opening ends the closing before it
    for start, sample in zip(starts, opens, strict=True):
        lasted_ms = 1e3 * (play.time_s[sample] - play.time_s[start])
        deepest_mm = 1e3 * np.abs(play.depth_m[start:sample]).max()
        words.append(f"{play.contact.name} opens after {lasted_ms:.3g} ms, at most {deepest_mm:.3g} mm deep")
    if unlisted := every[0].size - closes.size:
        words[closes.size - 1] += f"; it closes {unlisted} times more, which are not listed"
    samples = np.concatenate([closes, opens])
    order = np.argsort(samples, kind="stable")
    levels = np.array([rr.TextLogLevel.WARN] * closes.size + [rr.TextLogLevel.INFO] * opens.size)
    colours = np.array([CLOSED] * closes.size + [FREE] * opens.size, dtype=np.uint8).reshape(-1, 3)
    send(
        stream,
        entity("events", play.contact.name),
        play.time_s[samples[order]],
        rr.TextLog,
        text=[f"{play.time_s[samples[i]]:.4f} s: {words[i]}" for i in order],
        level=[str(levels[i]) for i in order],
        color=colours[order],
    )


def _changes(play: Play) -> tuple[Int[np.ndarray, " closings"], Int[np.ndarray, " openings"]]:
    """The first samples at which it is closed, and at which it is free again."""
    steps = np.diff(play.closed.astype(int))
    return np.flatnonzero(steps == 1) + 1, np.flatnonzero(steps == -1) + 1
