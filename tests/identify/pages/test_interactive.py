"""Figures as plots in a browser: what is drawn, what stays a picture, and that nothing of a name is interpreted."""

import gzip
import json
import re
from base64 import b64decode

import numpy as np
import pytest

from identify.pages import page
from identify.pages.artists import MAX_POINTS
from identify.pages.interactive import interactive_html
from identify.pages.style import picture

PHONE_PX = 375


def models(html):
    """Every model of the first plot in the HTML, by its kind."""
    (item,) = re.findall(r"embed_item\((.*)\)</script>", html)
    by_type = {}

    def walk(value):
        if isinstance(value, dict):
            if value.get("type") == "object":
                by_type.setdefault(value["name"], []).append(value.get("attributes", {}))
            for each in value.values():
                walk(each)
        elif isinstance(value, list):
            for each in value:
                walk(each)

    walk(json.loads(item))
    return by_type


def curves(figure, name="a curve", count=50):
    for axes in figure.subplots(1, 2, sharey=True):
        axes.plot(np.linspace(0, 1, count), np.sin(np.arange(count)), label=name)
        axes.axvline(0.5, color="k", label="a mark")
        axes.set(xlabel="time, s", ylabel="force, N", title=name)


def everything(figure):
    left_axes, right = figure.subplots(1, 2)
    left_axes.hist(np.random.default_rng(1).standard_normal(500), bins=20)
    left_axes.axvspan(0, 1, alpha=0.2, label="a span")
    left_axes.stairs([1, 2, 3], [0, 1, 2, 3], label="steps", baseline=None)
    left_axes.errorbar([1, 2], [3, 4], [0.1, 0.2], fmt="o-", label="with errors", capsize=2)
    cells = right.hexbin(*np.random.default_rng(2).standard_normal((2, 2000)), C=np.arange(2000.0), gridsize=12)
    figure.colorbar(cells, label="force, N")


def test_curves_can_be_switched_and_panels_move_together():
    by_type = models(interactive_html(picture(curves).figure))
    assert [len(legend["items"]) for legend in by_type["Legend"]] == [2, 2]
    assert {legend["click_policy"] for legend in by_type["Legend"]} == {"hide"}
    assert len(by_type["Range1d"]) == 3  # one for both ordinates
    assert {"BoxZoomTool", "HoverTool", "ResetTool"} <= set(by_type)


def logarithmic(figure):
    for axes, least in zip(figure.subplots(1, 3), (1e-9, 1e-2, 0.5), strict=True):
        axes.semilogy([least, 1.0])
        axes.set_title("histogram of the relative displacement of contact_1")


def test_titles_fit_a_phone():
    by_type = models(interactive_html(picture(logarithmic).figure))
    titles = {title["text"]["attributes"]["text"] for title in by_type["Title"]}
    assert titles == {"histogram of the relative\ndisplacement of contact_1"}


def test_long_curves_keep_their_peaks():
    def draw(figure):
        values = np.zeros(50_000)
        values[12_345] = 7.0
        figure.subplots().plot(values)

    ((_, y),) = [line.get_data() for line in picture(draw).figure.axes[0].get_lines()]
    assert y.size == 50_000
    html = interactive_html(picture(draw).figure)
    assert len(html) < 20 * MAX_POINTS
    (source,) = models(html)["ColumnDataSource"]
    y_entry = dict(source["data"]["entries"])["y"]
    written = b64decode(y_entry["array"]["data"])
    y_values = np.frombuffer(
        gzip.decompress(written) if written.startswith(b"\x1f\x8b") else written, dtype=y_entry["dtype"]
    )
    assert y_values.size <= MAX_POINTS
    assert y_values.max() == 7.0


def named_bars(figure):
    axes = figure.subplots()
    bars = axes.barh([0, 1], [30.0, 70.0])
    axes.bar_label(bars, ["30.0", "70.0"], padding=4)
    axes.set_yticks([0, 1], ["added_mass", "<b>$$x$$"])
    axes.invert_yaxis()


def test_bars_have_their_names_and_labels():
    by_type = models(interactive_html(picture(named_bars).figure))
    overrides = [
        dict(axis["major_label_overrides"]["entries"])
        for axis in by_type["LinearAxis"]
        if axis.get("major_label_overrides")
    ]
    assert [{place: text["attributes"]["text"] for place, text in names.items()} for names in overrides] == [
        {0.0: "added_mass", 1.0: "<b>$$x$$"}
    ]
    assert [(label["x"], label["y"], label["text"]["attributes"]["text"]) for label in by_type["Label"]] == [
        (30.0, 0.0, "30.0"),
        (70.0, 1.0, "70.0"),
    ]


def test_cells_without_a_value_are_left_out():
    def draw(figure):
        axes = figure.subplots()
        values = np.array([[1.0, np.nan], [3.0, 4.0], [5.0, 6.0]])
        figure.colorbar(axes.pcolormesh([0.0, 1.0, 2.0], [0.0, 1.0, 2.0, 3.0], values), label="share, %")

    by_type = models(interactive_html(picture(draw).figure))
    (source,) = by_type["ColumnDataSource"]
    columns = dict(source["data"]["entries"])
    assert columns["value"] == [1.0, 3.0, 4.0, 5.0, 6.0]
    assert list(zip(columns["left"], columns["bottom"], strict=True)) == [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2)]
    assert by_type["ColorBar"][0]["title"] == "share, %"


@pytest.mark.parametrize(
    "draw",
    [
        lambda figure: figure.subplots().text(0.5, 0.5, "a text"),
        lambda figure: figure.text(0.5, 0.5, "a text"),
        lambda figure: figure.subplots().annotate("", (0, 0), (1, 1), arrowprops={"arrowstyle": "->"}),
        lambda figure: figure.subplots().pie([1, 2]),
        lambda figure: figure.supylabel("a label"),
    ],
)
def test_what_it_cannot_draw_stays_a_picture(draw):
    image = picture(draw)
    assert interactive_html(image.figure) == ""
    assert "<img" in page.figure("a", image, "said")


def test_a_browser_draws_them(opened, tmp_path):
    odd = "</script><b>$$x$$ <!--<script>"
    html = page.figure("a", picture(lambda figure: curves(figure, odd)), odd) + page.figure("b", picture(everything))
    html += page.figure("c", picture(logarithmic))
    page.write(tmp_path / "p.html", title=odd, answer=page.Answer("red", "", ""), sections=[("A", html)], foot_text="")
    browser_page = opened(tmp_path / "p.html", PHONE_PX)
    assert browser_page.console == ()
    assert browser_page.scroll_px == PHONE_PX
    assert len(browser_page.plots_px) == 3
    assert min(browser_page.plots_px) > 500  # panels one below the other
