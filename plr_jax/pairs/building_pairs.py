"""Distances between any two points of a building, along paths that may take links from floor to floor."""

from dataclasses import dataclass
from typing import Any

import jax

from plr_jax._compiled import serializable
from plr_jax._types import ArrayLike
from plr_jax.buildings.floors import OnFloors

Places = tuple[ArrayLike, ArrayLike]  # floors and points


@serializable
@jax.tree_util.register_pytree_node_class
@dataclass(frozen=True, eq=False)
class BuildingPairs(OnFloors):
    """Distances between any two points of a building, made by :func:`construct_pairs` or :func:`load`.

        pairs = plr_jax.construct_pairs(building)
        pairs((0, x), (2, y))  # (n,), from points x (n, 2) of floor 0 to points y of floor 2

    A path may take links. With one-way links, the distance back may differ. BuildingPairs are a pytree of the arrays
    of their ``plane``, a :class:`PairPLR` of the plane in which all floors lie side by side. If there are links,
    ``pairs.plane.prepared``, ``pairs.plane.to`` and ``pairs.plane.js_module`` raise ``ValueError``.
    """

    def __call__(self, x: Places, y: Places) -> Any:
        """Return the distance from points ``x`` to points ``y``, ``(...)``, costs of links included.

        Both are pairs ``(floor, points)``: an index or an array ``(...)`` of indices, and points ``(..., 2)``, else
        ``ValueError``. The distance is ``inf`` without a path and outside a floor's bounds. :func:`construct_pairs`
        states the errors, in widths of the domain of ``plane``. Works under ``jax.jit``, ``jax.vmap`` and
        ``jax.grad``.
        """
        return self.plane(*map(self.floors.places_in_plane, (x, y)))

    def bounds(self, x: Places, y: Places) -> tuple[Any, Any]:
        """Return proven lower and upper bounds of the distance, ``(...)`` each; see :meth:`PairPLR.bounds`."""
        return self.plane.bounds(*map(self.floors.places_in_plane, (x, y)))

    def numpy(self) -> "BuildingPairs":
        """Return the same function in NumPy, with ``plane.numpy()`` as its ``plane``; the result cannot be saved."""
        return BuildingPairs(self.floors, self.plane.numpy())
