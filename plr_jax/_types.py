"""Array aliases and the function types in which discovering, storing and using distance meet."""

from collections.abc import Callable
from typing import Any, TypeAlias

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

A distance function may say by an attribute ``dim`` how many coordinates it takes. A type whose instances are distance
functions may offer a static method ``stack(fns: Sequence[DistanceFn])`` that gives one function for a whole team, of
joint configurations ``(n, robots, dof)`` to distances ``(n, robots)``; heuristics then call that.
"""

JointConfigurations: TypeAlias = Float[np.ndarray, "n robots dof"]
"""A batch of joint configurations on the host, one a row."""

HeuristicFn: TypeAlias = Callable[[JointConfigurations], Float[np.ndarray, "n"]]
"""Estimated cost-to-go of a batch of joint configurations, never NaN; ``inf`` where it has no estimate.

A heuristic that is a sum over robots may offer its terms as an attribute
``per_robot(q: (n, robots, dof)) -> (n, robots)``. Planners evaluate the terms once a robot's configuration
instead of once a joint one.
"""
