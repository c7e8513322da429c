"""Distances between any two points of a building, along paths that may take links from floor to floor."""

from dataclasses import dataclass

import jax
from jaxtyping import Array, Float

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

    A path may take links. With one-way links, the distance back may differ. The attribute ``plane`` is a
    :class:`PairPLR`, whose methods ``prepared`` and ``to`` raise ``ValueError`` if there are links. BuildingPairs are
    a pytree of the arrays of ``plane``.
    """

    def __call__(self, x: Places, y: Places) -> Float[Array, "*batch"]:
        """Return the distance from points ``x`` to points ``y``, ``(...)``, costs of links included.

        Both are pairs ``(floor, points)``: an index or an array ``(...)`` of indices, and points ``(..., 2)``. The
        distance is ``inf`` without a path and outside a floor's bounds. :func:`construct_pairs` states the errors, in
        widths of ``plane``. Works under ``jax.jit``, ``jax.vmap`` and ``jax.grad``.
        """
        return self.plane(self.floors.in_plane(*x), self.floors.in_plane(*y))

    def bounds(self, x: Places, y: Places) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Return proven lower and upper bounds of the distance, ``(...)`` each; see :meth:`PairPLR.bounds`."""
        return self.plane.bounds(self.floors.in_plane(*x), self.floors.in_plane(*y))
