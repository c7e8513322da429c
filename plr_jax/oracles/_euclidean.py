"""Straight-line distance."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import as_finite_point, as_points, as_values, set_fields, shortened
from plr_jax._types import ArrayLike, DimensionedFn, DistanceFn, Distances, Symmetry


@dataclass(frozen=True, eq=False, init=False)
class Euclidean:
    """Straight-line distance to a goal, in any dimension, as if there were no obstacles.

    Args:
        goal: The goal, ``(dim,)``, finite.

    Raises:
        ValueError: If the goal is not a vector of finite numbers.
    """

    goal: Float[np.ndarray, "dim"]
    is_lower_bound: ClassVar[bool] = True
    """True: no path of a robot whose reference point keeps to its free space is shorter."""

    def __init__(self, goal: ArrayLike):
        object.__setattr__(self, "goal", as_finite_point("The goal", goal))

    @property
    def dim(self) -> int:
        """Number of coordinates of a point."""
        return self.goal.size

    @property
    def symmetries(self) -> tuple[Symmetry, ...]:
        """Reflections along each axis, about the goal."""
        return tuple(Symmetry.about(self.goal, np.diag(signs)) for signs in 1 - 2 * np.eye(self.dim))

    def __call__(self, x: ArrayLike) -> Distances:
        """Distance of each point to the goal.

        Args:
            x: Points, ``(n, dim)``.

        Returns:
            Distances, ``(n,)``; ``inf`` for points with a coordinate that is not finite.

        Raises:
            ValueError: If ``x`` has another shape.
        """
        distance = np.linalg.norm(as_points("x", x, self.goal.size) - self.goal, axis=1)
        return np.where(np.isnan(distance), np.inf, distance)


# The nearest of several goals.


@dataclass(frozen=True, eq=False, init=False)
class NearestGoal:
    """Distance to the nearest of several goals, such as docks, and which one that is.

    It is a distance function as others are, for ``construct``, whose PLR needs few bytes more for more goals, for
    planners, ... Nothing can be proven of such a PLR. Inside ``jit`` the distances to all goals are
    ``stack(plrs)(np.arange(n)[:, None], x)``, of which the least is the same.

    Args:
        distance_fns: A distance function a goal, of the same dimension: ``[first, *map(first.with_goal, others)]`` of
            a ``VisibilityGraph``, a ``Roadmap`` or a ``GridGraph``, which share what is costly; or PLRs.

    Raises:
        ValueError: If there are none, one is no function, or their dimensions differ.
    """

    distance_fns: tuple[DistanceFn, ...]
    dim: int

    def __init__(self, distance_fns: Sequence[DimensionedFn]):
        fns = tuple(distance_fns) if isinstance(distance_fns, list | tuple) else ()
        if not fns or not all(isinstance(fn, DimensionedFn) for fn in fns) or len({fn.dim for fn in fns}) > 1:
            raise ValueError(
                "NearestGoal needs a list of distance functions, such as VisibilityGraph or PLRs, one a goal, of the "
                f"same dim, at least one, got {shortened(distance_fns)}."
            )
        set_fields(self, distance_fns=fns, dim=fns[0].dim)

    @property
    def is_lower_bound(self) -> bool:
        """Whether the minimum is a lower bound of the true distance: true if all functions are lower bounds."""
        return all(getattr(fn, "is_lower_bound", False) for fn in self.distance_fns)

    def __call__(self, x: ArrayLike) -> Distances:
        """Distance of each point to the nearest goal.

        Args:
            x: Points, ``(n, dim)``.

        Returns:
            Distances, ``(n,)``; ``inf`` where no goal can be reached.

        Raises:
            ValueError: If ``x`` has another shape.
        """
        return self._distances(x).min(axis=0)

    def which(self, x: ArrayLike) -> Int[np.ndarray, "n"]:
        """The goal that is nearest to each point.

        Args:
            x: Points, ``(n, dim)``.

        Returns:
            Numbers of goals, from 0 in their order, ``(n,)``: of equals the first, -1 where none can be reached.

        Raises:
            ValueError: If ``x`` has another shape.
        """
        distances = self._distances(x)
        return np.where(np.isfinite(distances).any(axis=0), distances.argmin(axis=0), -1)

    def _distances(self, x: ArrayLike) -> Float[np.ndarray, "goals n"]:
        x = as_points("x", x, self.dim)
        answers = np.array(
            [as_values(f"Distance function {i}", fn(x), len(x)) for i, fn in enumerate(self.distance_fns)]
        )
        return np.where(np.isnan(answers), np.inf, answers)  # of a PLR at a point that is none
