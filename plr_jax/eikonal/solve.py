"""Straight from a configuration space to a PLR, without an oracle and without a roadmap.

The lower bound is found on meshes that are refined where the flow of the convex program loses most.
"""

import math
import warnings
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Int8
from tqdm import tqdm

from plr_jax._arrays import as_bool, as_booleans, as_finite, as_finite_point, require_integer, shortened
from plr_jax._types import ArrayLike
from plr_jax.eikonal.bounds import CostToGoField, plr_of_bytes, plr_on_mesh
from plr_jax.eikonal.estimate import MOST_AXES, grid_estimate
from plr_jax.eikonal.mesh import Mesh, coarse_mesh
from plr_jax.eikonal.paths import graph_costs, shortest_paths
from plr_jax.eikonal.program import Iterate, SlopeProgram
from plr_jax.plr._construct import BuildOptions, construct
from plr_jax.plr._plr import PLR
from plr_jax.plr.faces import neighbor_of_largest_contact
from plr_jax.plr.frame import max_axis_depth
from plr_jax.plr.growth import ConstructionInterrupted, check_memory, largest_error
from plr_jax.plr.sampling import CellFit, sample_pattern
from plr_jax.spaces import CellState, CheckedSpace, ConfigurationSpace, CostMap, FreeTest, require_space

# Most cells by default, by the number of axes, and beyond; and leaves of an estimate alone.
_MAX_CELLS, _MAX_CELLS_BEYOND = {1: 2_000, 2: 10_000}, 50_000
_MAX_LEAVES = 2_000
# More leaves a byte than any file has.
_LEAVES_PER_BYTE = 2
# Bytes of memory a cell at the least.
_BYTES_A_CELL = 4_000
# Splits along an axis of leaves that are cut off from the goal, but border on leaves that are not.
_CUT_OFF_SPLITS = 6
# Below this cost, 32 bits hold no distances.
_LEAST_COST = 1e-30
# Share of the domain by which a goal that is free to a tolerance may be outside.
_BESIDE = 1e-6


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
    """Build a PLR of the cost-to-go of a configuration space: no oracle, no roadmap.

    With ``certified=False`` the PLR is an estimate, and takes about a second: scikit-fmm marches over a grid of
    160,000 nodes in the plane or up to a million in space, and continuous leaves compress the result. The mean error
    is that of the grid, mostly 0.01 to 0.5 %.

    By default bounds are proven as well, which takes longer. Cells are halved where that matters, and proven free,
    blocked, or neither. The largest function that is 0 at the goal, continuous across every face that is not proven
    blocked, and nowhere steeper than a step costs, is a lower bound of the cost of every path, in any dimension. The
    straight line to the goal is another one. Paths through cells that are proven free bound the cost from above;
    among voxels, paths from voxel to voxel do. The PLR is an estimate between the bounds. ``plr.bounds`` has both
    bounds, which hold for every point from which the goal can be reached.

    Args:
        space: What is free, and what motions cost. If the space only tests configurations (:class:`FreeTest`), cells
            count as free or blocked if all samples in them are. Then the PLR is an estimate, and nothing is proven.
        goal: The goal, ``(dim,)``, free.
        cost_map: A factor of the cost of motions that differs from place to place, such as the reciprocal of a
            speed, whose bounds over boxes are known; None: 1 everywhere.
        max_leaves: Most leaves, at least 1. None: if nothing is proven, 2,000 or as many as ``max_bytes`` allows;
            else 2,000 on a line, 10,000 in the plane, 50,000 in more dimensions. Certified PLRs have a leaf a cell.
        max_bytes: Most bytes of the file. If a leaf for each cell takes more, a certified PLR has fewer leaves than
            cells, grown from the estimate on the cells. The bounds of a leaf are then the worst ones of all cells
            that it meets: ``inf`` if one of these has no upper bound. None: no limit.
        tolerance: The mean distance of the lower bound to the truth, as estimated, at which no more cells are halved,
            in units of cost, at least 0. None: 0, so that all of ``max_leaves`` are used. For certified PLRs only.
        certified: Whether bounds are proven. False is for up to three axes.
        seed: Seed of samples.

    Returns:
        The PLR, of continuous leaves, or of planes if nothing is proven and motions of several blocks of axes add up
        (as those of a body that turns). ``plr(x)`` is finite wherever some path leads to the goal. The PLR does not
        test collision: points in obstacles, and points cut off from the goal within a 64th of the domain from points
        that reach it, may have finite answers too. Upper bounds are ``inf`` where no path was found.

    Warns:
        ConstructionInterrupted: If interrupted (Ctrl-C) once there is a first solution, of which the PLR then is.
        UserWarning: If the lower bound, which is proven all the same, was still rising when iterations ran out. If
            the estimate was more than a tenth outside of its proven bounds; there the nearer bound replaces it.

    Raises:
        ValueError: If the space is none, the goal is not a free configuration of it, or a limit is out of its range.
            If a limit is too small for one leaf, for four cells along each periodic axis, for cells at most 200,000
            times as long as wide, or for samples in all open cells. If obstacles are so close to the goal that no
            node of the grid sees it, ``certified=False`` comes with more than three axes or a tolerance, bounds of
            the cost map are not positive and finite, or it is directional and the space's cost no length.

    References:
        Section VII of the paper asks for it. The dual of the program is Beckmann's flow, 1952; see ``program.py``.
    """
    require_space(space)
    if cost_map is not None and not isinstance(cost_map, CostMap):
        raise ValueError(
            f"cost_map must be a CostMap, such as LipschitzCost or RasterCost, got {shortened(cost_map)}."
        )
    require_integer("seed", seed, 0)
    for name, limit in (("max_leaves", max_leaves), ("max_bytes", max_bytes)):
        if limit is not None:
            require_integer(name, limit, 1)
    if not as_bool("certified", certified) and (space.domain.dim > MOST_AXES or tolerance is not None):
        got = f"{space.domain.dim} axes" + ("" if tolerance is None else f" and tolerance={tolerance}")
        raise ValueError(
            f"certified=False is for up to {MOST_AXES} axes, without a tolerance, got {got}: leave it out."
        )
    tolerance = 0.0 if tolerance is None else as_finite("tolerance", tolerance)
    domain, goal = space.domain, as_finite_point("goal", goal)
    if goal.shape != (domain.dim,):
        raise ValueError(f"goal must have {domain.dim} coordinates, as the space has axes, got {goal.size}.")
    at = (domain.wrapped(goal[None])[0] - domain.lo) / domain.width
    if not (np.abs(at - 0.5) <= 0.5 + _BESIDE).all() or not as_booleans("is_free", space.is_free(goal[None]), 1)[0]:
        raise ValueError(f"goal must be a free configuration of the space, {goal.tolist()} is not.")
    at = np.clip(at, 0.0, 1.0)
    cells = space if isinstance(space, ConfigurationSpace) else SampledSpace(space, int(seed))
    if not certified:
        leaves = _MAX_LEAVES if max_leaves is None and max_bytes is None else max_leaves
        guide = grid_estimate(cells, cost_map, domain.at(at), leaves or 0)
        if guide.largest < 0:
            nodes = " x ".join(map(str, guide.cost.shape))
            raise ValueError(
                f"The goal must be seen from a node of the grid of {nodes} nodes, {goal.tolist()} is not: it is "
                "too close to obstacles. Move it, or leave out certified=False."
            )
        _require_costs(guide.largest)
        limits: dict[str, Any] = {"max_leaves": leaves, "max_bytes": max_bytes, "seed": seed}
        # Free space of bodies that turn is thin. Continuous leaves reach through walls there, and planes do not.
        if len(space.motion_cost.blocks) > 1:
            return construct(guide, domain, leaf="plane", **limits)
        options = BuildOptions(should_split=partial(_error_or_cut_off, space))
        return construct(guide, domain, leaf="continuous", options=options, **limits)
    most = _MAX_CELLS.get(domain.dim, _MAX_CELLS_BEYOND) if max_leaves is None else int(max_leaves)
    check_memory(2.0 * most, _BYTES_A_CELL / 2)
    field = _field(cells, cost_map, at, most, tolerance)
    estimate, proven = field.estimate, field if isinstance(space, ConfigurationSpace) else None
    _require_costs(float(estimate.corner_values.max()))
    most_bytes = math.inf if max_bytes is None else float(max_bytes)
    if len(estimate.mesh.state) <= _LEAVES_PER_BYTE * most_bytes and (
        plr := plr_on_mesh(estimate, proven, most_bytes)
    ):
        return plr
    return plr_of_bytes(estimate, int(most_bytes), int(seed), proven)


def _error_or_cut_off(space: FreeTest, fit: CellFit) -> Float[np.ndarray, "cells"]:
    """Return the largest error of each leaf, and more than that for large leaves that are cut off from the goal.

    A leaf from which no path leads to the goal borrows the function of a leaf beside it, for points on the face that
    rounding places in it. So a leaf that holds free points, but none inside that reaches the goal, has to be small.
    """
    error = largest_error(fit)
    inside = (np.abs(fit.pattern.u) < 1).all(axis=1)  # beyond a face may be another side of a wall
    is_large = (fit.cells.depth < _CUT_OFF_SPLITS).any(axis=1)
    lost = np.flatnonzero(is_large & ~fit.reachable[:, inside].any(axis=1))
    if not len(lost):
        return error
    lenders = np.flatnonzero(fit.reachable.any(axis=1))
    lost = lost[neighbor_of_largest_contact(fit.cells, lost, lenders, space.domain.periodic) >= 0]
    q = fit.cells[lost].points(fit.pattern.u[inside], space.domain)
    is_free = as_booleans("is_free", space.is_free(q.reshape(-1, q.shape[2])), q.shape[0] * q.shape[1])
    cut_off = lost[is_free.reshape(q.shape[:2]).any(axis=1)]
    error[cut_off] = np.ldexp(error.max(), fit.cells.depth[cut_off].sum(axis=1))
    return error


def _require_costs(largest: float) -> None:
    """Raise ``ValueError`` if the largest cost-to-go is positive and below what 32 bits hold."""
    if 0 < largest < _LEAST_COST:
        raise ValueError(
            f"Costs must come to {_LEAST_COST:g} somewhere, got {largest:g} at the most: 32 bits hold none so small. "
            "Give the domain, or the costs, in smaller units."
        )


def _field(
    space: ConfigurationSpace, cost_map: CostMap | None, goal: Float[np.ndarray, "dim"], most: int, tolerance: float
) -> CostToGoField:
    """Find bounds of the cost-to-go and an estimate between them, on meshes of at most so many cells."""
    solver = SlopeSolver(space, cost_map, goal, most, tolerance)
    with tqdm(desc="solve_eikonal", total=most, unit=" cells", delay=3, leave=False, disable=None) as progress:
        try:
            solver.refine(progress)
        except KeyboardInterrupt:
            if solver.iterate is None:
                raise
            message = f"Interrupted at {len(solver.mesh.state):,} of {most:,} cells: the PLR is of these."
            warnings.warn(message, ConstructionInterrupted, stacklevel=3)
    program, mesh, domain = solver.program, solver.mesh, space.domain
    guide = grid_estimate(space, cost_map, domain.at(goal)) if mesh.dim <= MOST_AXES else None
    paths = shortest_paths(mesh, program.costs, goal, space)
    if guide is None:
        likely = shortest_paths(solver.likely_mesh(), program.costs.midway, goal, space).cost[:-1]
    else:
        likely = guide(domain.at(mesh.nodes))
    return CostToGoField(program, solver.values, paths, likely, space, guide)


# The first mesh has this share of the cells, but at least two: in one alone, flows to a goal in its middle cancel.
_COARSEST, _FEWEST = 1 / 16, 2
# Share of the loss that is in the cells that are refined.
_SHARE = 0.8
# If mixed cells have more than this share of the loss, flows leak through walls: then some cells are kept for later,
# except for the last few.
_LEAKING, _LAST = 0.1, 0.01
# Least and most by which a refinement multiplies the number of cells.
_GROWTH = 1.3, 2.0
# Iterations on the first mesh, on those after it, and at the end.
_FIRST, _NEXT, _MOST = 100, 20, 1000
# Iterations on the first mesh before which the penalties follow the flow.
_FACTORED_FIRST = (20, 40, 80)
# A loss counts at most this much more for the way around that it hides.
_DETOUR = 16
# Splits along an axis, where a query's tables resolve as many.
_DEEPEST = 13
# Share of a cell by which points keep off its faces.
_INSET = 1e-9
Point = Float[np.ndarray, "dim"]


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
        iterate: Its solution; None before there is one.
    """

    def __init__(
        self, space: ConfigurationSpace, cost_map: CostMap | None, goal: Point, max_cells: int, tolerance: float
    ):
        self.space, self.cost_map, self.goal = space, cost_map, goal
        self.max_cells, self.tolerance = max_cells, tolerance
        mesh = coarse_mesh(space, max(int(_COARSEST * max_cells), _FEWEST), max_cells)
        self.program = SlopeProgram.on(mesh, space, cost_map, goal)
        self.iterate: Iterate | None = None
        self._through = np.full(len(mesh.state), CellState.MIXED, np.int8)  # what motions through mixed cells are

    @property
    def mesh(self) -> Mesh:
        """The finest mesh so far."""
        return self.program.space.mesh

    @property
    def values(self) -> Float[np.ndarray, "dofs"]:
        """The solution, 0 at the goal."""
        assert self.iterate is not None
        return self.iterate.values - self.program.goal @ self.iterate.values

    def refine(self, progress: tqdm) -> None:
        """Solve, refine where the flow loses most, and solve again, to the limit; then once more, thoroughly."""
        self.iterate = self.program.solve(_FIRST, None, _FACTORED_FIRST)
        progress.update(len(self.mesh.state))
        parts = 2**self.mesh.dim - 1  # that one cell becomes more, at the most
        while True:
            which, room = self._marked(parts, self.iterate)
            if not len(which) or room < parts:
                break
            coarse = self.mesh
            finer = SlopeProgram.on(coarse.refined(which, self.space, room), self.space, self.cost_map, self.goal)
            fine = finer.space.mesh
            # The same function and flow on the finer mesh.
            space, size = finer.space, len(finer.space.lattice)
            inset = 0.5 + (space.lattice[space.node_of % size] - 0.5) * (1 - _INSET)
            x = fine.fractions(space.node_of // size, inset)
            cell = coarse.locate(x)
            values = self.program.space.interpolation(cell, coarse.local(cell, x)) @ self.iterate.values
            parent = coarse.locate(fine.fractions(fine.open_cells, np.full(fine.dim, 0.5)))
            place = np.zeros(len(coarse.state), np.int64)
            place[coarse.open_cells] = np.arange(len(coarse.open_cells))
            flow = self.iterate.flow.reshape(fine.dim, -1, size).mean(axis=2)[:, place[parent]]
            iterate = Iterate(values, np.repeat(flow, size, axis=1))
            progress.update(len(fine.state) - len(coarse.state))
            if len(fine.state) + parts <= self.max_cells:
                iterate = finer.solve(_NEXT, iterate)
            # What motions through cells are, for cells that were there before; MIXED for the others.
            before = coarse.locate(fine.fractions(np.arange(len(fine.state)), np.full(fine.dim, 0.5)))
            is_same = (coarse.cells.depth[before] == fine.cells.depth).all(axis=1)
            self._through = np.where(is_same, self._through[before], np.int8(CellState.MIXED))
            self.program, self.iterate = finer, iterate
        self.iterate, has_converged = self.program.solve_thoroughly(self.iterate, _MOST)
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
        slope[mesh.open_cells] = self.program.mean_gradients(self.values) / self.space.motion_cost.scale
        lo, hi = (corner[new] for corner in mesh.boxes)
        share = np.abs(slope[new] / (hi - lo)).max(axis=1, keepdims=True)
        half = np.divide(slope[new], 2 * share, out=np.zeros_like(lo), where=share > 0)
        is_free = self.space.are_free((lo + hi) / 2 - half, (lo + hi) / 2 + half)
        self._through[new] = np.where(is_free, CellState.FREE, CellState.BLOCKED)
        return mesh.with_state(np.where(mesh.state == CellState.MIXED, self._through, mesh.state))

    def _marked(self, parts: int, iterate: Iterate) -> tuple[Int[np.ndarray, "some"], int]:
        """The cells to be refined, first those that lose most, and how many cells may come of it."""
        mesh, num_cells, costs = self.mesh, len(self.mesh.state), self.program.costs.midway
        loss, at_goal = self.program.losses(iterate), self.program.loss_at_goal(iterate)
        # 1. In mixed cells across which costs differ more than a motion through them would cost, a thin wall is in
        #    the way, and what a flow through it loses is the way around: such losses count more.
        at_corners = graph_costs(self.likely_mesh(), costs, self.goal, self.space)[mesh.corners[mesh.open_cells]]
        is_reached = np.isfinite(at_corners)
        highest, least = np.max(at_corners, axis=1, where=is_reached, initial=-np.inf), at_corners.min(axis=1)
        across = costs.of_motions(mesh.widths[mesh.open_cells], mesh.open_cells)
        share = np.divide(highest - least, across, out=np.ones(len(loss)), where=np.isfinite(least))
        is_mixed = mesh.state[mesh.open_cells] == CellState.MIXED
        loss = np.where(is_mixed, np.clip(share, 1.0, _DETOUR), 1.0) * loss
        if max(loss.sum(), at_goal) <= self.tolerance * self.program.weight.sum():
            return np.zeros(0, np.int64), 0
        # 2. The goal's cell comes first if it hides a loss, then cells by what they lose.
        is_first = (mesh.open_cells == mesh.locate(self.goal[None])) & (at_goal > loss)
        order = np.argsort(-np.where(is_first, np.inf, loss), kind="stable")[: np.count_nonzero(loss + is_first)]
        # 3. Refine most of the loss, but neither too few nor too many cells.
        enough = parts * (np.searchsorted(np.cumsum(loss[order]), _SHARE * loss.sum()) + 1)
        fewest, most = (max(int((growth - 1) * num_cells), parts) for growth in _GROWTH)
        most_splits = min(_DEEPEST, max_axis_depth(mesh.dim, None, 1, False))
        deepest = mesh.cells.depth[mesh.open_cells[order]].max(axis=1) >= most_splits
        left = self.max_cells - num_cells
        if loss[is_mixed].sum() > _LEAKING * loss.sum() and left > _LAST * self.max_cells:
            left = int(_SHARE * left)  # where walls are open still, the next flow finds what is open then
        return mesh.open_cells[order[~deepest]], int(min(max(enough, fewest), most, left))


# Samples of a box, beside the corners and the center, and of a motion.
_NUM_SAMPLES, _NUM_OF_MOTION = 8, 33


@dataclass(frozen=True, eq=False)
class SampledSpace(CheckedSpace):
    """A space that only tests configurations: boxes are classified by samples, and nothing is proven."""

    seed: int

    @cached_property
    def _samples(self) -> Float[np.ndarray, "k dim"]:
        return (1 + sample_pattern(self.domain.dim, _NUM_SAMPLES, 0.0, self.seed).u) / 2

    def classify(self, lo: Float[np.ndarray, "n dof"], hi: Float[np.ndarray, "n dof"]) -> Int8[np.ndarray, "n"]:
        """Free or blocked if all samples are, else mixed."""
        x = lo[:, None] + (hi - lo)[:, None] * self._samples
        free = self.is_free(x.reshape(-1, x.shape[2])).reshape(x.shape[:2])
        state = np.where(free.any(axis=1), CellState.MIXED, CellState.BLOCKED)
        return np.where(free.all(axis=1), CellState.FREE, state).astype(np.int8)

    def are_free(self, q0: ArrayLike, q1: ArrayLike) -> Bool[np.ndarray, "n"]:
        """Whether all samples of straight motions are."""
        q0, q1 = np.asarray(q0, np.float64), np.asarray(q1, np.float64)
        x = q0[:, None] + self.domain.difference(q1, q0)[:, None] * np.linspace(0, 1, _NUM_OF_MOTION)[:, None]
        free = self.is_free(x.reshape(-1, self.domain.dim)).reshape(x.shape[:2])
        return np.asarray(free.all(axis=1))
