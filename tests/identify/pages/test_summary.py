"""A summary as text and as HTML."""

from html.parser import HTMLParser

from identify.pages.summary import Summary

SUMMARY = Summary(
    rows=({"contact": "a <b>", "k, N/m": "1 ± 2"}, {"contact": "stop", "k, N/m": "10000 ± 20"}),
    above=("not to be relied on",),
    below=("c: not told",),
)


class Texts(HTMLParser):
    """Texts of a page in their order."""

    def __init__(self):
        super().__init__()
        self.texts = []

    def handle_data(self, data):
        self.texts += [data] if data.strip() else []


def test_columns_are_aligned_between_the_sentences():
    assert SUMMARY.text.splitlines() == [
        "not to be relied on",
        "contact  k, N/m",
        "a <b>    1 ± 2",
        "stop     10000 ± 20",
        "c: not told",
    ]


def test_a_notebook_shows_the_same_words_whatever_signs_they_hold():
    shown = Texts()
    shown.feed(SUMMARY.html)
    assert shown.texts == [
        "not to be relied on", "contact", "k, N/m", "a <b>", "1 ± 2", "stop", "10000 ± 20", "c: not told",
    ]  # fmt: skip


def test_without_rows_there_is_no_table():
    assert Summary(above=("nothing",)).text == "nothing"
    assert "<table" not in Summary(above=("nothing",)).html
