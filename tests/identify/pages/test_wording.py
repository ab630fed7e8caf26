"""Numbers in words: what is said holds for the number beside it."""

import re

import pytest

from identify.pages.wording import p_value_words, record_length_words


@pytest.mark.parametrize(
    "p_value", [0.0, 1e-14, 3e-9, 9e-4, 0.0099, 0.02, 0.0501, 0.19, 0.21, 0.5, 0.79, 0.8, 0.99, 1.0]
)
def test_the_words_beside_a_p_value_hold_for_it(p_value):
    number, _, words = p_value_words(p_value).partition(": ")
    if number.startswith("p < "):
        assert p_value < float(number[4:])
    else:
        assert float(number[4:]) == pytest.approx(p_value, rel=0.05)
    if match := re.fullmatch("chance alone would do this in fewer than 1 of ([0-9]+) machines", words):
        assert p_value < 1 / int(match[1]) < 20 * max(p_value, 1e-3)
    else:
        assert words == (
            "as likely by chance as not" if 0.2 <= p_value < 0.8 else "tolerances and noise mostly leave more"
        )
        assert p_value >= 0.2


@pytest.mark.parametrize("ratio", [1.01, 1.5, 1.51, 2.0, 2.3, 5.0, 9.7, 14.0, 99.0])
def test_a_longer_record_is_long_enough_and_not_much_longer(ratio):
    words = record_length_words(ratio).replace("half as long again", "1.5 times").replace("twice", "2 times")
    times = float(re.match("about ([0-9.]+) times", words)[1])
    assert 0.96 * ratio < times < 2 * ratio


@pytest.mark.parametrize("ratio", [None, 0.0, 0.9, 300.0, float("inf"), float("nan")])
def test_no_factor_is_said_that_is_unknown_or_cannot_be_done(ratio):
    assert record_length_words(ratio) == "longer"
