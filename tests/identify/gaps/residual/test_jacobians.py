"""Derivatives of the residual compared with differences of residuals."""

import numpy as np
import pytest

from identify.gaps.residual.fit import contact_jacobian
from identify.gaps.residual.nuisance import with_nuisance
from identify.gaps.residual.residual import linearized, residual_decrease, residual_of, same_except_laws
from identify.gaps.search.candidates import candidates, effect_range_scale
from identify.gaps.search.nominal import nuisance_fit
from rig.simulation.reference import BarrelCradle
from tests.identify.gaps.residual.simulated_records import simulated_record

SETTINGS = BarrelCradle(sensors="acceleration", duration_s=12.0, noise_density=1e-4)
RIG = SETTINGS.rig()
EXACT = 5e-3
"""Relative error of a derivative compared with a difference over a thousandth of a step."""


@pytest.fixture(scope="module")
def believed():
    """A recording of the rig that is believed, its slow motion fitted: where that is wrong, stops are met elsewhere."""
    linearization = linearized(simulated_record(SETTINGS, RIG), RIG)
    return linearization, nuisance_fit(linearization).residual


def unknowns_of(residual):
    return tuple(c.unknowns for c in residual.contacts)


def largest_relative_error(derivatives, expected):
    """Largest relative error of several derivatives; sizes below 1e-6 of the largest one count as that."""
    sizes = [np.linalg.norm(e) for e in expected]
    least = 1e-6 * max(sizes)
    each = [np.linalg.norm(f - e) for f, e in zip(derivatives, expected, strict=True)]
    return max((e / max(s, least) for e, s in zip(each, sizes, strict=True) if e), default=0.0)


def test_effects_by_differences(believed):
    """Each effect at each place, starting from no effect; contact laws are differentiated by differences anyhow.

    The derivative of large residuals differs, as it keeps the weights by which contact forces are estimated.
    """
    linearization, residual = believed
    unknowns, errors = unknowns_of(residual), {}
    names = [s.name for s in linearization.record.sensors]
    for candidate in candidates(effect_range_scale(linearization.record, RIG), names, linearization.record.zero_known):
        if candidate.kind.stochastic or same_except_laws(RIG, candidate.applied(RIG, candidate.typical_values)):
            continue
        neutral = np.append(candidate.neutral_strength, candidate.typical_values[1:])
        step = np.append(1e-3 * candidate.step_sizes[0], np.zeros(neutral.size - 1))
        changed_rig = candidate.applied(RIG, neutral + step)
        changed = residual_of(linearization, changed_rig, residual.nuisance_pulls, unknowns)
        linear, contacts = residual_decrease(linearization, changed_rig, residual)
        expected = [a.residual - b.residual for a, b in zip(residual.contacts, changed.contacts, strict=True)]
        errors[candidate.name] = largest_relative_error(
            [linear, *contacts], [residual.linear_residual - changed.linear_residual, *expected]
        )
    assert len(errors) > 40
    assert {name: error for name, error in errors.items() if error > EXACT} == {}


@pytest.mark.parametrize("contact", [0, pytest.param(1, marks=pytest.mark.study)])
def test_contact_unknowns_by_differences(believed, contact):
    """Clearance, stiffness and damping; and slow motion, for which the law's slope is taken at the samples.

    The latter in newtons: the low-passed slope rings about each closure, where an open contact's weights are large.
    """
    linearization, residual = believed
    columns, expected = residual.contacts[contact].columns_by_unknown.toarray(), []
    for k in range(columns.shape[1]):
        step = 1e-7 if k < columns.shape[1] - 3 else 1e-3
        residuals = []
        for sign in (-1, 1):
            unknowns = [u.copy() for u in unknowns_of(residual)]
            unknowns[contact][k] += sign * step
            changed = residual_of(linearization, RIG, residual.nuisance_pulls, tuple(unknowns))
            residuals.append(changed.contacts[contact].residual)
        expected.append((residuals[0] - residuals[1]) / (2 * step))
    assert largest_relative_error(columns[:, -3:].T, expected[-3:]) < EXACT
    weights = residual.contacts[contact].observation.force_weights
    is_moving = np.flatnonzero(weights)
    slow_n, expected_n = (x[is_moving] / weights[is_moving, None] for x in (columns, np.stack(expected, axis=1)))
    assert np.linalg.norm((slow_n - expected_n)[:, :-3]) < 0.1 * np.linalg.norm(expected_n[:, :-3])


def test_nuisance_parameters_by_another_rig(believed):
    """Parameters that a rig contains: gains and delays, mass, frequencies and damping of a body.

    What a sensor at a contact shows changes the relative displacement too, whose column takes the law's slope at the
    samples: too coarse for fast motion.
    """
    linearization, residual = believed
    at_contacts = {place for contact in RIG.contacts for place in (contact.at, contact.against)}
    coarse = {s.name for s in RIG.sensors if s.station in at_contacts}
    linear, contacts = {}, {}
    for k, parameter in enumerate(residual.parameters):
        if parameter.mode_number is not None or parameter.kind in ("position", "high-pass", "crosstalk"):
            continue
        values = np.where(np.arange(len(residual.parameters)) == k, 1e-3, 0.0)
        changed_rig = with_nuisance(RIG, residual.parameters, values, linearization.record.tolerances)
        changed = residual_of(linearization, changed_rig, residual.nuisance_pulls, unknowns_of(residual))
        linear[parameter.name] = largest_relative_error(
            [linearization.columns.residual_decrease(values)], [residual.linear_residual - changed.linear_residual]
        )
        if parameter.owner not in coarse:
            expected = [a.residual - b.residual for a, b in zip(residual.contacts, changed.contacts, strict=True)]
            contacts[parameter.name] = largest_relative_error(
                [contact_jacobian(linearization, residual, j) @ values for j in range(2)], expected
            )
    assert len(linear) > len(contacts) > 20
    assert {name: error for name, error in (*linear.items(), *contacts.items()) if error > EXACT} == {}
