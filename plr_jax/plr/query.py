"""Evaluation of a PLR in JAX: find each point's leaf without descending the tree, and evaluate the leaf's function.

A query passes these steps::

    _as_float_points    check the points, and choose 32 or 64 bits
    outside_domain      find the points outside, whose answer is inf or NaN; _clamp moves them inside
    _fold               map points by mirror symmetries into the part of the domain that the tree covers
    _wrap               along periodic axes, move points by whole periods into the domain
    find_row            turn the bits of each point's position into the row of its leaf's parameters (tables.py)
    _value              evaluate the function of the leaf

On a CPU, in 32 bits, answers equal those of the NumPy and C readers bit for bit, except for numbers below 1e-38. So
products are not fused with sums (:func:`without_fusion`), and all steps of a query must see the same rounded point.
"""

from dataclasses import dataclass, replace
from functools import reduce
from operator import add, or_

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt32

from plr_jax.plr.frame import WORD_BITS, Frame, Outside, require_resolved
from plr_jax.plr.tables import Blocks, FoldedDomain, Tables, Trie, gather

Points = Float[Array, "*batch dim"]
Values = Float[Array, "*batch"]
Flags = Bool[Array, "*batch"]
Bits = UInt32[Array, "*batch"]
_EXPONENT = np.uint32(0xFF800000)  # mask of the sign and exponent of a 32-bit float
_SUBNORMALS = np.uint32(0xFFFFFE)  # number of subnormal 32-bit floats, of either sign
_SHIFTS = np.uint32(WORD_BITS - 1)  # a mask that tells the compiler that no shift is by 32 bits or more
_ENDS_IN_DOUBLE = 2.0**-44  # relative error of the domain's ends in the tables, for 64-bit points


# Queries


def evaluate_tables(tables: Tables, x: Array, outside: Outside = "inf") -> Values:
    """Return the PLR's distance at each point ``x``, ``(..., dim)``; NaN where a coordinate is NaN.

    ``outside`` is the answer outside the domain: see :data:`~plr_jax.plr.frame.Outside`.
    """
    x = _as_float_points(tables, x)
    # 1. Clamped points take the value at the nearest point of the domain, plus the distance to it.
    if outside == "clamp":
        nearest, distance = _clamp(tables if tables.folding is None else tables.folding, x)
        return evaluate_tables(tables, nearest) + distance
    # 2. Evaluate the leaf's function. The domain before folding decides what is outside.
    if tables.folding is not None:
        is_outside, answer = outside_domain(tables.folding, x)
        value = evaluate_tables(replace(tables, folding=None), _fold(tables.folding, x, is_outside))
    else:
        x = _wrap(tables, x) if tables.periodic else x
        is_outside, answer = outside_domain(tables, x)
        value = _value(tables, find_row(tables, _constant(x)), x, is_outside)
        if tables.straight is not None:
            value = jnp.maximum(value, _straight_bound(tables, x, is_outside))
    # 3. Replace answers outside the domain.
    return jnp.where(is_outside, jnp.full_like(answer, np.nan) if outside == "nan" else answer, value)


def bounds_of_tables(tables: Tables, band: Float[Array, "2 rows"], x: Array) -> tuple[Values, Values]:
    """Return proven lower bounds (at least 0) and upper bounds of the distance at each point, rounded outward.

    ``band`` has bounds of distance minus PLR value: lower bounds in row 0, upper bounds in row 1. It has a column for
    each leaf, or one column for all leaves. Where the PLR's value is not finite, both results equal this value.
    """
    value = evaluate_tables(tables, x)
    # 1. Look up the leaf's bounds of the error.
    if band.shape[1] == 1:
        below, above = band[0, 0], band[1, 0]
    else:
        leaf = lookup(tables, _constant(x.astype(value.dtype)))
        below, above = gather(band[0], leaf), gather(band[1], leaf)

    # 2. Add them to the value, rounded outward. Straight motions may give a larger lower bound.
    def value_plus(error: Array, toward: float) -> Values:
        bound = value + error.astype(value.dtype)
        return straight_through(bound, jnp.nextafter(_constant(bound), jnp.asarray(toward, value.dtype)))

    lower, upper = jnp.maximum(value_plus(below, -np.inf), 0), value_plus(above, np.inf)
    if tables.straight is not None:
        x = _as_float_points(tables, x)
        x = _wrap(tables, x) if tables.periodic else x
        lower = jnp.maximum(lower, _straight_bound(tables, x, value == np.inf))
    return jnp.where(value < np.inf, lower, value), jnp.where(value < np.inf, upper, value)


def goals_in_tables(tables: Tables, goals: Int[Array, " rows"], x: Array) -> Int[Array, "*batch"]:
    """Return the index of the goal to which each point's leaf leads; -1 where the distance is not finite.

    ``goals`` has the index of each leaf's goal.
    """
    x = _constant(_as_float_points(tables, x))
    return jnp.where(jnp.isfinite(evaluate_tables(tables, x)), gather(goals, lookup(tables, x)), -1)


def waypoints_in_tables(tables: Tables, x: Array) -> Points:
    """Return each point's next waypoint, the apex of its leaf's cone.

    The waypoint is NaN outside the closed domain and where a coordinate is NaN.
    """
    x = _constant(_as_float_points(tables, x))
    outside, answer = outside_domain(tables, x)
    source = jnp.stack(tables.leaf.source_of(_leaf_parameters(tables, find_row(tables, x), x.dtype)), axis=-1)
    source = jnp.broadcast_to(tables.frame[Frame.LO], source.shape).astype(x.dtype) + source
    return jnp.where((outside | jnp.isnan(answer))[..., None], np.nan, source)


def lookup(tables: Tables, x: Points) -> Bits:
    """Return the index of each point's leaf; next to a border, rounding may give the leaf on the other side.

    Outside the domain and where a coordinate is NaN, the index is that of an arbitrary leaf.
    """
    if tables.folding is not None:
        return lookup(replace(tables, folding=None), _fold(tables.folding, x, jnp.zeros(x.shape[:-1], bool)))
    row = find_row(tables, _wrap(tables, x) if tables.periodic else x)
    return row if tables.pages is None else gather(tables.leaf_of_slot, row).astype(np.uint32)


# Points: their type, and their place in the domain


def _as_float_points(tables: Tables, x: Array) -> Points:
    if x.ndim == 0 or x.shape[-1] != tables.dim:
        raise ValueError(f"Points must have shape (..., {tables.dim}), got {x.shape}.")
    if not (jnp.issubdtype(x.dtype, jnp.floating) or jnp.issubdtype(x.dtype, jnp.integer)):
        raise ValueError(f"Points must be real numbers, got an array of {x.dtype}; convert them to floats.")
    x = x.astype(x.dtype if x.dtype == np.float64 else np.float32)
    if tables.unresolved:
        require_resolved(x.dtype, tables.unresolved)
    return x


def outside_domain(tables: Tables | FoldedDomain, x: Points) -> tuple[Flags, Values]:
    """Return whether points are outside the closed domain, and the answer for points outside.

    Along periodic axes, all finite coordinates are inside. The answer is ``inf``, or NaN if a coordinate is NaN.
    """
    x, frame = _constant(x), tables.frame.astype(x.dtype)
    outside, answer = jnp.zeros(x.shape[:-1], bool), jnp.full(x.shape[:-1], np.inf, x.dtype)
    for axis in range(tables.dim):
        above = x[..., axis] - frame[Frame.LO, axis]
        answer += jnp.abs(above)  # NaN if any coordinate is
        if axis in tables.periodic:
            outside |= jnp.isinf(above)
        elif x.dtype == np.float64:  # compare with the exact corners, LO + LO_REST and HI - HI_REST
            below = frame[Frame.HI, axis] - x[..., axis]
            outside |= (above < frame[Frame.LO_REST, axis]) | (below < frame[Frame.HI_REST, axis])
        else:  # compare with the rounded corners
            lo, hi, bits = frame[Frame.LO, axis], frame[Frame.HI, axis], x[..., axis].view(np.uint32)
            # XLA takes subnormal numbers for 0; their bits tell whether they are beyond an end at 0.
            is_subnormal = (bits << np.uint32(1)) - np.uint32(2) < _SUBNORMALS
            is_beyond_zero = is_subnormal & (jnp.where(bits >> np.uint32(31) != 0, lo, hi) == 0)
            outside |= (above < 0) | (x[..., axis] > hi) | is_beyond_zero
    return outside, answer


def _clamp(domain: Tables | FoldedDomain, x: Points) -> tuple[Points, Float[Array, "*#batch"]]:
    """Return, for each point, the nearest point of the domain and the distance to it.

    A point that is not finite does not move, and has distance 0.
    """
    is_finite = jnp.isfinite(x).all(axis=-1)
    nearest = [x[..., axis] for axis in range(domain.dim)]
    beyond = []  # differences to the nearest point, along axes that are not periodic
    for axis in range(domain.dim):
        if axis in domain.periodic:
            continue
        frame, along = domain.frame[:, axis].astype(x.dtype), nearest[axis]
        lo, hi = frame[Frame.LO], frame[Frame.HI]
        if x.dtype == np.float64:  # the outermost coordinates that ``outside_domain`` accepts
            lo, hi = lo + frame[Frame.LO_REST], hi - frame[Frame.HI_REST]
            lo = jnp.where(lo - frame[Frame.LO] < frame[Frame.LO_REST], jnp.nextafter(lo, np.inf), lo)
            hi = jnp.where(frame[Frame.HI] - hi < frame[Frame.HI_REST], jnp.nextafter(hi, -np.inf), hi)
        inside = jnp.where(along < lo, lo, jnp.where(along > hi, hi, along))
        nearest[axis] = jnp.where(is_finite, inside, along)
        beyond.append(jnp.where(is_finite, along - inside, 0))
    distance = length_of(beyond) if beyond else jnp.zeros(is_finite.shape, x.dtype)
    return jnp.stack(nearest, axis=-1), distance


def length_of(along: list[Values]) -> Float[Array, "*#batch"]:
    """Return the lengths of vectors, without overflow or underflow; the gradient at 0 is 0.

    ``along`` has an array of coordinates for each axis.
    """
    # |v| = s * |v / s|, with s the largest coordinate.
    largest = _constant(reduce(jnp.maximum, map(jnp.abs, along)))
    scale = jnp.where(largest > 0, largest, 1)
    square = reduce(add, (without_fusion(jnp.square(each / scale)) for each in along))
    return without_fusion(scale * jnp.where(largest > 0, jnp.sqrt(jnp.where(largest > 0, square, 1)), 0))


def _fold(domain: FoldedDomain, x: Points, outside: Flags) -> Points:
    # 1. Change the coordinates: z = A (x - center). Points outside the domain go to the center of the mirrors.
    axes = range(domain.dim)
    center, remainder = domain.center.astype(x.dtype)  # the center is their sum
    z = [jnp.where(outside, 0, without_fusion(x[..., axis] - center[axis]) - remainder[axis]) for axis in axes]
    if domain.axes is not None:
        turned = domain.axes.astype(x.dtype)
        z = [reduce(add, (without_fusion(turned[row, axis] * z[axis]) for axis in axes)) for row in axes]
    # 2. Mirror: negate the axes of each mirror at points whose pivot coordinate is negative.
    for pivot, reversed_axes in domain.mirrors:
        is_behind = z[pivot] < 0
        for axis in reversed_axes:
            z[axis] = jnp.where(is_behind, -z[axis], z[axis])
    # 3. Clip: only rounding can put coordinates outside.
    lo, hi = domain.corners.astype(x.dtype)
    columns = [straight_through(z[axis], jnp.clip(_constant(z[axis]), lo[axis], hi[axis])) for axis in axes]
    # Keep XLA from repeating the folding wherever a coordinate is read.
    return jnp.moveaxis(jax.lax.optimization_barrier(jnp.stack(columns)), 0, -1)


def _wrap(tables: Tables, x: Points) -> Points:
    """Move points by whole periods into the domain along periodic axes; the upper end becomes the lower end."""
    # x - floor((x - lo) / (hi - lo)) * (hi - lo)
    columns = [x[..., axis] for axis in range(tables.dim)]
    for axis in tables.periodic:
        along, frame = _constant(columns[axis]), tables.frame[:, axis].astype(x.dtype)
        lo, hi = frame[Frame.LO] + frame[Frame.LO_REST], frame[Frame.HI] - frame[Frame.HI_REST]
        turns = jnp.floor((along - lo) * frame[Frame.SCALE])
        is_end = jnp.abs(along - hi) <= _ENDS_IN_DOUBLE * jnp.maximum(jnp.abs(lo), jnp.abs(hi))
        # Without fusion, all parts of a query see the same point.
        inside = jnp.where(is_end, lo, jnp.clip(along - without_fusion(turns * (hi - lo)), lo, hi))
        columns[axis] = straight_through(columns[axis], jnp.where(jnp.isfinite(along), inside, along))
    return jnp.stack(columns, axis=-1)


# The row of each point's leaf


def find_row(tables: Tables, x: Points) -> Bits:
    """Return, for each point, the index at which ``tables.leaf_parameters`` has the parameters of the point's leaf.

    Along periodic axes, points must lie in the domain.
    """
    # The highest bits of a point's position select an entry of a flat table, or a block of a coarse grid. In a block,
    # lower bits select an entry of the block's table or page:
    #
    #     fraction bits of an axis  | block | entry within the block | not used |
    #
    if tables.trie is not None:
        return _row_in_trie(tables, tables.trie, x)
    fractions = [_fraction_bits(tables, x, axis) for axis in range(tables.dim)]
    index = _join_bits(fractions, *tables.bits)
    if tables.pages is not None:  # the row is the page's start, plus those bits below the block that the word selects
        mask, right, start = tables.pages.bits
        word = gather(tables.pages.words, index)
        return (word >> (start[0] & _SHIFTS)) + (word & _join_bits(fractions, mask, right))
    if tables.blocks is not None:
        index = _index_in_block(tables.blocks, fractions, index)
    return gather(tables.leaf_of_slot, index).astype(np.uint32)


def _fraction_bits(tables: Tables, x: Points, axis: int) -> Bits:
    # 1 plus the point's fraction of the domain is ``placed`` = (x - lo) * scale + start, from 1 to below 2. Its bits:
    #   | sign and exponent, always the same | 23 bits of the fraction |
    rows = Frame.LO, Frame.START, Frame.SCALE, Frame.TOP
    lo, start, scale, top = (tables.frame[row, axis].astype(x.dtype) for row in rows)
    scaled = (x[..., axis] - lo) * scale
    # The minimum (``where``) separates product and sum. If a compiler fused them in only one part of a query, a point
    # near a border could get the block (coarse cell) of one leaf and the entry of another.
    # The maximum keeps points that rounding puts below the lower edge from wrapping to the upper edge.
    return jnp.maximum(jnp.where(scaled < top, scaled, top) + start, 1).astype(np.float32).view(np.uint32)


def _join_bits(fractions: list[Bits], mask: UInt32[Array, " dim"], right: UInt32[Array, " dim"]) -> Bits:
    # A row-major index: the bits under each axis's mask, side by side, the last axis lowest.
    return reduce(or_, [(bits & mask[axis]) >> (right[axis] & _SHIFTS) for axis, bits in enumerate(fractions)])


def _index_in_block(blocks: Blocks, fractions: list[Bits], block: Bits) -> Bits:
    # Index into ``Tables.leaf_of_slot``; ``block`` is a point's cell of the coarse grid. Axis by axis, a field of the
    # block's word says how many fraction bits below the block go into the index:
    #
    #   first word                | start of the table | ... | bits of axis 1 | bits of axis 0 |
    #   fraction bits of an axis  | block | index bits | below the slot |
    #                                     | <------ shift ------------> |
    index = start = jnp.zeros_like(block)
    axis = 0
    for number, (words, num_fields) in enumerate(zip(blocks.words, blocks.axes, strict=True)):
        word = gather(words, block)
        for field in range(num_fields):
            bits = (word >> np.uint32(field * blocks.width)) & np.uint32(2**blocks.width - 1)
            within = fractions[axis] & ((np.uint32(1) << (blocks.shift[axis] & _SHIFTS)) - np.uint32(1))
            index = (index << bits) | (within >> ((blocks.shift[axis] - bits) & _SHIFTS))
            axis += 1
        if number == 0:
            start = word >> np.uint32(num_fields * blocks.width)
    return start + index


def _row_in_trie(tables: Tables, trie: Trie, x: Points) -> Bits:
    """Return the index of the parameters of each point's leaf in a stack of PLRs, by descending the stack's trie.

    A trie is a lookup table that is read level by level, from coarse to fine.
    """

    # Entry 2 * i + 1 leads to the page that starts at entry i, where the point's bits select an entry. Entry 2 * i
    # leads to row i; it reads entry i, which is 2 * i again.
    def descend(entry: Bits, bits: UInt32[Array, "2 dim"]) -> Bits:
        fractions = [_fraction_bits(tables, x, axis) for axis in range(tables.dim)]
        is_page = np.uint32(0) - (entry & np.uint32(1))  # all ones or zero
        return gather(trie.entries, (entry >> np.uint32(1)) + (_join_bits(fractions, bits[0], bits[1]) & is_page))

    entry = descend((trie.start << np.uint32(1)) | np.uint32(1), trie.bits[0])
    for level in range(1, len(trie.bits)):
        # XLA should compile each level to a loop of its own, so that reads of many points overlap. This condition
        # always holds, but XLA cannot know that, and does not fuse the loops.
        bits = trie.bits[level]
        entry = jax.lax.cond(bits.any(), lambda entry, bits=bits: descend(entry, bits), jnp.zeros_like, entry)
    return entry >> np.uint32(1)


# Functions of leaves


def _value(tables: Tables, row: Bits, x: Points, outside: Flags) -> Values:
    """Return the value of each point's leaf function; ``row`` has the index of the leaf's parameters.

    At points ``outside`` the domain, the value has no meaning.
    """
    parameters = _leaf_parameters(tables, row, x.dtype)
    frame = tables.frame.astype(x.dtype)
    place = []  # where the leaf's function is evaluated, axis by axis
    for axis in range(tables.dim):
        along = x[..., axis] - frame[Frame.LO, axis]
        if tables.leaf.is_cell_relative:
            # Local coordinate, from 0 to 1, or slightly beyond where the lookup rounds across a border. With u the
            # fraction of the domain, it is u * 2**depth - position. Products and the difference are exact, so both
            # leaves at a face see the same point. For depth 2 and position 1:
            #
            #     u                  0 |-----|--x--|-----|-----| 1
            #     local coordinate           0     1
            #
            # An axis stores the float 2**depth + position, whose exponent alone is 2**depth.
            u = without_fusion(along * frame[Frame.SCALE, axis]) + (frame[Frame.START, axis] - 1)
            bits = parameters[axis].astype(np.float32).view(np.uint32)
            num_cells = (bits & _EXPONENT).view(np.float32).astype(u.dtype)  # 2**depth
            along = u * num_cells - (parameters[axis] - num_cells)
        # Differentiate as at 0 outside the domain, where ``0 * inf`` would give NaN.
        place.append(_Unfused(jnp.where(outside, 0, along)))
    of_function = [_Unfused(value) for value in parameters[tables.dim * tables.leaf.is_cell_relative :]]
    return tables.leaf.value(of_function, place, lambda square: _Unfused(_root(square.value))).value


def _leaf_parameters(tables: Tables, row: Bits, dtype: np.dtype) -> list[Values]:
    # Parameters are stored in columns, or row by row in a flat table (``arrange_parameters``).
    numbers, count = tables.leaf_parameters, tables.leaf.num_leaf_parameters(tables.dim)
    if numbers.ndim == 2:
        return [gather(numbers[i], row).astype(dtype) for i in range(len(numbers))]
    return [gather(numbers, row * np.uint32(count) + np.uint32(i)).astype(dtype) for i in range(count)]


@dataclass(frozen=True)
class _Unfused:
    """An array whose products are not fused with sums: each product is rounded, as the file format requires."""

    value: Values

    def __add__(self, other: "_Unfused") -> "_Unfused":
        return _Unfused(self.value + other.value)

    def __sub__(self, other: "_Unfused") -> "_Unfused":
        return _Unfused(self.value - other.value)

    def __mul__(self, other: "_Unfused") -> "_Unfused":
        return _Unfused(without_fusion(self.value * other.value))


def _straight_bound(tables: Tables, x: Points, outside: Flags) -> Values:
    # Along periodic axes, points must lie in the domain. At points ``outside``, the bound has no meaning. With the
    # arrays of a :class:`StraightBound`, the bound is
    #   max(min over goals of (sum over groups of rate * sqrt(sum over the group's axes of change**2)) - margin, 0)
    goals, groups, rates, margin = (each.astype(x.dtype) for each in tables.straight or ())
    frame = tables.frame.astype(x.dtype)
    ends = (frame[Frame.HI] - frame[Frame.HI_REST]) - (frame[Frame.LO] + frame[Frame.LO_REST])
    least = jnp.full(x.shape[:-1], np.inf, x.dtype)
    for goal in range(goals.shape[0]):
        squares = []
        for axis in range(tables.dim):
            # Differentiate as at 0 outside the domain, as in `_value`.
            along = jnp.where(outside, 0, without_fusion(x[..., axis] - frame[Frame.LO, axis]))
            change = along - goals[goal, axis]
            if axis in tables.periodic:  # the short way around
                change = jnp.minimum(jnp.abs(change), ends[axis] - jnp.abs(change))
            squares.append(without_fusion(jnp.square(change)))
        cost = jnp.zeros_like(least)
        for group in range(groups.shape[0]):
            square = reduce(add, (without_fusion(groups[group, axis] * squares[axis]) for axis in range(tables.dim)))
            # The root of 0 has no gradient.
            length = jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, jnp.ones_like(square))), square)
            cost = cost + without_fusion(length * rates[group])
        least = jnp.minimum(least, cost)
    return jnp.maximum(least - margin[()], 0)


# Rounding and derivatives


_constant = jax.lax.stop_gradient  # returns its argument, but is differentiated as if it were constant


@jax.custom_jvp
def straight_through(x: Values, to: Values) -> Values:
    """Return ``to``, but differentiate as if the result were ``x`` (a straight-through estimator)."""
    return to


# The rule calls the function itself, so that derivatives of the result are right in the next differentiation, too.
straight_through.defjvp(lambda primals, tangents: (straight_through(*primals), tangents[0]))


def without_fusion(value: Values) -> Values:
    """Return ``value``, a product or sum, such that the compiler cannot fuse it with later operations."""
    # The selection returns the value itself, but compilers do not fuse across it.
    constant = _constant(value)
    return straight_through(value, jnp.where(constant == constant, constant, jnp.nan))


@jax.custom_jvp
def _root(square: Values) -> Values:
    """Return the square root; its derivative at 0 (at the apex of a cone) counts as 0."""
    return jnp.sqrt(square)


@_root.defjvp
def _root_tangent(primals, tangents):
    root = _root(primals[0])
    return root, jnp.where(root > 0, tangents[0] / (2 * jnp.where(root > 0, root, 1)), 0)


# Compiled queries

evaluate_points = jax.jit(evaluate_tables)  # separate, as a static argument adds a tenth to the time of a call
evaluate_anywhere = jax.jit(evaluate_tables, static_argnums=2)
bound_points, waypoints_of_points = jax.jit(bounds_of_tables), jax.jit(waypoints_in_tables)
goals_of_points = jax.jit(goals_in_tables)
