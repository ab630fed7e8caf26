"""A contact in the viewer as force over relative displacement, and the histogram of its relative displacement."""

from itertools import pairwise

import numpy as np
import rerun as rr

from rig.viewer.axes import Axes
from rig.viewer.contact_view import OTHERS, Play
from rig.viewer.drawing import LINES, STEEL, entity, pixels, send, style

BINS = 120
AT_REST = 0.01
"""A contact has not moved yet while it is off its first place by at most this share of its range."""


def send_phase(stream: rr.RecordingStream, play: Play) -> None:
    """Contact force (upwards) over relative displacement, frame by frame, over the laws.

    A frame's line goes from its sample to the next frame's, so that the view, which shows all until the moment, grows.
    """
    if play.force_n is None:
        return
    path, reach = entity("phase", play.contact.name), play.reach_mm
    largest_n = 1.1 * float(np.abs(play.force_n).max()) or 1.0
    axes = Axes((-reach, reach), (-largest_n, largest_n), "relative displacement, mm", "force, N")
    laws = {play.walls: play.contact.law, **play.others}
    colours = {name: STEEL if name == play.walls else OTHERS[name] for name in laws}
    axes.send(stream, path, {"force": LINES[1]} | {f"{name} law": colour for name, colour in colours.items()})
    eta = np.linspace(play.relative_m.min(), play.relative_m.max(), 401)
    for depth, (name, law) in enumerate(laws.items()):
        line = axes.points(1e3 * eta, law.force_n(eta, np.zeros(eta.size)))
        drawn = {"colors": [colours[name]], "radii": pixels(1.0), "draw_order": 10.0 + depth}
        style(stream, f"{path}/{name}", rr.LineStrips2D([line], **drawn))
    look = rr.LineStrips2D.from_fields(colors=[LINES[1]], radii=[pixels(1.25)], draw_order=50.0)
    style(stream, f"{path}/seen", look)
    points = axes.points(1e3 * play.relative_m, play.force_n)[play.kept]
    at = np.searchsorted(play.kept, play.frames)
    strips = [points[a : b + 1] for a, b in pairwise(at)]
    send(stream, f"{path}/seen", play.time_s[play.frames[1:]], rr.LineStrips2D, strips=strips)


def send_histogram(stream: rr.RecordingStream, play: Play) -> None:
    """Send the histogram of each relative displacement once it moves: % of time over mm, a bar as wide as its bin."""
    moved_m = np.abs(play.relative_m - play.relative_m[0])
    moving_m = play.relative_m[int(np.argmax(moved_m > AT_REST * np.ptp(play.relative_m))) :]
    counts, edges = np.histogram(1e3 * moving_m, BINS, range=(-play.reach_mm, play.reach_mm))
    share = 100 * counts / moving_m.size
    bars = rr.BarChart(share, abscissa=edges[:-1], widths=np.diff(edges), color=LINES[0])
    style(stream, entity("histogram", play.contact.name), bars)
