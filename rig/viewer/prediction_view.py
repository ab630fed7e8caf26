"""Predicted motion in the viewer: both rigs over the measured bodies, a station's displacement, and the errors."""

from dataclasses import replace

import numpy as np
import rerun as rr
from jaxtyping import Float

from rig.viewer.blueprint import GHOSTS
from rig.viewer.drawing import PREDICTION, TIMELINE, entity, pixels, send, send_legend, send_lines, style
from rig.viewer.palette import BELIEVED, FOUND, MACHINE, Colour
from rig.viewer.prediction import PredictedMotion, summary
from rig.viewer.stage import Stage


def send_prediction(stream: rr.RecordingStream, predicted: PredictedMotion, scene: Stage, stride: int) -> None:
    """Send outlines of both rigs, the displacement of the shown station, the errors over time and a summary.

    Every `stride`-th sample is plotted; the lines are broken where a window begins.
    """
    rate_hz = scene.sample_rate_hz
    words = summary(predicted, predicted.window_samples / rate_hz)
    style(stream, f"{PREDICTION}/words", rr.TextDocument(words, media_type="text/markdown"))
    displacements = {
        "measured": (predicted.measured_m, MACHINE),
        "believed": (predicted.believed_m, BELIEVED),
        "corrected": (predicted.corrected_m, FOUND),
    }
    plotted = np.arange(0, predicted.measured_m.shape[1], stride)
    time_s = (predicted.first_sample + plotted) / rate_hz
    begins = np.flatnonzero(np.diff(plotted // predicted.window_samples)) + 1
    for name, (displacement_m, colour) in displacements.items():
        breaks = begins if name != "measured" else begins[:0]
        for origin, values_m in (
            ("displacement", displacement_m[predicted.shown_row]),
            ("error", predicted.errors_m(displacement_m)),
        ):
            if origin == "error" and name == "measured":
                continue
            values_mm = np.insert(1e3 * values_m[plotted], breaks, np.nan)
            times_s = np.insert(time_s, breaks, time_s[breaks] - 1e-7)
            send_lines(stream, f"{PREDICTION}/{origin}/{name}", times_s, values_mm[None], [name], (colour,))
    legend = [(name, colour) for name, (_, colour) in displacements.items()]
    send_legend(stream, f"{PREDICTION}/displacement", legend)
    send_legend(stream, f"{PREDICTION}/error", legend[1:])
    for name in ("believed", "corrected"):
        displacement_m, colour = displacements[name]
        _send_ghosts(stream, f"{GHOSTS}/{name}", predicted, displacement_m, colour, scene)


def _send_ghosts(
    stream: rr.RecordingStream,
    path: str,
    predicted: PredictedMotion,
    displacement_m: Float[np.ndarray, "stations samples"],
    colour: Colour,
    scene: Stage,
) -> None:
    """Send the outlines of all bodies as one rig moves; there are none outside the predicted time."""
    whole_m = scene.deflection.displacement_m.copy()
    whole_m[:, predicted.samples] = displacement_m
    is_predicted = (scene.frames >= predicted.samples.start) & (scene.frames < predicted.samples.stop)
    frames = scene.frames[is_predicted]
    ghost = replace(scene, deflection=replace(scene.deflection, displacement_m=whole_m), frames=frames)
    for body in scene.rig.bodies:
        place = f"{path}/{entity(body.name)}"
        style(stream, place, rr.LineStrips3D.from_fields(colors=[colour], radii=[pixels(1.5)]))
        send(stream, place, ghost.time_s, rr.LineStrips3D, strips=ghost.strips(body))
    if frames.size and frames.size < scene.frames.size:
        stream.set_time(TIMELINE, duration=float(predicted.samples.stop / scene.sample_rate_hz))
        for body in scene.rig.bodies:
            stream.log(f"{path}/{entity(body.name)}", rr.Clear(recursive=False))
