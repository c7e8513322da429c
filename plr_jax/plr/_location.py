"""Where points are in a PLR's partition."""

import numpy as np
from jaxtyping import Float, Int

from plr_jax.plr._plr import PLR
from plr_jax.plr.query.points import find_leaves


def folded_points(plr: PLR, x: Float[np.ndarray, "*batch dim"]) -> Float[np.ndarray, "*batch dim"]:
    """Where points are in the folded domain, in double precision; themselves where nothing is folded.

    Around periodic axes they are not wrapped. What is outside the domain means nothing.
    """
    folding = plr.container.folding
    return np.asarray(x, np.float64) if folding is None else folding(x)


def unfolded_points(plr: PLR, z: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n dim"]:
    """For each point of the folded domain one that folds there, in the domain if any is."""
    folding = plr.container.folding
    return z if folding is None else folding.unfolded(z)


def local_coordinates(
    plr: PLR, leaf: Int[np.ndarray, "*batch"], x: Float[np.ndarray, "*#batch dim"]
) -> Float[np.ndarray, "*batch dim"]:
    """Coordinates of each point, folded, in a given leaf; ``[-1, 1]`` spans it along every axis."""
    lo, hi = plr.cells.boxes(plr.folded_domain)
    x = plr.folded_domain.image_near(folded_points(plr, x), (lo + hi)[leaf] / 2)
    return (2 * x - lo[leaf] - hi[leaf]) / (hi - lo)[leaf]


def leaf_of(plr: PLR, x: Float[np.ndarray, "*batch dim"]) -> Int[np.ndarray, "*batch"]:
    """Index of the leaf that answers for each point."""
    placed = x if plr._placement is None else plr._placement(x)
    return np.asarray(find_leaves(plr._placed_tables, placed)).astype(np.int64)
