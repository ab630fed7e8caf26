"""A recording as an .rrd file for the rerun viewer: the moving bodies, the contacts close up, and the time series."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from jaxtyping import Bool, Float, UInt8

from rig.blueprint import TIMELINE, TRAIL_S, Look, blueprint, entity
from rig.deflection import deflection
from rig.description import Contact
from rig.errors import RigError
from rig.recording import Recording
from rig.stage import Stage, stage

SCALARS = 1_000_000
"""Above this many in the time series, they are thinned out."""
ROWS = 8192
TRAIL_POINTS = 60
HATCHES = 16

FREE, CLOSED, STEEL, FAINT, FORCE = (90, 200, 120), (255, 70, 60), (170, 175, 185), (85, 90, 100), (255, 190, 60)
LINES = (
    (95, 160, 255),
    (255, 150, 90),
    (190, 130, 255),
    (120, 220, 220),
    (240, 220, 100),
    (255, 130, 180),
    (150, 210, 90),
    (200, 200, 200),
)


def write_rrd(recording: Recording, truth: Recording | None, path: Path, magnification: float | None = None) -> None:
    """Writes the recording for the rerun viewer; `truth`, where there is one, adds what only a simulator knows.

    The motion comes from the truth file, else from the displacement sensors, else from integrated accelerations, which
    lack everything below 1 Hz. `magnification` is that of the deflection in the 3D view; without it a round one is
    chosen. The walls are those that rig.json believes in.

    Raises RigError if the truth belongs to another recording, a body has no sensor, the magnification is not above
    zero, or the file cannot be written.
    """
    if magnification is not None and not 0 < magnification < np.inf:
        raise RigError(f"magnification is {magnification}; give a finite value above zero")
    if truth is not None and not _belongs(truth, recording):
        raise RigError("the truth file has other samples, contacts or groups than the recording; take it away")
    motion = deflection(recording, truth)
    scene = stage(motion, recording.rig.sample_rate_hz, magnification)
    relative_m = motion.relative() if truth is None else truth.signals["relative_displacement"].values
    stride = max(1, -(-_series_scalars(recording, truth) // SCALARS))
    look = Look(
        rig=recording.rig,
        contact_force=truth is not None and bool(recording.rig.contacts),
        magnification=scene.magnification,
        approximate=motion.approximate,
        stride=stride,
        centre_m=scene.centre_m,
        extent_m=scene.extent_m,
        frame_rate_hz=scene.frame_rate_hz,
        largest_relative_m=tuple(float(np.abs(row).max()) for row in relative_m),
    )
    part = path.with_name(path.name + ".part")
    try:
        part.touch()
        with rr.RecordingStream("rig") as stream:
            stream.save(part, default_blueprint=blueprint(look))
            stream.send_recording_name(f"{recording.rig.name}, {recording.duration_s:g} s")
            _send_model(stream, scene, recording, relative_m)
            for contact, row in zip(recording.rig.contacts, relative_m, strict=True):
                _send_close_up(stream, scene, contact, row, look.reach_mm(contact))
                _send_relative_displacement(stream, contact, recording.signals["force"].time_s, row, stride)
            _send_series(stream, recording, truth, stride)
            stream.flush()
            stream.disconnect()
        part.replace(path)
    except OSError as error:
        raise RigError(f"{path}: cannot be written ({error.strerror}); choose another place") from error
    finally:
        part.unlink(missing_ok=True)


def open_viewer(path: Path) -> None:
    """Opens the file in the rerun viewer and returns at once."""
    subprocess.Popen([sys.executable, "-m", "rerun", str(path)], start_new_session=True)


def _belongs(truth: Recording, recording: Recording) -> bool:
    contacts = [[c.name for c in r.rig.contacts] for r in (truth, recording)]
    known = {"displacement", "relative_displacement", "contact_force"} <= set(truth.signals)
    return known and truth.samples == recording.samples and contacts[0] == contacts[1]


def _series_scalars(recording: Recording, truth: Recording | None) -> int:
    """How many scalars the time series have at full rate."""
    accelerations = recording.signals.get("acceleration")
    channels = len(accelerations.channels.names) if accelerations else 0
    return recording.samples * (1 + channels + len(recording.rig.contacts) * (1 if truth is None else 2))


def _send_model(
    stream: rr.RecordingStream, scene: Stage, recording: Recording, relative_m: Float[np.ndarray, "contacts samples"]
) -> None:
    stream.log("model", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for number, body in enumerate(scene.rig.bodies):
        path, colour, strips = entity("model", body.name), LINES[number % len(LINES)], scene.strips(body)
        _style(stream, path, rr.LineStrips3D.from_fields(colors=[colour], radii=[_pixels(3.0)]))
        _send(stream, path, scene.time_s, rr.LineStrips3D, strips=strips)
        _style(stream, f"{path}/rest", rr.LineStrips3D([scene.rest(body)], colors=[FAINT], radii=_pixels(0.75)))
        if (support := scene.support(body)) is not None:
            _style(stream, f"{path}/support", rr.LineStrips3D([support], colors=[STEEL], radii=_pixels(2.0)))
        label = scene.label(body)
        _style(stream, f"{path}/name", rr.Points3D.from_fields(colors=[colour], radii=[0.0], labels=[body.name]))
        _send(stream, f"{path}/name", scene.time_s, rr.Points3D, positions=label)
    for contact, row in zip(scene.rig.contacts, relative_m, strict=True):
        path, believed = entity("model", contact.name), recording.rig.contact(contact.name)
        _style(stream, path, rr.LineStrips3D.from_fields(colors=[STEEL], radii=[_pixels(2.0)]))
        _send(stream, path, scene.time_s, rr.LineStrips3D, strips=scene.fork(contact, believed.law))
        _style(stream, f"{path}/point", rr.Points3D.from_fields(radii=[_pixels(5.0)]))
        colours = _closed(believed, row[scene.frames])[1]
        _send(stream, f"{path}/point", scene.time_s, rr.Points3D, positions=scene.point(contact.at), colors=colours)
    force = recording.force_n[scene.frames]
    arrows = np.zeros((force.size, 3))
    arrows[:, 2] = 0.2 * scene.extent_m * force / (np.abs(recording.force_n).max() or 1.0)
    pushed = scene.point(scene.rig.force_at)
    _style(stream, "model/force", rr.Arrows3D.from_fields(colors=[FORCE], radii=[0.004 * scene.extent_m]))
    _send(stream, "model/force", scene.time_s, rr.Arrows3D, vectors=arrows, origins=pushed)


def _send_close_up(
    stream: rr.RecordingStream,
    scene: Stage,
    contact: Contact,
    relative_m: Float[np.ndarray, " samples"],
    reach_mm: float,
) -> None:
    """The relative displacement in mm, upwards, between its two walls, with what it was just before to its left."""
    path, law, across = entity("close_up", contact.name), contact.law, 1.1 * reach_mm
    for level, solid in ((-1e3 * law.upper_clearance_m, -1), (1e3 * law.lower_clearance_m, 1)):  # y points downwards
        side = "upper" if solid < 0 else "lower"
        edges = np.linspace(-across, across, HATCHES + 1)
        hatches = [[[x, level], [x - 0.05 * across, level + solid * 0.05 * across]] for x in edges[1:]]
        walls = [[[-across, level], [across, level]], *hatches]
        _style(stream, f"{path}/{side}", rr.LineStrips2D(walls, colors=[STEEL], radii=_pixels(1.5)))
        place = [0.85 * across, level if solid < 0 else level - 0.17 * reach_mm]
        _style(
            stream, f"{path}/{side}/level", rr.Points2D([place], colors=[STEEL], radii=0, labels=[f"{-level:+g} mm"])
        )
    now_x, back = 0.15 * across, np.linspace(-TRAIL_S * scene.sample_rate_hz, 0, TRAIL_POINTS).round().astype(int)
    trail = np.empty((scene.frames.size, TRAIL_POINTS, 2))
    trail[..., 0] = now_x + (across + now_x) * back / -back[0]
    trail[..., 1] = -1e3 * relative_m[np.maximum(scene.frames[:, None] + back, 0)]
    closed, colours = _closed(contact, relative_m[scene.frames])
    words = [f"{-y:+.2f} mm, {'closed' if c else 'free'}" for y, c in zip(trail[:, -1, 1], closed, strict=True)]
    _style(stream, f"{path}/middle", rr.LineStrips2D([[[-across, 0], [across, 0]]], colors=[FAINT], radii=_pixels(0.5)))
    _style(stream, f"{path}/trail", rr.LineStrips2D.from_fields(colors=[LINES[0]], radii=[_pixels(0.75)]))
    _send(stream, f"{path}/trail", scene.time_s, rr.LineStrips2D, strips=trail)
    _style(stream, f"{path}/point", rr.Points2D.from_fields(radii=[_pixels(7.0)]))
    _send(stream, f"{path}/point", scene.time_s, rr.Points2D, positions=trail[:, -1], colors=colours)
    _style(stream, f"{path}/reading", rr.Points2D.from_fields(positions=[[0.65 * across, -0.1 * reach_mm]], radii=[0]))
    _send(stream, f"{path}/reading", scene.time_s, rr.Points2D, labels=words, colors=colours)


def _closed(
    contact: Contact, relative_m: Float[np.ndarray, " frames"]
) -> tuple[Bool[np.ndarray, " frames"], UInt8[np.ndarray, "frames 3"]]:
    """Whether the relative displacement is beyond a wall, and the colour that says so."""
    closed = contact.law.penetration_m(relative_m) != 0
    return closed, np.where(closed[:, None], CLOSED, FREE).astype(np.uint8)


def _send_relative_displacement(
    stream: rr.RecordingStream,
    contact: Contact,
    time_s: Float[np.ndarray, " samples"],
    relative_m: Float[np.ndarray, " samples"],
    stride: int,
) -> None:
    path, law = entity("relative_displacement", contact.name), contact.law
    limits = 1e3 * np.array([law.upper_clearance_m, -law.lower_clearance_m])
    names = [f"wall, {limit:+g} mm" for limit in limits]
    _send_lines(stream, f"{path}/walls", time_s[[0, -1]], np.tile(limits[:, None], 2), names, (CLOSED,))
    _send_lines(stream, f"{path}/value", time_s[::stride], 1e3 * relative_m[None, ::stride], [contact.name], LINES)


def _send_series(stream: rr.RecordingStream, recording: Recording, truth: Recording | None, stride: int) -> None:
    time_s = recording.signals["force"].time_s[::stride]
    _send_lines(stream, "exciting_force", time_s, recording.force_n[None, ::stride], ["force"], (FORCE,))
    if truth is not None:
        known = truth.signals["contact_force"]
        _send_lines(stream, "contact_force", time_s, known.values[:, ::stride], known.channels.names, LINES)
    if "acceleration" in recording.signals:
        measured = recording.signals["acceleration"]
        for body in recording.rig.bodies:
            places = [(i, s) for i, s in enumerate(measured.channels.stations) if s is not None and s.body == body.name]
            values = measured.values[[i for i, _ in places], ::stride]
            names = [f"{s.position_m:g} m" for _, s in places]
            _send_lines(stream, entity("acceleration", body.name), time_s, values, names, LINES)


def _send_lines(
    stream: rr.RecordingStream,
    path: str,
    time_s: Float[np.ndarray, " samples"],
    values: Float[np.ndarray, "channels samples"],
    names: Sequence[str],
    colours: Sequence[tuple[int, int, int]],
) -> None:
    """Lines of a time series; zoomed out, each pixel shows the least and the greatest value, not their mean."""
    style = rr.SeriesLines(
        names=names,
        colors=[colours[i % len(colours)] for i in range(len(names))],
        widths=[1.5] * len(names),
        aggregation_policy=rr.components.AggregationPolicy.MinMax,
    )
    _style(stream, path, style)
    rows = np.ascontiguousarray(values.T)
    _send(stream, path, time_s, rr.Scalars, scalars=rows)


def _style(stream: rr.RecordingStream, path: str, style: rr.AsComponents) -> None:
    stream.log(path, style, static=True)


def _send(stream: rr.RecordingStream, path: str, time_s: Float[np.ndarray, " rows"], kind: Any, **columns: Any) -> None:
    """Sends columns of an archetype, some thousand rows at a time."""
    for first in range(0, time_s.size, ROWS):
        rows = slice(first, first + ROWS)
        index = rr.TimeColumn(TIMELINE, duration=time_s[rows])
        stream.send_columns(path, [index], kind.columns(**{name: values[rows] for name, values in columns.items()}))


def _pixels(radius: float) -> float:
    return float(rr.Radius.ui_points(radius))
