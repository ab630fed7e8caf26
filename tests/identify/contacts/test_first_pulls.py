"""What moves a contact's force beside the contact is found from the times at which it is open."""

import numpy as np
import pytest

from identify.contacts.first_pulls import first_pulls
from identify.contacts.start import ContactRecord


def record(nuisance_n, force_n) -> ContactRecord:
    still = np.zeros(force_n.size)
    none = np.zeros(len(nuisance_n))
    return ContactRecord(
        eta_m=still,
        velocity_m_per_s=still,
        sample_rate_hz=1000.0,
        force_n=force_n,
        factor=1,
        quiet_n=0.0,
        unmodelled=0.0,
        drift=None,
        nuisance_n=nuisance_n.astype(np.float32),
        noise_in_n=none,
        moving=none > 0,
        noise_in_m=np.zeros(0),
        nuisance_m=np.zeros((0, force_n.size)),
        initial=np.array([True, True, False])[-len(nuisance_n) :],
    )


@pytest.fixture
def ringing():
    """Two decaying motions from the record's start, and a small one of a tolerance."""
    time_s = np.arange(4000) / 1000
    ring = np.exp(-time_s) * np.stack([np.cos(60 * time_s), np.sin(60 * time_s)])
    return np.concatenate([500 * ring, 0.1 * np.ones((1, 4000))])


def test_a_record_that_begins_in_motion_tells_its_start_beside_sparse_contact_forces(ringing):
    contact_n = np.where(np.arange(4000) % 50 < 12, 80.0, 0.0) * np.random.default_rng(1).uniform(0, 1, 4000)
    found = first_pulls(record(ringing, contact_n + np.array([1.3, -0.4, 0.0]) @ ringing))
    np.testing.assert_allclose(found, [1.3, -0.4, 0.0], atol=1e-3)


def test_tolerances_are_left_to_the_fit(ringing):
    assert not first_pulls(record(ringing[2:], ringing[2])).any()
