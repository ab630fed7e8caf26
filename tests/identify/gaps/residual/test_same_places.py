"""The residual of contacts between the same places: one separated force against the sum of their laws."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.residual.fit import fit
from identify.gaps.residual.residual import linearized, residual_of
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.hypothesis import reset_saturated_nuisance
from identify.gaps.search.nominal import fitted
from rig.effects.contact_clearance import ContactClearance
from rig.recording import read
from tests.campaigns.topologies import Topology, chain, progressive_stop, recorded

FACTOR = 1.2


def hidden(factor, contact="hard stop"):
    return ContactClearance(factor=float(factor), contact=contact)


@pytest.fixture(scope="module")
def fitted_record(tmp_path_factory):
    """A mass whose hard stop is farther away than believed; linearised, with tolerances and slow motion fitted.

    Without damping: the columns of clearances leave out that it sets in elsewhere.
    """
    rig = progressive_stop("acceleration")
    laws = [replace(c.law, damping_n_s_per_m=0.0) for c in rig.contacts]
    rig = replace(rig, contacts=tuple(replace(c, law=law) for c, law in zip(rig.contacts, laws, strict=True)))
    path = recorded(
        Topology(rig, 12.0, ""),
        tmp_path_factory.mktemp("stops") / "r.mcap",
        duration_s=12.0,
        actual=hidden(FACTOR).applied_to(rig),
    )
    linearization = linearized(record_of(read(path)), rig)
    return linearization, fitted(linearization).residual


def test_an_effect_on_one_of_them_is_fitted(fitted_record):
    linearization, at = fitted_record

    def build(values):
        return hidden(values[0]).applied_to(linearization.rig)

    found = fit(
        linearization,
        build,
        np.array([1.0]),
        np.array([0.01]),
        (np.array([0.1]), np.array([4.0])),
        reset_saturated_nuisance(at),
    )
    assert abs(found.values[0] - FACTOR) < 3 * np.sqrt(found.covariance[0, 0])
    assert abs(found.values[0] - FACTOR) < 0.01
    assert found.residual.contacts[0].cost < 0.1 * at.contacts[0].cost
    bumper, hard_stop = (c.law for c in found.residual.corrected_rig.contacts)
    assert bumper.clearance_m == pytest.approx(5e-4, rel=0.02)
    assert hard_stop.clearance_m == pytest.approx(FACTOR * 1e-3, rel=0.02)


def test_unknowns_of_both_laws_by_differences(fitted_record):
    """Clearance, stiffness and damping of one, then of the other."""
    linearization, _ = fitted_record
    at = residual_of(linearization, hidden(FACTOR).applied_to(linearization.rig))
    (contact,) = at.contacts
    assert contact.pulls.size == 6
    columns = contact.columns[:, -6:].toarray()
    for k in range(6):
        residuals = []
        for step in (-1e-3, 1e-3):
            moved = contact.unknowns.copy()
            moved[k - 6] += step
            residuals.append(residual_of(linearization, at.rig, at.nuisance, (moved,)).contacts[0].residual)
        expected = (residuals[0] - residuals[1]) / 2e-3
        assert np.linalg.norm(columns[:, k] - expected) < 5e-3 * np.linalg.norm(expected)


def test_a_contact_that_is_counted_the_other_way_round_leaves_the_same(tmp_path):
    """Between two masses: the residual does not depend on which is `at` and which `against`."""
    rig = chain(2, "acceleration", ground=False)
    (inner,) = rig.contacts
    outer = replace(
        inner,
        name="outer",
        law=replace(inner.law, lower_clearance_m=6e-4, upper_clearance_m=8e-4, stiffness_n_per_m=5e4),
    )
    turned = replace(
        outer,
        at=outer.against,
        against=outer.at,
        law=replace(outer.law, lower_clearance_m=8e-4, upper_clearance_m=6e-4),
    )
    one, other = (replace(rig, contacts=(inner, c)) for c in (outer, turned))
    record = record_of(read(recorded(Topology(one, 12.0, ""), tmp_path / "r.mcap", duration_s=12.0)))
    left = [residual_of(linearized(record, r), r) for r in (one, other)]
    assert np.allclose(left[0].contacts[0].residual, left[1].contacts[0].residual)
    assert np.allclose(left[0].contacts[0].columns.toarray(), left[1].contacts[0].columns.toarray())
    assert left[1].corrected_rig.contacts[1].at == turned.at
