"""PLRs as heuristics of the planners of the Open Motion Planning Library (OMPL), which is installed apart."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from plr_jax._arrays import shortened
from plr_jax.plr import PLR

_REMEMBERED = 2**16  # states whose bounds are kept: planners ask for most of them again and again

Coordinates = Callable[[Any], Sequence[float]]


def ompl_objective(space_information: Any, plr: PLR, *, coordinates: Coordinates | None = None) -> Any:
    """Path length as OMPL's objective, with a heuristic from what is proven of a PLR.

    Planners ask an objective for ``motionCostHeuristic(s1, s2)``: at most what a path from a state to another costs.
    By the triangle inequality that is the largest of the space's own distance, ``lower(s1) - upper(s2)`` and, where
    costs are alike both ways, ``lower(s2) - upper(s1)``, of the bounds of the distance to the PLR's goal. If that
    goal is ``s2`` it is the cost-to-go; it bounds the way from the start, and any motion, as well::

        from ompl import base, geometric

        setup = geometric.SimpleSetup(base.RealVectorStateSpace(2))  # and its bounds, what is valid, start and goal
        information = setup.getSpaceInformation()
        setup.setOptimizationObjective(plr_jax.ompl_objective(information, plr))
        setup.setPlanner(geometric.BITstar(information))

    *Admissible* it is wherever the proof holds: between states of free space that reach the PLR's goal. That is all
    that BIT*, BFMT* and SORRT* need, which alone ask for it.
    *Consistent* it is not: bounds jump from leaf to leaf, by up to ``2 * plr.max_error``, so that a search of a graph
    must open states again to which it finds a shorter way. Of RRT* and Informed RRT* it changes nothing: they ask for
    ``costToGo``, which OMPL's Python bindings let nobody set.

    Every question runs under the Python interpreter: some tens of microseconds for a state that was not asked for
    before, one or two for others. That pays where testing motions takes longer.

    Args:
        space_information: OMPL's ``SpaceInformation``, of whose space the distance is what motions cost.
        plr: A PLR of these costs to the goal of which something is proven, such as one built with ``certified=True``:
            of what a motion costs at least, so that one of points may serve a body that turns. Leaf bounds
            (``certified="leaves"``) make it a closer heuristic.
        coordinates: The point of the PLR's domain at which a state is. None: the first coordinates of a state of a
            ``RealVectorStateSpace``, or place and, for a PLR of three dimensions, heading in a ``SE2StateSpace``.

    Returns:
        An ``ompl.base.PathLengthOptimizationObjective``. Outside the PLR's domain, and between states about which
        nothing is known, its heuristic is the space's distance.

    Raises:
        ImportError: If OMPL is not installed.
        ValueError: If ``plr`` is none, nothing is proven of it, or coordinates must be given.

    References:
        Gammell et al., "Batch Informed Trees (BIT*)", 2020. Bounds of the way between two states by distances to a
        third: Goldberg and Harrelson, "Computing the shortest path: A* search meets graph theory", 2005.
    """
    try:
        from ompl import base
    except ImportError as error:
        message = "ompl_objective needs OMPL, which is not installed: pip install 'plr-jax[ompl]', or ompl==2.0.1."
        raise ImportError(message) from error
    if not isinstance(plr, PLR):
        raise ValueError(f"plr must be a PLR, got {shortened(plr)}.")
    plr.lower  # noqa: B018  which says so if nothing is proven
    place = _coordinates_of(base, space_information.getStateSpace(), plr.dim) if coordinates is None else coordinates

    @lru_cache(_REMEMBERED)
    def bounds(point: tuple[float, ...]) -> tuple[float, float]:
        lower, upper = map(float, plr.bounds(np.array(point)))
        return (lower, upper) if upper < np.inf else (-np.inf, np.inf)

    class _BoundedLength(base.PathLengthOptimizationObjective):
        """Path length, bounded by distances to a goal."""

        def __init__(self) -> None:
            super().__init__(space_information)
            self._distance, self._both_ways = space_information.distance, self.isSymmetric()

        def motionCostHeuristic(self, first: Any, last: Any) -> Any:
            lower, upper = bounds(tuple(place(first)))
            lower_of_last, upper_of_last = bounds(tuple(place(last)))
            least = max(self._distance(first, last), lower - upper_of_last)
            return base.Cost(max(least, lower_of_last - upper) if self._both_ways else least)

    return _BoundedLength()


def _coordinates_of(base: Any, space: Any, dim: int) -> Coordinates:
    """How to read the coordinates of states of a space."""
    axes = range(dim)
    if isinstance(space, base.RealVectorStateSpace) and space.getDimension() >= dim:
        return lambda state: [state[axis] for axis in axes]
    if isinstance(space, base.SE2StateSpace) and dim == 2:
        return lambda state: (state.getX(), state.getY())
    if isinstance(space, base.SE2StateSpace) and dim == 3:
        return lambda state: (state.getX(), state.getY(), state.getYaw())
    raise ValueError(
        f"States of {type(space).__name__} of {space.getDimension()} dimensions have no point of a PLR of {dim} by "
        "themselves: say which, coordinates=lambda state: (...)."
    )
