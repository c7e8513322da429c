"""Proven bounds of the cost-to-go on a mesh of cells, and an estimate between them.

The lower bound is the solution of a convex program (``program.py``), the upper bound is the cost of paths
(``paths.py``). :meth:`CostToGoField.bounds_over` bounds the error of any function that is multilinear in boxes, such
as a PLR in its leaves (``certified.py``).
"""

import warnings
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import parts
from plr_jax._types import Reach
from plr_jax.eikonal.elements import basis, to_bernstein
from plr_jax.eikonal.estimate import GridEstimate
from plr_jax.eikonal.goals import Points, nearest_goals
from plr_jax.eikonal.mesh import CellIndex, Mesh
from plr_jax.eikonal.paths import NodePaths
from plr_jax.eikonal.program import ROUNDING, Numbers, SlopeProgram
from plr_jax.plr.tree import PLACING, corner_bits
from plr_jax.spaces import CellState, ConfigurationSpace, SeesBoxes
from plr_jax.spaces._space import CheckedFreeTest

_BOXES_AT_ONCE = 1 << 10  # boxes handled together; beyond five axes each has thousands of points
# A warning tells if an estimate is outside of its bounds by more than
#   _OFF * max(lower bound, _NEAR * largest lower bound).
_OFF = 0.1
_NEAR = 0.01
AtCorners: TypeAlias = Float[np.ndarray, "n corners"]


class MeshEstimate(NamedTuple):
    """An estimate of the cost-to-go that is multilinear in each cell of a mesh, and ``inf`` in blocked cells."""

    mesh: Mesh
    corner_values: AtCorners  # 0 in blocked cells
    reach: Reach | None  # if known: which boxes hold points that paths join to a goal, and which hold others

    def __call__(self, x: Points) -> Numbers:
        mesh = self.mesh
        at = (mesh.domain.wrapped(x) - mesh.domain.lo) / mesh.domain.width
        cell = mesh.locate(at)
        values = np.sum(basis(1, np.clip(mesh.local(cell, at), 0, 1)) * self.corner_values[cell], axis=1)
        return np.where(mesh.state[cell] == CellState.BLOCKED, np.inf, values)


@dataclass(frozen=True, eq=False)
class CostToGoField:
    """A proven lower bound of the cost-to-go on a mesh, a proven upper bound, and an estimate between them."""

    program: SlopeProgram  # of the lower bound
    values: Float[np.ndarray, " dofs"]  # its solution, at most 0 at goals; before rescaling, slopes may be too large
    paths: NodePaths  # paths to the goal, whose costs are upper bounds
    nodal_estimate: Float[np.ndarray, " nodes"]  # at the corners of cells; inf where unknown
    space: ConfigurationSpace
    reach: Reach | None  # of the estimate
    guide: GridEstimate | None  # an estimate on a grid of the space that paths join to goals; None beyond three axes

    @property
    def mesh(self) -> Mesh:
        return self.program.space.mesh

    @property
    def goals(self) -> Points:
        return self.mesh.domain.at(self.program.at)

    @cached_property
    def _nodal(self) -> Float[np.ndarray, "cells nodes"]:
        # The solution, before rescaling, at the nodes of each cell.
        return (self.program.space.values @ self.values).reshape(len(self.mesh.state), -1)

    @cached_property
    def _rescaling(self) -> tuple[Float[np.ndarray, " levels"], Float[np.ndarray, " levels"]]:
        return self.program.rescaling(self.values)

    @cached_property
    def _lower_at_corners(self) -> AtCorners:
        # The larger of two proven bounds: the rescaled solution, and the cost of a straight motion at the least rate.
        is_corner = np.isin(self.program.space.lattice, (0, 1)).all(axis=1)
        proven = np.interp(self._nodal[:, is_corner], *self._rescaling)
        mesh, costs = self.mesh, self.program.costs
        places = mesh.domain.at(self.paths.points)
        if len(self.goals) == 1:
            straight = costs.motion_cost.norm(mesh.domain.difference(places, self.goals))
        else:
            straight = nearest_goals(self.goals, mesh.domain, costs.motion_cost, places)[0][:, 0]
        return np.maximum(proven, (costs.least_rate * straight)[mesh.corners])

    @cached_property
    def _upper_at_corners(self) -> AtCorners:
        # Costs of paths; inf without a path, and at all corners of blocked cells.
        is_open = self.mesh.state != CellState.BLOCKED
        return np.where(is_open[:, None], self.paths.cost[self.mesh.corners], np.inf)

    @cached_property
    def estimate(self) -> MeshEstimate:
        # The estimate at each corner of an open cell is lower bound + excess, between the lower and the upper bound.
        # Where it is unknown, the excess is an average over nearby corners.
        mesh, cell = self.mesh, self.mesh.open_cells
        node, lower, upper = mesh.corners[cell], self._lower_at_corners[cell], self._upper_at_corners[cell]
        excess = np.where(np.isfinite(self.nodal_estimate), self.nodal_estimate, np.nan)[node] - lower
        allowed = _OFF * np.maximum(lower, _NEAR * self._lower_at_corners.max())
        is_off = np.maximum(-excess, excess + lower - upper) > allowed
        if is_off.any() and not isinstance(self.space, CheckedFreeTest):  # nothing is proven of a sampled space
            reason = f"At {is_off.mean():.1%} of the corners of cells the estimate was more than a tenth outside"
            advice = "The PLR answers the nearer bound there. Allow more max_leaves."
            warnings.warn(f"{reason} of its bounds. {advice}", stacklevel=5)
        values = np.zeros(mesh.corners.shape)
        values[cell] = np.minimum(lower + _filled(np.maximum(excess, 0.0), node), upper)
        return MeshEstimate(mesh, values, self.reach)

    @property
    def mean_gap(self) -> float:
        # The mean of (upper - lower bound) over the corners of cells that have an upper bound; 0 if none has.
        is_known = np.isfinite(self._upper_at_corners)
        return float((self._upper_at_corners - self._lower_at_corners)[is_known].mean()) if is_known.any() else 0.0

    def bounds_over(self, cell: CellIndex, lo: Points, hi: Points, corners: AtCorners) -> tuple[Numbers, Numbers]:
        """Bound the cost-to-go minus a function that is multilinear in boxes, from below and above, in each box.

        Box ``i`` lies in mesh cell ``cell[i]``, which must not be blocked. The lower and upper corner of the box,
        ``lo[i]`` and ``hi[i]``, are local coordinates of this cell, from 0 to 1. ``corners[i]`` are the function's
        values at all corners of the box. The bounds also hold at points slightly outside of the box, which rounding
        may assign to the box. An upper bound is ``inf`` if some free point of the box has no known path to a goal.
        """
        mesh, space, dim = self.mesh, self.program.space, self.mesh.dim
        below, above = np.empty(len(cell)), np.empty(len(cell))
        #   2---5---8    For upper bounds, a box is cut into 2**dim equal parts, as the best path from each part may
        #   |   |   |    lead to another corner or target. `grid` has the 3**dim vertices of all parts, from 0 to 1.
        #   1---4---7    Row p of `vertices` lists the vertices of part p: in the plane, with the first axis to the
        #   |   |   |    right, the rows are (0, 1, 3, 4), (1, 2, 4, 5), (3, 4, 6, 7) and (4, 5, 7, 8).
        #   0---3---6
        grid = np.array(list(product((0.0, 0.5, 1.0), repeat=dim)))
        middles = 0.25 + corner_bits(dim) / 2
        vertices = np.stack([np.flatnonzero(np.all(np.abs(grid - middle) <= 0.25, axis=1)) for middle in middles])
        for batch in parts(np.ones(len(cell), np.int64), _BOXES_AT_ONCE):
            cells, spare = cell[batch], self._spare[cell[batch]]
            begin, width, values = lo[batch, None], (hi - lo)[batch, None], corners[batch]
            # 1. Lower bounds. Let f be the given function. The proven bound is g(u): u is the solution, a polynomial
            #    of degree n along each axis of the cell, and g the rescaling, whose slopes are from 0 to 1. So
            #    g(u) - u falls with u: in the box it is at least `bent`, its value at the largest u. The Bernstein
            #    coefficients of u (`control`) enclose u. The coefficients of f, written with degree n, are its values
            #    on the lattice. So
            #      g(u) - f >= min over the lattice of (control - f)  +  bent.
            #    The bound h by straight motions is concave in the box, and f is linear along each axis. So h - f is
            #    concave along each axis, and least at a corner.
            at = begin + width * space.lattice
            weights = basis(space.degree, at.reshape(-1, dim)).reshape(*at.shape[:2], -1)
            control = np.einsum("nij,nj->ni", weights, self._nodal[cells]) @ to_bernstein(space.degree, dim).T
            highest = control.max(axis=1)
            bent = np.interp(highest, *self._rescaling) - highest
            by_program = (control - values @ basis(1, space.lattice).T).min(axis=1) + bent
            ends = (mesh.domain.at(mesh.fractions(cells, end[batch])) for end in (lo, hi))
            below[batch] = np.maximum(by_program, (self._below_straight(*ends) - values).min(axis=1)) - spare
            # 2. Upper bounds, by straight motions to a corner of the cell or to one of its targets, and on along the
            #    path of this node. The cost of a straight motion is convex, and f is linear along each axis. So their
            #    difference is convex along each axis, and largest at a vertex. Each part takes its best node.
            at = begin + width * grid
            function = values @ basis(1, grid).T
            least = np.full((len(cells), len(vertices)), np.inf)
            for corner, place in enumerate(corner_bits(dim)):
                change = ((place - at) * mesh.widths[cells][:, None]).reshape(-1, dim)
                straight = self.program.costs.of_motions(change, np.repeat(cells, at.shape[1])).reshape(at.shape[:2])
                by_corner = self._upper_at_corners[cells, corner, None] + straight - function
                by_corner[~self._sees[cells, corner]] = np.inf
                least = np.minimum(least, by_corner[:, vertices].max(axis=2))
            x = mesh.fractions(cells[:, None], at)
            for target in self._targets[:, cells]:
                change = (self.paths.points[target, None] - x) * mesh.domain.width
                straight = self.program.costs.motion_cost.norm(change.reshape(-1, dim)).reshape(at.shape[:2])
                by_target = self.paths.cost[target, None] + straight - function
                by_target[target < 0] = np.inf
                least = np.minimum(least, by_target[:, vertices].max(axis=2))
            above[batch] = least.max(axis=1) + spare
        return below, above

    def _below_straight(self, lo: Points, hi: Points) -> AtCorners:
        """Return the values, at the corners of boxes, of a lower bound of the cost-to-go that is concave in each box.

        The bound follows from the costs of straight motions to the goals. It is 0 if an axis is periodic.

        ``lo`` and ``hi`` are the lower and upper corners of boxes, in coordinates of the domain.
        """
        # Any path to goal g costs at least `least_rate` times the norm N of the straight motion from x to g. Over a
        # box with the middle m, concave lower bounds of N are
        #   nearest goal:  N(x - g) >= s . (x - g), with s the gradient of N at m - g;
        #   other goals:   N(x - g) >= |x - g| >= |m - g| - |x - m|, with |.| the Euclidean length in axes multiplied
        #                  by `motion_cost.scale`, which is at most N. Half a diagonal bounds |x - m|.
        # The least of these functions is concave, too.
        costs, domain, bits = self.program.costs, self.mesh.domain, corner_bits(self.mesh.dim)
        if domain.is_periodic:  # costs of motions either way around are not convex
            return np.zeros((len(lo), len(bits)))
        distance, nearest = nearest_goals(self.goals, domain, costs.motion_cost, (lo + hi) / 2, 2)
        goal = self.goals[nearest[:, 0]]
        middle = (lo + hi) / 2 - goal
        slope = np.zeros_like(lo)
        for axes, weight in costs.motion_cost.blocks:
            length = np.linalg.norm(middle[:, axes], axis=1, keepdims=True)
            slope[:, axes] = weight * middle[:, axes] / np.maximum(length, np.finfo(float).tiny)
        corners = lo[:, None] + (hi - lo)[:, None] * bits - goal[:, None]
        others = distance[:, 1] - np.linalg.norm(costs.motion_cost.scale * (hi - lo) / 2, axis=1)
        return costs.least_rate * np.minimum(np.einsum("nk,nck->nc", slope, corners), others[:, None])

    @cached_property
    def _targets(self) -> Int[np.ndarray, "targets cells"]:
        # Three nodes ahead of each free cell on paths to a goal; -1 instead of a node to which not all straight
        # motions from the cell are proven free. None with a cost map: the cost of a motion is then not its norm.
        mesh, paths = self.mesh, self.paths
        if self.program.costs.cost_map is not None:
            return np.full((0, len(mesh.state)), -1)
        # 1. The next two nodes after the corner nearest to a goal, and the next node after the farthest corner.
        cells, costs = np.arange(len(mesh.state)), self._upper_at_corners
        nearest, farthest = (mesh.corners[cells, corner] for corner in (costs.argmin(axis=1), costs.argmax(axis=1)))
        ahead = paths.next[nearest]
        target = np.stack([ahead, paths.next[ahead], paths.next[farthest]])
        # 2. All motions are free if the smallest box around cell and node is free.
        free = np.flatnonzero(np.isfinite(costs).any(axis=1) & (mesh.state == CellState.FREE))
        place = mesh.domain.at(paths.points[target[:, free]])
        lo, hi = (np.broadcast_to(end[free], place.shape) for end in mesh.grown_boxes)
        hull = np.minimum(lo, place).reshape(-1, mesh.dim), np.maximum(hi, place).reshape(-1, mesh.dim)
        sees = (self.space.classify(*hull) == CellState.FREE).reshape(3, -1)
        visible = np.full_like(target, -1)
        visible[:, free] = np.where(sees, target[:, free], -1)
        return visible

    @cached_property
    def _spare(self) -> Float[np.ndarray, " cells"]:
        # A margin for rounding: of values, and the cost of the motion into a cell from points just outside that count
        # as inside.
        costs, beside = self.program.costs, PLACING * self.mesh.domain.width
        margin = costs.motion_cost.norm(beside[None]) * costs.upper
        if costs.pulls is not None:
            margin = margin + (np.abs(costs.pulls) @ beside).max(axis=0)
        return ROUNDING * max(np.abs(self._nodal).max(), self._lower_at_corners.max()) + margin

    @cached_property
    def _sees(self) -> Bool[np.ndarray, "cells corners"]:
        # Whether all straight motions to each corner of a cell are free, from the cell and from points just outside.
        # 1. They are if the grown box, of all points that rounding may place in the cell, is free.
        mesh, (lo, hi) = self.mesh, self.mesh.grown_boxes
        free = np.flatnonzero(mesh.state == CellState.FREE)
        is_clear = self.space.classify(lo[free], hi[free]) == CellState.FREE
        # 2. Around other free cells, each part of the grown box must be free or blocked. From a free part the
        #    shortest motion to the cell is free, and beside a flush wall the other parts are blocked.
        #      +---+-----------+---+   hi          ends[3]    The sides of the cell cut the grown box into 3**dim
        #      +---+-----------+---+   cell's hi   ends[2]    parts. Part k along an axis, of 0, 1 and 2, lies
        #      |   |   cell    |   |                          between ends[k] and ends[k + 1].
        #      +---+-----------+---+   cell's lo   ends[1]
        #      +---+-----------+---+   lo          ends[0]
        others = np.flatnonzero(~is_clear)
        ends, axes = np.stack([lo, *mesh.boxes, hi])[:, free[others]], np.arange(mesh.dim)
        is_clear[others] = True
        for part in product(range(3), repeat=mesh.dim):
            begin, end = ends[part, :, axes].T, ends[np.add(part, 1), :, axes].T
            rows = np.flatnonzero((begin < end).all(axis=1))  # parts at the border of the domain may be flat
            is_clear[others[rows]] &= self.space.classify(begin[rows], end[rows]) != CellState.MIXED
        sees = np.zeros((len(mesh.state), 2**mesh.dim), bool)
        sees[free[is_clear]] = True
        # 3. Beside walls, the space may prove it of single corners.
        if isinstance(self.space, SeesBoxes):
            cell, corner = np.nonzero(np.isfinite(self._upper_at_corners) & ~sees)
            q = np.stack(mesh.boxes)[corner_bits(mesh.dim)[corner], cell[:, None], np.arange(mesh.dim)]
            sees[cell, corner] = self.space.sees_boxes(q, lo[cell], hi[cell])
        return sees


def _filled(values: AtCorners, node: Int[np.ndarray, "cells corners"]) -> AtCorners:
    """Replace unknown values (NaN) at the corners of cells by averages of known values.

    Corners of several cells at the same point have the same index ``node``. In each round, a cell offers the mean of
    its known values to its unknown corners, and an unknown corner takes the mean of all offers at its node. Rounds
    end when no cell has both known and unknown corners. Values that are then unknown become 0.
    """
    num = int(node.max()) + 1
    while True:
        is_known = np.isfinite(values)
        count = is_known.sum(axis=1, keepdims=True)
        mean = np.where(is_known, values, 0.0).sum(axis=1, keepdims=True) / np.maximum(count, 1)
        is_offered = ~is_known & (count > 0)
        if not is_offered.any():
            return np.where(is_known, values, 0.0)
        total = np.bincount(node[is_offered], np.broadcast_to(mean, values.shape)[is_offered], num)
        weight = np.bincount(node[is_offered], minlength=num)
        fill = np.divide(total, weight, out=np.full(num, np.nan), where=weight > 0)
        values = np.where(is_known, values, fill[node])
