"""The pictures of a diagnosis, as matplotlib holds them: what they show, how their axes are named, what overlaps."""

import re
from io import BytesIO
from itertools import combinations

import numpy as np
import pytest
from matplotlib.axis import Tick
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Text
from msgspec.structs import replace

from identify.gap.pictures import pictures

NAMED = re.compile(r"(, (%|m|mm|s|Hz|m/s)|per mm|Hz|N|nulls leave 1\)|whitened residual)$")


def drawn(gap):
    """The pictures by name as PNG and as figures."""
    figures = []
    save = Figure.savefig

    def kept(figure, file, **options):
        save(figure, file, **options)
        figures.append(figure)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", kept)
        made = pictures(gap)
    return made, dict(zip(made, figures, strict=True))


@pytest.fixture(scope="module")
def made(diagnosis):
    return diagnosis, *drawn(diagnosis)


def widths(axes):
    return [bar.get_width() for bar in axes.patches]


def test_every_picture_is_a_png_that_shows_something(made):
    _, files, _ = made
    for name, content in files.items():
        image = imread(BytesIO(content))
        assert min(image.shape[:2]) > 200, name
        assert np.ptp(image[..., :3]) > 0.5, name


def test_every_section_has_pictures(made):
    gap, files, _ = made
    assert {name.split("_")[0] for name in files} == {"is", "where", "far"} | ({"why"} if gap.causes else set())
    for kind, count in (("where_surface", len(gap.where.surface)), ("far_curve", len(gap.curves))):
        assert sum(name.startswith(kind) for name in files) == count


def test_every_axis_that_counts_is_named_with_its_unit(made):
    _, _, figures = made
    for name, figure in figures.items():
        labels = {text for a in figure.axes for text in (a.get_xlabel(), a.get_ylabel()) if text}
        assert labels, name
        for label in labels:
            assert NAMED.search(label), f"{name}: {label}"


def test_no_text_lies_upon_another_nor_leaves_the_picture(made):
    _, _, figures = made
    for name, figure in figures.items():
        figure.draw_without_rendering()
        boxes = [(t.get_text(), t.get_window_extent()) for t in shown_texts(figure) if t.get_text().strip()]
        whole = figure.bbox.padded(1.0)
        for text, box in boxes:
            assert whole.x0 <= box.x0 < box.x1 <= whole.x1, f"{name}: {text}"
            assert whole.y0 <= box.y0 < box.y1 <= whole.y1, f"{name}: {text}"
        slanted = [(a, b) for a, b in boxes if "to" not in a]  # the corners of slanted texts may share a box
        for (one, a), (other, b) in combinations(slanted, 2):
            assert not a.padded(-1).overlaps(b.padded(-1)), f"{name}: {one!r} and {other!r}"


def shown_texts(figure):
    """The texts of a figure that are drawn: of ticks only those within their axis."""
    labels = {text for tick in figure.findobj(Tick) for text in (tick.label1, tick.label2)}
    texts = [t for t in figure.findobj(Text) if t not in labels]
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        low, high = sorted(axis.get_view_interval())
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
            if low <= tick.get_loc() <= high:
                texts += [tick.label1, tick.label2]
    return [t for t in texts if t.get_visible()]


def test_probabilities_are_drawn_and_sum_to_one(made):
    gap, _, figures = made
    if not gap.causes:
        assert "why_probability" not in figures
        return
    (axes,) = figures["why_probability"].axes
    assert widths(axes)[:-1] == pytest.approx([100 * c.probability for c in gap.causes])
    assert sum(widths(axes)) == pytest.approx(100)
    assert axes.get_yticklabels()[-1].get_text() == "none of these"


def test_what_causes_leave_is_drawn_beside_the_floor_at_one(made):
    gap, _, figures = made
    for name in {"is_size", "why_left"} & set(figures):
        (axes,) = figures[name].axes
        assert axes.get_xscale() == "log"
        assert list(axes.get_lines()[0].get_xdata()) == [1.0, 1.0]
        ends = [bar.get_x() + bar.get_width() for bar in axes.patches]
        assert ends[0] == pytest.approx(gap.size)
        if name == "why_left":
            assert ends[1:] == pytest.approx([c.left for c in gap.causes])


def test_shares_stand_at_the_stations(made):
    gap, _, figures = made
    for axes, stations in zip(figures["where_positions"].axes, gap.where.positions_m.values(), strict=True):
        middles = [bar.get_x() + bar.get_width() / 2 for bar in axes.patches]
        assert middles == pytest.approx([float(at) for at in stations])
        assert [bar.get_height() for bar in axes.patches] == pytest.approx([100 * s for s in stations.values()])


def test_the_surface_is_drawn_the_right_way_round(made):
    gap, _, figures = made
    for j, surface in enumerate(gap.where.surface.values(), 1):
        mesh = figures[f"where_surface_{j}"].axes[0].collections[0]
        shown = np.ma.filled(mesh.get_array(), 0.0) / 100  # rows: velocity
        np.testing.assert_allclose(np.nan_to_num(shown), np.array(surface.share).T)
        corners = mesh.get_coordinates()
        np.testing.assert_allclose(corners[0, :, 0], 1e3 * np.array(surface.eta_m))
        np.testing.assert_allclose(corners[:, 0, 1], surface.rate_m_per_s)


def test_curves_are_those_given(made):
    gap, _, figures = made
    for j, curve in enumerate(gap.curves, 1):
        figure = figures[f"far_curve_{j}"]
        (axes,) = figure.axes
        for line, values in zip(axes.get_lines(), (curve.measured, curve.believed, curve.corrected), strict=True):
            np.testing.assert_array_equal(line.get_ydata(), values)
        assert (axes.get_yscale() == "log") == curve.logarithmic
        assert len(figure.legends[0].get_texts()) == 3


def test_any_name_can_be_drawn(gaps):
    gap = gaps["null"]
    odd = {"$\\frac": 0.5, "<b>" * 30: 0.3, "a_$x$": 0.2}
    _, figures = drawn(replace(gap, where=replace(gap.where, channels=odd)))
    labels = [t.get_text() for t in figures["where_channels"].axes[0].get_yticklabels()]
    assert (labels[0], labels[2]) == ("$\\frac", "a_$x$")


def test_what_is_missing_is_left_out(gaps):
    gap = gaps["null"]
    where = replace(
        gap.where, channels={}, modal_equations={}, positions_m={}, band_hz=(), contact_state={}, time_s=(), surface={}
    )
    assert set(pictures(replace(gap, where=replace(where, parts={}), curves=()))) == {"is_size", "far_closure"}
