"""Types by which oracles, PLRs and planners work together: arrays, protocols of distance functions, and their data.

Each line of this table names a protocol, some classes that have its members, and functions that use these members::

    DimensionedFn         oracles, PLR                      NearestGoal, sum_of_distances
    FunctionOfBox         PLR                               plot
    PiecewiseFunction     PLR                               plot
    CellwiseFn            VisibilityGraph, NearestGoal      construct, certify
    FamilyFn              VisibilityGraph                   construct_many
    NearestFn             NearestGoal                       construct
    ReachFn               VisibilityGraph, Roadmap          construct
    StackableDistanceFn   PLR, LowerBound                   sum_of_distances
    BoundingFn            Euclidean, LowerBound             bl_plan, sum_of_distances
    SymmetricFn           Euclidean, ReedsShepp             construct
    HeuristicFn           SumOverRobots                     bl_plan

``isinstance(x, Protocol)`` tests only whether ``x`` has members with the protocol's names. So a ``NearestGoal`` is
always a ``CellwiseFn``, but its ``cell_sources`` is None unless all its functions are VisibilityGraphs of one map.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

ArrayLike: TypeAlias = Any  # anything that numpy.asarray accepts; public functions check it
Points: TypeAlias = Float[np.ndarray, "n dim"]
Numbers: TypeAlias = Float[np.ndarray, " n"]
Distances: TypeAlias = Float[np.ndarray, " n"]  # inf where the goal cannot be reached
JointConfigurations: TypeAlias = Float[np.ndarray, "n robots dof"]
DistanceFn: TypeAlias = Callable[[Points], Distances]
"""A function from points ``(n, dim)`` to distances ``(n,)`` to a goal.

``inf``, or a masked entry, means that the goal cannot be reached: the point is disconnected from it, in an obstacle,
or outside the bounds. An oracle never returns NaN or negative numbers; it returns ``inf`` where a coordinate is NaN.
A PLR may be slightly negative near the goal, returns ``inf`` outside its domain and NaN where a coordinate is NaN,
and ignores obstacles. Users of a distance function must handle the answers of both.
"""


class _PointFn(Protocol):
    """A function that is called with one array of points, ``(n, dim)``."""

    def __call__(self, x: ArrayLike, /) -> ArrayLike: ...


@runtime_checkable
class DimensionedFn(_PointFn, Protocol):
    """A distance function of points with ``dim`` coordinates.

    Callers with longer configurations pass the first ``dim`` coordinates.
    """

    @property
    def dim(self) -> int: ...


@runtime_checkable
class FunctionOfBox(_PointFn, Protocol):
    """A function with an attribute ``domain``: the :class:`Box` of points at which the function is defined."""

    @property
    def domain(self) -> Any: ...


@runtime_checkable
class PiecewiseFunction(FunctionOfBox, Protocol):
    """A function, such as a PLR, that is defined box by box.

    ``leaf_boxes`` is a pair of arrays, ``(n, dim)`` each: the lower and the upper corner of each of the ``n`` boxes.
    """

    @property
    def leaf_boxes(self) -> tuple[ArrayLike, ArrayLike]: ...


@dataclass(frozen=True, eq=False)
class Sources:
    """The *sources* of a distance function: goals, and the points where shortest paths to the nearest goal may turn.

    The first segment of any shortest path ends at a source. Sources that reach a goal and are their own parents are
    called *roots*. A root is a goal, or a place such as the foot of a flight of stairs, from which the path jumps to
    another source, the root's *exit*. Without ``exits``, sources at one place must have equal distances, so that
    files may merge them.
    """

    points: Float[np.ndarray, "sources dim"]
    distances: Float[np.ndarray, " sources"]  # to the nearest goal; inf if no goal can be reached
    parents: Int[np.ndarray, " sources"]  # next source on the path; itself for a root and if unreachable
    # The number of each root, such as the index of its goal; -1 for other sources. None: there is one goal.
    root_numbers: Int[np.ndarray, " sources"] | None = None
    exits: Int[np.ndarray, " sources"] | None = None  # itself for goals and other sources. None: all roots are goals

    @staticmethod
    def of_graph(points: Points, distances: Distances, parents: Int[np.ndarray, " v"], *roots: Any) -> "Sources":
        """Return the vertices of a graph as :class:`Sources`; ``parents`` are negative where there is no next vertex.

        The optional arguments ``roots`` are the fields ``root_numbers`` and ``exits`` of the result.
        """
        return Sources(points, distances, np.where(parents < 0, np.arange(len(parents)), parents), *roots)


CellSources: TypeAlias = Any  # plr_jax.geometry.cell_sight.CellSources, without its imports


@runtime_checkable
class CellwiseFn(_PointFn, Protocol):
    """A distance function in the plane that knows where shortest paths from the points of a box may turn first.

    ``cell_sources(domain)`` divides the free space in the box ``domain`` into convex pieces, and returns for each
    piece the points where paths from it may turn first. ``cell_sources`` is None if the function has no such answer.
    """

    @property
    def cell_sources(self) -> Callable[[Any], CellSources] | None: ...


@runtime_checkable
class FamilyFn(CellwiseFn, Protocol):
    """A distance function that shares work with its *family*: the distance functions to other goals on the map."""

    @property
    def family(self) -> Any: ...  # the corners and what they see: one object for all members
    @property
    def sources(self) -> Sources: ...

    # Return a free sample point in each box, and the corners that it sees. Neither depends on the goal.
    def shared_samples(self, lo: Any, hi: Any, /) -> Any: ...

    # Return, for each sample, its distance to the goal, and the index in `sources` of the first vertex of its path.
    def first_turns(self, samples: Any, /) -> Any: ...

    # Return the convex pieces of free space in each box, and the corners where paths from each piece may turn first.
    # Neither depends on the goal.
    def shared_cells(self, lo: Any, hi: Any, /) -> Any: ...

    # Return `cell_sources` for pairs of a box and a function: box number `box[i]` of `shared`, `members[member[i]]`.
    def cells_of_members(self, shared: Any, members: Sequence[Any], box: Any, member: Any, /) -> CellSources: ...


@runtime_checkable
class NearestFn(CellwiseFn, Protocol):
    """A distance function in the plane to the nearest of several goals.

    ``which`` returns the index of the nearest goal for each point; -1 if no goal can be reached.
    """

    def which(self, x: ArrayLike, /) -> Int[np.ndarray, " n"]: ...


# Cut-off points are *far* if they are farther than this from points that reach the goal, in widths of the domain.
FAR_AWAY = 1 / 64
_GROWN = 2.0**-21  # share of the domain by which rounding may place points outside of their box in a query
_SHRUNK = 1e-9  # share of the domain by which boxes are shrunk, so that they do not meet what only touches them
_NUM_REACH_BOXES = 1024  # about so many equal boxes show which share of free space is cut off
Fractions: TypeAlias = Float[np.ndarray, "boxes dim"]
BoxTest: TypeAlias = Callable[[Fractions, Fractions], Bool[np.ndarray, " boxes"]]


@dataclass(frozen=True, eq=False)
class Reach:
    """Tests whether boxes in a domain contain points that *reach* a goal, or *cut-off* points.

    A point reaches the goal if a free path leads from the point to the goal. A free point without such a path is cut
    off. Each test returns a bool for each box. ``Workspace.reach`` makes exact tests for polygons, ``reach_of_cells``
    makes tests for the cells of a grid.

    Boxes are given by their lower corners ``lo`` and upper corners ``hi``, ``(boxes, dim)``, as fractions of the
    domain: from 0 to 1 along each axis.

    Attributes:
        reached: Whether each box holds a point that reaches the goal.
        cut_off: Whether each box holds a cut-off point.
        far: Whether each box holds a cut-off point farther than 1/64 from all points that reach the goal, where 1 is
            the width of the domain along each axis. For a grid of cells: whether the box may hold such a point.
    """

    reached: BoxTest
    cut_off: BoxTest
    far: BoxTest

    def is_cut_off(self, lo: Fractions, hi: Fractions) -> Bool[np.ndarray, " boxes"]:
        """Return whether each box holds a cut-off point, but no point that reaches the goal.

        The box in which no point may reach the goal is slightly larger, because a query rounds points.
        """
        # Rounding may place points just outside of a box inside.
        holds = self.cut_off(lo + _SHRUNK, hi - _SHRUNK)
        holds[holds] = ~self.reached(lo[holds] - _GROWN, hi[holds] + _GROWN)
        return holds

    def is_border(self, lo: Fractions, hi: Fractions) -> Bool[np.ndarray, " boxes"]:
        """Return whether each box holds a point that reaches the goal, and a cut-off point far from it (``far``).

        The result is False for boxes with a diagonal of at most 1/64, in fractions of the domain.
        """
        holds = self.far(lo + _SHRUNK, hi - _SHRUNK) & (np.linalg.norm(hi - lo, axis=1) > FAR_AWAY)
        holds[holds] = self.reached(lo[holds] - _GROWN, hi[holds] + _GROWN)
        return holds

    def holds_reached(self, lo: Fractions, hi: Fractions) -> Bool[np.ndarray, " boxes"]:
        """Return whether the interior of each box holds a point that reaches the goal."""
        return self.reached(lo + _SHRUNK, hi - _SHRUNK)

    def cut_off_fraction(self, dim: int) -> float:
        """Estimate the share of free space that is cut off, from 0 to 1, in a domain of ``dim`` dimensions."""
        # Count the boxes of a lattice that hold reached points, and the boxes that hold cut-off points.
        num = round(_NUM_REACH_BOXES ** (1 / dim))
        lo = np.array(list(product(range(num), repeat=dim))) / num
        reached = np.count_nonzero(self.reached(lo, lo + 1 / num))
        cut_off = np.count_nonzero(self.cut_off(lo, lo + 1 / num))
        return cut_off / max(reached + cut_off, 1)


@runtime_checkable
class ReachFn(_PointFn, Protocol):
    """A distance function that knows which boxes hold free points from which the goal cannot be reached."""

    def reach(self, domain: Any, /) -> Reach | None: ...  # None if all free points reach the goal


@runtime_checkable
class StackableDistanceFn(_PointFn, Protocol):
    """A distance function, such as a PLR, with a static method ``stack`` that combines one function per robot.

    The combined function maps joint configurations to each robot's own distance.
    """

    @staticmethod
    def stack(fns: Sequence[Any], /) -> Callable[[JointConfigurations], Float[np.ndarray, "n robots"]]: ...


@runtime_checkable
class BoundingFn(_PointFn, Protocol):
    """A distance function or heuristic that states whether it is a proven lower bound of the true cost-to-go."""

    @property
    def is_lower_bound(self) -> bool: ...


@dataclass(frozen=True, eq=False)
class Symmetry:
    """An isometry ``x -> matrix @ x + offset`` of points; results that are angles are taken modulo a full turn."""

    matrix: Float[np.ndarray, "dim dim"]
    offset: Float[np.ndarray, " dim"]

    @classmethod
    def about(cls, point: Float[np.ndarray, " dim"], matrix: Float[np.ndarray, "dim dim"]) -> "Symmetry":
        """Return the isometry with the given ``matrix`` that maps ``point`` to itself."""
        return cls(matrix, point - matrix @ point)


@runtime_checkable
class SymmetricFn(_PointFn, Protocol):
    """A distance function with known symmetries: a point and its image under a symmetry have equal distances."""

    @property
    def symmetries(self) -> Sequence[Symmetry]: ...


@runtime_checkable
class HeuristicFn(Protocol):
    """An estimate of the cost-to-go of joint configurations ``(n, robots, dof)``: a sum of one term per robot.

    The estimate is never NaN; ``inf`` or a masked entry means that there is no estimate. Planners evaluate a robot's
    term only once per configuration of this robot. A heuristic may also be a :class:`BoundingFn`.
    """

    def __call__(self, q: Any, /) -> Float[np.ndarray, " n"]:
        """Return the estimates, ``(n,)``, for joint configurations ``(n, robots, dof)``."""
        ...

    def per_robot(self, q: Any, /) -> Float[np.ndarray, "n robots"]:
        """Return each robot's term of the sum. The term depends only on the configuration of this robot."""
        ...
