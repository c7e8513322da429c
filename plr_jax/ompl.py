"""PLRs as heuristics for planners of the Open Motion Planning Library (OMPL), an optional dependency."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from plr_jax._arrays import require_type
from plr_jax.plr import PLR

_CACHED_STATES = 2**16  # planners ask for the bounds of most states repeatedly
Coordinates = Callable[[Any], Sequence[float]]


def ompl_objective(space_information: Any, plr: PLR, *, coordinates: Coordinates | None = None) -> Any:
    """Create OMPL's path-length objective with a proven heuristic from a PLR.

    Typical use, with OMPL's Python bindings::

        from ompl import base, geometric

        setup = geometric.SimpleSetup(base.RealVectorStateSpace(2))  # and bounds, validity checker, start and goal
        information = setup.getSpaceInformation()
        setup.setOptimizationObjective(plr_jax.ompl_objective(information, plr))
        setup.setPlanner(geometric.BITstar(information))

    Planners call ``motionCostHeuristic(s1, s2)``, a lower bound of the path cost between two states. Let ``lower(s)``
    and ``upper(s)`` be the PLR's bounds of the distance from a state to its goal. The heuristic is the largest of
    the space's own distance, ``lower(s1) - upper(s2)`` and, for costs that are equal in both directions,
    ``lower(s2) - upper(s1)``. The differences are lower bounds by the triangle inequality.

    The heuristic is *admissible* between free states from which the PLR's goal is reachable. This suffices for the
    only planners that use it: BIT*, BFMT* and SORRT*. It is not *consistent*: bounds jump between leaves by up to
    ``2 * plr.max_error``, so a graph search must reopen states. The bounds of each new state take time to compute, so
    the heuristic pays off only if motion tests take longer.

    Args:
        space_information: OMPL's ``SpaceInformation``; its space's distance must be the cost of motions.
        plr: A PLR with proven bounds (``certified=True``, or better ``certified="leaves"``) for the same motion
            costs, or for lower ones. For example, the PLR of a point robot also serves a body that turns.
        coordinates: Function from a state to its point in the PLR's domain. None: the first coordinates of a
            ``RealVectorStateSpace``; position, and for a PLR of three dimensions heading, of an ``SE2StateSpace``.

    Returns:
        An ``ompl.base.PathLengthOptimizationObjective``. Outside the PLR's domain, and between states without finite
        bounds, its heuristic is the space's distance.

    Raises:
        ImportError: If OMPL is not installed.
        ValueError: If ``plr`` is not a PLR with proven bounds, or ``coordinates`` must be given.

    References: Gammell et al., "Batch Informed Trees (BIT*)", 2020. The bound (ALT): Goldberg and Harrelson, 2005.
    """
    try:
        from ompl import base
    except ImportError as error:
        message = "ompl_objective needs OMPL, which is not installed: pip install 'plr-jax[ompl]', or ompl==2.0.1."
        raise ImportError(message) from error
    require_type("plr", plr, PLR, "a PLR")
    plr.lower  # noqa: B018  raises if there are no certificates
    place = _coordinates_of(base, space_information.getStateSpace(), plr.dim) if coordinates is None else coordinates

    @lru_cache(_CACHED_STATES)
    def bounds(point: tuple[float, ...]) -> tuple[float, float]:
        lower, upper = map(float, plr.bounds(np.array(point)))
        return (lower, upper) if upper < np.inf else (-np.inf, np.inf)

    class _BoundedLength(base.PathLengthOptimizationObjective):
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
    """Return a function from a state of an OMPL space to its ``dim`` coordinates, or raise a ``ValueError``.

    There is such a function for a ``RealVectorStateSpace`` of at least ``dim`` dimensions and, if ``dim`` is 2 or 3,
    for an ``SE2StateSpace``. ``base`` is the module ``ompl.base``.
    """
    if isinstance(space, base.RealVectorStateSpace) and space.getDimension() >= dim:
        return lambda state: [state[axis] for axis in range(dim)]
    if isinstance(space, base.SE2StateSpace) and dim in (2, 3):
        return lambda state: (state.getX(), state.getY(), state.getYaw())[:dim]
    dimensions = f"a {type(space).__name__} of {space.getDimension()} dimensions and a PLR of {dim}"
    raise ValueError(f"coordinates must be given for {dimensions}: pass coordinates=lambda state: (...).")
