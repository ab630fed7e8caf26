"""Numbers in words: what is said holds for the number beside it."""

import re

import pytest

from identify.pages.wording import p_value_words, record_length_words


@pytest.mark.parametrize(
    ("p_value", "words"), [(0.0, "p < 1e-12"), (1e-300, "p < 1e-12"), (3e-9, "p = 3.0e-09"), (0.0501, "p = 0.050")]
)
def test_a_p_value_is_written_to_two_digits_above_one_floor(p_value, words):
    assert p_value_words(p_value) == words


@pytest.mark.parametrize("ratio", [1.01, 1.5, 1.51, 2.0, 2.3, 5.0, 9.7, 14.0, 99.0])
def test_a_longer_record_is_long_enough_and_not_much_longer(ratio):
    words = record_length_words(ratio).replace("half as long again", "1.5 times").replace("twice", "2 times")
    times = float(re.match("about ([0-9.]+) times", words)[1])
    assert 0.96 * ratio < times < 2 * ratio


@pytest.mark.parametrize("ratio", [None, 0.0, 0.9, 300.0, float("inf"), float("nan")])
def test_no_factor_is_said_that_is_unknown_or_cannot_be_done(ratio):
    assert record_length_words(ratio) == "longer"
