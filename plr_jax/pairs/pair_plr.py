"""PairPLR: distances between any two points of a planar workspace, stored in one file.

:func:`construct_pairs` builds the file (``construct.py``), and ``stored.py`` reads it. A call of a :class:`PairPLR`
makes points relative to the middle of the domain, so that rounding loses less, then answers in one of three ways::

    few pairs               NumPy, without compiling                               NumpyPairs (portable.py)
    many pairs              compiled code, block by block on all cores             _distances
    traced points or file   the same code as a part of the caller's computation    _distances

:func:`_distances` handles points outside the domain, finds shortest paths by ``query.py``, and makes their lengths
differentiable. Goals with known distances to all corners (*prepared* goals) and bounds are answered likewise.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial, reduce
from math import prod
from typing import TYPE_CHECKING, Any, overload

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from plr_jax._arrays import as_finite_point, as_queries, is_traced
from plr_jax._compiled import answered_in_parts, broadcast_shape, is_on_one_host, serializable
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.pairs.one_goal import plr_to
from plr_jax.pairs.portable import ENDS, SHRUNK, STRETCHED, NumpyPairs, js_pairs_module, point_rounding
from plr_jax.pairs.query import PreparedGoals, distances_to_corners, is_inside, shortest_ways
from plr_jax.pairs.stored import PairsFileData
from plr_jax.pairs.tables import PairTables, build_pair_tables, table_size
from plr_jax.plr._plr import PLR
from plr_jax.plr.container import FileBacked, padded_file
from plr_jax.plr.frame import Outside, as_outside, require_resolved, unresolved_types
from plr_jax.plr.query import length_of

if TYPE_CHECKING:
    from plr_jax.buildings import Building
    from plr_jax.geometry.workspace import Workspace
    from plr_jax.pairs.building_pairs import BuildingPairs


_BLOCKS = (2**10, 2**14)  # pairs in a block of compiled code: in small and in large batches
_FEW_TESTS = 2**18  # most pairs times walls that NumPy answers: at most about as slowly as a compiled block
_PAIRS_A_GOAL = 8  # pairs that NumPy answers in about the time in which it prepares a goal
Lengths = Float[Array, "*batch"]
_Points = Float[Array, "*batch 2"]
_Fn = Callable[..., Any]


@serializable
@jax.tree_util.register_pytree_with_keys_class
@dataclass(frozen=True, eq=False)
class PairPLR(FileBacked):
    """Distances between any two points of a planar workspace, made by :func:`construct_pairs` or :func:`load`.

    It is a pytree of arrays: jitted functions can close over it or take it as an argument. Its ``file`` is an array
    of bytes, padded with zeros to a power of two; the last four bytes are the size without padding.
    """

    file: UInt8[Array, " padded"] | UInt8[np.ndarray, " padded"]
    _known_stored: PairsFileData | None = field(default=None, repr=False)

    @cached_property
    def tables(self) -> PairTables:
        """The tables that a query reads, built from the file on first use; many times as large as the file."""
        with jax.ensure_compile_time_eval():  # also inside a traced function
            return build_pair_tables(self.stored, self.table_class)

    def __call__(self, x: ArrayLike, y: ArrayLike | PreparedGoals, *, outside: Outside = "inf") -> Lengths:
        """Return the distance between points, ``(...)``: the length of the shortest path in free space.

        The distance is ``inf`` without a path, NaN for NaN, 0 for ``x == y``, and meaningless for points in
        obstacles. ``pairs(x, y) == pairs(y, x)`` to the last bit. Distances are 32-bit floats; with
        ``jax_enable_x64``, 64-bit points give 64-bit floats, though positions of corners still have 32 bits. If the
        domain is far from the origin, pass points as :func:`evaluate` says. Outside of ``jit``, NumPy answers a small
        batch (pairs times walls up to 2**18) without compiling; such answers differ by rounding from the answers of
        compiled functions. The call works under ``jax.jit``, ``jax.vmap`` and ``jax.grad`` in both arguments. The
        gradient by a point is the unit vector that points away from the first turn of the path from this point. It is
        zero where the distance is 0 or ``inf``.

        Args:
            x: Points, ``(..., 2)``, NumPy or JAX, real, else ``ValueError``.
            y: Points whose shape broadcasts with ``x``; or goals made by :meth:`prepared`, whose batch broadcasts.
            outside: Answer for points outside the domain, as for :func:`evaluate`. ``"clamp"`` moves each such point
                to the nearest point of the domain, and adds the length of this move to the distance.
        """
        outside = as_outside(outside)
        x, ends, batch = self._from_middle_and_batch(x, y)
        if not isinstance(y, PreparedGoals):
            in_numpy = partial(NumpyPairs._distances_between, outside=outside)
            return self._answer(batch, partial(_distances, outside=outside), in_numpy, x, ends)[0]
        in_numpy = partial(NumpyPairs._distances_to, outside=outside)
        return self._answer(batch, partial(_to_goals, goals=y, outside=outside), in_numpy, x, goals=y)[0]

    def prepared(self, goals: ArrayLike) -> PreparedGoals:
        """Compute the distances of goals ``(..., 2)`` to all corners, for use as second points of many calls.

        Large batches then take less time. The result takes 4 bytes per goal and corner. The method works under
        ``jax.jit`` and ``jax.vmap``. Distances to prepared goals differ by rounding from distances to plain points,
        and have no gradient in the goals, which have 32 bits. With ``outside="clamp"``, distances are still ``inf``
        to a goal outside the domain. Use the result only with the same PairPLR. ``ValueError`` as for a call.
        """
        self._require_no_links("Distances to prepared goals")
        goals = self._from_middle("goals", goals)
        # 1. Few goals: NumPy compiles nothing.
        if is_on_one_host(goals, self.file) and self._are_few(_PAIRS_A_GOAL * prod(goals.shape[:-1])):
            with np.errstate(over="ignore"):  # goals far outside
                points = goals.astype(np.float32)
            to_corners = self._numpy._to_corners(points.reshape(-1, 2), self._table_size)
            to_corners = jnp.asarray(to_corners.reshape(*goals.shape[:-1], self._table_size))
            return PreparedGoals(jnp.asarray(points), to_corners)
        # 2. Many or traced goals: compiled code.
        points = jnp.asarray(goals, jnp.float32)
        (inside,), shape, _ = _checked(self.tables, points)
        to_corners = distances_to_corners(self.tables, jax.lax.stop_gradient(inside))
        return PreparedGoals(points, to_corners.reshape(*shape, len(self.tables.distances)))

    def bounds(self, x: ArrayLike, y: ArrayLike | PreparedGoals) -> tuple[Lengths, Lengths]:
        """Return proven lower and upper bounds, ``(...)`` each, of the distance between points of free space.

        Points, goals and errors are as for a call, but prepared goals save no time. The proof includes rounding of
        the file and of the query. It holds for points of ``Workspace.free_space``, walls included, but not for points
        that count as free only because of the workspace's tolerance. Upper bounds are lengths of certainly free
        paths; ``inf`` if none was found, as from points on a wall or within 4e-6 domain widths of a wall.

        Lower bounds are at least 0. They are an admissible heuristic of A*, but beside walls, and by rounding, not a
        consistent one: A* must reopen a node when it finds a shorter path to that node.
        """
        x, ends, batch = self._from_middle_and_batch(x, y)
        return self._answer(batch, _bounds, NumpyPairs._bounds_between, x, ends)

    def to(self, goal: ArrayLike) -> PLR:
        """Return the distance to one goal, a point ``(2,)`` of the domain, as an ordinary PLR of cones.

        Nothing is proven about the result: use :func:`certify`. Inside ``jit``, call the pairs with ``y=goal``
        instead. ``ValueError`` if the goal is not two finite numbers, is outside the domain, or cannot be reached.
        """
        goal = as_finite_point("The goal", self.domain.settled(goal), 2)
        if not self.domain.contains(goal[None])[0]:
            raise ValueError(f"The goal must be in the domain {self.domain}, got {goal.tolist()}: move it inside.")
        to_corners = np.asarray(self.prepared(goal).to_corners, np.float64)[: self.num_corners]
        return plr_to(self.stored, self, to_corners, goal)

    def numpy(self) -> NumpyPairs:
        """Return a function of two points that computes the distances in NumPy, without JAX.

        ``pairs/FORMAT.md`` defines the function's answers bit for bit. The answers of compiled functions differ by
        rounding.
        """
        return self._numpy

    def js_module(self) -> str:
        """Return the text of a JavaScript module that contains the file, answers its queries, and imports nothing.

        The module exports functions of two points, arrays of two numbers: ``distance(x, y)``; ``waypoint(x, y)``, the
        first turn of the path from ``x`` to ``y``; and ``bounds(x, y)``. Answers equal those of :meth:`numpy` bit for
        bit.
        """
        self._require_no_links("JavaScript")
        return js_pairs_module(self.to_bytes(), self.domain)

    def _require_no_links(self, name: str) -> None:
        if self.tables.has_arcs:
            raise ValueError(f"{name} cannot take links of a building: use the BuildingPairs, or a PLR of each goal.")

    def _answer(
        self, batch: tuple[int, ...], compiled: _Fn, in_numpy: _Fn, *points: Any, goals: PreparedGoals | None = None
    ) -> Any:
        """Return answers for a batch of pairs: ``in_numpy`` for few pairs, else by the ``compiled`` function."""
        # 1. NumPy takes the columns of prepared goals. The compiled function has them, and takes the index of each
        #    goal: so the parts of a batch share the goals.
        columns, index = (), ()
        if goals is not None:
            columns, shape = (goals.points, goals.to_corners), goals.points.shape[:-1]
            index = (np.arange(prod(shape), dtype=np.uint32).reshape(*shape, 1),)
        # 2. Inside a traced function, or with arrays on a device, the computation stays there.
        if not is_on_one_host(*points, *columns, self.file):
            return compiled(self.tables, *points, *index)
        # 3. Else answer few pairs in NumPy, which takes a row per pair, and many pairs on all cores.
        dtype = jax.dtypes.canonicalize_dtype(_floats_of(*points))
        with np.errstate(over="ignore"):  # points far outside
            points = tuple(np.asarray(p, dtype) for p in points)
        if self._are_few(prod(batch)):
            # Broadcast all axes but the last one to the batch, and flatten these.
            whole = (np.broadcast_to(column, (*batch, column.shape[-1])) for column in (*points, *columns))
            rows = (column.reshape(-1, column.shape[-1]) for column in whole)
            answers = np.atleast_2d(in_numpy(self._numpy, *rows))
        else:
            answers = answered_in_parts(partial(compiled, self.tables), _BLOCKS, *points, *index)
        # Unlike `jnp.asarray`, `device_put` compiles nothing.
        return tuple(jax.device_put(answer.reshape(batch)) for answer in answers)

    def _are_few(self, pairs: int) -> bool:
        return pairs * len(self.stored.outline.points) <= _FEW_TESTS

    @cached_property
    def _numpy(self) -> NumpyPairs:
        self.require_arrays_of_file()
        return NumpyPairs(self.stored)

    @property
    def _table_size(self) -> int:
        return len(self.tables.distances) if is_traced(self.file) else table_size(self.num_corners)

    def _from_middle_and_batch(self, x: ArrayLike, y: ArrayLike | PreparedGoals) -> tuple[Any, Any, tuple[int, ...]]:
        """Return points and second points or goals, relative to the middle of the domain, and the batch's shape."""
        x = self._from_middle("x", x)
        if not isinstance(y, PreparedGoals):
            y = self._from_middle("y", y)
            return x, y, broadcast_shape("x and y", x, y)[:-1]
        batch = broadcast_shape("x and goals", x, y.points)[:-1]
        if (size := y.to_corners.shape[-1]) != (corners := self._table_size):
            expected = f"Goals must have been prepared by these pairs, of {corners} corners"
            raise ValueError(f"{expected}, got goals of {size} corners: call prepared of these pairs.")
        return x, y.points, batch

    def _from_middle(self, name: str, x: ArrayLike) -> Array | np.ndarray:
        """Check points ``(..., 2)``, and return them relative to the middle of the domain.

        Points of 64-bit floats keep their precision. All others are returned as 32-bit floats.
        """
        x = x if isinstance(x, jax.Array) else as_queries(x)
        if x.ndim == 0 or x.shape[-1] != 2:
            raise ValueError(f"{name} must be points of shape (..., 2), got {x.shape}.")
        if not (jnp.issubdtype(x.dtype, jnp.floating) or jnp.issubdtype(x.dtype, jnp.integer)):
            raise ValueError(f"{name} must be real numbers, got an array of {x.dtype}.")
        # Subtract the middle: in 64 bits from such points outside of JAX, else in two parts, `first` and `rest`.
        if is_traced(self.file):
            unresolved, (first, rest) = self.tables.unresolved, self.tables.middle
        else:
            middle, unresolved = (self.domain.lo + self.domain.hi) / 2, unresolved_types(self.domain)
            if isinstance(x, np.ndarray) and x.dtype == np.float64:
                return x - middle
            first, rest = middle.astype(np.float32), (middle - middle.astype(np.float32)).astype(np.float32)
        require_resolved(x.dtype, unresolved)
        module: Any = np if is_on_one_host(x, self.file) else jnp
        x = module.asarray(x, _floats_of(x))
        first, rest = (module.broadcast_to(part.astype(x.dtype), x.shape) for part in (first, rest))
        return (x - first) - rest

    @cached_property
    def stored(self) -> PairsFileData:
        return self._known_stored or PairsFileData.from_bytes(self.file_bytes)

    @property
    def domain(self) -> Box:
        """The closed box of valid points."""
        return self.stored.domain

    @property
    def num_leaves(self) -> int:
        """Number of leaves of the partition."""
        return len(self.stored.cells)

    @property
    def num_corners(self) -> int:
        """Number of corners where paths turn."""
        return self.stored.num_corners

    def __repr__(self) -> str:
        try:
            leaves, corners = self.num_leaves, self.num_corners
            return f"PairPLR(num_leaves={leaves}, num_corners={corners}, num_bytes={self.num_bytes}, {self.domain})"
        except (TypeError, ValueError):
            return "PairPLR(of arrays that are traced, stacked or replaced)"


@overload
def construct_pairs(workspace: "Workspace", *, max_bytes: int | None = None) -> PairPLR: ...
@overload
def construct_pairs(workspace: "Building", *, max_bytes: int | None = None) -> "BuildingPairs": ...
def construct_pairs(workspace: Any, *, max_bytes: int | None = None) -> Any:
    """Build a PairPLR: distances between any two points of a planar workspace, or BuildingPairs for a building.

    The common call names a budget in bytes:

        pairs = plr_jax.construct_pairs(workspace, max_bytes=1024)
        pairs(x, y)  # distances (n,) of points x and y, both (n, 2)

    For a :class:`Building`, ``pairs((floor_x, x), (floor_y, y))`` also takes links.

    Args:
        workspace: The free space, at most 1e18 wide, with at most 8,192 reflex corners (sharp tips of thin walls
            count twice), else ``ValueError``. Or a building, whose ends of links also count.
        max_bytes: Largest size of the file that :func:`save` writes; None: 65,536. ``ValueError`` if free space and
            corners alone take more.

    The domain is halved repeatedly, and each leaf lists the corners at which a shortest path from it may turn first.
    More bytes make queries faster, because fewer corners must be tried. The file stays below the budget if more
    bytes would not help. If interrupted (Ctrl-C), the result has the partition so far, with a
    ``ConstructionInterrupted`` warning. Reference: "all-pairs" in Section II of the paper.

    With ``w`` the width of the domain, distances are within 4e-7 w of the exact ones for any budget, except right
    beside walls:

    - Within 4e-6 w of a wall, a point may see around the wall's end: distances may be 2e-5 w too small.
    - Within 8e-6 w of a wall or gap thinner than this, or of a place where obstacles touch, a point may get the
      distance of a point on the other side, or a smaller one. Bounds hold, but lower bounds treat walls this thin as
      free space.
    - Where a thin wall starts at the sharp tip of a thicker obstacle, a point near the tip, in line with the wall up
      to rounding, may see through between wall and tip. So may a point within 4e-6 w of another wall that ends at
      the tip.
    - Paths around the end of a thin wall may be 2e-6 w too long. If the workspace lets paths squeeze through places
      where obstacles touch, and a thin wall ends in such a place, paths through such places may be 2e-6 w too short.
      Some of these paths are not found: the distance is then the length of a longer path, above the upper bound.

    Otherwise gaps stay open however narrow, and places where obstacles touch stay closed, unless paths may squeeze
    through. Only a gap below 6e-8 w beside such a place, or below 8e-6 w beside the tip of a thin wall, may be
    closed, or paths through the gap may cross the wall on its other side.
    """
    from plr_jax.pairs.construct import construct_stored  # queries do not need it

    if hasattr(workspace, "plane_floors"):
        from plr_jax.pairs.building_pairs import BuildingPairs

        floors = workspace.plane_floors
        stored, data = construct_stored(workspace.plane, max_bytes, workspace.corners, len(floors.to_bytes()))
        return BuildingPairs(floors, PairPLR(padded_file(data), stored))
    stored, data = construct_stored(workspace, max_bytes)
    return PairPLR(padded_file(data), stored)


def pairs_from_bytes(data: bytes) -> PairPLR:
    return PairPLR(padded_file(data), PairsFileData.from_bytes(data))


@partial(jax.jit, static_argnames="outside")
def _distances(tables: PairTables, x: Array, y: Array, outside: Outside) -> tuple[Lengths]:
    """Return distances between points ``x`` and ``y``, both relative to the middle of the domain."""
    if outside == "clamp":
        (x, shift_x), (y, shift_y) = (_clamped(tables, p.astype(_floats_of(x, y))) for p in (x, y))
        return (_distances(tables, x, y, "inf")[0] + (shift_x + shift_y),)
    # 1. Find the shortest paths in 32 bits, from rounded points.
    (x, y), shape, answer = _checked(tables, x, y, outside=outside)
    single = [jax.lax.stop_gradient(p.astype(jnp.float32)) for p in (x, y)]
    ways = shortest_ways(tables, *single)
    length = jnp.where(jnp.isfinite(ways.length), ways.length, ways.least).astype(x.dtype)
    # 2. Add the change of the first and the last leg:
    #
    #        x ------ i ~~~~~~ j ------ y      legs(x, y) = |x - i| + |y - j|, or |x - y| if the path is straight
    #
    #    `length` is that of the rounded points x' and y', and has no gradient. With the turns i and j held fixed,
    #        length(x, y) = length(x', y') + legs(x, y) - legs(x', y'),
    #    whose gradient is that of legs(x, y). As legs(x', y') are computed in 32 bits, too, their rounding cancels.
    is_straight = (ways.from_x == single[1]).all(axis=1) & (ways.from_y == single[0]).all(axis=1)

    def legs(x: Float[Array, "n 2"], y: Float[Array, "n 2"]) -> Float[Array, " n"]:
        from_x, from_y = (p.astype(x.dtype) for p in (ways.from_x, ways.from_y))
        return jnp.where(is_straight, _norm(x - y), _norm(x - from_x) + _norm(y - from_y))

    length += jnp.where(jnp.isfinite(length), legs(x, y) - legs(*single).astype(x.dtype), 0)
    return (jnp.where(jnp.isfinite(answer), length, answer).reshape(shape),)


@partial(jax.jit, static_argnames="outside")
def _to_goals(tables: PairTables, x: Array, index: Array, goals: PreparedGoals, outside: Outside) -> tuple[Lengths]:
    """Return distances from points ``(..., 2)`` to the goals of given indices ``(..., 1)``, which broadcast."""
    if outside == "clamp":
        x, shift = _clamped(tables, x.astype(_floats_of(x)))
        return (_to_goals(tables, x, index, goals, "inf")[0] + shift,)
    # 1. Find the shortest paths in 32 bits, from rounded points.
    points, to_corners = (column.reshape(-1, column.shape[-1]) for column in (goals.points, goals.to_corners))
    index = jnp.broadcast_to(index[..., 0], jnp.broadcast_shapes(x.shape[:-1], index.shape[:-1]))
    (x, y), shape, answer = _checked(tables, x, points[index], outside=outside)
    single, end = (jax.lax.stop_gradient(p.astype(jnp.float32)) for p in (x, y))
    ways = shortest_ways(tables, single, end, jax.lax.stop_gradient(to_corners), index.ravel())
    via, length = ways.from_x.astype(x.dtype), ways.length.astype(x.dtype)
    # 2. Add the change of the first leg, as in `_distances`. Goals have 32 bits: the rest of the path is known.
    change = _norm(x - via) - _norm(single.astype(x.dtype) - via)
    length += jnp.where(jnp.isfinite(length), change, 0)
    return (jnp.where(jnp.isfinite(answer), length, answer).reshape(shape),)


@jax.jit
def _bounds(tables: PairTables, x: Array, y: Array) -> tuple[Lengths, Lengths]:
    """Return proven lower and upper bounds of the distances between points ``x`` and ``y``.

    Points are relative to the middle of the domain.
    """
    # With the relative error r of a query and the absolute error e of points and corners:
    #   lower = (1 - r) (length among walls that hide too little) - e
    #   upper = (1 + r) (length among walls that hide too much) + e
    (x, y), shape, answer = _checked(tables, x, y)
    dtype = x.dtype
    x, y = (jax.lax.stop_gradient(p.astype(jnp.float32)) for p in (x, y))
    absolute = point_rounding(tables.half, jnp.abs(tables.middle[0])).max()
    # 1. The lower bound: paths among walls moved into obstacles, without thin obstacles.
    lower_tables = tables if tables.sure_walls is None else replace(tables, walls=tables.sure_walls, near=None)
    lower = jnp.maximum(SHRUNK * shortest_ways(lower_tables, x, y).least - (tables.rounding[0] + absolute), 0.0)
    # 2. The upper bound: paths among walls moved into free space. A point near a wall may be behind the moved wall.
    listed_x, listed_y = (along[tables.listed] for along in tables.outset_corners.T)
    upper_tables = replace(tables, walls=tables.outset_walls, near=None, x=listed_x, y=listed_y, is_certain=True)
    is_clear = is_inside(upper_tables, x) & is_inside(upper_tables, y)
    length = jnp.where(is_clear, shortest_ways(upper_tables, x, y).length, jnp.inf)
    upper = STRETCHED * length + (tables.rounding[1] + absolute)
    lower, upper = (jnp.where(jnp.isfinite(answer), p.astype(dtype), answer).reshape(shape) for p in (lower, upper))
    return lower, upper


def _clamped(tables: PairTables, x: _Points) -> tuple[_Points, Lengths]:
    """Move finite points outside the domain to the nearest point of the domain; also return how far they move."""
    half = jnp.broadcast_to(tables.half.astype(x.dtype), x.shape)
    is_beyond = jnp.isfinite(x).all(axis=-1, keepdims=True) & (jnp.abs(x) > _ends(tables, x))  # by axis
    nearest = jnp.where(is_beyond, jnp.copysign(half, jax.lax.stop_gradient(x)), x)
    shift: Any = length_of([(x - nearest)[..., axis] for axis in range(2)])
    return nearest, shift


def _checked(
    tables: PairTables, *points: Array, outside: Outside = "inf"
) -> tuple[list[Float[Array, "n 2"]], tuple[int, ...], Float[Array, " n"]]:
    """Broadcast points to rows, and answer the rows that need no search.

    Return the rows, the shape of the batch, and an answer for each row: ``inf`` or NaN ``outside`` the domain, NaN
    for NaN, and 0 if the row needs a search. Points of rows with another answer are replaced by 0.
    """
    batches = jnp.broadcast_arrays(*(p.astype(_floats_of(*points)) for p in points))
    shape, rows = batches[0].shape[:-1], [p.reshape(-1, 2) for p in batches]
    farthest = reduce(jnp.maximum, map(jnp.abs, rows))
    is_outside = (farthest > _ends(tables, farthest)).any(axis=1)
    answer = jnp.where(is_outside, float(outside), jnp.zeros((), farthest.dtype))
    answer = jnp.where(jnp.isnan(farthest).any(axis=1), jnp.nan, answer)
    return [jnp.where(jnp.isfinite(answer)[:, None], p, 0.0) for p in rows], shape, answer


def _floats_of(*points: Any) -> Any:
    return jnp.float64 if jnp.float64 in [p.dtype for p in points] else jnp.float32


def _ends(tables: PairTables, x: _Points) -> _Points:
    # The largest coordinates of points in the domain, with a margin for the rounding of points.
    ends = tables.half + ENDS * (tables.half + jnp.abs(tables.middle[0]))
    return jnp.broadcast_to(ends.astype(x.dtype), x.shape)


def _norm(v: Float[Array, "n 2"]) -> Float[Array, " n"]:
    # The gradient at 0 is 0, not NaN: the root is taken of 1 there.
    square = (v * v).sum(axis=1)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)
