"""Both rigs beside the measured motion: the right one predicts it, the wrong one does not, and the file shows that."""

import numpy as np
import pytest
from msgspec.structs import replace

from rig.effects import effect_named
from rig.errors import RigError
from rig.model.description import Station, to_json
from rig.recording import read, read_truth, truth_path
from rig.simulation.excitation import BandLimitedGaussian
from rig.simulation.plants import modal
from rig.simulation.prediction import modal as modal_predictor
from rig.simulation.record import record
from rig.simulation.reference import Sdof
from rig.viewer.deflection import Deflection, deflection
from rig.viewer.gap import read_corrected_rig
from rig.viewer.palette import BELIEVED, FOUND, MACHINE
from rig.viewer.prediction import predicted_motion
from rig.viewer.prediction_view import summary_text
from rig.viewer.viewing import write_rrd
from tests.rig.viewer.test_viewing import column, series, static

MASS = Station("mass")


@pytest.fixture(scope="module")
def changed(tmp_path_factory):
    """A mass whose clearance is 1.3 times the believed one: recording, truth, and the rig as it is."""
    believed, path = Sdof().rig(), tmp_path_factory.mktemp("changed") / "r.mcap"
    true = effect_named("contact_clearance:factor=1.3").applied_to(believed)
    force = BandLimitedGaussian(rms_n=0.5, low_hz=0.5, high_hz=15.0)
    settings = {"plant": modal.simulate, "duration_s": 6.0, "step_s": 2.0**-13, "progress": lambda _: None}
    record(believed, force, path=path, actual=true, **settings)
    return read(path), read_truth(truth_path(path)), true


def coasting(rig, _forces_n, _starts, samples, _stations, states):
    """Predictor of bodies on which nothing acts: they keep their velocity."""
    displacement_m, velocity = states[:, 0, :, None], states[:, 1, :, None]
    time_s = np.arange(samples) / rig.sample_rate_hz
    return np.stack([displacement_m + velocity * time_s, velocity + 0 * time_s], axis=1)


def test_each_window_continues_from_the_measured_displacement_and_velocity(changed):
    """Of x = a sin(w t), the tangent at the start of a window errs by a known amount."""
    recording, _, true = changed
    amplitude_m, omega = 1e-3, 2 * np.pi * 3.0
    time_s = np.arange(recording.samples) / recording.rig.sample_rate_hz
    motion = Deflection(recording.rig, (MASS,), amplitude_m * np.sin(omega * time_s)[None], is_approximate=False)
    predicted = predicted_motion(recording, motion, true, coasting, 0.125)
    window = predicted.samples_per_window
    assert window / recording.rig.sample_rate_hz == pytest.approx(0.125)
    start_s = time_s[::window].repeat(window)[: predicted.measured_m.shape[1]]
    since_s = time_s[: start_s.size] - start_s
    tangent_m = amplitude_m * (np.sin(omega * start_s) + omega * np.cos(omega * start_s) * since_s)
    np.testing.assert_allclose(predicted.believed_m[0], tangent_m, atol=2e-3 * amplitude_m)
    np.testing.assert_allclose(predicted.errors_m(predicted.measured_m), 0)


def test_the_rig_as_it_is_predicts_the_motion_and_the_believed_one_does_not(changed):
    recording, truth, true = changed
    predicted = predicted_motion(recording, deflection(recording, truth), true, modal_predictor)
    believed, corrected = (
        np.median(predicted.window_errors_m(x)) for x in (predicted.believed_m, predicted.corrected_m)
    )
    assert corrected < 0.02 * np.std(predicted.measured_m)
    assert believed > 10 * corrected
    assert f"corrected {1e3 * corrected:.2g} mm" in summary_text(predicted, 0.2)


def test_the_file_holds_the_three_motions_in_the_colours_of_their_meaning(changed, tmp_path):
    recording, truth, true = changed
    predicted = predicted_motion(recording, deflection(recording, truth), true, modal_predictor)
    write_rrd(recording, truth, tmp_path / "r.rrd", prediction=predicted)
    for name, values_m, colour in (
        ("0_measured", predicted.measured_m, MACHINE),
        ("1_believed", predicted.believed_m, BELIEVED),
        ("2_corrected", predicted.corrected_m, FOUND),
    ):
        place = f"/prediction/displacement/{name}"
        times, values = series(tmp_path / "r.rrd", place)
        breaks = np.isnan(values[0])
        np.testing.assert_array_equal(values[0, ~breaks], 1e3 * values_m[0])
        windows = values_m.shape[1] // predicted.samples_per_window
        assert np.count_nonzero(breaks) == (0 if name == "0_measured" else windows - 1)
        (drawn,) = static(tmp_path / "r.rrd", place, "SeriesLines:colors")
        assert (drawn >> 24, drawn >> 16 & 255, drawn >> 8 & 255) == colour
    times, strips = column(tmp_path / "r.rrd", "/model/prediction/believed/mass", "LineStrips3D:strips")
    assert times[-1] < predicted.samples.stop / recording.rig.sample_rate_hz
    _, centres = column(tmp_path / "r.rrd", "/model/mass", "Boxes3D:centers")
    _, at_start = (np.array(rows[0]) for rows in (strips, centres))
    middle = np.mean(strips[0][0][:4], axis=0)
    np.testing.assert_allclose(middle[[0, 2]], at_start[0][[0, 2]], atol=1e-6)  # the first window begins at the mass
    _, corrected_strips = column(tmp_path / "r.rrd", "/model/prediction/corrected/mass", "LineStrips3D:strips")
    assert corrected_strips[0][0][0][1] < middle[1] < at_start[0][1]  # nearer to the eye, so that all three show


def test_a_corrected_rig_is_read_beside_gap_json_if_it_is_of_this_rig(changed, tmp_path):
    recording, _, true = changed
    assert read_corrected_rig(tmp_path, recording.rig) is None
    (tmp_path / "rig.json").write_bytes(to_json(true))
    assert read_corrected_rig(tmp_path / "gap.json", recording.rig) == true
    other = replace(true, contacts=(replace(true.contacts[0], name="other"),))
    (tmp_path / "rig.json").write_bytes(to_json(other))
    with pytest.raises(RigError, match=r"rig.json: is of another rig"):
        read_corrected_rig(tmp_path, recording.rig)


def test_a_station_without_a_sensor_is_refused_and_a_short_record_has_no_prediction(changed):
    recording, truth, true = changed
    motion = deflection(recording, truth)
    with pytest.raises(RigError, match="no motion is recorded at 'nowhere'; give one of the sensors mass"):
        predicted_motion(recording, motion, true, coasting, station_name="nowhere")
    assert predicted_motion(recording, motion, true, coasting, station_name="stop").shown_station_row == 0
    assert predicted_motion(recording, motion, true, coasting, window_s=7.0) is None
