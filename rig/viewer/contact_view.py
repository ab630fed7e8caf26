"""A contact in the viewer: close up, over time, its events, force over displacement, and the histogram."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Literal

import numpy as np
import rerun as rr
from jaxtyping import Bool, Float, Int, UInt8
from scipy.ndimage import maximum_filter1d

from rig.model.contact_laws import ContactLaw, walls_m
from rig.model.description import Contact
from rig.viewer.axes import Axes
from rig.viewer.blueprint import TRAIL_S
from rig.viewer.drawing import TIMELINE, entity, pixels, send, send_labels, send_legend, send_lines, style
from rig.viewer.palette import CLOSED, FAINT, FORCE, FOUND, MACHINE, SOURCES, STEEL, Colour

TRAIL_POINTS = 60
HATCHES = 16
DASHES = 24
MAX_CLOSINGS = 20_000
"""Largest number of closings in the log."""
MAX_PLOTTED = 1_000_000
FAR = 5.0
"""Clearance over the other one and the largest motion beyond which a stop is out of reach and of view."""
NEAR_S = 0.005
"""Time before and after a contact within which every sample is drawn, s."""
CHANGES = (("closes", "circle", "●"), ("opens", "diamond", "◆"))
"""Marks of the first closed and of the first free sample; both bound the time in contact and have its colour."""
SIDES = {-1: "upper", 1: "lower"}
COLUMNS = (1.85, -1.85, 0.55)
"""Positions of the labels of the walls and of overlaid laws, relative to the reach."""


LawSource = Literal["true", "identified", "believed"]


@dataclass(frozen=True)
class ContactMotion:
    """Motion of a contact over the record. Its law is drawn as walls and defines closure; wall_source is the law's.

    overlaid are laws drawn over it, by source; force_n is the contact force where it is known. The samples may be a
    part of the record: identified motion, for which is_identified is true, begins later and ends at until_s. frames
    are drawn; the time series hold every `stride`-th sample, and all near a contact.
    """

    contact: Contact
    wall_source: LawSource
    overlaid: Mapping[LawSource, ContactLaw]
    time_s: Float[np.ndarray, " samples"]
    until_s: float | None
    relative_m: Float[np.ndarray, " samples"]
    force_n: Float[np.ndarray, " samples"] | None
    frames: Int[np.ndarray, " frames"]
    stride: int
    is_identified: bool = False

    @property
    def colour(self) -> Colour:
        return FOUND if self.is_identified else MACHINE

    @cached_property
    def reach_mm(self) -> float:
        """Half width of the views of the contact, mm: the motion and the stops, unless a stop is far out of reach."""
        law, largest = self.contact.law, float(np.abs(self.relative_m).max())
        walls = sorted(abs(wall_m) for wall_m, _ in walls_m(law))
        in_reach = [wall_m for wall_m in walls if wall_m <= FAR * max(walls[0], largest)]
        return 1.2e3 * max([largest, *in_reach]) or 1.0

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
    def plotted_samples(self) -> Int[np.ndarray, " plotted_samples"]:
        """Plotted samples: all near a contact, every `stride`-th and the frames elsewhere; at most MAX_PLOTTED."""
        reach = max(1, round(NEAR_S * self.rate_hz))
        is_plotted = maximum_filter1d(self.closed.view(np.uint8), 2 * reach + 1, mode="constant").view(bool)
        is_plotted[:: self.stride] = True
        is_plotted[self.frames] = True
        plotted_samples = np.flatnonzero(is_plotted)
        return plotted_samples[:: -(-plotted_samples.size // MAX_PLOTTED)] if plotted_samples.size else plotted_samples

    @property
    def colours(self) -> UInt8[np.ndarray, "frames 3"]:
        return np.where(self.closed[self.frames, None], CLOSED, self.colour).astype(np.uint8)


def send_close_up(stream: rr.RecordingStream, contact_motion: ContactMotion) -> None:
    """Send the close-up: relative displacement (mm, upwards) between the two walls, with its recent trail to the left.

    The label of a wall is beyond it, so that it cannot be mistaken for that of the other; each law has its own column
    of labels: right, left and before the trail.
    """
    path, law, across = (
        entity("close_up", contact_motion.contact.name),
        contact_motion.contact.law,
        1.1 * contact_motion.reach_mm,
    )
    time_s = contact_motion.time_s[contact_motion.frames]
    edges, colour = np.linspace(-across, across, HATCHES + 1), SOURCES[contact_motion.wall_source]
    for level, direction in _levels(law):
        hatches = [[[x, level], [x - 0.05 * across, level + direction * 0.05 * across]] for x in edges[1:]]
        walls = [[[-across, level], [across, level]], *hatches]
        style(stream, f"{path}/{SIDES[direction]}", rr.LineStrips2D(walls, colors=[colour], radii=pixels(1.5)))
    _send_levels(stream, f"{path}/{contact_motion.wall_source}", contact_motion, law, COLUMNS[0], colour)
    for column, (name, overlaid_law) in zip(COLUMNS[1:], contact_motion.overlaid.items(), strict=False):
        dash_ends = np.linspace(-across, across, 2 * DASHES).reshape(DASHES, 2)
        dashes = [[[a, level], [b, level]] for level, _ in _levels(overlaid_law) for a, b in dash_ends]
        drawn = rr.LineStrips2D(dashes, colors=[SOURCES[name]], radii=pixels(1.25), draw_order=40.0)
        style(stream, f"{path}/{name}", drawn)
        _send_levels(stream, f"{path}/{name}", contact_motion, overlaid_law, column, SOURCES[name])
    now_x = 0.15 * across
    trail_offsets = np.linspace(-TRAIL_S * contact_motion.rate_hz, 0, TRAIL_POINTS).round().astype(int)
    trail = np.empty((contact_motion.frames.size, TRAIL_POINTS, 2))
    trail[..., 0] = now_x + (across + now_x) * trail_offsets / -trail_offsets[0]
    trail[..., 1] = -1e3 * contact_motion.relative_m[np.maximum(contact_motion.frames[:, None] + trail_offsets, 0)]
    middle = rr.LineStrips2D([[[-across, 0], [across, 0]]], colors=[FAINT], radii=pixels(0.5))
    style(stream, f"{path}/middle", middle)
    style(stream, f"{path}/trail", rr.LineStrips2D.from_fields(colors=[contact_motion.colour], radii=[pixels(0.75)]))
    send(stream, f"{path}/trail", time_s, rr.LineStrips2D, strips=trail)
    style(stream, f"{path}/point", rr.Points2D.from_fields(radii=[pixels(7.0)]))
    send(stream, f"{path}/point", time_s, rr.Points2D, positions=trail[:, -1], colors=contact_motion.colours)
    above = [[0, -1.5 * contact_motion.reach_mm]]
    style(stream, f"{path}/reading", rr.Points2D.from_fields(positions=above, radii=[0]))
    send(
        stream, f"{path}/reading", time_s, rr.Points2D, labels=_readings(contact_motion), colors=contact_motion.colours
    )
    if contact_motion.until_s is not None:
        stream.set_time(TIMELINE, duration=contact_motion.until_s)
        for name_ in ("trail", "point"):
            stream.log(f"{path}/{name_}", rr.Clear(recursive=False))
        stream.log(f"{path}/reading", rr.Points2D.from_fields(labels=["not identified"], colors=[STEEL]))


def _levels(law: ContactLaw) -> list[tuple[float, int]]:
    """Levels of the walls, upper first, in the view, mm (y points downwards), with the outward direction."""
    return [(-1e3 * wall_m, -side) for wall_m, side in walls_m(law)]


def _send_levels(
    stream: rr.RecordingStream, path: str, contact_motion: ContactMotion, law: ContactLaw, column: float, colour: Colour
) -> None:
    name = path.rpartition("/")[2]
    for level, direction in _levels(law):
        place = [column * contact_motion.reach_mm, level - 0.28 * contact_motion.reach_mm * (direction < 0)]
        send_labels(stream, f"{path}/{SIDES[direction]}", [place], [f"{name} {-level:+.4g} mm"], colour)


def _readings(contact_motion: ContactMotion) -> list[str]:
    """Relative displacement, penetration and force of every frame, in words."""
    words = []
    for frame in contact_motion.frames:
        force = "" if contact_motion.force_n is None else f", {contact_motion.force_n[frame]:+.1f} N"
        deep = (
            f"{1e3 * abs(contact_motion.depth_m[frame]):.2f} mm deep{force}, closed"
            if contact_motion.closed[frame]
            else "free"
        )
        words.append(f"{1e3 * contact_motion.relative_m[frame]:+.2f} mm, {deep}")
    return words


def send_over_time(stream: rr.RecordingStream, contact_motion: ContactMotion) -> None:
    """Send the relative displacement over time with all walls, and marks where the contact closes and opens."""
    path, end_times_s = entity("relative_displacement", contact_motion.contact.name), contact_motion.time_s[[0, -1]]
    legend = [(contact_motion.contact.name, contact_motion.colour)]
    for label, law in (("walls", contact_motion.contact.law), *contact_motion.overlaid.items()):
        colour = SOURCES[contact_motion.wall_source if label == "walls" else label]
        limits = 1e3 * np.array([wall_m for wall_m, _ in walls_m(law)])
        names = [f"{contact_motion.wall_source if label == 'walls' else label} {limit:+.5g} mm" for limit in limits]
        send_lines(stream, f"{path}/{label}", end_times_s, np.tile(limits[:, None], 2), names, (colour,))
        legend += [(label, colour) for label in names]
    value = 1e3 * contact_motion.relative_m[None, contact_motion.plotted_samples]
    send_lines(
        stream,
        f"{path}/value",
        contact_motion.time_s[contact_motion.plotted_samples],
        value,
        [contact_motion.contact.name],
        (contact_motion.colour,),
    )
    for (label, marker, sign), samples in zip(CHANGES, _changes(contact_motion), strict=True):
        points = rr.SeriesPoints(colors=[CLOSED], names=[label], markers=[marker], marker_sizes=[4.0])
        style(stream, f"{path}/{label}", points)
        send(
            stream,
            f"{path}/{label}",
            contact_motion.time_s[samples],
            rr.Scalars,
            scalars=1e3 * contact_motion.relative_m[samples],
        )
        legend.append((f"{sign} {label}", CLOSED))
    send_legend(stream, path, legend)


def send_events(stream: rr.RecordingStream, contact_motion: ContactMotion) -> None:
    """Send a log entry at every sample at which the contact closes or opens.

    Beyond MAX_CLOSINGS the number of further closings is stated.
    """
    changes = _changes(contact_motion)
    closes, opens = (samples[:MAX_CLOSINGS] for samples in changes)
    words = [
        f"{contact_motion.contact.name} closes at its {'upper' if contact_motion.depth_m[s] > 0 else 'lower'} stop"
        for s in closes
    ]
    starts = np.concatenate([[0], closes])[np.searchsorted(closes, opens)]  # an opening ends the closing before it
    for start, sample in zip(starts, opens, strict=True):
        lasted_ms = 1e3 * (contact_motion.time_s[sample] - contact_motion.time_s[start])
        deepest_mm = 1e3 * np.abs(contact_motion.depth_m[start:sample]).max()
        words.append(f"{contact_motion.contact.name} opens after {lasted_ms:.3g} ms, at most {deepest_mm:.3g} mm deep")
    if unlisted := changes[0].size - closes.size:
        words[closes.size - 1] += f"; it closes {unlisted} times more, which are not listed"
    samples = np.concatenate([closes, opens])
    order = np.argsort(samples, kind="stable")
    levels = np.array([rr.TextLogLevel.WARN] * closes.size + [rr.TextLogLevel.INFO] * opens.size)
    colours = np.array([CLOSED] * closes.size + [contact_motion.colour] * opens.size, dtype=np.uint8).reshape(-1, 3)
    send(
        stream,
        entity("events", contact_motion.contact.name),
        contact_motion.time_s[samples[order]],
        rr.TextLog,
        text=[f"{contact_motion.time_s[samples[i]]:.4f} s: {words[i]}" for i in order],
        level=[str(levels[i]) for i in order],
        color=colours[order],
    )


def _changes(contact_motion: ContactMotion) -> tuple[Int[np.ndarray, " closings"], Int[np.ndarray, " openings"]]:
    """First samples at which the contact is closed, and at which it is free again."""
    steps = np.diff(contact_motion.closed.astype(int))
    return np.flatnonzero(steps == 1) + 1, np.flatnonzero(steps == -1) + 1


BINS = 120
REST_SHARE = 0.01
"""Share of its range by which a contact has to leave its first position to count as moving."""


def send_phase(stream: rr.RecordingStream, contact_motion: ContactMotion) -> None:
    """Send the contact force (upwards) over relative displacement, frame by frame, over the laws.

    A frame's line goes from its sample to the next frame's, so that the view, which shows all until the moment, grows.
    """
    if contact_motion.force_n is None:
        return
    path, reach = entity("phase", contact_motion.contact.name), contact_motion.reach_mm
    largest_n = 1.1 * float(np.abs(contact_motion.force_n).max()) or 1.0
    axes = Axes((-reach, reach), (-largest_n, largest_n), "relative displacement, mm", "force, N")
    laws = {contact_motion.wall_source: contact_motion.contact.law, **contact_motion.overlaid}
    axes.send(stream, path, {"force": FORCE} | {f"{name} law": SOURCES[name] for name in laws})
    eta = np.linspace(contact_motion.relative_m.min(), contact_motion.relative_m.max(), 401)
    for depth, (name, law) in enumerate(laws.items()):
        line = axes.points(1e3 * eta, law.force_n(eta, np.zeros(eta.size)))
        law_style = {"colors": [SOURCES[name]], "radii": pixels(1.0), "draw_order": 10.0 + depth}
        style(stream, f"{path}/{name}", rr.LineStrips2D([line], **law_style))
    line_style = rr.LineStrips2D.from_fields(colors=[FORCE], radii=[pixels(1.25)], draw_order=50.0)
    style(stream, f"{path}/seen", line_style)
    points = axes.points(1e3 * contact_motion.relative_m, contact_motion.force_n)[contact_motion.plotted_samples]
    frame_places = np.searchsorted(contact_motion.plotted_samples, contact_motion.frames)
    strips = [points[a : b + 1] for a, b in pairwise(frame_places)]
    send(stream, f"{path}/seen", contact_motion.time_s[contact_motion.frames[1:]], rr.LineStrips2D, strips=strips)


def send_histogram(stream: rr.RecordingStream, contact_motion: ContactMotion) -> None:
    """Send the histogram of each relative displacement once it moves: % of time over mm, a bar as wide as its bin."""
    moved_m = np.abs(contact_motion.relative_m - contact_motion.relative_m[0])
    moving_m = contact_motion.relative_m[int(np.argmax(moved_m > REST_SHARE * np.ptp(contact_motion.relative_m))) :]
    counts, edges = np.histogram(1e3 * moving_m, BINS, range=(-contact_motion.reach_mm, contact_motion.reach_mm))
    share = 100 * counts / moving_m.size
    bars = rr.BarChart(share, abscissa=edges[:-1], widths=np.diff(edges), color=contact_motion.colour)
    style(stream, entity("histogram", contact_motion.contact.name), bars)
