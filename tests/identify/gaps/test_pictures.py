"""The pictures of a diagnosis, as matplotlib holds them: what they show, how their axes are named, what overlaps."""

import re
from io import BytesIO
from itertools import combinations

import numpy as np
import pytest
from matplotlib.axis import Tick
from matplotlib.image import imread
from matplotlib.text import Text
from msgspec.structs import replace

from identify.gaps.decision_table import Verdict
from identify.gaps.page.pictures import pictures
from identify.gaps.results import Attribution

NAMED = re.compile(r"(, (%|m|mm|s|Hz|N|m/s)|per mm|/Hz|N|natural logarithm\)|over its limit)$")


def drawn(gap):
    """The pictures by name as PNG and as figures."""
    made = pictures(gap)
    return {name: one.png for name, one in made.items()}, {name: one.figure for name, one in made.items()}


@pytest.fixture(scope="module")
def made(drawn_diagnosis):
    return drawn_diagnosis, *drawn(drawn_diagnosis)


def widths(axes):
    return [bar.get_width() for bar in axes.patches]


def test_every_picture_is_a_png_that_shows_something(made):
    _, files, _ = made
    for name, content in files.items():
        image = imread(BytesIO(content))
        assert min(image.shape[:2]) > 150, name
        assert np.ptp(image[..., :3]) > 0.5, name


def test_every_section_has_pictures(made):
    gap, files, _ = made
    sections = {"large", "decided", "why", "where"} | ({"unknown"} if gap.unknown else set())
    sections |= {"prediction"} if gap.rollout and gap.rollout.example else set()
    sections |= {"next"} if gap.next_experiments else set()
    assert {name.split("_")[0] for name in files} == sections
    assert sum(name.startswith("where_surface") for name in files) == len(gap.attribution.surface)


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
    (axes,) = figures["why_probability"].axes
    drawn = [100 * p for p in (*(c.probability for c in gap.causes), gap.probability_nothing, gap.probability_unknown)]
    assert widths(axes) == pytest.approx(drawn)
    assert sum(widths(axes)) == pytest.approx(100)
    names = [label.get_text() for label in axes.get_yticklabels()]
    nominal = {Verdict.CONSISTENT: "rig.json as it is", Verdict.CANNOT_TELL: "no effect that stands out"}
    assert names[-2] == nominal.get(gap.verdict, "no effect of the library")
    assert names[-1].startswith("something unmeasured")


def test_further_causes_are_one_bar(gaps):
    gap = gaps["pair"]
    many = tuple(replace(gap.causes[0], probability=0.09) for _ in range(9))
    _, figures = drawn(replace(gap, causes=many, probability_nothing=0.1, probability_unknown=0.09))
    (axes,) = figures["why_probability"].axes
    assert widths(axes) == pytest.approx([9.0] * 6 + [27.0, 10.0, 9.0])


def test_what_a_cause_closes_is_drawn_with_its_interval(made):
    gap, _, figures = made
    (axes,) = figures["why_closes"].axes
    assert widths(axes) == pytest.approx([100 * max(c.explained, 0) for c in gap.causes])
    for line, cause in zip(axes.get_lines(), gap.causes, strict=True):
        assert list(line.get_xdata()) == pytest.approx([100 * max(end, 0) for end in cause.interval_95])


def test_bands_are_drawn_beside_null_simulations_and_no_limit_of_the_whole_motion(made):
    gap, _, figures = made
    (axes,) = figures["large_bands"].axes
    steps = {patch.get_label(): patch.get_data() for patch in axes.patches}
    fields = {"the model as it is": "before", "95 % limit of tolerances and noise": "usual"}
    if gap.causes[0].interval_95[0] > 0.01:
        fields["with the likeliest cause"] = "after"
    assert set(steps) == set(fields)
    for label, field in fields.items():
        np.testing.assert_allclose(steps[label].values, [100 * getattr(b, field) for b in gap.bands])
        np.testing.assert_allclose(steps[label].edges[:-1], [b.low_hz for b in gap.bands])
    assert not axes.get_lines()
    assert axes.get_yscale() == "log"


def test_the_force_over_the_motion_is_the_right_way_round(gaps):
    gap = gaps["unexplained"]
    gap = replace(gap, unknown=replace(gap.unknown, law_name=""))
    seen = gap.unknown.over_motion
    _, figures = drawn(gap)
    mesh = figures["unknown_motion"].axes[0].collections[0]
    np.testing.assert_allclose(np.ma.filled(mesh.get_array(), 0.0), np.array(seen.force_n).T)
    np.testing.assert_allclose(mesh.get_coordinates()[0, :, 0], 1e3 * np.array(seen.displacement_m))
    dots = figures["unknown_law"].axes[0].collections[0].get_offsets()
    expected = 11.0 * np.tanh(np.asarray(dots)[:, 0] / 2.6)
    np.testing.assert_allclose(np.asarray(dots)[:, 1], expected, atol=1e-9)


def test_shares_stand_at_the_stations(made):
    gap, _, figures = made
    for axes, stations in zip(figures["where_positions"].axes, gap.attribution.positions_m.values(), strict=True):
        middles = [bar.get_x() + bar.get_width() / 2 for bar in axes.patches]
        assert middles == pytest.approx(list(stations))
        assert [bar.get_height() for bar in axes.patches] == pytest.approx([100 * s for s in stations.values()])


def test_the_surface_is_drawn_the_right_way_round(made):
    gap, _, figures = made
    for j, surface in enumerate(gap.attribution.surface.values(), 1):
        mesh = figures[f"where_surface_{j}"].axes[0].collections[0]
        shown = np.ma.filled(mesh.get_array(), 0.0) / 100  # rows: velocity
        np.testing.assert_allclose(np.nan_to_num(shown), np.array(surface.share).T)
        corners = mesh.get_coordinates()
        np.testing.assert_allclose(corners[0, :, 0], 1e3 * np.array(surface.eta_m))
        np.testing.assert_allclose(corners[:, 0, 1], surface.rate_m_per_s)


def test_the_predictions_are_drawn_beside_the_measured_motion(gaps):
    example = gaps["explained"].rollout.example
    _, figures = drawn(gaps["explained"])
    (axes,) = figures["prediction_motion"].axes
    for line, values in zip(axes.get_lines(), (example.measured, example.nominal, example.corrected), strict=True):
        np.testing.assert_array_equal(line.get_xdata(), example.time_s)
        np.testing.assert_array_equal(line.get_ydata(), values)
    assert axes.get_ylabel() == f"velocity of {example.sensor}, m/s"


def test_any_name_can_be_drawn(gaps):
    gap = gaps["consistent"]
    odd = {"$\\frac": 0.5, "<b>" * 30: 0.3, "a_$x$": 0.2}
    _, figures = drawn(replace(gap, attribution=replace(gap.attribution, channels=odd)))
    labels = [t.get_text() for t in figures["where_channels"].axes[0].get_yticklabels()]
    assert (labels[0], labels[2]) == ("$\\frac", "a_$x$")


def test_what_is_missing_is_left_out(gaps):
    gap = gaps["consistent"]
    evidence = replace(gap.evidence, quantities=())
    assert not pictures(replace(gap, evidence=evidence, attribution=Attribution(), bands=(), causes=()))
