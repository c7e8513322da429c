"""The optimization that :func:`refine` poses, in coordinates that make it easy.

Which leaf holds a point does not change, so it is looked up once; a step gathers the coefficients of all points and
adds up their gradients. Three things make a few hundred steps enough, whatever the loss:

- The start is the least-squares fit, and what is optimized is the correction to it, so that 32-bit floats resolve
  small errors of large distances.
- The variables ``z`` are coordinates in which a unit step changes the values at the points it moves by a unit in the
  root mean square. Where each leaf has parameters of its own, they come from the Cholesky factor of the leaf's normal
  matrix; where leaves share them, each parameter is scaled for itself.
- That unit is about the error of the least-squares fit there: leaves of small errors take small steps.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import padded, padded_size
from plr_jax._types import Distances, Points
from plr_jax.plr._plr import PLR, leaf_of, local_coordinates
from plr_jax.plr.leaves.base import LinearLeafModel, Parameters, as_linear, linear_mean_planes
from plr_jax.plr.leaves.sparse_squares import solve_sparse, weighted_squares
from plr_jax.plr.refinement.objective import Objective

_POINTS_A_PARAMETER = 4  # that a leaf must have to be fitted to its points
# The least unit, should the least-squares fit be very good: a share of the error over all points, and of how much the
# leaf's own function varies. Penalties may ask more of it than its points do.
_OF_ALL_ERROR, _OF_VARIATION = 0.1, 0.01
_RIDGE = 1e-9  # of a normal matrix: what the points do not determine stays as it is
# Where leaves share parameters, each holds on to its function, as if points lay on it, spread evenly: so many for
# each of its own or, where these are too few, for each that a leaf has on average.
_HELD, _HELD_WITHOUT_POINTS = 1e-3, 0.03
_EVEN_POINTS = 256


class WeightedPoints(NamedTuple):
    """Points of finite distance, with their weights."""

    x: Points
    distance: Distances
    weight: Float[np.ndarray, "n"]

    def take(self, index: Int[np.ndarray, "m"]) -> "WeightedPoints":
        """Some of the points."""
        return WeightedPoints(self.x[index], self.distance[index], self.weight[index])


@dataclass(frozen=True, eq=False)
class Refinable:
    """The objective, the parameters of least squared error, and those at given variables, in double precision.

    ``has_enough`` says which leaves have enough points to be fitted to.
    """

    objective: Objective
    values: Float[np.ndarray, "parameters"]
    at: Callable[[Float[np.ndarray, "padded"]], Float[np.ndarray, "parameters"]]
    has_enough: Bool[np.ndarray, "leaves"]


def pose(plr: PLR, points: WeightedPoints) -> Refinable:
    """The problem of refining a PLR with some points.

    Points of leaves that have too few of them get no weight, and nothing moves what those leaves alone depend on.
    """
    model, leaf = as_linear(plr.leaf), leaf_of(plr, points.x)
    order = np.argsort(leaf, kind="stable")
    leaf, (x, distance, weight) = leaf[order], points.take(order)
    lo, hi = plr.cells.boxes(plr.folded_domain)
    basis = model.basis(local_coordinates(plr, leaf, x))
    parameters = model.parameters(plr.cells, plr.stored)
    shape = (plr.num_leaves, basis.shape[1])
    num_points = np.bincount(leaf[weight > 0], minlength=len(lo))
    least_points = _POINTS_A_PARAMETER * math.ceil(len(parameters.values) / plr.num_leaves)
    has_enough = (num_points >= least_points) & ~plr.unreachable
    weight = _normalized(weight * has_enough[leaf], plr, least_points)

    def sum_up(values: Float[np.ndarray, "n"]) -> Float[np.ndarray, "leaves"]:
        return np.bincount(leaf, values, minlength=len(lo))

    normal = np.array([[sum_up(weight * a * b) for b in basis.T] for a in basis.T]).transpose(2, 0, 1)
    share = sum_up(weight)
    error = np.sum(_coefficients(parameters, shape)[leaf] * basis, axis=1) - distance
    moments = np.stack([sum_up(weight * error * term) for term in basis.T], axis=1)
    if not parameters.is_leafwise:
        held = np.where(has_enough, _HELD * share, _HELD_WITHOUT_POINTS / len(share))
        normal += held[:, None, None] * _even_moments(model, plr.dim)
    parameters = replace(parameters, values=parameters.values - _least_squares(parameters, normal, moments))
    coefficients = _coefficients(parameters, shape)
    error = np.sum(coefficients[leaf] * basis, axis=1) - distance
    center, half = linear_mean_planes(model, np.eye(shape[1]), plr.dim)
    unit = has_enough * _units(share, sum_up(weight * error**2), coefficients @ half)
    if parameters.is_leafwise:
        num_points = np.where(has_enough, num_points, 1)
        scaled, to_parameters = _whitened(parameters, share, normal, unit, num_points)
    else:
        scaled, to_parameters = _scaled(parameters, unit, shape[1])
    rows = {"leaf": leaf, "basis": basis, "error": error, "weight": weight, "share": share}
    rows |= {"coefficients": coefficients, "per_half": 2 / (hi - lo), "start": np.zeros(len(parameters.values))}
    rows |= {"row": scaled.row, "column": scaled.column, "entry": scaled.weight}
    filled_up = {name: padded(column, padded_size(len(column))) for name, column in rows.items()}
    objective = Objective(center=center, half=half.T, **filled_up)
    values = parameters.values
    return Refinable(objective, values, lambda z: values + to_parameters(z[: len(values)]), has_enough)


def _normalized(weight: Float[np.ndarray, "n"], plr: PLR, num_points: int) -> Float[np.ndarray, "n"]:
    """Weights that sum to 1."""
    if not weight.any():
        raise ValueError(
            f"No leaf of {plr} has {num_points} points of positive weight and finite distance to be fitted to; give "
            "more points."
        )
    weight = weight / weight.max()  # so that the sum does not overflow
    return weight / weight.sum()


def _coefficients(parameters: Parameters, shape: tuple[int, int]) -> Float[np.ndarray, "leaves terms"]:
    moved = parameters.weight * parameters.values[parameters.column]
    return np.bincount(parameters.row, moved, minlength=shape[0] * shape[1]).reshape(shape)


def _even_moments(model: LinearLeafModel, dim: int) -> Float[np.ndarray, "terms terms"]:
    """The normal matrix of points spread evenly over a leaf, of weights that sum to 1."""
    basis = model.basis(np.random.default_rng(0).uniform(-1, 1, (_EVEN_POINTS, dim)))
    return basis.T @ basis / _EVEN_POINTS


def _least_squares(
    parameters: Parameters,
    normal: Float[np.ndarray, "leaves terms terms"],
    moments: Float[np.ndarray, "leaves terms"],
) -> Float[np.ndarray, "parameters"]:
    """The change of parameters that explains the moments of the errors."""
    from scipy.sparse import csc_array, diags_array

    shape = moments.size, len(parameters.values)
    of_leaves = csc_array((parameters.weight, (parameters.row, parameters.column)), shape)
    matrix = weighted_squares(of_leaves, normal)
    diagonal = matrix.diagonal()
    return solve_sparse(matrix + diags_array(_RIDGE * (diagonal + diagonal.max())), of_leaves.T @ moments.ravel())


def _whitened(
    parameters: Parameters,
    share: Float[np.ndarray, "leaves"],
    normal: Float[np.ndarray, "leaves terms terms"],
    unit: Float[np.ndarray, "leaves"],
    num_points: Int[np.ndarray, "leaves"],
) -> tuple[Parameters, Callable]:
    """Coordinates in which the values at a leaf's points change by a unit in the root mean square.

    As many points as a leaf has coefficients, spread evenly over the cell, are counted in: along directions in
    which the points hardly vary, a function is not flung about.
    """
    leaves, terms, _ = normal.shape
    even = np.diag([1.0, *[1 / 3] * (terms - 1)])
    counted_in = np.where(share > 0, share * terms / num_points, 1.0)
    moments = (normal + counted_in[:, None, None] * even) / (share + counted_in)[:, None, None]
    transform = unit[:, None, None] * np.linalg.inv(np.linalg.cholesky(moments)).swapaxes(1, 2)
    row, column = np.broadcast_arrays(*np.ogrid[: leaves * terms, :terms])
    scaled = Parameters(parameters.values, row.ravel(), (row // terms * terms + column).ravel(), transform.ravel())
    return scaled, lambda z: np.einsum("lij,lj->li", transform, z.reshape(leaves, terms)).ravel()


def _scaled(
    parameters: Parameters, unit: Float[np.ndarray, "leaves"], terms: int
) -> tuple[Parameters, Callable[[Float[np.ndarray, "n"]], Float[np.ndarray, "n"]]]:
    """Each parameter in the smallest unit of the leaves it moves: it stays where one has too few points to tell."""
    scale = np.full(len(parameters.values), np.inf)
    np.minimum.at(scale, parameters.column, unit[parameters.row // terms])
    scale[np.isinf(scale)] = 0.0
    weight = parameters.weight * scale[parameters.column]
    return Parameters(parameters.values, parameters.row, parameters.column, weight), lambda z: scale * z


def _units(
    share: Float[np.ndarray, "leaves"], squares: Float[np.ndarray, "leaves"], half: Float[np.ndarray, "leaves dim"]
) -> Float[np.ndarray, "leaves"]:
    """Unit of each leaf's variables: how far off its least-squares fit is, but not next to nothing."""
    of_leaf = np.sqrt(squares / np.where(share > 0, share, 1.0))
    least = np.maximum(_OF_ALL_ERROR * np.sqrt(squares.sum()), _OF_VARIATION * np.linalg.norm(half, axis=1))
    return np.maximum(of_leaf, least)
