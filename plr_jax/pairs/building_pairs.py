"""Distances between any two places of a building, over floors and links."""

from dataclasses import dataclass, field

import jax
from jaxtyping import Array, Float

from plr_jax._compiled import serializable
from plr_jax._types import ArrayLike
from plr_jax.buildings.floors import Floors
from plr_jax.pairs.pair_plr import PairPLR


@serializable
@jax.tree_util.register_pytree_node_class
@dataclass(frozen=True, eq=False)
class BuildingPairs:
    """Distances between any two places of a building, made by :func:`construct_pairs` or :func:`load`.

        pairs = plr_jax.construct_pairs(building)
        pairs((0, x), (2, y))  # (n,), from points x (n, 2) of floor 0 to points y of floor 2

    A path may take links. With one-way links, the distance back may differ. It is a pytree, as a ``PairPLR`` is.

    Attributes:
        floors: Bounds of the floors, the links, and ``shift``.
        plane: The pairs of all floors, side by side: point ``x`` of floor ``k`` is ``x + floors.shift[k]`` there. Its
            methods ``prepared`` and ``to``, and JavaScript, do not know links.
    """

    floors: Floors = field(repr=False)
    plane: PairPLR

    def __call__(self, x: tuple[ArrayLike, ArrayLike], y: tuple[ArrayLike, ArrayLike]) -> Float[Array, "*batch"]:
        """Return the distance from places ``x`` to places ``y``, ``(...)``, costs of links included.

        Each is a pair ``(floor, points)``: an index or an array ``(...)`` of indices, and points ``(..., 2)``. The
        distance is ``inf`` without a path and outside a floor's bounds; errors are those of :func:`construct_pairs`,
        with the width of ``plane``. Works under ``jax.jit``, ``jax.vmap`` and ``jax.grad``.
        """
        return self.plane(self.floors.in_plane(*x), self.floors.in_plane(*y))

    def bounds(
        self, x: tuple[ArrayLike, ArrayLike], y: tuple[ArrayLike, ArrayLike]
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Return proven lower and upper bounds of the distance, ``(...)`` each; see :meth:`PairPLR.bounds`."""
        return self.plane.bounds(self.floors.in_plane(*x), self.floors.in_plane(*y))

    @property
    def num_bytes(self) -> int:
        """Size of the file in bytes."""
        return len(self.to_bytes())

    def to_bytes(self) -> bytes:
        """Return the bytes of the file: the floors and links, then the file of ``plane``."""
        return self.floors.to_bytes() + self.plane.to_bytes()

    def tree_flatten(self) -> tuple[tuple[PairPLR], str]:
        return (self.plane,), self.floors.text

    @classmethod
    def tree_unflatten(cls, text: str, children: tuple[PairPLR]) -> "BuildingPairs":
        return cls(Floors.of_text(text), *children)
