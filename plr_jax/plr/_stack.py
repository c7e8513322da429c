"""The public functions that evaluate one PLR (:func:`evaluate`) and combine many into one function (:func:`stack`).

A stack finds a point's leaf in a *trie*, level by level. Each level consists of *pages*: a page is a table with an
entry for each cell of a grid. The grid of a PLR's first page covers its domain. The grid of any other page covers a
cell of the level above that overlaps several leaves. All pages are parts of one array. An odd entry ``2 * i + 1``
leads to the page that starts at index ``i``, an even entry ``2 * i`` to row ``i`` of the leaf parameters. The first
``num_rows`` entries refer to themselves: entry ``i`` is ``2 * i``. So once a row is found, reading further levels
does not change it::

    0             num_rows                                                                       entries
    | 0, 2, 4, ... | first page of PLR 0 | first page of PLR 1 | ... | other pages of PLR 0, 1, ... |

Reference: Srinivasan, Varghese, "Fast address lookups using controlled prefix expansion", TOCS 1999.
"""

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import field, replace
from functools import partial
from itertools import pairwise
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt32

from plr_jax._arrays import as_queries, hash64, is_traced, padded, size_in_eighths
from plr_jax._compiled import pytree
from plr_jax._types import ArrayLike
from plr_jax.plr._plr import PLR, LowerBound, as_plrs
from plr_jax.plr.frame import FRACTION_BITS, Outside, as_outside, in_parts, is_far, require_resolved, unresolved_types
from plr_jax.plr.query import bounds_of_tables, evaluate_tables
from plr_jax.plr.tables import PerPointTable, Tables, Trie, arrange_parameters
from plr_jax.plr.tree import Cells, PerAxis, enumerate_boxes, leaves_in_blocks, num_pairs, row_major, spread_bits

_FIRST_BITS = 10  # index bits of first pages: those of 1,000 PLRs take 4 MB, and most points need no other page
_PAGE_BITS = 6  # most index bits of other pages
_MOST_ENTRIES = 2**25  # most entries of one PLR; the estimate counts a page of k leaves up to k times
_MOST_INDICES = 2**31  # an entry uses one of its 32 bits as a flag


def trie_levels(bits: PerAxis) -> list[PerAxis]:
    """Choose the grids of a trie's levels: return how often each grid halves each axis of the domain.

    A trie is a lookup table that a query reads level by level, from a coarse grid to finer grids. The first array is
    0 (the whole domain), the last is ``bits``, the halvings of the finest leaves. The first level has up to
    ``2**_FIRST_BITS`` cells. The other halvings are spread evenly over as few levels as possible, with at most
    ``_PAGE_BITS`` halvings in each.
    """
    ends = [0 * bits, spread_bits(bits, _FIRST_BITS)]
    for levels_left in range(-(-int((bits - ends[1]).sum()) // _PAGE_BITS), 0, -1):
        missing = bits - ends[-1]
        ends.append(ends[-1] + spread_bits(missing, -(-int(missing.sum()) // levels_left)))  # rounded up
    return ends


def build_trie(partitions: Sequence[Cells], rows: Sequence[Int[np.ndarray, "..."]], levels: list[PerAxis]) -> Trie:
    """Build the trie of several PLRs, a lookup table that a query reads level by level, from coarse to fine.

    ``partitions`` has the leaves of each PLR, ``rows`` the row of each leaf in the table of leaf parameters, and
    ``levels`` the result of :func:`trie_levels`. ``ValueError`` if leaves are too deep or entries are too many.
    """
    # 1. Masks and shifts that turn the fraction bits between two levels into a row-major index into a page:
    #
    #    fraction of a point along an axis   | above: level's begin | step bits | below end |   FRACTION_BITS bits
    #    index into a page                   | step bits of axis 0 | step bits of axis 1 | ... |
    ends = np.array(levels)
    steps = np.diff(ends, axis=0)
    shifts = FRACTION_BITS - ends[1:] - (np.cumsum(steps[:, ::-1], axis=1)[:, ::-1] - steps)
    bits = np.stack([((1 << steps) - 1) << (FRACTION_BITS - ends[1:]), shifts], axis=1)
    # 2. Entries of each PLR. A level has at most a page for each pair of a deeper leaf and a cell that it overlaps.
    num_rows = 1 + max(int(row.max()) for row in rows)
    total = num_rows + len(partitions) * (1 << int(levels[1].sum()))
    first_pages, others = [], []
    for cells, row in zip(partitions, rows, strict=True):
        most = 0.0
        for begin, end in pairwise(levels):
            pairs = num_pairs(cells[(cells.depth > begin).any(axis=1)], begin)
            most += min(pairs, 2.0 ** begin.sum()) * 2.0 ** (end - begin).sum()
        if most > _MOST_ENTRIES or (shifts < 0).any():  # a left shift is not supported
            raise ValueError("A PLR is too deep for a stack: construct it with a lower max_depth, or call it alone.")
        first_page, *later_levels = _pages(cells, row, levels, total)
        first_pages.append(first_page)
        others += later_levels
        total += sum(map(len, later_levels))
    if total >= _MOST_INDICES:
        raise ValueError(f"A stack needs fewer than 2**31 entries, got {total:,}: split the {len(rows):,} PLRs.")
    # 3. Entries of rows, first pages and other pages.
    entries = np.concatenate([2 * np.arange(num_rows, dtype=np.uint32), *first_pages, *others])
    entries = padded(entries, size_in_eighths(total))
    return Trie(*jax.device_put((entries, bits.astype(np.uint32), np.uint32(num_rows))))


def _pages(
    cells: Cells, row: Int[np.ndarray, " leaves"], levels: Sequence[PerAxis], next_start: int
) -> Iterator[UInt32[np.ndarray, " entries"]]:
    """Yield one PLR's entries in a trie (a lookup table read level by level), an array for each level.

    ``row`` has the index of each leaf's row of parameters, ``levels`` the result of :func:`trie_levels`.
    ``next_start`` is the index in the trie at which the PLR's second level begins.
    """
    # A level divides each cell of its `begin` grid that has a page into the cells of its `end` grid, its entries.
    page = np.zeros(1, np.int64)  # cells of the `begin` grid that have a page: row-major indices, ascending
    for level, (begin, end) in enumerate(pairwise(levels)):
        # 1. Leaves that the level resolves fill whole entries. Such leaves are not deeper than its `end` grid, but
        #    deeper than its `begin` grid, except in the first level.
        is_resolved = (cells.depth <= end).all(axis=1) & ((cells.depth > begin).any(axis=1) | (level == 0))
        resolved = cells[is_resolved]
        halvings = end - resolved.depth
        leaf, place = enumerate_boxes(resolved.position << halvings, np.int64(1) << halvings)
        # 2. Entries that overlap deeper leaves lead to pages of the next level, one after another.
        _, place_of_deeper = leaves_in_blocks(cells[(cells.depth > end).any(axis=1)], end)
        page_below, first = np.unique(row_major(place_of_deeper, end), return_index=True)
        page_bits = (levels[level + 2] - end).sum() if len(page_below) else 0
        starts = next_start + (np.arange(len(page_below)) << page_bits)
        next_start += len(page_below) << page_bits
        # 3. Write the entries. The highest bits of a place, a cell of the `end` grid, identify its page; the `step`
        #    bits below them are its index in the page.
        step = end - begin
        place = np.concatenate([place, place_of_deeper[first]])
        page_of_place = np.searchsorted(page, row_major(place >> step, begin))
        entries = np.zeros((len(page), 1 << step.sum()), np.uint32)
        values = np.concatenate([2 * row[is_resolved][leaf], 2 * starts + 1])
        entries[page_of_place, row_major(place & ((1 << step) - 1), step)] = values
        yield entries.ravel()
        page = page_below
        if not len(page):
            return


@pytree
class _SameShapeGroup:
    """The merged lookup tables of all PLRs of a stack that share a leaf model, periodic axes and mirrors."""

    frame: Tables  # without leaves; each array is one that all PLRs share, or has those of all PLRs, flattened
    trie: Trie
    leaf_parameters: Float[Array, "count rows"] | Float[Array, " numbers"]  # only distinct rows
    band: Any  # proven bounds of each row, ``(2, rows)``, as ``PLR.band``; None if a PLR has none
    shapes: tuple[tuple[int, ...] | None, ...] = field(metadata={"static": True})  # of an array; None if all share it
    first_bits: int = field(metadata={"static": True})  # index bits of the first level of the trie

    @classmethod
    def of(cls, plrs: Sequence[PLR], tables: Sequence[Tables], frames: Sequence[Tables]) -> "_SameShapeGroup":
        # 1. Keep one array of domains and symmetries where all PLRs have equal arrays; else join and flatten them.
        columns = zip(*map(jax.tree_util.tree_leaves, frames), strict=True)
        arrays, shapes = [], []
        for column in (list(map(np.asarray, column)) for column in columns):
            is_shared = all(np.array_equal(column[0], each) for each in column[1:])
            arrays.append(jax.device_put(column[0] if is_shared else np.stack(column).ravel()))
            shapes.append(None if is_shared else column[0].shape)
        # 2. Deduplicate rows of leaf parameters, by a hash of their bits.
        rows, distinct, num_rows = [], [], 0
        has_proof = all(plr.band is not None and plr.has_arrays_of_file for plr in plrs)
        for plr, each in zip(plrs, tables, strict=True):  # a row ends with the leaf's two bounds, if there is a proof
            # In paged tables, parameters are stored by slot, and the first slots are the leaves themselves.
            count = each.leaf.num_leaf_parameters(each.dim)
            numbers = np.asarray(each.leaf_parameters)
            of_leaves = (numbers if numbers.ndim == 2 else numbers.reshape(-1, count).T)[:, : plr.num_leaves]
            if has_proof:
                band = np.asarray(plr.band)[:, : plr.num_leaves]
                of_leaves = np.concatenate([of_leaves, np.broadcast_to(band, (2, plr.num_leaves))])
            key = np.zeros(plr.num_leaves, np.uint64)
            for column in np.ascontiguousarray(of_leaves).view(np.uint32):
                key = hash64(key + column + np.uint64(1))
            _, first, row = np.unique(key, return_index=True, return_inverse=True)
            rows.append(num_rows + row)
            distinct.append(of_leaves.T[first])
            num_rows += len(first)
        table = padded(np.concatenate(distinct), size_in_eighths(num_rows))
        band = jax.device_put(table[:, count:].T) if has_proof else None
        # 3. Build the trie that leads to the rows.
        levels = trie_levels(np.max([plr.cells.depth.max(axis=0) for plr in plrs], axis=0))
        trie = build_trie([plr.cells for plr in plrs], rows, levels)
        frame = jax.tree_util.tree_structure(frames[0]).unflatten(arrays)
        numbers = jax.device_put(arrange_parameters(np.ascontiguousarray(table[:, :count])))
        return cls(frame, trie, numbers, band, tuple(shapes), int(levels[1].sum()))

    def pick(self, which: UInt32[Array, "*batch"]) -> Tables:
        """Return tables that evaluate a different PLR at each point: the PLR of index ``which`` in the group."""
        arrays, structure = jax.tree_util.tree_flatten(self.frame)
        for i, (array, shape) in enumerate(zip(arrays, self.shapes, strict=True)):
            if shape is not None:
                arrays[i] = PerPointTable(array, shape, which * np.uint32(prod(shape)), array.dtype)
        trie = replace(self.trie, start=self.trie.start + (which << np.uint32(self.first_bits)))
        return replace(structure.unflatten(arrays), trie=trie, leaf_parameters=self.leaf_parameters)


@pytree
class PLRStack:
    """Many PLRs as one function: ``f(index, x)`` evaluates PLR number ``index`` at each point.

    :func:`stack` makes stacks. A stack is a pytree of arrays: a jitted function can close over it or take it as an
    argument, also under ``jax.vmap`` and ``jax.grad``. Stacks of equally many similar PLRs share compiled code.
    """

    groups: tuple[_SameShapeGroup, ...]
    group: UInt32[Array, " plrs"]
    place: UInt32[Array, " plrs"]  # index of each PLR in its group
    corners: Float[Array, "plrs 3 dim"] | None  # origin of each PLR's tables, a sum of floats; None for zeros
    dim: int = field(metadata={"static": True})
    unresolved: tuple[str, ...] = field(metadata={"static": True})  # float types too coarse for some domain

    def __len__(self) -> int:
        return self.group.shape[0]

    def __call__(self, index: ArrayLike, x: ArrayLike, *, outside: Outside = "inf") -> Float[Array, "*batch"]:
        """Evaluate the PLR with the given index at each point.

        Args:
            index: Indices of PLRs, integers of a shape that broadcasts with the batch.
            x: Points, ``(..., dim)``, NumPy or JAX. If a domain is far from the origin, pass ``index`` and ``x`` as
                NumPy arrays outside of ``jit``, so that 64-bit points are not rounded to 32 bits.
            outside: Answer outside the PLR's domain: ``"inf"``, ``"clamp"`` or ``"nan"``; see :func:`evaluate`.

        Returns:
            Distances, in the broadcast shape of index and batch, equal to the single PLRs' distances up to rounding;
            NaN for indices that are negative or too large.

        Raises:
            ValueError: If ``index`` is not of integers, or as for :func:`evaluate`.
        """
        return self._query(index, x, as_outside(outside))[0]

    def bounds(self, index: ArrayLike, x: ArrayLike) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Return proven lower and upper bounds of the distance of a PLR at each point; see :meth:`PLR.bounds`.

        Arguments, shapes and errors are as for calling the stack. ``ValueError`` also if a PLR of the stack has no
        proof. A PLR whose arrays were replaced before it was stacked has no proof.
        """
        self._require_bands()
        return self._query(index, x, None)

    @property
    def lower(self) -> LowerBound:
        """The proven lower bound as a function ``(index, x)``, the first result of :meth:`bounds`.

        See :attr:`PLR.lower`. ``ValueError`` if a PLR of the stack has no proof.
        """
        self._require_bands()
        return LowerBound(self)

    def _require_bands(self) -> None:
        if any(group.band is None for group in self.groups):
            raise ValueError("Every PLR of the stack must have a proof: see certify.")

    def _query(self, index: ArrayLike, x: ArrayLike, outside: Outside | None) -> Any:
        """Check the arguments; return a tuple: distances or, if ``outside`` is None, lower and upper bounds."""
        # 1. Check index and points. A single NumPy point is repeated by JAX's or NumPy's broadcasting.
        index = index if isinstance(index, jax.Array) else np.asarray(index)
        x = x if isinstance(x, jax.Array) else as_queries(x)
        if index.dtype.kind not in "iu":
            raise ValueError(f"index must hold integer indices of PLRs, got an array of {index.dtype}.")
        if x.ndim == 0 or x.shape[-1] != self.dim:
            raise ValueError(f"Points must have shape (..., {self.dim}), got {x.shape}.")
        if not isinstance(index, jax.Array):  # JAX would wrap indices of more than 32 bits
            index = np.where((index >= 0) & (index < len(self)), index.astype(np.int32), np.int32(-1))
        if x.ndim == 1 and index.ndim:
            x = jnp.broadcast_to(x, (*index.shape, self.dim)) if isinstance(x, jax.Array) else x[(None,) * index.ndim]
        # 2. Subtract the origins of tables: here in 64 bits if that is possible, else in compiled code.
        is_rounded = isinstance(index, jax.Array) or isinstance(x, jax.Array) or x.dtype != np.float64
        if self.corners is None or is_traced(self.corners) or is_rounded:
            require_resolved(jax.dtypes.canonicalize_dtype(x.dtype), self.unresolved)
            return _evaluate(self, index, x, outside)
        from_corner = x - np.asarray(self.corners, np.float64).sum(axis=1)[index]
        return _evaluate(replace(self, corners=None), index, from_corner, outside)


def stack(plrs: Sequence[PLR]) -> PLRStack:
    """Combine many PLRs into one function of index and point, ``stack(plrs)(index, x)``, which is a pytree.

    PLRs must be of one dimension. A stack is fastest if all have one leaf model; otherwise every point reads the
    tables of each model. To evaluate one PLR for each robot of a team, use :meth:`PLR.stack`. ``ValueError`` if
    ``plrs`` is no list of at least one PLR, dimensions differ, a PLR's leaves are too deep, or all tables together
    are too large for 32-bit indices.
    """
    # 1. Make each PLR's tables. Tables of a far domain take points relative to its corner.
    plrs = as_plrs(plrs)
    if len(dims := {plr.dim for plr in plrs}) != 1:
        raise ValueError(f"A stack needs PLRs of one dimension, got {sorted(dims)}: make a stack for each.")
    tables = [plr.tables_from_corner if is_far(plr.domain) else plr.tables for plr in plrs]
    corners = [plr.domain.lo if is_far(plr.domain) else np.zeros(plr.dim) for plr in plrs]
    # 2. Group the PLRs by the structure of their tables without leaves.
    kinds: dict[Hashable, list[int]] = {}
    no_leaves = dict.fromkeys(("bits", "blocks", "pages", "leaf_of_slot", "leaf_parameters"))
    frames: list[Tables] = [replace(each, **no_leaves) for each in tables]
    for i, frame in enumerate(frames):
        of_straight = tuple(array.shape for array in frame.straight or ())
        kinds.setdefault((jax.tree_util.tree_structure(frame), of_straight), []).append(i)
    # 3. Merge the tables of each group.
    group, place = np.zeros((2, len(plrs)), np.uint32)
    groups = []
    for members in kinds.values():
        group[members] = len(groups)
        place[members] = np.arange(len(members))
        of_members: Any = ([row[i] for i in members] for row in (plrs, tables, frames))
        groups.append(_SameShapeGroup.of(*of_members))
    unresolved = max((unresolved_types(plr.domain) for plr in plrs), key=len)
    parts = in_parts(np.array(corners)) if np.any(corners) else None
    return PLRStack(tuple(groups), *jax.device_put((group, place, parts)), dim=plrs[0].dim, unresolved=unresolved)


@partial(jax.jit, static_argnums=3)
def _evaluate(stacked: PLRStack, index: Array, x: Array, outside: Outside | None) -> tuple[Array, ...]:
    """Return the distances of PLR ``index`` at each point or, if ``outside`` is None, lower and upper bounds.

    The results are NaN where the stack has no PLR of this index.
    """
    # 1. Broadcast; PLR 0 takes the place of PLRs that do not exist.
    shape = jnp.broadcast_shapes(index.shape, x.shape[:-1])
    index, x = jnp.broadcast_to(index, shape), jnp.broadcast_to(x, (*shape, x.shape[-1]))
    exists = (index >= 0) & (index < len(stacked))
    number = jnp.where(exists, index, 0).astype(np.uint32)
    # 2. Subtract the origin of each point's tables, a sum of floats.
    if stacked.corners is not None:
        x = x.astype(jnp.promote_types(x.dtype, np.float32))
        for part in jnp.moveaxis(stacked.corners[number].astype(x.dtype), -2, 0):
            x = x - part
    # 3. Evaluate every group at all points, and select the answers of the points' groups.
    has_groups = len(stacked.groups) > 1
    place, group = (stacked.place[number], stacked.group[number]) if has_groups else (number, np.uint32(0))
    values = np.nan, np.nan
    for i, merged in enumerate(stacked.groups):
        is_in_group = group == i
        tables = merged.pick(jnp.where(is_in_group, place, np.uint32(0)))
        answers = (evaluate_tables(tables, x, outside),) if outside else bounds_of_tables(tables, merged.band, x)
        values = [jnp.where(is_in_group, answer, value) for answer, value in zip(answers, values, strict=False)]
    return tuple(jnp.where(exists, value, np.nan) for value in values)


def evaluate(plr: PLR, x: ArrayLike, *, outside: Outside = "inf") -> Float[Array, "*batch"]:
    """Return the approximate distance at each point (Putman et al., Section III-A); the same as ``plr(x)``.

    Works under ``jax.jit``, ``jax.vmap``, ``jax.grad`` and ``jax.hessian``. The gradient and the Hessian are those of
    the leaf's function. They are finite everywhere, 0 where the distance is ``inf``, and arbitrary where a coordinate
    is NaN. An optimizer that may leave the domain should pass ``outside="clamp"``, so that a descent step leads back.
    Outside of ``jit``, NumPy answers up to 4,096 points without compiling, bit for bit as compiled code does, unless
    ``jax_enable_x64`` is set.

    ``jax.export`` (with the package ``flatbuffers``) turns a query into a program of a few hundred kilobytes that
    runs without this package, for batches of any size. A program that takes the PLR as an argument needs this
    package, to read the PLR::

        n, dim = jax.export.symbolic_shape("n, 2")
        exported = jax.export.export(jax.jit(plr))(jax.ShapeDtypeStruct((n, dim), np.float32))
        distances = jax.export.deserialize(exported.serialize()).call(x)

    Args:
        plr: A PLR of any leaf model.
        x: Points, ``(..., dim)``, NumPy or JAX, in the units of the domain. Computation is in their precision, at
            least 32 bits; coefficients are 32-bit floats. In a domain far from the origin, as in UTM coordinates,
            pass NumPy's 64-bit points outside of ``jit`` or enable ``jax_enable_x64``: 32-bit points are rounded
            there, by decimeters.
        outside: Answer outside the domain: ``"inf"``; ``"clamp"``, the value at the nearest point of the domain plus
            the straight-line distance to it, ``inf`` if a coordinate is infinite; or ``"nan"``. Along a periodic
            axis, no finite coordinate is outside.

    Returns:
        Distances of shape ``(...)``. A PLR never tests collision: points of the closed domain mostly get a finite
        value, also in obstacles. In rooms that are cut off from the goal, PLRs of most distance functions of this
        package answer ``inf``: see :func:`construct`. Any other leaf from which no sample reaches the goal continues
        the plane of a neighbor that reaches it, or answers ``inf`` if there is no such neighbor. NaN coordinates give
        NaN. The upper edge of the domain belongs to the last cell; along a periodic axis it is the lower edge. Near
        the goal, values may be slightly negative.

    Raises:
        ValueError: If the last axis of ``x`` is not ``dim`` long, ``x`` is not real, or ``outside`` is invalid; or if
            the domain is so narrow for its distance from the origin that the type of the points cannot resolve it.
    """
    return plr(x, outside=outside)
