"""Tests whether a point or ball keeps clear of blocked voxels: at points, in boxes, and on straight motions."""

from collections.abc import Iterator
from fractions import Fraction
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import parts, ragged_indices
from plr_jax.geometry.voxels import Coordinates, Numbers, VoxelGrid, spread

_ROWS_AT_ONCE = 1 << 18  # rows of voxels; bounds the memory
_SHORT = 0.5  # pieces of motions up to this share of a voxel are tested against single voxels
_NEARLY = 1 + 2.0**-49  # ratio of computed times within which rounding may have changed their order
_LEAST_TIME = 1e-300  # absolute slack for times that may have lost digits by underflow
Booleans = Bool[np.ndarray, "n"]


def blocked_within(grid: VoxelGrid, lo: Coordinates, hi: Coordinates, radius: float) -> Booleans:
    """Return, for each box from corner ``lo`` to corner ``hi``, whether a blocked voxel is nearer than ``radius``.

    If the arguments ``lo`` and ``hi`` are swapped, return whether a blocked voxel is nearer than ``radius`` to every
    point of the box.
    """
    # 1. The box enlarged by the radius contains all points within the radius, and points beyond it near its corners.
    #
    #      . . . . . . . .     Blocked voxels in the enlarged box (dotted) are near if they are straight ahead of the
    #      . ? |     | ? .     box along an axis. In the corners (?), their distances decide.
    #      . --+-----+-- .
    #      .   | box |   .
    #      . --+-----+-- .
    #      . ? |     | ? .
    #      . . . . . . . .
    (first, last), (far_first, far_last) = _touching(grid, lo, hi), _touching(grid, lo - radius, hi + radius)
    within = grid.blocked.within(far_first, far_last) > 0
    is_doubtful = within.copy()
    for axis in range(grid.dim):
        ahead = (np.arange(grid.dim) == axis)[:, None]
        is_doubtful &= grid.blocked.within(np.where(ahead, far_first, first), np.where(ahead, far_last, last)) == 0
    # 2. Count blocked voxels in the part of each row of voxels that is within the radius.
    doubtful = np.flatnonzero(is_doubtful)
    within[doubtful] = False
    for box, begin, end in _rows_within(grid, lo[:, doubtful], hi[:, doubtful], radius):
        within[doubtful[box[grid.blocked.within(begin, end) > 0]]] = True
    return within


def _touching(grid: VoxelGrid, lo: Coordinates, hi: Coordinates) -> tuple[Numbers, Numbers]:
    return grid.numbers(lo)[0], grid.numbers(hi)[1]


def _rows_within(
    grid: VoxelGrid, lo: Coordinates, hi: Coordinates, radius: float
) -> Iterator[tuple[Int[np.ndarray, " m"], Numbers, Numbers]]:
    """Yield, in batches, the rows of voxels along the last axis that are within ``radius`` of each box.

    A box leads from corner ``lo`` to corner ``hi``. A batch is, for each row, the index of the box, and the numbers
    of the first and of the last voxel (a number per axis).
    """
    # A voxel is within the radius r of a box if its gaps from the box along the axes have a sum of squares below r^2.
    # The gaps along all axes but the last depend on the row alone. They leave a reach along the last axis.
    first, last = _touching(grid, lo - radius, hi + radius)
    num = np.maximum(last - first + 1, 0)[:-1]  # layers along each axis but the last; their product is the rows
    for batch in parts(num.prod(axis=0), _ROWS_AT_ONCE):
        box, rank = ragged_indices(num[:, batch].prod(axis=0))
        box += batch.start
        row = np.empty((grid.dim, len(box)), np.int64)
        square = np.full(len(box), radius**2)
        for axis in range(grid.dim - 1):
            rank, layer = np.divmod(rank, num[axis, box])  # a row's rank has a digit for each axis
            row[axis] = first[axis, box] + layer
            faces = grid.faces[axis]
            gaps = np.maximum(faces[row[axis]] - hi[axis, box], lo[axis, box] - faces[row[axis] + 1])
            square -= np.maximum(gaps, 0.0) ** 2
        near = square > 0
        box, row, reach = box[near], row[:, near], np.sqrt(square[near])
        begin, end = row, row.copy()
        begin[-1], _ = grid.numbers_along(grid.dim - 1, lo[-1, box] - reach)
        _, end[-1] = grid.numbers_along(grid.dim - 1, hi[-1, box] + reach)
        yield box, begin, end


def ball_passes(grid: VoxelGrid, q0: Coordinates, q1: Coordinates, radius: float) -> Booleans:
    """Return whether each straight motion of a ball, with its center from ``q0`` to ``q1``, hits no blocked voxel.

    The result is exact up to rounding errors. Touching is allowed.
    """
    # Bisect each motion until its parts are far from blocked voxels, the ball hits one in the middle of a part, or a
    # part is so short that the few voxels near it are tested exactly. A part is a motion, its begin and its width (as
    # shares of the motion; all parts are equally wide).
    is_clear = ~(blocked_within(grid, q0, q0, radius) | blocked_within(grid, q1, q1, radius))
    motion = np.flatnonzero(is_clear)
    begin, width = np.zeros(len(motion)), 1.0
    while len(motion):
        # 1. Drop the parts whose boxes are far from blocked voxels.
        change = q1[:, motion] - q0[:, motion]
        a, b = q0[:, motion] + begin * change, q0[:, motion] + (begin + width) * change
        near = blocked_within(grid, np.minimum(a, b), np.maximum(a, b), radius)
        motion, begin, a, b = motion[near], begin[near], a[:, near], b[:, near]
        # 2. Test the ball in the middle of each part.
        middle = (a + b) / 2
        is_clear[motion[blocked_within(grid, middle, middle, radius)]] = False
        # 3. Decide short parts: test their whole motions against the blocked voxels within the radius of the part.
        #    Pairs of a part (`piece`) and a voxel (a number per axis) come in batches, by rows of voxels.
        short = (np.abs(b - a) <= _SHORT * grid.sides[:, None]).all(axis=0) & is_clear[motion]
        lo, hi = np.minimum(a, b)[:, short], np.maximum(a, b)[:, short]
        for piece, first, last in _rows_within(grid, lo, hi, radius):
            row = np.flatnonzero(grid.blocked.within(first, last))
            index, place = ragged_indices(last[-1, row] - first[-1, row] + 1)
            row = row[index]  # of each voxel
            voxel = first[:, row]
            voxel[-1] += place
            blocked = ~grid.padded[tuple(voxel)]
            tested, voxel = motion[short][piece[row[blocked]]], voxel[:, blocked]
            is_clear[tested[squared_distances(grid, q0[:, tested], q1[:, tested], voxel) < radius**2]] = False
        # 4. Halve the remaining parts, unless their motion hits a voxel.
        halved = is_clear[motion] & ~short
        width /= 2
        motion, begin = np.tile(motion[halved], 2), np.append(begin[halved], begin[halved] + width)
    return is_clear


def squared_distances(grid: VoxelGrid, q0: Coordinates, q1: Coordinates, voxel: Numbers) -> Float[np.ndarray, " n"]:
    """Return the squared distance of each straight motion, from a column of ``q0`` to ``q1``, to a ``voxel``."""
    # At the time t in [0, 1] of a motion, let excess_a(t) be how far the point is beyond the voxel along axis a, with
    # a sign; 0 if it is between the faces lo_a and hi_a. Half the derivative of the squared distance, the slope
    # sum_a change_a * excess_a(t), never decreases in t, and is linear between the times at which an axis crosses a
    # face. So the squared distance is least at the zero of the slope, or at an end of the motion.
    lo, hi = (np.stack([faces[k + end] for faces, k in zip(grid.faces, voxel, strict=True)]) for end in (0, 1))
    change = q1 - q0

    def excess(time: Float[np.ndarray, " n"]) -> Coordinates:
        x = q0 + time * change
        return x - np.clip(x, lo, hi)

    # 1. Compute the slope at both ends of the motion, and at the times at which an axis crosses a face.
    crossing = [np.divide(face - q0, change, out=np.zeros_like(q0), where=change != 0) for face in (lo, hi)]
    times = np.sort(np.clip([np.zeros(q0.shape[1]), *crossing[0], *crossing[1], np.ones(q0.shape[1])], 0, 1), axis=0)
    slopes = np.stack([np.sum(change * excess(time), axis=0) for time in times])
    # 2. Find the zero: it lies between the last time at which the slope is negative and the next time.
    num_negative = np.count_nonzero(slopes < 0, axis=0)[None]
    last, after = np.maximum(num_negative - 1, 0), np.minimum(num_negative, len(times) - 1)
    (t0, s0), (t1, s1) = ([np.take_along_axis(x, k, axis=0)[0] for x in (times, slopes)] for k in (last, after))
    fraction = np.divide(-s0, s1 - s0, out=np.zeros_like(s0), where=s1 > s0)
    return np.sum(excess(t0 + np.clip(fraction, 0, 1) * (t1 - t0)) ** 2, axis=0)


class Traversal:
    """An exact traversal of voxels along many motions at once, from one crossed face to the next.

    A motion within a face or an edge touches several voxels at once. So the state of a motion is a set: the free
    voxels that it can be in, among the ``2**dim`` voxels around its current point. A motion cannot pass between
    blocked voxels that share only an edge or a corner. See Amanatides and Woo, "A fast voxel traversal algorithm for
    ray tracing", 1987.
    """

    def __init__(self, grid: VoxelGrid, q0: Coordinates, q1: Coordinates):
        self.grid, self.q0, self.q1 = grid, q0, q1
        (below, above), (below_end, above_end) = grid.numbers(q0), grid.numbers(q1)
        self.step = np.sign(q1 - q0).astype(np.int64)
        self.layers = np.where(self.step == 0, above - below, 0)  # 1 along axes on which a motion is within a face
        self.at = np.where(self.step > 0, above, below)  # the voxel that the motion is in, or enters from a face
        self.last = np.select([self.step > 0, self.step < 0], [below_end, above_end], self.at)  # in which it ends
        # The voxels around a point are numbered by one bit per axis, the first axis highest: 0 is the voxel `at`, 1
        # the one next to it along the axis (the same voxel along axes on which the point is within no face).
        #
        #        +----+----+
        #        | 01 | 11 |     second axis
        #        +----o----+      ^
        #        | 00 | 10 |      |
        #        +----+----+      +--> first axis, a step to the right
        self.corner = np.arange(2**grid.dim)
        self.bits = np.array(list(product((0, 1), repeat=grid.dim)))
        self.bits_of_axes = 1 << np.arange(grid.dim)[::-1]
        self.strides = np.array(grid.padded.strides)  # in bytes, which are the voxels' indices in `padded.ravel()`

    def passes(self) -> Booleans:
        """Return whether each straight motion of a point, from ``q0`` to ``q1``, enters no blocked voxel.

        Touching is allowed. A motion passes if it can be in at least one free voxel at its end.
        """
        # 1. A motion passes if no voxel is blocked in its bounding box.
        lowest, highest = np.minimum(self.at, self.last), np.maximum(self.at, self.last) + self.layers
        passes = self.grid.blocked.within(lowest, highest) == 0
        # 2. Follow the other motions from face to face. `live`: the voxels around that each can be in.
        rows = np.flatnonzero(~passes)
        live = self._free_around(rows, self.layers[:, rows])
        while True:
            is_live = live.any(axis=1)
            arrives = (self.at[:, rows] == self.last[:, rows]).all(axis=0)
            passes[rows[is_live & arrives]] = True
            rows, live = rows[is_live & ~arrives], live[is_live & ~arrives]
            if not len(rows):
                return passes
            live = self._cross(rows, live)

    def _cross(self, rows: Int[np.ndarray, " n"], live: Bool[np.ndarray, "n corners"]) -> Bool[np.ndarray, "..."]:
        # Move `at` across the next faces, and return in which of the voxels around that point each motion can be.
        # 1. Find the next face along every axis, the axes along which each motion crosses its next face or faces, and
        #    the free voxels around the crossing. Along several axes, crossings may be nearly simultaneous.
        at, step, layers, q0, q1 = (table[:, rows] for table in (self.at, self.step, self.layers, self.q0, self.q1))
        face = np.stack([faces[k] for faces, k in zip(self.grid.faces, at + (step > 0), strict=True)])
        time = np.full(face.shape, np.inf)
        np.divide(face - q0, q1 - q0, out=time, where=at != self.last[:, rows])
        crossed = time <= _NEARLY * time.min(axis=0) + _LEAST_TIME
        around = self._free_around(rows, np.where(crossed, step, layers))
        # 2. Decide which of nearly simultaneous crossings come first, by rational arithmetic, as rounding may have
        #    changed the order of times. It matters only if some voxel around is blocked.
        narrow = np.flatnonzero(~around.all(axis=1))
        doubtful = narrow[crossed[:, narrow].sum(axis=0) > 1]
        for i in doubtful.tolist():
            axes = np.flatnonzero(crossed[:, i])
            ends = ([Fraction(x) for x in table[axes, i].tolist()] for table in (face, q0, q1))
            times = [(place - begin) / (end - begin) for place, begin, end in zip(*ends, strict=True)]
            crossed[axes, i] = [time == min(times) for time in times]
        if len(doubtful):
            around[doubtful] = self._free_around(rows[doubtful], np.where(crossed, step, layers)[:, doubtful])
        # 3. Voxels beyond the crossed faces (with all bits in `beyond`) are reached from free voxels on the near
        #    side, through faces of free voxels around the crossing. `around` becomes the voxels that are reached.
        beyond = (crossed.T @ self.bits_of_axes)[:, None]
        around[narrow] = spread(live[narrow] & (self.corner & beyond[narrow] == 0), around[narrow])
        self.at[:, rows] += np.where(crossed, step, 0)
        return np.take_along_axis(around, self.corner | beyond, axis=1)

    def _free_around(self, motions: Int[np.ndarray, " some"], span: Numbers) -> Bool[np.ndarray, "some corners"]:
        # `span`: the step, along each axis, from the voxels with bit 0 to the voxels with bit 1.
        index = self.strides @ self.at[:, motions]
        return self.grid.padded.ravel()[index[:, None] + (span.T * self.strides) @ self.bits.T]
