"""A recording as an .rrd file for the rerun viewer: the moving bodies, the contacts close up, and the time series."""

import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rerun as rr
from jaxtyping import Float, Int
from msgspec.structs import replace

from rig.errors import RigError
from rig.files import write_bytes
from rig.model.contact_laws import ContactLaw, DeadZone
from rig.model.contact_laws.annular import Annular
from rig.model.description import Rig, Station
from rig.model.sensing import sensors_of
from rig.recording import Recording
from rig.viewer.blueprint import Layout, blueprint, plotted_quantities
from rig.viewer.contact_view import (
    ContactMotion,
    LawSource,
    send_close_up,
    send_events,
    send_over_time,
)
from rig.viewer.deflection import Deflection, deflection
from rig.viewer.drawing import entity, send_legend, send_lines
from rig.viewer.gap import ShownGap
from rig.viewer.gap_view import send_gap
from rig.viewer.identified import NOTHING_IDENTIFIED, IdentifiedContacts
from rig.viewer.model_view import send_key, send_model
from rig.viewer.orbit import Orbit
from rig.viewer.palette import FORCE, SENSOR, Colour, shades
from rig.viewer.phase_view import send_histogram, send_phase
from rig.viewer.prediction import PredictedMotion
from rig.viewer.prediction_view import send_prediction
from rig.viewer.spectra import send_spectra, spectra_of
from rig.viewer.stage import stage

MAX_SCALARS = 1_000_000
"""Number of plotted values above which the time series are decimated away from contacts."""


def write_rrd(
    recording: Recording,
    truth: Recording | None,
    path: Path,
    magnification: float | None = None,
    *,
    identified_contacts: IdentifiedContacts = NOTHING_IDENTIFIED,
    gap: ShownGap | None = None,
    prediction: PredictedMotion | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> None:
    """Write a recording for the rerun viewer; `truth`, if given, adds the simulated truth.

    The motion comes from the truth file, else from the displacement sensors, else from integrated accelerations, which
    lack everything below 1 Hz; relative displacements and contact forces from the truth file, else from the curves of
    `identified_contacts`. `magnification` is that of the deflection in the 3D view; without it a round one is chosen.
    The walls are the true ones, else those identified, else those that rig.json believes in; the others are drawn over
    them. A diagnosed `gap` is marked on the bodies. `prediction` adds a tab with the believed and the corrected rig
    beside the measured one.

    Raises RigError if the truth belongs to another recording, a body has no sensor, the magnification is not above
    zero, or the file cannot be written.
    """
    if magnification is not None and not 0 < magnification < np.inf:
        raise RigError(f"magnification is {magnification}; give a finite value above zero")
    if truth is not None and not _belongs_to(truth, recording):
        raise RigError("the truth file has other samples, contacts or groups than the recording; take it away")
    motion = deflection(recording, truth)
    scene = stage(motion, recording.rig.sample_rate_hz, magnification)
    stride = max(1, -(-_series_scalars(recording, truth) // MAX_SCALARS))
    contact_motions = _contact_motions(recording, truth, motion, identified_contacts, scene.frame_samples, stride)
    layout = Layout(
        rig=recording.rig if truth is None else truth.rig,
        contact_force=None
        if not contact_motions or contact_motions[0].force_n is None
        else "separated"
        if truth is None
        else "true",
        magnification=scene.magnification,
        is_approximate=motion.is_approximate,
        stride=stride,
        centre_m=scene.centre_m,
        extent_m=scene.extent_m,
        frame_rate_hz=scene.frame_rate_hz,
        reach_mm={contact_motion.contact.name: contact_motion.reach_mm for contact_motion in contact_motions},
        spectra=tuple(
            spectra_of(
                recording,
                {
                    other_motion.contact.name: other_motion.force_n
                    for other_motion in contact_motions
                    if other_motion.force_n is not None
                },
            )
        ),
        has_diagnosis=gap is not None,
        masses_alone=scene.masses_alone,
        predicted_station_name=station_words(recording.rig, prediction.stations[prediction.shown_row])
        if prediction
        else None,
    )
    with rr.RecordingStream("rig") as stream, _drained_stream(stream) as encoded_stream:
        stream.send_blueprint(blueprint(layout))
        stream.send_recording_name(f"{recording.rig.name}, {recording.duration_s:g} s")
        send_key(stream)
        send_model(stream, scene, recording, contact_motions)
        progress(0.3)
        for contact_number, contact_motion in enumerate(contact_motions, start=1):
            send_close_up(stream, contact_motion)
            send_over_time(stream, contact_motion)
            send_phase(stream, contact_motion)
            send_histogram(stream, contact_motion)
            send_events(stream, contact_motion)
            progress(0.3 + 0.5 * contact_number / len(contact_motions))
        if gap is not None:
            send_gap(stream, gap, scene, contact_motions)
        if prediction is not None:
            send_prediction(stream, prediction, scene, stride)
        _send_series(stream, recording, contact_motions, stride)
        for spectra in layout.spectra:
            send_spectra(stream, spectra, recording.rig.sample_rate_hz)
        write_bytes(encoded_stream.read() or b"", path)


@contextmanager
def _drained_stream(stream: rr.RecordingStream) -> Iterator[rr.BinaryStream]:
    """Encoded bytes of a stream; rerun's own file writer hangs if the disk is full.

    The stream is drained at the end, as rerun would otherwise print a warning.
    """
    encoded_stream = stream.binary_stream()
    try:
        yield encoded_stream
    finally:
        encoded_stream.read()


def _contact_motions(
    recording: Recording,
    truth: Recording | None,
    motion: Deflection,
    identified_contacts: IdentifiedContacts,
    frame_samples: Int[np.ndarray, " frames"],
    stride: int,
) -> list[ContactMotion]:
    """Motion of every contact from the best source: the truth, else the identification, else the sensors."""
    time_s = recording.signals["force"].time_s
    relative_displacement_m, force_n = motion.relative_displacement_m(), None
    if truth is not None:
        relative_displacement_m, force_n = (
            truth.signals[source_name].values for source_name in ("relative_displacement", "contact_force")
        )
    known_samples = slice(0, time_s.size)
    if truth is None and identified_contacts.curves is not None:
        known_samples = identified_contacts.curves.covered_samples(time_s)
        relative_displacement_m, force_n = identified_contacts.curves.interpolate(time_s[known_samples])
    contact_motions, first_row = [], 0
    for index, believed_contact in enumerate(recording.rig.contacts):
        is_annular = believed_contact.law.spatial
        rows = slice(first_row, first_row + 1 + is_annular)
        first_row = rows.stop
        law_by_source: dict[LawSource, ContactLaw] = {} if truth is None else {"true": truth.rig.contacts[index].law}
        law_by_source |= (
            {"identified": identified_contacts.laws[believed_contact.name]}
            if believed_contact.name in identified_contacts.laws
            else {}
        )
        law_by_source["believed"] = believed_contact.law
        wall_source = next(iter(law_by_source))
        eta_m, contact_n = relative_displacement_m[rows], None if force_n is None else force_n[rows]
        orbit = Orbit(eta_m - _centre_of(law_by_source[wall_source], believed_contact.law)) if is_annular else None
        if is_annular:
            law_by_source = {source_name: _radial_law(law) for source_name, law in law_by_source.items()}
        overlaid_laws = {
            source_name: contact_law
            for source_name, contact_law in law_by_source.items()
            if source_name == "identified" or contact_law != law_by_source[wall_source]
        }
        contact_motion = ContactMotion(
            contact=replace(believed_contact, law=law_by_source[wall_source]),
            wall_source=wall_source,
            overlaid_laws={
                source_name: contact_law
                for source_name, contact_law in overlaid_laws.items()
                if source_name != wall_source
            },
            time_s=time_s[known_samples],
            until_s=float(time_s[known_samples.stop]) if known_samples.stop < time_s.size else None,
            eta_m=eta_m[0] if orbit is None else orbit.radius_m,
            force_n=None if contact_n is None else np.hypot(*contact_n) if is_annular else contact_n[0],
            frame_samples=frame_samples[(frame_samples >= known_samples.start) & (frame_samples < known_samples.stop)]
            - known_samples.start,
            stride=stride,
            is_identified=truth is None and identified_contacts.curves is not None,
            orbit=orbit,
        )
        contact_motions.append(contact_motion)
    return contact_motions


def _centre_of(*laws: ContactLaw) -> Float[np.ndarray, "2 1"]:
    """Centre of the ring of the first annular law, m."""
    law = next(law for law in laws if isinstance(law, Annular))
    return np.array([[law.center_y_m], [law.center_z_m]])


def _radial_law(law: ContactLaw) -> DeadZone:
    """Law of an annular contact over the distance from its centre: one stop, at the radial clearance."""
    return DeadZone(
        lower_clearance_m=np.inf,
        upper_clearance_m=law.clearance_m,
        stiffness_n_per_m=law.stiffness_n_per_m,
        damping_n_s_per_m=law.damping_n_s_per_m,
        wear_m_per_s=law.wear_m_per_s,
        pulls=False,
    )


def open_viewer(path: Path) -> None:
    """Open the file in the rerun viewer without waiting for it."""
    subprocess.Popen([sys.executable, "-m", "rerun", str(path)], start_new_session=True)


def station_words(rig: Rig, station: Station) -> str:
    """Name of a station for a title: of a mass its body, else with the position."""
    return station.body if rig.body(station.body).is_mass else f"{station.body} at {station.position_m:g} m"


def _belongs_to(truth: Recording, recording: Recording) -> bool:
    contact_names = [
        [contact.name for contact in compared_recording.rig.contacts] for compared_recording in (truth, recording)
    ]
    has_truth = {"displacement", "relative_displacement", "contact_force"} <= set(truth.signals)
    return has_truth and truth.samples == recording.samples and contact_names[0] == contact_names[1]


def _series_scalars(recording: Recording, truth: Recording | None) -> int:
    """Number of values in the time series at full rate."""
    rig = recording.rig
    channel_count = len(rig.forces) + sum(len(sensors_of(rig, name)) for name in plotted_quantities(rig))
    return recording.samples * (channel_count + len(rig.contacts) * (1 if truth is None else 2))


def _send_series(
    stream: rr.RecordingStream, recording: Recording, contact_motions: Sequence[ContactMotion], stride: int
) -> None:
    time_s = recording.signals["force"].time_s
    force_names = recording.rig.force_names
    colours = shades(FORCE, len(force_names))
    send_lines(stream, "exciting_force", time_s[::stride], recording.forces_n[:, ::stride], force_names, colours)
    send_legend(stream, "exciting_force", list(zip(force_names, colours, strict=True)))
    legend: list[tuple[str, Colour]] = []
    for contact_motion, colour in zip(contact_motions, shades(FORCE, len(contact_motions)), strict=True):
        if contact_motion.force_n is not None:
            contact_name, plotted_samples = contact_motion.contact.name, contact_motion.plotted_samples
            plotted_time_s = contact_motion.time_s[plotted_samples]
            force_n = contact_motion.force_n[None, plotted_samples]
            send_lines(
                stream, entity("contact_force", contact_name), plotted_time_s, force_n, [contact_name], (colour,)
            )
            legend.append((contact_name, colour))
    send_legend(stream, "contact_force", legend)
    for quantity in plotted_quantities(recording.rig):
        signals = recording.signals[quantity]
        for body in recording.rig.bodies:
            channel_stations = [
                (i, station)
                for i, station in enumerate(signals.channels.stations)
                if station is not None and station.body == body.name
            ]
            values = signals.values[[i for i, _ in channel_stations], ::stride]
            station_names = [f"{s.position_m:g} m{'' if s.direction == 'y' else ', z'}" for _, s in channel_stations]
            entity_path = entity(quantity, body.name)
            colours = shades(SENSOR, len(station_names))
            send_lines(stream, entity_path, time_s[::stride], values, station_names, colours)
            send_legend(stream, entity_path, list(zip(station_names, colours, strict=True)))
