"""Figures as matplotlib holds them, their content and axes; and the tables of their curves in every format."""

import csv
import re
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from matplotlib.image import imread
from pyarrow import parquet
from scipy.io import loadmat

from identify.contacts import figures as drawing
from identify.contacts import identify_contact
from identify.contacts.drawn_results import curves
from identify.pages.tables import WRITERS, save_tables
from rig.model.contact_laws import penetration_m
from rig.recording import read
from rig.simulation.reference import BarrelCradle, Sdof
from tests.fuzz.readers import sound_recording

NAMES = {"outputs", "surface", "section", "separated", "histogram", "stiffness", "frf"}
UNIT = re.compile(r",\s(1e-3 √kg m|kg m²/Hz|N/√kg|s²|1/mm|m/s|N/m|m/N|m/s²/N|s|Hz|mm|N|%|degrees)$")


@pytest.fixture(scope="module", params=["one mass", "barrel and cradle"])
def drawn(request, simulate, tmp_path_factory):
    """The identification of a short record, its figures by name, and their PNG files."""
    folder = tmp_path_factory.mktemp("plots")
    settings = (
        Sdof(duration_s=30.0, step_s=2.0**-12)
        if request.param == "one mass"
        else BarrelCradle(duration_s=10.0, sensors="displacement", sample_rate_hz=2048.0)
    )
    identification = identify_contact(read(simulate(settings, folder / "r.mcap")), use="displacement")
    marks = {c.name: (c.law.clearance_m, c.law.stiffness_n_per_m) for c in identification.rig.contacts}
    made = drawing.contact_figures(identification, marks, "as described")
    return (
        identification,
        {name: image.figure for name, image in made.items()},
        {name: image.png for name, image in made.items()},
    )


def data_axes(figure):
    return [a for a in figure.axes if a.has_data()]


def texts(figure):
    """Every text of a figure, legends included."""
    return [t.get_text() for t in figure.findobj(lambda artist: hasattr(artist, "get_text")) if t.get_text()]


def lines(axes, label=None):
    return [x for x in axes.get_lines() if label is None or x.get_label() == label]


def test_every_figure_is_written(drawn):
    _, figures, files = drawn
    assert set(figures) == set(files) == NAMES
    for png in files.values():
        image = imread(BytesIO(png))
        assert min(image.shape[:2]) > 300
        assert np.ptp(image[..., :3]) > 0.5  # not blank


def test_every_axis_is_named_with_its_unit(drawn):
    _, figures, _ = drawn
    for name, figure in figures.items():
        x_labels = {a.get_xlabel() for a in figure.axes} - {""}
        y_labels = {a.get_ylabel() for a in figure.axes} - {""}
        assert x_labels, name
        assert y_labels, name
        for label in x_labels | y_labels:
            assert UNIT.search(label), f"{name}: {label}"


def test_every_panel_shows_something_finite(drawn):
    _, figures, _ = drawn
    for name, figure in figures.items():
        assert data_axes(figure), name
        for axes in data_axes(figure):
            for line in lines(axes):
                values = np.asarray(line.get_ydata(), dtype=float)
                assert np.isfinite(values).any() or not values.size, f"{name}: {line.get_label()}"


def test_the_marks_stand_where_they_were_given(drawn):
    identification, figures, _ = drawn
    for axes, contact in zip(data_axes(figures["section"]), identification.rig.contacts, strict=True):
        mark_mm = sorted(float(x.get_xdata()[0]) for x in lines(axes) if x.get_linestyle() == ":")
        assert mark_mm == pytest.approx([-1e3 * contact.law.clearance_m, 1e3 * contact.law.clearance_m])
    assert "stops, as described" in texts(figures["section"])
    assert "as described" in texts(figures["stiffness"])


def test_the_section_shows_the_dead_zone(drawn):
    identification, figures, _ = drawn
    for j, axes in enumerate(data_axes(figures["section"])):
        (fit,) = lines(axes, "dead zone as fitted")
        stops = identification.surface.stops[j]
        expected = identification.surface.stiffness_n_per_m[j] * penetration_m(
            1e-3 * np.asarray(fit.get_xdata()), stops.lower_m, stops.upper_m
        )
        misfit = np.asarray(fit.get_ydata()) - expected
        assert np.std(misfit) < 0.02 * np.std(expected)  # the fit is low-passed, so its knees are round


def test_the_frf_and_the_stiffness_are_those_found(drawn):
    identification, figures, _ = drawn
    (weak,) = lines(figures["frf"].axes[0], "NIFO, weak form")
    np.testing.assert_array_equal(weak.get_xdata(), identification.weak_nifo.frequency_hz)
    np.testing.assert_allclose(
        weak.get_ydata(), identification.weak_nifo.equation.shape_at_force**2 * np.abs(identification.weak_nifo.frf)
    )
    (values,) = lines(figures["stiffness"].axes[0], "weak form")
    np.testing.assert_allclose(values.get_ydata(), identification.weak_nifo.stiffness_n_per_m[0].real)


def test_the_time_axis_lies_within_the_record(drawn):
    identification, figures, _ = drawn
    duration_s = identification.motion.force_n.size / identification.motion.sample_rate_hz
    for name in ("outputs", "histogram"):
        axes = figures[name].axes[0]
        (measured,) = lines(axes, "as measured, with contact" if name == "outputs" else "η")
        time_s = np.asarray(measured.get_xdata())
        assert 0 <= time_s[0] < time_s[-1] <= duration_s
        if name == "histogram":
            rows = np.round(time_s * identification.motion.sample_rate_hz).astype(int)
            np.testing.assert_allclose(measured.get_ydata(), 1e3 * identification.eta_m[0][rows])


@pytest.fixture(scope="module")
def identification():
    return identify_contact(sound_recording())


def read_back(path):
    if path.suffix == ".csv":
        names, *rows = csv.reader(path.read_text().splitlines())
        return names, np.array(rows, dtype=float).T
    if path.suffix == ".mat":
        file = loadmat(path, squeeze_me=True)
        return list(file["names"]), file["values"].T
    table = parquet.read_table(path)
    return table.column_names, np.array([column.to_numpy() for column in table.columns])


@pytest.mark.parametrize("form", WRITERS)
def test_every_curve_comes_back(identification, tmp_path, form):
    save_tables(curves(identification), tmp_path, form)
    for name, table in curves(identification).items():
        names, rows = read_back(tmp_path / f"{name}.{form}")
        assert names == list(table)
        np.testing.assert_array_equal(rows, [*table.values()])
    assert len(list(tmp_path.iterdir())) == 3


def test_times_are_those_of_the_record(identification):
    """Also where its beginning is left out, as it does not begin at rest."""
    later = replace(identification, motion=identification.motion.segment(slice(100, None)))
    for table in ("motion", "surface"):
        assert curves(later)[table]["time_s"][0] == 100 / identification.motion.sample_rate_hz


def test_the_curves_hold_the_law(identification):
    """Beyond the stop the force follows the stiffness, within there is none: by least squares over the motion alone."""
    motion, (contact,) = curves(identification)["motion"], identification.report.contacts
    eta, force = motion["stop relative displacement m"], motion["stop contact force N"]
    beyond = np.abs(eta) - contact.clearance_m.value
    deep = beyond > 0.3 * beyond.max()
    stiffness = np.sum(np.abs(force[deep]) * beyond[deep]) / np.sum(beyond[deep] ** 2)
    assert stiffness == pytest.approx(contact.stiffness_n_per_m.value, rel=0.1)  # the force is low-passed
    assert np.std(force[beyond < -0.3 * contact.clearance_m.value]) < 0.15 * np.std(force[deep])
    nifo = curves(identification)["nifo"]
    mean = nifo["weak form stop stiffness N/m real"].mean()
    assert mean == pytest.approx(identification.report.nifo[0].stiffness[0].mean_n_per_m.value, rel=1e-9)
