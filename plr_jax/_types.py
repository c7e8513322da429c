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
"""
