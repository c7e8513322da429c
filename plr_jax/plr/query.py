"""A query, in JAX: the leaf that holds a point by arithmetic and one lookup, then the leaf's function.

Of one PLR or of a team's, compiled.
"""

from dataclasses import dataclass, replace
from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Integer, UInt32

from plr_jax._arrays import padded_size
from plr_jax.geometry.box import Box
from plr_jax.plr.frame import WORD_BITS, Frame, Outside, require_resolved
from plr_jax.plr.tables import Blocks, FoldedDomain, Tables, Trie

_EXPONENT = np.uint32(0xFF800000)  # and sign, of a 32-bit float
_SHIFTS = np.uint32(WORD_BITS - 1)  # a mask, which tells the compiler that no shift is by 32 bits or more
_ENDS_IN_DOUBLE = 2.0**-44
"""How well, in shares of themselves, the tables know ends of the domain; in 32 bits exactly."""


def evaluate_tables(tables: Tables, x: Array, outside: Outside = "inf") -> Float[Array, "*batch"]:
    """Value of the leaf's function at each point; outside the closed domain what is asked for, NaN for NaN.

    Raises ``ValueError`` for points of another shape or type; what is checked does not depend on their values.
    """
    x = _as_float_points(tables, x)
    if outside == "clamp":
        nearest, way = _clamp(tables if tables.folding is None else tables.folding, x)
        return evaluate_tables(tables, nearest) + way
    if tables.folding is not None:
        is_outside, answer = outside_domain(tables.folding, x)
        value = evaluate_tables(replace(tables, folding=None), _fold(tables.folding, x, is_outside))
    else:
        x = _wrap(tables, x) if tables.periodic else x
        row = find_row(tables, jax.lax.stop_gradient(x))
        is_outside, answer = outside_domain(tables, x)
        value = _value(tables, row, x, is_outside)
    return jnp.where(is_outside, jnp.full_like(answer, jnp.nan) if outside == "nan" else answer, value)


def _as_float_points(tables: Tables, x: Array) -> Float[Array, "*batch dim"]:
    """Points in 32 or 64 bits, which must resolve the domain."""
    if x.ndim == 0 or x.shape[-1] != tables.dim:
        raise ValueError(f"Points must have shape (..., {tables.dim}), got {x.shape}.")
    if not (jnp.issubdtype(x.dtype, jnp.floating) or jnp.issubdtype(x.dtype, jnp.integer)):
        raise ValueError(f"Points must be real numbers, got an array of {x.dtype}.")
    x = x.astype(x.dtype if x.dtype == jnp.float64 else jnp.float32)
    if tables.unresolved:
        require_resolved(x.dtype, tables.unresolved)
    return x


def bounds_of_tables(
    tables: Tables, band: Float[Array, "2 rows"], straight: Float[Array, "_"] | None, x: Array
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """Lower and upper bounds of the distance at each point: what is answered, and the band of its leaf, or of all.

    Both are without_fusion outward; the lower one is at least 0.
    """
    value = evaluate_tables(tables, x)
    if band.shape[1] == 1:
        below, above = band[0, 0], band[1, 0]
    else:
        leaf = lookup(tables, jax.lax.stop_gradient(x.astype(value.dtype)))
        below, above = gather(band[0], leaf), gather(band[1], leaf)
    lower, upper = (
        straight_through(bound, jnp.nextafter(jax.lax.stop_gradient(bound), jnp.asarray(toward, value.dtype)))
        for bound, toward in (
            (value + below.astype(value.dtype), -jnp.inf),
            (value + above.astype(value.dtype), jnp.inf),
        )
    )
    lower = jnp.maximum(lower, 0)
    if straight is not None:
        goal, rate, margin = jnp.split(straight.astype(value.dtype), [tables.dim, tables.dim + 1])
        above = x.astype(value.dtype) - tables.frame[Frame.LO] - tables.frame[Frame.LO_REST]
        square = jnp.sum(jnp.square(above - goal), axis=-1)
        # At the goal a root of 0 would have no gradient.
        line = jnp.sqrt(jnp.maximum(square, jnp.finfo(value.dtype).tiny)) * rate[0] - margin[0]
        lower = jnp.maximum(lower, jnp.minimum(line, value))  # no bound excludes the answer
    return jnp.where(value < jnp.inf, lower, value), jnp.where(value < jnp.inf, upper, value)


def waypoints_in_tables(tables: Tables, x: Array) -> Float[Array, "*batch dim"]:
    """The source of the leaf that holds each point; NaN outside the closed domain, and for NaN."""
    x = jax.lax.stop_gradient(_as_float_points(tables, x))
    outside, answer = outside_domain(tables, x)
    numbers = _leaf_parameters(tables, find_row(tables, x), x.dtype)
    source = jnp.stack(tables.leaf.source_of(numbers), axis=-1)
    source = jnp.broadcast_to(tables.frame[Frame.LO], source.shape).astype(x.dtype) + source
    return jnp.where((outside | jnp.isnan(answer))[..., None], jnp.nan, source)


def lookup(tables: Tables, x: Float[Array, "*batch dim"]) -> UInt32[Array, "*batch"]:
    """Index of the leaf that holds each point, to within the last bit of a 32-bit fraction of the domain.

    Points outside the domain, and NaN, get some leaf.
    """
    if tables.folding is not None:
        return lookup(replace(tables, folding=None), _fold(tables.folding, x, jnp.zeros(x.shape[:-1], bool)))
    row = find_row(tables, _wrap(tables, x) if tables.periodic else x)
    return row if tables.pages is None else gather(tables.leaf_of_slot, row).astype(jnp.uint32)


def find_row(tables: Tables, x: Float[Array, "*batch dim"]) -> UInt32[Array, "*batch"]:
    """Which of the ``numbers`` are for each point: those of its slot, if there are pages, else those of its leaf.

    The points are wrapped.
    """
    if tables.trie is not None:
        return _row_in_trie(tables, tables.trie, x)
    fractions = [_fraction_bits(tables, x, axis) for axis in range(tables.dim)]
    index = _join_bits(fractions, *tables.bits)
    if tables.pages is not None:
        # Slot of points in given blocks.
        mask, right, start = tables.pages.bits
        word = gather(tables.pages.words, index)
        return (word >> (start[0] & _SHIFTS)) + (word & _join_bits(fractions, mask, right))
    if tables.blocks is not None:
        index = _index_in_block(tables.blocks, fractions, index)
    return gather(tables.leaf_of_slot, index).astype(jnp.uint32)


def _index_in_block(
    blocks: Blocks, fractions: list[UInt32[Array, "*batch"]], block: UInt32[Array, "*batch"]
) -> UInt32[Array, "*batch"]:
    """Index into ``leaf_of_slot`` of points in given blocks."""
    index = start = jnp.zeros_like(block)
    axis = 0
    for number, (table, axes) in enumerate(zip(blocks.words, blocks.axes, strict=True)):
        word = gather(table, block)
        for slot in range(axes):
            bits = (word >> np.uint32(slot * blocks.width)) & np.uint32(2**blocks.width - 1)
            within = fractions[axis] & ((np.uint32(1) << (blocks.shift[axis] & _SHIFTS)) - np.uint32(1))
            index = (index << bits) | (within >> ((blocks.shift[axis] - bits) & _SHIFTS))
            axis += 1
        if number == 0:
            start = word >> np.uint32(axes * blocks.width)
    return start + index


def _fold(
    window: FoldedDomain, x: Float[Array, "*batch dim"], outside: Bool[Array, "*batch"]
) -> Float[Array, "*batch dim"]:
    """The folded points; those ``outside`` the domain go to its center, from where nothing returns."""
    axes, (center, rest) = range(window.dim), window.center.astype(x.dtype)
    z = [jnp.where(outside, 0, without_fusion(x[..., axis] - center[axis]) - rest[axis]) for axis in axes]
    if window.axes is not None:
        turned = window.axes.astype(x.dtype)
        z = [reduce(jnp.add, (without_fusion(turned[row, axis] * z[axis]) for axis in axes)) for row in axes]
    for pivot, reversed_axes in window.mirrors:
        is_behind = z[pivot] < 0
        for axis in reversed_axes:
            z[axis] = jnp.where(is_behind, -z[axis], z[axis])
    lo, hi = window.corners.astype(x.dtype)  # only rounding puts coordinates outside
    columns = [
        straight_through(z[axis], jnp.clip(jax.lax.stop_gradient(z[axis]), lo[axis], hi[axis])) for axis in axes
    ]
    # Computed once: a compiler would repeat all this wherever a coordinate is read.
    return jnp.moveaxis(jax.lax.optimization_barrier(jnp.stack(columns)), 0, -1)


def outside_domain(
    tables: Tables | FoldedDomain, x: Float[Array, "*batch dim"]
) -> tuple[Bool[Array, "*batch"], Float[Array, "*batch"]]:
    """Whether each wrapped point is outside the closed domain, and the answer there: ``inf``, NaN for NaN."""
    x, frame = jax.lax.stop_gradient(x), tables.frame.astype(x.dtype)
    outside, answer = jnp.zeros(x.shape[:-1], bool), jnp.full(x.shape[:-1], jnp.inf, x.dtype)
    for axis in range(tables.dim):
        above = x[..., axis] - frame[Frame.LO, axis]
        answer += jnp.abs(above)  # NaN if any coordinate is
        if axis in tables.periodic:
            outside |= jnp.isinf(above)
        elif x.dtype == jnp.float64:  # which can tell the true corners from the without_fusion ones
            below = frame[Frame.HI, axis] - x[..., axis]
            outside |= (above < frame[Frame.LO_REST, axis]) | (below < frame[Frame.HI_REST, axis])
        else:
            outside |= (above < 0) | (x[..., axis] > frame[Frame.HI, axis])
    return outside, answer


def _clamp(
    window: Tables | FoldedDomain, x: Float[Array, "*batch dim"]
) -> tuple[Float[Array, "*batch dim"], Float[Array, "*#batch"]]:
    """The point of the domain that is nearest to each, and how far that is; points that are not finite stay."""
    is_finite = jnp.isfinite(x).all(axis=-1)
    nearest, beyond = [x[..., axis] for axis in range(window.dim)], []
    for axis in range(window.dim):
        if axis in window.periodic:
            continue
        frame, along = window.frame[:, axis].astype(x.dtype), nearest[axis]
        lo, hi = frame[Frame.LO], frame[Frame.HI]
        if x.dtype == jnp.float64:  # the outermost coordinates that ``outside_domain`` calls inside
            lo, hi = lo + frame[Frame.LO_REST], hi - frame[Frame.HI_REST]
            lo = jnp.where(lo - frame[Frame.LO] < frame[Frame.LO_REST], jnp.nextafter(lo, jnp.inf), lo)
            hi = jnp.where(frame[Frame.HI] - hi < frame[Frame.HI_REST], jnp.nextafter(hi, -jnp.inf), hi)
        inside = jnp.where(along < lo, lo, jnp.where(along > hi, hi, along))
        nearest[axis] = jnp.where(is_finite, inside, along)
        beyond.append(jnp.where(is_finite, along - inside, 0))
    return jnp.stack(nearest, axis=-1), length_of(beyond)


def length_of(along: list[Float[Array, "*batch"]]) -> Float[Array, "*#batch"]:
    """Length of vectors of any finite numbers, given axis by axis; of slope 0 at 0."""
    if not along:
        return jnp.zeros(())
    largest = jax.lax.stop_gradient(reduce(jnp.maximum, map(jnp.abs, along)))
    scale = jnp.where(largest > 0, largest, 1)
    square = reduce(jnp.add, (without_fusion(jnp.square(each / scale)) for each in along))
    return without_fusion(scale * jnp.where(largest > 0, jnp.sqrt(jnp.where(largest > 0, square, 1)), 0))


def _wrap(tables: Tables, x: Float[Array, "*batch dim"]) -> Float[Array, "*batch dim"]:
    """Points straight_through by whole periods to between the ends of periodic axes, the upper of which becomes the lower.

    A compiler may round the product and the difference at once in one part of a query and apart in another. That
    moves a point by a rounding, but never from one end to the other: the number of periods leaves no such choice.
    """
    columns = [x[..., axis] for axis in range(tables.dim)]  # axis by axis, as the rest of a query computes
    for axis in tables.periodic:
        along, frame = jax.lax.stop_gradient(columns[axis]), tables.frame[:, axis].astype(x.dtype)
        lo, hi = frame[Frame.LO] + frame[Frame.LO_REST], frame[Frame.HI] - frame[Frame.HI_REST]
        turns = jnp.floor((along - lo) * frame[Frame.SCALE])
        is_end = jnp.abs(along - hi) <= _ENDS_IN_DOUBLE * jnp.maximum(jnp.abs(lo), jnp.abs(hi))
        inside = jnp.where(is_end, lo, jnp.clip(along - without_fusion(turns * (hi - lo)), lo, hi))
        columns[axis] = straight_through(columns[axis], jnp.where(jnp.isfinite(along), inside, along))
    return jnp.stack(columns, axis=-1)


def _value(
    tables: Tables, row: UInt32[Array, "*batch"], x: Float[Array, "*batch dim"], outside: Bool[Array, "*batch"]
) -> Float[Array, "*batch"]:
    """Value of the leaf at each point; if that is ``outside`` the domain, any number will do."""
    numbers, frame, place = _leaf_parameters(tables, row, x.dtype), tables.frame.astype(x.dtype), []
    for axis in range(tables.dim):
        along = x[..., axis] - frame[Frame.LO, axis]
        if tables.leaf.is_cell_relative:
            # From 0 to 1 in the interval of that number, or beyond by as much as the lookup rounds a point across a
            # border. Products and the difference are exact, so both leaves at a face see the same point.
            u = without_fusion(along * frame[Frame.SCALE, axis]) + (frame[Frame.START, axis] - 1)
            number = jax.lax.bitcast_convert_type(numbers[axis].astype(jnp.float32), jnp.uint32)
            count = jax.lax.bitcast_convert_type(number & _EXPONENT, jnp.float32).astype(u.dtype)
            along = u * count - (numbers[axis] - count)
        place.append(_Unfused(_zero_if_differentiated(along, outside)))
    of_leaf = [_Unfused(number) for number in numbers[tables.dim * tables.leaf.is_cell_relative :]]
    return tables.leaf.value(of_leaf, place, lambda square: _Unfused(_root(square.value))).value


@dataclass(frozen=True)
class _Unfused:
    """Numbers whose products are without_fusion before they are added, as the format says."""

    value: Float[Array, "*batch"]

    def __add__(self, other: "_Unfused") -> "_Unfused":
        return _Unfused(self.value + other.value)

    def __sub__(self, other: "_Unfused") -> "_Unfused":
        return _Unfused(self.value - other.value)

    def __mul__(self, other: "_Unfused") -> "_Unfused":
        return _Unfused(without_fusion(self.value * other.value))


def _leaf_parameters(tables: Tables, row: UInt32[Array, "*batch"], dtype: np.dtype) -> list[Float[Array, "*batch"]]:
    """The numbers of each leaf that the tables were built of, at the row that ``find_row`` gave."""
    if tables.leaf_parameters.ndim == 2:
        return [
            gather(tables.leaf_parameters[which], row).astype(dtype) for which in range(len(tables.leaf_parameters))
        ]
    count = tables.leaf.num_leaf_parameters(tables.dim)
    return [
        gather(tables.leaf_parameters, row * np.uint32(count) + np.uint32(which)).astype(dtype)
        for which in range(count)
    ]


@jax.custom_jvp
def _zero_if_differentiated(t: Float[Array, "*batch"], outside: Bool[Array, "*batch"]) -> Float[Array, "*batch"]:
    """The coordinates, but zero outside the domain where differentiated: zero times a gradient at inf is NaN."""
    return t


@_zero_if_differentiated.defjvp
def _zero_tangent(primals, tangents):
    t, outside = primals
    return (jnp.where(outside, jnp.zeros_like(t), t), jnp.where(outside, jnp.zeros_like(t), tangents[0]))


@jax.custom_jvp
def _root(square: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """The square root, whose slope at zero, at a source itself, counts as zero."""
    return jnp.sqrt(square)


@_root.defjvp
def _root_tangent(primals, tangents):
    root = jnp.sqrt(primals[0])
    return root, jnp.where(root > 0, tangents[0] / (2 * jnp.where(root > 0, root, 1)), 0)


def _fraction_bits(tables: Tables, x: Float[Array, "*batch dim"], axis: int) -> UInt32[Array, "*batch"]:
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


def _join_bits(
    fractions: list[UInt32[Array, "*batch"]], mask: UInt32[Array, "dim"], right: UInt32[Array, "dim"]
) -> UInt32[Array, "*batch"]:
    """Some bits of a point's place along each axis, side by side."""
    return reduce(
        jnp.bitwise_or, [(place & mask[axis]) >> (right[axis] & _SHIFTS) for axis, place in enumerate(fractions)]
    )


def _row_in_trie(tables: Tables, trie: Trie, x: Float[Array, "*batch dim"]) -> UInt32[Array, "*batch"]:
    """Row of the numbers of points, level by level.

    Each level is to be a loop of its own, in which reads of many points are under way at once. All in one, a point's
    reads wait for one another, and few other points are; that takes far longer. What is behind a condition, XLA does
    not put into one loop with the rest. The condition always holds, which XLA cannot know.
    """

    def descend(entry: UInt32[Array, "*batch"], bits: UInt32[Array, "2 dim"]) -> UInt32[Array, "*batch"]:
        fractions = [_fraction_bits(tables, x, axis) for axis in range(tables.dim)]
        is_page = jnp.uint32(0) - (entry & np.uint32(1))  # all bits or none
        return gather(trie.entries, (entry >> np.uint32(1)) + (_join_bits(fractions, bits[0], bits[1]) & is_page))

    entry = descend((trie.start << np.uint32(1)) | np.uint32(1), trie.bits[0])
    for level in range(1, len(trie.bits)):
        entry = jax.lax.cond(
            trie.bits[level].any(), lambda entry, level=level: descend(entry, trie.bits[level]), jnp.zeros_like, entry
        )
    return entry >> np.uint32(1)


def gather(table: Integer[Array, "n"] | Float[Array, "n"], index: UInt32[Array, "*batch"]):
    """Entries of a table at indices that it has."""
    return table.at[index].get(mode="promise_in_bounds")


@jax.custom_jvp
def straight_through(x: Float[Array, "*batch"], to: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """What numbers become that computing moves a little, or by whole periods; differentiated as if they stayed."""
    return to


@straight_through.defjvp
def _straight_through_tangent(primals, tangents):
    return primals[1], tangents[0]


def without_fusion(value: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """A product or sum that no compiler combines with what follows: none knows that the condition changes nothing."""
    constant = jax.lax.stop_gradient(value)
    return straight_through(value, jnp.where(constant == constant, constant, jnp.nan))


# What is compiled, and the points that it is given.


find_leaves = jax.jit(lookup)
"""The leaf of each point, as its index."""

evaluate_points = jax.jit(evaluate_tables)
"""Values at points; ``outside`` would add a tenth to what a call takes."""

evaluate_points_anywhere = jax.jit(evaluate_tables, static_argnames="outside")
"""The same with another answer outside the domain."""

bound_points, waypoints_of_points = jax.jit(bounds_of_tables), jax.jit(waypoints_in_tables)


@dataclass(frozen=True, eq=False)
class PointPlacement:
    """Placing points on the host: around periodic axes, and from a corner far from the origin.

    Attributes:
        domain: The domain, if it has a periodic axis; else None.
        corner: The corner from which the tables count coordinates; None for the origin.
    """

    domain: Box | None
    corner: Float[np.ndarray, "dim"] | None

    def __call__(self, x: Float[np.ndarray, "*batch dim"]) -> Float[np.ndarray, "*batch dim"]:
        """The points as the tables want them."""
        if self.domain is not None:
            x = self.domain.wrapped(x)
        return x if self.corner is None else x - self.corner


# A team's PLRs as one function: a whole batch of joint configurations in a few compiled calls.


# The sizes of batch that are compiled. Where a call costs more than its work, few of them waste little; a few points
# are worth their own, as JAX then computes at once instead of handing the work to another thread.
_SIZES = (1, 4, 16, 64, 256, 1024, 2048, 4096, 8192, 16384, 32768)
_CHUNK = _SIZES[-1]  # of larger batches, chunks in flight overlap with the copies between NumPy and JAX


@dataclass(frozen=True, eq=False)
class TableStack:
    """The tables of several PLRs, one a robot, and how some want their points placed before they are without_fusion.

    See :meth:`PLR.stack`. Where there is a band, the lower bound is meant.
    """

    tables: tuple[Tables, ...]
    bands: tuple[tuple[Float[Array, "2 _"], Float[Array, "_"] | None] | None, ...]
    placements: tuple[PointPlacement | None, ...]

    def __call__(self, q: Float[np.ndarray, "n robots dof"]) -> Float[np.ndarray, "n robots"]:
        """Distance of every robot in every joint configuration, of which a PLR sees its leading coordinates."""
        shape = q.shape
        if len(shape) != 3 or shape[1] != len(self.tables):
            raise ValueError(f"Joint configurations must have shape (n, {len(self.tables)}, dof), got {shape}.")
        for i, table in enumerate(self.tables):
            if table.dim > shape[2]:
                raise ValueError(f"The PLR of robot {i} has {table.dim} dimensions, got {shape[2]}.")
        distances = np.empty(q.shape[1::-1])
        starts = range(0, len(q), _CHUNK)
        # All calls are under way before the first result is waited for.
        answers = [_evaluate(self.tables, self.bands, self._padded(q[begin : begin + _CHUNK])) for begin in starts]
        for begin, answer in zip(starts, answers, strict=True):
            columns = distances[:, begin : begin + _CHUNK]
            for column, of_robot in zip(columns, answer, strict=True):
                column[:] = np.asarray(of_robot)[: len(column)]
        return distances.T

    def _padded(self, q: Float[np.ndarray, "n robots dof"]) -> Float[np.ndarray, "size robots dof"]:
        """The batch in the precision of JAX's floats, filled up to one of the compiled sizes."""
        size = padded_size(len(q), _SIZES)
        padded = np.empty((size, *q.shape[1:]), jax.dtypes.canonicalize_dtype(np.float64))
        padded[: len(q)], padded[len(q) :] = q, 0
        for i, (table, placement) in enumerate(zip(self.tables, self.placements, strict=True)):
            if placement is not None:
                padded[: len(q), i, : table.dim] = placement(q[:, i, : table.dim])
        return padded


@jax.jit
def _evaluate(
    tables: tuple[Tables, ...],
    bands: tuple[tuple[Float[Array, "2 _"], Float[Array, "_"] | None] | None, ...],
    q: Float[Array, "n robots dof"],
) -> tuple[Float[Array, "n"], ...]:
    """Distances robot by robot: side by side in one array, they would be computed in one slower loop."""
    parts = [q[:, i, : table.dim] for i, table in enumerate(tables)]
    return tuple(
        evaluate_tables(table, part) if band is None else bounds_of_tables(table, *band, part)[0]
        for table, band, part in zip(tables, bands, parts, strict=True)
    )
