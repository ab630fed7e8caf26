"""A diagnosis in the viewer: marks on the moving bodies, the gap over time, and the verdict in words."""

from collections.abc import Sequence
from textwrap import fill

import numpy as np
import rerun as rr
from jaxtyping import Bool, Float

from rig.viewer.contact_view import ContactMotion
from rig.viewer.drawing import DIAGNOSIS, GAP_OVER_TIME, send, send_lines, send_static
from rig.viewer.gap import Mark, ShownGap
from rig.viewer.palette import GAP
from rig.viewer.stage import Stage

MIN_LABELLED_SHARE = 0.1
"""Least share of the mismatch at a station that is labelled."""
MAX_LINE_LETTERS = 40
"""Letters in a line of the words of a mark, which have to fit beside the end of a body."""


def send_gap(stream: rr.RecordingStream, gap: ShownGap, scene: Stage, contact_motions: Sequence[ContactMotion]) -> None:
    """Send a diagnosis: text, dots sized by the stations' shares of the mismatch, marks and mismatch over time.

    Marks are labelled dots whose size follows their strength over time.
    """
    send_static(stream, DIAGNOSIS, rr.TextDocument(gap.text, media_type="text/markdown"))
    for index, (station, mismatch_share) in enumerate(gap.share_by_station.items()):
        share_labels = [f"{100 * mismatch_share:.0f} % of the gap"] if mismatch_share >= MIN_LABELLED_SHARE else None
        radius_px = 2.0 + 6.0 * float(np.sqrt(mismatch_share / max(gap.share_by_station.values(), default=1.0)))
        entity_path = f"model/gap/share_{index}"
        dot_style = rr.Points3D.from_fields(colors=[GAP], radii=[rr.Radius.ui_points(radius_px)], labels=share_labels)
        send_static(stream, entity_path, dot_style)
        send(stream, entity_path, scene.time_s, rr.Points3D, positions=scene.point(station))
    for index, mark in enumerate(gap.marks):
        entity_path, positions = f"model/gap/mark_{index}", scene.point(mark.station)
        strengths = _strength_by_frame(mark, gap, scene.time_s, _is_closed_by_frame(scene, contact_motions))
        negative_radii_px = -14.0 * strengths  # negative: pixels
        send_static(stream, entity_path, rr.Points3D.from_fields(colors=[GAP]))
        send(stream, entity_path, scene.time_s, rr.Points3D, positions=positions, radii=negative_radii_px)
        send_static(stream, f"{entity_path}/words", rr.Points3D.from_fields(colors=[GAP], radii=[0.0]))
        text_points = positions + np.array([0, 0, (0.12 + 0.07 * index) * scene.extent_m])
        mark_words = np.where(strengths > 0, fill(mark.words, MAX_LINE_LETTERS), "")
        send(stream, f"{entity_path}/words", scene.time_s, rr.Points3D, positions=text_points, labels=mark_words)
    interval_edges_s = np.array([edge_s for start_s, end_s, _ in gap.share_spans for edge_s in (start_s, end_s - 1e-6)])
    share_percent = np.array([100 * mismatch_share for _, _, mismatch_share in gap.share_spans for _ in range(2)])
    send_lines(stream, GAP_OVER_TIME, interval_edges_s, share_percent[None], ["share of the gap"], (GAP,))


def _is_closed_by_frame(scene: Stage, contact_motions: Sequence[ContactMotion]) -> Bool[np.ndarray, " frames"]:
    """Frames at which a contact is closed."""
    is_closed = np.zeros(scene.time_s.size, dtype=bool)
    for motion in contact_motions:
        frame_indices = np.searchsorted(scene.time_s, motion.time_s[motion.frame_samples] - 1e-9)
        is_closed[frame_indices] |= motion.is_closed[motion.frame_samples]
    return is_closed


def _strength_by_frame(
    mark: Mark, gap: ShownGap, time_s: Float[np.ndarray, " frames"], is_closed: Bool[np.ndarray, " frames"]
) -> Float[np.ndarray, " frames"]:
    """Strength of a mark at every frame: 1 if constant, else 0.3 to 1, zero outside the diagnosed time.

    Of what acts in contact it is zero where every contact is open.
    """
    if len(mark.strengths) == 1:
        return is_closed.astype(float) if mark.in_contact else np.ones(time_s.size)
    start_s, end_s = (gap.share_spans[0][0], gap.share_spans[-1][1]) if gap.share_spans else (0.0, np.inf)
    interval_edges_s = np.linspace(start_s, end_s if np.isfinite(end_s) else time_s[-1], len(mark.strengths) + 1)
    interval_indices = np.clip(np.searchsorted(interval_edges_s, time_s, side="right") - 1, 0, len(mark.strengths) - 1)
    is_acting = (time_s >= start_s) & (time_s <= end_s) & (is_closed if mark.in_contact else True)
    return np.where(is_acting, 0.3 + 0.7 * np.array(mark.strengths)[interval_indices], 0.0)
