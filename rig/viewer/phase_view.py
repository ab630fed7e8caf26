"""Force of a contact over its relative displacement in the viewer, and the histogram of that displacement."""

from itertools import pairwise

import numpy as np
import rerun as rr

from rig.viewer.axes import Axes
from rig.viewer.blueprint import DISPLACEMENT, DISTANCE
from rig.viewer.contact_view import ContactMotion
from rig.viewer.drawing import entity, pixels, send, send_static
from rig.viewer.palette import FORCE, SOURCES

BIN_COUNT = 120
MIN_MOVING_SHARE = 0.01
"""Share of its range by which a contact has to leave its first position to count as moving."""


def send_phase(stream: rr.RecordingStream, motion: ContactMotion) -> None:
    """Send the contact force (upwards) over relative displacement, frame by frame, over the laws.

    A frame's line goes from its sample to the next frame's, so that the view, which shows all until the moment, grows.
    """
    if motion.force_n is None:
        return
    path = entity("phase", motion.contact.name)
    largest_n = 1.1 * float(np.abs(motion.force_n).max()) or 1.0
    lowest_n, eta_name = (-largest_n, DISPLACEMENT) if motion.orbit is None else (0.0, DISTANCE)
    axes = Axes(motion.range_mm, (lowest_n, largest_n), f"{eta_name}, mm", "force, N")
    laws = {motion.wall_source: motion.contact.law, **motion.overlaid_laws}
    axes.send(stream, path, {"force": FORCE} | {f"{source} law": SOURCES[source] for source in laws})
    eta_m = np.linspace(motion.eta_m.min(), motion.eta_m.max(), 401)
    for layer, (source, law) in enumerate(laws.items()):
        line = axes.points(1e3 * eta_m, law.force_n(eta_m, np.zeros(eta_m.size)))
        radius = pixels(1.0 if layer else 2.25)
        strips = rr.LineStrips2D([line], colors=[SOURCES[source]], radii=radius, draw_order=10.0 + layer)
        send_static(stream, f"{path}/{source}", strips)
    style = rr.LineStrips2D.from_fields(colors=[FORCE], radii=[pixels(1.25)], draw_order=50.0)
    send_static(stream, f"{path}/seen", style)
    points = axes.points(1e3 * motion.eta_m, motion.force_n)[motion.plotted_samples]
    frames = np.searchsorted(motion.plotted_samples, motion.frame_samples)
    strips = [points[start : stop + 1] for start, stop in pairwise(frames)]
    send(stream, f"{path}/seen", motion.time_s[motion.frame_samples[1:]], rr.LineStrips2D, strips=strips)


def send_histogram(stream: rr.RecordingStream, motion: ContactMotion) -> None:
    """Send the histogram of each relative displacement once it moves: % of time over mm, a bar as wide as its bin."""
    distance_moved_m = np.abs(motion.eta_m - motion.eta_m[0])
    eta_in_motion_m = motion.eta_m[int(np.argmax(distance_moved_m > MIN_MOVING_SHARE * np.ptp(motion.eta_m))) :]
    bin_counts, bin_edges_mm = np.histogram(1e3 * eta_in_motion_m, BIN_COUNT, range=motion.range_mm)
    time_percent = 100 * bin_counts / eta_in_motion_m.size
    bar_chart = rr.BarChart(time_percent, abscissa=bin_edges_mm[:-1], widths=np.diff(bin_edges_mm), color=motion.colour)
    send_static(stream, entity("histogram", motion.contact.name), bar_chart)
