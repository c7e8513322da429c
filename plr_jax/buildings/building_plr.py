"""PLRs of whole buildings in JAX: one PLR of the plane in which all floors lie side by side."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import jax
import numpy as np

from plr_jax._arrays import index_of
from plr_jax._compiled import serializable
from plr_jax._types import ArrayLike
from plr_jax.buildings.floors import Route
from plr_jax.buildings.numpy_building import NumpyBuildingPLR
from plr_jax.plr._trace import trace

if TYPE_CHECKING:
    from plr_jax.buildings.building import Building


@serializable
@jax.tree_util.register_pytree_node_class
@dataclass(frozen=True, eq=False)
class BuildingPLR(NumpyBuildingPLR):
    """Distance to the nearest of a building's goals, over floors and links, as a PLR: ``plr(floor, x)``.

    :meth:`BuildingOracle.construct` or :func:`load` makes it. Calls, ``bounds`` and ``which`` work under ``jax.jit``,
    ``jax.vmap`` and, by ``x``, ``jax.grad``. It is a pytree of the arrays of ``plane``, a :class:`PLR`.
    """

    def numpy(self) -> NumpyBuildingPLR:
        """Return the PLR as a function that needs no JAX, and is fast for single points."""
        return NumpyBuildingPLR(self.floors, self.plane.numpy())

    def trace(self, floor: ArrayLike, starts: ArrayLike, building: "Building | None" = None) -> list[Route]:
        """Return the routes to the goal from starts ``(n, 2)`` on floors, an index or ``(n,)``, read from the file.

        Needs cones, else ``ValueError``. As for :func:`trace`, the first segment may cross a wall unless the
        ``building`` is given, whose walls are then tested. A start without a path, or without a free one, has a route
        without legs.
        """
        plane, sources = self.floors.in_plane(floor, starts), self.plane.stored.sources
        traces = trace(self.plane, plane, None if building is None else building.plane)
        of_start = np.broadcast_to(floor, len(traces)).tolist()
        # 1. Find the source at which each path on the start's floor ends.
        keys = sources.points @ [1, 1j]
        order = np.argsort(np.where(sources.is_root, 0, 1), kind="stable")  # prefer roots
        ends = traces.paths[np.arange(len(traces)), np.maximum(traces.counts, 1) - 1]
        root = order[index_of(keys[order], ends @ [1, 1j])]
        # 2. Follow the links: each root has a number, and its path continues at the source at the link's other end.
        number = np.full(len(keys), -1)
        number[sources.is_root] = sources.goals
        routes = []
        for k, (path, count, last) in enumerate(
            zip(traces.paths, traces.counts.tolist(), root.tolist(), strict=True)
        ):
            legs, arcs = [], []
            if traces.arrived[k]:
                legs.append((of_start[k], path[:count]))
                while (arc := int(number[last]) - self.floors.num_goals) >= 0:
                    arcs.append(arc)
                    leg_floor, point = self.floors.arcs[arc].end
                    points = [np.array(point) + self.floors.shift[leg_floor]]
                    last = int(np.linalg.norm(sources.points - points[0], axis=1).argmin())
                    while sources.parent[last] != last:
                        last = int(sources.parent[last])
                        points.append(sources.points[last])
                    legs.append((leg_floor, np.stack(points)))
            routes.append(self.floors.route(legs, arcs))
        return routes
