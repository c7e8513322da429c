"""Queries of a PairPLR in JAX: the search for shortest paths.

If two points x and y do not see each other, the path between them turns first at a corner i and last at a corner j.
The leaf of x lists the corner i, and the leaf of y lists the corner j::

    x ------ i ~~~~~~~~~~ j ------ y      |x - i| + D(i, j) + |j - y|, with D the distance between corners
       leg                   leg

For each corner in the first point's list, the search knows a lower bound of the path length through the corner. It
tries the corners by ascending bound. It drops a corner from a list if a wall hides the corner from the list's point,
and stops once no bound is below the length of a path found. Most pairs of points need one or two rounds.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.export import is_symbolic_dim
from jaxtyping import Array, Float, UInt32

from plr_jax._arrays import padded_size
from plr_jax._compiled import part_by_part, pytree
from plr_jax.pairs.occlusion import Flags, Points, Rows, updated
from plr_jax.pairs.portable import crossings, winding
from plr_jax.pairs.tables import NO_WAY, STEEPEST, PairTables
from plr_jax.plr.query import lookup
from plr_jax.plr.tables import gather

_AT_ONCE = 2**14  # pairs of points that fit into caches
_TESTED = 2**10  # pairs tested against the walls of a box together
_FEW = 2**7  # up to so many pairs, each round takes all of them
_SEARCHED = 2**10  # open pairs searched together, if there are more pairs
_LAST_KEY = np.float32(np.inf).view(np.uint32)  # the key of no path
_Lengths = Float[Array, "n"]
_Crossed = tuple[Array, Array]  # whether segments cross walls inward, and whether outward
_ToCorners = Float[Array, "goals size"] | None  # the distances of prepared goals to all corners; None without these


@pytree
class PreparedGoals:
    """Goals with their distances to all corners: a pytree of arrays made by :meth:`PairPLR.prepared`."""

    points: Float[Array, "*batch 2"]  # relative to the middle of the domain, in 32 bits
    to_corners: Float[Array, "*batch size"]  # length of the shortest path to each corner; `inf` without a path


@jax.jit
def distances_to_corners(tables: PairTables, points: Points) -> Float[Array, "n size"]:
    """Return the length of the shortest path from each point to each obstacle corner; ``inf`` without a path.

    Points are relative to the middle of the domain. Rows are padded with ``inf``.
    """
    leaf: Any = lookup(tables.partition, points)
    legs_of_points = _legs(tables, leaf, points)

    def by_corner(column: Array, lengths: Float[Array, "n size"]) -> Float[Array, "n size"]:
        place = jnp.full(leaf.shape, column, jnp.uint32)
        hidden = _is_leg_hidden(tables, leaf, place, points, _corner_of(tables, leaf, place))
        leg = jnp.where(hidden, jnp.inf, legs_of_points[:, column])
        return jnp.minimum(lengths, leg[:, None] + tables.distances[tables.listed[leaf, place]])

    none = jnp.full((points.shape[0], len(tables.distances)), jnp.inf, jnp.float32)
    return jax.lax.fori_loop(0, tables.x.shape[1], by_corner, none)


@pytree
class _Search:
    """The state of a search for the shortest paths between pairs of points."""

    length: _Lengths  # of the shortest path found so far, `inf` if there is none
    via_x: Rows  # place of the path's first turn in the list of the first point's leaf; the list's length if straight
    via_y: Rows  # place of the path's last turn in the list of the second point's leaf; the list's length if straight
    key: Rows  # smallest of the pair's keys that is not yet tried: see :func:`_after_all_rounds`
    # A bit for each corner of the second point's list: whether it is known to be hidden from the point.
    hidden_y: UInt32[Array, "n words"]


@pytree
class Ways:
    """The shortest paths between pairs of points: lengths, and the first and last turns."""

    length: _Lengths  # of the shortest path found, `inf` if there is none
    least: _Lengths  # lower bound of the length of any path
    from_x: Points  # first turn after the first point; the second point if the path is straight or missing
    from_y: Points  # last turn before the second point; the first point if straight, missing or not known


def shortest_ways(
    tables: PairTables, x: Points, y: Points, to_corners: _ToCorners = None, goal: Rows | None = None
) -> Ways:
    """Find shortest paths between points ``x`` and ``y``, both relative to the middle of the domain.

    If ``y`` are prepared goals, ``to_corners`` has the distances of goals to all corners, and ``goal`` the row of
    each ``y`` in ``to_corners``. Otherwise, lengths are equal to the last bit if ``x`` and ``y`` are swapped,
    unless the tables have arcs (links of a building).
    """
    if goal is not None:
        return part_by_part(partial(_ways, tables, to_corners), _AT_ONCE, x, y, goal)
    if tables.has_arcs:
        return part_by_part(partial(_ways, tables, None), _AT_ONCE, x, y)
    swaps = ((x[:, 0] > y[:, 0]) | ((x[:, 0] == y[:, 0]) & (x[:, 1] > y[:, 1])))[:, None]
    ways = part_by_part(partial(_ways, tables, None), _AT_ONCE, jnp.where(swaps, y, x), jnp.where(swaps, x, y))
    from_x, from_y = jnp.where(swaps, ways.from_y, ways.from_x), jnp.where(swaps, ways.from_x, ways.from_y)
    return replace(ways, from_x=from_x, from_y=from_y)


def _ways(tables: PairTables, to_corners: _ToCorners, x: Points, y: Points, goal: Rows | None = None) -> Ways:
    """Find the shortest path from each ``x[i]`` to ``y[i]``: straight, or through corners that their leaves list.

    For ``to_corners`` and ``goal`` see :func:`shortest_ways`.
    """
    leaf_x: Any = lookup(tables.partition, x)
    leaf_y: Any = lookup(tables.partition, y) if goal is None else goal
    size = len(tables.distances)
    listed = tables.listed[leaf_x].astype(jnp.uint32)
    longest = tables.x.shape[1]
    # 1. Bound the path length through each corner of the first point's list, |x - i| + `onward`. Between points,
    #    `onward` is a linear function of y, unpacked from `PairTables.onward`: length + slopes . (y - middle), with
    #
    #        bits 24 to 31: slope along y   bits 16 to 23: slope along x   bits 0 to 15: length at the leaf's middle
    #
    #    For a prepared goal, it is the distance of the corner to the goal.
    if to_corners is not None:
        onward = gather(to_corners.ravel(), leaf_y[:, None] * size + listed)
    else:
        packed = gather(tables.onward.ravel(), leaf_y[:, None] * size + listed)
        length = jnp.where(packed & NO_WAY == NO_WAY, jnp.inf, (packed & NO_WAY).astype(jnp.float32) * tables.step)
        # A slope is stored as `STEEPEST * (1 + slope)`.
        slopes = ((packed >> shift & 255).astype(jnp.float32) - STEEPEST for shift in (np.uint32(16), np.uint32(24)))
        away = (y - tables.middles[leaf_y]) / STEEPEST
        onward = length + sum(slope * along[:, None] for slope, along in zip(slopes, away.T, strict=True))
    # A key has the bits of the bound, the last ones replaced by the place of the corner in the list.
    bounds = jax.lax.bitcast_convert_type(jnp.maximum(_legs(tables, leaf_x, x) + onward, 0), jnp.uint32)
    keys = jax.lax.optimization_barrier(bounds & ~_place_bits(longest) | np.arange(longest, dtype=np.uint32)[None])
    # 2. Finish the pairs that see one another.
    straight = jnp.where(is_hidden(tables, x, y), jnp.inf, _norm(x - y))
    none_hidden = jnp.zeros((x.shape[0], -(-longest // 32)), jnp.uint32)
    no_turn = jnp.full(x.shape[0], longest, jnp.uint32)
    search = _Search(straight, no_turn, no_turn, keys.min(axis=1), none_hidden)
    # 3. Search in rounds. Then look up the turns.
    search = _after_all_rounds(partial(_after_round, tables, to_corners), search, x, y, leaf_x, leaf_y, keys)
    is_straight = (search.via_x == longest)[:, None]
    from_x = jnp.where(is_straight, y, _corner_of(tables, leaf_x, jnp.minimum(search.via_x, longest - 1)))
    from_y = x
    if goal is None:
        from_y = jnp.where(is_straight, x, _corner_of(tables, leaf_y, jnp.minimum(search.via_y, longest - 1)))
    return Ways(search.length, jnp.minimum(search.length, _bound_of(search.key, longest)), from_x, from_y)


def _after_all_rounds(after_round: Callable[..., _Search], search: _Search, *pairs: Array) -> _Search:
    """Repeat ``after_round`` until no pair of points has a corner left to try that may give a shorter path.

    ``pairs`` are arrays with a row for each pair of points: the points ``x`` and ``y``; the leaves that hold the
    points, for prepared goals the index of the goal instead of the second leaf; and keys, ``(n, longest)``. A key is
    for a corner that the leaf of ``x`` lists: a lower bound of the path length through the corner and, in the last
    bits, the corner's place in the list.
    """
    # Compilers find a minimum of keys fast, but the place of a minimum slowly. Bits of floats of at least 0 are in
    # the order of the floats. The search ends: each round drops a corner from a list of each open pair of points.
    size, longest = pairs[-1].shape

    def is_open(search: _Search) -> Flags:
        return _bound_of(search.key, longest) < search.length

    def next_round(search: _Search) -> _Search:
        if not is_symbolic_dim(size) and size > _FEW:  # only the open pairs
            return updated(search, is_open(search), _SEARCHED, after_round, *pairs, leaves_rest=True)
        stays = ~is_open(search)
        after = after_round(search, *pairs)
        return jax.tree.map(lambda a, b: jnp.where(jnp.expand_dims(stays, range(1, a.ndim)), a, b), search, after)

    return jax.lax.while_loop(lambda search: is_open(search).any(), next_round, search)


def _after_round(tables: PairTables, to_corners: _ToCorners, search: _Search, *pairs: Array) -> _Search:
    """Return the state of the search after trying one more first turn for each pair of points.

    This turn is the corner that ``search.key`` encodes, from the list of the first point's leaf. For ``pairs`` see
    :func:`_after_all_rounds`.
    """
    # Below, `first` and `last` are places in lists, `corner` is an index of a corner, and `turn_x` is a point.
    x, y, leaf_x, leaf_y, keys = pairs
    size = len(tables.distances)
    # 1. Decode the place of the first turn. The next key is the least one that is larger.
    first = search.key & _place_bits(keys.shape[1])
    next_key = jnp.where(keys > search.key[:, None], keys, _LAST_KEY).min(axis=1)
    turn_x = _corner_of(tables, leaf_x, first)
    corner = tables.listed[leaf_x, first].astype(jnp.uint32)
    if to_corners is not None:  # the distance from the first turn to a prepared goal is known
        length = _norm(x - turn_x) + gather(to_corners.ravel(), leaf_y * size + corner)
        better = ~_is_leg_hidden(tables, leaf_x, first, x, turn_x) & (length < search.length)
        length, via_x = jnp.where(better, length, search.length), jnp.where(better, first, search.via_x)
        return replace(search, length=length, via_x=via_x, key=next_key)
    # 2. Find the last turn of the shortest path from there. Corners that are known to be hidden are left out: place p
    #    in a list has bit p % 32 of word p // 32 of `hidden_y`.
    columns = np.arange(keys.shape[1], dtype=np.uint32)[None]
    bits = search.hidden_y[:, :, None] >> np.arange(32, dtype=np.uint32)[None, None]
    is_left_out = (bits.reshape(bits.shape[0], -1)[:, : columns.size] & 1).astype(bool)
    listed = tables.listed[leaf_y].astype(jnp.uint32)
    onward = _legs(tables, leaf_y, y) + gather(tables.distances.ravel(), corner[:, None] * size + listed)
    onward = jax.lax.optimization_barrier(jnp.where(is_left_out, jnp.inf, onward))
    shortest = onward.min(axis=1)  # from the first turn to y
    last = jnp.where(onward == shortest[:, None], columns, columns.size - 1).min(axis=1)
    # 3. Test both legs together, and compare the path with the shortest one so far.
    legs = ((leaf_x, leaf_y), (first, last), (x, y), (turn_x, _corner_of(tables, leaf_y, last)))
    hidden_x, hidden_y = jnp.split(_is_leg_hidden(tables, *map(jnp.concatenate, legs)), 2)
    length = jnp.where(hidden_x | hidden_y, jnp.inf, _norm(x - turn_x) + shortest)
    better = length < search.length
    word = np.arange(search.hidden_y.shape[1], dtype=np.uint32)[None] == (last >> 5)[:, None]
    bit = jnp.where(word & hidden_y[:, None], jnp.uint32(1) << (last & 31)[:, None], 0)
    changes = (length, search.length), (first, search.via_x), (last, search.via_y)
    length, via_x, via_y = (jnp.where(better, new, old) for new, old in changes)
    # 4. Go on to the next first turn if it is hidden, or the path was possible, or no last turn is left. Else only
    #    the last turn is hidden: the next round tries another one.
    key = jnp.where(hidden_x | ~hidden_y | (shortest == jnp.inf), next_key, search.key)
    return _Search(length, via_x, via_y, key, search.hidden_y | bit)


def _place_bits(longest: int) -> np.uint32:
    # The lower bits of a key hold a place in a list, as many bits as places need. The other bits are a float's.
    return np.uint32(padded_size(longest) - 1)


def _bound_of(key: Rows, longest: int) -> _Lengths:
    # Without its last bits the bound is rounded down, so it is still a lower bound.
    return jax.lax.bitcast_convert_type(key & ~_place_bits(longest), jnp.float32)


def _legs(tables: PairTables, leaf: Rows, x: Points) -> Float[Array, "n longest"]:
    # The distances of points to the corners that their leaves list.
    dx, dy = tables.x[leaf] - x[:, :1], tables.y[leaf] - x[:, 1:]
    return jnp.sqrt(dx * dx + dy * dy)


def _corner_of(tables: PairTables, leaf: Rows, place: Rows) -> Points:
    return jnp.stack([tables.x[leaf, place], tables.y[leaf, place]], axis=1)


def _norm(v: Points) -> _Lengths:
    return jnp.sqrt(v[:, 0] * v[:, 0] + v[:, 1] * v[:, 1])


def _is_leg_hidden(tables: PairTables, leaf: Rows, place: Rows, x: Points, corner: Points) -> Flags:
    return is_hidden(tables, x, corner) if tables.near is None else tables.near.hide(leaf, place, x, corner)


def is_hidden(tables: PairTables, x: Points, y: Points) -> Flags:
    """Return whether obstacles hide points ``x[i]`` and ``y[i]`` from each other.

    Points are relative to the middle of the domain.
    """
    # Walls have moved a little into their obstacles, so a segment through an obstacle crosses one wall inward and
    # another outward. A single crossing is due to rounding, or to thin obstacles whose walls moved past one another.
    # It counts only if `tables.is_certain`: then paths must be certainly free.
    size = x.shape[0]
    takes_all = is_symbolic_dim(size) or size <= _TESTED
    (px, py), (dx, dy) = x.T, (y - x).T

    # Test the walls, group by group.
    def cross(crossed: _Crossed, walls: Any, x: Points, y: Points) -> _Crossed:
        goes_in, goes_out = crossed
        for wall in walls:
            inward, outward = crossings(x.T, y.T, wall)
            goes_in, goes_out = goes_in | inward, goes_out | outward
        return goes_in, goes_out

    def cross_group(crossed: _Crossed, group: tuple[Array, Array]) -> tuple[_Crossed, None]:
        walls, (middle_x, middle_y, half_x, half_y) = group
        if takes_all:
            return cross(crossed, walls, x, y), None
        # Test only pairs whose segment no axis separates from the box: both coordinate axes, and the axis across the
        # segment. The segment's middle is at d / 2, the box's at `to`, both seen from the segment's start.
        along_x, along_y, to_x, to_y = jnp.abs(dx), jnp.abs(dy), middle_x - px, middle_y - py
        meets = (jnp.abs(dx - 2 * to_x) <= along_x + 2 * half_x) & (jnp.abs(dy - 2 * to_y) <= along_y + 2 * half_y)
        meets &= jnp.abs(dx * to_y - dy * to_x) <= along_x * half_y + along_y * half_x
        is_open = meets & ~(crossed[0] & crossed[1])
        return updated(crossed, is_open, _TESTED, lambda crossed, *ends: cross(crossed, walls, *ends), x, y), None

    none, walls = jnp.zeros(size, bool), tables.walls
    goes_in, goes_out = jax.lax.scan(cross_group, (none, none), (walls.groups, walls.boxes))[0]
    return goes_in | goes_out if tables.is_certain else goes_in & goes_out


def is_inside(tables: PairTables, x: Points) -> Flags:
    """Return whether points are in the free space that ``tables.walls`` enclose, where the winding number is 1.

    Points are relative to the middle of the domain.
    """

    def winds(turns, walls):
        for wall in walls:
            up, down = winding(x.T, wall)
            turns += up.astype(int) - down.astype(int)
        return turns, None

    return jax.lax.scan(winds, jnp.zeros(x.shape[0], int), tables.walls.groups)[0] == 1
