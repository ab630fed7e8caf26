"""The file for the viewer, read back: it holds the recording's values, moves as the stations do and is never half."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from msgspec.structs import replace as replace_struct
from rerun.chunk import RrdReader

import rig.viewer.stage
import rig.viewer.viewing
from rig.errors import RigError
from rig.model.contact_laws import penetration_m
from rig.recording import read, read_truth, truth_path
from rig.simulation.excitation import BandLimitedGaussian
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle, BarrelCradleAnnular, Sdof
from rig.viewer.axes import WIDTH
from rig.viewer.deflection import deflection
from rig.viewer.drawing import entity, legend_of
from rig.viewer.identified import IdentifiedContacts, identified_laws, read_identified
from rig.viewer.stage import stage
from rig.viewer.viewing import write_rrd


def recorded(directory, machine, force, duration_s):
    path = directory / "r.mcap"
    step_s = 2.0**-14 if machine.name == "barrel_cradle" else 2.0**-13
    record(
        machine, force, plant=modal.simulate, duration_s=duration_s, step_s=step_s, path=path, progress=lambda _: None
    )
    return read(path), read_truth(truth_path(path))


@pytest.fixture(scope="module")
def beams(tmp_path_factory):
    force = BandLimitedGaussian(rms_n=14.0, low_hz=4.0, high_hz=100.0)
    return recorded(tmp_path_factory.mktemp("beams"), BarrelCradle(stations=4).rig(), force, 4.0)


@pytest.fixture(scope="module")
def mass(tmp_path_factory):
    force = BandLimitedGaussian(rms_n=0.5, low_hz=0.5, high_hz=15.0)
    return recorded(tmp_path_factory.mktemp("mass"), Sdof().rig(), force, 8.0)


def column(path, place, component):
    """Times in seconds and values of a component of an entity, in the order of time."""
    reader = RrdReader(path)
    times, values = [], []
    for chunk in reader.stream(store=reader.recordings()[0]).filter(content=place):
        batch = chunk.to_record_batch()
        if component in batch.schema.names and "sim_time" in batch.schema.names:
            times.extend(batch["sim_time"].cast("int64").to_pylist())
            values.extend(batch[component].to_pylist())
    order = np.argsort(times, kind="stable")
    return np.array(times)[order] / 1e9, [values[i] for i in order]


def static(path, place, component):
    """The one value of a component of an entity that does not change."""
    reader = RrdReader(path)
    for chunk in reader.stream(store=reader.recordings()[0]).filter(content=place):
        batch = chunk.to_record_batch()
        if component in batch.schema.names and "sim_time" not in batch.schema.names:
            return batch[component].to_pylist()[0]
    return None


def series(path, place):
    times, values = column(path, place, "Scalars:scalars")
    return times, np.array(values).T


@pytest.mark.parametrize("fixture", ["beams", "mass"])
def test_the_series_are_those_of_the_recording_and_its_truth(fixture, request, tmp_path):
    recording, truth = request.getfixturevalue(fixture)
    write_rrd(recording, truth, tmp_path / "r.rrd")
    time_s = recording.signals["force"].time_s
    for row, contact in enumerate(recording.rig.contacts):
        times, values = series(tmp_path / "r.rrd", entity("relative_displacement", contact.name, "value"))
        np.testing.assert_allclose(times, time_s, atol=1e-9)
        np.testing.assert_array_equal(values[0], 1e3 * truth.signals["relative_displacement"].values[row])
        _, walls = series(tmp_path / "r.rrd", entity("relative_displacement", contact.name, "0_true"))
        assert walls[0] == pytest.approx(1e3 * contact.law.upper_clearance_m)
        assert walls[1] == pytest.approx(-1e3 * contact.law.lower_clearance_m)
        _, force = series(tmp_path / "r.rrd", entity("contact_force", contact.name))
        np.testing.assert_array_equal(force[0], truth.signals["contact_force"].values[row])
    _, exciting = series(tmp_path / "r.rrd", "exciting_force")
    np.testing.assert_array_equal(exciting[0], recording.force_n)
    assert [p.name for p in tmp_path.iterdir()] == ["r.rrd"]


def test_a_rig_in_space_moves_in_both_directions_and_its_contacts_as_orbits_in_rings(tmp_path):
    """On the stage z is y of the rig, and the depth less z of it."""
    settings = BarrelCradleAnnular(sensors="acceleration")
    centred = settings.rig()
    contacts = tuple(
        replace_struct(c, law=replace_struct(c.law, center_y_m=2e-4, center_z_m=-3e-4)) for c in centred.contacts
    )
    recording, truth = recorded(tmp_path, replace_struct(centred, contacts=contacts), settings.force(), 2.0)
    centre_m = np.array([[2e-4], [-3e-4]])
    write_rrd(recording, truth, tmp_path / "r.rrd", magnification=10.0)
    true_eta_m, true_n = (truth.signals[name].values for name in ("relative_displacement", "contact_force"))
    _, distance = series(tmp_path / "r.rrd", entity("relative_displacement", "contact_2", "value"))
    about_m = true_eta_m[2:] - centre_m
    np.testing.assert_allclose(distance[0], 1e3 * np.hypot(*about_m))
    _, force_n = series(tmp_path / "r.rrd", entity("contact_force", "contact_2"))
    np.testing.assert_allclose(force_n[0], np.hypot(*true_n[2:]))
    legend_path = legend_of(entity("relative_displacement", "contact_2"))
    assert static(tmp_path / "r.rrd", f"{legend_path}/1", "Points2D:labels") == ["true 2"]  # a distance has no sign
    histogram_edges_mm = static(tmp_path / "r.rrd", entity("histogram", "contact_2"), "BarChart:abscissa")
    assert min(histogram_edges_mm[0]["buffer"]) == 0
    _, readings = column(tmp_path / "r.rrd", entity("close_up", "contact_2", "reading"), "Points2D:labels")
    assert not any("+" in reading[0] for reading in readings)
    times, points = column(tmp_path / "r.rrd", entity("close_up", "contact_2", "point"), "Points2D:positions")
    frames = np.round(times * recording.rig.sample_rate_hz).astype(int)
    np.testing.assert_allclose([p[0] for p in points], 1e3 * (about_m[::-1] * [[1], [-1]])[:, frames].T, rtol=1e-5)
    _, strips = column(tmp_path / "r.rrd", entity("model", "barrel"), "LineStrips3D:strips")
    tip_y, tip_z = (truth[f"barrel_1000mm{z}"].values[frames] for z in ("", "_z"))
    tips = np.array([s[0][-1] for s in strips])
    np.testing.assert_allclose(tips[:, 2], 10 * tip_y, atol=1e-5)
    np.testing.assert_allclose(tips[:, 1] - tips[0, 1], -10 * (tip_z - tip_z[0]), atol=1e-5)
    _, rings = column(tmp_path / "r.rrd", entity("model", "contact_2"), "LineStrips3D:strips")
    ring = np.array(rings[0][0])[:-1]  # the last point is at its carrier
    middle = (ring.max(axis=0) + ring.min(axis=0)) / 2
    np.testing.assert_allclose(np.linalg.norm(ring - middle, axis=1), 0.02, rtol=1e-3)
    carrier = [truth[f"cradle_1000mm{z}"].values[0] for z in ("_z", "")]
    depth_m = stage(deflection(recording, truth), 4096.0, 10.0).depth_m("barrel")
    np.testing.assert_allclose(middle[1:], [depth_m - 10 * (carrier[0] - 3e-4), 10 * (carrier[1] + 2e-4)], atol=1e-4)
    _, events = column(tmp_path / "r.rrd", entity("events", "contact_2"), "TextLog:text")
    assert "from y towards z" in " ".join(e[0] for e in events)


def test_a_close_up_is_in_true_scale_and_says_when_the_contact_is_closed(mass, tmp_path):
    recording, truth = mass
    write_rrd(recording, truth, tmp_path / "r.rrd", magnification=7.0)
    times, points = column(tmp_path / "r.rrd", entity("close_up", "stop", "point"), "Points2D:positions")
    _, readings = column(tmp_path / "r.rrd", entity("close_up", "stop", "reading"), "Points2D:labels")
    frames = np.round(times * recording.rig.sample_rate_hz).astype(int)
    eta = truth.signals["relative_displacement"].values[0, frames]
    np.testing.assert_allclose([p[0][1] for p in points], -1e3 * eta, rtol=1e-6)  # the view's y points downwards
    closed = penetration_m(eta, 1e-3, 1e-3) != 0
    assert closed.any()
    assert not closed.all()
    assert [r[0].endswith("closed") for r in readings] == list(closed)


def test_without_truth_the_displacement_sensors_are_shown(beams, tmp_path):
    recording, _ = beams
    write_rrd(recording, None, tmp_path / "r.rrd")
    sensed = recording.signals["displacement"]
    rows = dict(zip(sensed.channels.stations, sensed.values, strict=True))
    for contact in recording.rig.contacts:
        _, values = series(tmp_path / "r.rrd", entity("relative_displacement", contact.name, "value"))
        np.testing.assert_allclose(values[0], 1e3 * (rows[contact.at] - rows[contact.against]), atol=1e-12)
        assert series(tmp_path / "r.rrd", entity("contact_force", contact.name))[0].size == 0


def with_sensors(recording, chosen):
    machine = replace_struct(recording.rig, sensors=tuple(s for s in recording.rig.sensors if chosen(s)))
    return replace(recording, rig=machine)


def only_accelerometers(recording):
    poor = with_sensors(recording, lambda s: s.quantity == "acceleration")
    return replace(poor, signals={k: recording.signals[k] for k in ("force", "acceleration")})


def test_accelerometers_alone_give_the_motion_above_one_hertz(beams, tmp_path):
    recording, truth = beams
    poor = only_accelerometers(recording)
    write_rrd(poor, None, tmp_path / "r.rrd")
    motion, true_motion = deflection(poor, None), deflection(recording, truth)
    assert motion.is_approximate
    assert not true_motion.is_approximate
    station = recording.rig.contacts[0].against
    middle = slice(recording.samples // 3, 2 * recording.samples // 3)
    error = (motion.displacement_at(station) - true_motion.displacement_at(station))[middle]
    slow = np.fft.rfft(true_motion.displacement_at(station))
    slow[np.fft.rfftfreq(recording.samples, 1 / recording.rig.sample_rate_hz) >= 2.0] = 0
    lacking = np.fft.irfft(slow, recording.samples)[middle]
    assert np.std(error) < 2 * np.std(lacking) + 0.02 * np.std(true_motion.displacement_at(station)[middle])


def test_the_beams_pass_through_their_stations_and_between_them_follow_the_modes(beams):
    recording, _ = beams
    machine = recording.rig
    body, rows = machine.bodies[1], [i for i, s in enumerate(machine.sensors) if s.station.body == "barrel"]
    places = np.unique([machine.sensors[i].station.position_m for i in rows])
    coordinates = np.array([[1e-3, -2e-3, 5e-4, 3e-4]])  # modal coordinates, as many as there are stations
    motion = deflection(recording, None)
    deformed = replace(
        motion,
        stations=tuple(type(machine.force_at)("barrel", float(x)) for x in places),
        displacement_m=(coordinates @ body.shapes(places, 4).T).T,
    )
    x = np.linspace(0, body.length_m, 23)
    np.testing.assert_allclose(
        deformed.body_displacement_m(body, x)[:, 0], (coordinates @ body.shapes(x, 4).T)[0], atol=1e-12
    )


def test_the_bodies_lie_over_each_other_at_their_contacts_and_move_magnified(beams, tmp_path):
    recording, truth = beams
    scene = stage(deflection(recording, truth), recording.rig.sample_rate_hz, 3.0)
    for contact in recording.rig.contacts:
        station, against = scene.point(contact.at), scene.point(contact.against)
        np.testing.assert_allclose(station[:, 0], against[:, 0])
        eta = truth.signals["relative_displacement"].values[recording.rig.contacts.index(contact), scene.frame_samples]
        np.testing.assert_allclose(station[:, 2] - against[:, 2], 3.0 * eta, atol=1e-12)
        jaws = scene.fork(contact, contact.law)[..., 2]
        outside = (station[:, 2] > jaws[:, 0]) | (station[:, 2] < jaws[:, 3])
        np.testing.assert_array_equal(outside, contact.law.penetration_m(eta) != 0)
    write_rrd(recording, truth, tmp_path / "r.rrd", magnification=3.0)
    _, strips = column(tmp_path / "r.rrd", entity("model", "barrel"), "LineStrips3D:strips")
    tip = [frame[0][-1][2] for frame in strips]
    np.testing.assert_allclose(tip, scene.point(recording.rig.force_at)[:, 2], rtol=1e-5, atol=1e-7)


def test_the_chosen_magnification_is_round_and_keeps_the_largest_deflection_in_the_view(beams):
    recording, truth = beams
    scene = stage(deflection(recording, truth), recording.rig.sample_rate_hz, None)
    largest = np.abs(truth.signals["displacement"].values).max()
    leading = scene.magnification / 10.0 ** np.floor(np.log10(scene.magnification))
    assert round(leading, 9) in {1, 2, 5}
    assert scene.extent_m / 4 / 2.5 < scene.magnification * largest <= scene.extent_m / 4


def test_a_long_recording_is_thinned_out_but_not_near_contacts(mass, tmp_path, monkeypatch):
    recording, truth = mass
    curves = 4  # force, acceleration, two of the contact
    monkeypatch.setattr(rig.viewer.viewing, "MAX_PLOTTED_VALUES", curves * recording.samples // 8)
    monkeypatch.setattr(rig.viewer.stage, "FRAME_RATE_RANGE_HZ", (32.0, 32.0))
    write_rrd(recording, truth, tmp_path / "r.rrd")
    rate = recording.rig.sample_rate_hz
    times, force = series(tmp_path / "r.rrd", "exciting_force")
    np.testing.assert_array_equal(force[0], recording.force_n[::8])
    times, values = series(tmp_path / "r.rrd", entity("contact_force", "stop"))
    samples, true_force_n = np.round(times * rate).astype(int), truth.signals["contact_force"].values[0]
    np.testing.assert_array_equal(values[0], true_force_n[samples])
    closed = np.flatnonzero(recording.rig.contacts[0].law.penetration_m(relative(truth)))
    assert closed.size
    assert set(closed) <= set(samples)
    assert set(range(0, recording.samples, 8)) <= set(samples)
    assert samples.size < recording.samples


def relative(truth):
    return truth.signals["relative_displacement"].values[0]


def test_every_closing_and_opening_is_an_event(mass, tmp_path):
    recording, truth = mass
    write_rrd(recording, truth, tmp_path / "r.rrd")
    times, words = column(tmp_path / "r.rrd", entity("events", "stop"), "TextLog:text")
    depth = recording.rig.contacts[0].law.penetration_m(relative(truth))
    changes = np.flatnonzero(np.diff((depth != 0).astype(int))) + 1
    assert changes.size
    np.testing.assert_array_equal(np.round(times * recording.rig.sample_rate_hz).astype(int), changes)
    for sample, (said,) in zip(changes, words, strict=True):
        time, _, word = said.partition(" s: ")
        assert float(time) == pytest.approx(sample / recording.rig.sample_rate_hz, abs=1e-4)
        if depth[sample] > 0:
            assert word == "stop closes at its upper stop"
        elif depth[sample] < 0:
            assert word == "stop closes at its lower stop"
        else:
            assert word.startswith("stop opens after ")


def test_the_phase_plot_grows_over_the_truth(mass, tmp_path):
    """Frame by frame, each line begins where the last one ended; together they hold every closed sample."""
    recording, truth = mass
    write_rrd(recording, truth, tmp_path / "r.rrd")
    times, strips = column(tmp_path / "r.rrd", entity("phase", "stop", "seen"), "LineStrips2D:strips")
    lines = [np.array(row[0]) for row in strips]
    for before, after in pairwise(lines):
        np.testing.assert_array_equal(before[-1], after[0])
    across = np.sort(np.concatenate([line[:-1, 0] for line in lines]))
    depth = recording.rig.contacts[0].law.penetration_m(relative(truth))
    last = round(times[-1] * recording.rig.sample_rate_hz)
    closed = depth[:last] != 0
    reach_m = 1.2 * np.abs(relative(truth)).max()
    expected = WIDTH * (relative(truth)[:last][closed] / reach_m + 1) / 2
    next_one = np.clip(np.searchsorted(across, expected), 1, across.size - 1)
    distance = np.minimum(np.abs(across[next_one] - expected), np.abs(across[next_one - 1] - expected))
    assert distance.max() < 1e-6


def test_identified_walls_stand_where_contact_json_says(mass, tmp_path):
    recording, truth = mass
    file = tmp_path / "contact.json"
    value = {"value": 1.2e-3, "standard_error": 1e-6}
    contact = {"name": "stop", "clearance_m": value, "stiffness_n_per_m": value, "damping_n_s_per_m": {"value": -1.0}}
    file.write_text(json.dumps({"rig": "sdof", "contacts": [contact]}))
    write_rrd(recording, truth, tmp_path / "r.rrd", identified_contacts=read_identified(file, recording.rig, 8.0))
    _, walls = series(tmp_path / "r.rrd", entity("relative_displacement", "stop", "1_identified"))
    np.testing.assert_allclose(walls[:, 0], [1.2, -1.2])
    widths = [
        static(tmp_path / "r.rrd", entity("relative_displacement", "stop", name), "SeriesLines:widths")[0]
        for name in ("0_true", "1_identified")
    ]
    assert widths[0] > widths[1]  # drawn first, it shows beside what is drawn over it
    legend_path = legend_of(entity("relative_displacement", "stop"))
    words = [static(tmp_path / "r.rrd", f"{legend_path}/{row}", "Points2D:labels") for row in range(1, 3)]
    assert words == [["true \u00b11"], ["identified \u00b11.2"]]


def with_law(machine, **changes):
    (contact,) = machine.contacts
    return replace_struct(machine, contacts=(replace_struct(contact, law=replace_struct(contact.law, **changes)),))


def with_clearances(machine, factor):
    law = machine.contacts[0].law
    return with_law(machine, **{f: factor * getattr(law, f) for f in ("lower_clearance_m", "upper_clearance_m")})


@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_the_figures_of_every_wall_stand_beyond_it_in_a_column_of_their_own(mass, tmp_path, scale):
    """The figures neither cross nor label another wall, however small the play is in the view."""
    recording, truth = mass
    rigs = {
        "true": with_clearances(truth.rig, scale),
        "believed": with_clearances(recording.rig, 1.3 * scale),
        "identified": with_clearances(recording.rig, 1.43 * scale),
    }
    laws = {name: machine.contacts[0].law for name, machine in rigs.items()}
    recording, truth = replace(recording, rig=rigs["believed"]), replace(truth, rig=rigs["true"])
    identified = IdentifiedContacts({"stop": laws["identified"]})
    write_rrd(recording, truth, tmp_path / "r.rrd", identified_contacts=identified)
    columns = []
    for name, law in laws.items():
        for side, level, out in (("upper", -law.upper_clearance_m, -1), ("lower", law.lower_clearance_m, 1)):
            place = entity("close_up", "stop", name, side)
            (words,), ((x, y),) = (static(tmp_path / "r.rrd", place, f"Points2D:{c}") for c in ("labels", "positions"))
            assert words == f"{name} {-1e3 * level:+.4g} mm"
            assert out * (y - 1e3 * level) > -1e-6
        columns.append(x)
    reach = max(columns) / 1.85
    assert np.diff(sorted(columns)).min() > reach


def test_the_bars_of_the_histogram_span_their_bins_and_leave_the_quiet_second_out(mass, tmp_path):
    recording, truth = mass
    write_rrd(recording, truth, tmp_path / "r.rrd")
    drawn = [static(tmp_path / "r.rrd", entity("histogram", "stop"), f"BarChart:{n}") for n in ("abscissa", "values")]
    left_mm, share = (np.array(batch[0]["buffer"]) for batch in drawn)
    width = np.array(static(tmp_path / "r.rrd", entity("histogram", "stop"), "BarChart:widths"))
    np.testing.assert_allclose(left_mm[1:], (left_mm + width)[:-1], atol=1e-6)
    eta_mm = 1e3 * relative(truth)[round(truth.rig.sample_rate_hz) :]
    assert share.sum() == pytest.approx(100)
    for k in np.flatnonzero(share):
        least, most = ((eta_mm > left_mm[k] - e) & (eta_mm < left_mm[k] + width[k] + e) for e in (-1e-6, 1e-6))
        assert 100 * least.mean() - 1 <= share[k] <= 100 * most.mean() + 1  # the first motion is slow


CURVES = "time_s,stop relative displacement m,stop contact force N\n"


def test_without_truth_the_identified_curves_are_shown_as_long_as_they_go(mass, tmp_path):
    """Every fourth sample of the truth is exported, without the first and the last two seconds."""
    recording, truth = mass
    poor, rate = only_accelerometers(recording), round(recording.rig.sample_rate_hz)
    rows = np.arange(2 * rate, 6 * rate, 4)
    eta, force = (truth.signals[name].values[0] for name in ("relative_displacement", "contact_force"))
    table = np.stack([rows / rate, eta[rows], force[rows]], axis=1)
    value = {"value": 0.9e-3}
    contact = {"name": "stop", "clearance_m": value, "stiffness_n_per_m": value, "damping_n_s_per_m": value}
    (tmp_path / "contact.json").write_text(json.dumps({"contacts": [contact]}))
    np.savetxt(tmp_path / "motion.csv", table, delimiter=",", header=CURVES.strip(), comments="")
    write_rrd(poor, None, tmp_path / "r.rrd", identified_contacts=read_identified(tmp_path, poor.rig, 8.0))
    for names, expected in (
        (("relative_displacement", "stop", "value"), 1e3 * eta),
        (("contact_force", "stop"), force),
    ):
        times, values = series(tmp_path / "r.rrd", entity(*names))
        assert times.min() >= 2.0
        assert times.max() <= rows[-1] / rate
        samples = np.round(times * rate).astype(int)
        exported = np.isin(samples, rows)
        np.testing.assert_allclose(values[0, exported], expected[samples[exported]], atol=1e-12)
    times, words = column(tmp_path / "r.rrd", entity("events", "stop"), "TextLog:text")
    closed = np.abs(eta[2 * rate : rows[-1]]) > 0.9e-3
    assert abs(len(words) - np.count_nonzero(np.diff(closed.astype(int)))) <= 2  # splines may miss a graze


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time_s,other relative displacement m\n0,1\n1,2\n", "has no column 'stop relative displacement m'"),
        ("", "is no table"),
        (CURVES + "0,1,2\n1,x,2\n", "is no table"),
        (CURVES + "0,1,2\n1,1\n", "is no table"),
        (CURVES + "0,1,2\n", "too few rows"),
        (CURVES + "0,1,2\n0.01,1,2\n", "too few rows"),
        (CURVES + "0,1,2\n1,nan,2\n", "no number"),
        (CURVES + "0,1,2\n1,1e300,2\n", "no number"),
        (CURVES + "1,1,2\n0,1,2\n", "does not grow"),
        (CURVES + "0,1,2\n1e-320,2,1\n1,1,2\n", "does not grow"),
        (CURVES + "0,1,2\n9,1,2\n", "goes to 9 s, the recording to 8 s"),
        ("\xff", "is no table"),
    ],
)
@pytest.mark.parametrize("name", ["motion.csv", "motion.parquet"])
def test_curves_that_cannot_be_used_are_named(mass, tmp_path, name, text, said):
    (tmp_path / "contact.json").write_text('{"contacts": []}')
    (tmp_path / name).write_bytes(text.encode("latin-1"))
    with pytest.raises(RigError, match=f"{name}: .*{said if name.endswith('csv') else 'is no table'}"):
        read_identified(tmp_path, mass[0].rig, 8.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "cannot be opened"),
        ("{", "is no contact.json"),
        ('{"schema_version": 3}', "schema_version is 3, and this program reads 1 to 2"),
        ('{"contacts": [{"name": "stop"}]}', "is no contact.json"),
        ("\xff", "is no contact.json"),
        pytest.param('{"a": ' + 20_000 * "[", "is no contact.json", id="nested"),
        (
            '{"contacts": [{"name": "other", "clearance_m": {"value": 1}, "stiffness_n_per_m": {"value": 1}, '
            '"damping_n_s_per_m": {"value": 1}}]}',
            "has a contact 'other', the rig has stop",
        ),
        (
            '{"contacts": [{"name": "stop", "clearance_m": {"value": -1}, "stiffness_n_per_m": {"value": 1}, '
            '"damping_n_s_per_m": {"value": 1}}]}',
            "lower_clearance_m is -1",
        ),
    ],
)
def test_a_file_that_is_no_contact_json_is_named(mass, tmp_path, text, said):
    path = tmp_path / "contact.json"
    if text is not None:
        path.write_bytes(text.encode("latin-1"))
    with pytest.raises(RigError, match=f"contact.json: .*{said}"):
        identified_laws(path, mass[0].rig)


def test_walls_are_the_true_ones_and_what_was_believed_is_drawn_too(mass, tmp_path):
    recording, truth = mass
    (contact,) = recording.rig.contacts
    wider = with_law(recording.rig, upper_clearance_m=2 * contact.law.upper_clearance_m)
    write_rrd(replace(recording, rig=wider), truth, tmp_path / "r.rrd")
    for name, expected in (("0_true", contact.law), ("1_believed", wider.contacts[0].law)):
        _, walls = series(tmp_path / "r.rrd", entity("relative_displacement", "stop", name))
        np.testing.assert_allclose(walls[:, 0], [1e3 * expected.upper_clearance_m, -1e3 * expected.lower_clearance_m])


def test_what_cannot_be_shown_is_said_in_one_sentence_and_leaves_nothing(beams, mass, tmp_path):
    recording, _ = beams
    barrel_only = with_sensors(only_accelerometers(recording), lambda s: s.station.body == "barrel")
    with pytest.raises(RigError, match="'cradle' has no sensor"):
        write_rrd(barrel_only, None, tmp_path / "r.rrd")
    with pytest.raises(RigError, match="take it away"):
        write_rrd(recording, mass[1], tmp_path / "r.rrd")
    with pytest.raises(RigError, match="magnification is 0"):
        write_rrd(recording, None, tmp_path / "r.rrd", magnification=0.0)
    with pytest.raises(RigError, match="cannot be written"):
        write_rrd(recording, None, tmp_path / "nowhere" / "r.rrd")
    assert not list(tmp_path.iterdir())


def test_a_stop_that_is_not_there_has_no_wall(mass, tmp_path):
    recording, truth = (replace(x, rig=with_law(x.rig, lower_clearance_m=np.inf)) for x in mass)
    write_rrd(recording, truth, tmp_path / "r.rrd")
    _, walls = series(tmp_path / "r.rrd", entity("relative_displacement", "stop", "0_true"))
    assert len(walls) == 1
    assert walls[0] == pytest.approx(1e3 * truth.rig.contacts[0].law.upper_clearance_m)
    _, jaws = column(tmp_path / "r.rrd", entity("model", "stop"), "LineStrips3D:strips")
    assert np.all(np.isfinite(np.array(jaws[0], dtype=float)))
