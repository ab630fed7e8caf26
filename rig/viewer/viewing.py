"""A recording as an .rrd file for the rerun viewer: the moving bodies, the contacts close up, and the time series."""

import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

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
from rig.viewer.contact_view import ContactMotion, LawSource, send_close_up, send_events, send_over_time
from rig.viewer.deflection import Deflection, deflection
from rig.viewer.drawing import entity, send_legend, send_lines
from rig.viewer.gap import ShownGap
from rig.viewer.gap_view import send_gap
from rig.viewer.identified import NOTHING_IDENTIFIED, IdentifiedContacts
from rig.viewer.model_view import send_colour_key, send_model
from rig.viewer.orbit import Orbit
from rig.viewer.palette import FORCE, MEANINGS, SENSOR, Colour, ColourMeaning, shades
from rig.viewer.phase_view import send_histogram, send_phase
from rig.viewer.prediction import PredictedMotion
from rig.viewer.prediction_view import send_prediction
from rig.viewer.spectra import send_spectra, spectra_of
from rig.viewer.stage import stage
from rig.viewer.web import LOOPBACK

MAX_PLOTTED_VALUES = 1_000_000
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
    if truth is not None and not _is_truth_of(truth, recording):
        raise RigError("the truth file has other samples, contacts or groups than the recording; take it away")
    shown_motion = deflection(recording, truth)
    scene = stage(shown_motion, recording.rig.sample_rate_hz, magnification)
    stride = max(1, -(-_series_value_count(recording, truth) // MAX_PLOTTED_VALUES))
    contact_motions = _contact_motions(recording, truth, shown_motion, identified_contacts, scene.frame_samples, stride)
    forces_n = {contact.contact.name: contact.force_n for contact in contact_motions if contact.force_n is not None}
    force_source: Literal["separated", "true"] = "separated" if truth is None else "true"
    layout = Layout(
        rig=recording.rig if truth is None else truth.rig,
        contact_force=force_source if forces_n else None,
        magnification=scene.magnification,
        is_approximate=shown_motion.is_approximate,
        stride=stride,
        centre_m=scene.centre_m,
        extent_m=scene.extent_m,
        frame_rate_hz=scene.frame_rate_hz,
        reach_by_contact_mm={contact.contact.name: contact.reach_mm for contact in contact_motions},
        spectra=tuple(spectra_of(recording, forces_n)),
        has_diagnosis=gap is not None,
        meanings=_shown_meanings(contact_motions, gap is not None, prediction is not None),
        masses_alone=scene.masses_alone,
        predicted_station_name=station_title(recording.rig, prediction.stations[prediction.shown_station_row])
        if prediction
        else None,
    )
    with rr.RecordingStream("rig") as stream, _drained_stream(stream) as encoded_stream:
        stream.send_blueprint(blueprint(layout))
        stream.send_recording_name(f"{recording.rig.name}, {recording.duration_s:g} s")
        send_colour_key(stream, layout.meanings)
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


def _shown_meanings(
    contact_motions: Sequence[ContactMotion], has_gap: bool, has_prediction: bool
) -> tuple[ColourMeaning, ...]:
    """Meanings of the colours that occur, in the order of the key."""
    sources = {source for motion in contact_motions for source in (motion.wall_source, *motion.overlaid_laws)}
    is_shown = {
        "believed": "believed" in sources or has_prediction,
        "found": "identified" in sources or has_prediction,
        "closed": bool(contact_motions),
        "gap": has_gap,
    }
    return tuple(meaning for name, meaning in MEANINGS.items() if is_shown.get(name, True))


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
    shown_motion: Deflection,
    identified_contacts: IdentifiedContacts,
    frame_samples: Int[np.ndarray, " frames"],
    stride: int,
) -> list[ContactMotion]:
    """Motion of every contact from the best source: the truth, else the identification, else the sensors."""
    time_s, curves = recording.signals["force"].time_s, identified_contacts.curves
    relative_eta_m, force_n, window = shown_motion.relative_displacement_m(), None, slice(0, time_s.size)
    if truth is not None:
        relative_eta_m, force_n = (truth.signals[name].values for name in ("relative_displacement", "contact_force"))
    elif curves is not None:
        window = curves.covered_samples(time_s)
        relative_eta_m, force_n = curves.interpolate(time_s[window])
    known_frame_samples = frame_samples[(frame_samples >= window.start) & (frame_samples < window.stop)] - window.start
    contact_motions, first_row = [], 0
    for index, nominal_contact in enumerate(recording.rig.contacts):
        is_annular = nominal_contact.law.spatial
        row_span = slice(first_row, first_row + 1 + is_annular)
        first_row = row_span.stop
        law_by_source: dict[LawSource, ContactLaw] = {} if truth is None else {"true": truth.rig.contacts[index].law}
        if nominal_contact.name in identified_contacts.laws:
            law_by_source["identified"] = identified_contacts.laws[nominal_contact.name]
        law_by_source["believed"] = nominal_contact.law
        wall_source = next(iter(law_by_source))
        eta_m, force_rows_n = relative_eta_m[row_span], None if force_n is None else force_n[row_span]
        orbit = Orbit(eta_m - _ring_centre_m(law_by_source[wall_source], nominal_contact.law)) if is_annular else None
        if is_annular:
            law_by_source = {source: _radial_law(law) for source, law in law_by_source.items()}
        wall_law = law_by_source.pop(wall_source)
        overlaid_laws: dict[LawSource, ContactLaw] = {
            source: law for source, law in law_by_source.items() if source == "identified" or law != wall_law
        }
        contact_motion = ContactMotion(
            contact=replace(nominal_contact, law=wall_law),
            wall_source=wall_source,
            overlaid_laws=overlaid_laws,
            time_s=time_s[window],
            until_s=float(time_s[window.stop]) if window.stop < time_s.size else None,
            eta_m=eta_m[0] if orbit is None else orbit.radius_m,
            force_n=None if force_rows_n is None else np.hypot(*force_rows_n) if is_annular else force_rows_n[0],
            frame_samples=known_frame_samples,
            stride=stride,
            is_identified=truth is None and curves is not None,
            orbit=orbit,
        )
        contact_motions.append(contact_motion)
    return contact_motions


def _ring_centre_m(*laws: ContactLaw) -> Float[np.ndarray, "2 1"]:
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
    """Open the file in the rerun viewer, which other computers cannot reach, without waiting for it."""
    subprocess.Popen([sys.executable, "-m", "rerun", "--bind", LOOPBACK, str(path)], start_new_session=True)


def station_title(rig: Rig, station: Station) -> str:
    """Name of a station for a title: of a mass its body, else with the position."""
    return station.body if rig.body(station.body).is_mass else f"{station.body} at {station.position_m:g} m"


def _is_truth_of(truth: Recording, recording: Recording) -> bool:
    true_contact_names, names = ([contact.name for contact in record.rig.contacts] for record in (truth, recording))
    has_truth = {"displacement", "relative_displacement", "contact_force"} <= set(truth.signals)
    return has_truth and truth.samples == recording.samples and true_contact_names == names


def _series_value_count(recording: Recording, truth: Recording | None) -> int:
    """Number of values in the time series at full rate."""
    rig = recording.rig
    channel_count = len(rig.forces) + sum(len(sensors_of(rig, quantity)) for quantity in plotted_quantities(rig))
    return recording.samples * (channel_count + len(rig.contacts) * (1 if truth is None else 2))


def _send_series(
    stream: rr.RecordingStream, recording: Recording, contact_motions: Sequence[ContactMotion], stride: int
) -> None:
    time_s = recording.signals["force"].time_s[::stride]

    def send_plot(path: str, values: Float[np.ndarray, "channels plotted"], names: Sequence[str], hue: Colour) -> None:
        colours = shades(hue, len(names))
        send_lines(stream, path, time_s, values, names, colours)
        send_legend(stream, path, list(zip(names, colours, strict=True)))

    send_plot("exciting_force", recording.forces_n[:, ::stride], recording.rig.force_names, FORCE)
    legend: list[tuple[str, Colour]] = []
    for motion, colour in zip(contact_motions, shades(FORCE, len(contact_motions)), strict=True):
        if motion.force_n is not None:
            name, shown_samples = motion.contact.name, motion.plotted_samples
            force_n = motion.force_n[None, shown_samples]
            send_lines(stream, entity("contact_force", name), motion.time_s[shown_samples], force_n, [name], (colour,))
            legend.append((name, colour))
    send_legend(stream, "contact_force", legend)
    for quantity in plotted_quantities(recording.rig):
        signals = recording.signals[quantity]
        for body in recording.rig.bodies:
            station_by_row = {row: s for row, s in enumerate(signals.channels.stations) if s and s.body == body.name}
            names = [f"{s.position_m:g} m{'' if s.direction == 'y' else ', z'}" for s in station_by_row.values()]
            send_plot(entity(quantity, body.name), signals.values[[*station_by_row], ::stride], names, SENSOR)
