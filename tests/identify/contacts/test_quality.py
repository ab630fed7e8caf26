"""The quality of a joint fit: what is said of it, and what its intervals become."""

import numpy as np
import pytest

from identify.contacts.joint import Joint
from identify.contacts.quality import fit_findings, widened
from identify.structure.nuisance import Nuisance

PARAMETERS = (Nuisance("frequency", "beam"), Nuisance("frequency", "beam", 3), Nuisance("gain", "a"))


def joint(pulls=(0.0, 0.0, 0.0), damping=1.0, halves=(0.0, 0.0), unexplained=0.01) -> Joint:
    return Joint(
        values=np.array([1e-3, 1e-3, 1e5, damping]),
        covariance=np.diag([1e-12, 1e-12, 1e4, 0.01]),
        of_tolerances=np.diag([5e-13, 5e-13, 5e3, 0.005]),
        of_drift=np.zeros((4, 4)),
        sides_known=True,
        touched=(True, True),
        drift_m=np.zeros(4),
        drift_m_per_s=np.zeros(4),
        pulls=np.array(pulls),
        unexplained=unexplained,
        halves=halves,
    )


@pytest.mark.parametrize(("pull", "factor"), [(1.0, 1.0), (2.0, 2.0), (-3.0, 3.0)])
def test_errors_grow_with_the_pull_of_a_whole_body(pull, factor):
    found = widened(joint((pull, 4.0, 4.0)), PARAMETERS)
    np.testing.assert_allclose(found.errors, factor * joint().errors)


@pytest.mark.parametrize(
    ("fit", "cause", "of"),
    [
        (joint((5.0, 0.0, 0.0)), "frequency", "beam"),
        (joint((0.0, -6.0, 0.0)), "frequency", "beam 3"),
        (joint((0.0, 0.0, 5.0)), "gain", "a"),
        (joint(damping=-0.6), "fit", "stop"),
        (joint(halves=(0.0, -3.9)), "fit", "stop"),
        (joint(unexplained=0.5), "fit", "stop"),
    ],
)
def test_a_fit_that_cannot_be_is_named(fit, cause, of):
    (found,) = fit_findings(["stop"], [fit], PARAMETERS)
    assert (found.cause, found.of) == (cause, of)


def test_a_fit_within_its_tolerances_has_no_finding():
    assert list(fit_findings(["stop", "other"], [joint((2.0, 3.0, -4.0)), "it never closes"], PARAMETERS)) == []
