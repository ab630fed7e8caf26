"""Predicted motion in the viewer: both rigs over the measured bodies, a station's displacement, and the errors."""

from dataclasses import replace

import numpy as np
import rerun as rr
from jaxtyping import Float

from rig.viewer.blueprint import PREDICTED_RIGS
from rig.viewer.drawing import (
    LAYER_WIDTHS_PX,
    PREDICTION,
    TIMELINE,
    entity,
    pixels,
    send,
    send_legend,
    send_lines,
    send_static,
)
from rig.viewer.palette import BELIEVED, FOUND, MACHINE, Colour
from rig.viewer.prediction import PredictedMotion
from rig.viewer.stage import Stage

GHOST_WIDTH_AND_DEPTH = {BELIEVED: (2.25, 0.0015), FOUND: (1.0, 0.003)}
"""Half widths of the outlines in pixels and their distances before the measured bodies as shares of the extent: where
they coincide, each shows within the one behind it."""


def send_prediction(stream: rr.RecordingStream, prediction: PredictedMotion, scene: Stage, stride: int) -> None:
    """Send outlines of both rigs, the displacement of the shown station, the errors over time and a summary.

    Every `stride`-th sample is plotted; the lines are broken where a window begins.
    """
    rate_hz = scene.sample_rate_hz
    summary_words = summary_text(prediction, prediction.samples_per_window / rate_hz)
    send_static(stream, f"{PREDICTION}/words", rr.TextDocument(summary_words, media_type="text/markdown"))
    displacement_by_source = {
        "measured": (prediction.measured_m, MACHINE),
        "believed": (prediction.believed_m, BELIEVED),
        "corrected": (prediction.corrected_m, FOUND),
    }
    plotted_samples = np.arange(0, prediction.measured_m.shape[1], stride)
    plotted_time_s = (prediction.first_sample + plotted_samples) / rate_hz
    window_starts = np.flatnonzero(np.diff(plotted_samples // prediction.samples_per_window)) + 1
    for layer_index, (source_name, (displacement_m, colour)) in enumerate(displacement_by_source.items()):
        break_positions = window_starts if source_name != "measured" else window_starts[:0]
        for plot_name, plotted_m in (
            ("displacement", displacement_m[prediction.shown_station_row]),
            ("error", prediction.errors_m(displacement_m)),
        ):
            if plot_name == "error" and source_name == "measured":
                continue
            broken_values_mm = np.insert(1e3 * plotted_m[plotted_samples], break_positions, np.nan)
            broken_time_s = np.insert(plotted_time_s, break_positions, plotted_time_s[break_positions] - 1e-7)
            send_lines(
                stream,
                f"{PREDICTION}/{plot_name}/{layer_index}_{source_name}",
                broken_time_s,
                broken_values_mm[None],
                [source_name],
                (colour,),
                LAYER_WIDTHS_PX[min(layer_index, 1)],
            )
    legend = [(source_name, colour) for source_name, (_, colour) in displacement_by_source.items()]
    send_legend(stream, f"{PREDICTION}/displacement", legend)
    send_legend(stream, f"{PREDICTION}/error", legend[1:])
    for source_name in ("believed", "corrected"):
        displacement_m, colour = displacement_by_source[source_name]
        _send_ghosts(stream, f"{PREDICTED_RIGS}/{source_name}", prediction, displacement_m, colour, scene)


def summary_text(prediction: PredictedMotion, window_s: float) -> str:
    """Median errors of both rigs over the windows, in Markdown."""
    believed_mm, corrected_mm = (
        1e3 * float(np.median(prediction.window_errors_m(displacement_m)))
        for displacement_m in (prediction.believed_m, prediction.corrected_m)
    )
    change_words = "" if not np.isfinite(believed_mm) else f", {100 * (1 - corrected_mm / believed_mm):.0f} % less"
    return (
        f"Every {window_s:.2g} s both rigs start anew from the measured motion and continue under the measured force. "
        f"Median error of the displacement: **believed {believed_mm:.2g} mm, corrected {corrected_mm:.2g} "
        f"mm**{change_words}."
    )


def _send_ghosts(
    stream: rr.RecordingStream,
    ghosts_path: str,
    prediction: PredictedMotion,
    displacement_m: Float[np.ndarray, "stations samples"],
    colour: Colour,
    scene: Stage,
) -> None:
    """Send the outlines of all bodies as one rig moves; there are none outside the predicted time."""
    radius_px, depth_share = GHOST_WIDTH_AND_DEPTH[colour]
    record_displacement_m = scene.deflection.displacement_m.copy()
    record_displacement_m[:, prediction.samples] = displacement_m
    is_predicted = (scene.frame_samples >= prediction.samples.start) & (scene.frame_samples < prediction.samples.stop)
    predicted_frames = scene.frame_samples[is_predicted]
    ghost_stage = replace(
        scene,
        deflection=replace(scene.deflection, displacement_m=record_displacement_m),
        frame_samples=predicted_frames,
    )
    for body in scene.rig.bodies:
        entity_path = f"{ghosts_path}/{entity(body.name)}"
        send_static(stream, entity_path, rr.LineStrips3D.from_fields(colors=[colour], radii=[pixels(radius_px)]))
        ghost_strips = ghost_stage.strips(body) - [0.0, depth_share * scene.extent_m, 0.0]
        send(stream, entity_path, ghost_stage.time_s, rr.LineStrips3D, strips=ghost_strips)
    if predicted_frames.size and predicted_frames.size < scene.frame_samples.size:
        stream.set_time(TIMELINE, duration=float(prediction.samples.stop / scene.sample_rate_hz))
        for body in scene.rig.bodies:
            stream.log(f"{ghosts_path}/{entity(body.name)}", rr.Clear(recursive=False))
