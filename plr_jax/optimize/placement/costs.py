"""What placements cost: the distances of demand points to their nearest facilities, weighted, summed or the largest.

The gradient of a cost sees of each demand point the nearest facility alone, and of the largest distance a single
point. So descent follows soft costs: instead of the nearest facility, and of the farthest point, a mean over all with
shares that fall off exponentially by a temperature. As that goes to 0 the soft cost becomes the cost.
"""

import enum
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from plr_jax._compiled import answered_in_parts
from plr_jax.geometry.workspace import Workspace

_NEAR = 16  # facilities among which a demand point looks for its nearest while these move a little
_AT_ONCE = 2**14  # pairs: of one size, so that the distance is compiled once


class PlacementObjective(enum.StrEnum):
    """What is minimized of the weighted distances of all demand points."""

    SUM = "sum"
    MAX = "max"

    def over(self, costs: Any, axis: int = -1) -> Any:
        """Costs of many points as one, along an axis."""
        return costs.sum(axis=axis) if self is PlacementObjective.SUM else costs.max(axis=axis)

    def over_groups(
        self, costs: Float[np.ndarray, "n m"], group: Int[np.ndarray, "n"], count: int
    ) -> Float[np.ndarray, "count m"]:
        """Costs of the points of each group as one; 0 where a group has none."""
        result = np.zeros((count, costs.shape[1]))
        order = np.argsort(group, kind="stable")
        present, first = np.unique(group[order], return_index=True)
        combine = np.add if self is PlacementObjective.SUM else np.maximum
        result[present] = combine.reduceat(costs[order], first, axis=0)
        return result


class LocationProblem(NamedTuple):
    """Facilities are to be where the demand is served at the least cost.

    Attributes:
        workspace: Where they may be.
        distance: Of pairs of points, as a pytree.
        objective: What is made of the costs of all demand points.
        points: The demand points.
        weights: What a unit of distance costs each of them.
    """

    workspace: Workspace
    distance: Any
    objective: PlacementObjective
    points: Float[np.ndarray, "n 2"]
    weights: Float[np.ndarray, "n"]

    def distances(self, x: Float[np.ndarray, "*batch k 2"]) -> Float[np.ndarray, "*batch k n"]:
        """Distances of facilities and all demand points."""
        return pair_distances(self.distance, x[..., None, :], self.points)

    def near(self, x: Float[np.ndarray, "*batch k 2"]) -> Int[np.ndarray, "*batch n near"]:
        """The nearest facilities of each demand point, or all where they are few, in order of their numbers."""
        k = x.shape[-2]
        if k <= _NEAR:
            return np.broadcast_to(np.arange(k), (*x.shape[:-2], len(self.points), k))
        distances = np.swapaxes(self.distances(x), -1, -2)
        return np.sort(np.argpartition(distances, _NEAR - 1, axis=-1)[..., :_NEAR], axis=-1)

    def cost(self, nearest: Float[np.ndarray, "*batch n"]) -> Any:
        """Costs ``(*batch,)`` of the distances of all demand points to their facilities."""
        return self.objective.over(self.weights * nearest)


def pair_distances(distance: Any, x: Float[np.ndarray, "..."], y: Float[np.ndarray, "..."]) -> np.ndarray:
    """Distances of points ``(..., 2)`` that broadcast; raises ``ValueError`` for NaN and below 0."""
    return pair_slopes(distance, x, y)[0]


def pair_slopes(
    distance: Any, x: Float[np.ndarray, "..."], y: Float[np.ndarray, "..."]
) -> tuple[np.ndarray, np.ndarray]:
    """The same, and their gradients in the first points ``(..., 2)``; 0 where there is none.

    Whatever asks for distances asks here, so that they are compiled once.
    """
    found, *slopes = answered_in_parts(partial(_slopes, distance), (_AT_ONCE, _AT_ONCE), x, y)
    distances = np.asarray(found, np.float64)
    bad = np.argwhere(~(distances >= 0))
    if bad.size:
        at = tuple(bad[0])
        x, y = (np.broadcast_to(points, (*distances.shape, 2))[at].tolist() for points in (x, y))
        raise ValueError(f"distance gives {distances[at]} for {x} and {y}; use inf where no path joins them.")
    of_pairs = np.stack(slopes, axis=-1).astype(np.float64)
    return distances, np.where(np.isfinite(of_pairs), of_pairs, 0.0)


@jax.jit
def _slopes(
    distance: Any, x: Float[Array, "n 2"], y: Float[Array, "n 2"]
) -> tuple[Float[Array, "n"], Float[Array, "n"], Float[Array, "n"]]:
    d, pull_back = jax.vjp(lambda x: distance(x, y), x)
    (slopes,) = pull_back(jnp.ones_like(d))  # each pair has a point of its own
    return d, slopes[:, 0], slopes[:, 1]


@partial(jax.jit, static_argnums=(0, 5))
def soft_pulls(
    objective: PlacementObjective,
    weights: Float[Array, "n"],
    d: Float[Array, "restarts n near"],
    slopes: Float[Array, "restarts n near 2"],
    near: Int[Array, "restarts n near"],
    k: int,
    temperature: Float[Array, ""],
) -> Float[Array, "restarts k 2"]:
    """Gradients of soft costs in the facilities, shares held, from distances of demand points to those that are near.

    Weights are at most 1: costs are compared by the temperature, too.
    """
    share = jax.nn.softmax(-d / temperature, axis=2)
    if objective is PlacementObjective.SUM:
        share *= weights[:, None]
    else:
        soft = weights * jnp.where(share > 0, share * d, 0.0).sum(axis=2)
        share *= (weights * jax.nn.softmax(soft / temperature, axis=1))[..., None]
    pulls = share[..., None] * slopes
    restart = jnp.arange(len(d))[:, None, None]
    return jnp.zeros((len(d), k, 2), d.dtype).at[restart, near].add(jnp.where(jnp.isfinite(pulls), pulls, 0.0))
