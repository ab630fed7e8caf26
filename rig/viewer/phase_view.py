"""Force of a contact over its relative displacement in the viewer, and the histogram of that displacement."""

from itertools import pairwise

import numpy as np
import rerun as rr

from rig.viewer.axes import Axes
from rig.viewer.blueprint import DISPLACEMENT, DISTANCE
from rig.viewer.contact_view import ContactMotion
from rig.viewer.drawing import entity, pixels, send, send_static
from rig.viewer.palette import FORCE, SOURCES

HISTOGRAM_BIN_COUNT = 120
MIN_MOVING_SHARE = 0.01
"""Share of its range by which a contact has to leave its first position to count as moving."""


def send_phase(stream: rr.RecordingStream, motion: ContactMotion) -> None:
    """Send the contact force (upwards) over relative displacement, frame by frame, over the laws.

    A frame's line goes from its sample to the next frame's, so that the view, which shows all until the moment, grows.
    """
    if motion.force_n is None:
        return
    entity_path = entity("phase", motion.contact.name)
    largest_force_n = 1.1 * float(np.abs(motion.force_n).max()) or 1.0
    lowest_force_n, eta_name = (-largest_force_n, DISPLACEMENT) if motion.orbit is None else (0.0, DISTANCE)
    axes = Axes(motion.axis_range_mm, (lowest_force_n, largest_force_n), f"{eta_name}, mm", "force, N")
    law_by_source = {motion.wall_source: motion.contact.law, **motion.overlaid_laws}
    axes.send(stream, entity_path, {"force": FORCE} | {f"{source} law": SOURCES[source] for source in law_by_source})
    eta_m = np.linspace(motion.eta_m.min(), motion.eta_m.max(), 401)
    for layer, (source, law) in enumerate(law_by_source.items()):
        law_line = axes.points(1e3 * eta_m, law.force_n(eta_m, np.zeros(eta_m.size)))
        half_width = pixels(1.0 if layer else 2.25)
        line_strips = rr.LineStrips2D([law_line], colors=[SOURCES[source]], radii=half_width, draw_order=10.0 + layer)
        send_static(stream, f"{entity_path}/{source}", line_strips)
    force_style = rr.LineStrips2D.from_fields(colors=[FORCE], radii=[pixels(1.25)], draw_order=50.0)
    send_static(stream, f"{entity_path}/seen", force_style)
    plotted_points = axes.points(1e3 * motion.eta_m, motion.force_n)[motion.plotted_samples]
    frame_positions = np.searchsorted(motion.plotted_samples, motion.frame_samples)
    line_strips = [plotted_points[start : stop + 1] for start, stop in pairwise(frame_positions)]
    send(stream, f"{entity_path}/seen", motion.time_s[motion.frame_samples[1:]], rr.LineStrips2D, strips=line_strips)


def send_histogram(stream: rr.RecordingStream, motion: ContactMotion) -> None:
    """Send the histogram of each relative displacement once it moves: % of time over mm, a bar as wide as its bin."""
    distance_from_start_m = np.abs(motion.eta_m - motion.eta_m[0])
    eta_in_motion_m = motion.eta_m[int(np.argmax(distance_from_start_m > MIN_MOVING_SHARE * np.ptp(motion.eta_m))) :]
    bin_counts, bin_edges_mm = np.histogram(1e3 * eta_in_motion_m, HISTOGRAM_BIN_COUNT, range=motion.axis_range_mm)
    time_percent = 100 * bin_counts / eta_in_motion_m.size
    bar_chart = rr.BarChart(time_percent, abscissa=bin_edges_mm[:-1], widths=np.diff(bin_edges_mm), color=motion.colour)
    send_static(stream, entity("histogram", motion.contact.name), bar_chart)
