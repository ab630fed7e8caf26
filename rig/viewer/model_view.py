"""The moving rig in the viewer: bodies, supports, contacts, forces, and the key of the colours."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from rig.model.description import Body
from rig.recording import Recording
from rig.viewer.contact_view import ContactMotion
from rig.viewer.drawing import KEY, entity, pixels, send, send_labels, send_static
from rig.viewer.palette import FAINT, FORCE, MACHINE, SOURCES, STEEL, Colour, ColourMeaning, shades
from rig.viewer.stage import Stage

UPWARDS, OUTWARDS = (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)
"""Directions of y and of z of the rig on the stage."""


def send_colour_key(stream: rr.RecordingStream, meanings: Sequence[ColourMeaning]) -> None:
    """Send the meanings of the colours that are shown, side by side."""
    for index, meaning in enumerate(meanings):
        send_labels(stream, f"{KEY}/{index}", [[index + 0.5, 0.0]], [meaning.words], meaning.on_dark)


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
    largest_force_n = np.abs(recording.forces_n).max() or 1.0
    for force_name, station, force_n in zip(scene.rig.force_names, scene.rig.forces, recording.forces_n, strict=True):
        if scene.rig.is_on_ground(station):
            continue
        entity_path, arrow_vectors = entity("model", force_name), np.zeros((scene.time_s.size, 3))
        arrow_lengths_m = 0.2 * scene.extent_m * force_n[scene.frame_samples] / largest_force_n
        arrow_vectors += arrow_lengths_m[:, None] * np.array(UPWARDS if station.direction == "y" else OUTWARDS)
        send_static(stream, entity_path, rr.Arrows3D.from_fields(colors=[FORCE], radii=[0.004 * scene.extent_m]))
        send(stream, entity_path, scene.time_s, rr.Arrows3D, vectors=arrow_vectors, origins=scene.force_origin(station))


def _send_body(stream: rr.RecordingStream, scene: Stage, body: Body, colour: Colour) -> None:
    entity_path = entity("model", body.name)
    if body.length_m:
        send_static(stream, entity_path, rr.LineStrips3D.from_fields(colors=[colour], radii=[pixels(4.0)]))
        send(stream, entity_path, scene.time_s, rr.LineStrips3D, strips=scene.strips(body))
    else:
        block_style = rr.Boxes3D.from_fields(half_sizes=[scene.half_sizes(body)], colors=[colour], fill_mode="solid")
        send_static(stream, entity_path, block_style)
        send(stream, entity_path, scene.time_s, rr.Boxes3D, centers=scene.centre(body))
    rest_line = rr.LineStrips3D([scene.rest_line(body)], colors=[FAINT], radii=pixels(0.75))
    send_static(stream, f"{entity_path}/rest", rest_line)
    if (wall_points := scene.wall_corners(body)) is not None:
        send_static(stream, f"{entity_path}/support", rr.LineStrips3D([wall_points], colors=[STEEL], radii=pixels(2.0)))
    name_style = rr.Points3D.from_fields(colors=[colour], radii=[0.0], labels=[body.name], show_labels=True)
    send_static(stream, f"{entity_path}/name", name_style)
    send(stream, f"{entity_path}/name", scene.time_s, rr.Points3D, positions=scene.label(body))


def _send_contact(stream: rr.RecordingStream, scene: Stage, contact_motion: ContactMotion) -> None:
    """Send the stops, drawn by the law of the walls, and the point between them in the colour of its state."""
    contact = contact_motion.contact
    entity_path, tip_points = entity("model", contact.name), scene.tip(contact)
    fork_style = rr.LineStrips3D.from_fields(colors=[SOURCES[contact_motion.wall_source]], radii=[pixels(1.75)])
    send_static(stream, entity_path, fork_style)
    stop_lines = scene.ring(contact) if contact_motion.orbit is not None else scene.fork(contact, contact.law)
    send(stream, entity_path, scene.time_s, rr.LineStrips3D, strips=stop_lines)
    if scene.is_side_by_side(contact):
        tongue_strips = np.stack([scene.point(contact.at), tip_points], axis=1)
        send_static(stream, f"{entity_path}/tongue", rr.LineStrips3D.from_fields(colors=[MACHINE], radii=[pixels(3.0)]))
        send(stream, f"{entity_path}/tongue", scene.time_s, rr.LineStrips3D, strips=tongue_strips)
    send_static(stream, f"{entity_path}/point", rr.Points3D.from_fields(radii=[pixels(6.0)]))
    point_colours = np.full((scene.time_s.size, 3), STEEL, dtype=np.uint8)
    frame_indices = np.searchsorted(scene.time_s, contact_motion.time_s[contact_motion.frame_samples] - 1e-9)
    point_colours[frame_indices] = contact_motion.frame_colours
    send(stream, f"{entity_path}/point", scene.time_s, rr.Points3D, positions=tip_points, colors=point_colours)
