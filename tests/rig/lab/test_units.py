"""Units of a laboratory against their definitions."""

import pytest

from rig.errors import RigError
from rig.lab.units import FACTORS, name_and_unit, quantity_of, si_factor, stated_unit


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


def test_a_unit_belongs_to_one_quantity():
    units = [unit for factors in FACTORS.values() for unit in factors]
    assert len(units) == len(set(units))


@pytest.mark.parametrize(
    ("header", "name", "quantity"),
    [
        ("acc tip [m/s^2]", "acc tip", "acceleration"),
        ("a (m/s²)", "a", "acceleration"),
        ("a [ms⁻²]", "a", "acceleration"),
        ("F (N)", "F", "force"),
        ("x_1 / mm", "x_1", "displacement"),
        ("acc / m/s^2", "acc", "acceleration"),
        ("Zeit [s]", "Zeit", "time"),
        ("Kraft in kN", "Kraft", "force"),
        ("eps {µm/m}", "eps", "strain"),
        ("T [°C]", "T", None),
        ("acc (tip)", "acc (tip)", None),
        ("acc[3]", "acc[3]", None),
        ("run(2)", "run(2)", None),
        ("motion in plane", "motion in plane", None),
        ("F_N", "F_N", None),
    ],
)
def test_the_unit_of_a_header(header, name, quantity):
    plain, unit = name_and_unit(header)
    assert (plain, quantity_of(unit)) == (name, quantity)


def test_a_unit_after_an_underscore_is_guessed():
    assert name_and_unit("time_s", guess=True) == ("time", "s")
    assert name_and_unit("mass_0000mm_acceleration", guess=True) == ("mass_0000mm_acceleration", None)


@pytest.mark.parametrize(
    ("unit", "quantity", "factor"),
    [
        ("lb", "force", 4.4482216152605),
        ("LBS", "force", 4.4482216152605),
        ("kgf", "force", 9.80665),
        ("kp", "force", 9.80665),
        ("daN", "force", 10.0),
        ("MN", "force", 1e6),
        ("KN", "force", 1e3),
        ("Newtons", "force", 1.0),
        ("dyn", "force", 1e-5),
        ("ozf", "force", 4.4482216152605 / 16),
        ("kips", "force", 4448.2216152605),
        ("gal", "acceleration", 1e-2),
        ("g's", "acceleration", 9.80665),
        ("Gs", "acceleration", 9.80665),
        ("ft/s²", "acceleration", 0.3048),
        ("inches/sec^2", "acceleration", 0.0254),
        ("M/S2", "acceleration", 1.0),
        ("m·s⁻²", "acceleration", 1.0),
        ("ips", "velocity", 0.0254),
        ("ft/sec", "velocity", 0.3048),
        ("mils", "displacement", 2.54e-5),
        ("thou", "displacement", 2.54e-5),
        ("microns", "displacement", 1e-6),
        ("msec", "time", 1e-3),
    ],
)
def test_spellings_of_laboratories(unit, quantity, factor):
    assert quantity_of(unit) == quantity
    assert si_factor(quantity, unit) == pytest.approx(factor, rel=1e-14)


@pytest.mark.parametrize("unit", ["Nm", "NM", "MPa", "kg", "degC", "Hz", "furlong", "lbf/s", "V"])
def test_what_is_no_unit_of_a_quantity_is_none(unit):
    assert quantity_of(unit) is None


def test_kilograms_are_a_force_where_a_force_is_asked_for():
    assert si_factor("force", "kg") == 9.80665
    with pytest.raises(RigError, match="is no unit of acceleration"):
        si_factor("acceleration", "kg")


@pytest.mark.parametrize(("text", "unit"), [(" [N] ", "N"), ("NONE", None), ("", None), (None, None), ("EU", "EU")])
def test_the_unit_in_a_field(text, unit):
    assert stated_unit(text) == unit
