"""Straight from a configuration space to a PLR, without an oracle and without a roadmap."""

import math
import warnings

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from plr_jax._arrays import as_bool, as_booleans, as_finite, as_finite_point, require_integer, shortened
from plr_jax._types import ArrayLike
from plr_jax.eikonal.estimate import MOST_AXES, swept_estimate
from plr_jax.eikonal.field import CostToGoField, MeshEstimate
from plr_jax.eikonal.leaves import plr_of_bytes, plr_on_mesh
from plr_jax.eikonal.lower import SlopeSolver
from plr_jax.eikonal.mesh import coarse_mesh
from plr_jax.eikonal.paths import guided_paths, shortest_paths
from plr_jax.eikonal.sampled_space import SampledSpace
from plr_jax.plr._plr import PLR
from plr_jax.plr.growth.limits import ConstructionInterrupted, check_memory
from plr_jax.spaces import ConfigurationSpace, CostMap, FreeTest, require_space

_MAX_CELLS = {1: 2_000, 2: 10_000}
_MAX_CELLS_BEYOND = 50_000
_LEAVES_PER_BYTE = 2  # more than any file has
_BOXES_PER_CELL = 4  # of the grid of the estimate
_BYTES_A_CELL = {True: 4_000, False: 400}  # of memory at the least, if certified or not
_LEAST_COST = 1e-30  # below, 32 bits hold no distances
_BESIDE = 1e-6  # of the domain, by which a goal that is free to a tolerance may be outside


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

    Cells are halved where that matters, and proven free, blocked, or neither. The largest function that is 0 at the
    goal, continuous across every face that is not proven blocked, and nowhere steeper than a step costs, is a lower
    bound of the cost of every path, in any dimension. Paths through cells that are proven free bound it from above.
    The PLR itself is an estimate between the two. Where costs vary, that is a semi-Lagrangian one of second order, on
    a grid of four times as many nodes; else mixed cells count as free or blocked for it, by one motion each.
    ``plr.bounds`` has both bounds: as what is proven of a PLR always, they hold for every point from which the goal
    can be reached.

    Args:
        space: What is free, and what motions cost. Of one that only tests configurations (:class:`FreeTest`), cells
            count as free or blocked if all samples in them are: the PLR is an estimate, of which nothing is proven.
        goal: The goal, ``(dim,)``, free.
        cost_map: A factor of the cost of motions that differs from place to place, such as the reciprocal of a
            speed, whose bounds over boxes are known; None: 1 everywhere.
        max_leaves: Most cells. None: 2,000 on a line, 10,000 in the plane, 50,000 in more dimensions.
        max_bytes: Most bytes of the file. If a leaf a cell takes more, the leaves are others than the cells: as few
            as that allows, grown from what was found on the cells. The bounds of a leaf are then the worst ones of
            all cells that it meets, and where there is one that has no upper bound, it has none. None: a leaf a cell,
            in as many bytes as that takes.
        tolerance: The mean distance of the lower bound to the truth, as estimated, at which no more cells are halved,
            in units of cost, at least 0; None: 0, so that all of ``max_leaves`` are used.
        certified: Whether bounds are proven. If not, of up to three axes, the PLR is an estimate alone, found by
            sweeps over a grid: once these are compiled, which takes seconds, of cells by the ten thousand within
            tenths of a second in the plane, and within seconds in space. It may lie outside of what would be proven.
            Its cells are about equally wide along every axis, halved alike: as many as the last halving leaves below
            ``max_leaves``. There is no ``tolerance``.
        seed: Seed of samples.

    Returns:
        The PLR, of continuous leaves. ``plr(x)`` is finite wherever a cell is connected to the goal's by faces that
        are not proven blocked. Upper bounds are ``inf`` where no path was found. If interrupted (Ctrl-C) once there
        is a first solution, that of the cells there are, with a ``ConstructionInterrupted`` warning. If the lower
        bound, which is proven all the same, was still rising when iterations ran out, a ``UserWarning`` says so.

    Raises:
        ValueError: If the space is none, the goal is not a free configuration of it, a limit is out of its range or
            too small (for one leaf, for four cells along each periodic axis, for cells at most 200,000 times as long
            as wide, for samples in all open cells or, without proof, for a free motion from a corner of a cell to the
            goal), ``certified=False`` comes with more than three axes or a tolerance, bounds of the cost map are not
            positive and finite, or it is directional and the space's cost no length.

    References:
        Section VII of the paper asks for it. The dual of the program is Beckmann's flow, 1952; see ``program.py``.
    """
    require_space(space)
    if cost_map is not None and not isinstance(cost_map, CostMap):
        raise ValueError(
            f"cost_map must be a CostMap, such as LipschitzCost or RasterCost, got {shortened(cost_map)}."
        )
    require_integer("seed", seed, 0)
    most = _MAX_CELLS.get(space.domain.dim, _MAX_CELLS_BEYOND)
    if max_leaves is not None:
        require_integer("max_leaves", max_leaves, 1)
        most = int(max_leaves)
    if max_bytes is not None:
        require_integer("max_bytes", max_bytes, 1)
    if not as_bool("certified", certified) and (space.domain.dim > MOST_AXES or tolerance is not None):
        got = f"{space.domain.dim} axes" + ("" if tolerance is None else f" and tolerance={tolerance}")
        raise ValueError(
            f"certified=False is for up to {MOST_AXES} axes, without a tolerance, got {got}: leave it out."
        )
    tolerance = 0.0 if tolerance is None else as_finite("tolerance", tolerance)
    check_memory(2.0 * most, _BYTES_A_CELL[certified] / 2)
    at = _fraction(space, goal)
    is_proven = isinstance(space, ConfigurationSpace)
    cells = space if isinstance(space, ConfigurationSpace) else SampledSpace(space, int(seed))
    if certified:
        field = _field(cells, cost_map, at, most, tolerance)
        estimate, proven = field.estimate, field if is_proven else None
    else:
        estimate, proven = _swept(cells, cost_map, at, most), None
    largest = float(estimate.corner_values.max())
    if 0 < largest < _LEAST_COST:
        raise ValueError(
            f"Costs must come to {_LEAST_COST:g} somewhere, got {largest:g} at the most: 32 bits hold none so small. "
            "Give the domain, or the costs, in smaller units."
        )
    most_bytes = math.inf if max_bytes is None else float(max_bytes)
    if len(estimate.mesh.state) <= _LEAVES_PER_BYTE * most_bytes and (
        plr := plr_on_mesh(estimate, proven, most_bytes)
    ):
        return plr
    return plr_of_bytes(estimate, int(most_bytes), int(seed), proven)


def _fraction(space: FreeTest, goal: ArrayLike) -> Float[np.ndarray, "dim"]:
    """The goal as a fraction of the domain; ``ValueError`` if one cannot be there."""
    domain = space.domain
    goal = as_finite_point("goal", goal)
    if goal.shape != (domain.dim,):
        raise ValueError(f"goal must have {domain.dim} coordinates, as the space has axes, got {goal.size}.")
    at = (domain.wrapped(goal[None])[0] - domain.lo) / domain.width
    if not (np.abs(at - 0.5) <= 0.5 + _BESIDE).all() or not as_booleans("is_free", space.is_free(goal[None]), 1)[0]:
        raise ValueError(f"goal must be a free configuration of the space, {goal.tolist()} is not.")
    return np.clip(at, 0.0, 1.0)


def _swept(
    space: ConfigurationSpace, cost_map: CostMap | None, goal: Float[np.ndarray, "dim"], most: int
) -> MeshEstimate:
    """The estimate alone, on cells that are about equally wide along every axis."""
    mesh = coarse_mesh(space, space.motion_cost.scale, most, most)
    costs = swept_estimate(space, cost_map, goal, _BOXES_PER_CELL * most)(mesh.nodes)
    if not np.isfinite(costs).any():
        raise ValueError(
            f"max_leaves must be so many that a corner of a cell has a free motion to the goal, got {most}: allow "
            "more, or leave out certified=False."
        )
    is_reached = np.isfinite(costs)[mesh.corners].any(axis=1)
    mesh = mesh.without(np.logical_not(is_reached))
    return MeshEstimate.of_nodes(mesh, costs)


def _field(
    space: ConfigurationSpace, cost_map: CostMap | None, goal: Float[np.ndarray, "dim"], most: int, tolerance: float
) -> CostToGoField:
    solver = SlopeSolver(space, cost_map, goal, most, tolerance)
    with tqdm(desc="solve_eikonal", total=most, unit=" cells", delay=3, leave=False, disable=None) as progress:
        try:
            solver.refine(progress)
        except KeyboardInterrupt:
            if not solver.has_solution:
                raise
            message = f"Interrupted at {len(solver.mesh.state):,} of {most:,} cells: the PLR is of these."
            warnings.warn(message, ConstructionInterrupted, stacklevel=3)
    program, mesh = solver.program, solver.mesh
    if cost_map is None or mesh.dim > MOST_AXES:
        paths = shortest_paths(mesh, program.costs, goal, space)
        likely = shortest_paths(solver.likely_mesh(), program.costs.midway, goal, space).cost[:-1]
        if mesh.dim == MOST_AXES:  # where cells are few along an axis, and each estimate is mostly too high
            likely = np.fmin(likely, swept_estimate(space, None, goal, _BOXES_PER_CELL * most)(mesh.nodes))
    else:
        guide = swept_estimate(space, cost_map, goal, _BOXES_PER_CELL * most)
        paths, likely = guided_paths(mesh, program.costs, goal, space, guide), guide(mesh.nodes)
    return CostToGoField(program, solver.values, paths, likely, space)
