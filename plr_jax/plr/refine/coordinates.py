"""Coordinates of the leaves' parameters in which a unit step changes the values by about as much everywhere."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from plr_jax.plr.leaves.base import LeafModel, Parameters

# The least unit, should the least-squares fit be very good: a share of the error over all points, and of how much the
# leaf's own function varies. Penalties may ask more of it than its points do.
_OF_ALL_ERROR, _OF_VARIATION = 0.1, 0.01
_EVEN_POINTS = 64  # a coefficient: enough that their mean squares are nearly those over the cell
_TINY = 1e-30


def count_in(
    model: LeafModel,
    dim: int,
    normal: Float[np.ndarray, "leaves terms terms"],
    share: Float[np.ndarray, "leaves"],
    num_points: Int[np.ndarray, "leaves"],
) -> tuple[Float[np.ndarray, "leaves terms terms"], Float[np.ndarray, "leaves terms terms"]]:
    """Normal matrices with some points counted in, and their mean over the points.

    They are as many points as a leaf has coefficients, spread evenly over the cell: along directions in which its
    own points hardly vary, a function is not flung about. A leaf whose points have no weight gets the weight of a
    mean one, so that it stays as it is.
    """
    leaves, terms, _ = normal.shape
    basis = model.basis(np.random.default_rng(0).uniform(-1, 1, (_EVEN_POINTS * terms, dim)))
    even = basis.T @ basis / len(basis)
    counted_in = np.where(share > 0, share * terms / np.maximum(num_points, 1), 1 / leaves)
    total = normal + counted_in[:, None, None] * even
    return total, total / (share + counted_in)[:, None, None]


def units(
    share: Float[np.ndarray, "leaves"], squares: Float[np.ndarray, "leaves"], half: Float[np.ndarray, "leaves dim"]
) -> Float[np.ndarray, "leaves"]:
    """Unit of each leaf's variables: how far off its least-squares fit is, but not next to nothing."""
    of_leaf = np.sqrt(squares / np.where(share > 0, share, 1.0))
    least = np.maximum(_OF_ALL_ERROR * np.sqrt(squares.sum()), _OF_VARIATION * np.linalg.norm(half, axis=1))
    return np.maximum(of_leaf, least)


def whitened(
    parameters: Parameters, mean_squares: Float[np.ndarray, "leaves terms terms"], unit: Float[np.ndarray, "leaves"]
) -> tuple[Parameters, Callable]:
    """Coordinates in which the values at a leaf's points change by a unit in the root mean square."""
    leaves, terms, _ = mean_squares.shape
    transform = unit[:, None, None] * np.linalg.inv(np.linalg.cholesky(mean_squares)).swapaxes(1, 2)
    row, column = np.broadcast_arrays(*np.ogrid[: leaves * terms, :terms])
    moved = Parameters(parameters.values, row.ravel(), (row // terms * terms + column).ravel(), transform.ravel())
    return moved, lambda z: np.einsum("lij,lj->li", transform, z.reshape(leaves, terms)).ravel()


def scaled_one_by_one(
    parameters: Parameters, mean_squares: Float[np.ndarray, "leaves terms terms"], unit: Float[np.ndarray, "leaves"]
) -> tuple[Parameters, Callable]:
    """Parameters in units of their leaves', each divided by how much it changes the values at the points it moves."""
    of_row = np.einsum("lii->li", mean_squares).ravel()
    sum_up = sums(parameters.column, len(parameters.values))
    leaf, effect = parameters.row // mean_squares.shape[1], parameters.weight**2 * of_row[parameters.row]
    scale = sum_up(effect * unit[leaf]) / np.maximum(sum_up(effect), _TINY)
    weight = parameters.weight * scale[parameters.column]
    return Parameters(parameters.values, parameters.row, parameters.column, weight), lambda z: scale * z


def sums(leaf: Int[np.ndarray, "n"], leaves: int) -> Callable[[Float[np.ndarray, "n"]], Float[np.ndarray, "leaves"]]:
    """Sums a number a point over the points of each leaf."""
    return lambda values: np.bincount(leaf, values, minlength=leaves)


def leaf_normal_matrices(
    sum_up: Callable, design: Float[np.ndarray, "n terms"], weight: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "leaves terms terms"]:
    """Sum over the points of each leaf of the products of all pairs of terms."""
    rows = [[sum_up(weight * a * b) for b in design.T] for a in design.T]
    return np.moveaxis(np.array(rows), -1, 0)
