import pytest

from tests.campaigns import cost
from tests.campaigns.cost import Costs


def test_the_exponent_is_that_of_the_power_law():
    series = [Costs(size, {"square": 3e-4 * size**2, "root": 2.0 * size**0.5}) for size in (10.0, 20.0, 80.0)]
    assert cost._exponent(series, "square") == pytest.approx(2.0)
    assert cost._exponent(series, "root") == pytest.approx(0.5)


@pytest.mark.study
def test_every_step_is_timed_printed_and_drawn(tmp_path, capsys):
    cost.cost_table(tmp_path, cost.Plan(series={"length of the record, s": (12.0, 16.0)}, runs=1, block_s=1.0))
    printed = capsys.readouterr().out
    steps = (
        "plant",
        "reading",
        "kinematics",
        "contacts, separated and fitted",
        "surface of an",
        "NIFO of an equation",
        "one FFT",
    )
    assert all(step in printed for step in (*steps, "12", "16", "exponent"))
    assert (tmp_path / "cost.png").stat().st_size > 10_000
