"""PLRs as functions: one of a point, many of an index and a point."""

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import pairwise
from math import prod

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int, UInt32

from plr_jax._arrays import as_queries, hash64, padded, size_in_eighths
from plr_jax._types import ArrayLike
from plr_jax.plr._plr import PLR, as_plrs
from plr_jax.plr.frame import (
    FRACTION_BITS,
    Outside,
    as_outside,
    enumerate_boxes,
    in_parts,
    is_far,
    leaves_in_blocks,
    num_pairs,
    require_resolved,
    row_major,
    spread_bits,
    unresolved_types,
)
from plr_jax.plr.query import evaluate_tables
from plr_jax.plr.tables import PerPointTable, Tables, Trie, arrange_parameters
from plr_jax.plr.tree import Cells

# A trie: one table of many PLRs, of as many levels as the deepest needs, each of a few bits of a point's place.
#
# A *page* has an entry for each cell of a regular grid: the first page of a PLR for those of the domain, which nearly
# always say the leaf at once, any other for those of one cell of the level above that several leaves share. An entry
# is odd if it leads to a page, and then half of it is where the page begins; else half of it is the row of the leaf's
# numbers. At the index of a row there is an entry of that same row: a read of what is found already finds it again.
#
# That takes more reads than the pages of one PLR (``tables.py``) and less memory, for which the reads of many PLRs
# wait. And nothing else differs from one PLR to the next. First pages, which all points read, stand side by side.
#
# References: Srinivasan, Varghese, "Fast address lookups using controlled prefix expansion", TOCS 1999.


_FIRST_BITS = 10  # of a first page: those of a thousand PLRs take 4 MB, and others are seldom read
_PAGE_BITS = 6  # of others, at the most
_MOST_ENTRIES = 2**25  # of one PLR, at the most, before leaves that share pages are seen to
_MOST_INDICES = 2**31  # an entry has one bit for other things


def trie_levels(bits: Int[np.ndarray, "dim"]) -> list[Int[np.ndarray, "dim"]]:
    """Where levels begin and end: so many bits of a place along each axis, from none to all of them."""
    ends = [0 * bits, spread_bits(bits, _FIRST_BITS)]
    for left in range(-(-int((bits - ends[1]).sum()) // _PAGE_BITS), 0, -1):
        rest = bits - ends[-1]
        ends.append(ends[-1] + spread_bits(rest, -(-int(rest.sum()) // left)))
    return ends


def build_trie(
    partitions: Sequence[Cells], rows: Sequence[Int[np.ndarray, "_"]], levels: Sequence[Int[np.ndarray, "dim"]]
) -> Trie:
    """The trie of several partitions, of which each leaf's numbers are in a given row.

    Raises ``ValueError`` if one is too deep or has too many pages, or all of them together are too large.
    """
    # Mask and shift that make an index into a page of the bits of a point's place between two levels.
    ends = np.array(levels)
    steps = np.diff(ends, axis=0)
    shifts = FRACTION_BITS - ends[1:] - (np.cumsum(steps[:, ::-1], axis=1)[:, ::-1] - steps)
    bits = np.stack([((1 << steps) - 1) << (FRACTION_BITS - ends[1:]), shifts], axis=1)
    num_rows = 1 + max(int(of_leaf.max()) for of_leaf in rows)
    end = num_rows + len(partitions) * (1 << int(levels[1].sum()))
    first_pages, others = [], []
    for cells, of_leaf in zip(partitions, rows, strict=True):
        most = 0.0
        for begin, behind in pairwise(levels):
            pairs = num_pairs(cells[(cells.depth > begin).any(axis=1)], begin)
            most += min(pairs, 2.0 ** begin.sum()) * 2.0 ** (behind - begin).sum()
        if most > _MOST_ENTRIES or (shifts < 0).any():  # no bits of a place belong farther left in an index
            raise ValueError("A PLR has leaves too deep for a stack. Lower max_depth, or call it by itself.")
        for number, pages in enumerate(_pages(cells, of_leaf, levels, end)):
            if number == 0:
                first_pages.append(pages)
            else:
                others.append(pages)
                end += len(pages)
    if end >= _MOST_INDICES:
        raise ValueError(f"{len(partitions):,} PLRs have tables too large for one stack; make several of fewer PLRs.")
    entries = np.concatenate([2 * np.arange(num_rows, dtype=np.uint32), *first_pages, *others])
    entries = padded(entries, size_in_eighths(len(entries)))
    return Trie(jnp.asarray(entries), jnp.asarray(bits.astype(np.uint32)), jnp.asarray(np.uint32(num_rows)))


def _pages(
    cells: Cells, row: Int[np.ndarray, "leaves"], levels: Sequence[Int[np.ndarray, "dim"]], next_start: int
) -> Iterator[UInt32[np.ndarray, "entries"]]:
    """The pages of each level of one partition, side by side; those of the second level on start at a given index."""
    page = np.zeros(1, np.int64)  # of this level: the indices of their cells in the grid of the level above
    for number, (begin, end) in enumerate(pairwise(levels)):
        entries = np.zeros((len(page), 1 << (end - begin).sum()), np.int64)
        is_here = (cells.depth <= end).all(axis=1) & ((cells.depth > begin).any(axis=1) | (number == 0))
        here = cells[is_here]
        leaf, place = enumerate_boxes(here.position << (end - here.depth), np.int64(1) << (end - here.depth))
        entries[_page_entries(place, page, begin, end)] = 2 * row[is_here][leaf]
        _, place = leaves_in_blocks(cells[(cells.depth > end).any(axis=1)], end)
        next_page, first = np.unique(row_major(place, end), return_index=True)
        if len(next_page):
            starts = next_start + (np.arange(len(next_page)) << (levels[number + 2] - end).sum())
            entries[_page_entries(place[first], page, begin, end)] = 2 * starts + 1
            next_start = int(starts[-1]) + (1 << (levels[number + 2] - end).sum())
        yield entries.ravel().astype(np.uint32)
        page = next_page
        if not len(page):
            return


def _page_entries(
    place: Int[np.ndarray, "n dim"],
    page: Int[np.ndarray, "pages"],
    begin: Int[np.ndarray, "dim"],
    end: Int[np.ndarray, "dim"],
) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "n"]]:
    """The page and the entry there of places in the grid of a level that has these pages."""
    step = end - begin
    return np.searchsorted(page, row_major(place >> step, begin)), row_major(place & ((1 << step) - 1), step)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class _SameShapeGroup:
    """PLRs whose domains and foldings have arrays of one structure.

    Attributes:
        arrays: Each array of the tables' structure, if it is the same for all; else those of all PLRs, side by side.
        trie: The rows of the numbers of their leaves.
        leaf_parameters: One row a number, or a leaf's side by side, as in :class:`Tables`; leaves with the same share them.
        shapes: Of each array of one PLR; None if it is the same for all.
        structure: That of tables without leaves.
        first_bits: How many bits of a place the first level of the trie takes.
    """

    arrays: tuple[Array, ...]
    trie: Trie
    leaf_parameters: Float[Array, "count rows"] | Float[Array, "numbers"]
    shapes: tuple[tuple[int, ...] | None, ...] = field(metadata={"static": True})
    structure: jax.tree_util.PyTreeDef = field(metadata={"static": True})
    first_bits: int = field(metadata={"static": True})

    @classmethod
    def of(cls, plrs: Sequence[PLR], tables: Sequence[Tables], frames: Sequence[Tables]) -> "_SameShapeGroup":
        """That of PLRs, given their tables, and these without leaves."""
        # 1. What tells their domains and foldings apart.
        columns = zip(*map(jax.tree_util.tree_leaves, frames), strict=True)
        arrays, shapes = [], []
        for column in (list(map(np.asarray, column)) for column in columns):
            is_shared = all(np.array_equal(column[0], each) for each in column[1:])
            arrays.append(jnp.asarray(column[0] if is_shared else np.stack(column).ravel()))
            shapes.append(None if is_shared else column[0].shape)
        # 2. The numbers of leaves: the first of all rows that are bit for bit alike, and which of these each is like.
        rows, distinct, num_rows = [], [], 0
        for plr, each in zip(plrs, tables, strict=True):
            # What the leaf model reads of each leaf; the first slots of pages are the leaves, one each.
            count, numbers = each.leaf.num_leaf_parameters(each.dim), np.asarray(each.leaf_parameters)
            of_leaves = (numbers if numbers.ndim == 2 else numbers.reshape(-1, count).T)[:, : plr.num_leaves]
            key = np.zeros(plr.num_leaves, np.uint64)
            for column in np.ascontiguousarray(of_leaves).view(np.uint32):
                key = hash64(key + column + np.uint64(1))
            _, first, row = np.unique(key, return_index=True, return_inverse=True)
            rows.append(num_rows + row)
            distinct.append(of_leaves.T[first])
            num_rows += len(first)
        table = np.concatenate(distinct)
        table = padded(table, size_in_eighths(len(table)))
        # 3. The way from a place to a row.
        levels = trie_levels(np.max([plr.cells.depth.max(axis=0) for plr in plrs], axis=0))
        trie = build_trie([plr.cells for plr in plrs], rows, levels)
        structure = jax.tree_util.tree_structure(frames[0])
        first_bits = int(levels[1].sum())
        return cls(tuple(arrays), trie, jnp.asarray(arrange_parameters(table)), tuple(shapes), structure, first_bits)

    def pick(self, which: UInt32[Array, "*batch"]) -> Tables:
        """The tables of each point's PLR."""
        picked = [
            array if shape is None else PerPointTable(array, shape, which * np.uint32(prod(shape)), array.dtype)
            for array, shape in zip(self.arrays, self.shapes, strict=True)
        ]
        tables = jax.tree_util.tree_unflatten(self.structure, picked)
        trie = replace(self.trie, start=self.trie.start + (which << np.uint32(self.first_bits)))
        return replace(tables, trie=trie, leaf_parameters=self.leaf_parameters)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class PLRStack:
    """Many PLRs as one function: ``f(index, x)`` is the distance of each point by the PLR of its index.

    Made by :func:`stack`. A pytree of arrays: a jitted function can close over it or take it as an argument, under
    ``jax.vmap`` and ``jax.grad`` too. Stacks of as many PLRs of one leaf model, and about as large, share compiled
    code.

    Attributes:
        groups: The tables of PLRs that are alike.
        group: The group of each PLR.
        place: Its place there.
        corners: The corner that the tables of each PLR count points from, in three parts that add up to it; None if
            all count from the origin.
        dim: Number of axes.
        unresolved: Types of points that cannot be answered, as some domain is too far from the origin.
    """

    groups: tuple[_SameShapeGroup, ...]
    group: UInt32[Array, "plrs"]
    place: UInt32[Array, "plrs"]
    corners: Float[Array, "plrs 3 dim"] | None
    dim: int = field(metadata={"static": True})
    unresolved: tuple[str, ...] = field(metadata={"static": True})

    def __len__(self) -> int:
        return self.group.shape[0]

    def __call__(self, index: ArrayLike, x: ArrayLike, *, outside: Outside = "inf") -> Float[Array, "*batch"]:
        """Distance of each point by the PLR of its index.

        Args:
            index: Indices of PLRs, integers of any shape that broadcasts with the batch.
            x: Points, ``(..., dim)``, NumPy or JAX. NumPy's are placed in 64 bits, as for
                :func:`evaluate`, if ``index`` is NumPy's too.
            outside: What points outside the domain of their PLR get, as for :func:`evaluate`.

        Returns:
            Distances, of the shape to which index and batch broadcast: what the PLR of the index answers, up to
            rounding. NaN where the index is not that of a PLR; negative ones do not count from the end.

        Raises:
            ValueError: If ``x`` has another last axis than ``dim``, ``index`` holds no integers, or ``outside`` is
                none of the three.
        """
        index = index if isinstance(index, jax.Array) else np.asarray(index)
        x = x if isinstance(x, jax.Array) else as_queries(x)
        if index.dtype.kind not in "iu":
            raise ValueError(f"index must hold integers, numbers of PLRs, got an array of {index.dtype}.")
        if x.ndim == 0 or x.shape[-1] != self.dim:
            raise ValueError(f"Points must have shape (..., {self.dim}), got {x.shape}.")
        corners, outside = self.corners, as_outside(outside)
        if corners is None or isinstance(corners, Tracer) or isinstance(index, jax.Array) or isinstance(x, jax.Array):
            require_resolved(jax.dtypes.canonicalize_dtype(x.dtype), self.unresolved)
            return _evaluate(self, index, x, outside)
        from_corner = x - self._exact_corners[np.where((index >= 0) & (index < len(self)), index, 0)]
        return _evaluate(replace(self, corners=None), index, from_corner, outside)

    @cached_property
    def _exact_corners(self) -> Float[np.ndarray, "plrs dim"]:
        return np.asarray(self.corners, np.float64).sum(axis=1)


def stack(plrs: Sequence[PLR]) -> PLRStack:
    """One function of many PLRs: ``stack(plrs)(index, x)``, a pytree.

    Args:
        plrs: The PLRs, at least one, all of one number of dimensions; of any leaf models and sizes. It is fastest
            where all have one leaf model: else the tables of each are read for every point.

    Returns:
        The function. For a team, one PLR a robot, see :meth:`PLR.stack`.

    Raises:
        ValueError: If they are not a list of PLRs, at least one, of one number of dimensions; or all their tables
            together are too large for 32-bit indices.
    """
    plrs = as_plrs(plrs)
    if len(dims := {plr.dim for plr in plrs}) != 1:
        raise ValueError(f"A stack needs PLRs of one number of dimensions, got those of {sorted(dims)}.")
    # In a domain that is far from the origin, points are counted from its corner.
    tables = [plr.tables_from_corner if is_far(plr.domain) else plr.tables for plr in plrs]
    corners = [plr.domain.lo if is_far(plr.domain) else np.zeros(plr.dim) for plr in plrs]
    # Tables without all that tells leaves apart, but for how many numbers each has, in groups of one structure.
    kinds: dict[Hashable, list[int]] = {}
    frames = [
        replace(
            each,
            bits=jnp.zeros_like(each.bits),
            blocks=None,
            pages=None,
            leaf_of_slot=jnp.zeros(0, np.uint16),
            leaf_parameters=jnp.zeros((each.leaf.num_leaf_parameters(each.dim), 0), np.float32),
        )
        for each in tables
    ]
    for i, frame in enumerate(frames):
        kinds.setdefault(jax.tree_util.tree_structure(frame), []).append(i)
    group, place = np.zeros((2, len(plrs)), np.uint32)
    groups = []
    for members in kinds.values():
        group[members], place[members] = len(groups), np.arange(len(members))
        groups.append(
            _SameShapeGroup.of([plrs[i] for i in members], [tables[i] for i in members], [frames[i] for i in members])
        )
    unresolved = max((unresolved_types(plr.domain) for plr in plrs), key=len)
    parts = jnp.asarray(in_parts(np.array(corners))) if np.any(corners) else None
    arrays = jnp.asarray(group), jnp.asarray(place), parts
    return PLRStack(tuple(groups), *arrays, dim=plrs[0].dim, unresolved=unresolved)


@partial(jax.jit, static_argnames="outside")
def _evaluate(stacked: PLRStack, index: Array, x: Array, outside: Outside) -> Float[Array, "*batch"]:
    shape = jnp.broadcast_shapes(index.shape, x.shape[:-1])
    index, x = jnp.broadcast_to(index, shape), jnp.broadcast_to(x, (*shape, x.shape[-1]))
    is_one = (index >= 0) & (index < len(stacked))
    known = jnp.where(is_one, index, 0).astype(jnp.uint32)
    if stacked.corners is not None:
        x = x.astype(jnp.promote_types(x.dtype, jnp.float32))
        for part in jnp.moveaxis(stacked.corners[known].astype(x.dtype), -2, 0):
            x = x - part
    has_kinds = len(stacked.groups) > 1
    place, group = (stacked.place[known], stacked.group[known]) if has_kinds else (known, np.uint32(0))
    value = None
    for number, alike in enumerate(stacked.groups):
        here = group == number
        of_group = evaluate_tables(alike.pick(jnp.where(here, place, jnp.uint32(0))), x, outside)
        value = of_group if value is None else jnp.where(here, of_group, value)
    assert value is not None
    return jnp.where(is_one, value, jnp.nan)


def evaluate(plr: PLR, x: ArrayLike, *, outside: Outside = "inf") -> Float[Array, "*batch"]:
    """Approximate distance at each point: the function of the leaf that holds it (Section III-A of the paper).

    Clean under ``jax.jit``, ``jax.vmap`` and ``jax.grad``; the gradient is that of the leaf's function, finite
    everywhere, and zero where the distance is ``inf``; where a coordinate is NaN, any numbers or NaN.

    An optimizer that may leave the domain asks with ``outside="clamp"``, so that to descend is to return::

        step = jax.grad(lambda x: plr(x, outside="clamp"))(x)

    ``jax.export`` makes of a query, of batches of any size, what runs without this package; it takes some hundred
    kilobytes, as tables are padded, and the package ``flatbuffers``. Close over the PLR, or pass the arrays that
    ``jax.tree.flatten`` makes of it: a program that takes the PLR itself cannot be serialized::

        n, dim = jax.export.symbolic_shape("n, 2")
        exported = jax.export.export(jax.jit(plr))(jax.ShapeDtypeStruct((n, dim), np.float32))
        distances = jax.export.deserialize(exported.serialize()).call(x)

    Args:
        plr: The PLR, of any leaf model.
        x: Points, ``(..., dim)``, NumPy or JAX, in the units of the domain. Computed in their own precision, at
            least 32 bits; coefficients are 32-bit floats. Where the domain is far from the origin, as in UTM
            coordinates, NumPy's 64-bit points are placed in 64 bits and answered as near it; JAX's 32-bit ones, and
            all under ``jax.jit``, where rounding has put them (decimeters away) unless ``jax_enable_x64`` is on.
        outside: What points outside the domain get: ``"inf"``; ``"clamp"``, the value at the nearest point of the
            domain plus the straight-line distance to it in coordinates, ``inf`` if a coordinate is infinite; or
            ``"nan"``. It changes no answer inside. Along a periodic axis no finite coordinate is outside.

    Returns:
        Distances of shape ``(...)``. A PLR never tests collision: every point of the closed domain gets a finite
        value, in an obstacle too, except in leaves of which nothing reaches the goal and that touch no leaf of which
        something does. Those get ``inf``; a NaN coordinate gives NaN. Cones answer a finite number everywhere in the
        domain, where the goal cannot be reached as well. The upper edge of the domain belongs to the last cell; that
        of a periodic axis is its lower edge, and points are wrapped around it, NumPy's 64-bit ones in 64 bits. An
        approximation may be a little below 0 near the goal.

    Raises:
        ValueError: If the last axis of ``x`` is not ``dim`` long, its numbers are not real, or ``outside`` is none of
            the three; or if fewer than 64 places along an axis of the domain are told apart by 32-bit points there.
    """
    return plr(x, outside=outside)
