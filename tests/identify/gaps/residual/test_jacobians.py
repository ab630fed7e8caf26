"""Every derivative of the residual beside a difference of residuals."""

import numpy as np
import pytest

from identify.gaps.residual.fit import by_nuisance, derivative
from identify.gaps.residual.nuisance import with_nuisance
from identify.gaps.residual.residual import linearized, residual_of, same_but_laws
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.candidates import candidates, scale_of
from identify.gaps.search.nominal import fitted
from rig.simulation.excitation import force_history
from rig.simulation.reference import BarrelCradle
from rig.simulation.replay import modal

SETTINGS = BarrelCradle(sensors="acceleration", duration_s=12.0, noise_density=1e-4)
RIG = SETTINGS.rig()
EXACT = 5e-3
"""Relative error of a derivative, beside a difference over a thousandth of a step."""


@pytest.fixture(scope="module")
def believed():
    """A recording of the rig that is believed, its slow motion fitted: where that is wrong, stops are met elsewhere."""
    force_n = force_history(SETTINGS.force(), SETTINGS.duration_s, 1 / RIG.sample_rate_hz)
    linearization = linearized(record_of(modal(RIG, RIG, force_n, 1)), RIG)
    return linearization, fitted(linearization).residual


def unknowns_of(at):
    return tuple(c.unknowns for c in at.contacts)


def off(found, expected):
    """The largest relative error of the parts; of a part beside which another is 1e6 times as large, by that one."""
    sizes = [np.linalg.norm(e) for e in expected]
    least = 1e-6 * max(sizes)
    each = [np.linalg.norm(f - e) for f, e in zip(found, expected, strict=True)]
    return max((e / max(s, least) for e, s in zip(each, sizes, strict=True) if e), default=0.0)


def test_effects_by_differences(believed):
    """Each effect at each place, from nothing on. A contact's law is differentiated by differences anyhow.

    Where much is left the derivative differs: it keeps the weights by which contact forces are found.
    """
    linearization, at = believed
    unknowns, errors = unknowns_of(at), {}
    names = [s.name for s in linearization.record.sensors]
    for candidate in candidates(scale_of(linearization.record, RIG), names, linearization.record.zero_known):
        if candidate.kind.stochastic or same_but_laws(RIG, candidate.applied(RIG, candidate.default)):
            continue
        nothing = np.append(candidate.neutral, candidate.default[1:])
        there = candidate.applied(RIG, nothing + np.append(1e-3 * candidate.steps[0], np.zeros(nothing.size - 1)))
        other = residual_of(linearization, there, at.nuisance, unknowns)
        linear, contacts = derivative(linearization, there, at)
        expected = [a.residual - b.residual for a, b in zip(at.contacts, other.contacts, strict=True)]
        errors[candidate.name] = off([linear, *contacts], [at.linear - other.linear, *expected])
    assert len(errors) > 40
    assert {name: error for name, error in errors.items() if error > EXACT} == {}


@pytest.mark.parametrize("contact", [0, 1])
def test_contact_unknowns_by_differences(believed, contact):
    """Clearance, stiffness and damping; and slow motion, for which the law's slope is taken at the samples.

    The latter in newtons: the low-passed slope rings about each closure, where an open contact's weights are large.
    """
    linearization, at = believed
    columns, expected = at.contacts[contact].columns.toarray(), []
    for k in range(columns.shape[1]):
        step = 1e-7 if k < columns.shape[1] - 3 else 1e-3
        residuals = []
        for sign in (-1, 1):
            moved = [u.copy() for u in unknowns_of(at)]
            moved[contact][k] += sign * step
            residuals.append(residual_of(linearization, RIG, at.nuisance, tuple(moved)).contacts[contact].residual)
        expected.append((residuals[0] - residuals[1]) / (2 * step))
    assert off(columns[:, -3:].T, expected[-3:]) < EXACT
    weights = at.contacts[contact].seen.weights
    moving = np.flatnonzero(weights)
    slow_n, expected_n = (x[moving] / weights[moving, None] for x in (columns, np.stack(expected, axis=1)))
    assert np.linalg.norm((slow_n - expected_n)[:, :-3]) < 0.1 * np.linalg.norm(expected_n[:, :-3])


def test_nuisance_parameters_by_another_rig(believed):
    """Those that a rig can hold: gains and delays, mass, frequencies and damping of a body.

    What a sensor at a contact shows changes the relative displacement too, whose column takes the law's slope at the
    samples: too coarse for fast motion.
    """
    linearization, at = believed
    at_contacts = {place for contact in RIG.contacts for place in (contact.at, contact.against)}
    coarse = {s.name for s in RIG.sensors if s.station in at_contacts}
    linear, contacts = {}, {}
    for k, parameter in enumerate(at.parameters):
        if parameter.mode is not None or parameter.kind in ("position", "high-pass", "crosstalk"):
            continue
        values = np.where(np.arange(len(at.parameters)) == k, 1e-3, 0.0)
        moved = with_nuisance(RIG, at.parameters, values, linearization.record.tolerances)
        other = residual_of(linearization, moved, at.nuisance, unknowns_of(at))
        linear[parameter.name] = off([linearization.columns.along(values)], [at.linear - other.linear])
        if parameter.of not in coarse:
            expected = [a.residual - b.residual for a, b in zip(at.contacts, other.contacts, strict=True)]
            contacts[parameter.name] = off([by_nuisance(linearization, at, j) @ values for j in range(2)], expected)
    assert len(linear) > len(contacts) > 20
    assert {name: error for name, error in (*linear.items(), *contacts.items()) if error > EXACT} == {}
