"""The configuration space of a point or a ball among voxels, in one to four dimensions."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int8

from plr_jax._arrays import as_finite, as_points
from plr_jax._types import ArrayLike
from plr_jax.collision.voxels import ball_passes, blocked_within, point_passes
from plr_jax.geometry.boundary import rounding_of
from plr_jax.geometry.box import Box
from plr_jax.geometry.voxels import VoxelGrid
from plr_jax.spaces._space import CellState, MotionCost, as_boxes, as_motions

Booleans = Bool[np.ndarray, "n"]

_LEAST_RADIUS = 1e3  # tolerances


@dataclass(frozen=True, eq=False, init=False)
class VoxelSpace:
    """Positions of a point or of a ball among voxels; the cost of a motion is its length.

    Voxel ``[i, j, k]`` of the default bounds fills ``[i, i + 1] x [j, j + 1] x [k, k + 1]``: axes of the array are
    those of points, in order. (In :class:`Workspace.from_mask`, as of pictures, rows are ``y``.) Free is what keeps
    the robot off blocked voxels and within the bounds; it may touch them. A point passes between two blocked voxels
    that touch in an edge or a corner as little as it does in the plane: two free voxels are joined through faces.

    For a point all answers are exact. A ball keeps off by its radius to the ``tolerance``, and of boxes some that
    several blocked voxels forbid together, none of them alone, are called MIXED.

    Args:
        free: Which voxels are free, booleans of one to four axes.
        bounds: The box that the voxels fill, or its corners ``(lo, hi)``: of the outer voxels, not of their centers.
            Voxels need not be cubes. None: each has sides of 1, and the first its corner at 0.
        radius: Of the ball, in units of the bounds; 0: a point.

    Attributes:
        grid: The voxels.
        radius: As given.

    Raises:
        ValueError: If ``free`` is no array of booleans of one to four axes, none is free, the bounds are no box of as
            many axes or have periodic ones, voxels are so small that coordinates cannot tell them apart, or the
            radius is negative, not finite, above 0 but below a thousand tolerances, or more than half of a width.
    """

    grid: VoxelGrid
    radius: float

    def __init__(self, free: ArrayLike, bounds: Box | ArrayLike | None = None, radius: float | int = 0.0):
        object.__setattr__(self, "grid", VoxelGrid.of(free, bounds))
        object.__setattr__(self, "radius", as_finite("radius", radius))
        if 0 < self.radius < _LEAST_RADIUS * self.tolerance:
            raise ValueError(
                f"radius must be 0, for a point, or at least {_LEAST_RADIUS * self.tolerance:.2g} in {self.domain}, "
                f"got {self.radius:g}."
            )
        if self.radius > self.domain.width.min() / 2:
            raise ValueError(
                f"radius must be at most {self.domain.width.min() / 2:g}, or the ball fits nowhere into "
                f"{self.domain}, got {self.radius:g}."
            )

    def __repr__(self) -> str:
        ball = f", radius={self.radius:g}" if self.radius else ""
        return f"VoxelSpace({' x '.join(map(str, self.free.shape))} voxels, {self.domain}{ball})"

    @property
    def free(self) -> Bool[np.ndarray, "..."]:
        """Which voxels are free, read-only."""
        return self.grid.free

    @property
    def domain(self) -> Box:
        """The bounds."""
        return self.grid.bounds

    @property
    def motion_cost(self) -> MotionCost:
        """Length."""
        return MotionCost(((tuple(range(self.grid.dim)), 1.0),))

    @property
    def tolerance(self) -> float:
        """By which a ball may be nearer than its radius, in units of the bounds."""
        return rounding_of(self.domain)

    def is_free(self, q: ArrayLike) -> Booleans:
        """Whether configurations are free.

        Args:
            q: Positions, ``(n, dim)``, of the ball's center.

        Returns:
            True where the point is in no blocked voxel's interior, nor between blocked ones, nor outside the bounds,
            or the ball keeps off all of that; False for configurations that are not finite.

        Raises:
            ValueError: If ``q`` has another shape.
        """
        q = as_points("q", q, self.grid.dim)
        free = np.isfinite(q).all(axis=1)
        x = q[free].T
        if self.radius == 0:
            below, above = self.grid.numbers(x)
            free[free] = self.grid.num_blocked(below, above) < np.prod(above - below + 1, axis=0)
        else:
            free[free] = ~blocked_within(self.grid, x, x, self.radius - self.tolerance)
        return free

    def classify(self, lo: ArrayLike, hi: ArrayLike) -> Int8[np.ndarray, "n"]:
        """What is proven of boxes of positions.

        Args:
            lo: Lower corners, ``(n, dim)``, finite.
            hi: Upper corners, ``(n, dim)``, finite and nowhere below.

        Returns:
            The :class:`CellState` of each, ``(n,)``. For a point, one that touches an edge or a corner in which
            blocked voxels touch is not FREE, as no path passes there from one side to the other. A box without
            extent along some axis that lies in a face of a blocked voxel is not FREE either.

        Raises:
            ValueError: If the shapes are others or differ, or corners are not those of boxes.
        """
        as_boxes(lo, hi, self.grid.dim)
        lo, hi = (np.asarray(end, np.float64).T for end in (lo, hi))
        (_, above), (below, _) = self.grid.numbers(lo), self.grid.numbers(hi)
        first, last = np.minimum(above, below), np.maximum(above, below)  # which a box without extent may exchange
        num, num_blocked = np.prod(last - first + 1, axis=0), self.grid.num_blocked(first, last)
        state = np.full(len(num), CellState.MIXED, np.int8)
        state[num_blocked == num] = CellState.BLOCKED
        free = np.flatnonzero(num_blocked == 0)
        if self.radius == 0:
            state[free[~self.grid.touches_contact(lo[:, free], hi[:, free])]] = CellState.FREE
            return state
        # With margins of half the tolerance, so that rounding makes no difference.
        near, forbidden = (self.radius - share * self.tolerance for share in (0.5, 1.5))
        state[free[~blocked_within(self.grid, lo[:, free], hi[:, free], near)]] = CellState.FREE
        mixed = np.flatnonzero(state == CellState.MIXED)
        state[mixed[blocked_within(self.grid, hi[:, mixed], lo[:, mixed], forbidden)]] = CellState.BLOCKED
        return state

    def are_free(self, q0: ArrayLike, q1: ArrayLike) -> Booleans:
        """Whether straight motions are proven free all along.

        Args:
            q0: Where they begin, ``(n, dim)``.
            q1: Where they end.

        Returns:
            True where the whole motion is free and, for a point, passes from no free voxel to another but through
            faces; motions within a face or an edge do where they can along the voxels beside it. False where an end
            is not finite.

        Raises:
            ValueError: If the shapes are others or differ.
        """
        q0, q1 = as_motions(q0, q1, self.grid.dim)
        free = np.isfinite(q0 + q1).all(axis=1)
        ends = q0[free].T, q1[free].T
        if self.radius == 0:
            free[free] = point_passes(self.grid, *ends)
        else:
            free[free] = ball_passes(self.grid, *ends, self.radius - self.tolerance / 2)
        return free

    def sees_boxes(self, q: ArrayLike, lo: ArrayLike, hi: ArrayLike) -> Booleans:
        """Whether positions are seen from everywhere in boxes that is free: proven for points, never for balls.

        Args:
            q: Positions, ``(n, dim)``, in or beside their boxes.
            lo: Lower corners of boxes, ``(n, dim)``, finite.
            hi: Upper corners, finite and nowhere below.

        Returns:
            True where the free voxels that the box touches form a box, and the position is in what the two have in
            common. False in an edge or a corner in which blocked voxels touch.

        Raises:
            ValueError: If the shapes are others or differ, or corners are not those of boxes.
        """
        (q, _), _ = as_motions(q, lo, self.grid.dim), as_boxes(lo, hi, self.grid.dim)
        if self.radius > 0:
            return np.zeros(len(q), bool)
        x, (lo, hi) = q.T, (np.asarray(end, np.float64).T for end in (lo, hi))
        first, last = self.grid.free_range(self.grid.numbers(lo)[0], self.grid.numbers(hi)[1])
        sees = np.all(first <= last, axis=0) & (self.grid.num_blocked(first, last) == 0)
        for axis, faces in enumerate(self.grid.faces):
            sees &= np.maximum(lo[axis], faces[first[axis]]) <= x[axis]
            sees &= x[axis] <= np.minimum(hi[axis], faces[last[axis] + 1])
        rows = np.flatnonzero(sees & np.isfinite(q).all(axis=1))
        sees[:] = False
        sees[rows] = ~self.grid.touches_contact(x[:, rows], x[:, rows])
        return sees
