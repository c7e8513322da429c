"""Distances to several goals: to the nearest goal, or from each robot of a team to its own goal."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from plr_jax import _arrays
from plr_jax._problem import Problem
from plr_jax._types import ArrayLike, CellSources, DimensionedFn, DistanceFn, Reach
from plr_jax.geometry.box import Box
from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles._visibility_graph import NearestPaths, VisibilityGraph

_SHRINKAGE = 4  # robots are shrunk by this many times the workspace's tolerance


@dataclass(frozen=True, eq=False, init=False)
class NearestGoal(_arrays.PickledWithoutCaches):
    """Distance to the nearest of several goals, such as docks or exits, and the index of that goal.

        first = plr_jax.VisibilityGraph(workspace, exits[0])
        nearest = plr_jax.NearestGoal([first, *map(first.with_goal, exits[1:])], offsets=[0, 12.5])  # a queue: 12.5

    Pass one distance function per goal, all of the same dimension (else ``ValueError``), such as PLRs. ``offsets``
    are the costs of using each goal, in units of distance, finite and at least 0 (else ``ValueError``): the distance
    to a goal is its function plus its offset. To share preprocessing, use ``[first, *map(first.with_goal, others)]``,
    where ``first`` is a ``VisibilityGraph``, a ``Roadmap`` or a ``GridGraph``. ``construct`` and planners accept a
    NearestGoal as a distance function. If all functions are ``VisibilityGraph``s of one workspace, a PLR built from
    the NearestGoal may have cone leaves, can be certified, and tells the nearest goal by :meth:`PLR.which`. After a
    PLR is saved and loaded, ``which`` needs cone leaves.

    Represent a wide exit, such as a door, by several goals: points along it, no farther apart than twice the error
    that you accept. If the map changes, make a new object:
    ``NearestGoal([fn.with_workspace(new) for fn in nearest.distance_fns])``.
    """

    distance_fns: tuple[DistanceFn, ...]
    offsets: Float[np.ndarray, " goals"]
    dim: int
    _graphs: tuple[VisibilityGraph, ...] = field(repr=False)  # the functions, if all are of one workspace

    def __init__(self, distance_fns: Sequence[DimensionedFn], offsets: ArrayLike | None = None):
        fns = tuple(distance_fns) if isinstance(distance_fns, list | tuple) else ()
        if not fns or not all(isinstance(fn, DimensionedFn) for fn in fns) or len({fn.dim for fn in fns}) > 1:
            advice = "such as VisibilityGraphs or PLRs of the same dim"
            got = _arrays.shortened(distance_fns)
            raise ValueError(f"NearestGoal needs a list of distance functions, one per goal, {advice}, got {got}.")
        graphs = tuple(fn for fn in fns if isinstance(fn, VisibilityGraph))
        share_map = len(graphs) == len(fns) and len({id(graph.workspace) for graph in graphs}) == 1
        _arrays.set_fields(self, distance_fns=fns, offsets=_arrays.as_offsets(offsets, len(fns)), dim=fns[0].dim)
        _arrays.set_fields(self, _graphs=graphs if share_map else ())

    @cached_property
    def _paths(self) -> NearestPaths:
        first, goals = self._graphs[0], np.stack([graph.goal for graph in self._graphs])
        return NearestPaths.of(first.workspace, first.family, goals, self.offsets)

    @property
    def cell_sources(self) -> Callable[[Box], CellSources] | None:
        """A function like :meth:`VisibilityGraph.cell_sources`, by which PLRs of the nearest goal can be certified.

        The value is None unless all distance functions are VisibilityGraphs of one workspace.
        """
        return self._paths.cell_sources if self._graphs else None

    def reach(self, domain: Box) -> Reach | None:
        """Return tests whether boxes in ``domain`` hold points that reach a goal, or free points that do not.

        The result is None if a path leads from every free point to a goal, or if the distance functions are not
        VisibilityGraphs of one workspace.
        """
        return self._paths.reach(domain) if self._graphs else None

    @property
    def is_lower_bound(self) -> bool:
        """Whether the answers never exceed the true distance: true if this is known of all distance functions."""
        return all(getattr(fn, "is_lower_bound", False) for fn in self.distance_fns)

    def __call__(self, x: ArrayLike) -> Any:
        """Return the distances ``(n,)`` of points ``(n, dim)`` to the nearest goal, ``inf`` if none can be reached.

        Inside ``jit``, all distance functions must be traceable, such as PLRs.
        """
        return self._distances(x).min(axis=0)

    def which(self, x: ArrayLike) -> Any:
        """Return the index ``(n,)`` of the goal nearest to each point ``(n, dim)``, -1 if no goal can be reached.

        Of several nearest goals, the first counts.
        """
        distances = self._distances(x)
        xp = distances.__array_namespace__()
        return xp.where(xp.isfinite(distances).any(axis=0), distances.argmin(axis=0), -1)

    def shortest_path(self, x: ArrayLike) -> Float[np.ndarray, "m dim"]:
        """Return the shortest path from a point ``(dim,)`` to the nearest goal, as vertices ``(m, dim)``.

        ``ValueError`` is raised if the distance function of that goal has no method ``shortest_path``.
        """
        _arrays.as_point("The start", x, self.dim)
        nearest: Any = self.distance_fns[self.which(_arrays.as_queries(x)[None])[0]]
        if not hasattr(type(nearest), "shortest_path"):
            got = _arrays.shortened(nearest)
            raise ValueError(f"Paths need oracles with shortest_path, got {got}: use trace or descend.")
        return nearest.shortest_path(x)

    def _distances(self, x: ArrayLike) -> Any:
        if _arrays.is_traced(x):
            shifted = [fn(x) + offset for fn, offset in zip(self.distance_fns, self.offsets, strict=True)]
            answers = x.__array_namespace__().stack(shifted)
            return answers.__array_namespace__().nan_to_num(answers, nan=np.inf, posinf=np.inf)
        num = len(_arrays.as_points("x", x, self.dim))
        x = _arrays.as_queries(x)  # functions must know which points come as 32-bit floats
        answers = enumerate(fn(x) for fn in self.distance_fns)
        values = np.array([_arrays.as_values(f"Distance function {i}", answer, num) for i, answer in answers])
        values += self.offsets[:, None]
        return np.where(np.isnan(values), np.inf, values)  # PLRs answer NaN at points with a NaN


def robot_distance_fns(problem: Problem, inflated: bool = True) -> list[VisibilityGraph]:
    """Return, for each robot, the distance function to the robot's goal, as if there were no other robots.

    Each function takes positions ``(n, 2)``; distances are ``inf`` at blocked positions. If ``inflated``, obstacles
    are grown by the robot's inscribed radius: distances of discs are exact up to a tolerance, and distances of other
    robots are lower bounds. Otherwise distances are those of a point robot, which are shorter, as in section V-B of
    the paper (Putman et al.). Robots of equal size share the preprocessing of the map.
    """
    first: dict[float, VisibilityGraph] = {}  # the first robot's oracle for each radius of inflation
    distance_fns = []
    for robot, goal in zip(problem.robots, problem.goals, strict=True):
        # A robot may overlap a wall by the tolerance, and fits through a passage of exactly its own width.
        radius = max(0.0, robot.inscribed_radius - _SHRINKAGE * problem.workspace.tolerance) if inflated else 0.0
        if radius in first:
            oracle = first[radius].with_goal(_snapped_goal(goal[:2], first[radius].workspace))
        else:
            workspace = problem.workspace.inflate(radius) if radius > 0 else problem.workspace
            oracle = first[radius] = VisibilityGraph(workspace, _snapped_goal(goal[:2], workspace))
        distance_fns.append(oracle)
    return distance_fns


def exact_lower_bound(problem: Problem) -> float:
    """Return the sum of the robots' exact distances to their goals, a lower bound of the cost of all team paths.

    Each robot counts as alone in the workspace, and turns cost nothing. The bound is ``inf`` if a robot cannot reach
    its goal.
    """
    pairs = zip(robot_distance_fns(problem), problem.starts, strict=True)
    return float(sum(distance_fn(start[None, :2])[0] for distance_fn, start in pairs))


def _snapped_goal(goal: Float[np.ndarray, "2"], workspace: Workspace) -> Float[np.ndarray, "2"]:
    """Return the goal, moved to the nearest free point if the goal is outside free space only by rounding.

    The goal is not moved if it is at most ``workspace.tolerance`` outside, since it then counts as free. Nor is it
    moved if it is more than 1,000 times the tolerance outside, since rounding errors are smaller.
    """
    if workspace.is_free_to_tolerance(goal[None])[0]:
        return goal
    nearest = shapely.get_coordinates(shapely.shortest_line(workspace.free_space, shapely.Point(goal)))[0]
    return nearest if np.linalg.norm(nearest - goal) <= 1e3 * workspace.tolerance else goal
