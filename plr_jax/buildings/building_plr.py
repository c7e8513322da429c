"""PLRs of whole buildings in JAX: one PLR of the plane in which all floors lie side by side."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from plr_jax._arrays import shortened
from plr_jax._compiled import serializable
from plr_jax._types import ArrayLike, Sources
from plr_jax.buildings.floors import Route
from plr_jax.buildings.numpy_building import NumpyBuildingPLR
from plr_jax.plr._trace import trace_by_sources

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

        The leaves must be cones, else ``ValueError``. As for :func:`trace`, the first segment may cross a wall unless
        the ``building`` is given, whose walls are then tested. A route that bends, or takes a link, where two walls
        touch may still pass between these walls. A start without a path, or without a free path, has a route without
        legs.
        """
        floors, stored = self.floors, self.plane.stored.sources
        given: Any = floors if building is None else getattr(building, "plane_floors", None)
        if given is None or not np.array_equal((given.lo, given.hi), (floors.lo, floors.hi)):
            raise ValueError(f"building must be the Building of this PLR, or None, got {shortened(building)}.")
        traces, first = trace_by_sources(self.plane, floors.in_plane(floor, starts), building and building.plane)
        first = np.where(traces.arrived, first, -1)
        # Number the roots, and find where their links lead: to the sources nearest to the links' ends, of several
        # to the one nearest to the goal.
        numbers, exits = np.full(len(stored.points), -1), np.arange(len(stored.points))
        numbers[stored.is_root] = stored.goals
        for root in np.flatnonzero(numbers >= floors.num_goals):
            end_floor, end = floors.arcs[numbers[root] - floors.num_goals][1].end
            away = np.linalg.norm(stored.points - (end + floors.shift[end_floor]), axis=1)
            exits[root] = np.lexsort([stored.offsets, away])[0]
        sources = Sources(stored.points, stored.offsets, stored.parent, numbers, exits)
        rows = zip(np.broadcast_to(floor, len(traces)).tolist(), traces.paths[:, 0], first.tolist(), strict=True)
        return [floors.route(*row, sources) for row in rows]
