"""Build a PLR of the cost-to-go from a configuration space, without an oracle or a roadmap.

If bounds are asked for, :class:`SlopeSolver` refines a mesh where the lower bound is loose, and paths on the finest
mesh give the upper bound. Otherwise, a PLR is fitted to an estimate on a grid.
"""

import math
import warnings
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int, Int8
from threadpoolctl import threadpool_limits

from plr_jax._arrays import as_bool, as_booleans, as_finite, as_numbers, require_integer, require_type, row_products
from plr_jax._progress import Progress
from plr_jax._types import ArrayLike, Fractions, Reach
from plr_jax.eikonal.bounds import CostToGoField
from plr_jax.eikonal.certified import plr_of_bytes, plr_on_mesh, straight_bound
from plr_jax.eikonal.estimate import MOST_AXES, grid_estimate
from plr_jax.eikonal.goals import Goals, Points, WhichGoal
from plr_jax.eikonal.mesh import Mesh, coarse_mesh
from plr_jax.eikonal.paths import graph_costs, shortest_paths
from plr_jax.eikonal.program import Iterate, SlopeProgram
from plr_jax.plr._construct import BuildOptions, construct, warn_if_cut_off
from plr_jax.plr._plr import PLR, plr_of_leaves
from plr_jax.plr.growth import BudgetTooSmall, ConstructionInterrupted, check_memory, largest_error
from plr_jax.plr.sampling import CellFit, sample_pattern
from plr_jax.plr.sizes import max_axis_depth
from plr_jax.spaces import CellState, ConfigurationSpace, FreeTest
from plr_jax.spaces._costs import CostMap, cost_bounds
from plr_jax.spaces._space import CheckedFreeTest, Separable, require_space

_MAX_CELLS = {1: 2_000, 2: 10_000}  # default of max_leaves with bounds, by the number of axes
_MAX_CELLS_BEYOND = 50_000  # the same for more axes
_MAX_LEAVES = {1: 2_000, 2: 2_000, 3: 4_000}  # default of max_leaves without bounds, by the number of axes
_LEAVES_PER_BYTE = 2  # no file has more leaves per byte
_BYTES_A_CELL = 4_000  # least memory that construction takes for each cell
_LEAF_SAMPLES = 64  # samples in a leaf of an estimate, in which the grid has few nodes
_LEAST_COST = 1e-30  # least cost that 32 bits resolve
_BESIDE = 1e-6  # share of the domain's width by which a goal may lie outside: a space may count such goals as free


@threadpool_limits.wrap(limits=1, user_api="blas")  # vectors are short: more threads would wait for one another
def solve_eikonal(
    space: ConfigurationSpace | FreeTest,
    goal: ArrayLike,
    *,
    cost_map: CostMap | None = None,
    max_leaves: int | None = None,
    max_bytes: int | None = None,
    tolerance: int | float | None = None,
    certified: bool = True,
    seed: int = 0,
) -> PLR:
    """Build a PLR of the cost-to-go of a configuration space, without an oracle or a roadmap.

        cost = plr_jax.RasterCost(values, ((0, 0), (6, 4)))  # cost per length; row 0 has the lowest y, inf is blocked
        plr = plr_jax.solve_eikonal(cost.space(radius=0.3), goal=(5, 1), cost_map=cost, max_bytes=8192)
        plr(points)  # costs-to-go (n,) of points (n, dim); plr.bounds(points) are proven

    In this example, the robot is a ball of radius 0.3, which must keep clear of blocked cells. ``plr(x)`` is an
    estimate between the lower and the upper bound. The bounds hold for every point from which the goal can be
    reached.

    Args:
        space: The configuration space, which says what is free and what motions cost. If it can only test single
            configurations (a :class:`FreeTest`), nothing is proven: a cell then counts as free if all samples in it
            are free, and as blocked if all are blocked.
        goal: The goal, ``(dim,)``, or several goals, ``(k, dim)``, all free. Several goals, such as exits, give the
            cost-to-go to the nearest goal, and ``plr.which(x)`` returns the index of this goal.
        cost_map: A factor of the cost of motions, such as the reciprocal of a speed, with bounds over boxes. None:
            the factor is 1 everywhere.
        max_leaves: Largest number of leaves, and of cells of the mesh on which bounds are computed. More cells give
            tighter bounds, even if ``max_bytes`` stays equal, and take longer. None, if certified: 2,000 on a line,
            10,000 in the plane, 50,000 in more dimensions. None, if not certified: as many as ``max_bytes`` allows;
            without ``max_bytes``, 2,000, or 4,000 in three dimensions.
        max_bytes: Largest size of the file. A certified PLR has one leaf for each cell of a mesh, which is refined
            where bounds are loose. If this takes more than ``max_bytes``, the PLR has fewer, larger leaves instead.
            A larger leaf stores the worst bounds of all cells that it overlaps.
        tolerance: For certified PLRs: refinement stops when the estimated mean of (cost-to-go - lower bound) is at
            most this, in units of cost. None: 0, so that refinement goes on to ``max_leaves`` cells.
        certified: Whether to prove bounds. False is for up to three axes.
        seed: Seed of the random samples.

    Returns:
        The PLR. Its leaves are continuous; they are planes if ``certified=False`` and the cost of motions is a sum of
            norms of several groups of axes, as for a body that turns. ``plr(x)`` is finite at every point with a path
            to the goal. ``plr(x)`` may also be finite in obstacles, and at free points without a path that are within
            1/64 of the domain's width of a point with a path.

    Warns:
        ConstructionInterrupted: If interrupted (Ctrl-C) after the first solution; the PLR then has the latest
            solution.
        UserWarning: If the PLR is finite at free points without a path, farther than 1/64 of the domain's width from
            all points with a path; the message says which share of space this concerns. Or if the lower bound, though
            proven, was still rising at the last iteration. Or if the estimate was outside of its bounds by more than
            a tenth; there the nearer bound replaces the estimate.

    Raises:
        ValueError: If an argument is invalid, a goal is not free, or bounds of the cost map are not positive and
            finite. If ``certified=False`` comes with more than three axes or a tolerance, or no node of the grid sees
            some goal. If a directional cost map comes with a space whose motion costs are not lengths. If
            ``max_leaves`` or ``max_bytes`` is too small. There must be at least one leaf, and four cells along each
            periodic axis. No cell may be more than 200,000 times as long as wide. Each leaf that holds free points
            with a path must have a sample among them.

    How bounds are proven:

    - The lower bound is the largest function that meets three conditions: it is 0 at the goal (at most 0 at several
      goals), it is continuous across every face that is not proven blocked, and along every motion it rises by no
      more than the motion costs. The least cost of straight motions to the goals is a lower bound too, if the file
      holds the goals: at most 64, in at most 40 % of ``max_bytes``.
    - The upper bound is the cost of paths that are proven free: through free cells of the mesh, by straight motions
      near goals and walls, and in voxel spaces also from voxel to voxel. It is ``inf`` where no path was found.

    ``certified=False`` gives only the estimate, which has no upper bound. If the file holds the goals, the estimate
    is at least the least cost of straight motions to the goals, else at least 0, up to rounding to 32 bits.

    - In the plane, the estimate takes about a second, by fast marching over 160,000 nodes. The mean error is mostly
      0.003 to 0.6 % of the mean cost.
    - In voxel spaces, nodes are the centers of voxels, or of groups of voxels if there are too many voxels: more than
      4 million for a point, 16 million for a ball, 2 million if costs depend on the direction. On three synthetic
      volumes of up to 128 x 128 x 128 voxels the mean error was 0.4 to 6 % of the mean cost
      (``experiments/volumes``), because paths over centers of voxels stay half a voxel away from walls. In volumes of
      rock, where a leaf may hold several caves and tunnels, errors are larger.

    References: Section VII of the paper asks for such a PLR. Finding the largest lower bound is dual to Beckmann's
    problem of a cheapest flow, "A continuous model of transportation", 1952.
    """
    # 1. Check the arguments but the goals.
    require_space(space)
    require_type("cost_map", cost_map, CostMap | None, "a CostMap, such as RasterCost")
    require_integer("seed", seed, 0)
    for name, limit in (("max_leaves", max_leaves), ("max_bytes", max_bytes)):
        if limit is not None:
            require_integer(name, limit, 1)
    if not as_bool("certified", certified) and (space.domain.dim > MOST_AXES or tolerance is not None):
        expected = f"up to {MOST_AXES} axes, without a tolerance"
        got = f"{space.domain.dim} axes" + ("" if tolerance is None else f" and tolerance={tolerance}")
        raise ValueError(f"certified=False is for {expected}, got {got}: leave it out.")
    tolerance = 0.0 if tolerance is None else as_finite("tolerance", tolerance)
    # 2. Check the goals: `goals` as rows, `at` as fractions of the domain.
    domain = space.domain
    goal = as_numbers("goal", domain.settled(goal, space.is_free), "numbers, (dim,) or (k, dim)")
    if goal.ndim not in (1, 2) or goal.shape[-1] != domain.dim or not goal.size:
        got = f"{goal.size}" if goal.ndim == 1 else f"shape {goal.shape}"
        raise ValueError(f"goal must have {domain.dim} coordinates, like the space, or be rows of these, got {got}.")
    goals = np.atleast_2d(goal)
    at = (domain.wrapped(goals) - domain.lo) / domain.width
    is_fine = np.asarray((np.abs(at - 0.5) <= 0.5 + _BESIDE).all(axis=1))  # False for NaN
    must = "goal must be a free configuration of the space"
    _require_goals(goal, is_fine, must, f": it does not lie in the domain {domain}")
    is_free = as_booleans("is_free", space.is_free(goals), len(goals))
    _require_goals(goal, is_free, must, ": it is in an obstacle, or too close to one")
    at = np.clip(at, 0.0, 1.0)
    first = np.sort(np.unique(at, axis=0, return_index=True)[1])  # of equal goals, the first counts
    at = at[first]
    cells = space if isinstance(space, ConfigurationSpace) else SampledSpace(space, int(seed))
    if not certified:
        # 3a. Estimate costs on a grid, some node of which must see each goal.
        leaves = _MAX_LEAVES[domain.dim] if max_leaves is None and max_bytes is None else max_leaves
        guide = grid_estimate(cells, cost_map, domain.at(at), leaves or 0)
        is_seen = np.isin(np.arange(len(goals)), first[guide.unseen], invert=True)
        must = f"The goal must be seen from a node of the grid of {' x '.join(map(str, guide.cost.shape))} nodes"
        _require_goals(goal, is_seen, must, ": it is too close to obstacles. Move it, or leave out certified=False")
        _require_costs(float(guide.cost.max(where=np.isfinite(guide.cost), initial=-np.inf)))
        # 4a. Fit a PLR to the estimate. Its file also holds the bound by straight motions, which takes a part of it.
        leaf, options = "continuous", BuildOptions(should_split=_error_by_norm, num_samples=_LEAF_SAMPLES)
        if len(space.motion_cost.blocks) > 1:
            # The free space of a turning body is thin: continuous leaves would reach through its walls.
            leaf, options = "plane", BuildOptions()
        least_rates, _, _ = cost_bounds(space.motion_cost, cost_map, domain.lo[None], domain.hi[None])
        straight = straight_bound(domain, space.motion_cost, float(least_rates[0]), at, max_bytes or math.inf)
        # Before the bound, the file has a float that says that nothing else is proven.
        spare = 0 if straight is None else straight.num_bytes + 4
        budget = None if max_bytes is None else max(int(max_bytes) - spare, 1)
        try:
            plr = construct(guide, domain, leaf=leaf, max_leaves=leaves, max_bytes=budget, seed=seed, options=options)
        except BudgetTooSmall as error:
            assert max_bytes is not None
            raise BudgetTooSmall(max_bytes, error.num_bytes + spare) from None
        plr = plr_of_leaves(replace(plr._contents, straight=straight))
        nearest_goal = guide.which_reached
    else:
        # 3b. Solve for the bounds on a mesh.
        max_cells = _MAX_CELLS.get(domain.dim, _MAX_CELLS_BEYOND) if max_leaves is None else int(max_leaves)
        check_memory(2.0 * max_cells, _BYTES_A_CELL / 2)
        field, nearest_goal = _field(cells, cost_map, at, max_cells, tolerance, goals)
        estimate = field.estimate
        proven = field if isinstance(space, ConfigurationSpace) else None
        _require_costs(float(estimate.corner_values.max()))
        # 4b. The cells are the leaves of the PLR if they fit into the file, else it has fewer leaves.
        most_bytes = math.inf if max_bytes is None else float(max_bytes)
        may_fit = len(estimate.mesh.state) <= _LEAVES_PER_BYTE * most_bytes
        on_mesh = plr_on_mesh(estimate, proven, most_bytes) if may_fit else None
        plr = plr_of_bytes(estimate, int(most_bytes), int(seed), proven) if on_mesh is None else on_mesh
        warn_if_cut_off(field.reach or (field.guide and field.guide.reach(domain)), plr._contents)
    # 5. Without bounds, also a single goal has an index: -1 where the estimate is infinite.
    if certified and goal.ndim == 1:
        return plr
    return plr.with_nearest_goal(partial(_row_of_goal, np.append(first, -1), nearest_goal))


def _row_of_goal(rows: Int[np.ndarray, " k"], which: WhichGoal, x: Points) -> Int[np.ndarray, " n"]:
    # The index of the nearest goal among all given goals, from its index among distinct ones. A function of its own,
    # since lambdas cannot be pickled.
    return rows[which(x)]


def _require_goals(goal: Float[np.ndarray, "..."], is_fine: Bool[np.ndarray, " goals"], must: str, why: str) -> None:
    # Raise a ValueError for the first goal that is not fine.
    if not is_fine.all():
        row = int(is_fine.argmin())
        of_row = f" (row {row})" if goal.ndim > 1 else ""
        raise ValueError(f"{must}, {np.atleast_2d(goal)[row].tolist()}{of_row} is not{why}.")


def _error_by_norm(fit: CellFit) -> Float[np.ndarray, " cells"]:
    """Return, for each leaf, the geometric mean of the largest error and the L2 norm of the error.

    Leaves are split in descending order of this number, so that the mean error of the PLR is small.
    """
    mean_square = row_products(np.square(fit.residual), fit.pattern.weight) / fit.pattern.weight.sum()
    norm = np.sqrt(np.ldexp(mean_square, -fit.cells.depth.sum(axis=1)))  # the volume is 2**-(sum of halvings)
    return np.sqrt(largest_error(fit) * norm)


def _require_costs(largest: float) -> None:
    if 0 < largest < _LEAST_COST:
        got = f"got at most {largest:g}, which 32 bits do not hold. Give the domain, or the costs, in smaller units"
        raise ValueError(f"Costs must come to {_LEAST_COST:g} somewhere, {got}.")


def _reach_of_spaces(reached: ConfigurationSpace, cut_off: ConfigurationSpace) -> Reach:
    # Whether boxes, in fractions of the domain, may hold free configurations of a space.
    def meets(space: ConfigurationSpace, lo: Fractions, hi: Fractions) -> Bool[np.ndarray, " boxes"]:
        return space.classify(*(space.domain.at(np.clip(end, 0.0, 1.0)) for end in (lo, hi))) != CellState.BLOCKED

    is_reached, is_cut_off = partial(meets, reached), partial(meets, cut_off)
    return Reach(is_reached, is_cut_off, is_cut_off)  # all cut-off points count as far from points that reach a goal


def _field(
    space: ConfigurationSpace, cost_map: CostMap | None, goals: Goals, max_cells: int, tolerance: float, given: Points
) -> tuple[CostToGoField, WhichGoal]:
    """Solve for bounds and an estimate of the cost-to-go; also return a function from points to indices of goals.

    The index is that of the goal to which the path from the point leads.

    ``goals`` are fractions of the domain; ``given`` are the same goals in the domain's own coordinates, not rounded.
    """
    # 1. Solve for the lower bound, in the part of the space that paths join to goals.
    reached, cut_off = space.separated(given) if isinstance(space, Separable) else (space, None)
    reach = None if cut_off is None else _reach_of_spaces(reached, cut_off)
    solver = SlopeSolver(reached, cost_map, goals, max_cells, tolerance, reach)
    with Progress("solve_eikonal", "cells", max_cells) as progress:  # at most so many
        try:
            solver.refine(progress)
        except KeyboardInterrupt:
            if solver.iterate is None:
                raise
            message = f"Interrupted at {len(solver.mesh.state):,} of {max_cells:,} cells: the PLR has these cells."
            warnings.warn(message, ConstructionInterrupted, stacklevel=3)
    # 2. The upper bound, by paths through cells that are proven free.
    program, mesh, domain = solver.program, solver.mesh, space.domain
    paths = shortest_paths(mesh, program.costs, goals, space)
    # 3. The estimate at nodes: up to three axes from a grid, beyond by paths through cells that are probably free.
    #    With three axes, the grid is coarse and its estimate a little too high: a path that costs a little less is
    #    taken. A path that costs much less leads through a thin wall.
    guide = None
    if mesh.dim <= MOST_AXES:
        guide = grid_estimate(reached, cost_map, domain.at(goals))
        nodal_estimate, which = guide(domain.at(mesh.nodes)), guide.which
    if mesh.dim >= MOST_AXES:
        likely = shortest_paths(solver.mesh_without_mixed(), program.costs.midway, goals, space)
        cost = likely.cost[: len(mesh.nodes)]
        if guide is None:
            nodal_estimate, which = cost, partial(likely.which, mesh, program.costs)
        else:
            is_near = cost > _LEAST_OF_GRID * nodal_estimate
            nodal_estimate = np.where(is_near, np.minimum(cost, nodal_estimate), nodal_estimate)
    if isinstance(space, SampledSpace) and guide is not None:  # nothing is proven of such a space
        reach = guide.reach(domain)
    return CostToGoField(program, solver.values, paths, nodal_estimate, space, reach, guide), which


_LEAST_OF_GRID = 0.95  # least cost of a path that is believed, as a share of the estimate by the grid
_COARSEST = 1 / 16  # share of all cells in the first mesh
_FEWEST = 2  # least number of its cells: in one cell, flows to a goal in its middle cancel
_REFINED_LOSS = 0.8  # share of the loss (gap) in the cells that are refined together
_LEAKING = 0.1  # if mixed cells have more than this share of the loss, flows leak through walls: save cells for later
_LAST = 0.01  # save no cells if at most this share of all is left
_GROWTH = 1.3, 2.0  # least and largest factor by which a refinement multiplies the number of cells
_FIRST = 100  # iterations on the first mesh
_NEXT = 20  # iterations on each later mesh
_MOST = 1000  # most iterations at the end on the last mesh
_FACTORED_FIRST = (20, 40, 80)  # after these iterations of the first solve, penalties are rescaled to fit the flow
_DETOUR = 16  # largest factor by which a suspected thin wall raises a cell's loss
_DEEPEST = 13  # most halvings of a cell along an axis, if a query's tables resolve as many
_INSET = 1e-9  # distance of points from the faces of a cell, as a share of its width


@dataclass(eq=False)
class SlopeSolver:
    """A solver of the largest lower bound of the cost-to-go, on a mesh that it refines where the bound is loose."""

    space: ConfigurationSpace
    cost_map: CostMap | None
    goals: Goals  # fractions of the domain
    max_cells: int
    tolerance: float
    reach: Reach | None = None  # if the space lacks free configurations that paths do not join to the goals

    def __post_init__(self):
        mesh = coarse_mesh(self.space, max(int(_COARSEST * self.max_cells), _FEWEST), self.max_cells)
        self.program = SlopeProgram.on(mesh, self.space, self.cost_map, self.goals)
        self.iterate: Iterate | None = None
        # The state as which each mixed cell counts: FREE or BLOCKED, or MIXED if it is not known yet.
        self._through = np.full(len(mesh.state), CellState.MIXED, np.int8)

    @property
    def mesh(self) -> Mesh:
        return self.program.space.mesh

    @property
    def values(self) -> Float[np.ndarray, " dofs"]:
        assert self.iterate is not None
        return self.program.below_goals(self.iterate.values)

    def refine(self, progress: Progress) -> None:
        """Solve the convex program on finer and finer meshes, and finally on the finest mesh with many iterations."""
        # 1. Solve on the coarse mesh.
        self.iterate = self.program.solve(_FIRST, None, _FACTORED_FIRST)
        progress.update(len(self.mesh.state))
        most_added = 2**self.mesh.dim - 1  # most cells that a refined cell adds
        while True:
            # 2. Refine the mesh.
            marked, room = self._marked(most_added, self.iterate)
            if not len(marked) or room < most_added:
                break
            coarse = self.mesh
            mesh = self._without_borders(coarse.refined(marked, self.space, room))
            finer = SlopeProgram.on(mesh, self.space, self.cost_map, self.goals)
            fine, space, size = finer.space.mesh, finer.space, len(finer.space.lattice)
            # 3. Interpolate the function at the nodes of the finer mesh. They move into their cells a bit, so that
            #    the coarse cell around this cell is found, not a neighbor of it across a face.
            inset = 0.5 + (space.lattice[space.node_of % size] - 0.5) * (1 - _INSET)
            x = fine.fractions(space.node_of // size, inset)
            cell = coarse.locate(x)
            values = self.program.space.interpolation(cell, coarse.local(cell, x)) @ self.iterate.values
            # 4. Take over the mean flow of the coarse cell (the parent) of each open cell.
            parent = coarse.locate(fine.fractions(np.arange(len(fine.state)), np.full(fine.dim, 0.5)))
            open_index = np.zeros(len(coarse.state), np.int64)  # of each open coarse cell, among these
            open_index[coarse.open_cells] = np.arange(len(coarse.open_cells))
            flow = self.iterate.flow.reshape(fine.dim, -1, size).mean(axis=2)[:, open_index[parent[fine.open_cells]]]
            iterate = Iterate(values, np.repeat(flow, size, axis=1), self.iterate.inflow)
            progress.update(len(fine.state) - len(coarse.state))
            # 5. Improve the iterate, unless this is the last mesh.
            if len(fine.state) + most_added <= self.max_cells:
                iterate = finer.solve(_NEXT, iterate)
            # 6. Cells that are not new keep their answer (free or blocked) to whether paths pass through.
            is_same = (coarse.cells.depth[parent] == fine.cells.depth).all(axis=1)
            self._through = np.where(is_same, self._through[parent], np.int8(CellState.MIXED))
            self.program, self.iterate = finer, iterate
        # 7. Solve thoroughly on the last mesh.
        self.iterate, has_converged = self.program.solve_thoroughly(self.iterate, _MOST)
        if not has_converged:
            problem = f"The solver of lower bounds has not converged in {_MOST:,} iterations"
            effect = "the bounds hold, but lower bounds may be looser than the cells allow"
            warnings.warn(f"{problem}: {effect}. Compare the bounds of another max_leaves.", stacklevel=4)

    def _without_borders(self, mesh: Mesh) -> Mesh:
        # Refine cells that hold both points that reach a goal and points that do not: the answer beyond a wall errs
        # by about the size of the domain. Large cells come first. Half of the cells that are left are for other
        # errors.
        while self.reach is not None:
            border = np.flatnonzero(self.reach.is_border(*mesh.cells.fractions))
            border = border[np.argsort(mesh.cells.depth[border].sum(axis=1), kind="stable")]
            finer = mesh.refined(border, self.space, (self.max_cells - len(mesh.state)) // 2)
            if len(finer.state) == len(mesh.state):
                break
            mesh = finer
        return mesh

    def mesh_without_mixed(self) -> Mesh:
        """Return a copy of the mesh in which each mixed (unproven) cell counts as free or as blocked.

        A mixed cell counts as free if a straight motion through its middle is free, from side to side of the cell
        along the gradient of the lower bound. The answers are stored in ``_through`` for later calls.
        """
        mesh = self.mesh
        new = np.flatnonzero((mesh.state == CellState.MIXED) & (self._through == CellState.MIXED))
        slope = np.zeros((len(mesh.state), mesh.dim))
        slope[mesh.open_cells] = self.program.mean_gradients(self.values) / self.space.motion_cost.scale
        lo, hi = (corner[new] for corner in mesh.boxes)
        steepest = np.abs(slope[new] / (hi - lo)).max(axis=1, keepdims=True)
        half = np.divide(slope[new], 2 * steepest, out=np.zeros_like(lo), where=steepest > 0)
        is_free = self.space.are_free((lo + hi) / 2 - half, (lo + hi) / 2 + half)
        self._through[new] = np.where(is_free, CellState.FREE, CellState.BLOCKED)
        return mesh.with_state(np.where(mesh.state == CellState.MIXED, self._through, mesh.state))

    def _marked(self, most_added: int, iterate: Iterate) -> tuple[Int[np.ndarray, " some"], int]:
        """Return the indices of the cells to refine, most urgent first, and how many cells refinement may add in all.

        Each refined cell adds at most ``most_added`` cells.
        """
        mesh, num_cells, costs = self.mesh, len(self.mesh.state), self.program.costs.midway
        loss, at_goals = self.program.losses(iterate), self.program.losses_at_goals(iterate)  # of open cells
        # 1. If costs differ across a mixed cell by more than a motion through it costs, it holds a thin wall. A flow
        #    through it saves the detour, so its loss counts more.
        nodal_costs = graph_costs(self.mesh_without_mixed(), costs, self.goals, self.space)
        at_corners = nodal_costs[mesh.corners[mesh.open_cells]]
        highest = np.max(at_corners, axis=1, where=np.isfinite(at_corners), initial=-np.inf)
        least = at_corners.min(axis=1)
        across = costs.of_motions(mesh.widths[mesh.open_cells], mesh.open_cells)
        detour = np.divide(highest - least, across, out=np.ones(len(loss)), where=np.isfinite(least))
        is_mixed = mesh.state[mesh.open_cells] == CellState.MIXED
        loss = np.where(is_mixed, np.clip(detour, 1.0, _DETOUR), 1.0) * loss
        if max(loss.sum(), at_goals.sum()) <= self.tolerance * self.program.weight.sum():
            return np.zeros(0, np.int64), 0
        # 2. Cells of goals come first if they hide a loss, then cells by their loss.
        is_first = at_goals > loss
        order = np.argsort(-np.where(is_first, np.inf, loss), kind="stable")[: np.count_nonzero(loss + is_first)]
        # 3. Refine most of the loss, but neither too few nor too many cells; no cells at the largest depth.
        num_needed = most_added * (np.searchsorted(np.cumsum(loss[order]), _REFINED_LOSS * loss.sum()) + 1)
        fewest, most = (max(int((growth - 1) * num_cells), most_added) for growth in _GROWTH)
        most_splits = min(_DEEPEST, max_axis_depth(mesh.dim, None, 1, False))
        is_deepest = mesh.cells.depth[mesh.open_cells[order]].max(axis=1) >= most_splits
        num_left = self.max_cells - num_cells
        if loss[is_mixed].sum() > _LEAKING * loss.sum() and num_left > _LAST * self.max_cells:
            num_left = int(_REFINED_LOSS * num_left)  # the next flow finds the walls that are still open
        return mesh.open_cells[order[~is_deepest]], int(min(max(num_needed, fewest), most, num_left))


_NUM_SAMPLES = 8  # in a box
_NUM_OF_MOTION = 33  # samples of a motion


@dataclass(frozen=True, eq=False)
class SampledSpace(CheckedFreeTest):
    """A configuration space that classifies boxes and motions by testing samples, so nothing is proven."""

    seed: int

    def classify(self, lo: Float[np.ndarray, "n dof"], hi: Float[np.ndarray, "n dof"]) -> Int8[np.ndarray, " n"]:
        u = sample_pattern(self.domain.dim, _NUM_SAMPLES, 0.0, self.seed).u  # from -1 to 1
        x = lo[:, None] + (hi - lo)[:, None] * (1 + u) / 2
        is_free = self.is_free(x.reshape(-1, x.shape[2])).reshape(x.shape[:2])
        state = np.where(is_free.any(axis=1), CellState.MIXED, CellState.BLOCKED)
        return np.where(is_free.all(axis=1), CellState.FREE, state).astype(np.int8)

    def are_free(self, q0: ArrayLike, q1: ArrayLike) -> Bool[np.ndarray, " n"]:
        q0, q1 = np.asarray(q0, np.float64), np.asarray(q1, np.float64)
        x = q0[:, None] + self.domain.difference(q1, q0)[:, None] * np.linspace(0, 1, _NUM_OF_MOTION)[:, None]
        return np.asarray(self.is_free(x.reshape(-1, self.domain.dim)).reshape(x.shape[:2]).all(axis=1))
