"""A diagnosis in the viewer: marks on the moving bodies, the gap over time, and the verdict in words."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
from jaxtyping import Bool, Float

from rig.viewer.contact_view import ContactMotion
from rig.viewer.drawing import DIAGNOSIS, GAP_OVER_TIME, send, send_lines, style
from rig.viewer.gap import Mark, ShownGap
from rig.viewer.palette import GAP
from rig.viewer.stage import Stage

MIN_LABELLED_SHARE = 0.1
"""Least share of the mismatch at a station that is labelled."""


def send_gap(stream: rr.RecordingStream, gap: ShownGap, scene: Stage, contact_motions: Sequence[ContactMotion]) -> None:
    """Send a diagnosis: text, dots sized by the stations' shares of the mismatch, marks and mismatch over time.

    Marks are labelled dots whose size follows their strength over time.
    """
    style(stream, DIAGNOSIS, rr.TextDocument(gap.text, media_type="text/markdown"))
    for number, (station, share) in enumerate(gap.shares.items()):
        words = [f"{100 * share:.0f} %"] if share >= MIN_LABELLED_SHARE else None
        radius = 2.0 + 6.0 * float(np.sqrt(share / max(gap.shares.values(), default=1.0)))
        path = f"model/gap/share_{number}"
        style(stream, path, rr.Points3D.from_fields(colors=[GAP], radii=[rr.Radius.ui_points(radius)], labels=words))
        send(stream, path, scene.time_s, rr.Points3D, positions=scene.point(station))
    for number, mark in enumerate(gap.marks):
        path, positions = f"model/gap/mark_{number}", scene.point(mark.place)
        strengths = _strengths(mark, gap, scene.time_s, _closed(scene, contact_motions))
        radii = -14.0 * strengths  # negative: pixels
        style(stream, path, rr.Points3D.from_fields(colors=[GAP]))
        send(stream, path, scene.time_s, rr.Points3D, positions=positions, radii=radii)
        style(stream, f"{path}/words", rr.Points3D.from_fields(colors=[GAP], radii=[0.0]))
        above = positions + np.array([0, 0, (0.12 + 0.07 * number) * scene.extent_m])
        send(
            stream,
            f"{path}/words",
            scene.time_s,
            rr.Points3D,
            positions=above,
            labels=np.where(strengths > 0, mark.words, ""),
        )
    edges = np.array([edge_s for start_s, end_s, _ in gap.spans for edge_s in (start_s, end_s - 1e-6)])
    percent = np.array([100 * share for _, _, share in gap.spans for _ in range(2)])
    send_lines(stream, GAP_OVER_TIME, edges, percent[None], ["share of the gap"], (GAP,))


def _closed(scene: Stage, contact_motions: Sequence[ContactMotion]) -> Bool[np.ndarray, " frames"]:
    """Frames at which a contact is closed."""
    closed = np.zeros(scene.time_s.size, dtype=bool)
    for contact_motion in contact_motions:
        closed[np.searchsorted(scene.time_s, contact_motion.time_s[contact_motion.frames] - 1e-9)] |= (
            contact_motion.closed[contact_motion.frames]
        )
    return closed


def _strengths(
    mark: Mark, gap: ShownGap, time_s: Float[np.ndarray, " frames"], closed: Bool[np.ndarray, " frames"]
) -> Float[np.ndarray, " frames"]:
    """Strength of a mark at every frame, 0.3 to 1; zero outside the diagnosed time and, if in contact, when open."""
    start_s, end_s = (gap.spans[0][0], gap.spans[-1][1]) if gap.spans else (0.0, np.inf)
    edges = np.linspace(start_s, end_s if np.isfinite(end_s) else time_s[-1], len(mark.strengths) + 1)
    interval = np.clip(np.searchsorted(edges, time_s, side="right") - 1, 0, len(mark.strengths) - 1)
    acts = (time_s >= start_s) & (time_s <= end_s) & (closed if mark.in_contact else True)
    return np.where(acts, 0.3 + 0.7 * np.array(mark.strengths)[interval], 0.0)
