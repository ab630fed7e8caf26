"""Spectra of forces and channels in the viewer: amplitude spectral densities over frequency."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import rerun as rr
from jaxtyping import Float
from scipy.signal import welch

from rig.model.description import UNITS
from rig.model.quantities import printed_unit
from rig.model.sensing import quantities_of
from rig.recording import Recording
from rig.viewer.axes import Axes
from rig.viewer.drawing import entity, pixels, send_static
from rig.viewer.palette import FORCE, SENSOR, shades

BLOCK_S = 4.0
"""Length of the averaged blocks, s (lines 0.25 Hz apart); at most a quarter of the record."""
MAX_DECADE_COUNT = 6
"""Largest range of densities that is shown."""


@dataclass(frozen=True)
class ShownSpectra:
    """Signals of one unit by name, whose spectra are drawn in one view."""

    origin: str
    title: str
    unit: str
    signals: Mapping[str, Float[np.ndarray, " samples"]]


def spectra_of(
    recording: Recording, contact_forces_n: Mapping[str, Float[np.ndarray, " samples"]]
) -> list[ShownSpectra]:
    """Groups of signals for spectra: exciting forces, known contact forces, and every body's channels by quantity."""
    exciting_forces_n = dict(zip(recording.rig.force_names, recording.forces_n, strict=True))
    shown_spectra_list = [
        ShownSpectra(entity("spectra", "force"), "Exciting force", "N", exciting_forces_n),
        ShownSpectra(entity("spectra", "contact_force"), "Contact force", "N", contact_forces_n),
    ]
    for quantity in quantities_of(recording.rig):
        quantity_signals = recording.signals[quantity]
        for body in recording.rig.bodies:
            stations_and_samples = zip(quantity_signals.channels.stations, quantity_signals.values, strict=True)
            samples_by_name = {
                f"{station.position_m:g} m": samples
                for station, samples in stations_and_samples
                if station is not None and station.body == body.name
            }
            origin, unit = entity("spectra", quantity, body.name), printed_unit(UNITS[quantity])
            shown_spectra_list.append(ShownSpectra(origin, f"{body.name}: {quantity}", unit, samples_by_name))
    return [shown_spectra for shown_spectra in shown_spectra_list if shown_spectra.signals]


def send_spectra(stream: rr.RecordingStream, spectra: ShownSpectra, sample_rate_hz: float) -> None:
    """Send the amplitude density over frequency of every signal, on logarithmic axes."""
    frequencies_hz, density_rows = amplitude_densities(np.array([*spectra.signals.values()]), sample_rate_hz)
    highest_density = 10.0 ** np.ceil(np.log10(density_rows.max() or 1.0))
    lowest_density = 10.0 ** np.floor(np.log10(max(density_rows.min(), highest_density / 10.0**MAX_DECADE_COUNT)))
    density_name = f"amplitude density, {spectra.unit}/√Hz"
    axes = Axes(
        (frequencies_hz[0], frequencies_hz[-1]),
        (min(lowest_density, highest_density / 10), highest_density),
        "frequency, Hz",
        density_name,
        True,
    )
    colour_by_name = dict(
        zip(spectra.signals, shades(FORCE if spectra.unit == "N" else SENSOR, len(density_rows)), strict=True)
    )
    axes.send(stream, spectra.origin, colour_by_name)
    spectrum_lines = [axes.points(frequencies_hz, signal_density) for signal_density in density_rows]
    line_strips = rr.LineStrips2D(
        spectrum_lines, colors=[*colour_by_name.values()], radii=pixels(0.75), draw_order=50.0
    )
    send_static(stream, f"{spectra.origin}/lines", line_strips)


def amplitude_densities(
    values: Float[np.ndarray, "rows samples"], sample_rate_hz: float
) -> tuple[Float[np.ndarray, " lines"], Float[np.ndarray, "rows lines"]]:
    """Frequencies above zero (Hz), and one-sided amplitude spectral densities, unit/sqrt(Hz).

    Square root of Welch's power spectral density, with Hann blocks that overlap by half, each without its mean.
    """
    block_samples = max(2, min(round(BLOCK_S * sample_rate_hz), values.shape[1] // 4))
    frequencies_hz, power_densities = welch(values, sample_rate_hz, nperseg=block_samples)
    return frequencies_hz[1:], np.sqrt(power_densities[:, 1:])
