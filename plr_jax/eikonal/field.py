"""What has been found of the cost-to-go: a proven lower and a proven upper bound, and an estimate between them."""

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.eikonal.elements import basis, to_bernstein
from plr_jax.eikonal.mesh import Mesh
from plr_jax.eikonal.paths import NodePaths
from plr_jax.eikonal.program import ROUNDING, Rescaling, SlopeProgram
from plr_jax.plr.partition.cells import PLACING, corner_bits
from plr_jax.spaces import CellState, ConfigurationSpace, SeesBoxes

_BOXES_AT_ONCE = 1 << 10  # which bounds the memory: beyond five axes each has thousands of places
_HALVES = np.array([0.0, 0.5, 1.0])


@dataclass(frozen=True, eq=False)
class MeshEstimate:
    """An estimate of the cost-to-go on a mesh.

    Attributes:
        mesh: The cells.
        corner_values: At the corners of open cells; 0 at those of blocked ones.
    """

    mesh: Mesh
    corner_values: Float[np.ndarray, "cells corners"]

    @classmethod
    def of_nodes(cls, mesh: Mesh, costs: Float[np.ndarray, "nodes"]) -> "MeshEstimate":
        """That of an estimate at the nodes of a mesh; at nodes where it is ``inf``, what is known near by."""
        node, num_corners = mesh.corners[mesh.open_cells].ravel(), 2**mesh.dim
        known = np.where(np.isfinite(costs[node]), costs[node], np.nan)
        values = np.zeros((len(mesh.state), num_corners))
        values[mesh.open_cells] = _filled(known, node, num_corners).reshape(-1, num_corners)
        return cls(mesh, values)

    def __call__(self, x: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n"]:
        """At points of the domain, multilinear in every cell; ``inf`` in blocked ones."""
        mesh = self.mesh
        at = (mesh.domain.wrapped(x) - mesh.domain.lo) / mesh.domain.width
        cell = mesh.locate(at)
        values = np.sum(basis(1, np.clip(mesh.local(cell, at), 0, 1)) * self.corner_values[cell], axis=1)
        return np.where(mesh.state[cell] == CellState.BLOCKED, np.inf, values)


@dataclass(frozen=True, eq=False)
class CostToGoField:
    """A proven lower bound of the cost-to-go on a mesh, a proven upper one, and an estimate between them.

    Attributes:
        program: The program whose solution bounds it from below.
        values: That solution, 0 at the goal; its slopes may be a little too steep.
        paths: The paths that bound it from above.
        likely: An estimate at the nodes of the mesh; ``inf`` where there is none.
        space: The configuration space.
    """

    program: SlopeProgram
    values: Float[np.ndarray, "dofs"]
    paths: NodePaths
    likely: Float[np.ndarray, "nodes"]
    space: ConfigurationSpace

    @property
    def mesh(self) -> Mesh:
        """The cells."""
        return self.program.space.mesh

    @cached_property
    def _nodal(self) -> Float[np.ndarray, "cells nodes"]:
        """Values at the nodes of each cell."""
        return (self.program.space.values @ self.values).reshape(len(self.mesh.state), -1)

    @cached_property
    def _rescaling(self) -> Rescaling:
        return self.program.rescaling(self.values)

    def lower_at(self, cell: Int[np.ndarray, "n"], t: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n"]:
        """The lower bound at points ``t``, from 0 to 1, of cells, but for what is rounded."""
        return self._rescaling(np.sum(basis(self.program.space.degree, t) * self._nodal[cell], axis=1))

    @cached_property
    def estimate(self) -> "MeshEstimate":
        """The estimate, within the bounds; where there is none, as far above the lower one as near by."""
        mesh, corners = self.mesh, corner_bits(self.mesh.dim)
        cell, corner = np.divmod(np.arange(len(mesh.open_cells) * len(corners)), len(corners))
        lower = self.lower_at(mesh.open_cells[cell], corners[corner].astype(float))
        node = mesh.corners[mesh.open_cells].ravel()
        excess = np.maximum(self.likely[node] - lower, 0.0)
        excess = _filled(np.where(np.isfinite(excess), excess, np.nan), node, len(corners))
        values = np.zeros((len(mesh.state), len(corners)))
        values[mesh.open_cells[cell], corner] = np.minimum(lower + excess, self.paths.cost[node])
        return MeshEstimate(mesh, values)

    @cached_property
    def mean_gap(self) -> float:
        """Mean distance of the bounds at the corners of cells that have both."""
        corners = corner_bits(self.mesh.dim).astype(float)
        cell, corner = np.nonzero(np.isfinite(self._corner_costs))
        gap = self._corner_costs[cell, corner] - self.lower_at(cell, corners[corner])
        return float(gap.mean()) if len(gap) else 0.0

    @cached_property
    def _corner_costs(self) -> Float[np.ndarray, "cells corners"]:
        """The cost of a path from each corner of open cells; ``inf`` where there is none."""
        is_open = self.mesh.state != CellState.BLOCKED
        return np.where(is_open[:, None], self.paths.cost[self.mesh.corners], np.inf)

    def bounds_over(
        self,
        cell: Int[np.ndarray, "n"],
        lo: Float[np.ndarray, "n dim"],
        hi: Float[np.ndarray, "n dim"],
        corners: Float[np.ndarray, "n corners"],
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Bounds of the cost-to-go minus multilinear functions over boxes in open cells.

        They hold as well for points beside a box that a query may place in it, if for the function's value there the
        one at the nearest point of the box is taken.

        Args:
            cell: The cell of each box.
            lo: Its lower corner in the cell, from 0 to 1.
            hi: Its upper corner.
            corners: The function's values at the box's corners.

        Returns:
            Lower bounds, and upper ones: ``inf`` where no path is known from all free points of the box.
        """
        below, above = np.empty(len(cell)), np.empty(len(cell))
        for begin in range(0, len(cell), _BOXES_AT_ONCE):
            some = slice(begin, begin + _BOXES_AT_ONCE)
            below[some] = self._lowest(cell[some], lo[some], hi[some], corners[some])
            above[some] = self._highest(cell[some], lo[some], hi[some], corners[some])
        return below, above

    def _lowest(
        self,
        cell: Int[np.ndarray, "n"],
        lo: Float[np.ndarray, "n dim"],
        hi: Float[np.ndarray, "n dim"],
        corners: Float[np.ndarray, "n corners"],
    ) -> Float[np.ndarray, "n"]:
        space = self.program.space
        lattice = space.lattice
        at = lo[:, None] + (hi - lo)[:, None] * lattice
        weights = basis(space.degree, at.reshape(-1, self.mesh.dim)).reshape(*at.shape[:2], -1)
        control = np.einsum("nij,nj->ni", weights, self._nodal[cell]) @ to_bernstein(space.degree, self.mesh.dim).T
        function = corners @ basis(1, lattice).T
        highest = control.max(axis=1)
        bent = self._rescaling(highest) - highest  # most where the value is largest
        return (control - function).min(axis=1) + bent - self._spare[cell]

    def _highest(
        self,
        cell: Int[np.ndarray, "n"],
        lo: Float[np.ndarray, "n dim"],
        hi: Float[np.ndarray, "n dim"],
        corners: Float[np.ndarray, "n corners"],
    ) -> Float[np.ndarray, "n"]:
        """By straight motions to corners of the cell, whose costs are convex: the most is at a vertex of a part."""
        mesh, dim = self.mesh, self.mesh.dim
        lattice = np.stack(np.meshgrid(*[_HALVES] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
        middles = 0.25 + corner_bits(dim) / 2
        vertices = np.stack([np.flatnonzero(np.all(np.abs(lattice - middle) <= 0.25, axis=1)) for middle in middles])
        at = lo[:, None] + (hi - lo)[:, None] * lattice
        function = corners @ basis(1, lattice).T
        most = np.full((len(cell), len(vertices)), np.inf)
        for corner, place in enumerate(corner_bits(dim)):
            change = ((place - at) * mesh.widths[cell][:, None]).reshape(-1, dim)
            straight = self.program.costs.of_motions(change, np.repeat(cell, at.shape[1])).reshape(at.shape[:2])
            above = self._corner_costs[cell, corner, None] + straight - function
            above[~self._sees[cell, corner]] = np.inf
            most = np.minimum(most, above[:, vertices].max(axis=2))
        x = mesh.fractions(cell[:, None], at)
        for target in self._targets[:, cell]:
            change = (self.paths.points[target, None] - x) * mesh.domain.width
            straight = self.program.costs.motion.norm(change.reshape(-1, dim)).reshape(at.shape[:2])
            above = self.paths.cost[target, None] + straight - function
            above[target < 0] = np.inf
            most = np.minimum(most, above[:, vertices].max(axis=2))
        return most.max(axis=1) + self._spare[cell]

    @cached_property
    def _targets(self) -> Int[np.ndarray, "targets cells"]:
        """Nodes on the way from corners of cells, or the goal, that are seen from everywhere in a cell; -1 for none.

        They are if a box that holds both is free.
        """
        mesh, paths = self.mesh, self.paths
        if self.program.costs.cost_map is not None:
            return np.full((0, len(mesh.state)), -1)
        cells, costs = np.arange(len(mesh.state)), self._corner_costs
        nearest, farthest = (mesh.corners[cells, corner] for corner in (costs.argmin(axis=1), costs.argmax(axis=1)))
        ahead = paths.next[nearest]
        target = np.stack([ahead, paths.next[ahead], paths.next[farthest]])
        free = np.flatnonzero(np.isfinite(costs).any(axis=1) & (mesh.state == CellState.FREE))
        place = mesh.domain.at(paths.points[target[:, free]])
        lo, hi = (np.broadcast_to(end[free], place.shape) for end in mesh.grown_boxes)
        hull = np.minimum(lo, place).reshape(-1, mesh.dim), np.maximum(hi, place).reshape(-1, mesh.dim)
        sees = (self.space.classify(*hull) == CellState.FREE).reshape(3, -1)
        seen = np.full_like(target, -1)
        seen[:, free] = np.where(sees, target[:, free], -1)
        return seen

    @cached_property
    def _spare(self) -> Float[np.ndarray, "cells"]:
        """What is rounded, and what the way costs to each cell from a point beside it that a query places in it."""
        costs, beside = self.program.costs, PLACING * self.mesh.domain.width
        way = costs.motion.norm(beside[None]) * costs.upper
        if costs.pulls is not None:
            way = way + (np.abs(costs.pulls) @ beside).max(axis=0)
        return ROUNDING * np.abs(self._nodal).max() + way

    @cached_property
    def _sees(self) -> Bool[np.ndarray, "cells corners"]:
        """Whether a straight motion to a corner is free from all free points that a query may place in a cell."""
        mesh, (lo, hi) = self.mesh, self.mesh.grown_boxes
        free = np.flatnonzero(mesh.state == CellState.FREE)
        is_clear = self.space.classify(lo[free], hi[free]) == CellState.FREE
        is_clear[~is_clear] = self._are_clear_beside(free[~is_clear])
        sees = np.zeros((len(mesh.state), 2**mesh.dim), bool)
        sees[free[is_clear]] = True
        if isinstance(self.space, SeesBoxes):
            cell, corner = np.nonzero(np.isfinite(self._corner_costs) & ~sees)
            q = np.stack(mesh.boxes)[corner_bits(mesh.dim)[corner], cell[:, None], np.arange(mesh.dim)]
            sees[cell, corner] = self.space.sees_boxes(q, lo[cell], hi[cell])
        return sees

    def _are_clear_beside(self, cell: Int[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
        """Whether beside free cells, where a query may place points in them, each part is free or blocked.

        From a free part the shortest motion to the cell is free; beside a wall that is flush with the cell, the other
        parts are blocked.
        """
        (lo, hi), (first, last) = self.mesh.boxes, self.mesh.grown_boxes
        ends, axes = np.stack([first, lo, hi, last])[:, cell], np.arange(self.mesh.dim)
        clear = np.ones(len(cell), bool)
        for part in product(range(3), repeat=self.mesh.dim):
            begin, end = ends[part, :, axes].T, ends[np.add(part, 1), :, axes].T
            some = np.flatnonzero((begin < end).all(axis=1))  # at the border of the domain there is nothing beside
            clear[some] &= self.space.classify(begin[some], end[some]) != CellState.MIXED
        return clear


def _filled(values: Float[np.ndarray, "m"], node: Int[np.ndarray, "m"], num_corners: int) -> Float[np.ndarray, "m"]:
    """Values at nodes, unknown ones (NaN) from the known ones of their cells, cell by cell outward."""
    values = values.copy()
    num = int(node.max()) + 1
    while True:
        of_cell = values.reshape(-1, num_corners)
        known = np.isfinite(of_cell)
        count = known.sum(axis=1)
        mean = np.where(count > 0, np.where(known, of_cell, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan)
        near = np.repeat(mean, num_corners)
        use = np.isnan(values) & np.isfinite(near)
        if not use.any():
            return np.where(np.isnan(values), 0.0, values)
        total = np.bincount(node[use], near[use], num)
        weight = np.bincount(node[use], minlength=num)
        fill = np.divide(total, weight, out=np.full(num, np.nan), where=weight > 0)
        values = np.where(np.isnan(values), fill[node], values)
