"""The continuous function of least squared error: all values at once, one sparse system."""

import numpy as np
from jaxtyping import Float

from plr_jax.plr.leaves.continuous.basis import design, numbers_of_leaves
from plr_jax.plr.leaves.continuous.space import NodalSpace
from plr_jax.plr.sampling.cell_fit import CellFit

# How much a value that differs from what coarser ones predict counts beside a cell's samples: it decides only where
# samples do not, in a wall.
_PREDICTION_WEIGHT = 1e-7
_UNPREDICTED = 1e-3  # of that, for the corners of the domain, which only differ from the mean


def fit_values(
    order: int, space: NodalSpace, fit: CellFit, weight: Float[np.ndarray, "leaves k"]
) -> tuple[Float[np.ndarray, "masters"], Float[np.ndarray, "leaves terms"]]:
    """Values of the masters with which the function of the given order errs least at the leaves' samples.

    With them come the numbers of all leaves, see :func:`numbers_of_leaves`.
    """
    from scipy.sparse import bsr_array, csc_array, diags_array
    from scipy.sparse.linalg import splu

    numbers = numbers_of_leaves(order, space)
    functions = design(order, (fit.pattern.u + 1) / 2)
    terms, leaves = functions.shape[1], len(fit)
    products = (functions[:, :, None] * functions[:, None, :]).reshape(len(functions), -1)
    gram = bsr_array(
        ((weight @ products).reshape(-1, terms, terms), np.arange(leaves), np.arange(leaves + 1)),
        (leaves * terms, leaves * terms),
    )
    is_predicted = np.diff(space.prediction.indptr) > 0
    surprise = diags_array(np.where(is_predicted, 1.0, _UNPREDICTED)) - space.prediction
    normal = numbers.T @ (gram @ numbers) + (_PREDICTION_WEIGHT * fit.pattern.weight.sum()) * (surprise.T @ surprise)
    mean = np.sum(weight * fit.value) / np.sum(weight)
    moments = ((weight * (fit.value - mean)) @ functions).ravel()
    # The matrix is symmetric and positive definite: without pivoting, its factors fill in a quarter as much.
    factors = splu(
        csc_array(normal), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    values = mean + factors.solve(numbers.T @ moments)
    return values, (numbers @ values).reshape(leaves, terms)


def residuals(
    order: int, numbers: Float[np.ndarray, "leaves terms"], fit: CellFit, weight: Float[np.ndarray, "leaves k"]
) -> Float[np.ndarray, "leaves k"]:
    """Sampled distance minus function; 0 where the goal cannot be reached or no weight is given."""
    functions = design(order, (fit.pattern.u + 1) / 2)
    return np.where(weight > 0, fit.value - numbers @ functions.T, 0.0)
