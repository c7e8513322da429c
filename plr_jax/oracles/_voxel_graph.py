"""Shortest paths over the voxels of a volume."""

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int, UInt32

from plr_jax._arrays import as_finite_point, as_points, set_fields, shortened
from plr_jax._types import ArrayLike, Distances, Points
from plr_jax.geometry.box import Box
from plr_jax.geometry.voxels import VoxelGrid

_AXES = {6: 1, 18: 2, 26: 3}  # along how many a step leads at once
_ROUNDING = 1e-9  # share by which a bucket is narrower than the shortest step


@dataclass(frozen=True, eq=False, init=False)
class VoxelGraph:
    """Length of paths from voxel to voxel to a goal, a `DistanceFn`, exact.

    A step leads from a voxel's center to that of a neighbor: through one of 6 faces, across one of 12 edges as well,
    or also across one of 8 corners. All voxels of the box that it leads through must be free, so that it cuts no
    edge or corner. In voxels with sides of 1 steps have the lengths 1, and the square roots of 2 and 3.

    A path over 26 neighbors is one that a point can follow: its length is never below that of a shortest path of any
    angle between the two centers, and in the open, of
    cubes, at most 12.9 % above that.

    Args:
        free: Which voxels are free, booleans ``(nx, ny, nz)``, at ``[i, j, k]`` those of a :class:`VoxelSpace`.
        goal: A point of a free voxel, ``(3,)``; the distance is that from the voxel's center.
        moves: Neighbors of a voxel, 6, 18 or 26.
        bounds: The box that the voxels fill, or its corners ``(lo, hi)``. None: voxels have sides of 1, the first its
            corner at 0, so that whole numbers are those of voxels.

    Attributes:
        grid: The voxels.
        goal: As given, read-only.
        moves: As given.

    Raises:
        ValueError: If ``free`` is no array of booleans of three axes with a free voxel, the bounds are no box of
            three axes or have periodic ones, the goal is in no free voxel, or there is another number of neighbors.

    References:
        R. Dial, "Algorithm 360: shortest-path forest with topological ordering", CACM 12(11), 1969.
    """

    grid: VoxelGrid
    moves: int
    goal: Float[np.ndarray, "3"]

    def __init__(self, free: ArrayLike, goal: ArrayLike, moves: int = 26, bounds: Box | ArrayLike | None = None):
        if isinstance(moves, bool) or moves not in _AXES:
            raise ValueError(f"moves must be 6, 18 or 26, got {shortened(moves)}.")
        set_fields(self, grid=VoxelGrid.of(free, bounds, range(3, 4)), moves=int(moves))
        set_fields(self, goal=self._checked_goal(goal))

    def __repr__(self) -> str:
        return f"VoxelGraph({' x '.join(map(str, self.free.shape))} voxels, {self.moves} moves)"

    @property
    def free(self) -> Bool[np.ndarray, "nx ny nz"]:
        """Which voxels are free, read-only."""
        return self.grid.free

    @property
    def bounds(self) -> Box:
        """The box that they fill."""
        return self.grid.bounds

    @property
    def dim(self) -> int:
        """Number of coordinates of a point."""
        return 3

    def with_goal(self, goal: ArrayLike) -> "VoxelGraph":
        """The same volume with another goal.

        Args:
            goal: A point of a free voxel, ``(3,)``.

        Returns:
            The volume, sharing the graph.

        Raises:
            ValueError: If the goal is in no free voxel.
        """
        _ = self._legal  # computed once, for all copies
        graph = copy(self)
        graph.__dict__.pop("_to_goal", None)
        set_fields(graph, goal=self._checked_goal(goal))
        return graph

    def __call__(self, x: ArrayLike) -> Distances:
        """Length of a shortest path from the center of each point's voxel to that of the goal's.

        Args:
            x: Points, ``(n, 3)``. One in a face between two voxels is of the upper one, one in an upper bound of the
                last.

        Returns:
            Distances, ``(n,)``, in units of the bounds; ``inf`` in blocked voxels, outside the bounds, where no path
            leads to the goal, and for points with a NaN.

        Raises:
            ValueError: If ``x`` has another shape.
        """
        return self._to_goal[self._voxels_of(as_points("x", self.bounds.settled(x), 3))]

    def _voxels_of(self, x: Points) -> Int[np.ndarray, "n"]:
        """The padded voxel of each point, in row-major order; the first, which is blocked, for one outside."""
        inside = self.bounds.contains(x)
        x = np.where(inside[:, None], x, self.bounds.lo)
        below, above = self.grid.numbers(x.T)
        number = np.where(self.bounds.hi[:, None] == x.T, below, above)
        return np.where(inside, np.ravel_multi_index(tuple(number), self.grid.padded.shape), 0)

    def _checked_goal(self, goal: ArrayLike) -> Float[np.ndarray, "3"]:
        goal = as_finite_point("The goal", goal, 3)
        if not self.grid.padded.ravel()[self._voxels_of(goal[None])[0]]:
            raise ValueError(f"The goal must be in a free voxel, got {goal.tolist()}.")
        return goal

    @cached_property
    def _steps(self) -> Int[np.ndarray, "steps 3"]:
        """What steps change of a voxel's number along each axis."""
        steps = np.array(list(product((-1, 0, 1), repeat=3)))
        num_axes = np.count_nonzero(steps, axis=1)
        return steps[(num_axes > 0) & (num_axes <= _AXES[self.moves])]

    @cached_property
    def _legal(self) -> UInt32[np.ndarray, "voxels"]:
        """Which steps are legal from each padded voxel, a bit each."""
        padded, legal = self.grid.padded, np.zeros(self.grid.padded.shape, np.uint32)
        for bit, step in enumerate(self._steps):
            can = np.ones(self.free.shape, bool)
            for part in product(*[(0, change) if change else (0,) for change in step]):
                can &= padded[tuple(slice(1 + by, n - 1 + by) for by, n in zip(part, padded.shape, strict=True))]
            legal[1:-1, 1:-1, 1:-1] |= can.astype(np.uint32) << np.uint32(bit)
        return legal.ravel()

    @cached_property
    def _to_goal(self) -> Distances:
        """Distance of every padded voxel, by Dijkstra's search over buckets that a shortest step leads out of.

        So all voxels of a bucket are final once it is the next, and go on at once.
        """
        steps, bits = self._steps, np.arange(len(self._steps), dtype=np.uint32)
        jumps = np.sum(steps * self.grid.padded.strides, axis=1)
        lengths = np.linalg.norm(steps * self.grid.sides, axis=1)
        width = lengths.min() * (1 - _ROUNDING)
        distance = np.full(self.grid.padded.size, np.inf)
        root = self._voxels_of(self.goal[None])
        distance[root] = 0.0
        buckets = {0: [root]}
        while buckets:
            bucket = min(buckets)
            voxels = np.concatenate(buckets.pop(bucket))
            # What has come nearer since it was put here was in a bucket before.
            voxels = np.unique(voxels[(distance[voxels] / width).astype(np.int64) == bucket])
            begin, step = np.nonzero((self._legal[voxels][:, None] >> bits) & np.uint32(1))
            end, length = voxels[begin] + jumps[step], distance[voxels][begin] + lengths[step]
            better = length < distance[end]
            end, length = end[better], length[better]
            np.minimum.at(distance, end, length)
            later = (length / width).astype(np.int64)
            for number in np.unique(later).tolist():
                buckets.setdefault(number, []).append(end[later == number])
        return distance
