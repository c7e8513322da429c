"""The distance to the nearest of several goals."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_point, as_points, as_queries, as_values, is_traced, set_fields, shortened
from plr_jax._types import ArrayLike, CellSources, DimensionedFn, DistanceFn
from plr_jax.geometry.box import Box
from plr_jax.geometry.reach import Reach
from plr_jax.oracles._visibility_graph import VisibilityGraph, nearest_cell_sources


@dataclass(frozen=True, eq=False, init=False)
class NearestGoal:
    """Distance to the nearest of several goals, such as docks or exits, and the index of that goal.

    Pass one distance function per goal, all of the same dimension (else ``ValueError``), such as PLRs. To share
    preprocessing, use ``[first, *map(first.with_goal, others)]``, where ``first`` is a ``VisibilityGraph``, a
    ``Roadmap`` or a ``GridGraph``. ``construct`` and planners accept a NearestGoal as a distance function. If all
    functions are ``VisibilityGraph``s of one workspace, a PLR built from the NearestGoal may have cone leaves, can be
    certified, and tells the nearest goal by :meth:`PLR.which`. After a PLR is saved and loaded, ``which`` needs cone
    leaves.

    Represent a wide exit, such as a door, by several goals: points along it, no farther apart than twice the error
    that you accept. If the map changes, make a new object:
    ``NearestGoal([fn.with_workspace(new) for fn in nearest.distance_fns])``.
    """

    distance_fns: tuple[DistanceFn, ...]
    dim: int
    _graphs: tuple[VisibilityGraph, ...] = field(repr=False)  # the functions, if all are of one workspace

    def __init__(self, distance_fns: Sequence[DimensionedFn]):
        fns = tuple(distance_fns) if isinstance(distance_fns, list | tuple) else ()
        if not fns or not all(isinstance(fn, DimensionedFn) for fn in fns) or len({fn.dim for fn in fns}) > 1:
            raise ValueError(
                "NearestGoal needs a list of distance functions, one per goal, such as VisibilityGraphs or PLRs of "
                f"the same dim, got {shortened(distance_fns)}."
            )
        graphs = tuple(fn for fn in fns if isinstance(fn, VisibilityGraph))
        share_map = len(graphs) == len(fns) and len({id(graph.workspace) for graph in graphs}) == 1
        set_fields(self, distance_fns=fns, dim=fns[0].dim, _graphs=graphs if share_map else ())

    @property
    def cell_sources(self) -> Callable[[Box], CellSources] | None:
        """A function like ``VisibilityGraph.cell_sources``; None unless all are VisibilityGraphs of one workspace."""
        return partial(nearest_cell_sources, self._graphs) if self._graphs else None

    def reach(self, domain: Box) -> Reach | None:
        """Return which boxes of a domain hold free points without a path; None if there are none or it is unknown."""
        goals = [graph.goal for graph in self._graphs]
        return self._graphs[0].workspace.reach(np.stack(goals), domain) if goals else None

    @property
    def is_lower_bound(self) -> bool:
        """Whether the minimum is a lower bound of the true distance: true if all functions are lower bounds."""
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
        as_point("The start", x, self.dim)
        nearest: Any = self.distance_fns[self.which(as_queries(x)[None])[0]]
        if not hasattr(type(nearest), "shortest_path"):
            raise ValueError(
                f"Paths need oracles with shortest_path, got {shortened(nearest)}: use trace or descend."
            )
        return nearest.shortest_path(x)

    def _distances(self, x: ArrayLike) -> Any:
        if is_traced(x):
            answers = x.__array_namespace__().stack([fn(x) for fn in self.distance_fns])
            return answers.__array_namespace__().nan_to_num(answers, nan=np.inf, posinf=np.inf)
        num = len(as_points("x", x, self.dim))
        x = as_queries(x)  # functions must know which points come as 32-bit floats
        values = np.array([as_values(f"Distance function {i}", fn(x), num) for i, fn in enumerate(self.distance_fns)])
        return np.where(np.isnan(values), np.inf, values)  # PLRs answer NaN at points with a NaN
