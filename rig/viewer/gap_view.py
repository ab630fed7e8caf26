"""A diagnosis in the viewer: marks on the moving bodies, the gap over time, and the verdict in words."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
from jaxtyping import Bool, Float

from rig.viewer.contact_view import Play
from rig.viewer.drawing import DIAGNOSIS, GAP, GAP_OVER_TIME, send, send_lines, style
from rig.viewer.gap import Mark, ShownGap
from rig.viewer.stage import Stage

LABELLED = 0.1
"""Stations with so large a share of the gap have a figure."""


def send_gap(stream: rr.RecordingStream, gap: ShownGap, scene: Stage, plays: Sequence[Play]) -> None:
    """Dots as large as the stations' shares of the gap; larger ones, with words, where something acts, by its strength
    at the time. The text, and the share of the gap over time."""
    style(stream, DIAGNOSIS, rr.TextDocument(gap.text, media_type="text/markdown"))
    for number, (station, share) in enumerate(gap.shares.items()):
        words = [f"{100 * share:.0f} %"] if share >= LABELLED else None
        radius = 2.0 + 6.0 * float(np.sqrt(share / max(gap.shares.values(), default=1.0)))
        path = f"model/gap/share_{number}"
        style(stream, path, rr.Points3D.from_fields(colors=[GAP], radii=[rr.Radius.ui_points(radius)], labels=words))
        send(stream, path, scene.time_s, rr.Points3D, positions=scene.point(station))
    for number, mark in enumerate(gap.marks):
        path, at = f"model/gap/mark_{number}", scene.point(mark.place)
        strengths = _strengths(mark, gap, scene.time_s, _closed(scene, plays))
        radii = -14.0 * strengths  # negative: pixels
        style(stream, path, rr.Points3D.from_fields(colors=[GAP]))
        send(stream, path, scene.time_s, rr.Points3D, positions=at, radii=radii)
        style(stream, f"{path}/words", rr.Points3D.from_fields(colors=[GAP], radii=[0.0]))
        above = at + np.array([0, 0, (0.12 + 0.07 * number) * scene.extent_m])
        send(
            stream,
            f"{path}/words",
            scene.time_s,
            rr.Points3D,
            positions=above,
            labels=np.where(strengths > 0, mark.words, ""),
        )
    edges = np.array([t for begin, end, _ in gap.spans for t in (begin, end - 1e-6)])
    percent = np.array([100 * share for _, _, share in gap.spans for _ in range(2)])
    send_lines(stream, GAP_OVER_TIME, edges, percent[None], ["share of the gap"], (GAP,))


def _closed(scene: Stage, plays: Sequence[Play]) -> Bool[np.ndarray, " frames"]:
    """Frames at which a contact is closed."""
    closed = np.zeros(scene.time_s.size, dtype=bool)
    for play in plays:
        closed[np.searchsorted(scene.time_s, play.time_s[play.frames] - 1e-9)] |= play.closed[play.frames]
    return closed


def _strengths(
    mark: Mark, gap: ShownGap, time_s: Float[np.ndarray, " frames"], closed: Bool[np.ndarray, " frames"]
) -> Float[np.ndarray, " frames"]:
    """Strengths of a mark at every frame; none before and after what was diagnosed, and without contact if it acts in
    it.
    """
    begin, end = (gap.spans[0][0], gap.spans[-1][1]) if gap.spans else (0.0, np.inf)
    edges = np.linspace(begin, end if np.isfinite(end) else time_s[-1], len(mark.strengths) + 1)
    part = np.clip(np.searchsorted(edges, time_s, side="right") - 1, 0, len(mark.strengths) - 1)
    acts = (time_s >= begin) & (time_s <= end) & (closed if mark.in_contact else True)
    return np.where(acts, 0.3 + 0.7 * np.array(mark.strengths)[part], 0.0)
