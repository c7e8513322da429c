"""What placements cost: the distances of demand points to their nearest facilities, weighted, summed or the largest.

The gradient of a cost sees of each demand point the nearest facility alone, and of the largest distance a single
point. So descent follows soft costs: instead of the nearest facility, and of the farthest point, a mean over all with
shares that fall off exponentially by a temperature. As that goes to 0 the soft cost becomes the cost.
"""

import enum
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from plr_jax._arrays import padded
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
    shape = np.broadcast_shapes(x.shape, y.shape)
    x, y = (np.broadcast_to(points, shape).reshape(-1, 2) for points in (x, y))
    found = np.concatenate([np.empty(0), *_in_parts(partial(_distances, distance), x, y)])
    bad = np.flatnonzero(~(found >= 0))
    if bad.size:
        ends = f"{x[bad[0]].tolist()} and {y[bad[0]].tolist()}"
        raise ValueError(f"distance gives {found[bad[0]]} for {ends}; use inf where no path joins them.")
    return found.reshape(shape[:-1])


def _in_parts(
    answer: Callable[[Array, Array], Any], x: Float[np.ndarray, "n 2"], y: Float[np.ndarray, "n 2"]
) -> Iterator[Any]:
    """What a function of points answers, as pytrees of arrays, of as many pairs at once as it is compiled for."""
    for begin in range(0, len(x), _AT_ONCE):
        parts = [points[begin : begin + _AT_ONCE] for points in (x, y)]
        found = answer(*(jnp.asarray(padded(part, _AT_ONCE, part[0])) for part in parts))
        yield jax.tree.map(lambda each, part=parts[0]: np.asarray(each, np.float64)[: len(part)], found)


@jax.jit
def _distances(distance: Any, x: Float[Array, "n 2"], y: Float[Array, "n 2"]) -> Float[Array, "n"]:
    return distance(x, y)


def slopes_at(
    distance: Any, x: Float[np.ndarray, "n 2"], y: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 2"]]:
    """Distances of pairs, and their gradients in the first point; 0 where there is none."""
    distances, slopes = map(np.concatenate, zip(*_in_parts(partial(_slopes, distance), x, y), strict=True))
    return distances, np.where(np.isfinite(slopes), slopes, 0.0)


@jax.jit
def _slopes(
    distance: Any, x: Float[Array, "n 2"], y: Float[Array, "n 2"]
) -> tuple[Float[Array, "n"], Float[Array, "n 2"]]:
    d, pull_back = jax.vjp(lambda x: distance(x, y), x)
    return d, pull_back(jnp.ones_like(d))[0]


@partial(jax.jit, static_argnums=0)
def nearest_and_pulls(
    objective: PlacementObjective,
    distance: Any,
    points: Float[Array, "n 2"],
    weights: Float[Array, "n"],
    x: Float[Array, "restarts k 2"],
    near: Int[Array, "restarts n near"],
    temperature: Float[Array, ""],
) -> tuple[Float[Array, "restarts n"], Float[Array, "restarts k 2"]]:
    """Distances of demand points to the nearest of some facilities, and gradients of soft costs, shares held.

    Weights are at most 1: costs are compared by the temperature, too.
    """
    restart = jnp.arange(len(x))[:, None, None]
    y = jnp.broadcast_to(points[:, None], (*near.shape, 2)).reshape(-1, 2)
    # Each pair has a facility of its own: one that has no gradient, such as a point and itself, spoils no other.
    of_pairs = x[restart, near]
    d, pull_back = jax.vjp(lambda x: distance(x.reshape(-1, 2), y).reshape(near.shape), of_pairs)
    share = jax.nn.softmax(-d / temperature, axis=2)
    if objective is PlacementObjective.SUM:
        share *= weights[:, None]
    else:
        soft = weights * jnp.where(share > 0, share * d, 0.0).sum(axis=2)
        share *= (weights * jax.nn.softmax(soft / temperature, axis=1))[..., None]
    (pulls,) = pull_back(share)
    return d.min(axis=2), jnp.zeros_like(x).at[restart, near].add(jnp.where(jnp.isfinite(pulls), pulls, 0.0))
