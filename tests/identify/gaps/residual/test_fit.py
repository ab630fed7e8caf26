"""The step of Gauss-Newton within bounds."""

import numpy as np
import pytest

from identify.gaps.residual.fit import bounded
from rig.errors import RigError

WIDE = np.full(6, 1e3)


def test_the_rounding_of_products_in_single_precision_does_not_hide_the_priors():
    """Six columns that are nearly one, of which the priors alone tell the differences: the sum is as it should be."""
    rng = np.random.default_rng(1)
    columns = 1e5 * (rng.standard_normal((1, 400)) + 1e-5 * rng.standard_normal((6, 400)))
    exact = columns @ columns.T + 7.0 * np.eye(6)
    gradient = columns @ columns.sum(axis=0) / 6
    apart = np.array([1.0, -1.0, 0.0, 0.0, 0.0, 0.0])
    rounded = exact - 1e3 * np.outer(apart, apart)  # a share of 2e-10, less than single precision's 6e-8
    assert np.linalg.eigvalsh(rounded)[0] < 0
    step = bounded(rounded, gradient, -WIDE, WIDE)
    assert step.sum() == pytest.approx(np.linalg.solve(exact, gradient).sum(), rel=1e-4)


def test_what_is_not_told_apart_at_all_is_refused():
    with pytest.raises(RigError, match="does not tell contact forces and tolerances"):
        bounded(np.diag([1.0, -1.0, 1.0, 1.0, 1.0, 1.0]), np.ones(6), -WIDE, WIDE)
