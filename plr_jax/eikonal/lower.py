"""Proven lower bounds of the cost-to-go: the slope program on meshes that are refined where the flow loses most."""

import warnings

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array, vstack
from tqdm import tqdm

from plr_jax.eikonal.cell_costs import cell_costs
from plr_jax.eikonal.contacts import with_open_contacts
from plr_jax.eikonal.elements import function_space
from plr_jax.eikonal.mesh import Mesh, coarse_mesh
from plr_jax.eikonal.paths import graph_costs
from plr_jax.eikonal.program import Iterate, SlopeProgram
from plr_jax.spaces import CellState, ConfigurationSpace, CostMap

_COARSEST = 1 / 16  # share of the cells that the first mesh has
_FEWEST = 2  # of these: in one alone, flows to a goal in its middle cancel, and no loss shows
_SHARE = 0.8  # of the loss, in cells that are refined
_LEAKING = 0.1  # share of the loss in mixed cells, above which flows leak through walls
_LAST = 0.01  # share of the cells that are left, which are used at once
_GROWTH = 1.3, 2.0  # least and most, of the number of cells
_FIRST, _NEXT = 100, 20  # iterations on the first mesh, and on those after it
_FACTORED_FIRST = (20, 40, 80)  # before which of these the penalties follow the flow
_MOST = 1000  # iterations at the end
_DETOUR = 16  # most by which a loss counts more for the way around that it hides
_DEEPEST = 13  # splits along an axis, which a query resolves
_INSET = 1e-9  # of a cell, by which points keep off its faces


class SlopeSolver:
    """The slope program on finer and finer meshes.

    Args:
        space: What is free.
        cost_map: A factor of the cost of motions, or None.
        goal: The goal, a fraction of the domain.
        max_cells: Most cells.
        tolerance: Mean loss at which the mesh is fine enough.

    Attributes:
        program: The program on the finest mesh so far.
    """

    def __init__(
        self,
        space: ConfigurationSpace,
        cost_map: CostMap | None,
        goal: Float[np.ndarray, "dim"],
        max_cells: int,
        tolerance: float,
    ):
        self.space, self.cost_map, self.goal = space, cost_map, goal
        self.max_cells, self.tolerance = max_cells, tolerance
        num_cells = max(int(_COARSEST * max_cells), _FEWEST)
        mesh = coarse_mesh(space, space.motion_cost.scale, num_cells, max_cells)
        self.program = self._program(mesh)
        self._iterate: Iterate | None = None
        self._through = np.full(len(mesh.state), CellState.MIXED, np.int8)  # what motions through mixed cells are

    @property
    def mesh(self) -> Mesh:
        """The finest mesh so far."""
        return self.program.space.mesh

    @property
    def has_solution(self) -> bool:
        """Whether there is one."""
        return self._iterate is not None

    @property
    def values(self) -> Float[np.ndarray, "dofs"]:
        """The solution, 0 at the goal."""
        assert self._iterate is not None
        return self._iterate.values - self.program.at_goal(self._iterate.values)

    def _program(self, mesh: Mesh) -> SlopeProgram:
        return slope_program(mesh, self.space, self.cost_map, self.goal)

    def refine(self, progress: tqdm) -> None:
        """Solve, refine where the flow loses most, and solve again, to the limit; then once more, thoroughly."""
        self._iterate = self.program.solve(_FIRST, self.program.zero(), _FACTORED_FIRST)
        progress.update(len(self.mesh.state))
        parts = 2**self.mesh.dim - 1  # that one cell becomes more, at the most
        while True:
            which, room = self._marked(parts)
            if not len(which) or room < parts:
                break
            finer = self._program(self.mesh.refined(which, self.space, room))
            iterate = _prolonged(self.program, self._iterate, finer)
            progress.update(len(finer.space.mesh.state) - len(self.mesh.state))
            if len(finer.space.mesh.state) + parts <= self.max_cells:
                iterate = finer.solve(_NEXT, iterate)
            # What motions through cells are, for cells that were there before; MIXED for the others.
            fine = finer.space.mesh
            before = self.mesh.locate(fine.fractions(np.arange(len(fine.state)), np.full(fine.dim, 0.5)))
            is_same = (self.mesh.cells.depth[before] == fine.cells.depth).all(axis=1)
            self._through = np.where(is_same, self._through[before], np.int8(CellState.MIXED))
            self.program, self._iterate = finer, iterate
        self._iterate, has_converged = self.program.solve_thoroughly(self._iterate, _MOST)
        if not has_converged:
            warnings.warn(
                f"The solver of lower bounds has not converged in {_MOST:,} iterations: the bounds hold, but lower "
                "ones may be looser than cells allow. Compare those of another max_leaves.",
                stacklevel=4,
            )

    def likely_mesh(self) -> Mesh:
        """The mesh with mixed cells counted as free if a straight motion through their middle is, else as blocked.

        It goes from face to face the way that paths go: that of the slope, when the cell was new.
        """
        mesh = self.mesh
        mixed = np.flatnonzero(mesh.state == CellState.MIXED)
        new = mixed[self._through[mixed] == CellState.MIXED]
        slope = np.zeros((len(mesh.state), mesh.dim))
        slope[mesh.open_cells] = self.program.slopes_within(self.values)
        lo, hi = (corner[new] for corner in mesh.boxes)
        share = np.abs(slope[new] / (hi - lo)).max(axis=1, keepdims=True)
        half = np.divide(slope[new], 2 * share, out=np.zeros_like(lo), where=share > 0)
        is_free = self.space.are_free((lo + hi) / 2 - half, (lo + hi) / 2 + half)
        self._through[new] = np.where(is_free, CellState.FREE, CellState.BLOCKED)
        return mesh.with_state(np.where(mesh.state == CellState.MIXED, self._through, mesh.state))

    def _losses(self) -> Float[np.ndarray, "open"]:
        """Losses, larger in mixed cells across which costs differ more than a motion through them would cost.

        There a thin wall is in the way, and what a flow through it loses is the way around.
        """
        assert self._iterate is not None
        mesh, costs, loss = self.mesh, self.program.costs.midway, losses(self.program, self._iterate)
        at_corners = graph_costs(self.likely_mesh(), costs, self.goal, self.space)[mesh.corners[mesh.open_cells]]
        is_reached = np.isfinite(at_corners)
        highest, least = np.max(at_corners, axis=1, where=is_reached, initial=-np.inf), at_corners.min(axis=1)
        across = costs.of_motions(mesh.widths[mesh.open_cells], mesh.open_cells)
        share = np.divide(highest - least, across, out=np.ones(len(loss)), where=np.isfinite(least))
        return np.where(mesh.state[mesh.open_cells] == CellState.MIXED, np.clip(share, 1.0, _DETOUR), 1.0) * loss

    def _marked(self, parts: int) -> tuple[Int[np.ndarray, "some"], int]:
        """The cells to be refined, first those that lose most, and how many cells may come of it."""
        mesh, num_cells = self.mesh, len(self.mesh.state)
        assert self._iterate is not None
        loss, at_goal = self._losses(), loss_at_goal(self.program, self._iterate, self.goal)
        if max(loss.sum(), at_goal) <= self.tolerance * self.program.weight.sum():
            return np.zeros(0, np.int64), 0
        is_first = (mesh.open_cells == mesh.locate(self.goal[None])) & (at_goal > loss)
        order = np.argsort(-np.where(is_first, np.inf, loss), kind="stable")[: np.count_nonzero(loss + is_first)]
        enough = parts * (np.searchsorted(np.cumsum(loss[order]), _SHARE * loss.sum()) + 1)
        least, most = (max(int((growth - 1) * num_cells), parts) for growth in _GROWTH)
        deepest = mesh.cells.depth[mesh.open_cells[order]].max(axis=1) >= _DEEPEST
        left = self.max_cells - num_cells
        is_mixed = mesh.state[mesh.open_cells] == CellState.MIXED
        if loss[is_mixed].sum() > _LEAKING * loss.sum() and left > _LAST * self.max_cells:
            left = int(_SHARE * left)  # where walls are open still, the next flow finds what is open then
        return mesh.open_cells[order[~deepest]], int(min(max(enough, least), most, left))


def slope_program(
    mesh: Mesh, space: ConfigurationSpace, cost_map: CostMap | None, goal: Float[np.ndarray, "dim"]
) -> SlopeProgram:
    """The program on the part of a mesh that the goal, a fraction of the domain, is connected to."""
    home = mesh.locate(goal[None])
    if mesh.state[home[0]] == CellState.BLOCKED:  # to a tolerance: the goal is free
        state = mesh.state.copy()
        state[home] = CellState.MIXED
        mesh = mesh.with_state(state)
    mesh = with_open_contacts(mesh, space)
    mesh = mesh.without(~mesh.connected_to(int(home[0])))
    # Of the polynomials: 2 errs far less for its cells, but takes too long in more than two dimensions.
    functions = function_space(mesh, (2 if mesh.dim <= 2 else 1))
    gradient = csr_array(vstack(functions.gradients(space.motion_cost.scale)))
    num_controls = len(functions.lattice)
    volume = np.repeat(mesh.volumes[mesh.open_cells] / num_controls, num_controls)
    value_at_goal = functions.interpolation(home, mesh.local(home, goal[None])).toarray()[0]
    costs = cell_costs(space, cost_map, mesh)
    return SlopeProgram(functions, gradient, costs, volume, functions.integrals(), value_at_goal)


def losses(program: SlopeProgram, iterate: Iterate) -> Float[np.ndarray, "open"]:
    """What the flow through each open cell costs at the most, less what it gains in value; in a mixed cell all of it.

    Their sum is about how far the integral of the function is below that of the cost-to-go.
    """
    mesh, num_controls = program.space.mesh, len(program.space.lattice)
    gradient = program.mean_gradients(iterate.values)
    flow = iterate.flow.reshape(program.dim, -1, num_controls).mean(axis=2).T
    cost = (program.doubt * program.sets.costs(iterate.flow)).reshape(-1, num_controls).mean(axis=1)
    gain = np.where(mesh.state[mesh.open_cells] == CellState.MIXED, 0.0, np.sum(flow * gradient, axis=1))
    return mesh.volumes[mesh.open_cells] * np.maximum(cost - gain, 0.0)


def loss_at_goal(program: SlopeProgram, iterate: Iterate, goal: Float[np.ndarray, "dim"]) -> float:
    """The loss in the goal's cell if what arrives at its nodes went straight to the goal.

    Where the goal is within a cell, what arrives on one side may leave on the other: such a flow gains as much as it
    costs, though values behind the goal are as far below 0 as they should be above.
    """
    space, mesh = program.space, program.space.mesh
    home = int(mesh.locate(goal[None])[0])
    change = mesh.domain.difference(mesh.domain.width * goal, mesh.domain.width * space.points)
    values = iterate.values - program.at_goal(iterate.values)
    excess = program.costs.of_motions(change, np.full(len(change), home)) - values
    within = np.repeat(mesh.open_cells == home, len(space.lattice))
    climbed = np.sum((iterate.flow * program.gradients(excess))[:, within], axis=0)
    return float(program.volume[within] @ climbed + program.weight.sum() * program.at_goal(excess))


def _prolonged(coarse: SlopeProgram, iterate: Iterate, fine: SlopeProgram) -> Iterate:
    """The same function and flow on a finer mesh."""
    space, mesh = fine.space, coarse.space.mesh
    size = len(space.lattice)
    inset = 0.5 + (space.lattice[space.node_of % size] - 0.5) * (1 - _INSET)
    x = space.mesh.fractions(space.node_of // size, inset)
    cell = mesh.locate(x)
    values = coarse.space.interpolation(cell, mesh.local(cell, x)) @ iterate.values
    parent = mesh.locate(space.mesh.fractions(space.mesh.open_cells, np.full(mesh.dim, 0.5)))
    place = np.full(len(mesh.state), 0)
    place[mesh.open_cells] = np.arange(len(mesh.open_cells))
    flow = iterate.flow.reshape(coarse.dim, -1, size).mean(axis=2)[:, place[parent]]
    return Iterate(values, np.repeat(flow, size, axis=1))
