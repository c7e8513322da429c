"""What a query of pairs reads: walls, corners, distances between them, and the list of corners of each leaf."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt16

from plr_jax._arrays import padded, padded_size, runs
from plr_jax.geometry.box import Box
from plr_jax.plr.pairs.stored import Stored
from plr_jax.plr.query.tables import Tables, build_tables

_RECEDING = 32 * float(np.finfo(np.float32).eps)
"""How far walls move back for sight, in widths of the domain: several times what a query rounds."""
_UNROLLED = 16  # walls at a time


@dataclass(frozen=True)
class _NoLeaf:
    """What the tables of a partition alone ask of a leaf model."""

    least_bytes: float = 1.0
    has_deep_trees: bool = False


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class PairTables:
    """All that a query reads. Coordinates count from the middle of the domain.

    Attributes:
        partition: Finds leaves.
        walls: Ends of the walls that block sight, moved back a little; groups of them, padded with empty ones.
        x: First coordinate of the corners of each leaf's list; padding is ``inf``.
        y: Second coordinate.
        listed: The corners; padding is one more than the last corner.
        distances: Distance between each two corners, row by row; ``inf`` for padding.
        last: Of the ways from each corner to a leaf's box by a corner of its list, that by which the shortest goes.
        other: At most the length of any way by another corner of the list, to anywhere in the box.
        middle: The middle of the domain.
        half: Half its width, along each axis.
        proud_walls: Ends of the walls moved into free space instead.
        proud_corners: The corners moved into it twice as far.
        rounding: By how much distances by way of the file's points may err, and more by way of the proud corners.
    """

    partition: Tables
    walls: Float[Array, "groups 16 7"]
    x: Float[Array, "leaves longest"]
    y: Float[Array, "leaves longest"]
    listed: UInt16[Array, "leaves longest"]
    distances: Float[Array, "size size"]
    last: UInt16[Array, "leaves size"]
    other: Float[Array, "leaves size"]
    corners: Float[Array, "size 2"]
    middle: Float[Array, "2"]
    half: Float[Array, "2"]
    proud_walls: Float[Array, "groups 16 7"]
    proud_corners: Float[Array, "size 2"]
    rounding: Float[Array, "2"]

    @property
    def in_free_space(self) -> "PairTables":
        """The same, but what counts as a way is certainly free."""
        x, y = (along[self.listed] for along in self.proud_corners.T)
        return replace(self, walls=self.proud_walls, x=x, y=y)


def build_pair_tables(stored: Stored, num_bytes: int) -> PairTables:
    """The tables of what a file of so many bytes holds."""
    middle = (stored.domain.lo + stored.domain.hi) / 2
    domain = Box(stored.domain.lo - middle, stored.domain.hi - middle)
    cells, count = stored.cells, len(stored.corner)
    partition = build_tables(domain, cells, np.zeros((len(cells), 1)), _NoLeaf(), num_bytes)
    size, rows = padded_size(count + 1), padded_size(len(cells))
    distances = np.full((size, size), np.inf)
    distances[:count, :count] = stored.distances
    listed = _listed(stored, rows, count)
    points = np.append(stored.points - middle, np.full((1, 2), np.inf), axis=0)
    lo, hi = cells.grown_boxes(domain)
    last, other = _ways_to_leaves(points, distances, listed[: len(cells)], lo, hi)
    receding = _RECEDING * stored.domain.width.max()
    proud = stored.outline.moved_points(-2 * receding)[stored.corner] - middle
    farther = float(np.linalg.norm(proud - points[:count], axis=1).max(initial=0.0))
    x, y = (along[listed] for along in points.T)
    return PairTables(
        partition=partition,
        walls=_groups_of_walls(stored.outline.moved_walls(receding) - np.tile(middle, 2)),
        x=_in_32_bits(x),
        y=_in_32_bits(y),
        listed=jnp.asarray(listed.astype(np.uint16)),
        distances=_in_32_bits(distances),
        last=jnp.asarray(padded(last, rows)),
        other=jnp.asarray(padded(other, rows)),
        corners=_in_32_bits(padded(points, size, np.inf)),
        middle=_in_32_bits(middle),
        half=_in_32_bits(stored.domain.width / 2),
        proud_walls=_groups_of_walls(stored.outline.moved_walls(-receding) - np.tile(middle, 2)),
        proud_corners=_in_32_bits(padded(proud, size, np.inf)),
        rounding=_in_32_bits(np.array([stored.rounding, stored.rounding + 2 * farther])),
    )


def _in_32_bits(values: Float[np.ndarray, "*n"]) -> Float[Array, "*n"]:
    return jnp.asarray(values.astype(np.float32))


def _groups_of_walls(walls: Float[np.ndarray, "walls 4"]) -> Float[Array, "groups 16 7"]:
    """Walls in groups, as many as a power of two; the last ones have no length."""
    size = _UNROLLED * padded_size(-(-len(walls) // _UNROLLED))
    ax, ay, bx, by = walls.astype(np.float32).T
    ex, ey = bx - ax, by - ay
    of_wall = np.stack([ax, ay, bx, by, ex, ey, ex * ay - ey * ax], axis=1)
    return jnp.asarray(padded(of_wall, size).reshape(-1, _UNROLLED, 7))


def _listed(stored: Stored, rows: int, count: int) -> Int[np.ndarray, "rows longest"]:
    """The lists as rows of one length, a multiple of eight."""
    lengths = np.bincount(stored.leaf, minlength=rows)
    listed = np.full((rows, 8 * max(1, -(-int(lengths.max()) // 8))), count)
    listed[runs(lengths)] = stored.listed
    return listed


def _ways_to_leaves(
    points: Float[np.ndarray, "corners_plus_one 2"],
    distances: Float[np.ndarray, "size size"],
    listed: Int[np.ndarray, "leaves longest"],
    lo: Float[np.ndarray, "leaves 2"],
    hi: Float[np.ndarray, "leaves 2"],
) -> tuple[UInt16[np.ndarray, "leaves size"], Float[np.ndarray, "leaves size"]]:
    """The corner of each leaf's list by which the shortest way from each corner goes, and the shortest by another."""
    last = np.full((len(listed), len(distances)), len(points) - 1, np.uint16)
    other = np.full(last.shape, np.inf, np.float32)
    for leaf, corners in enumerate(listed):
        corners = corners[corners < len(points) - 1]
        if not len(corners):
            continue
        beside = np.maximum(np.maximum(lo[leaf] - points[corners], points[corners] - hi[leaf]), 0)
        way = np.hypot(*beside.T)[:, None] + distances[corners]
        best = way.argmin(axis=0)
        last[leaf] = corners[best]
        if len(corners) > 1:
            way[best, np.arange(way.shape[1])] = np.inf
            other[leaf] = _rounded_down(way.min(axis=0))
    return last, other


def _rounded_down(values: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """The 32-bit floats at or below."""
    rounded = values.astype(np.float32)
    return np.where(rounded > values, np.nextafter(rounded, np.float32(-np.inf)), rounded)
