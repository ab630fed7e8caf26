"""Motion of the believed and of the corrected rig beside the measured one, predicted anew from it in short windows.

Motion with contacts is chaotic: a model can be compared with the machine over some tenths of a second only. Each window
begins with the measured displacement and velocity of the stations; both rigs then continue under the measured force.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.signal import savgol_filter

from rig.errors import RigError
from rig.model.description import Rig, Station
from rig.model.layout import station_named
from rig.recording import Recording
from rig.recording.interfaces import Predict
from rig.viewer.deflection import TAPER_S, Deflection

WINDOW_S = 0.2
"""Shortest windows, s, which the horizon of gap.json may lengthen: less than two contacts show no difference."""
MAX_PREDICTED_S = 120.0
"""Longest part of a record that is predicted, s; it bounds memory and time."""
SMOOTHED_SAMPLES, POLYNOMIAL_ORDER = 9, 3
"""Samples and order of the polynomials whose derivative is the velocity: exact to a quarter of the sampling rate."""


@dataclass(frozen=True)
class PredictedMotion:
    """Displacements of both rigs at the stations, m, in windows one after another from first_sample on.

    shown_station_row is the row of the station whose displacement is plotted; a prediction that diverges is not finite.
    """

    stations: tuple[Station, ...]
    samples_per_window: int
    first_sample: int
    measured_m: Float[np.ndarray, "stations samples"]
    believed_m: Float[np.ndarray, "stations samples"]
    corrected_m: Float[np.ndarray, "stations samples"]
    shown_station_row: int

    @property
    def samples(self) -> slice:
        """Predicted samples of the record."""
        return slice(self.first_sample, self.first_sample + self.measured_m.shape[1])

    def errors_m(self, predicted_m: Float[np.ndarray, "stations samples"]) -> Float[np.ndarray, " samples"]:
        """Root mean square over the stations of predicted less measured displacement, m."""
        return np.asarray(np.sqrt(np.mean((predicted_m - self.measured_m) ** 2, axis=0)))

    def window_errors_m(self, predicted_m: Float[np.ndarray, "stations samples"]) -> Float[np.ndarray, " windows"]:
        """Root-mean-square error of all stations in each window, m; infinite for one that diverges."""
        squared_errors = self.errors_m(predicted_m).reshape(-1, self.samples_per_window) ** 2
        return np.nan_to_num(np.sqrt(squared_errors.mean(axis=1)), nan=np.inf)


def predicted_motion(
    recording: Recording,
    shown_motion: Deflection,
    corrected_rig: Rig,
    predict: Predict,
    window_s: float = WINDOW_S,
    station_name: str | None = None,
) -> PredictedMotion | None:
    """Predict the rig of the recording and the corrected one from the `shown_motion`.

    station_name is that of a sensor, contact or body; otherwise the station where the believed rig errs most is shown.
    None if the record is shorter than a window.

    Raises RigError if the name has no recorded station or a rig cannot be predicted.
    """
    rate_hz = recording.rig.sample_rate_hz
    requested_row = None if station_name is None else _station_row(recording.rig, shown_motion, station_name)
    samples_per_window = max(2, round(window_s * rate_hz))
    first_sample = round(TAPER_S * rate_hz) if shown_motion.is_approximate else 0
    end_sample = min(shown_motion.displacement_m.shape[1] - first_sample, round(MAX_PREDICTED_S * rate_hz))
    window_starts = np.arange(first_sample, end_sample - samples_per_window + 1, samples_per_window)
    if not window_starts.size:
        return None
    displacement_m = shown_motion.displacement_m
    velocity_m_per_s = savgol_filter(
        displacement_m, SMOOTHED_SAMPLES, POLYNOMIAL_ORDER, deriv=1, delta=1 / rate_hz, axis=1
    )
    states = np.stack([displacement_m[:, window_starts], velocity_m_per_s[:, window_starts]]).transpose(2, 0, 1)
    forces_n = recording.forces_n[:, : int(window_starts[-1]) + samples_per_window]
    believed_m, corrected_m = (
        _joined_windows(predict(rig, forces_n, window_starts, samples_per_window, shown_motion.stations, states)[:, 0])
        for rig in (recording.rig, corrected_rig)
    )
    measured_m = displacement_m[:, first_sample : first_sample + window_starts.size * samples_per_window]
    station_errors_m = np.nan_to_num(believed_m - measured_m).std(axis=1)
    shown_row = int(np.argmax(station_errors_m)) if requested_row is None else requested_row
    return PredictedMotion(
        shown_motion.stations, samples_per_window, first_sample, measured_m, believed_m, corrected_m, shown_row
    )


def _station_row(rig: Rig, motion: Deflection, place_name: str) -> int:
    station = station_named(rig, place_name)
    if station not in motion.stations:
        sensor_names = ", ".join(sorted({sensor.name for sensor in rig.sensors if sensor.station in motion.stations}))
        raise RigError(f"no motion is recorded at {place_name!r}; give one of the sensors {sensor_names}")
    return motion.stations.index(station)


def _joined_windows(windows: Float[np.ndarray, "windows stations times"]) -> Float[np.ndarray, "stations samples"]:
    return np.asarray(windows.transpose(1, 0, 2).reshape(windows.shape[1], -1))
