"""Straight from a configuration space to a PLR, without an oracle and without a roadmap."""

import warnings

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from plr_jax._arrays import as_finite, as_finite_point, require_integer, shortened
from plr_jax._types import ArrayLike
from plr_jax.eikonal.field import CostToGoField
from plr_jax.eikonal.lower import SlopeSolver
from plr_jax.eikonal.paths import shortest_paths
from plr_jax.eikonal.sampled import SampledSpace
from plr_jax.eikonal.storing import plr_of_bytes, plr_on_mesh
from plr_jax.geometry.box import Box
from plr_jax.plr._plr import PLR
from plr_jax.plr.growth.limits import ConstructionInterrupted
from plr_jax.spaces import ConfigurationSpace, CostMap, FreeTest, MotionCost

_MAX_CELLS = {1: 2_000, 2: 10_000}
_MAX_CELLS_BEYOND = 50_000
_BESIDE = 1e-6  # of the domain, by which a goal that is free to a tolerance may be outside


def solve_eikonal(
    space: ConfigurationSpace | FreeTest,
    goal: ArrayLike,
    *,
    cost_map: CostMap | None = None,
    max_leaves: int | None = None,
    max_bytes: int | None = None,
    tolerance: int | float | None = None,
    seed: int = 0,
) -> PLR:
    """Build a PLR of the cost-to-go of a configuration space: no oracle, no roadmap.

    Cells are halved where that matters, and proven free, blocked, or neither. The largest function that is 0 at the
    goal, continuous across every face that is not proven blocked, and nowhere steeper than a step costs, is a lower
    bound of the cost of every path, in any dimension. Paths through cells that are proven free bound it from above.
    Mixed cells count as free or blocked by one motion each for the PLR itself, an estimate between the two.
    ``plr.bounds`` has both bounds: as what is proven of a PLR always, they hold for every point from which the goal
    can be reached.

    Args:
        space: What is free, and what motions cost. Of one that only tests configurations (:class:`FreeTest`), cells
            count as free or blocked if all samples in them are: the PLR is an estimate, of which nothing is proven.
        goal: The goal, ``(dim,)``, free.
        cost_map: A factor of the cost of motions that differs from place to place, such as the reciprocal of a
            speed, whose bounds over boxes are known; None: 1 everywhere.
        max_leaves: Most cells. None: 2,000 on a line, 10,000 in the plane, 50,000 in more dimensions.
        max_bytes: Most bytes of the file. The leaves are then others than the cells: as few as that allows, grown
            from what was found on the cells. None: a leaf a cell, in as many bytes as that takes.
        tolerance: The mean distance of the lower bound to the truth, as estimated, at which no more cells are halved,
            in units of cost, at least 0; None: 0, so that all of ``max_leaves`` are used.
        seed: Seed of samples.

    Returns:
        The PLR, of continuous leaves. ``plr(x)`` is finite wherever a cell is connected to the goal's by faces that
        are not proven blocked. Upper bounds are ``inf`` where no path was found. If interrupted (Ctrl-C) once there
        is a first solution, that of the cells there are, with a ``ConstructionInterrupted`` warning.

    Raises:
        ValueError: If the space is none, the goal is not a free configuration of it, a limit is out of its range or
            too small (for one leaf, for four cells along each periodic axis, or so that open cells have no sample),
            bounds of the cost map are not positive and finite, or it is directional and the space's cost no length.

    References:
        Section VII of the paper asks for it. The dual of the program is Beckmann's flow, 1952; see ``program.py``.
    """
    _check_space(space)
    if cost_map is not None and not isinstance(cost_map, CostMap):
        raise ValueError(f"cost_map must be a CostMap, such as LipschitzCost, got {shortened(cost_map)}.")
    require_integer("seed", seed, 0)
    most = _MAX_CELLS.get(space.domain.dim, _MAX_CELLS_BEYOND)
    if max_leaves is not None:
        require_integer("max_leaves", max_leaves, 1)
        most = int(max_leaves)
    if max_bytes is not None:
        require_integer("max_bytes", max_bytes, 1)
    tolerance = 0.0 if tolerance is None else as_finite("tolerance", tolerance)
    at = _fraction(space, goal)
    is_proven = isinstance(space, ConfigurationSpace)
    cells = space if isinstance(space, ConfigurationSpace) else SampledSpace(space, int(seed))
    field = _field(cells, cost_map, at, most, tolerance)
    if max_bytes is None:
        return plr_on_mesh(field, is_proven)
    return plr_of_bytes(field, int(max_bytes), int(seed), is_proven)


def _check_space(space: object) -> None:
    if isinstance(space, type) or not isinstance(space, FreeTest):
        raise ValueError(
            "space must be a configuration space, such as PlaneSpace(workspace), with a domain, a motion_cost and "
            f"is_free, got {shortened(space)}."
        )
    domain, motion = space.domain, space.motion_cost
    if not isinstance(domain, Box):
        raise ValueError(f"The space's domain must be a Box, got {shortened(domain)}.")
    if not isinstance(motion, MotionCost) or sorted(axis for axes, _ in motion.blocks for axis in axes) != list(
        range(domain.dim)
    ):
        raise ValueError(
            f"The space's motion_cost must be a MotionCost of its {domain.dim} axes, got {shortened(motion)}."
        )


def _fraction(space: FreeTest, goal: ArrayLike) -> Float[np.ndarray, "dim"]:
    """The goal as a fraction of the domain; ``ValueError`` if one cannot be there."""
    domain = space.domain
    goal = as_finite_point("goal", goal)
    if goal.shape != (domain.dim,):
        raise ValueError(f"goal must have {domain.dim} coordinates, as the space has axes, got {goal.size}.")
    at = (domain.wrapped(goal[None])[0] - domain.lo) / domain.width
    if not (np.abs(at - 0.5) <= 0.5 + _BESIDE).all() or not space.is_free(goal[None])[0]:
        raise ValueError(f"goal must be a free configuration of the space, {goal.tolist()} is not.")
    return np.clip(at, 0.0, 1.0)


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
    paths = shortest_paths(mesh, program.costs, goal, space)
    likely = shortest_paths(solver.likely_mesh(), program.costs.midway, goal, space)
    return CostToGoField(program, solver.values, paths, likely, space)
