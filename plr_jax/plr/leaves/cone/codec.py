"""Encode cone leaves, functions ``offset + |x - source|``: a table of sources, and the index of every leaf's source.

A source is an obstacle corner or the goal. The offset is the distance from the source to the goal. Instead of the
offset, a file stores the source's *parent*, the next source on the shortest path from it to the goal. Only *roots*,
such as the goal, store offsets. Most maps have coordinates on a lattice, such as multiples of 0.01. Sources off this
lattice, such as a goal, are *fine*: their coordinates are multiples of about ``2**-26`` of the domain's width. The
bits in the file are described in ``portable/FORMAT.md``.
"""

from bisect import bisect_left
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import sum_of_columns
from plr_jax._types import Sources
from plr_jax.geometry.box import Box
from plr_jax.plr.coding import BitReader, BitWriter
from plr_jax.plr.frame import LARGEST
from plr_jax.plr.growth import Limits

# Fields of the file.
_COUNT_BITS = 20  # bits of the number of sources
_STEP_BITS = 16  # bits of a lattice's step
_WIDTH_BITS = 6  # bits of a bit width
_EXPONENT_BIAS = 1 << 15  # added to the exponent of the step of fine sources
_ESCAPE = 3  # smaller ranks of leaves' sources are stored as flags, others as codes
_FINE_BITS = 26  # bits of a coordinate that is not on the lattice
_SAME = 4  # steps of fine coordinates: distances of sources at one place are equal up to this
_LATTICES = np.array([*range(1, 257), 360, 400, 500, 512, 1000, 1024, 2000, 2048, 4096, 5000, 8192, 10000])
# Limits: a file beyond them is not read, and numbers beyond _LARGEST_SQUARED are not written.
_MOST_COORDINATE_BITS = 40
_LARGEST_EXPONENT = 200
_FARTHEST = 2.0**60  # largest distance of the domain's corner from the origin, in steps
_LARGEST_SQUARED = 1e18  # larger numbers overflow when squared in 32 bits
CUT_OFF = -2  # instead of a leaf's source: the goal cannot be reached from the leaf's free points


@dataclass(frozen=True, eq=False)
class StoredSources:
    """Apexes of cones (corners, goals) as in a file: first *fine* ones, which are not on the map's lattice of points.

    Fine apexes are sorted by their coordinates, and so are the apexes on the lattice.
    """

    num_fine: int  # size of the first group: sources that are not on the map's lattice
    exponent: int  # coordinates in the first group are multiples of 2**exponent
    fraction: int  # coordinates in the second group, on the lattice, are multiples of 1 / fraction
    code: Int[np.ndarray, "sources dim"]  # coordinates, as these multiples
    parent: Int[np.ndarray, " sources"]  # next source on the way to the goal; a root is its own parent
    root_offset: Float[np.ndarray, " sources"]  # of roots: distance to the goal, exact in 32 bits; else 0
    goals: Int[np.ndarray, " roots"] | None = None  # index of the goal at each root, if the file names goals

    @property
    def is_root(self) -> Bool[np.ndarray, " sources"]:
        return self.parent == np.arange(len(self.parent))

    @cached_property
    def points(self) -> Float[np.ndarray, "sources dim"]:
        fine, others = np.split(self.code, [self.num_fine])
        return np.concatenate([fine * 2.0**self.exponent, others / self.fraction])

    @cached_property
    def offsets(self) -> Float[np.ndarray, " sources"]:
        return self._offsets_and_roots[0]

    def is_goal(self, root: Int[np.ndarray, " n"], rounding: float) -> Bool[np.ndarray, " n"]:
        # If the file names goals, all roots are goals; else those whose offset is 0, up to rounding.
        return (self.offsets[root] <= rounding) | (self.goals is not None)

    @property
    def goal_of_source(self) -> Int[np.ndarray, " sources"] | None:
        # `goals` has an entry for each root: roots are counted in the order of the sources.
        return None if self.goals is None else self.goals[(np.cumsum(self.is_root) - 1)[self._offsets_and_roots[1]]]

    @cached_property
    def _offsets_and_roots(self) -> tuple[Float[np.ndarray, " sources"], Int[np.ndarray, " sources"]]:
        # The distance of each source to the goal, and its root. By pointer doubling: after round k, `onward` is the
        # source 2**k parents on (or the root), and `length` is the length of the way there. A way has fewer than
        # len(onward) parents, so it ends within the rounds, unless parents form a circle. The order of additions is
        # part of the format.
        onward = self.parent
        length = np.sqrt(sum_of_columns(np.square(self.points - self.points[onward])))
        for _ in range(len(onward).bit_length()):
            length = length + length[onward]
            onward = onward[onward]
        if not self.is_root[onward].all():
            raise ValueError("its sources follow one another in a circle")
        return length + self.root_offset[onward], onward


@dataclass(frozen=True, eq=False)
class StoredCones:
    """Cones as in a file: all sources (apexes of cones), and the source of each leaf."""

    sources: StoredSources
    source: Int[np.ndarray, " leaves"]


def store_sources(
    sources: Sources, domain: Box, is_off: Bool[np.ndarray, "sources fractions"] | None = None
) -> tuple[StoredSources, Int[np.ndarray, " sources"]]:
    """Round sources to lattices, and merge sources whose rounded positions are equal.

    If ``sources.exits`` is given, sources merge only if their distances to the goal are also equal up to rounding.
    Return the stored sources, and the index of each given source among the stored sources. ``is_off`` is the result
    of :func:`off_lattices`, if known. ``ValueError`` if numbers are too large.
    """
    # 1. Check the limits.
    points, parents = sources.points, sources.parents
    largest = max(np.abs(points).max(initial=0.0), sources.distances.max(initial=0.0), domain.width.max())
    if largest > _LARGEST_SQUARED:
        limit = f"within {_LARGEST_SQUARED:g}, as 32-bit queries square them, got {largest:g}"
        raise ValueError(f"Cones need distances and domains {limit}. Scale them down, or use another leaf model.")
    if (count := len(points)) >= (limit := 1 << _COUNT_BITS):
        raise ValueError(f"A file can hold fewer than {limit:,} sources, got {count:,}. Use another leaf model.")
    # 2. Round coordinates to multiples of 2**exponent (fine) or of 1 / fraction (on the lattice).
    exponent = int(np.ceil(np.log2(domain.width.max()))) - _FINE_BITS
    fraction, is_fine = _lattice(off_lattices(points, domain) if is_off is None else is_off, exponent)
    code = np.rint(np.where(is_fine[:, None], points * 2.0**-exponent, points * fraction)).astype(np.int64)
    rows = np.column_stack([~is_fine, code])
    # 3. Count the turns from each source to its root, along the parents, and on from there along the exits.
    onward = parents if sources.exits is None else np.where(parents == np.arange(len(rows)), sources.exits, parents)
    num_turns, ahead = np.zeros(len(rows), np.int64), np.arange(len(rows))
    while (has_turn := onward[ahead] != ahead).any():
        num_turns += has_turn
        ahead = onward[ahead]
    if sources.exits is not None:  # distances may differ at one place, where obstacles touch: number groups of them
        order = np.lexsort([sources.distances, *rows.T[::-1]])
        is_apart = np.diff(sources.distances[order]) > _SAME * 2.0**exponent
        group = np.append(0, np.cumsum(is_apart | (rows[order[1:]] != rows[order[:-1]]).any(axis=1)))
        rows = np.column_stack([rows, group[np.argsort(order)]])
    # 4. Sort, fine sources first. Of sources with equal rows, keep one with the fewest turns. A kept source then has
    # more turns than the source kept for its parent or exit, so no circle can arise.
    order = np.lexsort([num_turns, *rows.T[::-1]])
    is_new = np.append(True, (rows[order[1:]] != rows[order[:-1]]).any(axis=1))
    kept = order[is_new]
    index = np.empty(len(rows), np.int64)
    index[order] = np.cumsum(is_new) - 1
    parent = index[parents[kept]]
    is_root = parent == np.arange(len(kept))
    goals = None if sources.root_numbers is None else sources.root_numbers[kept[is_root]]
    root_offset = np.where(is_root, sources.distances[kept], 0).astype(np.float32).astype(np.float64)
    num_fine = int(np.count_nonzero(is_fine[kept]))
    return StoredSources(num_fine, exponent, fraction, code[kept], parent, root_offset, goals), index


def off_lattices(points: Float[np.ndarray, "sources dim"], domain: Box) -> Bool[np.ndarray, "sources fractions"]:
    """Return, for each point and each ``n`` in ``_LATTICES``, whether a coordinate is no multiple of ``1 / n``."""
    # A coordinate x is on the lattice if |n x - round(n x)| <= n * rounding. This tolerance is a little more than the
    # rounding of corners in a workspace.
    rounding = 4e-12 * domain.width.max() + 4e-15 * np.abs(points).max(initial=0.0)
    scaled = points[:, :, None] * _LATTICES
    return (np.abs(scaled - np.rint(scaled)) > _LATTICES * rounding).any(axis=1)


def _lattice(is_off: Bool[np.ndarray, "sources choices"], exponent: int) -> tuple[int, Bool[np.ndarray, " sources"]]:
    # The n for which multiples of 1 / n take the fewest bits, and which sources are no such multiples. A coordinate
    # of these counts _FINE_BITS bits, any other coordinate log2(n).
    fractions = _LATTICES[2.0**-exponent > _LATTICES]  # lattices with larger steps than those of fine sources
    if not len(fractions):  # in a very wide domain, integers are too fine
        return 1, np.ones(len(is_off), bool)
    num_off = np.count_nonzero(is_off[:, : len(fractions)], axis=0)
    best = int(np.argmin(num_off * _FINE_BITS + (len(is_off) - num_off) * np.log2(fractions)))
    return int(fractions[best]), is_off[:, best]


def write_cones(body: BitWriter, domain: Box, cones: StoredCones) -> None:
    """Write the coordinates of sources in lattice steps, then their parents, then the source of each leaf.

    Instead of a parent, a root has its offset (see :class:`StoredSources`).
    """
    sources, exponent, fraction = cones.sources, cones.sources.exponent, cones.sources.fraction
    fine, others = np.split(sources.code, [sources.num_fine])
    groups = (fine, exponent + _EXPONENT_BIAS, 2.0**-exponent), (others, fraction, fraction)
    for code, step_field, steps_per_unit in groups:
        body.write(np.array([len(code)]), _COUNT_BITS)
        if len(code):
            lowest = code.min(axis=0)
            body.write(np.array([step_field]), _STEP_BITS)
            body.write_signed(lowest - _origin_in_steps(domain.lo * steps_per_unit))
            body.write_coded(np.diff(code[:, 0]))  # at least 0: sources are sorted by the first axis
            for along in (code - lowest).T[1:]:
                width = int(along.max()).bit_length()
                body.write(np.array([width]), _WIDTH_BITS).write(along, width)
    body.write(sources.is_root.astype(np.int64), 1)
    body.write_floats(sources.root_offset[sources.is_root])
    body.write(sources.parent[~sources.is_root], (len(sources.code) - 1).bit_length())
    _write_ranks(body, cones.source)


def write_goals(body: BitWriter, goals: Int[np.ndarray, " roots"]) -> BitWriter:
    width = int(goals.max()).bit_length()
    return body.write(np.array([width]), _WIDTH_BITS).write(goals, width)


def _write_ranks(body: BitWriter, source: Int[np.ndarray, " leaves"]) -> None:
    # 1. Each leaf's source as its rank in a list of all sources, 0, 1, 2, ... at first: the source of each leaf moves
    # to the front, so that the source of the leaf before has rank 0.
    #   list of all sources = used ones, the latest first (`recent`), then unused ones in ascending order
    # So an unused source has the rank  len(used) + apex - (number of used sources below apex).  Source 0, the first
    # of the list, counts as used.
    changes = np.flatnonzero(np.diff(source, prepend=0))
    ranks, recent, used = [], [0], [0]  # `used` is sorted
    for apex in source[changes].tolist():
        num_below = bisect_left(used, apex)
        if num_below < len(used) and used[num_below] == apex:
            ranks.append(recent.index(apex))
            recent.remove(apex)
        else:
            ranks.append(len(used) + apex - num_below)
            used.insert(num_below, apex)
        recent.insert(0, apex)
    rank = np.zeros(len(source), np.int64)
    rank[changes] = ranks
    # 2. Is it 0, for all leaves; is it 1, for the leaves left; is it 2, for the leaves left; then what is left.
    for low_rank in range(_ESCAPE):
        body.write((rank == low_rank).astype(np.int64), 1)
        rank = rank[rank > low_rank]
    body.write_coded(rank - _ESCAPE)


def read_cones(body: BitReader, domain: Box, num_leaves: int) -> StoredCones:
    """Decode the sources of cones, and the source of each leaf; ``ValueError`` if they are invalid."""
    # 1. Coordinates: fine sources, then sources on the lattice.
    exponent, fraction, parts = 0, 1, []
    if num_fine := int(body.read_fixed_width(1, _COUNT_BITS)[0]):
        exponent = int(body.read_fixed_width(1, _STEP_BITS)[0]) - _EXPONENT_BIAS
        if abs(exponent) > _LARGEST_EXPONENT:
            raise ValueError(f"it states coordinates in steps of 2**{exponent}")
        parts.append(_read_codes(body, num_fine, _origin_in_steps(domain.lo * 2.0**-exponent)))
    if num_others := int(body.read_fixed_width(1, _COUNT_BITS)[0]):
        if not (fraction := int(body.read_fixed_width(1, _STEP_BITS)[0])):
            raise ValueError("it states coordinates in steps of 1 / 0")
        parts.append(_read_codes(body, num_others, _origin_in_steps(domain.lo * fraction)))
    if not parts:
        raise ValueError("it states no sources")
    # 2. Offsets of roots, and parents of the other sources.
    code, count = np.concatenate(parts), num_fine + num_others
    is_root = body.read_fixed_width(count, 1) == 1
    parent, offset = np.arange(count), np.zeros(count)
    offset[is_root] = body.read_floats(int(np.count_nonzero(is_root)))
    parent[~is_root] = body.read_fixed_width(int(np.count_nonzero(~is_root)), (count - 1).bit_length())
    if parent.max() >= count:
        raise ValueError(f"it names source {parent.max()} of {count}")
    sources = StoredSources(num_fine, exponent, fraction, code, parent, offset)
    if not (np.isfinite(offset).all() and np.abs(sources.points).max() < LARGEST and sources.offsets.max() < LARGEST):
        raise ValueError("it states sources whose coordinates or distances are too large")
    return StoredCones(sources, _read_ranks(body, num_leaves, len(sources.code)))


def read_goals(body: BitReader, num_roots: int) -> Int[np.ndarray, " roots"]:
    if (width := int(body.read_fixed_width(1, _WIDTH_BITS)[0])) > _COUNT_BITS:
        raise ValueError(f"it states goals of {width} bits")
    return body.read_fixed_width(num_roots, width)


def _read_codes(body: BitReader, count: int, origin: Int[np.ndarray, " dim"]) -> Int[np.ndarray, "count dim"]:
    """Decode the coordinates of ``count`` sources, in lattice steps.

    Along the first axis, the file has differences of successive coordinates. ``origin`` is the domain's lower corner
    in lattice steps.
    """
    lowest = body.read_signed(len(origin))
    columns = [np.append(0, np.cumsum(body.read_coded(count - 1)))]
    for _ in origin[1:]:
        if (width := int(body.read_fixed_width(1, _WIDTH_BITS)[0])) > _MOST_COORDINATE_BITS:
            raise ValueError(f"it states coordinates of {width} bits")
        columns.append(body.read_fixed_width(count, width))
    return np.column_stack(columns) + lowest + origin


def _origin_in_steps(steps: Float[np.ndarray, " dim"]) -> Int[np.ndarray, " dim"]:
    if np.abs(steps).max() > _FARTHEST:
        raise ValueError("it states coordinates in steps that are too small for its domain")
    return np.rint(steps).astype(np.int64)


def _read_ranks(body: BitReader, num_leaves: int, count: int) -> Int[np.ndarray, " leaves"]:
    """Decode the source of each leaf, one of ``count``: the inverse of :func:`_write_ranks`."""
    # 1. Ranks. A leaf whose flag of a rank is not set has a higher rank.
    rank, pending = np.zeros(num_leaves, np.int64), np.arange(num_leaves)
    for low_rank in range(_ESCAPE):
        pending = pending[body.read_fixed_width(len(pending), 1) == 0]
        rank[pending] = low_rank + 1
    rank[pending] += body.read_coded(len(pending))
    if (rank >= count).any():
        raise ValueError(f"it names source {rank.max()} of {count}")
    # 2. The list of sources changes only at leaves of positive rank; all leaves up to the next have its first source.
    changes = np.flatnonzero(rank)
    sources = list(range(count))
    front = np.zeros(len(changes) + 1, np.int64)  # first source of the list before any change, and after each
    for i, place in enumerate(rank[changes].tolist()):
        sources.insert(0, sources.pop(place))
        front[i + 1] = sources[0]
    return front[np.searchsorted(changes, np.arange(num_leaves), side="right")]


@dataclass(frozen=True, eq=False)
class ConeFiles:
    """An encoder of the cone leaves of a PLR, which also computes the size of the PLR's file."""

    sources: Sources  # possible apexes: goals and corners
    domain: Box

    @cached_property
    def _is_off(self) -> Bool[np.ndarray, "sources fractions"]:
        return off_lattices(self.sources.points, self.domain)

    def stored(self, source: Int[np.ndarray, " leaves"]) -> StoredCones:
        """Encode cone leaves; ``source`` has the index of each leaf's apex among the sources.

        A negative index (-1 or ``CUT_OFF``) marks a leaf without a path to the goal; it gets another leaf's apex.
        Only the sources on paths from the apexes to the goal are encoded.
        """
        sources = self.sources
        # 1. A leaf without a path gets the apex of the last leaf before it that has one (else of the first).
        leaf = np.flatnonzero(source >= 0)
        before = np.searchsorted(leaf, np.arange(len(source)), side="right") - 1
        source = source[leaf[np.maximum(before, 0)]]
        # 2. Keep the apexes of leaves, their parents, the parents of these, and so on; also where paths continue.
        is_kept, added = np.zeros(len(sources.parents), bool), source
        onward = [sources.parents] if sources.exits is None else [sources.parents, sources.exits]
        while len(added):
            is_kept[added] = True
            added = np.unique(np.concatenate([ahead[added] for ahead in onward]))
            added = added[~is_kept[added]]
        kept = np.flatnonzero(is_kept)
        # 3. Encode them.
        columns = sources.points[kept], sources.distances[kept], np.searchsorted(kept, sources.parents[kept])
        numbers = None if sources.root_numbers is None else sources.root_numbers[kept]
        exits = None if sources.exits is None else np.searchsorted(kept, sources.exits[kept])
        stored, index = store_sources(Sources(*columns, numbers, exits), self.domain, self._is_off[kept])
        return StoredCones(stored, index[np.searchsorted(kept, source)])

    def num_bytes(self, source: Int[np.ndarray, " leaves"], limits: Limits) -> int:
        """Return the size in bytes of a file of leaves with the apexes ``source``: see :meth:`Limits.file_size`.

        Apexes are indices of sources; a leaf that is cut off from the goal has ``CUT_OFF``.
        """
        cones = self.stored(source)
        write_cones(body := BitWriter(), self.domain, cones)
        if cones.sources.goals is not None:
            write_goals(body, cones.sources.goals)
        return limits.file_size(self.domain.dim, len(source), body.num_bits, int(np.count_nonzero(source == CUT_OFF)))

    def fit(self, limits: Limits, source: Int[np.ndarray, " leaves"]) -> bool:
        return self.num_bytes(source, limits) <= limits.max_bytes
