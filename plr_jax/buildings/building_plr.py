"""PLRs of whole buildings: one PLR of the plane in which all floors lie side by side."""

from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from plr_jax._types import ArrayLike
from plr_jax.buildings.floors import Floors
from plr_jax.plr._plr import PLR


@jax.tree_util.register_pytree_node_class
@dataclass(frozen=True, eq=False)
class BuildingPLR:
    """Distance to the nearest of a building's goals, over floors and links, as a PLR: ``plr(floor, x)``.

    :meth:`BuildingOracle.construct` or :func:`load` makes it. It is a pytree, as a :class:`PLR` is.

    Attributes:
        plane: The PLR of all floors side by side: a point ``x`` of floor ``k`` is ``x + floors.shift[k]`` there.
        floors: Bounds and shifts of the floors, and the links.
    """

    plane: PLR
    floors: Floors

    def __call__(self, floor: ArrayLike, x: ArrayLike) -> Float[Array | np.ndarray, "*batch"]:
        """Return the distance at each point ``x`` ``(..., 2)`` of a floor, an index or an array ``(...)`` of indices.

        Distances ``(...)`` include the costs of links; they are ``inf`` outside the floor's bounds.
        """
        return self.plane(self.floors.in_plane(floor, x))

    def bounds(self, floor: ArrayLike, x: ArrayLike) -> Any:
        return self.plane.bounds(self.floors.in_plane(floor, x))

    @property
    def max_error(self) -> float | None:
        return self.plane.max_error

    def tree_flatten(self) -> tuple[tuple[PLR], Floors]:
        return (self.plane,), self.floors

    @classmethod
    def tree_unflatten(cls, floors: Floors, children: tuple[PLR]) -> "BuildingPLR":
        return cls(*children, floors)
