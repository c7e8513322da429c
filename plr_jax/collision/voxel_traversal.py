"""Whether a point passes between voxels on straight motions.

As in :class:`VoxelGrid`, arrays have an axis of space first.
"""

from fractions import Fraction
from itertools import product

import numpy as np
from jaxtyping import Bool, Int

from plr_jax.geometry.voxels import Coordinates, Numbers, VoxelGrid, spread

_AT_ONCE = 1 << 14  # motions, which bounds the memory
_NEARLY = 1 + 2.0**-49  # ratio of computed times up to which rounding may have changed their order
_LEAST_TIME = 1e-300  # below which times have lost digits

Booleans = Bool[np.ndarray, "n"]


def point_passes(grid: VoxelGrid, q0: Coordinates, q1: Coordinates) -> Booleans:
    """Whether a point passes on straight motions, which may touch blocked voxels; exact.

    It does not pass between voxels that touch in an edge or a corner.
    """
    passes = np.zeros(q0.shape[1], bool)
    for begin in range(0, q0.shape[1], _AT_ONCE):
        some = slice(begin, begin + _AT_ONCE)
        passes[some] = _Traversal(grid, q0[:, some], q1[:, some]).passes()
    return passes


class _Traversal:
    """Motions from voxel to voxel, all at once, one crossing of faces of each at a time.

    A motion within a face, or an edge, runs beside several voxels. On a crossing it may get from one to another
    through faces of those around the point, of which ``2**dim`` are looked at: some of them the same one where the
    point is on no face along an axis.

    References:
        J. Amanatides, A. Woo, "A fast voxel traversal algorithm for ray tracing", Eurographics 1987.
    """

    def __init__(self, grid: VoxelGrid, q0: Coordinates, q1: Coordinates):
        self.grid, self.q0, self.q1 = grid, q0, q1
        (below, above), (below_end, above_end) = grid.numbers(q0), grid.numbers(q1)
        self.step = np.sign(q1 - q0).astype(np.int64)
        self.layers = np.where(self.step == 0, above - below, 0)  # 1 along axes of faces that a motion is within
        self.at = np.where(self.step > 0, above, below)
        self.last = np.select([self.step > 0, self.step < 0], [below_end, above_end], self.at)
        self.corner = np.arange(2**grid.dim)
        self.bits = np.array(list(product((0, 1), repeat=grid.dim)))
        self.bits_of_axes = 1 << np.arange(grid.dim)[::-1]
        self.strides = np.array(grid.padded.strides)

    def passes(self) -> Booleans:
        """Whether each comes to its end."""
        lowest, highest = np.minimum(self.at, self.last), np.maximum(self.at, self.last) + self.layers
        passes = self.grid.num_blocked(lowest, highest) == 0
        rows = np.flatnonzero(~passes)
        live = self._free_around(rows, self.layers[:, rows])
        while True:
            alive, arrives = live.any(axis=1), (self.at[:, rows] == self.last[:, rows]).all(axis=0)
            passes[rows[alive & arrives]] = True
            rows, live = rows[alive & ~arrives], live[alive & ~arrives]
            if not len(rows):
                return passes
            live = self._cross(rows, live)

    def _cross(
        self, rows: Int[np.ndarray, "some"], live: Bool[np.ndarray, "some corners"]
    ) -> Bool[np.ndarray, "..."]:
        """Let motions cross the next faces on their way; which voxels beyond they get to."""
        step, layers = self.step[:, rows], self.layers[:, rows]
        crossed, face = self._crossed_next(rows)
        around = self._free_around(rows, np.where(crossed, step, layers))
        # Where all are free, the order of crossings that are nearly at once makes no difference.
        narrow = np.flatnonzero(~around.all(axis=1))
        doubtful = narrow[crossed[:, narrow].sum(axis=0) > 1]
        if len(doubtful):
            of = rows[doubtful]
            crossed[:, doubtful] = _first(crossed[:, doubtful], face[:, doubtful], self.q0[:, of], self.q1[:, of])
            around[doubtful] = self._free_around(
                of, np.where(crossed[:, doubtful], step[:, doubtful], layers[:, doubtful])
            )
        # The corner beyond the crossed faces, and on the near side along the other axes.
        beyond = (crossed.T @ self.bits_of_axes)[:, None]
        reached = around
        reached[narrow] = spread(live[narrow] & (self.corner & beyond[narrow] == 0), around[narrow])
        self.at[:, rows] += np.where(crossed, step, 0)
        return np.take_along_axis(reached, self.corner | beyond, axis=1)

    def _free_around(self, rows: Int[np.ndarray, "some"], span: Numbers) -> Bool[np.ndarray, "some corners"]:
        """Which voxels are free: where motions are, and those that spans along the axes lead to."""
        at = self.strides @ self.at[:, rows]
        return self.grid.padded.ravel()[at[:, None] + (span.T * self.strides) @ self.bits.T]

    def _crossed_next(self, rows: Int[np.ndarray, "some"]) -> tuple[Bool[np.ndarray, "dim some"], Coordinates]:
        """Which faces are crossed next, some perhaps only nearly at once; and where those are."""
        at, q0 = self.at[:, rows], self.q0[:, rows]
        further = at + (self.step[:, rows] > 0)
        face = np.stack([faces[k] for faces, k in zip(self.grid.faces, further, strict=True)])
        time = np.full(face.shape, np.inf)
        np.divide(face - q0, self.q1[:, rows] - q0, out=time, where=at != self.last[:, rows])
        return time <= _NEARLY * time.min(axis=0) + _LEAST_TIME, face


def _first(
    crossed: Bool[np.ndarray, "dim n"], face: Coordinates, q0: Coordinates, q1: Coordinates
) -> Bool[np.ndarray, "dim n"]:
    """Of faces that are crossed nearly at once those that are first, by arithmetic without rounding."""
    first = np.zeros_like(crossed)
    for i in range(crossed.shape[1]):
        axes = np.flatnonzero(crossed[:, i])
        ends = ([Fraction(x) for x in each[axes, i].tolist()] for each in (face, q0, q1))
        times = [(at - begin) / (end - begin) for at, begin, end in zip(*ends, strict=True)]
        first[axes, i] = [time == min(times) for time in times]
    return first
