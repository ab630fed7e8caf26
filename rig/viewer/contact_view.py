"""A contact in the viewer: close up, over time, and its events."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import rerun as rr
from jaxtyping import Bool, Float, Int, UInt8
from scipy.ndimage import maximum_filter1d

from rig.model.contact_laws import ContactLaw, stop_positions_m_and_sides
from rig.model.description import Contact
from rig.viewer.blueprint import TRAIL_S
from rig.viewer.drawing import (
    LAYER_WIDTHS_PX,
    TIMELINE,
    entity,
    pixels,
    send,
    send_labels,
    send_legend,
    send_lines,
    send_static,
)
from rig.viewer.orbit import Orbit, send_rings
from rig.viewer.palette import CLOSED, FAINT, FOUND, MACHINE, SOURCES, STEEL, Colour

TRAIL_POINT_COUNT = 60
WALL_HATCH_COUNT = 16
WALL_DASH_COUNT = 24
MAX_LISTED_CLOSINGS = 20_000
"""Largest number of closings in the log."""
MAX_PLOTTED_SAMPLES = 1_000_000
MAX_REACH_RATIO = 5.0
"""Clearance over the other one and the largest motion beyond which a stop is out of reach and of view."""
NEAR_CONTACT_S = 0.005
"""Time before and after a contact within which every sample is drawn, s."""
CHANGE_MARKS = (("closes", "circle", "●"), ("opens", "diamond", "◆"))
"""Marks of the first closed and of the first free sample; both bound the time in contact and have its colour."""
SIDE_NAMES = {-1: "upper", 1: "lower"}
LABEL_X_OVER_REACH = (1.85, -1.85, 0.55)
"""Horizontal positions of the labels of the walls and of overlaid laws, over the reach."""


LawSource = Literal["true", "identified", "believed"]


@dataclass(frozen=True)
class ContactMotion:
    """Motion of a contact over the record: eta_m is its relative displacement. Its law is drawn as walls and defines
    closure; wall_source is the law's. Of an annular contact, which has an orbit, eta_m is the distance from its centre,
    force_n the size of the force, and the laws are those over the radius.

    overlaid_laws are drawn over it, by source; force_n is the contact force where it is known. The samples may be a
    part of the record: identified motion, for which is_identified is true, begins later and ends at until_s.
    frame_samples are drawn; the time series hold every `stride`-th sample, and all near a contact.
    """

    contact: Contact
    wall_source: LawSource
    overlaid_laws: Mapping[LawSource, ContactLaw]
    time_s: Float[np.ndarray, " samples"]
    until_s: float | None
    eta_m: Float[np.ndarray, " samples"]
    force_n: Float[np.ndarray, " samples"] | None
    frame_samples: Int[np.ndarray, " frames"]
    stride: int
    is_identified: bool = False
    orbit: Orbit | None = None

    def closing_stop_text(self, sample: int) -> str:
        """Stop at which the contact closes at a sample, in words."""
        if self.orbit is not None:
            return f"at {self.orbit.angle_deg(sample):.0f}\u00b0 from y towards z"
        return f"at its {'upper' if self.depth_m[sample] > 0 else 'lower'} stop"

    @property
    def colour(self) -> Colour:
        return FOUND if self.is_identified else MACHINE

    @cached_property
    def reach_mm(self) -> float:
        """Half width of the views of the contact, mm: the motion and the stops, unless a stop is far out of reach."""
        law, max_eta_m = self.contact.law, float(np.abs(self.eta_m).max())
        distances_m = sorted(abs(wall_m) for wall_m, _ in stop_positions_m_and_sides(law))
        reachable_m = (wall_m for wall_m in distances_m if wall_m <= MAX_REACH_RATIO * max(distances_m[0], max_eta_m))
        return 1.2e3 * max([max_eta_m, *reachable_m]) or 1.0

    @property
    def axis_range_mm(self) -> tuple[float, float]:
        """Range of the axes of the relative displacement, mm; a distance from the centre begins at zero."""
        return (-self.reach_mm if self.orbit is None else 0.0, self.reach_mm)

    def text_in_mm(self, eta_m: float, precision: str) -> str:
        """Relative displacement in mm as text; a distance has no sign."""
        return f"{1e3 * eta_m:{'' if self.orbit else '+'}{precision}}"

    @cached_property
    def depth_m(self) -> Float[np.ndarray, " samples"]:
        return np.asarray(self.contact.law.penetration_m(self.eta_m, self.time_s))

    @cached_property
    def is_closed(self) -> Bool[np.ndarray, " samples"]:
        return self.depth_m != 0

    @property
    def rate_hz(self) -> float:
        return float((self.time_s.size - 1) / (self.time_s[-1] - self.time_s[0])) if self.time_s.size > 1 else 1.0

    @cached_property
    def plotted_samples(self) -> Int[np.ndarray, " plotted_samples"]:
        """Indices: all near a contact, every `stride`-th and the frames elsewhere; at most MAX_PLOTTED_SAMPLES."""
        near_samples = max(1, round(NEAR_CONTACT_S * self.rate_hz))
        is_plotted = maximum_filter1d(self.is_closed.view(np.uint8), 2 * near_samples + 1, mode="constant").view(bool)
        is_plotted[:: self.stride] = True
        is_plotted[self.frame_samples] = True
        sample_indices = np.flatnonzero(is_plotted)
        return sample_indices[:: max(1, -(-sample_indices.size // MAX_PLOTTED_SAMPLES))]

    @property
    def frame_colours(self) -> UInt8[np.ndarray, "frames 3"]:
        return np.where(self.is_closed[self.frame_samples, None], CLOSED, self.colour).astype(np.uint8)


def send_close_up(stream: rr.RecordingStream, motion: ContactMotion) -> None:
    """Send the close-up: relative displacement (mm, upwards) between the two walls, with its recent trail to the left.

    The label of a wall is beyond it, so that it cannot be mistaken for that of the other; each law has its own column
    of labels: right, left and before the trail.
    """
    root_path = entity("close_up", motion.contact.name)
    law, frame_samples = motion.contact.law, motion.frame_samples
    half_width_mm = 1.1 * motion.reach_mm
    time_s, cursor_x_mm = motion.time_s[frame_samples], 0.15 * half_width_mm
    sample_offsets = np.linspace(-TRAIL_S * motion.rate_hz, 0, TRAIL_POINT_COUNT).round().astype(int)
    trail_samples = np.maximum(frame_samples[:, None] + sample_offsets, 0)
    if motion.orbit is None:
        _send_walls(stream, root_path, motion, half_width_mm)
        trail_points_mm = np.empty((frame_samples.size, TRAIL_POINT_COUNT, 2))
        trail_points_mm[..., 0] = cursor_x_mm + (half_width_mm + cursor_x_mm) * sample_offsets / -sample_offsets[0]
        trail_points_mm[..., 1] = -1e3 * motion.eta_m[trail_samples]
    else:
        send_rings(stream, root_path, [(motion.wall_source, law), *motion.overlaid_laws.items()], motion.reach_mm)
        trail_points_mm = motion.orbit.points_mm[trail_samples]
    colours, reading_texts = motion.frame_colours, _frame_value_texts(motion)
    send_static(stream, f"{root_path}/trail", rr.LineStrips2D.from_fields(colors=[motion.colour], radii=[pixels(0.75)]))
    send(stream, f"{root_path}/trail", time_s, rr.LineStrips2D, strips=trail_points_mm)
    send_static(stream, f"{root_path}/point", rr.Points2D.from_fields(radii=[pixels(7.0)]))
    send(stream, f"{root_path}/point", time_s, rr.Points2D, positions=trail_points_mm[:, -1], colors=colours)
    reading_position = [[0, -1.5 * motion.reach_mm]]
    send_static(stream, f"{root_path}/reading", rr.Points2D.from_fields(positions=reading_position, radii=[0]))
    send(stream, f"{root_path}/reading", time_s, rr.Points2D, labels=reading_texts, colors=colours)
    if motion.until_s is not None:
        stream.set_time(TIMELINE, duration=motion.until_s)
        for path_end in ("trail", "point"):
            stream.log(f"{root_path}/{path_end}", rr.Clear(recursive=False))
        stream.log(f"{root_path}/reading", rr.Points2D.from_fields(labels=["not identified"], colors=[STEEL]))


def _send_walls(stream: rr.RecordingStream, entity_path: str, motion: ContactMotion, half_mm: float) -> None:
    """Send the walls with their hatching and labels, those of overlaid laws dashed, and the middle."""
    law, colour = motion.contact.law, SOURCES[motion.wall_source]
    hatch_mm = 0.05 * half_mm
    for y_mm, outward_sign in _wall_levels(law):
        hatch_x_mm = np.linspace(-half_mm, half_mm, WALL_HATCH_COUNT + 1)[1:]
        hatching = [[[x_mm, y_mm], [x_mm - hatch_mm, y_mm + outward_sign * hatch_mm]] for x_mm in hatch_x_mm]
        strips = rr.LineStrips2D([[[-half_mm, y_mm], [half_mm, y_mm]], *hatching], colors=[colour], radii=pixels(1.5))
        send_static(stream, f"{entity_path}/{SIDE_NAMES[outward_sign]}", strips)
    _send_wall_labels(stream, f"{entity_path}/{motion.wall_source}", motion, law, LABEL_X_OVER_REACH[0], colour)
    dash_ends_mm = np.linspace(-half_mm, half_mm, 2 * WALL_DASH_COUNT).reshape(WALL_DASH_COUNT, 2)
    for x_to_reach, (source, overlaid_law) in zip(LABEL_X_OVER_REACH[1:], motion.overlaid_laws.items(), strict=False):
        colour = SOURCES[source]
        dashes = [[[start, y_mm], [end, y_mm]] for y_mm, _ in _wall_levels(overlaid_law) for start, end in dash_ends_mm]
        strips = rr.LineStrips2D(dashes, colors=[colour], radii=pixels(1.25), draw_order=40.0)
        send_static(stream, f"{entity_path}/{source}", strips)
        _send_wall_labels(stream, f"{entity_path}/{source}", motion, overlaid_law, x_to_reach, colour)
    zero_line = rr.LineStrips2D([[[-half_mm, 0], [half_mm, 0]]], colors=[FAINT], radii=pixels(0.5))
    send_static(stream, f"{entity_path}/middle", zero_line)


def _wall_levels(law: ContactLaw) -> list[tuple[float, int]]:
    """Levels of the walls, upper first, in the view, mm (y points downwards), with the outward direction."""
    return [(-1e3 * wall_m, -side) for wall_m, side in stop_positions_m_and_sides(law)]


def _send_wall_labels(
    stream: rr.RecordingStream, path: str, motion: ContactMotion, law: ContactLaw, x_to_reach: float, colour: Colour
) -> None:
    law_source = path.rpartition("/")[2]
    for y_mm, outward_sign in _wall_levels(law):
        position = [x_to_reach * motion.reach_mm, y_mm - 0.28 * motion.reach_mm * (outward_sign < 0)]
        send_labels(stream, f"{path}/{SIDE_NAMES[outward_sign]}", [position], [f"{law_source} {-y_mm:+.4g} mm"], colour)


def _frame_value_texts(motion: ContactMotion) -> list[str]:
    """Relative displacement, penetration and force of every frame, in words."""
    reading_texts, sign_format = [], "+" if motion.orbit is None else ""
    for sample in motion.frame_samples:
        state_words = "free"
        if motion.is_closed[sample]:
            force_words = "" if motion.force_n is None else f", {motion.force_n[sample]:{sign_format}.1f} N"
            state_words = f"{1e3 * abs(motion.depth_m[sample]):.2f} mm deep{force_words}, closed"
        reading_texts.append(f"{motion.text_in_mm(motion.eta_m[sample], '.2f')} mm, {state_words}")
    return reading_texts


def send_over_time(stream: rr.RecordingStream, motion: ContactMotion) -> None:
    """Send the relative displacement over time with all walls, and marks where the contact closes and opens."""
    entity_path, end_times_s = entity("relative_displacement", motion.contact.name), motion.time_s[[0, -1]]
    legend_entries = [(motion.contact.name, motion.colour)]
    law_by_source = {motion.wall_source: motion.contact.law, **motion.overlaid_laws}
    for layer_index, (source, law) in enumerate(law_by_source.items()):  # the viewer draws in the order of the paths
        walls_at_m = [wall_m for wall_m, _ in stop_positions_m_and_sides(law)]
        labels, colour = [motion.text_in_mm(wall_m, ".4g") for wall_m in walls_at_m], SOURCES[source]
        levels_mm, names = np.tile(1e3 * np.array(walls_at_m)[:, None], 2), [f"{source} {text} mm" for text in labels]
        width_px = LAYER_WIDTHS_PX[min(layer_index, 1)]
        send_lines(stream, f"{entity_path}/{layer_index}_{source}", end_times_s, levels_mm, names, (colour,), width_px)
        unsigned_texts = {text.lstrip("+-") for text in labels}
        if len(unsigned_texts) < len(labels):
            labels = [f"\u00b1{unsigned_texts.pop()}"]
        legend_entries += [(f"{source} {text}", colour) for text in labels]
    time_s, eta_mm = motion.time_s[motion.plotted_samples], 1e3 * motion.eta_m[None, motion.plotted_samples]
    send_lines(stream, f"{entity_path}/value", time_s, eta_mm, [motion.contact.name], (motion.colour,))
    for (change, marker_shape, legend_mark), change_samples in zip(
        CHANGE_MARKS, _closing_and_opening_samples(motion), strict=True
    ):
        marker_style = rr.SeriesPoints(colors=[CLOSED], names=[change], markers=[marker_shape], marker_sizes=[4.0])
        send_static(stream, f"{entity_path}/{change}", marker_style)
        eta_mm = 1e3 * motion.eta_m[change_samples]
        send(stream, f"{entity_path}/{change}", motion.time_s[change_samples], rr.Scalars, scalars=eta_mm)
        legend_entries.append((f"{legend_mark} {change}", CLOSED))
    send_legend(stream, entity_path, legend_entries)


def send_events(stream: rr.RecordingStream, motion: ContactMotion) -> None:
    """Send a log entry at every sample at which the contact closes or opens.

    Beyond MAX_LISTED_CLOSINGS the number of further closings is stated.
    """
    change_samples = _closing_and_opening_samples(motion)
    closing_samples, opening_samples = (event_samples[:MAX_LISTED_CLOSINGS] for event_samples in change_samples)
    event_texts = [
        f"{motion.contact.name} closes {motion.closing_stop_text(sample)}" for sample in closing_samples.tolist()
    ]
    closing_indices = np.searchsorted(closing_samples, opening_samples)  # an opening ends the closing before it
    closing_starts = np.concatenate([[0], closing_samples])[closing_indices]
    for closing_start, opening_sample in zip(closing_starts, opening_samples, strict=True):
        duration_ms = 1e3 * (motion.time_s[opening_sample] - motion.time_s[closing_start])
        deepest_mm = 1e3 * np.abs(motion.depth_m[closing_start:opening_sample]).max()
        event_texts.append(f"{motion.contact.name} opens after {duration_ms:.3g} ms, at most {deepest_mm:.3g} mm deep")
    if unlisted_count := change_samples[0].size - closing_samples.size:
        event_texts[closing_samples.size - 1] += f"; it closes {unlisted_count} times more, which are not listed"
    event_samples = np.concatenate([closing_samples, opening_samples])
    time_order = np.argsort(event_samples, kind="stable")
    log_levels = np.array([rr.TextLogLevel.WARN] * closing_samples.size + [rr.TextLogLevel.INFO] * opening_samples.size)
    event_colours = np.array(
        [CLOSED] * closing_samples.size + [motion.colour] * opening_samples.size, dtype=np.uint8
    ).reshape(-1, 3)
    send(
        stream,
        entity("events", motion.contact.name),
        motion.time_s[event_samples[time_order]],
        rr.TextLog,
        text=[f"{motion.time_s[event_samples[event]]:.4f} s: {event_texts[event]}" for event in time_order],
        level=[str(log_levels[event]) for event in time_order],
        color=event_colours[time_order],
    )


def _closing_and_opening_samples(
    motion: ContactMotion,
) -> tuple[Int[np.ndarray, " closings"], Int[np.ndarray, " openings"]]:
    """First samples at which the contact is closed, and at which it is free again."""
    closure_changes = np.diff(motion.is_closed.astype(int))
    return np.flatnonzero(closure_changes == 1) + 1, np.flatnonzero(closure_changes == -1) + 1
