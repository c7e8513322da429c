"""Paths that follow a cost-to-go to its goal, from many starts at once, never through a wall."""

from collections.abc import Callable

from plr_jax._arrays import as_finite, shortened
from plr_jax._types import ArrayLike
from plr_jax.geometry.workspace import Workspace
from plr_jax.optimize._corners import along_corners
from plr_jax.optimize._descent import Descent
from plr_jax.optimize._lookahead import by_lookahead
from plr_jax.optimize._motion_tests import MotionTests
from plr_jax.optimize._path_costs import PathCosts
from plr_jax.spaces import ConfigurationSpace, CostMap, FreeTest, PlaneSpace, require_space


def descend(
    distance_fn: Callable[[ArrayLike], ArrayLike],
    space: Workspace | ConfigurationSpace | FreeTest,
    starts: ArrayLike,
    goal: ArrayLike,
    *,
    cost_map: CostMap | None = None,
    resolution: float | int | None = None,
) -> Descent:
    """Follow a distance function, or another cost-to-go, from many starts to its goal, by lookahead.

    *Lengths in a workspace*: shortest paths turn at corners alone, so that paths go from corner to corner. The field
    is asked once, at the corners, whose edges it ranks; every leg of every path is tested for visibility. Corners
    that the field does not lead to the goal are joined to all that they see. So a start reaches the goal whenever
    there is a way, whatever the field; its paths are the shortest but for places where it errs by more than the best
    ways on from a corner differ. Most tests are those of starts, of which it saves few. Often, as in the maze, paths
    are the shortest with a field that is zero as well: that a descent arrives, and how long it is, says little of a
    field.

    *Other costs and spaces*: paths go on over steps of many lengths and directions, to the place in sight where the
    field falls most for what the step costs. That is steepest descent for the norm that the cost of motions is, over
    finite steps, whatever the slope of the field. (Where a cost is length plus weighted turn, the direction that is
    steepest either moves or turns: the dual of a sum of norms is the largest of their duals.) At last paths are made
    cheaper where they are: vertices are left out, or shifted to where the two legs cost least. Dents of the field
    that no step leads out of are filled, by a search of the configurations around, which is slow: a path is STUCK
    where 1,000 expansions lead to none that is lower. A step may cross a ridge of the field, and so take another way
    around an obstacle than the field does, which may be much longer. The better the field, the better the paths, and
    the sooner found. With a cost map a start takes some tenths of a second.

    Args:
        distance_fn: The field, such as a PLR: any function of points ``(n, dim)`` to their costs-to-go ``(n,)``
            through free space, NumPy or JAX; ``inf`` where it has none. In units of what motions cost, as cost-to-go
            is. Of a space, it is asked within the domain alone, into which periodic coordinates are wrapped.
        space: Free space. A Workspace is one of points; for the shortest paths of a disc, the inflated one. Of one
            that only tests configurations (:class:`FreeTest`), as with a collision checker of your own, motions are
            tested at a ``resolution``.
        starts: Where to begin, ``(n, dim)``.
        goal: Where to end, ``(dim,)``, in closed free space.
        cost_map: The factor of the cost of motions that the field is a cost-to-go of; None: 1 everywhere.
        resolution: Of a space that only tests, and of no other: what a motion between two tests costs at most, in
            units of its ``motion_cost``. What is thinner may be passed through.

    Returns:
        The paths, with a status for each start, their lengths and their costs. Costs by a cost map err by at most
        0.1 %, and far less where it is smooth.

    Raises:
        ValueError: If the space is none, it only tests and has no resolution, another one has, a motion takes more
            than 262,144 tests, a shape is wrong, the goal is not free, the field gives NaN or another number of
            values, or the cost map a number that is not positive and finite.

    References:
        "Extracting optimal trajectories" is a requirement of Putman et al., Section I. The edges are a part of the
        visibility graph: de Berg et al., Computational Geometry (3rd ed.), chapter 15. Finite
        steps stand for gradients in semi-Lagrangian schemes: Falcone and Ferretti, 2014, chapter 8.
    """
    if not isinstance(space, Workspace):
        require_space(space)
    if isinstance(space, ConfigurationSpace | Workspace) != (resolution is None):
        raise ValueError(
            "resolution, what a motion costs at most between two tests of it, is for a space that only tests "
            f"configurations, and needed there, got {shortened(resolution)} for {shortened(space)}."
        )
    if isinstance(space, Workspace) and cost_map is None:
        return along_corners(distance_fn, space, starts, goal)
    if isinstance(space, Workspace):
        space = PlaneSpace(space)
    if not isinstance(space, ConfigurationSpace):
        space = MotionTests(space, as_finite("resolution", resolution, positive=True))
    if cost_map is not None and not isinstance(cost_map, CostMap):
        raise ValueError(
            f"cost_map must be a CostMap, such as LipschitzCost or RasterCost, got {shortened(cost_map)}."
        )
    return by_lookahead(distance_fn, PathCosts(space, cost_map), starts, goal)
