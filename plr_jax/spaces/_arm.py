"""The configuration space of a planar arm: a chain of links that revolute joints turn."""

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any, TypeAlias

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int8

from plr_jax._arrays import as_bool, as_finite, as_finite_point, as_points, set_fields
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.geometry.workspace import Workspace, require_workspace
from plr_jax.robots import shorter_turn
from plr_jax.spaces._plane import crosses_walls, near_walls, segment_distances, walls_within
from plr_jax.spaces._space import MotionCost, as_boxes, as_motions, batches, states_of_boxes

_BOXES = 1 << 14  # boxes handled together, which bounds the memory
_MOTIONS = 1 << 10  # motions handled together
_MOST_BISECTIONS = 12  # largest number of times that a motion is halved
_SIDES = 12  # sides of the polygon around the disc that a link's end sweeps; it reaches 3.5 % farther than the disc
_PROBES = np.array([0.0, 0.5, 1.0])  # positions along each link at which it is tested against obstacles
Angles: TypeAlias = Float[np.ndarray, "n joints"]
# Positions of an arm's joints, base first, and of its tip: link ``i`` leads from point ``i`` to point ``i + 1``.
Ends: TypeAlias = Float[np.ndarray, "n joints_plus_one 2"]


@dataclass(frozen=True, eq=False, init=False)
class PlanarArm:
    """The configuration space of a planar arm in a workspace: joint angles; motions cost their length in radians.

    The first angle is measured from the x axis, each other angle from the previous link. Angles are in radians,
    counterclockwise and modulo a full turn. A configuration is free if all links avoid obstacles and the outside of
    the bounds, up to ``workspace.tolerance``; with ``self_collision``, links must also avoid one another.
    Classification of boxes is conservative (MIXED if in doubt), and tighter for smaller boxes. An argument out of its
    range raises ``ValueError``.

    Args:
        lengths: Lengths of the links, ``(joints,)``, in workspace units, positive; one joint per link.
        base: Position of the first joint, ``(2,)``, with a clearance of at least half the width.
        width: Width of the links, at least 0: a link covers all points within ``width / 2`` of a segment.
        self_collision: Whether links that are not neighbors must not overlap; needs a positive width.
    """

    workspace: Workspace
    lengths: Float[np.ndarray, " joints"]
    base: Float[np.ndarray, "2"]
    width: float
    self_collision: bool

    def __init__(self, workspace: Any, lengths: Any, base: Any, width: float | int = 0, self_collision: bool = False):
        require_workspace(workspace)
        lengths, base = as_finite_point("lengths", lengths), as_finite_point("base", base, 2)
        if (lengths <= 0).any():
            raise ValueError(f"The lengths of an arm's links must be positive, got {lengths.tolist()}.")
        width, self_collision = as_finite("width", width), as_bool("self_collision", self_collision)
        if self_collision and width == 0:
            raise ValueError("self_collision needs links of a width above 0, got 0: give a width, or leave it out.")
        clearance = workspace.clearance(base[None])[0]
        if clearance < width / 2 - workspace.tolerance:
            expected = f"a clearance of at least {width / 2:g}, half the width of the links"
            raise ValueError(f"The base of the arm at {base.tolist()} must have {expected}, got {clearance:.3g}.")
        set_fields(self, workspace=workspace, lengths=lengths, base=base, width=width, self_collision=self_collision)

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self.lengths)

    @property
    def domain(self) -> Box:
        """Angles from ``-pi`` to ``pi``, all periodic."""
        return Box([-np.pi] * self.dof, [np.pi] * self.dof, periodic=(True,) * self.dof)

    @property
    def motion_cost(self) -> MotionCost:
        """Length of a motion in joint space, in radians."""
        return MotionCost(((tuple(range(self.dof)), 1.0),))

    def forward(self, q: ArrayLike) -> Ends:
        """Return the positions of the joints, base first, and of the arm's tip, ``(n, joints + 1, 2)``."""
        heading = np.cumsum(as_points("q", q, self.dof), axis=1)
        links = self.lengths[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=2)
        return self.base + np.concatenate([np.zeros((len(links), 1, 2)), np.cumsum(links, axis=1)], axis=1)

    def is_free(self, q: ArrayLike) -> Bool[np.ndarray, " n"]:
        """Return whether configurations ``(n, joints)`` are free; False for configurations that are not finite."""
        q = as_points("q", q, self.dof)
        free = np.isfinite(q).all(axis=1)
        ends = self.forward(np.where(free[:, None], q, 0.0))
        for i in range(self.dof):
            rows = np.flatnonzero(free)
            free[rows] = self.workspace.is_visible(ends[rows, i], ends[rows, i + 1])
            if self.width > 0:
                rows = rows[free[rows]]
                links: Any = shapely.linestrings(ends[rows, i : i + 2])
                free[rows] = ~near_walls(self.workspace, links, self.width / 2 - self.workspace.tolerance)
        return free & (self._link_distances(ends) >= self.width - self.workspace.tolerance).all(axis=1)

    def are_free(self, q0: ArrayLike, q1: ArrayLike) -> Bool[np.ndarray, " n"]:
        """Return whether straight motions from ``q0`` to ``q1``, ``(n, joints)``, are proven free all the way.

        Each joint turns the shorter way. A motion that comes close to a wall may not be proven free. Close means
        about 1e-3 of the length of the path of the arm's tip.
        """
        q0, q1 = as_motions(q0, q1, self.dof)
        free = self.is_free(q0) & self.is_free(q1)
        for part in batches(np.flatnonzero(free), _MOTIONS):
            free[part] = self._are_free(q0[part], shorter_turn(q0[part], q1[part]))
        return free

    def classify(self, lo: ArrayLike, hi: ArrayLike) -> Int8[np.ndarray, " n"]:
        """Tell whether boxes of joint angles (radians) are FREE, BLOCKED or MIXED; see :class:`CellState`."""
        center, half = as_boxes(lo, hi, self.dof)
        return states_of_boxes(self, center, half, np.arange(len(center)), _BOXES)

    def _are_free(self, q0: Angles, change: Angles) -> Bool[np.ndarray, " n"]:
        # Bisect motions. A part of a motion is `center` - half to `center` + half, the diagonal of a box: the part is
        # free if the box is. A motion is not proven free if the center of a part is not free, or parts are left after
        # the last bisection.
        free = np.ones(len(q0), dtype=bool)
        motion = np.arange(len(q0))  # of each part
        center, half = q0 + change / 2, change / 2
        for _ in range(_MOST_BISECTIONS):
            is_unsure = ~self._boxes_are_free(center, np.abs(half))
            motion, center, half = motion[is_unsure], center[is_unsure], half[is_unsure]
            free[motion[~self.is_free(center)]] = False
            stays = free[motion]
            motion, half = np.tile(motion[stays], 2), np.tile(half[stays] / 2, (2, 1))
            center = np.tile(center[stays], (2, 1)) + np.repeat([[-1], [1]], stays.sum(), axis=0) * half
        free[motion] = False
        return free

    def _boxes_are_free(self, center: Angles, half: Angles) -> Bool[np.ndarray, " n"]:
        """Return whether each box of joint angles, from ``center - half`` to ``center + half``, is proven free."""
        #     .---.___________         In a box, a link's ends stay in discs around their places at the center. The
        #    /     \          --.-.    radii, `reaches`, are the sum over joints of half width times largest distance.
        #   (   o=============( o )   A point between the ends moves no farther than the linear interpolation of both
        #    \     /___________-'-'    radii. So the convex hull of the discs contains the link.
        #     '---'
        ends, reaches = self.forward(center), half @ self._max_reach
        angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
        rim = np.stack([np.cos(angle), np.sin(angle)], axis=1) / np.cos(np.pi / _SIDES)  # a polygon around a disc
        free = np.ones(len(center), dtype=bool)
        for i in reversed(range(self.dof)):  # the last link moves most
            rows = np.flatnonzero(free)
            points = ends[rows, i : i + 2, None] + reaches[rows, i : i + 2, None, None] * rim
            hulls: Any = shapely.convex_hull(shapely.linestrings(points.reshape(len(rows), 2 * _SIDES, 2)))
            free[rows] = shapely.covers(self.workspace.free_space, hulls)
            if self.width > 0:
                rows, hulls = rows[free[rows]], hulls[free[rows]]
                free[rows] = ~near_walls(self.workspace, hulls, self.width / 2 - self.workspace.tolerance / 2)
        return free & (self._link_distances(ends) >= self.width + self._link_motion_bounds(half)).all(axis=1)

    def _boxes_are_blocked(self, center: Angles, half: Angles) -> Bool[np.ndarray, " n"]:
        """Return whether each box of joint angles is proven to hold no free configuration.

        The boxes reach from ``center - half`` to ``center + half``.
        """
        # They hold none if a link crosses a wall wherever its ends are in their discs; if a wall is so near to a
        # point of a link that the link covers it wherever the point moves; or if two links surely overlap.
        ends, reaches = self.forward(center), half @ self._max_reach + 2 * self.workspace.tolerance
        hit = np.zeros(len(center), dtype=bool)
        for i in range(self.dof):
            rows = np.flatnonzero(~hit)
            hit[rows] = crosses_walls(self.workspace, ends[rows, i : i + 2], reaches[rows, i : i + 2])
            for t in _PROBES:
                rows = np.flatnonzero(~hit)
                x, moves = ((1 - t) * of_ends[rows, i] + t * of_ends[rows, i + 1] for of_ends in (ends, reaches))
                hit[rows] = walls_within(self.workspace, x, self.width / 2 - moves)
        deep = self.width - self._link_motion_bounds(half) - 2 * self.workspace.tolerance
        return hit | (self._link_distances(ends) <= deep).any(axis=1)

    @cached_property
    def _max_reach(self) -> Float[np.ndarray, "joints joints_plus_one"]:
        # Largest distance from each joint to the base (column 0) and to the end of link k (column k, from 1 on); 0 if
        # the joint does not move this point.
        along = np.append(0.0, np.cumsum(self.lengths))
        return np.maximum(0.0, along - along[:-1, None])

    @cached_property
    def _link_pairs(self) -> list[tuple[int, int]]:
        """Pairs of links, by index, that must not overlap: with ``self_collision``, all pairs of non-neighbors."""
        return [(i, k) for i, k in combinations(range(self.dof), 2) if k > i + 1 and self.self_collision]

    def _link_distances(self, ends: Ends) -> Float[np.ndarray, "n pairs"]:
        # `reshape` also makes an empty table if there are no pairs.
        distances = [segment_distances(ends[:, i : i + 2], ends[:, k : k + 2]) for i, k in self._link_pairs]
        return np.reshape(distances, (len(self._link_pairs), len(ends))).T

    def _link_motion_bounds(self, half: Angles) -> Float[np.ndarray, "n pairs"]:
        """Return, for each box of joint angles and pair of links, how far the links may move relative to each other.

        The result is an upper bound, for motions from the box's center to any configuration in the box. ``half`` has
        the half widths of the boxes.
        """
        # As seen from link i, only joints i + 1 to k move link k, and its end moves farthest.
        moves = [half[:, i + 1 :] @ self._max_reach[i + 1 :, k + 1] for i, k in self._link_pairs]
        return np.reshape(moves, (len(self._link_pairs), len(half))).T
