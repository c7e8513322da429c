"""Encode cone leaves, functions ``offset + |x - source|``: a table of sources, and the index of every leaf's source.

A source is an obstacle corner or the goal. Its offset is its distance to the goal; a file stores instead its
*parent*, the next source on its shortest path. Only *roots*, such as the goal, store offsets. Most maps have
coordinates on a lattice, such as multiples of 0.01. Other sources, such as a goal, are *fine*: multiples of about
``2**-26`` of the domain's width. The bits in the file are described in ``portable/FORMAT.md``.
"""

from bisect import bisect_left
from copy import copy
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

_STEP_BITS, _COUNT_BITS, _WIDTH_BITS, _EXPONENT_BIAS = 16, 20, 6, 1 << 15
_MOST_COORDINATE_BITS, _LARGEST_EXPONENT = 40, 200
_LARGEST_SQUARED = 1e18  # larger numbers overflow when squared in 32 bits
_FINE_BITS = 26  # bits of a coordinate that is not on the lattice
_FARTHEST = 2.0**60  # largest distance of the domain's corner from the origin, in steps
CUT_OFF = -2  # instead of a leaf's source: the goal cannot be reached from the leaf's free points
_ESCAPE = 3  # smaller ranks are stored as flags, others as codes
_LATTICES = np.array([*range(1, 257), 360, 400, 500, 512, 1000, 1024, 2000, 2048, 4096, 5000, 8192, 10000])


@dataclass(frozen=True, eq=False)
class StoredSources:
    """Apexes of cones (corners, goals) as in a file: fine ones, then ones on the lattice, sorted by coordinates."""

    num_fine: int  # size of the first group: sources that are not on the map's lattice
    exponent: int  # coordinates in the first group are multiples of 2**exponent
    fraction: int  # coordinates in the second group, on the lattice, are multiples of 1 / fraction
    code: Int[np.ndarray, "sources dim"]
    parent: Int[np.ndarray, " sources"]  # next source on the way to the goal; a root is its own parent
    root_offset: Float[np.ndarray, " sources"]  # of roots: distance to the goal, exact in 32 bits
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

    @property
    def goal_of_source(self) -> Int[np.ndarray, " sources"] | None:
        if self.goals is None:
            return None
        return self.goals[(np.cumsum(self.is_root) - 1)[self._offsets_and_roots[1]]]

    @cached_property
    def _offsets_and_roots(self) -> tuple[Float[np.ndarray, " sources"], Int[np.ndarray, " sources"]]:
        onward = self.parent
        length = np.sqrt(sum_of_columns(np.square(self.points - self.points[onward])))
        for _ in range(len(onward).bit_length()):  # pointer doubling
            length, onward = length + length[onward], onward[onward]
        if not self.is_root[onward].all():
            raise ValueError("its sources follow one another in a circle")
        return length + self.root_offset[onward], onward


@dataclass(frozen=True, eq=False)
class StoredCones:
    """Cones as in a file: the sources, and the source of each leaf."""

    sources: StoredSources
    source: Int[np.ndarray, " leaves"]


def store_sources(
    points: Float[np.ndarray, "sources dim"],
    offsets: Float[np.ndarray, " sources"],
    parents: Int[np.ndarray, " sources"],
    domain: Box,
    is_off: Bool[np.ndarray, "sources fractions"] | None = None,
    goals: Int[np.ndarray, " goals"] | None = None,  # indices of several goals, which are the first sources
) -> tuple[StoredSources, Int[np.ndarray, " sources"]]:
    # Sources without duplicates, and each given source's new index.
    largest = max(np.abs(points).max(initial=0.0), np.abs(offsets).max(initial=0.0), domain.width.max())
    if largest > _LARGEST_SQUARED:
        raise ValueError(
            f"Cones need distances and domains within {_LARGEST_SQUARED:g}, as 32-bit queries square them, got "
            f"{largest:g}. Scale them down, or use another leaf model."
        )
    if len(points) >= 1 << _COUNT_BITS:
        raise ValueError(
            f"A file can hold fewer than {1 << _COUNT_BITS:,} sources, got {len(points):,}. Use another leaf model."
        )
    exponent = int(np.ceil(np.log2(domain.width.max()))) - _FINE_BITS
    fraction, is_fine = _lattice(off_lattices(points, domain) if is_off is None else is_off, exponent)
    code = np.rint(np.where(is_fine[:, None], points * 2.0**-exponent, points * fraction)).astype(np.int64)
    rows = np.column_stack([~is_fine, code])
    # Of sources with equal codes, keep one with the fewest turns onward. Parents have fewer, so no circle can arise.
    num_turns, root = np.zeros(len(rows), np.int64), np.arange(len(rows))
    while (turns := parents[root] != root).any():
        num_turns, root = num_turns + turns, parents[root]
    order = np.lexsort([num_turns, *rows.T[::-1]])
    is_new = np.append(True, (rows[order[1:]] != rows[order[:-1]]).any(axis=1))
    first, index = order[is_new], np.empty(len(rows), np.int64)
    index[order], rows = np.cumsum(is_new) - 1, rows[first]
    parent, itself = index[parents[first]], np.arange(len(first))
    root_offset = np.where(parent == itself, offsets[first].astype(np.float32).astype(np.float64), 0.0)
    of_roots = None if goals is None else goals[first[parent == itself]]
    num_fine = int(np.count_nonzero(rows[:, 0] == 0))
    return StoredSources(num_fine, exponent, fraction, rows[:, 1:], parent, root_offset, of_roots), index


def off_lattices(points: Float[np.ndarray, "sources dim"], domain: Box) -> Bool[np.ndarray, "sources fractions"]:
    """Return which points are off the lattice of multiples of ``1 / n``: a column for each ``n`` in ``_LATTICES``."""
    # The tolerance is a little more than the rounding of corners in a workspace.
    rounding = 4e-12 * domain.width.max() + 4e-15 * np.abs(points).max(initial=0.0)
    is_off = np.zeros((len(points), len(_LATTICES)), bool)
    for along in points.T:
        scaled = along[:, None] * _LATTICES
        is_off |= np.abs(scaled - np.rint(scaled)) > _LATTICES * rounding
    return is_off


def _lattice(is_off: Bool[np.ndarray, "sources choices"], exponent: int) -> tuple[int, Bool[np.ndarray, " sources"]]:
    # The n for which multiples of 1 / n take the fewest bits, and which sources are no such multiples.
    fractions = _LATTICES[2.0**-exponent > _LATTICES]
    if not len(fractions):  # in a very wide domain, integers are too fine
        return 1, np.ones(len(is_off), bool)
    off = np.count_nonzero(is_off[:, : len(fractions)], axis=0)
    best = int(np.argmin(off * _FINE_BITS + (len(is_off) - off) * np.log2(fractions)))
    return int(fractions[best]), is_off[:, best]


def write_cones(body: BitWriter, domain: Box, cones: StoredCones) -> None:
    _write_sources(body, domain, cones.sources)
    _write_ranks(body, cones.source)


def _write_sources(body: BitWriter, domain: Box, sources: StoredSources) -> None:
    """Write the sources: coordinates in steps of two lattices, and each one's distance to the goal or parent."""
    (fine, others), exponent = np.split(sources.code, [sources.num_fine]), sources.exponent
    kinds = (fine, exponent + _EXPONENT_BIAS, 2.0**-exponent), (others, sources.fraction, sources.fraction)
    for code, step, scale in kinds:
        body.write(np.array([len(code)]), _COUNT_BITS)
        if len(code):
            lowest = code.min(axis=0)
            body.write(np.array([step]), _STEP_BITS).write_signed(lowest - _origin_in_steps(domain.lo * scale))
            body.write_coded(np.diff(code[:, 0]))
            for along in (code - lowest).T[1:]:
                width = int(along.max()).bit_length()
                body.write(np.array([width]), _WIDTH_BITS).write(along, width)
    body.write(sources.is_root.astype(np.int64), 1)
    body.write_floats(sources.root_offset[sources.is_root])
    body.write(sources.parent[~sources.is_root], (len(sources.code) - 1).bit_length())


def write_goals(body: BitWriter, goals: Int[np.ndarray, " roots"]) -> BitWriter:
    width = int(goals.max()).bit_length()
    return body.write(np.array([width]), _WIDTH_BITS).write(goals, width)


def _write_ranks(body: BitWriter, source: Int[np.ndarray, " leaves"]) -> None:
    # Each leaf's source as its rank in a move-to-front list: 0 for the source of the leaf before.
    rank = np.zeros(len(source), np.int64)
    changes, ranks = np.flatnonzero(np.diff(source, prepend=0)), []
    # Only used sources need lists, by time of use and sorted; unused ones follow in their order.
    recent, used = [0], [0]
    for apex in source[changes].tolist():
        if (place := bisect_left(used, apex)) < len(used) and used[place] == apex:
            ranks.append(recent.index(apex))
            recent.remove(apex)
        else:
            ranks.append(len(used) + apex - place)
            used.insert(place, apex)
        recent.insert(0, apex)
    rank[changes] = ranks
    for low_rank in range(_ESCAPE):
        body.write((rank == low_rank).astype(np.int64), 1)
        rank = rank[rank > low_rank]
    body.write_coded(rank - _ESCAPE)


def read_cones(body: BitReader, domain: Box, num_leaves: int) -> StoredCones:
    """Decode the sources of cones, and the source of each leaf; ``ValueError`` if they are invalid."""
    exponent, fraction, parts = 0, 1, []
    num_fine = int(body.read_fixed_width(1, _COUNT_BITS)[0])
    if num_fine:
        exponent = int(body.read_fixed_width(1, _STEP_BITS)[0]) - _EXPONENT_BIAS
        if abs(exponent) > _LARGEST_EXPONENT:
            raise ValueError(f"it states coordinates in steps of 2**{exponent}")
        parts.append(_read_codes(body, num_fine, _origin_in_steps(domain.lo * 2.0**-exponent)))
    num_others = int(body.read_fixed_width(1, _COUNT_BITS)[0])
    if num_others:
        fraction = int(body.read_fixed_width(1, _STEP_BITS)[0])
        if not fraction:
            raise ValueError("it states coordinates in steps of 1 / 0")
        parts.append(_read_codes(body, num_others, _origin_in_steps(domain.lo * fraction)))
    if not parts:
        raise ValueError("it states no sources")
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
    """Decode the coordinates of sources in lattice steps; the first coordinates are stored as differences."""
    lowest = body.read_signed(len(origin))
    columns = [np.append(0, np.cumsum(body.read_coded(count - 1)))]
    for _ in origin[1:]:
        width = int(body.read_fixed_width(1, _WIDTH_BITS)[0])
        if width > _MOST_COORDINATE_BITS:
            raise ValueError(f"it states coordinates of {width} bits")
        columns.append(body.read_fixed_width(count, width))
    return np.column_stack(columns) + lowest + origin


def _origin_in_steps(steps: Float[np.ndarray, " dim"]) -> Int[np.ndarray, " dim"]:
    if np.abs(steps).max() > _FARTHEST:
        raise ValueError("it states coordinates in steps that are too small for its domain")
    return np.rint(steps).astype(np.int64)


def _read_ranks(body: BitReader, num_leaves: int, count: int) -> Int[np.ndarray, " leaves"]:
    """Decode the source of each leaf: the inverse of :func:`_write_ranks`, with a list of all sources."""
    rank, pending = np.zeros(num_leaves, np.int64), np.arange(num_leaves)
    for low_rank in range(_ESCAPE):
        pending = pending[body.read_fixed_width(len(pending), 1) == 0]
        rank[pending] = low_rank + 1
    rank[pending] += body.read_coded(len(pending))
    if (rank >= count).any():
        raise ValueError(f"it names source {rank.max()} of {count}")
    recent, changes = list(range(count)), np.flatnonzero(rank)
    latest = np.zeros(len(changes) + 1, np.int64)
    for i, place in enumerate(rank[changes].tolist()):
        recent.insert(0, recent.pop(place))
        latest[i + 1] = recent[0]
    return latest[np.searchsorted(changes, np.arange(num_leaves), side="right")]


class ConeFiles:
    """An encoder of cone leaves that computes file sizes; apexes are ``sources``, obstacle corners and goals."""

    def __init__(self, sources: Sources, domain: Box) -> None:
        self._sources, self._domain = sources, domain
        self._is_off = off_lattices(sources.points, domain)
        self._cache: dict[bytes, tuple[StoredSources, np.ndarray, int]] = {}

    def of_goal(self, sources: Sources) -> "ConeFiles":
        """Return an encoder for another goal; ``sources`` are that goal, then the same corners in the same order."""
        files = copy(self)
        files._sources, files._cache, files._is_off = sources, {}, self._is_off.copy()
        files._is_off[:1] = off_lattices(sources.points[:1], self._domain)
        return files

    def stored(self, source: Int[np.ndarray, " leaves"]) -> StoredCones:
        """Encode leaves by the index of each leaf's apex; those without a path, < 0, get another leaf's apex."""
        return self._stored(source)[0]

    def num_bytes(self, source: Int[np.ndarray, " leaves"], limits: Limits) -> int:
        cones, num_bits = self._stored(source)
        _write_ranks(body := BitWriter(), cones.source)
        num_cut_off = int(np.count_nonzero(source == CUT_OFF))
        return limits.file_size(self._domain.dim, len(source), num_bits + body.num_bits, num_cut_off)

    def fit(self, limits: Limits, source: Int[np.ndarray, " leaves"]) -> bool:
        return self.num_bytes(source, limits) <= limits.max_bytes

    def _stored(self, source: Int[np.ndarray, " leaves"]) -> tuple[StoredCones, int]:
        """Encode leaves and the sources that their paths need; also return the number of bits of the sources."""
        leaf, sources = np.flatnonzero(source >= 0), self._sources
        before = np.searchsorted(leaf, np.arange(len(source)), side="right") - 1
        source = source[leaf[np.maximum(before, 0)]]
        is_kept, used = np.zeros(len(sources.parents), bool), source
        while len(used):  # add parents, their parents, and so on
            is_kept[used] = True
            used = sources.parents[used]
            used = used[~is_kept[used]]
        kept = np.flatnonzero(is_kept)
        if kept.tobytes() not in self._cache:
            place = np.searchsorted(kept, np.arange(len(sources.parents)))
            stored, index = store_sources(
                sources.points[kept],
                sources.distances[kept],
                place[sources.parents[kept]],
                self._domain,
                self._is_off[kept],
                None if sources.goals is None else sources.goals[kept[kept < len(sources.goals)]],
            )
            _write_sources(body := BitWriter(), self._domain, stored)
            if stored.goals is not None:
                write_goals(body, stored.goals)
            self._cache[kept.tobytes()] = stored, index[np.minimum(place, len(kept) - 1)], body.num_bits
        stored, index, num_bits = self._cache[kept.tobytes()]
        return StoredCones(stored, index[source]), num_bits
