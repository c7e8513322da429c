"""A query, in JAX: the leaf that holds a point by arithmetic and one lookup, then the leaf's function."""

from dataclasses import dataclass
from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Num, UInt32

from plr_jax.plr.frame import WORD_BITS, Frame, Outside, require_resolved
from plr_jax.plr.tables import Blocks, FoldedWindow, Tables, Trie, gather, moved, rounded, shift_right

_EXPONENT = np.uint32(0xFF800000)  # and sign, of a 32-bit float
_ENDS_IN_DOUBLE = 2.0**-44
"""How well, in shares of themselves, the tables know ends of the domain; in 32 bits exactly."""


def evaluate_tables(tables: Tables, x: Num[Array, "*batch dim"], outside: Outside = "inf") -> Float[Array, "*batch"]:
    """Value of the leaf's function at each point; outside the closed domain what is asked for, NaN for NaN."""
    x = _in_floats(tables, x)
    if outside == "clamp":
        nearest, way = _clamped(tables if tables.folding is None else tables.folding, x)
        return evaluate_tables(tables, nearest) + way
    if tables.folding is not None:
        is_outside, answer = outside_domain(tables.folding, x)
        value = evaluate_tables(tables.of_folded_points(), tables.folding(x, is_outside))
    else:
        x = _wrapped(tables, x)
        row = find_row(tables, jax.lax.stop_gradient(x))
        is_outside, answer = outside_domain(tables, x)
        value = _value(tables, row, x, is_outside)
    return jnp.where(is_outside, jnp.full_like(answer, jnp.nan) if outside == "nan" else answer, value)


def _in_floats(tables: Tables, x: Num[Array, "*batch dim"]) -> Float[Array, "*batch dim"]:
    """Points in 32 or 64 bits, which must resolve the domain."""
    x = x.astype(x.dtype if x.dtype == jnp.float64 else jnp.float32)
    require_resolved(x.dtype, tables.unresolved)
    return x


def bounds_of_tables(
    tables: Tables, band: Float[Array, "2 rows"], x: Num[Array, "*batch dim"]
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """Lower and upper bounds of the distance at each point: what is answered, and the band of its leaf, or of all.

    Both are rounded outward; the lower one is at least 0.
    """
    value = evaluate_tables(tables, x)
    if band.shape[1] == 1:
        below, above = band[0, 0], band[1, 0]
    else:
        leaf = lookup(tables, jax.lax.stop_gradient(x.astype(value.dtype)))
        below, above = gather(band[0], leaf), gather(band[1], leaf)
    lower, upper = (
        moved(bound, jnp.nextafter(jax.lax.stop_gradient(bound), jnp.asarray(toward, value.dtype)))
        for bound, toward in (
            (value + below.astype(value.dtype), -jnp.inf),
            (value + above.astype(value.dtype), jnp.inf),
        )
    )
    return jnp.where(value < jnp.inf, jnp.maximum(lower, 0), value), jnp.where(value < jnp.inf, upper, value)


def waypoints_in_tables(tables: Tables, x: Num[Array, "*batch dim"]) -> Float[Array, "*batch dim"]:
    """The source of the leaf that holds each point; NaN outside the closed domain, and for NaN."""
    x = jax.lax.stop_gradient(_in_floats(tables, x))
    outside, answer = outside_domain(tables, x)
    numbers = _numbers(tables, find_row(tables, x), x.dtype)
    source = jnp.stack(tables.leaf.source_of(numbers), axis=-1)
    source = jnp.broadcast_to(tables.frame[Frame.LO], source.shape).astype(x.dtype) + source
    return jnp.where((outside | jnp.isnan(answer))[..., None], jnp.nan, source)


def lookup(tables: Tables, x: Float[Array, "*batch dim"]) -> UInt32[Array, "*batch"]:
    """Index of the leaf that holds each point, to within the last bit of a 32-bit fraction of the domain.

    Points outside the domain, and NaN, get some leaf.
    """
    if tables.folding is not None:
        return lookup(tables.of_folded_points(), tables.folding(x, jnp.zeros(x.shape[:-1], bool)))
    row = find_row(tables, _wrapped(tables, x))
    return row if tables.pages is None else gather(tables.leaf_of_slot, row).astype(jnp.uint32)


def find_row(tables: Tables, x: Float[Array, "*batch dim"]) -> UInt32[Array, "*batch"]:
    """Which of the ``numbers`` are for each point: those of its slot, if there are pages, else those of its leaf.

    The points are wrapped.
    """
    if tables.trie is not None:
        return _row_in_trie(tables, tables.trie, x)
    places = [_place(tables, x, axis) for axis in range(tables.dim)]
    index = _joined_bits(places, *tables.bits)
    if tables.pages is not None:
        # Slot of points in given blocks.
        mask, right, start = tables.pages.bits
        word = gather(tables.pages.words, index)
        return shift_right(word, start[0]) + (word & _joined_bits(places, mask, right))
    if tables.blocks is not None:
        index = _index_in_block(tables.blocks, places, index)
    return gather(tables.leaf_of_slot, index).astype(jnp.uint32)


def _index_in_block(
    blocks: Blocks, places: list[UInt32[Array, "*batch"]], block: UInt32[Array, "*batch"]
) -> UInt32[Array, "*batch"]:
    """Index into ``leaf_of_slot`` of points in given blocks."""
    index = start = jnp.zeros_like(block)
    axis = 0
    for number, (table, axes) in enumerate(zip(blocks.words, blocks.axes, strict=True)):
        word = gather(table, block)
        for slot in range(axes):
            bits = (word >> np.uint32(slot * blocks.width)) & np.uint32(2**blocks.width - 1)
            within = places[axis] & ((np.uint32(1) << (blocks.shift[axis] & np.uint32(WORD_BITS - 1))) - np.uint32(1))
            index = (index << bits) | shift_right(within, blocks.shift[axis] - bits)
            axis += 1
        if number == 0:
            start = word >> np.uint32(axes * blocks.width)
    return start + index


def outside_domain(
    tables: Tables | FoldedWindow, x: Float[Array, "*batch dim"]
) -> tuple[Bool[Array, "*batch"], Float[Array, "*batch"]]:
    """Whether each wrapped point is outside the closed domain, and the answer there: ``inf``, NaN for NaN."""
    x, frame = jax.lax.stop_gradient(x), tables.frame.astype(x.dtype)
    outside, answer = jnp.zeros(x.shape[:-1], bool), jnp.full(x.shape[:-1], jnp.inf, x.dtype)
    for axis in range(tables.dim):
        above = x[..., axis] - frame[Frame.LO, axis]
        answer += jnp.abs(above)  # NaN if any coordinate is
        if axis in tables.periodic:
            outside |= jnp.isinf(above)
        elif x.dtype == jnp.float64:  # which can tell the true corners from the rounded ones
            below = frame[Frame.HI, axis] - x[..., axis]
            outside |= (above < frame[Frame.LO_REST, axis]) | (below < frame[Frame.HI_REST, axis])
        else:
            outside |= (above < 0) | (x[..., axis] > frame[Frame.HI, axis])
    return outside, answer


def _clamped(
    window: Tables | FoldedWindow, x: Float[Array, "*batch dim"]
) -> tuple[Float[Array, "*batch dim"], Float[Array, "*#batch"]]:
    """The point of the domain that is nearest to each, and how far that is; points that are not finite stay."""
    is_finite = jnp.isfinite(x).all(axis=-1)
    nearest, beyond = [x[..., axis] for axis in range(window.dim)], []
    for axis in range(window.dim):
        if axis in window.periodic:
            continue
        along, (lo, hi) = nearest[axis], _ends_inside(window, axis, x.dtype)
        inside = jnp.where(along < lo, lo, jnp.where(along > hi, hi, along))
        nearest[axis] = jnp.where(is_finite, inside, along)
        beyond.append(jnp.where(is_finite, along - inside, 0))
    return jnp.stack(nearest, axis=-1), length_of(beyond)


def _ends_inside(window: Tables | FoldedWindow, axis: int, dtype: Any) -> tuple[Float[Array, "*_"], ...]:
    """The outermost coordinates of an axis that ``outside_domain`` calls inside."""
    frame = window.frame[:, axis].astype(dtype)
    lo, hi = frame[Frame.LO], frame[Frame.HI]
    if dtype == jnp.float64:
        lo, hi = lo + frame[Frame.LO_REST], hi - frame[Frame.HI_REST]
        lo = jnp.where(lo - frame[Frame.LO] < frame[Frame.LO_REST], jnp.nextafter(lo, jnp.inf), lo)
        hi = jnp.where(frame[Frame.HI] - hi < frame[Frame.HI_REST], jnp.nextafter(hi, -jnp.inf), hi)
    return lo, hi


def length_of(along: list[Float[Array, "*batch"]]) -> Float[Array, "*#batch"]:
    """Length of vectors of any finite numbers, given axis by axis; of slope 0 at 0."""
    if not along:
        return jnp.zeros(())
    largest = jax.lax.stop_gradient(reduce(jnp.maximum, map(jnp.abs, along)))
    scale = jnp.where(largest > 0, largest, 1)
    square = reduce(jnp.add, (rounded(jnp.square(each / scale)) for each in along))
    return rounded(scale * jnp.where(largest > 0, jnp.sqrt(jnp.where(largest > 0, square, 1)), 0))


def _wrapped(tables: Tables, x: Float[Array, "*batch dim"]) -> Float[Array, "*batch dim"]:
    """Points with their coordinates along periodic axes inside the domain, in the points' own precision."""
    if not tables.periodic:
        return x
    along = [x[..., axis] for axis in range(tables.dim)]  # axis by axis, as the rest of a query computes
    for axis in tables.periodic:
        along[axis] = moved(along[axis], _between_ends(tables, jax.lax.stop_gradient(along[axis]), axis))
    return jnp.stack(along, axis=-1)


def _between_ends(tables: Tables, x: Float[Array, "*batch"], axis: int) -> Float[Array, "*batch"]:
    """Coordinates moved by whole periods to between the ends of an axis, the upper of which becomes the lower.

    A compiler may round the product and the difference at once in one part of a query and apart in another. That
    moves a point by a rounding, but never from one end to the other: the number of periods leaves no such choice.
    """
    frame = tables.frame[:, axis].astype(x.dtype)
    lo, hi = frame[Frame.LO] + frame[Frame.LO_REST], frame[Frame.HI] - frame[Frame.HI_REST]
    turns = jnp.floor((x - lo) * frame[Frame.SCALE])
    is_end = jnp.abs(x - hi) <= _ENDS_IN_DOUBLE * jnp.maximum(jnp.abs(lo), jnp.abs(hi))
    inside = jnp.where(is_end, lo, jnp.clip(x - rounded(turns * (hi - lo)), lo, hi))
    return jnp.where(jnp.isfinite(x), inside, x)


def _value(
    tables: Tables, row: UInt32[Array, "*batch"], x: Float[Array, "*batch dim"], outside: Bool[Array, "*batch"]
) -> Float[Array, "*batch"]:
    """Value of the leaf at each point; if that is ``outside`` the domain, any number will do."""
    numbers, frame, place = _numbers(tables, row, x.dtype), tables.frame.astype(x.dtype), []
    for axis in range(tables.dim):
        along = x[..., axis] - frame[Frame.LO, axis]
        if tables.leaf.is_of_cells:
            u = rounded(along * frame[Frame.SCALE, axis]) + (frame[Frame.START, axis] - 1)
            along = _coordinate_in_cell(u, numbers[axis])
        place.append(_Unfused(_zero_if_differentiated(along, outside)))
    of_leaf = [_Unfused(number) for number in numbers[tables.dim * tables.leaf.is_of_cells :]]
    return tables.leaf.value(of_leaf, place, lambda square: _Unfused(_root(square.value))).value


@dataclass(frozen=True)
class _Unfused:
    """Numbers whose products are rounded before they are added, as the format says."""

    value: Float[Array, "*batch"]

    def __add__(self, other: "_Unfused") -> "_Unfused":
        return _Unfused(self.value + other.value)

    def __sub__(self, other: "_Unfused") -> "_Unfused":
        return _Unfused(self.value - other.value)

    def __mul__(self, other: "_Unfused") -> "_Unfused":
        return _Unfused(rounded(self.value * other.value))


def _numbers(tables: Tables, row: UInt32[Array, "*batch"], dtype: Any) -> list[Float[Array, "*batch"]]:
    """The numbers of each leaf that the tables were built of, at the row that ``find_row`` gave."""
    count = tables.leaf.num_numbers(tables.dim)
    if tables.numbers.ndim == 2:
        return [gather(tables.numbers[which], row).astype(dtype) for which in range(count)]
    first = row * np.uint32(count)
    return [gather(tables.numbers, first + np.uint32(which)).astype(dtype) for which in range(count)]


def _coordinate_in_cell(u: Float[Array, "*batch"], number: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Coordinate, from 0 to 1, in the interval of that number, of a point at ``u`` of the domain.

    Where the lookup rounds a point across a border, the coordinate is beyond 0 or 1 by as much. Products and the
    difference are exact, so both leaves at a face see the same point.
    """
    exponent = jax.lax.bitcast_convert_type(number.astype(jnp.float32), jnp.uint32) & _EXPONENT
    count = jax.lax.bitcast_convert_type(exponent, jnp.float32).astype(u.dtype)
    return u * count - (number - count)


@jax.custom_jvp
def _zero_if_differentiated(t: Float[Array, "*batch"], outside: Bool[Array, "*batch"]) -> Float[Array, "*batch"]:
    """The coordinates, but zero outside the domain where differentiated: zero times a gradient at inf is NaN."""
    return t


@_zero_if_differentiated.defjvp
def _zero_with_tangent(primals, tangents):
    t, outside = primals
    return (jnp.where(outside, jnp.zeros_like(t), t), jnp.where(outside, jnp.zeros_like(t), tangents[0]))


@jax.custom_jvp
def _root(square: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """The square root, whose slope at zero, at a source itself, counts as zero."""
    return jnp.sqrt(square)


@_root.defjvp
def _root_with_tangent(primals, tangents):
    root = jnp.sqrt(primals[0])
    return root, jnp.where(root > 0, tangents[0] / (2 * jnp.where(root > 0, root, 1)), 0)


def _place(tables: Tables, x: Float[Array, "*batch dim"], axis: int) -> UInt32[Array, "*batch"]:
    """A point's place along an axis, in units of ``2**-23`` of the domain's width, in the lower 23 bits of a word.

    Those are the fraction bits of one plus the place, a 32-bit float from 1 to below 2. The last place is for the
    upper edge, which belongs to the last cell.
    """
    lo, start, scale, top = (
        tables.frame[row, axis].astype(x.dtype) for row in (Frame.LO, Frame.START, Frame.SCALE, Frame.TOP)
    )
    share = (x[..., axis] - lo) * scale
    # The bound stands before the sum, or a compiler might round product and sum at once in one part of a query and
    # apart in another, and so put a point beside a border into a block of one cell and a slot of the other.
    # Points that rounding put below the lower edge would be beside the upper one.
    placed = jnp.maximum(jnp.where(share < top, share, top) + start, 1)
    return jax.lax.bitcast_convert_type(placed.astype(jnp.float32), jnp.uint32)


def _joined_bits(
    places: list[UInt32[Array, "*batch"]], mask: UInt32[Array, "dim"], right: UInt32[Array, "dim"]
) -> UInt32[Array, "*batch"]:
    """Some bits of a point's place along each axis, side by side."""
    return reduce(jnp.bitwise_or, [shift_right(place & mask[axis], right[axis]) for axis, place in enumerate(places)])


def _row_in_trie(tables: Tables, trie: Trie, x: Float[Array, "*batch dim"]) -> UInt32[Array, "*batch"]:
    """Row of the numbers of points, level by level.

    Each level is to be a loop of its own, in which reads of many points are under way at once. All in one, a point's
    reads wait for one another, and few other points are; that takes far longer. What is behind a condition, XLA does
    not put into one loop with the rest. The condition always holds, which XLA cannot know.
    """

    def descend(entry: UInt32[Array, "*batch"], bits: UInt32[Array, "2 dim"]) -> UInt32[Array, "*batch"]:
        places = [_place(tables, x, axis) for axis in range(tables.dim)]
        is_page = jnp.uint32(0) - (entry & np.uint32(1))  # all bits or none
        return gather(trie.entries, (entry >> np.uint32(1)) + (_joined_bits(places, bits[0], bits[1]) & is_page))

    entry = descend((trie.start << np.uint32(1)) | np.uint32(1), trie.bits[0])
    for level in range(1, len(trie.bits)):
        entry = jax.lax.cond(
            trie.bits[level].any(), lambda entry, level=level: descend(entry, trie.bits[level]), jnp.zeros_like, entry
        )
    return entry >> np.uint32(1)
