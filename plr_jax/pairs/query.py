"""A query of pairs, in JAX.

The distance of two points that see one another is straight; any other way goes by a corner of each one's list. The
first corner of the way is found best-first: those of the list, each with at most the length that a way by it can
have, are looked into in that order, and then the way by one is the shortest by the second point's list. A corner that
a wall hides from its point is struck off the list it is on. So the bounds that are left never exceed the distance.

Legs are tested against the walls near the leaf's box and the corner, which are few; straight lines against all walls.
Most pairs need one round or two. Each round is of the first pairs that are open: of many together while there are
many, and then of few.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.export import is_symbolic_dim
from jaxtyping import Array, Bool, Float, Integer, Shaped, UInt32

from plr_jax.pairs.portable import crossings, straight_line_of, winding
from plr_jax.pairs.tables import PairTables, last_bits_of
from plr_jax.plr.portable.numpy import ARRAYS
from plr_jax.plr.query import lookup

_AT_ONCE = 2**14
_MANY, _FEW = 2**11, 2**7  # pairs that are looked at together while many are open, and then
_TESTED = 2**10  # pairs that are held against all walls together
_LARGEST = np.finfo(np.float32).max  # `inf` with other bits would be no number
_BELOW, _TINY = np.float32(1 - 2.0**-10), np.float32(1e-30)


Of, Columns = TypeVar("Of"), TypeVar("Columns")
Found = TypeVar("Found", bound=Any)  # with `length`, of the shortest found, and `least`: none left is shorter


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of points.

    Attributes:
        x: First points.
        y: Second points.
        leaf_x: The leaves of the first points.
        leaf_y: Those of the second ones.
        at_least: At most the length of the way by each corner of the first point's list.
    """

    x: Float[Array, "n 2"]
    y: Float[Array, "n 2"]
    leaf_x: UInt32[Array, "n"]
    leaf_y: UInt32[Array, "n"]
    at_least: Float[Array, "n longest"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Search:
    """The search of shortest ways between pairs of points.

    Attributes:
        length: Length of the shortest way found; ``inf`` if none is.
        via_x: The place in the first point's list of the corner where it goes first.
        via_y: And that in the second point's list, where it goes last; of a straight way both are behind all places.
        least: No way that is left is shorter.
        done_x: Corners of the first point's list that are done with, a bit each.
        done_y: Those of the second point's that are struck off.
    """

    length: Float[Array, "n"]
    via_x: UInt32[Array, "n"]
    via_y: UInt32[Array, "n"]
    least: Float[Array, "n"]
    done_x: UInt32[Array, "n words"]
    done_y: UInt32[Array, "n words"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Ways:
    """Shortest ways between points.

    Attributes:
        length: Length of the shortest way found; ``inf`` if there is none.
        least: No way is shorter.
        from_x: Where it goes first from the first point; the second one if it is straight, or there is none.
        from_y: And from the second one.
    """

    length: Float[Array, "n"]
    least: Float[Array, "n"]
    from_x: Float[Array, "n 2"]
    from_y: Float[Array, "n 2"]


def shortest_ways(tables: PairTables, x: Float[Array, "n 2"], y: Float[Array, "n 2"]) -> Ways:
    """The shortest ways between points of the domain, counted from its middle; alike either way round."""
    swaps = ((x[:, 0] > y[:, 0]) | ((x[:, 0] == y[:, 0]) & (x[:, 1] > y[:, 1])))[:, None]
    ways = part_by_part(partial(_ways, tables), jnp.where(swaps, y, x), jnp.where(swaps, x, y))
    from_x, from_y = jnp.where(swaps, ways.from_y, ways.from_x), jnp.where(swaps, ways.from_x, ways.from_y)
    return replace(ways, from_x=from_x, from_y=from_y)


def part_by_part(ways: Callable[..., Columns], *rows: Shaped[Array, "n ..."]) -> Columns:
    """A pytree of what is found of each row of some arrays, of so many rows at a time as caches hold."""
    size = rows[0].shape[0]
    if is_symbolic_dim(size) or size <= _AT_ONCE:
        return ways(*rows)
    parts = -(-size // _AT_ONCE)
    padded = [jnp.pad(each, ((0, parts * _AT_ONCE - size), *((0, 0),) * (each.ndim - 1))) for each in rows]
    whole = tuple(each.reshape(parts, _AT_ONCE, *each.shape[1:]) for each in padded)
    columns = jax.lax.map(lambda part: ways(*part), whole)
    return jax.tree.map(lambda each: each.reshape(-1, *each.shape[2:])[:size], columns)


def _ways(tables: PairTables, x: Float[Array, "n 2"], y: Float[Array, "n 2"]) -> Ways:
    leaf_x, leaf_y = lookup(tables.partition, x), lookup(tables.partition, y)
    at_least = jax.lax.optimization_barrier(_at_least(tables, x, y, leaf_x, leaf_y))
    # Before the first round pairs that see one another are done.
    straight = jnp.where(is_hidden(tables, x, y), jnp.inf, leg_length(x - y))
    longest = tables.x.shape[1]
    words = jnp.zeros((x.shape[0], -(-longest // 32)), jnp.uint32)
    behind = jnp.full(x.shape[0], longest, jnp.uint32)
    search = Search(straight, behind, behind, at_least.min(axis=1), words, words)
    search = after_all_rounds(partial(_after_round, tables), Pairs(x, y, leaf_x, leaf_y, at_least), search)
    is_straight = (search.via_x == longest)[:, None]
    from_x = jnp.where(is_straight, y, corner_of(tables, leaf_x, jnp.minimum(search.via_x, longest - 1)))
    from_y = jnp.where(is_straight, x, corner_of(tables, leaf_y, jnp.minimum(search.via_y, longest - 1)))
    return Ways(search.length, jnp.minimum(search.length, search.least), from_x, from_y)


def after_all_rounds(after_round: Callable[[Of, Found], Found], pairs: Of, search: Found) -> Found:
    """The search after all rounds, each of pairs that are open: of which a shorter way may be left.

    It ends, as each round strikes a corner off a list of each pair that is open.
    """
    size = search.length.shape[0]

    def is_open(search: Found) -> Bool[Array, "n"]:
        return search.least < search.length

    def while_open(than: int, after: Callable[[Found], Found], search: Found) -> Found:
        return jax.lax.while_loop(lambda search: is_open(search).sum() > than, after, search)

    def round_of_all(search: Found) -> Found:
        stays = ~is_open(search)
        after = after_round(pairs, search)
        return jax.tree.map(lambda a, b: jnp.where(jnp.expand_dims(stays, range(1, a.ndim)), a, b), search, after)

    def round_of_first(count: int, search: Found) -> Found:
        number = jnp.cumsum(is_open(search))  # of each open pair, from 1
        lanes = jnp.searchsorted(number, 1 + jnp.arange(count))  # behind the last pair where fewer are open
        first = after_round(*jax.tree.map(lambda a: at(a, lanes, "clip"), (pairs, search)))
        return jax.tree.map(lambda a, b: a.at[lanes].set(b, mode="drop", unique_indices=True), search, first)

    if is_symbolic_dim(size) or size <= _FEW:
        return while_open(0, round_of_all, search)
    if size > _MANY:
        search = while_open(_MANY, partial(round_of_first, _MANY), search)
    return while_open(0, partial(round_of_first, _FEW), search)


def _at_least(
    tables: PairTables,
    x: Float[Array, "n 2"],
    y: Float[Array, "n 2"],
    leaf_x: UInt32[Array, "n"],
    leaf_y: UInt32[Array, "n"],
) -> Float[Array, "n longest"]:
    """At most the length of the way by each corner of the first point's list."""
    listed = tables.listed[leaf_x].astype(jnp.uint32)
    size = len(tables.distances)
    last_bits = last_bits_of(size)
    onward = at(tables.onward.ravel(), leaf_y[:, None] * size + listed)
    last, other = onward & last_bits, jax.lax.bitcast_convert_type(onward & ~last_bits, jnp.float32)
    dx, dy = (at(along, last) - p[:, None] for along, p in zip(tables.corners.T, y.T, strict=True))
    way = at(tables.distances.ravel(), last * size + listed) + jnp.sqrt(dx * dx + dy * dy)
    return legs(tables, leaf_x, x) + jnp.minimum(way, other)


def _after_round(tables: PairTables, pairs: Pairs, search: Search) -> Search:
    """The search after a look into the most promising corner of each first point."""
    x, y, leaf_x, leaf_y = pairs.x, pairs.y, pairs.leaf_x, pairs.leaf_y
    first, at_first, second = smallest(pairs.at_least, search.done_x)
    corner = tables.listed[leaf_x, first].astype(jnp.uint32)
    listed = tables.listed[leaf_y].astype(jnp.uint32)
    onward = legs(tables, leaf_y, y) + at(tables.distances.ravel(), corner[:, None] * len(tables.distances) + listed)
    last, rest, _ = smallest(onward, search.done_y)
    via_x, via_y = corner_of(tables, leaf_x, first), corner_of(tables, leaf_y, last)
    hidden_x = is_leg_hidden(tables, leaf_x, first, x, via_x)
    hidden_y = is_leg_hidden(tables, leaf_y, last, y, via_y)
    length = jnp.where(hidden_x | hidden_y, jnp.inf, leg_length(x - via_x) + rest)
    is_done = hidden_x | ~hidden_y | (rest == jnp.inf)
    better = length < search.length
    return Search(
        length=jnp.where(better, length, search.length),
        via_x=jnp.where(better, first, search.via_x),
        via_y=jnp.where(better, last, search.via_y),
        least=jnp.where(is_done, second, jnp.minimum(at_first, second)),
        done_x=with_bit(search.done_x, first, is_done),
        done_y=with_bit(search.done_y, last, hidden_y),
    )


def with_bit(
    words: UInt32[Array, "n words"], place: UInt32[Array, "n"], if_so: Bool[Array, "n"] | bool = True
) -> UInt32[Array, "n words"]:
    """Words after the bit of a place is set in each, if so."""
    number = jnp.arange(words.shape[1], dtype=jnp.uint32)[None]
    bit = jnp.where(if_so, jnp.uint32(1) << (place & 31), 0)
    return words | jnp.where(number == (place >> 5)[:, None], bit[:, None], 0)


def smallest(
    values: Float[Array, "n longest"], done: UInt32[Array, "n words"]
) -> tuple[UInt32[Array, "n"], Float[Array, "n"], Float[Array, "n"]]:
    """Where the smallest of each row is, of those not done with, to rounding; it; and the smallest of the others.

    Compilers find the place of a minimum slowly, and a minimum fast. So the places stand in the last bits of what the
    values are above a little less than the minimum, where they do not disturb the order of any that differ.
    """
    columns = np.arange(values.shape[1], dtype=np.uint32)[None]
    is_done = done[:, columns[0] // 32] & (np.uint32(1) << columns % 32) != 0
    values = jax.lax.optimization_barrier(jnp.where(is_done, jnp.inf, values))
    base = _BELOW * jnp.minimum(values.min(axis=1, keepdims=True), _LARGEST) - _TINY
    mask = np.uint32(2 ** (values.shape[1] - 1).bit_length() - 1)
    bits = jax.lax.bitcast_convert_type(jnp.minimum(values - base, _LARGEST), jnp.uint32) & ~mask | columns
    smallest = jax.lax.optimization_barrier(jax.lax.bitcast_convert_type(bits, jnp.float32)).min(axis=1)
    place = jax.lax.bitcast_convert_type(smallest, jnp.uint32) & mask
    others = jax.lax.optimization_barrier(jnp.where(columns == place[:, None], jnp.inf, values))
    return place, jnp.take_along_axis(values, place[:, None], axis=1)[:, 0], others.min(axis=1)


def legs(tables: PairTables, leaf: UInt32[Array, "n"], x: Float[Array, "n 2"]) -> Float[Array, "n longest"]:
    """Lengths of the legs from points to all corners of their leaves' lists."""
    dx, dy = tables.x[leaf] - x[:, :1], tables.y[leaf] - x[:, 1:]
    return jnp.sqrt(dx * dx + dy * dy)


def corner_of(tables: PairTables, leaf: UInt32[Array, "n"], place: UInt32[Array, "n"]) -> Float[Array, "n 2"]:
    """The corners at some places of leaves' lists."""
    return jnp.stack([tables.x[leaf, place], tables.y[leaf, place]], axis=1)


def leg_length(v: Float[Array, "n 2"]) -> Float[Array, "n"]:
    """Lengths of vectors."""
    return jnp.sqrt(v[:, 0] * v[:, 0] + v[:, 1] * v[:, 1])


def at(
    table: Shaped[Array, "m ..."], index: Integer[Array, "*n"], mode: str = "promise_in_bounds"
) -> Shaped[Array, "..."]:
    """Entries of a table, whose numbers are in it."""
    return table.at[index].get(mode=mode)


def is_leg_hidden(
    tables: PairTables,
    leaf: UInt32[Array, "n"],
    place: UInt32[Array, "n"],
    x: Float[Array, "n 2"],
    corner: Float[Array, "n 2"],
) -> Bool[Array, "n"]:
    """Whether an obstacle is between points and corners at some places of their leaves' lists."""
    if tables.near is None:
        return is_hidden(tables, x, corner)
    (px, py), (qx, qy) = x.T[:, :, None], corner.T[:, :, None]
    ax, ay, bx, by = tables.near(leaf, place)
    ex, ey, dx, dy = bx - ax, by - ay, qx - px, qy - py
    beside_p, beside_q = ex * (py - ay) - ey * (px - ax), ex * (qy - ay) - ey * (qx - ax)
    a_is_left, b_is_left = dx * (ay - py) >= dy * (ax - px), dx * (by - py) >= dy * (bx - px)
    crossed = jnp.where(beside_p * beside_q < 0, a_is_left.astype(jnp.float32) - b_is_left, 0)
    crossed = jax.lax.optimization_barrier(crossed)
    return (crossed.min(axis=1) < 0) & (crossed.max(axis=1) > 0)


def is_hidden(tables: PairTables, x: Float[Array, "n 2"], y: Float[Array, "n 2"]) -> Bool[Array, "n"]:
    """Whether an obstacle is between points: most pairs that one hides are told by the occluders, others by walls."""
    size, hidden = x.shape[0], is_across_occluder(tables.occluders, x, y)
    if is_symbolic_dim(size) or size <= _TESTED:
        return hidden | _is_across_walls(tables, x, y)
    number = jnp.cumsum(~hidden)  # of each pair that is left, from 1

    def of_next(done: Array, hidden: Bool[Array, "n"]) -> Bool[Array, "n"]:
        lanes = jnp.searchsorted(number, done * _TESTED + 1 + jnp.arange(_TESTED))  # behind the last where fewer are
        across = _is_across_walls(tables, *(at(p, lanes, "clip") for p in (x, y)))
        return hidden.at[lanes].set(across, mode="drop", unique_indices=True)

    return jax.lax.fori_loop(0, -(-number[-1] // _TESTED), of_next, hidden)


def is_across_occluder(
    occluders: Float[Array, "groups 16 7"], x: Float[Array, "n 2"], y: Float[Array, "n 2"]
) -> Bool[Array, "n"]:
    """Whether lines between points cross an occluder for certain, whatever is rounded.

    An end that is on the line's other side but for rounding is behind none of two points that are clear of its line.
    """
    (px, py), (qx, qy) = x.T, y.T
    dx, dy = qx - px, qy - py
    moment = dx * py - dy * px

    def meets(hidden, group):
        for ax, ay, bx, by, nx, ny, offset in group:
            p, q = nx * px + ny * py - offset, nx * qx + ny * qy - offset
            a_is_left, b_is_left = dx * ay - dy * ax >= moment, dx * by - dy * bx >= moment
            hidden |= (jnp.maximum(p, q) > 1) & (jnp.minimum(p, q) < -1) & (a_is_left != b_is_left)
        return hidden, None

    return jax.lax.scan(meets, jnp.zeros(x.shape[0], bool), occluders)[0]


def _is_across_walls(tables: PairTables, x: Float[Array, "n 2"], y: Float[Array, "n 2"]) -> Bool[Array, "n"]:
    """Whether an obstacle, whose walls have moved back a little, is between points.

    A line through one goes in across a wall and out across another. Across one way alone goes the line from a point
    that rounding puts into a wall, or that is in two parts of free space at once where thin walls have moved past one
    another: such a point sees what is on both sides. Nothing but free space is certain where that must not be.
    """
    p, q = list(x.T), list(y.T)
    straight = straight_line_of(ARRAYS, p, q)

    def meets(crossed, walls):
        goes_in, goes_out = crossed
        for wall in walls:
            inward, outward = crossings(ARRAYS, p, q, straight, wall)
            goes_in, goes_out = goes_in | inward, goes_out | outward
        return (goes_in, goes_out), None

    none = jnp.zeros(x.shape[0], bool)
    goes_in, goes_out = jax.lax.scan(meets, (none, none), tables.walls)[0]
    return goes_in | goes_out if tables.is_certain else goes_in & goes_out


def is_inside(tables: PairTables, x: Float[Array, "n 2"]) -> Bool[Array, "n"]:
    """Whether points are in what the walls enclose: walls that have changed sides wind around them the other way."""
    p = list(x.T)

    def winds(turns, walls):
        for wall in walls:
            up, down = winding(ARRAYS, p, wall)
            turns += up.astype(int) - down.astype(int)
        return turns, None

    return jax.lax.scan(winds, jnp.zeros(x.shape[0], int), tables.walls)[0] == 1
