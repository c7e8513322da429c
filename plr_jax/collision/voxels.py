"""Tests whether a point or ball keeps clear of blocked voxels: at points, in boxes, and on straight motions."""

from collections.abc import Callable, Iterator
from fractions import Fraction
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import parts, ragged_indices
from plr_jax.geometry.voxels import Coordinates, Numbers, VoxelGrid, spread

_MOTIONS_AT_ONCE, _ROWS_AT_ONCE = 1 << 14, 1 << 18  # batch sizes, which bound the memory
_SHORT = 0.5  # pieces of motions up to this share of a voxel are tested against single voxels
_NEARLY = 1 + 2.0**-49  # ratio of computed times within which rounding may have changed their order
_LEAST_TIME = 1e-300  # absolute slack for times that may have lost digits by underflow
Booleans = Bool[np.ndarray, "n"]
Which = Int[np.ndarray, "m"]


def blocked_within(grid: VoxelGrid, lo: Coordinates, hi: Coordinates, radius: float) -> Booleans:
    """Return whether a blocked voxel is nearer than ``radius`` to a box.

    If ``lo`` and ``hi`` are swapped, a voxel must be nearer than ``radius`` to every point of the box.
    """
    (first, last), (far_first, far_last) = _touching(grid, lo, hi), _touching(grid, lo - radius, hi + radius)
    within = grid.num_blocked(far_first, far_last) > 0
    doubtful = within.copy()
    for axis in range(grid.dim):  # exact for blocked voxels straight ahead along the axis
        ahead = (np.arange(grid.dim) == axis)[:, None]
        doubtful &= grid.num_blocked(np.where(ahead, far_first, first), np.where(ahead, far_last, last)) == 0
    doubtful = np.flatnonzero(doubtful)
    within[doubtful] = False
    for box, begin, end in _rows_within(grid, lo[:, doubtful], hi[:, doubtful], radius):
        within[doubtful[box[grid.num_blocked(begin, end) > 0]]] = True
    return within


def _touching(grid: VoxelGrid, lo: Coordinates, hi: Coordinates) -> tuple[Numbers, Numbers]:
    return grid.numbers(lo)[0], grid.numbers(hi)[1]


def _rows_within(
    grid: VoxelGrid, lo: Coordinates, hi: Coordinates, radius: float
) -> Iterator[tuple[Which, Numbers, Numbers]]:
    """Yield rows of voxels along the last axis within ``radius`` of boxes: index of the box, first and last voxel."""
    first, last = _touching(grid, lo - radius, hi + radius)
    num = np.maximum(last - first + 1, 0)[:-1]
    for some in parts(num.prod(axis=0), _ROWS_AT_ONCE):
        box, place = ragged_indices(num[:, some].prod(axis=0))
        box += some.start
        row = np.empty((grid.dim, len(box)), np.int64)
        square = np.full(len(box), radius**2)
        for axis in range(grid.dim - 1):
            place, beyond = np.divmod(place, num[axis, box])
            row[axis], faces = first[axis, box] + beyond, grid.faces[axis]
            gaps = np.maximum(faces[row[axis]] - hi[axis, box], lo[axis, box] - faces[row[axis] + 1])
            square -= np.maximum(gaps, 0.0) ** 2
        near = square > 0
        box, row, reach = box[near], row[:, near], np.sqrt(square[near])
        begin, end = row, row.copy()
        begin[-1], _ = grid.numbers_along(grid.dim - 1, lo[-1, box] - reach)
        _, end[-1] = grid.numbers_along(grid.dim - 1, hi[-1, box] + reach)
        yield box, begin, end


def _in_batches(test: Callable[[Coordinates, Coordinates], Booleans], q0: Coordinates, q1: Coordinates) -> Booleans:
    batches = (slice(begin, begin + _MOTIONS_AT_ONCE) for begin in range(0, q0.shape[1], _MOTIONS_AT_ONCE))
    return np.concatenate([np.zeros(0, bool), *(test(q0[:, some], q1[:, some]) for some in batches)])


def ball_passes(grid: VoxelGrid, q0: Coordinates, q1: Coordinates, radius: float) -> Booleans:
    """Return whether a ball hits no blocked voxel on straight motions, up to rounding; touching is allowed."""
    return _in_batches(lambda a, b: _ball_keeps_clear(grid, a, b, radius), q0, q1)


def _ball_keeps_clear(grid: VoxelGrid, q0: Coordinates, q1: Coordinates, radius: float) -> Booleans:
    # Bisect each motion until its parts are far from blocked voxels, the ball hits one in the middle of a part, or a
    # part is so short that the few voxels near it are tested exactly.
    keeps_off = ~(blocked_within(grid, q0, q0, radius) | blocked_within(grid, q1, q1, radius))
    motion, width = np.flatnonzero(keeps_off), 1.0
    begin = np.zeros(len(motion))
    while len(motion):
        change = q1[:, motion] - q0[:, motion]
        a, b = q0[:, motion] + begin * change, q0[:, motion] + (begin + width) * change
        near = blocked_within(grid, np.minimum(a, b), np.maximum(a, b), radius)
        motion, begin, a, b = motion[near], begin[near], a[:, near], b[:, near]
        middle = (a + b) / 2
        keeps_off[motion[blocked_within(grid, middle, middle, radius)]] = False
        short = (np.abs(b - a) <= _SHORT * grid.sides[:, None]).all(axis=0) & keeps_off[motion]
        owner, lo, hi = motion[short], np.minimum(a, b)[:, short], np.maximum(a, b)[:, short]
        for piece, voxel in _blocked_voxels_within(grid, lo, hi, radius):
            meets = squared_distances(grid, q0[:, owner[piece]], q1[:, owner[piece]], voxel) < radius**2
            keeps_off[owner[piece[meets]]] = False
        halved = keeps_off[motion] & ~short
        motion, begin, width = motion[halved], begin[halved], width / 2
        motion, begin = np.append(motion, motion), np.append(begin, begin + width)
    return keeps_off


def _blocked_voxels_within(
    grid: VoxelGrid, lo: Coordinates, hi: Coordinates, radius: float
) -> Iterator[tuple[Which, Numbers]]:
    """Yield pairs of a box and a blocked voxel within ``radius`` of it: indices of boxes, and numbers of voxels."""
    for box, begin, end in _rows_within(grid, lo, hi, radius):
        some = np.flatnonzero(grid.num_blocked(begin, end))
        row, place = ragged_indices(end[-1, some] - begin[-1, some] + 1)
        voxel = begin[:, some[row]]
        voxel[-1] += place
        blocked = ~grid.padded[tuple(voxel)]
        yield box[some[row[blocked]]], voxel[:, blocked]


def squared_distances(grid: VoxelGrid, q0: Coordinates, q1: Coordinates, voxel: Numbers) -> Float[np.ndarray, " n"]:
    """Return the least squared distance between the i-th motion and the i-th voxel."""
    lo = np.stack([faces[k] for faces, k in zip(grid.faces, voxel, strict=True)])
    hi = np.stack([faces[k + 1] for faces, k in zip(grid.faces, voxel, strict=True)])
    change = q1 - q0

    def excess(time: Float[np.ndarray, " n"]) -> Coordinates:
        x = q0 + time * change
        return np.maximum(x - hi, 0.0) - np.maximum(lo - x, 0.0)

    moves = change != 0
    level = [np.divide(face - q0, change, out=np.zeros_like(q0), where=moves) for face in (lo, hi)]
    times = np.sort(np.clip([np.zeros(q0.shape[1]), *level[0], *level[1], np.ones(q0.shape[1])], 0, 1), axis=0)
    slopes = np.stack([np.sum(change * excess(time), axis=0) for time in times])
    # Half the derivative of the squared distance, sum(change * excess(t)) over axes, never decreases in t, and is
    # linear between the times at which an axis crosses a face. Find its zero: it lies between the last time at which
    # this slope is negative and the next time, or at an end of the motion.
    after = np.count_nonzero(slopes < 0, axis=0)
    ends = np.maximum(after - 1, 0), np.minimum(after, len(times) - 1)
    (t0, t1), (s0, s1) = ([np.take_along_axis(of, at[None], axis=0)[0] for at in ends] for of in (times, slopes))
    fraction = np.divide(-s0, s1 - s0, out=np.zeros_like(s0), where=s1 > s0)
    return np.sum(excess(t0 + np.clip(fraction, 0, 1) * (t1 - t0)) ** 2, axis=0)


def point_passes(grid: VoxelGrid, q0: Coordinates, q1: Coordinates) -> Booleans:
    """Return whether a point passes on straight motions without entering blocked voxels; touching is allowed."""
    return _in_batches(lambda a, b: _Traversal(grid, a, b).passes(), q0, q1)


class _Traversal:
    """An exact traversal of voxels along many motions at once, from one crossed face to the next.

    A motion within a face or an edge touches several voxels at once. So the state of a motion is the set of voxels,
    among the ``2**dim`` around its current point, that it can be in. It cannot pass between blocked voxels that share
    only an edge or a corner. See Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing", 1987.
    """

    def __init__(self, grid: VoxelGrid, q0: Coordinates, q1: Coordinates):
        self.grid, self.q0, self.q1 = grid, q0, q1
        (below, above), (below_end, above_end) = grid.numbers(q0), grid.numbers(q1)
        self.step = np.sign(q1 - q0).astype(np.int64)
        self.layers = np.where(self.step == 0, above - below, 0)  # 1 along axes on which a motion is within a face
        self.at = np.where(self.step > 0, above, below)
        self.last = np.select([self.step > 0, self.step < 0], [below_end, above_end], self.at)
        self.corner = np.arange(2**grid.dim)
        self.bits = np.array(list(product((0, 1), repeat=grid.dim)))
        self.bits_of_axes = 1 << np.arange(grid.dim)[::-1]
        self.strides = np.array(grid.padded.strides)

    def passes(self) -> Booleans:
        """Return whether each motion passes: whether it reaches its end with a voxel left in which it can be."""
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
        self, rows: Int[np.ndarray, " some"], live: Bool[np.ndarray, "some corners"]
    ) -> Bool[np.ndarray, "..."]:
        # Return which of the voxels around the next point each motion can be in.
        step, layers = self.step[:, rows], self.layers[:, rows]
        crossed, face = self._crossed_next(rows)
        around = self._free_around(rows, np.where(crossed, step, layers))
        # The order of nearly simultaneous crossings matters only if some voxel around is blocked.
        narrow = np.flatnonzero(~around.all(axis=1))
        doubtful = narrow[crossed[:, narrow].sum(axis=0) > 1]
        if len(doubtful):
            motions = rows[doubtful]
            first = _first_crossed(crossed[:, doubtful], face[:, doubtful], self.q0[:, motions], self.q1[:, motions])
            crossed[:, doubtful] = first
            around[doubtful] = self._free_around(motions, np.where(first, step[:, doubtful], layers[:, doubtful]))
        # Voxels beyond the crossed faces are reached from free voxels on the near side.
        beyond = (crossed.T @ self.bits_of_axes)[:, None]
        reached = around
        reached[narrow] = spread(live[narrow] & (self.corner & beyond[narrow] == 0), around[narrow])
        self.at[:, rows] += np.where(crossed, step, 0)
        return np.take_along_axis(reached, self.corner | beyond, axis=1)

    def _free_around(self, motions: Int[np.ndarray, " some"], span: Numbers) -> Bool[np.ndarray, "some corners"]:
        at = self.strides @ self.at[:, motions]
        return self.grid.padded.ravel()[at[:, None] + (span.T * self.strides) @ self.bits.T]

    def _crossed_next(self, rows: Int[np.ndarray, " some"]) -> tuple[Bool[np.ndarray, "dim some"], Coordinates]:
        """Return across which axes each motion leaves its current voxels next, and the next face along each axis."""
        at, q0 = self.at[:, rows], self.q0[:, rows]
        further = at + (self.step[:, rows] > 0)
        face = np.stack([faces[k] for faces, k in zip(self.grid.faces, further, strict=True)])
        time = np.full(face.shape, np.inf)
        np.divide(face - q0, self.q1[:, rows] - q0, out=time, where=at != self.last[:, rows])
        return time <= _NEARLY * time.min(axis=0) + _LEAST_TIME, face


def _first_crossed(
    crossed: Bool[np.ndarray, "dim n"], face: Coordinates, q0: Coordinates, q1: Coordinates
) -> Bool[np.ndarray, "dim n"]:
    # Rational arithmetic: rounding may have changed the order of times.
    first = np.zeros_like(crossed)
    for i in range(crossed.shape[1]):
        axes = np.flatnonzero(crossed[:, i])
        ends = ([Fraction(x) for x in table[axes, i].tolist()] for table in (face, q0, q1))
        times = [(at - begin) / (end - begin) for at, begin, end in zip(*ends, strict=True)]
        first[axes, i] = [time == min(times) for time in times]
    return first
