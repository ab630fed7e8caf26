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
    entity_path = entity("phase", motion.contact.name)
    largest_n = 1.1 * float(np.abs(motion.force_n).max()) or 1.0
    lowest_n, eta_name = (-largest_n, DISPLACEMENT) if motion.orbit is None else (0.0, DISTANCE)
    axes = Axes(motion.range_mm, (lowest_n, largest_n), f"{eta_name}, mm", "force, N")
    law_by_source = {motion.wall_source: motion.contact.law, **motion.overlaid_laws}
    axes.send(
        stream,
        entity_path,
        {"force": FORCE} | {f"{law_source} law": SOURCES[law_source] for law_source in law_by_source},
    )
    eta_m = np.linspace(motion.eta_m.min(), motion.eta_m.max(), 401)
    for layer, (law_source, law) in enumerate(law_by_source.items()):
        law_line = axes.points(1e3 * eta_m, law.force_n(eta_m, np.zeros(eta_m.size)))
        law_style = {
            "colors": [SOURCES[law_source]],
            "radii": pixels(1.0 if layer else 2.25),
            "draw_order": 10.0 + layer,
        }
        send_static(stream, f"{entity_path}/{law_source}", rr.LineStrips2D([law_line], **law_style))
    line_style = rr.LineStrips2D.from_fields(colors=[FORCE], radii=[pixels(1.25)], draw_order=50.0)
    send_static(stream, f"{entity_path}/seen", line_style)
    force_points = axes.points(1e3 * motion.eta_m, motion.force_n)[motion.plotted_samples]
    frame_positions = np.searchsorted(motion.plotted_samples, motion.frame_samples)
    force_strips = [force_points[start_index : stop_index + 1] for start_index, stop_index in pairwise(frame_positions)]
    send(stream, f"{entity_path}/seen", motion.time_s[motion.frame_samples[1:]], rr.LineStrips2D, strips=force_strips)


def send_histogram(stream: rr.RecordingStream, motion: ContactMotion) -> None:
    """Send the histogram of each relative displacement once it moves: % of time over mm, a bar as wide as its bin."""
    distance_moved_m = np.abs(motion.eta_m - motion.eta_m[0])
    eta_in_motion_m = motion.eta_m[int(np.argmax(distance_moved_m > MIN_MOVING_SHARE * np.ptp(motion.eta_m))) :]
    bin_counts, bin_edges_mm = np.histogram(1e3 * eta_in_motion_m, BIN_COUNT, range=motion.range_mm)
    time_percent = 100 * bin_counts / eta_in_motion_m.size
    bar_chart = rr.BarChart(time_percent, abscissa=bin_edges_mm[:-1], widths=np.diff(bin_edges_mm), color=motion.colour)
    send_static(stream, entity("histogram", motion.contact.name), bar_chart)
