"""Least squares of numbers that many leaves share: few of them in every equation."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    from scipy.sparse import csc_array, csr_array

_RESIDUAL, _MOST_STEPS = 1e-10, 200  # of conjugate gradients


def weighted_squares(
    of_parameters: "csr_array | csc_array", normal: Float[np.ndarray, "leaves terms terms"]
) -> "csr_array":
    """The normal matrix of parameters that are mapped to all coefficients, from those of the leaves' coefficients."""
    from scipy.sparse import bsr_array

    each = np.arange(len(normal) + 1)
    return of_parameters.T @ (bsr_array((normal, each[:-1], each)) @ of_parameters)


def solve_sparse(normal: "csr_array", moments: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    """Solve equations whose matrix is symmetric and positive definite, by its factors."""
    from scipy.sparse import csc_array
    from scipy.sparse.linalg import splu

    # Without pivoting, the factors of such a matrix fill in a quarter as much.
    options = {"SymmetricMode": True}
    factors = splu(csc_array(normal), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    return factors.solve(moments)


def solve_by_descent(normal: "csr_array", moments: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    """The same by conjugate gradients, to a relative residual of 1e-10; by factors if that takes long.

    In more than two dimensions factors fill in far more than the matrix holds. Where samples determine all values,
    the matrix divided by its diagonal is well conditioned, whatever the sizes of leaves.
    """
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import cg

    scale = 1 / np.sqrt(normal.diagonal())
    scaled = (diags_array(scale) @ normal @ diags_array(scale)).tocsr()
    values, failed = cg(scaled, scale * moments, rtol=_RESIDUAL, maxiter=_MOST_STEPS)
    return solve_sparse(normal, moments) if failed else scale * values
