"""The form that the pages share, as a browser without a screen has it."""

import pytest

from identify.pages import page

PHONE_PX = 375


def written(path, html):
    page.write(
        path, title="A page", answer=page.Answer("green", "so", "It is."), sections=[("One", html)], foot_text=""
    )
    return path


def test_a_wide_table_and_a_long_word_need_no_sideways_scrolling(opened, tmp_path):
    wide = page.table([f"column {i}" for i in range(12)], [[f"{i:.12f}" for i in range(12)], ["word" * 40] * 12])
    browser_page = opened(written(tmp_path / "page.html", wide + page.list_html(["word" * 100])), PHONE_PX)
    assert (browser_page.scroll_px, browser_page.console) == (PHONE_PX, ())


@pytest.mark.parametrize(
    ("html", "found"),
    [
        (page.picture("broken", b"no picture"), lambda opened_page: opened_page.pictures_px == (0,)),
        ("<script>nowhere()</script>", lambda opened_page: "nowhere is not defined" in "".join(opened_page.console)),
        ("<script>console.error('odd')</script>", lambda opened_page: "odd" in "".join(opened_page.console)),
        ('<div style="width:900px">wide</div>', lambda opened_page: opened_page.scroll_px >= 900),
    ],
)
def test_what_is_wrong_with_a_page_is_seen(opened, tmp_path, html, found):
    """Else the tests of the pages could not fail."""
    assert found(opened(written(tmp_path / "page.html", html), PHONE_PX))


def test_plots_fit_the_paper_in_print(framed, tmp_path):
    """Plots keep their size on the screen, so that print has to make them smaller."""
    path, script = (
        written(tmp_path / "page.html", "a page"),
        (
            "const page = this.contentDocument; this.contentWindow.dispatchEvent(new Event('beforeprint'));"
            "const shrink = Number(page.body.style.getPropertyValue('--shrink'));"
            "this.title = JSON.stringify([page.querySelector('main').clientWidth, shrink])"
        ),
    )
    for width_px in (1200, PHONE_PX):
        (content_px, shrink), _ = framed(path.read_text(encoding="utf-8"), width_px, script)
        assert content_px * shrink == pytest.approx(min(content_px, page.PAPER_PX), abs=1)


@pytest.mark.parametrize(
    ("html", "found"),
    [
        (page.table(("a value, N", *["far"] * 40), [["12 ± 1"] * 41]) + page.picture("a figure", b""), []),
        ('<p style="color:#555">dark on dark</p>', ["color-contrast"]),
        ('<img src="">', ["image-alt"] * 2),
    ],
)
def test_what_a_reader_without_good_eyes_cannot_use_is_seen(inaccessible, tmp_path, html, found):
    assert [
        finding.partition(":")[0] for finding in inaccessible(written(tmp_path / "page.html", html), PHONE_PX)
    ] == found
