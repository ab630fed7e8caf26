"""The residual of contacts between the same places: one separated force against the sum of their laws."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.residual.fit import fit
from identify.gaps.residual.residual import linearized, residual_of
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.hypothesis import reset_saturated_nuisance
from identify.gaps.search.nominal import nuisance_fit
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
    path = tmp_path_factory.mktemp("stops") / "r.mcap"
    recorded(Topology(rig, 12.0, ""), path, duration_s=12.0, actual=hidden(FACTOR).applied_to(rig))
    linearization = linearized(record_of(read(path)), rig)
    return linearization, nuisance_fit(linearization).residual


def test_an_effect_on_one_of_them_is_fitted(fitted_record):
    linearization, residual = fitted_record

    def build(values):
        return hidden(values[0]).applied_to(linearization.rig)

    bounds, start_residual = (np.array([0.1]), np.array([4.0])), reset_saturated_nuisance(residual)
    effect_fit = fit(linearization, build, np.array([1.0]), np.array([0.01]), bounds, start_residual)
    assert abs(effect_fit.values[0] - FACTOR) < 3 * np.sqrt(effect_fit.covariance[0, 0])
    assert abs(effect_fit.values[0] - FACTOR) < 0.01
    assert effect_fit.residual.contacts[0].cost < 0.1 * residual.contacts[0].cost
    bumper, hard_stop = (c.law for c in effect_fit.residual.corrected_rig.contacts)
    assert bumper.clearance_m == pytest.approx(5e-4, rel=0.02)
    assert hard_stop.clearance_m == pytest.approx(FACTOR * 1e-3, rel=0.02)


def test_unknowns_of_both_laws_by_differences(fitted_record):
    """Clearance, stiffness and damping of one, then of the other."""
    linearization, _ = fitted_record
    residual = residual_of(linearization, hidden(FACTOR).applied_to(linearization.rig))
    (contact,) = residual.contacts
    assert contact.pulls.size == 6
    columns = contact.columns_by_unknown[:, -6:].toarray()
    for k in range(6):
        residuals = []
        for step in (-1e-3, 1e-3):
            unknowns = contact.unknowns.copy()
            unknowns[k - 6] += step
            changed = residual_of(linearization, residual.rig, residual.nuisance_pulls, (unknowns,))
            residuals.append(changed.contacts[0].residual)
        expected = (residuals[0] - residuals[1]) / 2e-3
        assert np.linalg.norm(columns[:, k] - expected) < 5e-3 * np.linalg.norm(expected)


def test_a_contact_that_is_counted_the_other_way_round_leaves_the_same(tmp_path):
    """Residual of contacts between two masses with `at` and `against` exchanged."""
    rig = chain(2, "acceleration", ground=False)
    (first,) = rig.contacts
    law = replace(first.law, lower_clearance_m=6e-4, upper_clearance_m=8e-4, stiffness_n_per_m=5e4)
    turned_law = replace(law, lower_clearance_m=8e-4, upper_clearance_m=6e-4)
    second = replace(first, name="outer", law=law)
    turned = replace(second, at=second.against, against=second.at, law=turned_law)
    outward, inward = (replace(rig, contacts=(first, c)) for c in (second, turned))
    record = record_of(read(recorded(Topology(outward, 12.0, ""), tmp_path / "r.mcap", duration_s=12.0)))
    residuals = [residual_of(linearized(record, r), r) for r in (outward, inward)]
    assert np.allclose(residuals[0].contacts[0].residual, residuals[1].contacts[0].residual)
    outward_columns, inward_columns = (residual.contacts[0].columns_by_unknown.toarray() for residual in residuals)
    assert np.allclose(outward_columns, inward_columns)
    assert residuals[1].corrected_rig.contacts[1].at == turned.at
