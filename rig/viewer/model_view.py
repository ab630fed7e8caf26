"""The moving rig in the viewer: bodies, supports, contacts, forces, and the key of the colours."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from rig.model.description import Body
from rig.recording import Recording
from rig.viewer.contact_view import ContactMotion
from rig.viewer.drawing import KEY, entity, pixels, send, send_labels, style
from rig.viewer.palette import FAINT, FORCE, MACHINE, MEANINGS, SOURCES, STEEL, Colour, shades
from rig.viewer.stage import Stage


def send_key(stream: rr.RecordingStream) -> None:
    """Send the meanings of the colours, side by side."""
    for number, meaning in enumerate(MEANINGS.values()):
        send_labels(stream, f"{KEY}/{number}", [[number + 0.5, 0.0]], [meaning.words], meaning.on_dark)


def send_model(
    stream: rr.RecordingStream, scene: Stage, recording: Recording, contact_motions: Sequence[ContactMotion]
) -> None:
    """Send the moving bodies, contacts and forces; a mass is a block."""
    stream.log("model", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    bodies = scene.rig.bodies
    for body, colour in zip(bodies, shades(MACHINE, len(bodies)), strict=True):
        _send_body(stream, scene, body, colour)
    for contact_motion in contact_motions:
        _send_contact(stream, scene, contact_motion)
    longest_n = np.abs(recording.forces_n).max() or 1.0
    for name, station, force_n in zip(scene.rig.force_names, scene.rig.forces, recording.forces_n, strict=True):
        if scene.rig.is_on_ground(station):
            continue
        path, arrows = entity("model", name), np.zeros((scene.time_s.size, 3))
        arrows[:, 2] = 0.2 * scene.extent_m * force_n[scene.frames] / longest_n
        style(stream, path, rr.Arrows3D.from_fields(colors=[FORCE], radii=[0.004 * scene.extent_m]))
        send(stream, path, scene.time_s, rr.Arrows3D, vectors=arrows, origins=scene.force_origin(station))


def _send_body(stream: rr.RecordingStream, scene: Stage, body: Body, colour: Colour) -> None:
    path = entity("model", body.name)
    if body.length_m:
        style(stream, path, rr.LineStrips3D.from_fields(colors=[colour], radii=[pixels(4.0)]))
        send(stream, path, scene.time_s, rr.LineStrips3D, strips=scene.strips(body))
    else:
        block = rr.Boxes3D.from_fields(half_sizes=[scene.half_sizes(body)], colors=[colour], fill_mode="solid")
        style(stream, path, block)
        send(stream, path, scene.time_s, rr.Boxes3D, centers=scene.centre(body))
    style(stream, f"{path}/rest", rr.LineStrips3D([scene.rest_line(body)], colors=[FAINT], radii=pixels(0.75)))
    if (support := scene.support(body)) is not None:
        style(stream, f"{path}/support", rr.LineStrips3D([support], colors=[STEEL], radii=pixels(2.0)))
    words = rr.Points3D.from_fields(colors=[colour], radii=[0.0], labels=[body.name], show_labels=True)
    style(stream, f"{path}/name", words)
    send(stream, f"{path}/name", scene.time_s, rr.Points3D, positions=scene.label(body))


def _send_contact(stream: rr.RecordingStream, scene: Stage, contact_motion: ContactMotion) -> None:
    """Send the stops, drawn by the law of the walls, and the point between them in the colour of its state."""
    contact = contact_motion.contact
    path, tip = entity("model", contact.name), scene.tip(contact)
    stops = rr.LineStrips3D.from_fields(colors=[SOURCES[contact_motion.wall_source]], radii=[pixels(1.75)])
    style(stream, path, stops)
    send(stream, path, scene.time_s, rr.LineStrips3D, strips=scene.fork(contact, contact.law))
    if scene.stands_beside(contact):
        tongue = np.stack([scene.point(contact.at), tip], axis=1)
        style(stream, f"{path}/tongue", rr.LineStrips3D.from_fields(colors=[MACHINE], radii=[pixels(3.0)]))
        send(stream, f"{path}/tongue", scene.time_s, rr.LineStrips3D, strips=tongue)
    style(stream, f"{path}/point", rr.Points3D.from_fields(radii=[pixels(6.0)]))
    colours = np.full((scene.time_s.size, 3), STEEL, dtype=np.uint8)
    drawn = np.searchsorted(scene.time_s, contact_motion.time_s[contact_motion.frames] - 1e-9)
    colours[drawn] = contact_motion.colours
    send(stream, f"{path}/point", scene.time_s, rr.Points3D, positions=tip, colors=colours)
