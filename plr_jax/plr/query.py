"""Evaluation of PLRs in JAX, for one PLR or for one PLR per robot of a team.

A query folds (mirrors) and wraps the points, finds the leaf of each by bit arithmetic and table lookups, and
evaluates the leaf's function.
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

_EXPONENT = np.uint32(0xFF800000)  # sign and exponent of a 32-bit float
_SHIFTS = np.uint32(WORD_BITS - 1)  # a mask that tells the compiler that no shift is by 32 bits or more
_ENDS_IN_DOUBLE = 2.0**-44  # relative error of the domain's ends in the tables, for 64-bit points


def evaluate_tables(tables: Tables, x: Array, outside: Outside = "inf") -> Float[Array, "*batch"]:
    """Return the PLR's distance at each point; NaN for NaN, and outside the closed domain as ``outside`` says.

    Raises ``ValueError`` for points of a wrong shape or type; the check does not depend on their values.
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
    if x.ndim == 0 or x.shape[-1] != tables.dim:
        raise ValueError(f"Points must have shape (..., {tables.dim}), got {x.shape}.")
    if not (jnp.issubdtype(x.dtype, jnp.floating) or jnp.issubdtype(x.dtype, jnp.integer)):
        raise ValueError(f"Points must be real numbers, got an array of {x.dtype}; convert them to floats.")
    x = x.astype(x.dtype if x.dtype == jnp.float64 else jnp.float32)
    if tables.unresolved:
        require_resolved(x.dtype, tables.unresolved)
    return x


def bounds_of_tables(
    tables: Tables, band: Float[Array, "2 rows"], straight: Float[Array, "_"] | None, x: Array
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """Return proven lower (at least 0) and upper bounds: answer plus bounds of its error (``band``), rounded outward.

    ``straight`` holds goal, rate and margin of a second lower bound, ``rate * |x - goal| - margin``.
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
        *goal, rate, margin = straight.astype(value.dtype)
        frame, square = tables.frame.astype(value.dtype), jnp.zeros_like(value)
        for axis, to in enumerate(goal):
            along = x[..., axis].astype(value.dtype) - frame[Frame.LO, axis] - frame[Frame.LO_REST, axis]
            square += jnp.square(along - to)
        # The root of 0 has no gradient.
        length = jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, jnp.ones_like(square))), square)
        line = length * rate - margin
        lower = jnp.maximum(lower, jnp.minimum(line, value))  # no bound excludes the answer
    return jnp.where(value < jnp.inf, lower, value), jnp.where(value < jnp.inf, upper, value)


def waypoints_in_tables(tables: Tables, x: Array) -> Float[Array, "*batch dim"]:
    """Return the next waypoint that each point's leaf stores; NaN outside the closed domain and for NaN."""
    x = jax.lax.stop_gradient(_as_float_points(tables, x))
    outside, answer = outside_domain(tables, x)
    numbers = _leaf_parameters(tables, find_row(tables, x), x.dtype)
    source = jnp.stack(tables.leaf.source_of(numbers), axis=-1)
    source = jnp.broadcast_to(tables.frame[Frame.LO], source.shape).astype(x.dtype) + source
    return jnp.where((outside | jnp.isnan(answer))[..., None], jnp.nan, source)


def lookup(tables: Tables, x: Float[Array, "*batch dim"]) -> UInt32[Array, "*batch"]:
    """Return the leaf's number for each point, up to rounding across borders; arbitrary outside and for NaN."""
    if tables.folding is not None:
        return lookup(replace(tables, folding=None), _fold(tables.folding, x, jnp.zeros(x.shape[:-1], bool)))
    row = find_row(tables, _wrap(tables, x) if tables.periodic else x)
    return row if tables.pages is None else gather(tables.leaf_of_slot, row).astype(jnp.uint32)


def find_row(tables: Tables, x: Float[Array, "*batch dim"]) -> UInt32[Array, "*batch"]:
    """Return each wrapped point's row of ``Tables.leaf_parameters``: the leaf's number or, with pages, the slot's."""
    if tables.trie is not None:
        return _row_in_trie(tables, tables.trie, x)
    fractions = [_fraction_bits(tables, x, axis) for axis in range(tables.dim)]
    index = _join_bits(fractions, *tables.bits)
    if tables.pages is not None:
        mask, right, start = tables.pages.bits
        word = gather(tables.pages.words, index)
        return (word >> (start[0] & _SHIFTS)) + (word & _join_bits(fractions, mask, right))
    if tables.blocks is not None:
        index = _index_in_block(tables.blocks, fractions, index)
    return gather(tables.leaf_of_slot, index).astype(jnp.uint32)


def _index_in_block(
    blocks: Blocks, fractions: list[UInt32[Array, "*batch"]], block: UInt32[Array, "*batch"]
) -> UInt32[Array, "*batch"]:
    """Return the index into ``Tables.leaf_of_slot`` for points with given fraction bits in given blocks."""
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
    """Shift, rotate and mirror points; points ``outside`` the domain are sent to the center, without gradient."""
    axes, (center, rest) = range(window.dim), window.center.astype(x.dtype)
    z = [jnp.where(outside, 0, without_fusion(x[..., axis] - center[axis]) - rest[axis]) for axis in axes]
    if window.axes is not None:
        turned = window.axes.astype(x.dtype)
        z = [reduce(jnp.add, (without_fusion(turned[row, axis] * z[axis]) for axis in axes)) for row in axes]
    for pivot, reversed_axes in window.mirrors:
        is_behind = z[pivot] < 0
        for axis in reversed_axes:
            z[axis] = jnp.where(is_behind, -z[axis], z[axis])
    lo, hi = window.corners.astype(x.dtype)  # only rounding can put coordinates outside
    columns = [
        straight_through(z[axis], jnp.clip(jax.lax.stop_gradient(z[axis]), lo[axis], hi[axis])) for axis in axes
    ]
    # The barrier keeps XLA from repeating the folding wherever a coordinate is read.
    return jnp.moveaxis(jax.lax.optimization_barrier(jnp.stack(columns)), 0, -1)


def outside_domain(
    tables: Tables | FoldedDomain, x: Float[Array, "*batch dim"]
) -> tuple[Bool[Array, "*batch"], Float[Array, "*batch"]]:
    """Return whether wrapped points are outside the closed domain, and what they get: ``inf``, or NaN for NaN."""
    x, frame = jax.lax.stop_gradient(x), tables.frame.astype(x.dtype)
    outside, answer = jnp.zeros(x.shape[:-1], bool), jnp.full(x.shape[:-1], jnp.inf, x.dtype)
    for axis in range(tables.dim):
        above = x[..., axis] - frame[Frame.LO, axis]
        answer += jnp.abs(above)  # NaN if any coordinate is
        if axis in tables.periodic:
            outside |= jnp.isinf(above)
        elif x.dtype == jnp.float64:  # can distinguish exact from rounded corners
            below = frame[Frame.HI, axis] - x[..., axis]
            outside |= (above < frame[Frame.LO_REST, axis]) | (below < frame[Frame.HI_REST, axis])
        else:
            outside |= (above < 0) | (x[..., axis] > frame[Frame.HI, axis])
    return outside, answer


def _clamp(
    window: Tables | FoldedDomain, x: Float[Array, "*batch dim"]
) -> tuple[Float[Array, "*batch dim"], Float[Array, "*#batch"]]:
    """Return the nearest point of the domain and the distance to it; points that are not finite are unchanged."""
    is_finite = jnp.isfinite(x).all(axis=-1)
    nearest, beyond = [x[..., axis] for axis in range(window.dim)], []
    for axis in range(window.dim):
        if axis in window.periodic:
            continue
        frame, along = window.frame[:, axis].astype(x.dtype), nearest[axis]
        lo, hi = frame[Frame.LO], frame[Frame.HI]
        if x.dtype == jnp.float64:  # the outermost coordinates that ``outside_domain`` accepts
            lo, hi = lo + frame[Frame.LO_REST], hi - frame[Frame.HI_REST]
            lo = jnp.where(lo - frame[Frame.LO] < frame[Frame.LO_REST], jnp.nextafter(lo, jnp.inf), lo)
            hi = jnp.where(frame[Frame.HI] - hi < frame[Frame.HI_REST], jnp.nextafter(hi, -jnp.inf), hi)
        inside = jnp.where(along < lo, lo, jnp.where(along > hi, hi, along))
        nearest[axis] = jnp.where(is_finite, inside, along)
        beyond.append(jnp.where(is_finite, along - inside, 0))
    return jnp.stack(nearest, axis=-1), length_of(beyond)


def length_of(along: list[Float[Array, "*batch"]]) -> Float[Array, "*#batch"]:
    """Return the lengths of vectors given axis by axis, without overflow or underflow; the gradient at 0 is 0."""
    if not along:
        return jnp.zeros(())
    largest = jax.lax.stop_gradient(reduce(jnp.maximum, map(jnp.abs, along)))
    scale = jnp.where(largest > 0, largest, 1)
    square = reduce(jnp.add, (without_fusion(jnp.square(each / scale)) for each in along))
    return without_fusion(scale * jnp.where(largest > 0, jnp.sqrt(jnp.where(largest > 0, square, 1)), 0))


def _wrap(tables: Tables, x: Float[Array, "*batch dim"]) -> Float[Array, "*batch dim"]:
    """Move points by whole periods into the domain along periodic axes; the upper end becomes the lower one.

    The product is kept from fusing with the difference, so that all parts of a query see the same point.
    """
    columns = [x[..., axis] for axis in range(tables.dim)]
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
    """Evaluate the leaf in each ``row`` at the point; points ``outside`` the domain get an arbitrary number."""
    numbers, frame, place = _leaf_parameters(tables, row, x.dtype), tables.frame.astype(x.dtype), []
    for axis in range(tables.dim):
        along = x[..., axis] - frame[Frame.LO, axis]
        if tables.leaf.is_cell_relative:
            # Local coordinate, from 0 to 1, or slightly beyond where the lookup rounds across a border. Products and
            # the difference are exact, so both leaves at a face see the same point.
            u = without_fusion(along * frame[Frame.SCALE, axis]) + (frame[Frame.START, axis] - 1)
            number = jax.lax.bitcast_convert_type(numbers[axis].astype(jnp.float32), jnp.uint32)
            count = jax.lax.bitcast_convert_type(number & _EXPONENT, jnp.float32).astype(u.dtype)
            along = u * count - (numbers[axis] - count)
        place.append(_Unfused(_zero_if_differentiated(along, outside)))
    of_leaf = [_Unfused(number) for number in numbers[tables.dim * tables.leaf.is_cell_relative :]]
    return tables.leaf.value(of_leaf, place, lambda square: _Unfused(_root(square.value))).value


@dataclass(frozen=True)
class _Unfused:
    """Numbers whose products are rounded before they are added, as the file format requires."""

    value: Float[Array, "*batch"]

    def __add__(self, other: "_Unfused") -> "_Unfused":
        return _Unfused(self.value + other.value)

    def __sub__(self, other: "_Unfused") -> "_Unfused":
        return _Unfused(self.value - other.value)

    def __mul__(self, other: "_Unfused") -> "_Unfused":
        return _Unfused(without_fusion(self.value * other.value))


def _leaf_parameters(tables: Tables, row: UInt32[Array, "*batch"], dtype: np.dtype) -> list[Float[Array, "*batch"]]:
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
    """Return ``t``, but differentiate as if it were 0 outside the domain, where ``0 * inf`` would give NaN."""
    return t


@_zero_if_differentiated.defjvp
def _zero_tangent(primals, tangents):
    t, outside = primals
    return (jnp.where(outside, jnp.zeros_like(t), t), jnp.where(outside, jnp.zeros_like(t), tangents[0]))


@jax.custom_jvp
def _root(square: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Return the square root; its derivative at 0 (at the apex of a cone) counts as 0."""
    return jnp.sqrt(square)


@_root.defjvp
def _root_tangent(primals, tangents):
    root = jnp.sqrt(primals[0])
    return root, jnp.where(root > 0, tangents[0] / (2 * jnp.where(root > 0, root, 1)), 0)


def _fraction_bits(tables: Tables, x: Float[Array, "*batch dim"], axis: int) -> UInt32[Array, "*batch"]:
    """Return an integer whose lowest 23 bits are a point's place along an axis, in ``2**-23`` of the domain's width.

    These are the low bits of ``1 + place`` as a 32-bit float, with other bits above them. The upper edge gets the
    largest value, as it belongs to the last cell.
    """
    lo, start, scale, top = (
        tables.frame[row, axis].astype(x.dtype) for row in (Frame.LO, Frame.START, Frame.SCALE, Frame.TOP)
    )
    share = (x[..., axis] - lo) * scale
    # The bound separates product and sum. If a compiler fused them in only one part of a query, a point near a border
    # could get the block (coarse cell) of one leaf and the entry of another.
    # The maximum keeps points that rounding puts below the lower edge from wrapping to the upper edge.
    placed = jnp.maximum(jnp.where(share < top, share, top) + start, 1)
    return jax.lax.bitcast_convert_type(placed.astype(jnp.float32), jnp.uint32)


def _join_bits(
    fractions: list[UInt32[Array, "*batch"]], mask: UInt32[Array, "dim"], right: UInt32[Array, "dim"]
) -> UInt32[Array, "*batch"]:
    """Concatenate the fraction bits that ``mask`` selects on each axis, shifted ``right``, to one index."""
    return reduce(
        jnp.bitwise_or, [(place & mask[axis]) >> (right[axis] & _SHIFTS) for axis, place in enumerate(fractions)]
    )


def _row_in_trie(tables: Tables, trie: Trie, x: Float[Array, "*batch dim"]) -> UInt32[Array, "*batch"]:
    """Return each point's row of leaf parameters, found in a trie (tables of several PLRs) level by level.

    XLA should compile each level to a loop of its own, so that reads of many points overlap; in one fused loop the
    reads of a point wait for one another. A condition keeps XLA from fusing. It always holds, but XLA cannot know
    that.
    """

    def descend(entry: UInt32[Array, "*batch"], bits: UInt32[Array, "2 dim"]) -> UInt32[Array, "*batch"]:
        fractions = [_fraction_bits(tables, x, axis) for axis in range(tables.dim)]
        is_page = jnp.uint32(0) - (entry & np.uint32(1))  # all ones or zero
        return gather(trie.entries, (entry >> np.uint32(1)) + (_join_bits(fractions, bits[0], bits[1]) & is_page))

    entry = descend((trie.start << np.uint32(1)) | np.uint32(1), trie.bits[0])
    for level in range(1, len(trie.bits)):
        entry = jax.lax.cond(
            trie.bits[level].any(), lambda entry, level=level: descend(entry, trie.bits[level]), jnp.zeros_like, entry
        )
    return entry >> np.uint32(1)


def gather(table: Integer[Array, "n"] | Float[Array, "n"], index: UInt32[Array, "*batch"]):
    """Return ``table[index]`` without a bounds check."""
    return table.at[index].get(mode="promise_in_bounds")


@jax.custom_jvp
def straight_through(x: Float[Array, "*batch"], to: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Return ``to``, but differentiate as if the result were ``x`` (a straight-through estimator)."""
    return to


@straight_through.defjvp
def _straight_through_tangent(primals, tangents):
    return primals[1], tangents[0]


def without_fusion(value: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Return a product or sum that the compiler cannot fuse with later operations."""
    constant = jax.lax.stop_gradient(value)
    return straight_through(value, jnp.where(constant == constant, constant, jnp.nan))


find_leaves = jax.jit(lookup)
evaluate_points = jax.jit(evaluate_tables)  # separate, as a static argument adds a tenth to the time of a call
evaluate_points_anywhere = jax.jit(evaluate_tables, static_argnames="outside")
bound_points, waypoints_of_points = jax.jit(bounds_of_tables), jax.jit(waypoints_in_tables)


@dataclass(frozen=True, eq=False)
class PointPlacement:
    """A function that wraps 64-bit points around periodic axes, then subtracts a corner; None leaves a step out."""

    domain: Box | None
    corner: Float[np.ndarray, "dim"] | None

    def __call__(self, x: Float[np.ndarray, "*batch dim"]) -> Float[np.ndarray, "*batch dim"]:
        if self.domain is not None:
            x = self.domain.wrapped(x)
        return x if self.corner is None else x - self.corner


# Compiled batch sizes. Padding is cheap while a call's overhead dominates; tiny sizes avoid a thread switch in JAX.
_SIZES = (1, 4, 16, 64, 256, 1024, 2048, 4096, 8192, 16384, 32768)
_CHUNK = _SIZES[-1]  # larger batches are split, so that computation overlaps with copies between NumPy and JAX


@dataclass(frozen=True, eq=False)
class TableStack:
    """A function of joint configurations made of one PLR per robot; robots with ``bands`` get proven lower bounds."""

    tables: tuple[Tables, ...]
    bands: tuple[tuple[Float[Array, "2 _"], Float[Array, "_"] | None] | None, ...]
    placements: tuple[PointPlacement | None, ...]

    def __call__(self, q: Float[np.ndarray, "n robots dof"]) -> Float[np.ndarray, "n robots"]:
        """Return each robot's distance; its PLR sees the leading coordinates of the robot's configuration."""
        shape = q.shape
        if len(shape) != 3 or shape[1] != len(self.tables):
            raise ValueError(f"Joint configurations must have shape (n, {len(self.tables)}, dof), got {shape}.")
        for i, table in enumerate(self.tables):
            if table.dim > shape[2]:
                raise ValueError(
                    f"The PLR of robot {i} needs {table.dim} coordinates, got configurations of {shape[2]}."
                )
        distances = np.empty(q.shape[1::-1])
        starts = range(0, len(q), _CHUNK)
        # Dispatch all calls before waiting for the first result.
        answers = [_evaluate(self.tables, self.bands, self._padded(q[begin : begin + _CHUNK])) for begin in starts]
        for begin, answer in zip(starts, answers, strict=True):
            columns = distances[:, begin : begin + _CHUNK]
            for column, of_robot in zip(columns, answer, strict=True):
                column[:] = np.asarray(of_robot)[: len(column)]
        return distances.T

    def _padded(self, q: Float[np.ndarray, "n robots dof"]) -> Float[np.ndarray, "size robots dof"]:
        """Pad a batch to a size that is compiled once, in the precision of JAX's floats; wrap or shift its points."""
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
    """Return one array per robot: for a single array, XLA would compute all robots in one slower loop."""
    parts = [q[:, i, : table.dim] for i, table in enumerate(tables)]
    return tuple(
        evaluate_tables(table, part) if band is None else bounds_of_tables(table, *band, part)[0]
        for table, band, part in zip(tables, bands, parts, strict=True)
    )
