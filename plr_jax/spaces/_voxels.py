"""The configuration space of a point or ball among voxels, in one to four dimensions."""

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Bool, Int8
from scipy import ndimage

from plr_jax._arrays import as_finite, as_points, batches, set_fields
from plr_jax._types import ArrayLike
from plr_jax.collision.voxels import Booleans, Traversal, ball_passes, blocked_within
from plr_jax.geometry.boundary import rounding_of
from plr_jax.geometry.box import Box
from plr_jax.geometry.voxels import VoxelGrid
from plr_jax.spaces._space import CellState, MotionCost, as_boxes, as_motions

_MOTIONS = 1 << 14  # motions handled together, which bounds the memory
_LEAST_RADIUS = 1e3  # smallest radius of a ball, in tolerances


@dataclass(frozen=True, eq=False, init=False)
class VoxelSpace:
    """The configuration space of a point or ball among voxels; the cost of a motion is its length.

    With default bounds, voxel ``[i, j, k]`` fills ``[i, i + 1] x [j, j + 1] x [k, k + 1]``: array axes are coordinate
    axes, in order. (In :meth:`Workspace.from_mask`, as in pictures, rows are ``y``.)

    A position is free if the robot overlaps neither blocked voxels nor the outside of the bounds; it may touch both.
    A point cannot pass between two blocked voxels that share only an edge or corner: free voxels are connected
    through faces. For a point, all answers are exact. A ball may come nearer to blocked voxels than its radius, by
    the ``tolerance``. For a ball, a box of positions is proven blocked only if one blocked voxel is too near to all
    positions in the box. All other blocked boxes are MIXED. ``ValueError`` is raised if an argument is invalid, no
    voxel is free, or voxels are too small for the precision of coordinates.

    Args:
        free: Boolean array of one to four axes, True where a voxel is free.
        bounds: The box that the voxels fill, or its corners ``(lo, hi)``: outer faces, not voxel centers; no axis may
            be periodic. Voxels need not be cubes. None: unit voxels, the first with its corner at 0.
        radius: Radius of the ball, in units of the bounds: 0 for a point, else from a thousand tolerances to half the
            narrowest width of the bounds.
    """

    grid: VoxelGrid
    radius: float

    def __init__(self, free: ArrayLike, bounds: Box | ArrayLike | None = None, radius: float | int = 0.0):
        set_fields(self, grid=VoxelGrid.of(free, bounds), radius=as_finite("radius", radius))
        least, most = _LEAST_RADIUS * self.tolerance, self.domain.width.min() / 2
        if 0 < self.radius < least or self.radius > most:
            expected = f"at most {most:g}, for the ball to fit into {self.domain}"
            if self.radius < least:
                expected = f"0 for a point, or at least {least:.2g} in {self.domain}"
            raise ValueError(f"radius must be {expected}, got {self.radius:g}.")

    def __repr__(self) -> str:
        ball = f", radius={self.radius:g}" if self.radius else ""
        return f"VoxelSpace({' x '.join(map(str, self.free.shape))} voxels, {self.domain}{ball})"

    @property
    def free(self) -> Bool[np.ndarray, "..."]:
        """Whether each voxel is free: a read-only boolean array."""
        return self.grid.free

    @property
    def domain(self) -> Box:
        """The box that the voxels fill."""
        return self.grid.bounds

    @property
    def motion_cost(self) -> MotionCost:
        """Euclidean length of a motion."""
        return MotionCost(((tuple(range(self.grid.dim)), 1.0),))

    @property
    def tolerance(self) -> float:
        """Distance by which a ball may come nearer to blocked voxels than its radius, in units of the bounds."""
        return rounding_of(self.domain)

    def is_free(self, q: ArrayLike) -> Booleans:
        """Return whether positions are free; a point is free if a closed free voxel contains it."""
        q = as_points("q", q, self.grid.dim)
        free = np.isfinite(q).all(axis=1)
        x = q[free].T
        if self.radius == 0:  # not all voxels that contain the point are blocked
            below, above = self.grid.numbers(x)
            free[free] = self.grid.blocked.within(below, above) < np.prod(above - below + 1, axis=0)
        else:
            free[free] = ~blocked_within(self.grid, x, x, self.radius - self.tolerance)
        return free

    def classify(self, lo: ArrayLike, hi: ArrayLike) -> Int8[np.ndarray, " n"]:
        """Tell whether boxes of positions are FREE, BLOCKED or MIXED; see :class:`CellState`.

        For a point, a box that touches an edge or corner where blocked voxels touch is not FREE, since no path passes
        between these voxels. A box without extent along an axis, in a face of a blocked voxel, is not FREE either.
        """
        as_boxes(lo, hi, self.grid.dim)
        # 1. Find the range of voxels whose interior a box meets: above its lower corner, below its upper corner.
        lo, hi = (np.asarray(end, np.float64).T for end in (lo, hi))
        above, below = self.grid.numbers(lo)[1], self.grid.numbers(hi)[0]
        first, last = np.minimum(above, below), np.maximum(above, below)  # swapped for a box without extent on a face
        num, num_blocked = np.prod(last - first + 1, axis=0), self.grid.blocked.within(first, last)
        state = np.full(len(num), CellState.MIXED, np.int8)
        state[num_blocked == num] = CellState.BLOCKED
        free = np.flatnonzero(num_blocked == 0)
        # 2. For a point, these counts decide, except at contacts: edges or corners where blocked voxels touch.
        if self.radius == 0:
            state[free[~self.grid.touches_contact(lo[:, free], hi[:, free])]] = CellState.FREE
            return state
        # 3. For a ball, a box is free if no blocked voxel is near to any of its points, and blocked if a voxel is
        #    near to all of them (corners swapped). Margins of half the tolerance cover rounding errors.
        near, forbidden = (self.radius - margin * self.tolerance for margin in (0.5, 1.5))
        state[free[~blocked_within(self.grid, lo[:, free], hi[:, free], near)]] = CellState.FREE
        mixed = np.flatnonzero(state == CellState.MIXED)
        state[mixed[blocked_within(self.grid, hi[:, mixed], lo[:, mixed], forbidden)]] = CellState.BLOCKED
        return state

    def are_free(self, q0: ArrayLike, q1: ArrayLike) -> Booleans:
        """Return whether straight motions from ``q0`` to ``q1`` are proven free all the way.

        A point may change from one free voxel to another only through faces. A motion within faces or along edges of
        voxels is free if a path through the voxels beside it is free.
        """
        q0, q1 = as_motions(q0, q1, self.grid.dim)
        free = np.isfinite(q0 + q1).all(axis=1)
        for part in batches(np.flatnonzero(free), _MOTIONS):
            ends = q0[part].T, q1[part].T
            if self.radius == 0:
                free[part] = Traversal(self.grid, *ends).passes()
            else:
                free[part] = ball_passes(self.grid, *ends, self.radius - self.tolerance / 2)
        return free

    def separated(self, q: ArrayLike) -> "tuple[VoxelSpace, VoxelSpace | None]":
        """Divide the space in two by the free voxels.

        The first part has the free voxels that are connected through faces to a position in ``q``, the second part
        has all other free voxels. Return each part as a space of its own. If one part has no voxel, return the space
        itself and None.
        """
        # 1. Find the regions of all free voxels that contain a position: 2**dim voxels, some equal, per position.
        labeled: Any = ndimage.label(self.grid.padded)
        region = labeled[0]
        below, above = self.grid.numbers(as_points("q", q, self.grid.dim).T)
        voxels = (np.where(ends, above.T, below.T) for ends in product((False, True), repeat=self.grid.dim))
        regions = [region[tuple(voxel.T)] for voxel in voxels]
        # 2. Take the free voxels of these regions; 0 is the region of blocked voxels.
        is_joined = np.isin(region, np.setdiff1d(regions, 0))[(slice(1, -1),) * self.grid.dim]
        if not is_joined.any() or not (rest := self.free & ~is_joined).any():
            return self, None
        return VoxelSpace(is_joined, self.domain, self.radius), VoxelSpace(rest, self.domain, self.radius)

    def sees_boxes(self, q: ArrayLike, lo: ArrayLike, hi: ArrayLike) -> Booleans:
        """Return whether a point robot at ``q[i]`` is proven to see every free position of box ``i``.

        Box ``i`` reaches from ``lo[i]`` to ``hi[i]``. The free voxels that it touches must fill a box, too. ``q[i]``
        must lie in both boxes, but not on an edge or corner where blocked voxels touch. The result is False for a
        ball robot.
        """
        (q, _), _ = as_motions(q, lo, self.grid.dim), as_boxes(lo, hi, self.grid.dim)
        if self.radius > 0:
            return np.zeros(len(q), bool)
        lo, hi = (np.asarray(end, np.float64).T for end in (lo, hi))
        # 1. The free voxels that the box touches must fill a box: their range has no blocked voxel.
        first, last = self.grid.free_range(self.grid.numbers(lo)[0], self.grid.numbers(hi)[1])
        sees = np.all(first <= last, axis=0) & (self.grid.blocked.within(first, last) == 0)
        # 2. The point must lie in that range and in the given box: voxel k has the faces number k and k + 1.
        for axis, faces in enumerate(self.grid.faces):
            sees &= np.maximum(lo[axis], faces[first[axis]]) <= q[:, axis]
            sees &= q[:, axis] <= np.minimum(hi[axis], faces[last[axis] + 1])
        # 3. The point must not lie on a contact.
        sees &= np.isfinite(q).all(axis=1)
        sees[sees] = ~self.grid.touches_contact(q[sees].T, q[sees].T)
        return sees
