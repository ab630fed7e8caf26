"""A contact in the viewer: close up, over time, as force over relative displacement, and its events."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import rerun as rr
from jaxtyping import Bool, Float, Int, UInt8
from scipy.ndimage import binary_dilation

from rig.model.contact_laws import ContactLaw
from rig.model.description import Contact
from rig.viewer.blueprint import TRAIL_S, entity
from rig.viewer.drawing import CLOSED, FAINT, FOUND, FREE, LINES, STEEL, Colour, pixels, send, send_lines, style

TRAIL_POINTS = 60
HATCHES = 16
DASHES = 24
BINS = 120
NEAR_S = 0.005
"""So long before and after a contact every sample is drawn."""
OTHERS: dict[str, Colour] = {"believed": FAINT, "identified": FOUND}


@dataclass(frozen=True)
class Play:
    """A contact over the record. Its own law is drawn as walls: the true one, or without a truth the believed one.

    others are laws drawn over it, by name; force_n is the contact force where it is known. frames are the samples that
    are drawn, and one of `stride` samples is in the time series, but all near a contact.
    """

    contact: Contact
    others: Mapping[str, ContactLaw]
    time_s: Float[np.ndarray, " samples"]
    relative_m: Float[np.ndarray, " samples"]
    force_n: Float[np.ndarray, " samples"] | None
    frames: Int[np.ndarray, " frames"]
    stride: int
    reach_mm: float

    @cached_property
    def depth_m(self) -> Float[np.ndarray, " samples"]:
        return np.asarray(self.contact.law.penetration_m(self.relative_m, self.time_s))

    @cached_property
    def closed(self) -> Bool[np.ndarray, " samples"]:
        return self.depth_m != 0

    @cached_property
    def kept(self) -> Int[np.ndarray, " kept"]:
        """Every sample near a contact, one of `stride` and the frames elsewhere."""
        wide = max(1, round(NEAR_S / max(self.time_s[-1] / self.time_s.size, 1e-9)))
        chosen = binary_dilation(self.closed, np.ones(2 * wide + 1, dtype=bool))
        chosen[:: self.stride] = True
        chosen[self.frames] = True
        return np.flatnonzero(chosen)

    @property
    def colours(self) -> UInt8[np.ndarray, "frames 3"]:
        return np.where(self.closed[self.frames, None], CLOSED, FREE).astype(np.uint8)


def send_close_up(stream: rr.RecordingStream, play: Play) -> None:
    """The relative displacement in mm, upwards, between its two walls, with what it was just before to its left."""
    path, law, across = entity("close_up", play.contact.name), play.contact.law, 1.1 * play.reach_mm
    time_s = play.time_s[play.frames]
    for level, solid in ((-1e3 * law.upper_clearance_m, -1), (1e3 * law.lower_clearance_m, 1)):  # y points downwards
        side = "upper" if solid < 0 else "lower"
        edges = np.linspace(-across, across, HATCHES + 1)
        hatches = [[[x, level], [x - 0.05 * across, level + solid * 0.05 * across]] for x in edges[1:]]
        walls = [[[-across, level], [across, level]], *hatches]
        style(stream, f"{path}/{side}", rr.LineStrips2D(walls, colors=[STEEL], radii=pixels(1.5)))
        place = [0.85 * across, level if solid < 0 else level - 0.17 * play.reach_mm]
        style(stream, f"{path}/{side}/level", rr.Points2D([place], colors=[STEEL], radii=0, labels=[f"{-level:+g} mm"]))
    for name, other in play.others.items():
        _send_dashed_walls(stream, f"{path}/{name}", other, across, name)
    rate, now_x = play.time_s.size / play.time_s[-1], 0.15 * across
    back = np.linspace(-TRAIL_S * rate, 0, TRAIL_POINTS).round().astype(int)
    trail = np.empty((play.frames.size, TRAIL_POINTS, 2))
    trail[..., 0] = now_x + (across + now_x) * back / -back[0]
    trail[..., 1] = -1e3 * play.relative_m[np.maximum(play.frames[:, None] + back, 0)]
    middle = rr.LineStrips2D([[[-across, 0], [across, 0]]], colors=[FAINT], radii=pixels(0.5))
    style(stream, f"{path}/middle", middle)
    style(stream, f"{path}/trail", rr.LineStrips2D.from_fields(colors=[LINES[0]], radii=[pixels(0.75)]))
    send(stream, f"{path}/trail", time_s, rr.LineStrips2D, strips=trail)
    style(stream, f"{path}/point", rr.Points2D.from_fields(radii=[pixels(7.0)]))
    send(stream, f"{path}/point", time_s, rr.Points2D, positions=trail[:, -1], colors=play.colours)
    style(
        stream, f"{path}/reading", rr.Points2D.from_fields(positions=[[0.6 * across, -0.3 * play.reach_mm]], radii=[0])
    )
    send(stream, f"{path}/reading", time_s, rr.Points2D, labels=_readings(play), colors=play.colours)


def _readings(play: Play) -> list[str]:
    """Relative displacement, penetration and force of every frame, in words."""
    words = []
    for frame in play.frames:
        force = "" if play.force_n is None else f", {play.force_n[frame]:+.1f} N"
        deep = f"{1e3 * abs(play.depth_m[frame]):.2f} mm deep{force}, closed" if play.closed[frame] else "free"
        words.append(f"{1e3 * play.relative_m[frame]:+.2f} mm, {deep}")
    return words


def _send_dashed_walls(stream: rr.RecordingStream, path: str, law: ContactLaw, across: float, name: str) -> None:
    ends = np.linspace(-across, across, 2 * DASHES).reshape(DASHES, 2)
    levels = (-1e3 * law.upper_clearance_m, 1e3 * law.lower_clearance_m)
    dashes = [[[a, level], [b, level]] for level in levels for a, b in ends]
    style(stream, path, rr.LineStrips2D(dashes, colors=[OTHERS[name]], radii=pixels(1.25), draw_order=40.0))
    places = [[-0.75 * across, levels[0] + 0.2 * across], [-0.75 * across, levels[1] - 0.2 * across]]
    labels = [f"{name} {-level:+.4g} mm" for level in levels]
    style(stream, f"{path}/level", rr.Points2D(places, colors=[OTHERS[name]], radii=0, labels=labels))


def send_over_time(stream: rr.RecordingStream, play: Play) -> None:
    """The relative displacement with all walls; where it closes and opens is marked."""
    path, ends = entity("relative_displacement", play.contact.name), play.time_s[[0, -1]]
    for name, law, colour in (
        ("walls", play.contact.law, CLOSED),
        *((name, law, OTHERS[name]) for name, law in play.others.items()),
    ):
        limits = 1e3 * np.array([law.upper_clearance_m, -law.lower_clearance_m])
        names = [f"{'wall' if name == 'walls' else name}, {limit:+.5g} mm" for limit in limits]
        send_lines(stream, f"{path}/{name}", ends, np.tile(limits[:, None], 2), names, (colour,))
    value = 1e3 * play.relative_m[None, play.kept]
    send_lines(stream, f"{path}/value", play.time_s[play.kept], value, [play.contact.name], LINES)
    for name, samples, colour in (("closes", _changes(play)[0], CLOSED), ("opens", _changes(play)[1], FREE)):
        style(stream, f"{path}/{name}", rr.SeriesPoints(colors=[colour], names=[name], marker_sizes=[3.0]))
        send(stream, f"{path}/{name}", play.time_s[samples], rr.Scalars, scalars=1e3 * play.relative_m[samples])


def send_events(stream: rr.RecordingStream, play: Play) -> None:
    """A line in the log, and a mark on the timeline, at every sample at which the contact has closed or opened."""
    closes, opens = _changes(play)
    words = [f"{play.contact.name} closes at its {'upper' if play.depth_m[s] > 0 else 'lower'} stop" for s in closes]
    for sample in opens:
        before = closes[closes < sample]
        start = int(before[-1]) if before.size else 0
        lasted_ms = 1e3 * (play.time_s[sample] - play.time_s[start])
        deepest_mm = 1e3 * np.abs(play.depth_m[start:sample]).max()
        words.append(f"{play.contact.name} opens after {lasted_ms:.3g} ms, at most {deepest_mm:.3g} mm deep")
    samples = np.concatenate([closes, opens])
    order = np.argsort(samples, kind="stable")
    levels = np.array([rr.TextLogLevel.WARN] * closes.size + [rr.TextLogLevel.INFO] * opens.size)
    colours = np.array([CLOSED] * closes.size + [FREE] * opens.size, dtype=np.uint8).reshape(-1, 3)
    send(
        stream,
        entity("events", play.contact.name),
        play.time_s[samples[order]],
        rr.TextLog,
        text=[words[i] for i in order],
        level=[str(levels[i]) for i in order],
        color=colours[order],
    )


def _changes(play: Play) -> tuple[Int[np.ndarray, " closings"], Int[np.ndarray, " openings"]]:
    """The first samples at which it is closed, and at which it is free again."""
    steps = np.diff(play.closed.astype(int))
    return np.flatnonzero(steps == 1) + 1, np.flatnonzero(steps == -1) + 1


def send_phase(stream: rr.RecordingStream, play: Play) -> None:
    """Contact force (upwards) over relative displacement (mm), frame by frame, over the laws; and the histogram.

    A frame's line goes from its sample to the next frame's, so that the view, which shows all until the moment, grows.
    """
    path, reach, name = entity("phase", play.contact.name), play.reach_mm, play.contact.name
    if play.force_n is not None:
        largest_n = float(np.abs(play.force_n).max()) or 1.0
        scale = 0.8 * reach / largest_n
        eta = np.linspace(play.relative_m.min(), play.relative_m.max(), 401)
        laws = {"law": play.contact.law, **play.others}
        for depth, (label, law) in enumerate(laws.items()):
            line = np.stack([1e3 * eta, -scale * law.force_n(eta, np.zeros(eta.size))], axis=1)
            drawn = {"colors": [OTHERS.get(label, STEEL)], "radii": pixels(1.0), "draw_order": 10.0 + depth}
            style(stream, f"{path}/{label}", rr.LineStrips2D([line], **drawn))
        labels = [f"{largest_n:.3g} N", f"{-largest_n:.3g} N", f"{reach:.3g} mm"]
        places = [[0, -0.8 * reach], [0, 0.8 * reach], [1.05 * reach, 0]]
        style(stream, f"{path}/scale", rr.Points2D(places, colors=[FAINT], radii=pixels(2.0), labels=labels))
        axes = [[[-1.1 * reach, 0], [1.1 * reach, 0]], [[0, -0.95 * reach], [0, 0.95 * reach]]]
        style(stream, f"{path}/axes", rr.LineStrips2D(axes, colors=[FAINT], radii=pixels(0.5)))
        style(
            stream,
            f"{path}/seen",
            rr.LineStrips2D.from_fields(colors=[LINES[1]], radii=[pixels(1.25)], draw_order=50.0),
        )
        points = np.stack([1e3 * play.relative_m, -scale * play.force_n], axis=1)[play.kept]
        at = np.searchsorted(play.kept, play.frames)
        strips = [points[a : b + 1] for a, b in pairwise(at)]
        send(stream, f"{path}/seen", play.time_s[play.frames[1:]], rr.LineStrips2D, strips=strips)
    counts, edges = np.histogram(1e3 * play.relative_m, BINS, range=(-reach, reach))
    share = 100 * counts / max(play.relative_m.size, 1)
    middle = (edges[1:] + edges[:-1]) / 2
    style(stream, entity("histogram", name), rr.BarChart(share, abscissa=middle, color=LINES[0]))
