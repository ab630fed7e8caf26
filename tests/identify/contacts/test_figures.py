"""The figures, as matplotlib holds them: what they show and how their axes are named."""

import re
from io import BytesIO

import numpy as np
import pytest
from matplotlib.image import imread

from identify.contacts import figures as drawing
from identify.contacts import identify_contact
from rig.model.contact_laws import penetration_m
from rig.recording import read
from rig.simulation.reference import BarrelCradle, Sdof

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
    found = identify_contact(read(simulate(settings, folder / "r.mcap")), use="displacement")
    marks = {c.name: (c.law.clearance_m, c.law.stiffness_n_per_m) for c in found.rig.contacts}
    made = drawing.drawn(found, marks, "as described")
    return found, {name: one.figure for name, one in made.items()}, {name: one.png for name, one in made.items()}


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
        along = {a.get_xlabel() for a in figure.axes} - {""}
        up = {a.get_ylabel() for a in figure.axes} - {""}
        assert along, name
        assert up, name
        for label in along | up:
            assert UNIT.search(label), f"{name}: {label}"


def test_every_panel_shows_something_finite(drawn):
    _, figures, _ = drawn
    for name, figure in figures.items():
        assert data_axes(figure), name
        for axes in data_axes(figure):
            for line in lines(axes):
                shown = np.asarray(line.get_ydata(), dtype=float)
                assert np.isfinite(shown).any() or not shown.size, f"{name}: {line.get_label()}"


def test_the_marks_stand_where_they_were_given(drawn):
    found, figures, _ = drawn
    for axes, contact in zip(data_axes(figures["section"]), found.rig.contacts, strict=True):
        given = sorted(float(x.get_xdata()[0]) for x in lines(axes) if x.get_linestyle() == ":")
        assert given == pytest.approx([-1e3 * contact.law.clearance_m, 1e3 * contact.law.clearance_m])
    assert "stops, as described" in texts(figures["section"])
    assert "as described" in texts(figures["stiffness"])


def test_the_section_shows_the_dead_zone(drawn):
    found, figures, _ = drawn
    for j, axes in enumerate(data_axes(figures["section"])):
        (fit,) = lines(axes, "dead zone as fitted")
        stops = found.surface.stops[j]
        expected = found.surface.stiffness_n_per_m[j] * penetration_m(
            1e-3 * np.asarray(fit.get_xdata()), stops.lower_m, stops.upper_m
        )
        left = np.asarray(fit.get_ydata()) - expected
        assert np.std(left) < 0.02 * np.std(expected)  # the fit is low-passed, so its knees are round


def test_the_frf_and_the_stiffness_are_those_found(drawn):
    found, figures, _ = drawn
    (weak,) = lines(figures["frf"].axes[0], "NIFO, weak form")
    np.testing.assert_array_equal(weak.get_xdata(), found.weak.frequency_hz)
    np.testing.assert_allclose(weak.get_ydata(), found.weak.equation.shape_at_force**2 * np.abs(found.weak.frf))
    (shown,) = lines(figures["stiffness"].axes[0], "weak form")
    np.testing.assert_allclose(shown.get_ydata(), found.weak.stiffness_n_per_m[0].real)


def test_the_time_axis_lies_within_the_record(drawn):
    found, figures, _ = drawn
    duration_s = found.motion.force_n.size / found.motion.sample_rate_hz
    for name in ("outputs", "histogram"):
        axes = figures[name].axes[0]
        (measured,) = lines(axes, "as measured, with contact" if name == "outputs" else "η")
        time_s = np.asarray(measured.get_xdata())
        assert 0 <= time_s[0] < time_s[-1] <= duration_s
        if name == "histogram":
            rows = np.round(time_s * found.motion.sample_rate_hz).astype(int)
            np.testing.assert_allclose(measured.get_ydata(), 1e3 * found.eta_m[0][rows])
