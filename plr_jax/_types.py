"""Array aliases and the function types in which discovering, storing and using distance meet."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from jaxtyping import Float

ArrayLike: TypeAlias = Any
"""Whatever ``numpy.asarray`` accepts; checked, with a clear error, where it comes in."""

Points: TypeAlias = Float[np.ndarray, "n dim"]
"""A batch of points (configurations) on the host, one a row."""

Distances: TypeAlias = Float[np.ndarray, "n"]
"""One distance a point, in workspace units; ``inf`` where the goal cannot be reached."""

DistanceFn: TypeAlias = Callable[[Points], Distances]
"""Distance to a goal for a batch of points: never NaN, never negative.

``inf`` means that the goal cannot be reached from there: the point is cut off, in an obstacle, outside the domain
or the bounds, or not a point at all (a coordinate is NaN).

What one may offer besides: :class:`HasDimension`, :class:`StackableDistanceFn`.
"""

JointConfigurations: TypeAlias = Float[np.ndarray, "n robots dof"]
"""A batch of joint configurations on the host, one a row."""

HeuristicFn: TypeAlias = Callable[[JointConfigurations], Float[np.ndarray, "n"]]
"""Estimated cost-to-go of a batch of joint configurations, never NaN; ``inf`` where it has no estimate.

What one may offer besides: :class:`SeparableHeuristic`.
"""


@runtime_checkable
class HasDimension(Protocol):
    """A function of points that says how many coordinates it takes: an oracle, a PLR, or any with this attribute.

    Where configurations have more, it sees the leading ones: of ``(x, y, theta)`` a function of 2 sees ``(x, y)``.
    """

    @property
    def dim(self) -> int:
        """Coordinates a point, at least 1."""
        ...

    def __call__(self, x: Any, /) -> Any:
        """Its values at points."""
        ...


@runtime_checkable
class StackableDistanceFn(Protocol):
    """A distance function of a type whose functions can be called all at once, one a robot; a PLR is one."""

    def __call__(self, x: Any, /) -> Any:
        """Distances of points, as a :data:`DistanceFn`."""
        ...

    @staticmethod
    def stack(fns: Sequence[Any], /) -> Callable[[JointConfigurations], Float[np.ndarray, "n robots"]]:
        """One function for a team, of joint configurations ``(n, robots, dof)`` to distances ``(n, robots)``.

        Args:
            fns: One distance function a robot, all of this type.

        Returns:
            The function. What it answers for a robot is what that robot's function would answer.
        """
        ...


@runtime_checkable
class SeparableHeuristic(Protocol):
    """A heuristic that is a sum over robots: planners evaluate its terms once a robot's configuration."""

    def __call__(self, q: Any, /) -> Float[np.ndarray, "n"]:
        """The sum of the terms, as a :data:`HeuristicFn`."""
        ...

    def per_robot(self, q: Any, /) -> Float[np.ndarray, "n robots"]:
        """Its terms, of joint configurations ``(n, robots, dof)``, never NaN.

        Each may depend on its own robot's configuration alone.
        """
        ...
