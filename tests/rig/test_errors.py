"""A sentence stays a sentence, whatever a file has in it."""

from rig.errors import MAX_SENTENCE_LENGTH, RigError


def test_what_is_quoted_of_a_file_becomes_one_printable_line():
    assert str(RigError("no column 'a\nb\x1b[31m'")) == r"no column 'a\nb\x1b[31m'"
    assert str(RigError("Müller, 20 °C")) == "Müller, 20 °C"


def test_a_sentence_without_end_loses_its_middle():
    sentence = str(RigError("begin " + "y" * 100_000 + " end"))
    assert len(sentence) < MAX_SENTENCE_LENGTH + 10
    assert sentence.startswith("begin yyy")
    assert sentence.endswith("yyy end")
