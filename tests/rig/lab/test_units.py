"""Units of a laboratory against their definitions."""

import pytest

from rig.errors import RigError
from rig.lab.units import FACTORS, si_factor


@pytest.mark.parametrize(
    ("quantity", "unit", "reference", "ratio"),
    [
        ("acceleration", "g", "m/s^2", 9.80665),
        ("acceleration", "m/s²", "mm / s**2", 1e3),
        ("displacement", "µm", "nm", 1e3),
        ("displacement", "in", "mm", 25.4),
        ("velocity", "m/s", "mm/s", 1e3),
        ("force", "lbf", "N", 0.45359237 * 9.80665),
        ("time", "min", "ms", 60e3),
        ("strain", "ustrain", "m/m", 1e-6),
        ("strain", "µm/m", "mm/m", 1e-3),
    ],
)
def test_units_are_what_they_are_defined_to_be(quantity, unit, reference, ratio):
    assert si_factor(quantity, unit) / si_factor(quantity, reference) == pytest.approx(ratio, rel=1e-15)


def test_every_unit_of_another_quantity_is_refused():
    for quantity, units in FACTORS.items():
        for foreign_unit in {u for q, factors in FACTORS.items() if q != quantity for u in factors} - set(units):
            with pytest.raises(RigError, match=f"is no unit of {quantity}"):
                si_factor(quantity, foreign_unit)
