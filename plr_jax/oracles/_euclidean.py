"""Distances without obstacles, and the nearest of several goals."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import as_finite_point, as_points, as_values, set_fields, shortened
from plr_jax._types import ArrayLike, DimensionedFn, DistanceFn, Distances, Symmetry


@dataclass(frozen=True, eq=False, init=False)
class Euclidean:
    """Straight-line distance to a goal, in any dimension, without obstacles.

    Args:
        goal: The goal, ``(dim,)``, finite.

    Raises:
        ValueError: If the goal is not a vector of finite numbers.
    """

    goal: Float[np.ndarray, "dim"]
    is_lower_bound: ClassVar[bool] = True
    """True: no path of the robot's reference point is shorter."""

    def __init__(self, goal: ArrayLike):
        object.__setattr__(self, "goal", as_finite_point("The goal", goal))

    @property
    def dim(self) -> int:
        """Number of coordinates of a point."""
        return self.goal.size

    @property
    def symmetries(self) -> tuple[Symmetry, ...]:
        """Reflections about the goal, each of which flips one axis."""
        return tuple(Symmetry.about(self.goal, np.diag(signs)) for signs in 1 - 2 * np.eye(self.dim))

    def __call__(self, x: ArrayLike) -> Distances:
        """Return the distance of points ``(n, dim)`` to the goal, ``inf`` if a coordinate is not finite."""
        distance = np.linalg.norm(as_points("x", x, self.goal.size) - self.goal, axis=1)
        return np.where(np.isnan(distance), np.inf, distance)


@dataclass(frozen=True, eq=False, init=False)
class NearestGoal:
    """Distance to the nearest of several goals, such as docks, and the index of that goal.

    It is a distance function like others, for example for ``construct`` or for planners. Its PLR needs only a few
    more bytes per additional goal, but cannot be certified. Inside ``jit``, ``stack(plrs)(np.arange(n)[:, None], x)``
    gives the distances to all goals; take their minimum.

    Args:
        distance_fns: One distance function per goal, all of the same dimension. To share preprocessing, use
            ``[first, *map(first.with_goal, others)]`` of a ``VisibilityGraph``, ``Roadmap`` or ``GridGraph``. PLRs
            work too.

    Raises:
        ValueError: If the list is empty, contains anything but distance functions with ``dim``, or dimensions differ.
    """

    distance_fns: tuple[DistanceFn, ...]
    dim: int

    def __init__(self, distance_fns: Sequence[DimensionedFn]):
        fns = tuple(distance_fns) if isinstance(distance_fns, list | tuple) else ()
        if not fns or not all(isinstance(fn, DimensionedFn) for fn in fns) or len({fn.dim for fn in fns}) > 1:
            raise ValueError(
                "NearestGoal needs a list of distance functions, one per goal, such as VisibilityGraphs or PLRs of "
                f"the same dim, got {shortened(distance_fns)}."
            )
        set_fields(self, distance_fns=fns, dim=fns[0].dim)

    @property
    def is_lower_bound(self) -> bool:
        """Whether the minimum is a lower bound of the true distance: true if all functions are lower bounds."""
        return all(getattr(fn, "is_lower_bound", False) for fn in self.distance_fns)

    def __call__(self, x: ArrayLike) -> Distances:
        """Return the distance of points ``(n, dim)`` to the nearest goal, ``inf`` where no goal can be reached."""
        return self._distances(x).min(axis=0)

    def which(self, x: ArrayLike) -> Int[np.ndarray, "n"]:
        """Return the index of the goal that is nearest to each point ``(n, dim)``.

        The index is the first of equally near goals, and -1 where no goal can be reached.
        """
        distances = self._distances(x)
        return np.where(np.isfinite(distances).any(axis=0), distances.argmin(axis=0), -1)

    def _distances(self, x: ArrayLike) -> Float[np.ndarray, "goals n"]:
        x = as_points("x", x, self.dim)
        answers = np.array(
            [as_values(f"Distance function {i}", fn(x), len(x)) for i, fn in enumerate(self.distance_fns)]
        )
        return np.where(np.isnan(answers), np.inf, answers)  # PLRs answer NaN at points with a NaN
