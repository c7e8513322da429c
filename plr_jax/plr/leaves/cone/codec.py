"""Cones as they are stored: a small table of sources, and for every leaf which of them is its own.

Sources have coordinates that are multiples of one ``step``: those of the map's own lattice where it has one (a grid,
two decimals), else of a power of two about ``2**-24`` of the domain. A source is followed by its *parent*, to which
its own shortest path goes next, so its offset, its distance to the goal, needs no number: it is that of the parent and
the way there. A *root*, such as the goal, has a number of its own.

What a file keeps of the leaves, as bits:

    is the step a fraction ``1 / number``, in 1 bit; else it is a power of two; the number or the exponent plus 2**15
      in 16 bits
    number of sources, in 20 bits
    for every axis the smallest coordinate, in steps from the rounded lower corner of the domain: a signed number
    sources are sorted by coordinates; along the first axis by how much each is above the one before
    along every other axis: a width in 6 bits, and in so many bits how much each is above the smallest
    which sources are roots, 1 bit each, and their offsets as 32-bit floats
    parents of the others, each in as many bits as the largest index needs
    the rank of every leaf's source among those lately used, the latest first (at first they stand in order): for all
      leaves, is it 0; for the rest, is it 1; for the rest, is it 2, 1 bit each; of what is left by how much it is
      more than 3, as codes

Signed numbers and codes are as in ``file/bits.py``.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.geometry.box import Box
from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.query.tables import LARGEST

_STEP_BITS, _COUNT_BITS, _WIDTH_BITS, _EXPONENT_BIAS = 16, 20, 6, 1 << 15
_MOST_COORDINATE_BITS = 40
_FINE_BITS = 26  # of a coordinate where the sources have no lattice
_ESCAPE = 3
_LATTICES = np.array([*range(1, 257), 360, 400, 500, 512, 1000, 1024, 2000, 2048, 4096, 5000, 8192, 10000])


@dataclass(frozen=True, eq=False)
class StoredSources:
    """Sources as a file keeps them.

    Attributes:
        fraction: The step is 1 over it; or 0.
        exponent: The step is this power of two, if it is no fraction.
        code: Coordinates in steps, sorted.
        parent: The source that follows, its own index for a root.
        root_offset: Offsets of roots, exact in 32 bits; of others 0.
    """

    fraction: int
    exponent: int
    code: Int[np.ndarray, "sources dim"]
    parent: Int[np.ndarray, "sources"]
    root_offset: Float[np.ndarray, "sources"]

    @property
    def is_root(self) -> Bool[np.ndarray, "sources"]:
        """Which sources have an offset of their own."""
        return self.parent == np.arange(len(self.parent))

    @property
    def step(self) -> float:
        """What coordinates are multiples of."""
        return 1 / self.fraction if self.fraction else 2.0**self.exponent

    @cached_property
    def points(self) -> Float[np.ndarray, "sources dim"]:
        """Where they are."""
        return self.code / self.fraction if self.fraction else self.code * self.step

    @cached_property
    def offsets(self) -> Float[np.ndarray, "sources"]:
        """Distance of each to the goal, along its parents; raises ``ValueError`` if they lead in a circle."""
        onward = self.parent
        length = np.sqrt(np.square(self.points - self.points[onward]).sum(axis=1))
        for _ in range(len(onward).bit_length()):  # twice as far along the parents each time
            length, onward = length + length[onward], onward[onward]
        if not self.is_root[onward].all():
            raise ValueError("its sources follow one another in a circle")
        return length + self.root_offset[onward]


@dataclass(frozen=True, eq=False)
class StoredCones:
    """Cones as a file keeps them: the sources, and which one is each leaf's."""

    sources: StoredSources
    source: Int[np.ndarray, "leaves"]


def store_sources(
    points: Float[np.ndarray, "sources dim"],
    offsets: Float[np.ndarray, "sources"],
    parents: Int[np.ndarray, "sources"],
    domain: Box,
) -> tuple[StoredSources, Int[np.ndarray, "sources"]]:
    """Sources as a file can keep them, each once, and the index there of each one given.

    A parent is an index, of another source, or of a root its own.
    """
    if max(np.abs(points).max(initial=0.0), np.abs(offsets).max(initial=0.0)) > LARGEST:
        raise ValueError(f"Distances must be within {LARGEST:g} to be stored; scale them down.")
    fraction, exponent = _lattice(points, domain)
    code = np.rint(points * fraction if fraction else points * 2.0**-exponent).astype(np.int64)
    is_root = parents == np.arange(len(parents))
    code, first, index = np.unique(code, axis=0, return_index=True, return_inverse=True)
    parent = index[parents[first]]
    root_offset = np.where(is_root[first], offsets[first].astype(np.float32).astype(np.float64), 0.0)
    root_offset[parent != np.arange(len(parent))] = 0.0
    return StoredSources(fraction, exponent, code, parent, root_offset), index.ravel()


def _lattice(points: Float[np.ndarray, "sources dim"], domain: Box) -> tuple[int, int]:
    """The coarsest fraction whose multiples all coordinates are, to within rounding; else 0 and a fine exponent."""
    width = float(domain.width.max())
    fine = int(np.ceil(np.log2(width))) - _FINE_BITS
    rounding = 4e-12 * width + 4e-15 * np.abs(points).max(initial=0.0)  # of a workspace
    fractions = _LATTICES[2.0**-fine > _LATTICES]
    for some in (points[:8], points):  # few rule most of them out
        scaled = some.ravel() * fractions[:, None]
        fractions = fractions[(np.abs(scaled - np.rint(scaled)) <= fractions[:, None] * rounding).all(axis=1)]
    if len(fractions):
        return int(fractions[0]), 0
    return 0, fine


def write_cones(body: BitWriter, domain: Box, cones: StoredCones) -> None:
    """Append sources, and every leaf's."""
    sources = cones.sources
    count, dim = sources.code.shape
    number = sources.fraction if sources.fraction else sources.exponent + _EXPONENT_BIAS
    body.write(np.array([int(sources.fraction > 0)]), 1).write(np.array([number]), _STEP_BITS)
    body.write(np.array([count]), _COUNT_BITS)
    lowest = sources.code.min(axis=0)
    body.write_signed(lowest - _first_code(sources, domain))
    above = sources.code - lowest
    body.write_coded(np.diff(above[:, 0]))
    for axis in range(1, dim):
        width = int(above[:, axis].max()).bit_length()
        body.write(np.array([width]), _WIDTH_BITS).write(above[:, axis], width)
    body.write(sources.is_root.astype(np.int64), 1)
    body.write_floats(sources.root_offset[sources.is_root])
    body.write(sources.parent[~sources.is_root], (count - 1).bit_length())
    _write_ranks(body, _ranks(cones.source, count))


def read_cones(body: BitReader, domain: Box, num_leaves: int) -> StoredCones:
    """The next sources, and those of so many leaves; raises ``ValueError`` saying what is wrong with them."""
    is_fraction, number = (int(body.read_alike(1, width)[0]) for width in (1, _STEP_BITS))
    fraction, exponent = (number, 0) if is_fraction else (0, number - _EXPONENT_BIAS)
    if (is_fraction and not fraction) or abs(exponent) > 200:
        raise ValueError(f"it states coordinates in steps of {'1 / 0' if is_fraction else f'2**{exponent}'}")
    count = int(body.read_alike(1, _COUNT_BITS)[0])
    if not count:
        raise ValueError("it states no sources")
    lowest = body.read_signed(domain.dim)
    columns = [np.append(0, np.cumsum(body.read_coded(count - 1)))]
    for _ in range(1, domain.dim):
        width = int(body.read_alike(1, _WIDTH_BITS)[0])
        if width > _MOST_COORDINATE_BITS:
            raise ValueError(f"it states coordinates of {width} bits")
        columns.append(body.read_alike(count, width))
    is_root = body.read_alike(count, 1) == 1
    parent, offset = np.arange(count), np.zeros(count)
    offset[is_root] = body.read_floats(int(np.count_nonzero(is_root)))
    parent[~is_root] = body.read_alike(int(np.count_nonzero(~is_root)), (count - 1).bit_length())
    if parent.max() >= count:
        raise ValueError(f"it names source {parent.max()} of {count}")
    sources = StoredSources(fraction, exponent, np.column_stack(columns), parent, offset)
    sources.code[:] += lowest + _first_code(sources, domain)
    if not (np.isfinite(offset).all() and np.abs(sources.points).max() < LARGEST and sources.offsets.max() < LARGEST):
        raise ValueError("it states sources whose coordinates or distances are too large")
    return StoredCones(sources, _sources_of_ranks(_read_ranks(body, num_leaves), count))


def cones_bits(domain: Box, cones: StoredCones) -> int:
    """How many bits ``write_cones`` appends."""
    body = BitWriter()
    write_cones(body, domain, cones)
    return body.num_bits


def _first_code(sources: StoredSources, domain: Box) -> Int[np.ndarray, "dim"]:
    """The lower corner of the domain in steps, from which coordinates are counted."""
    return np.rint(domain.lo / sources.step).astype(np.int64)


def _ranks(source: Int[np.ndarray, "leaves"], count: int) -> Int[np.ndarray, "leaves"]:
    """Rank of each leaf's source among those lately used, 0 for the latest."""
    rank, recent = np.zeros(len(source), np.int64), list(range(count))
    for leaf in np.flatnonzero(np.diff(source, prepend=0)).tolist():
        rank[leaf] = place = recent.index(int(source[leaf]))
        recent.insert(0, recent.pop(place))
    return rank


def _sources_of_ranks(rank: Int[np.ndarray, "leaves"], count: int) -> Int[np.ndarray, "leaves"]:
    if (rank >= count).any():
        raise ValueError(f"it names source {rank.max()} of {count}")
    recent, changes = list(range(count)), np.flatnonzero(rank)
    latest = np.zeros(len(changes) + 1, np.int64)
    for number, place in enumerate(rank[changes].tolist()):
        recent.insert(0, recent.pop(place))
        latest[number + 1] = recent[0]
    return latest[np.searchsorted(changes, np.arange(len(rank)), side="right")]


def _write_ranks(body: BitWriter, rank: Int[np.ndarray, "leaves"]) -> None:
    for each in range(_ESCAPE):
        body.write((rank == each).astype(np.int64), 1)
        rank = rank[rank > each]
    body.write_coded(rank - _ESCAPE)


def _read_ranks(body: BitReader, num_leaves: int) -> Int[np.ndarray, "leaves"]:
    rank, rest = np.zeros(num_leaves, np.int64), np.arange(num_leaves)
    for each in range(_ESCAPE):
        rest = rest[body.read_alike(len(rest), 1) == 0]
        rank[rest] = each + 1
    rank[rest] += body.read_coded(len(rest))
    return rank
