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
"""Distance to a goal for a batch of points.

``inf`` means that the goal cannot be reached from there: the point is cut off, in an obstacle, outside the domain or
the bounds. An oracle never answers NaN or a negative number; where a coordinate is NaN it answers ``inf``. A PLR
approximates one: it may be a little below zero near the goal, answers ``inf`` outside its domain and NaN where a
coordinate is NaN, and knows nothing of obstacles. Who uses a distance function must cope with both.

What one may offer besides: :class:`DimensionedFn`, :class:`PiecewiseFunction`, :class:`StackableDistanceFn`.
"""

JointConfigurations: TypeAlias = Float[np.ndarray, "n robots dof"]
"""A batch of joint configurations on the host, one a row."""

HeuristicFn: TypeAlias = Callable[[JointConfigurations], Float[np.ndarray, "n"]]
"""Estimated cost-to-go of a batch of joint configurations, never NaN; ``inf`` where it has no estimate.

What one may offer besides: :class:`SeparableHeuristic`.
"""


@runtime_checkable
class DimensionedFn(Protocol):
    """A distance function that says how many coordinates it takes, as oracles and PLRs do.

    Of configurations of more coordinates it is shown the leading ``dim``, a function without ``dim`` all of them.
    """

    @property
    def dim(self) -> int: ...
    def __call__(self, x: ArrayLike, /) -> ArrayLike: ...


@runtime_checkable
class PiecewiseFunction(Protocol):
    """A function that is one piece in each of many boxes, such as a PLR.

    ``domain`` is the Box that the boxes fill, ``leaf_boxes`` their lower and upper corners, ``(leaves, dim)`` each.
    """

    @property
    def domain(self) -> Any: ...
    @property
    def leaf_boxes(self) -> tuple[ArrayLike, ArrayLike]: ...
    def __call__(self, x: ArrayLike, /) -> ArrayLike: ...


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
