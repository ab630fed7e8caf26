"""The normal equations of a separated force's fit: banded in the drift's knots, dense in the other parameters."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.sparse import csr_matrix, diags, spmatrix

from identify.contacts.linearised import Jacobian, State, parts
from identify.contacts.start import ContactRecord
from identify.signals.drift import Spline
from rig.errors import RigError

BAND = 3
"""Knots further apart share no sample."""
NO_LAW = "its closures tell no law of it; excite the rig more strongly"


@dataclass(frozen=True)
class Normal:
    """The normal equations [A B; B' C] [knots; others] = right-hand side, by elimination of the knots.

    A is banded (`cholesky` of it), and kept is A^-1 B; rest is the inverse of C - B' A^-1 B.
    """

    cholesky: Float[np.ndarray, "band knots"]
    mixed: Float[np.ndarray, "knots others"]
    kept: Float[np.ndarray, "knots others"]
    rest: Float[np.ndarray, "others others"]

    def solved(
        self, knots: Float[np.ndarray, "knots columns"], others: Float[np.ndarray, "others columns"]
    ) -> tuple[Float[np.ndarray, "knots columns"], Float[np.ndarray, "others columns"]]:
        by_knots = cho_solve_banded((self.cholesky, False), knots) if knots.size else knots
        of_others = self.rest @ (others - self.mixed.T @ by_knots)
        return by_knots - self.kept @ of_others, of_others


def normal_equations(
    seen: ContactRecord,
    state: State,
    derivatives: Jacobian,
    curve: Spline,
    to_law: Float[np.ndarray, "laws free"],
    weights: Float[np.ndarray, " fewer"],
) -> tuple[Normal, Float[np.ndarray, "knots 1"], Float[np.ndarray, "others 1"]]:
    """And the descent's right-hand side. The others are the nuisance parameters, then the law's free ones.

    Raises RigError if they are singular.
    """
    pulls, free = state.pulls.size, to_law.shape[1]
    of_others = np.diag(np.r_[np.full(pulls, seen.sample_ratio), np.zeros(free)])
    gradient = np.r_[-seen.sample_ratio * state.pulls, np.zeros(free)]
    mixed, left = np.zeros((curve.knots, pulls + free)), weights * state.residual
    by_knots = csr_matrix(diags(weights) @ derivatives.by_knots)
    for part in parts(left.size):
        rows = np.concatenate([derivatives.by_pulls[part], derivatives.by_law[part] @ to_law], axis=1)
        rows *= weights[part, None]
        of_others += rows.T @ rows
        gradient += rows.T @ left[part]
        if curve.knots:
            mixed += by_knots[part].T @ rows
    of_knots = by_knots.T @ left + curve.curvature.T @ (curve.target - curve.curvature @ state.knots)
    try:
        cholesky = _banded(by_knots.T @ by_knots + curve.curvature.T @ curve.curvature)
        kept = cho_solve_banded((cholesky, False), mixed) if curve.knots else mixed
        rest = np.linalg.inv(of_others - mixed.T @ kept)
    except LinAlgError as error:
        raise RigError(NO_LAW) from error
    return Normal(cholesky, mixed, kept, rest), of_knots[:, None], gradient[:, None]


def _banded(matrix: spmatrix) -> Float[np.ndarray, "band knots"]:
    """The Cholesky factor of a symmetric matrix with so many diagonals."""
    knots = matrix.shape[0]
    upper = np.zeros((BAND + 1, knots))
    for off in range(min(BAND + 1, knots)):
        upper[BAND - off, off:] = matrix.diagonal(off)
    return np.asarray(cholesky_banded(upper)) if knots else upper
