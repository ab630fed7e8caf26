"""The stepped barrel: its modes as data against its finite elements in motion."""

import numpy as np
import pytest

from rig.errors import RigError
from rig.model.description import check_shapes_known
from rig.simulation.motion import concatenated
from rig.simulation.plants import modal
from rig.simulation.plants.basis import modal_basis
from rig.simulation.reference import BarrelCradle
from scenarios.stepped_barrel import BREECH_END_M, POSITIONS_M, THICKNESS_RATIO, meshed, with_basis, with_effect

BELIEVED = with_basis(BarrelCradle().rig())
UNIFORM = BarrelCradle().rig().body("barrel")


@pytest.mark.parametrize("body", BarrelCradle().rig().bodies, ids=lambda b: b.name)
def test_without_sections_the_basis_is_that_of_the_beam(body):
    basis = modal_basis(body, (), POSITIONS_M, 12)
    np.testing.assert_allclose(basis.frequencies_hz(12), body.frequencies_hz(12), rtol=1e-4)
    found, exact = (np.abs(m.shapes(POSITIONS_M, 12)) for m in (basis, body))
    np.testing.assert_allclose(found, exact, atol=1e-3 * exact.max())
    np.testing.assert_array_equal(basis.damping_ratios(12), body.damping_ratios(12))


def test_the_stepped_barrel_has_its_mass_and_its_centre_of_mass():
    check_shapes_known(BELIEVED, "rig.json")
    basis = BELIEVED.body("barrel")
    shares = np.array([THICKNESS_RATIO * BREECH_END_M, 1 - BREECH_END_M])  # of the uniform beam's mass
    assert np.sum(basis.translation() ** 2) == pytest.approx(UNIFORM.mass_kg * shares.sum(), rel=1e-6)
    translation, rotation = basis.shapes(POSITIONS_M, 2).T
    np.testing.assert_allclose(translation, 1 / np.sqrt(UNIFORM.mass_kg * shares.sum()), rtol=1e-6)
    centre = shares @ [BREECH_END_M / 2, (1 + BREECH_END_M) / 2] / shares.sum()
    assert np.interp(0.0, rotation, POSITIONS_M) == pytest.approx(centre, abs=1e-6)


def test_the_finite_elements_move_as_their_modes():
    """A push of 10 ms on the barrel's end, small enough that no contact closes."""
    step_s = 2.0**-14
    time_s = np.arange(820) * step_s
    force_n = 5 * np.sin(np.pi * np.minimum(time_s / 0.01, 1.0)) ** 2
    elements = concatenated(meshed(BELIEVED, force_n, step_s, lambda _: None))
    modes = concatenated(modal.simulate(BELIEVED, force_n, step_s, lambda _: None))
    assert not np.any(elements.contact_force_n)
    np.testing.assert_allclose(
        elements.displacement_m, modes.displacement_m, atol=2e-3 * np.abs(modes.displacement_m).max()
    )


def test_the_effect_must_leave_the_modes_alone():
    changed = with_effect(BELIEVED, "contact_clearance:factor=1.1")
    assert changed.contacts[0].law.clearance_m == pytest.approx(1.1 * BELIEVED.contacts[0].law.clearance_m)
    with pytest.raises(RigError, match="effect structural_damping: changes the modes"):
        with_effect(BELIEVED, "structural_damping")
