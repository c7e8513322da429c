"""Goals that are asked for many times: how far all corners are from each, found once, also where goals are traced.

What is left of a query is half of one of two points: the first corner of the way, of those that the leaf lists.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

from plr_jax.pairs.query import (
    after_all_rounds,
    at,
    corner_of,
    is_hidden,
    is_leg_hidden,
    leg_length,
    legs,
    part_by_part,
    smallest,
    with_bit,
)
from plr_jax.pairs.tables import PairTables
from plr_jax.plr.query import lookup


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class PreparedGoals:
    """Goals of a PairPLR, made by :meth:`PairPLR.prepared`: a pytree of arrays that may be batched and sliced.

    Attributes:
        points: The goals, counted from the middle of the domain, in 32 bits.
        to_corners: The distance of each goal to each corner; ``inf`` where no path joins them.
    """

    points: Float[Array, "*batch 2"]
    to_corners: Float[Array, "*batch size"]


def distances_to_corners(tables: PairTables, points: Float[Array, "n 2"]) -> Float[Array, "n size"]:
    """The length of the shortest way from each corner to points, by the corners that each sees or straight."""
    leaf = lookup(tables.partition, points)
    legs_of_points = legs(tables, leaf, points)

    def by_corner(column: Array, found: Float[Array, "n size"]) -> Float[Array, "n size"]:
        place = jnp.full(leaf.shape, column, jnp.uint32)
        hidden = is_leg_hidden(tables, leaf, place, points, corner_of(tables, leaf, place))
        leg = jnp.where(hidden, jnp.inf, legs_of_points[:, column])
        return jnp.minimum(found, leg[:, None] + tables.distances[tables.listed[leaf, place]])

    none = jnp.full((points.shape[0], len(tables.distances)), jnp.inf, jnp.float32)
    return jax.lax.fori_loop(0, tables.x.shape[1], by_corner, none)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class _Points:
    """Points, and the length of the way to the goal by each corner of their leaves' lists, if they see it."""

    x: Float[Array, "n 2"]
    leaf: UInt32[Array, "n"]
    way: Float[Array, "n longest"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class _Search:
    """The search of first corners, as :class:`plr_jax.pairs.query.Search`."""

    length: Float[Array, "n"]
    via: UInt32[Array, "n"]
    least: Float[Array, "n"]
    done: UInt32[Array, "n words"]


def ways_to_goals(
    tables: PairTables,
    to_corners: Float[Array, "goals size"],
    x: Float[Array, "n 2"],
    y: Float[Array, "n 2"],
    goal: UInt32[Array, "n"],
) -> tuple[Float[Array, "n"], Float[Array, "n 2"]]:
    """Lengths of shortest ways from points to others that are goals of some numbers, and where each goes first."""
    return part_by_part(partial(_ways, tables, to_corners), x, y, goal)


def _ways(
    tables: PairTables,
    to_corners: Float[Array, "goals size"],
    x: Float[Array, "n 2"],
    y: Float[Array, "n 2"],
    goal: UInt32[Array, "n"],
) -> tuple[Float[Array, "n"], Float[Array, "n 2"]]:
    leaf, longest = lookup(tables.partition, x), tables.x.shape[1]
    rest = at(to_corners.ravel(), goal[:, None] * to_corners.shape[1] + tables.listed[leaf])
    points = _Points(x, leaf, jax.lax.optimization_barrier(legs(tables, leaf, x) + rest))
    straight = jnp.where(is_hidden(tables, x, y), jnp.inf, leg_length(x - y))
    words = jnp.zeros((x.shape[0], -(-longest // 32)), jnp.uint32)
    search = _Search(straight, jnp.full(x.shape[0], longest, jnp.uint32), points.way.min(axis=1), words)

    def after_round(points: _Points, search: _Search) -> _Search:
        first, length, second = smallest(points.way, search.done)
        hidden = is_leg_hidden(tables, points.leaf, first, points.x, corner_of(tables, points.leaf, first))
        better = ~hidden & (length < search.length)
        return _Search(
            length=jnp.where(better, length, search.length),
            via=jnp.where(better, first, search.via),
            least=second,
            done=with_bit(search.done, first),
        )

    search = after_all_rounds(after_round, points, search)
    corner = corner_of(tables, leaf, jnp.minimum(search.via, np.uint32(longest - 1)))
    return search.length, jnp.where((search.via == longest)[:, None], y, corner)
