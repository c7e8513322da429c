"""Array aliases and the function types in which discovering, storing and using distance meet."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

ArrayLike: TypeAlias = Any
"""Whatever ``numpy.asarray`` accepts; checked, with a clear error, where it comes in."""

Points: TypeAlias = Float[np.ndarray, "n dim"]
"""A batch of points (configurations) on the host, one a row."""

Distances: TypeAlias = Float[np.ndarray, "n"]
"""One distance a point, in workspace units; ``inf`` where the goal cannot be reached."""

DistanceFn: TypeAlias = Callable[[Points], Distances]
"""Distance to a goal for a batch of points.

``inf`` means that the goal cannot be reached from there: the point is cut off, in an obstacle, outside the domain or
the bounds. A masked entry of an answer means the same. An oracle never answers NaN or a negative number; where a
coordinate is NaN it answers ``inf``. A PLR approximates one: it may be a little below zero near the goal, answers
``inf`` outside its domain and NaN where a coordinate is NaN, and knows nothing of obstacles. Who uses a distance
function must cope with both.

What one may offer besides: :class:`DimensionedFn`, :class:`PiecewiseFunction`, :class:`StackableDistanceFn`,
:class:`CellwiseFn`, :class:`BoundingFn`, :class:`FreeSpaceFn`, :class:`SymmetricFn`.
"""

JointConfigurations: TypeAlias = Float[np.ndarray, "n robots dof"]
"""A batch of joint configurations on the host, one a row."""


@runtime_checkable
class DimensionedFn(Protocol):
    """A distance function that says how many coordinates it takes, as oracles and PLRs do.

    Of configurations of more coordinates it is shown the leading ``dim``, a function without ``dim`` all of them.
    """

    @property
    def dim(self) -> int: ...
    def __call__(self, x: ArrayLike, /) -> ArrayLike: ...


@runtime_checkable
class FunctionOfBox(Protocol):
    """A function of the points of a Box, its ``domain``."""

    @property
    def domain(self) -> Any: ...
    def __call__(self, x: ArrayLike, /) -> ArrayLike: ...


@runtime_checkable
class PiecewiseFunction(FunctionOfBox, Protocol):
    """A function that is one piece in each of many boxes, such as a PLR.

    The boxes fill the ``domain``; ``leaf_boxes`` are their lower and upper corners, ``(leaves, dim)`` each.
    """

    @property
    def leaf_boxes(self) -> tuple[ArrayLike, ArrayLike]: ...


@dataclass(frozen=True, eq=False)
class Sources:
    """Points that distances run through: the distance of a point is that of a source and the straight way to it.

    Attributes:
        points: Where they are.
        distances: Their own distances to the goal; ``inf`` for those that do not reach it.
        parents: The source that each one's shortest path goes to next; its own index for the goal, and for those that
            do not reach it.
    """

    points: Float[np.ndarray, "sources dim"]
    distances: Float[np.ndarray, "sources"]
    parents: Int[np.ndarray, "sources"]


CellSources: TypeAlias = Any
"""Which points the shortest paths from cells of the plane go to first: ``plr_jax.geometry.cell_sight.CellSources``.

Code that works without Shapely names the class by this alias.
"""


@runtime_checkable
class FamilyFn(Protocol):
    """A distance function that answers for whole cells, at once for several of the same kind: they are a family."""

    @property
    def family(self) -> Any:
        """An object that is the same for all functions of a family, and for no other."""
        ...

    def shared_cells(self, domain: Any, lo: Any, hi: Any, /) -> Any:
        """What all of a family share of some boxes in a domain."""
        ...

    @staticmethod
    def family_sources(shared: Any, fns: Sequence[Any], /) -> Any:
        """Sources of these boxes for some of a family.

        Returns:
            The distinct ones as ``FamilySources``, their keys, and which of them each box is for each
            function, ``(fns, boxes)``, -1 where nothing reaches the goal.
        """
        ...

    @property
    def sources(self) -> Sources:
        """The goal, then the corners."""
        ...

    def cell_sources(self, domain: Any, /) -> CellSources: ...
    def __call__(self, x: ArrayLike, /) -> ArrayLike: ...


@runtime_checkable
class CellwiseFn(Protocol):
    """A distance function in the plane that answers for whole cells, without samples."""

    def cell_sources(self, domain: Any, /) -> CellSources:
        """Those of a Box as one cell."""
        ...

    def __call__(self, x: ArrayLike, /) -> ArrayLike: ...


@runtime_checkable
class ChangingFn(CellwiseFn, Protocol):
    """A distance function in the plane that says how it differs from the one before its map changed."""

    @property
    def sources(self) -> Sources: ...

    def sources_of_boxes(self, lo: Float[np.ndarray, "cells 2"], hi: Float[np.ndarray, "cells 2"], /) -> CellSources:
        """Those of boxes as cells, whatever the boxes are parts of."""
        ...

    def changed_since(self, before: Any, /) -> Any:
        """How distances have changed: a ``ChangedDistances``; ``ValueError`` if they cannot be compared."""
        ...


@runtime_checkable
class FreeSpaceFn(Protocol):
    """A distance function that says which points are free, so that those can be told that do not reach the goal."""

    def is_free(self, x: ArrayLike, /) -> Bool[np.ndarray, "n"]: ...
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
class BoundingFn(Protocol):
    """A distance function, or a heuristic, that says whether it is a lower bound: nowhere above the truth."""

    @property
    def is_lower_bound(self) -> bool: ...
    def __call__(self, x: Any, /) -> ArrayLike: ...


@dataclass(frozen=True, eq=False)
class Symmetry:
    """An affine map of points that keeps the lengths between them: ``x`` to ``matrix @ x + offset``.

    Attributes:
        matrix: An orthogonal matrix.
        offset: What is added; where a coordinate is an angle, the sum is one modulo a whole turn.
    """

    matrix: Float[np.ndarray, "dim dim"]
    offset: Float[np.ndarray, "dim"]

    @classmethod
    def about(cls, point: Float[np.ndarray, "dim"], matrix: Float[np.ndarray, "dim dim"]) -> "Symmetry":
        """That with a matrix which leaves a point where it is."""
        return cls(matrix, point - matrix @ point)


@runtime_checkable
class SymmetricFn(Protocol):
    """A distance function that states symmetries: the distance of a point is that of its image, up to rounding.

    They are generators: one after the other, in any order, they are symmetries as well.
    """

    @property
    def symmetries(self) -> Sequence[Symmetry]: ...
    def __call__(self, x: ArrayLike, /) -> ArrayLike: ...


@runtime_checkable
class HeuristicFn(Protocol):
    """Estimated cost-to-go, a sum over robots: planners evaluate its terms once a robot's configuration.

    Never NaN; ``inf``, or masked, where it has no estimate. It may be a :class:`BoundingFn` besides.
    """

    def __call__(self, q: Any, /) -> Float[np.ndarray, "n"]:
        """The sum of the terms, of a batch of joint configurations ``(n, robots, dof)``."""
        ...

    def per_robot(self, q: Any, /) -> Float[np.ndarray, "n robots"]:
        """Its terms, of joint configurations ``(n, robots, dof)``, never NaN.

        Each may depend on its own robot's configuration alone.
        """
        ...
