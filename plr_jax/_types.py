"""Array types, and protocols of functions, by which oracles, PLRs and planners work together."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

ArrayLike: TypeAlias = Any
"""Anything that ``numpy.asarray`` accepts; public functions check it."""

Points: TypeAlias = Float[np.ndarray, "n dim"]
"""A batch of points (configurations) on the host, one per row."""

Distances: TypeAlias = Float[np.ndarray, "n"]
"""One distance per point, in workspace units; ``inf`` where the goal cannot be reached."""

DistanceFn: TypeAlias = Callable[[Points], Distances]
"""A function from points ``(n, dim)`` to distances ``(n,)`` to a goal.

``inf``, or a masked entry, means that the goal cannot be reached: the point is disconnected from it, in an obstacle,
or outside the bounds. An oracle never returns NaN or negative numbers; it returns ``inf`` where a coordinate is NaN.
A PLR may be slightly negative near the goal, returns ``inf`` outside its domain and NaN where a coordinate is NaN,
and ignores obstacles. Users of a distance function must handle both.

Optional protocols: :class:`DimensionedFn`, :class:`PiecewiseFunction`, :class:`StackableDistanceFn`,
:class:`CellwiseFn`, :class:`BoundingFn`, :class:`FreeSpaceFn`, :class:`SymmetricFn`.
"""

JointConfigurations: TypeAlias = Float[np.ndarray, "n robots dof"]
"""A batch of joint configurations on the host, one per row."""


@runtime_checkable
class DimensionedFn(Protocol):
    """A distance function of ``dim`` coordinates; callers with longer configurations pass the leading ones."""

    @property
    def dim(self) -> int: ...
    def __call__(self, x: ArrayLike, /) -> ArrayLike: ...


@runtime_checkable
class FunctionOfBox(Protocol):
    """A function of the points in a :class:`Box`, its ``domain``."""

    @property
    def domain(self) -> Any: ...
    def __call__(self, x: ArrayLike, /) -> ArrayLike: ...


@runtime_checkable
class PiecewiseFunction(FunctionOfBox, Protocol):
    """A function, such as a PLR, defined box by box; ``leaf_boxes``: their lower and upper corners, ``(n, dim)``."""

    @property
    def leaf_boxes(self) -> tuple[ArrayLike, ArrayLike]: ...


@dataclass(frozen=True, eq=False)
class Sources:
    """The goal, and the points where shortest paths to it may turn; any path goes straight to one, its *source*.

    A point's distance is the distance to its source plus the source's distance to the goal.

    Attributes:
        distances: Distances of the sources to the goal; ``inf`` where the goal cannot be reached.
        parents: Next source on each source's shortest path; its own index for the goal and for unreachable sources.
    """

    points: Float[np.ndarray, "sources dim"]
    distances: Float[np.ndarray, "sources"]
    parents: Int[np.ndarray, "sources"]


CellSources: TypeAlias = Any
"""``plr_jax.geometry.cell_sight.CellSources``: the first turns (or goal) on shortest paths from cells of the plane.

This alias lets code without Shapely name the class.
"""


@runtime_checkable
class FamilyFn(Protocol):
    """A distance function that can share work on cells with a family of functions, such as other goals on its map."""

    @property
    def family(self) -> Any:
        """An object that identifies the family: the same for all its functions, and for no others."""
        ...

    def shared_samples(self, lo: Any, hi: Any, /) -> Any:
        """Return a sample of free space in each of several boxes, for all functions of the family."""
        ...

    def first_turns(self, samples: Any, /) -> Any:
        """Return each sample's distance, and the index in ``sources`` of its path's first vertex; or inf and -1."""
        ...

    def shared_cells(self, lo: Any, hi: Any, /) -> Any:
        """Return boxes' free convex pieces, and the corners that paths from each to any goal may turn at first."""
        ...

    def cells_of_members(
        self, shared: Any, members: Sequence[Any], box: Any, member: Any, near: Any, /
    ) -> CellSources:
        """Return the sources of cells for several functions of the family.

        Cell ``i`` is box ``box[i]`` of the shared cells, for ``members[member[i]]``. Its paths go first to about
        ``near[i]``, an index in that function's ``sources``; -1 if unknown.
        """
        ...

    @property
    def sources(self) -> Sources:
        """The goal, followed by the corners where paths may turn."""
        ...

    def cell_sources(self, domain: Any, /) -> CellSources: ...
    def __call__(self, x: ArrayLike, /) -> ArrayLike: ...


@runtime_checkable
class CellwiseFn(Protocol):
    """A distance function in the plane that knows where paths from any point of a cell may turn first."""

    def cell_sources(self, domain: Any, /) -> CellSources:
        """Return, for a Box taken as one cell, its sources: the goal or corners to which paths may go straight."""
        ...

    def __call__(self, x: ArrayLike, /) -> ArrayLike: ...


@runtime_checkable
class ChangingFn(CellwiseFn, Protocol):
    """A distance function in the plane that can compare itself with its version before the map changed."""

    @property
    def sources(self) -> Sources: ...

    def sources_of_boxes(self, lo: Float[np.ndarray, "cells 2"], hi: Float[np.ndarray, "cells 2"], /) -> CellSources:
        """Return, for each box, its sources: the goal or corners to which paths from there may go straight."""
        ...

    def changed_since(self, before: Any, /) -> Any:
        """Return how distances changed since ``before``, an older function; ``ValueError`` if not comparable."""
        ...


@runtime_checkable
class FreeSpaceFn(Protocol):
    """A distance function with a test ``is_free``: a point of distance ``inf`` may be free, but without a path."""

    def is_free(self, x: ArrayLike, /) -> Bool[np.ndarray, "n"]: ...
    def __call__(self, x: ArrayLike, /) -> ArrayLike: ...


@runtime_checkable
class StackableDistanceFn(Protocol):
    """A distance function, such as a PLR, whose class can combine several of them into one function for a team."""

    def __call__(self, x: Any, /) -> Any:
        """Return distances of points, as a :data:`DistanceFn`."""
        ...

    @staticmethod
    def stack(fns: Sequence[Any], /) -> Callable[[JointConfigurations], Float[np.ndarray, "n robots"]]:
        """Combine one function per robot: map joint configurations ``(n, robots, dof)`` to ``(n, robots)``."""
        ...


@runtime_checkable
class BoundingFn(Protocol):
    """A distance function or heuristic that states whether it is proven never to exceed the true value."""

    @property
    def is_lower_bound(self) -> bool: ...
    def __call__(self, x: Any, /) -> ArrayLike: ...


@dataclass(frozen=True, eq=False)
class Symmetry:
    """An isometry ``x -> matrix @ x + offset``; coordinates that are angles count modulo a full turn."""

    matrix: Float[np.ndarray, "dim dim"]
    offset: Float[np.ndarray, "dim"]

    @classmethod
    def about(cls, point: Float[np.ndarray, "dim"], matrix: Float[np.ndarray, "dim dim"]) -> "Symmetry":
        """Return the isometry with the given matrix that leaves the given point fixed."""
        return cls(matrix, point - matrix @ point)


@runtime_checkable
class SymmetricFn(Protocol):
    """A distance function with known symmetries: a point and its image under them have equal distances."""

    @property
    def symmetries(self) -> Sequence[Symmetry]: ...
    def __call__(self, x: ArrayLike, /) -> ArrayLike: ...


@runtime_checkable
class HeuristicFn(Protocol):
    """An estimate of the cost-to-go of joint configurations: a sum of one term per robot.

    It is never NaN; ``inf`` or a masked entry means that there is no estimate. Planners evaluate each term only once
    per configuration of its robot. A heuristic may also be a :class:`BoundingFn`.
    """

    def __call__(self, q: Any, /) -> Float[np.ndarray, "n"]:
        """Return the sum of the terms, ``(n,)``, for joint configurations ``(n, robots, dof)``."""
        ...

    def per_robot(self, q: Any, /) -> Float[np.ndarray, "n robots"]:
        """Return the terms, ``(n, robots)``; each depends only on its own robot's configuration."""
        ...
