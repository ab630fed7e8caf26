"""The tables of READMEs are those of the code."""

import pytest

from tests.readme_tables import ROOT, TABLES, written


@pytest.mark.parametrize(("readme", "above", "rows"), TABLES, ids=[rows.__name__ for *_, rows in TABLES])
def test_a_readme_has_the_rows_that_the_code_gives(readme, above, rows):
    text = (ROOT / readme).read_text(encoding="utf-8")
    assert text.count(f"\n{above}\n") == 1
    assert text == written(text, above, rows), "run python -m tests.readme_tables"
