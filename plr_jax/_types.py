"""Array aliases and the function types in which discovering, storing and using distance meet."""

from collections.abc import Callable
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

A distance function may say how many coordinates it takes (:class:`DimensionedFn`) and that it is one piece in each of
many boxes (:class:`PiecewiseFunction`). A type whose instances are distance functions may offer a static method
``stack(fns: Sequence[DistanceFn])`` that gives one function for a whole team, of joint configurations
``(n, robots, dof)`` to distances ``(n, robots)``; heuristics then call that.
"""

JointConfigurations: TypeAlias = Float[np.ndarray, "n robots dof"]
"""A batch of joint configurations on the host, one a row."""

HeuristicFn: TypeAlias = Callable[[JointConfigurations], Float[np.ndarray, "n"]]
"""Estimated cost-to-go of a batch of joint configurations, never NaN; ``inf`` where it has no estimate.

A heuristic that is a sum over robots may offer its terms as an attribute
``per_robot(q: (n, robots, dof)) -> (n, robots)``. Planners evaluate the terms once a robot's configuration
instead of once a joint one.
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
