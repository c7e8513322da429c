"""PairPLR: the distance between any two points of a planar workspace, from one file, or to one goal."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial, reduce
from itertools import product
from math import prod
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.tree_util import GetAttrKey
from jaxtyping import Array, Float, Int, UInt8

from plr_jax._arrays import as_finite_point, run_members
from plr_jax._cores import answered_in_parts, is_on_one_host
from plr_jax._types import ArrayLike, Sources
from plr_jax.geometry.box import Box
from plr_jax.pairs.goals import PreparedGoals, distances_to_corners, ways_to_goals
from plr_jax.pairs.query import is_inside, shortest_ways
from plr_jax.pairs.stored import Stored
from plr_jax.pairs.tables import PairTables, build_pair_tables
from plr_jax.plr._assembly import plr_of_leaves
from plr_jax.plr._file import Contents
from plr_jax.plr._plr import PLR
from plr_jax.plr.file.held import HeldFile, held
from plr_jax.plr.leaves import leaf_model
from plr_jax.plr.leaves.base import as_sourced
from plr_jax.plr.partition.cells import Cells, Tree, levels_of, tree_of
from plr_jax.plr.query.frame import Outside, as_outside, require_resolved
from plr_jax.plr.query.lookup import length_of
from plr_jax.plr.query.points import as_array

# The distance to one goal, taken out of a PairPLR: a cone in each leaf.


_SAMPLES = 0.96 * np.array(list(product((-1, 0, 1), repeat=2)))
"""Where each leaf is asked, in its local coordinates."""
_HALVINGS = 4  # of the leaves of the pairs, where one corner does not serve all of a leaf
_DEPTH = 13  # to which few leaves are halved, such as the one of a file that was cut off before its lists
_MAX_AXIS_DEPTH = 13
_NEGLIGIBLE = 1e-5  # mean error of a cell, in widths of the domain
_ROUNDING = 1e-6  # of a distance and the domain's width: more than a query of pairs rounds

PairFn: TypeAlias = Callable[[ArrayLike, ArrayLike], ArrayLike]


def plr_to(stored: Stored, pairs: PairFn, goal: ArrayLike) -> PLR:
    """The PLR of cones of the distance to a goal: each leaf of the pairs has the corner that serves it best."""
    domain = stored.domain
    goal = as_finite_point("The goal", domain.settled(goal), 2)
    if not domain.contains(goal[None])[0]:
        raise ValueError(f"The goal {goal.tolist()} lies outside the domain {domain}; move it inside.")
    sources = _sources(stored, pairs, goal)
    cells, owner, done = stored.cells, np.arange(len(stored.cells)), []
    most = max(_HALVINGS, _DEPTH - (len(cells) - 1).bit_length())
    for halvings in range(most + 1):
        source, error = _best_sources(stored, pairs, sources, cells, owner)
        is_poor = (error > _NEGLIGIBLE * domain.width.max()) & (cells.depth.max(axis=1) < _MAX_AXIS_DEPTH)
        is_poor &= halvings < most
        done.append((cells[~is_poor], source[~is_poor]))
        poor = cells[is_poor]
        cells, owner = poor.split(poor.longest_axis(domain)), np.repeat(owner[is_poor], 2)
    first, *others = (cells for cells, _ in done)
    cells, source = first.append(*others), np.concatenate([source for _, source in done])
    if (source < 0).all():
        raise ValueError(f"No leaf reaches the goal {goal.tolist()}; move it into free space.")
    tree = tree_of(cells)
    cells, source = _joined(tree, source[tree.order])
    leaf = leaf_model("cone")
    cells, cones = as_sourced(leaf).of_sources(domain, cells, source, sources)
    return plr_of_leaves(Contents(domain, leaf, levels_of(cells)[0], cells, cones))


def _sources(stored: Stored, pairs: PairFn, goal: Float[np.ndarray, "2"]) -> Sources:
    """The goal, and the corners that shortest paths to it turn at, with their distances and the way on from each.

    A path that turns at a corner goes on straight to the goal, or along an edge to a corner that is nearer to it. A
    corner from which no edge leads on like that may be where a path starts, but none turns there: its distance is
    ``inf``, so that no leaf names it.
    """
    points = np.concatenate([goal[None], stored.points])
    distances = np.append(0.0, np.asarray(pairs(stored.points, goal), np.float64))
    slack = _ROUNDING * (distances + stored.domain.width.max())
    parents = np.where(distances <= np.linalg.norm(points - goal, axis=1) + slack, 0, -1)
    start, end = 1 + np.concatenate([stored.edges, stored.edges[:, ::-1]]).T
    onward = np.linalg.norm(points[start] - points[end], axis=1) + distances[end]
    leads_on = (onward <= distances[start] + slack[start]) & (distances[end] < distances[start])
    edges = np.flatnonzero(leads_on & (parents[start] < 0) & np.isfinite(onward))
    edges = edges[np.argsort(-onward[edges], kind="stable")]
    parents[start[edges]] = end[edges]  # of several the last one stays: the shortest
    distances[parents < 0] = np.inf
    return Sources(points, distances, np.where(parents < 0, np.arange(len(points)), parents))


def _best_sources(
    stored: Stored, pairs: PairFn, sources: Sources, cells: Cells, owner: Int[np.ndarray, "cells"]
) -> tuple[Int[np.ndarray, "cells"], Float[np.ndarray, "cells"]]:
    """The source of each cell whose cone is nearest to the distances in it, and its mean error; -1 if none reaches.

    Its owner is the leaf that holds it.
    """
    x = cells.points(_SAMPLES, stored.domain)
    distance = np.full(x.shape[:2], np.inf)
    is_free = stored.outline.contains(x.reshape(-1, 2)).reshape(x.shape[:2])
    distance[is_free] = pairs(x[is_free], sources.points[0])
    entries, cell = run_members(np.searchsorted(stored.leaf, np.arange(len(stored.cells) + 1)), owner)
    cell = np.concatenate([np.arange(len(cells)), cell])
    source = np.concatenate([np.zeros(len(cells), np.int64), 1 + stored.listed[entries]])
    cone = sources.distances[source, None] + np.linalg.norm(x[cell] - sources.points[source, None], axis=2)
    with np.errstate(invalid="ignore"):
        error = np.where(np.isfinite(distance[cell]), np.abs(cone - distance[cell]), 0.0).mean(axis=1)
    order = np.lexsort((error, cell))
    best = order[np.searchsorted(cell[order], np.arange(len(cells)))]
    reaches = np.isfinite(distance).any(axis=1) & np.isfinite(sources.distances[source[best]])
    return np.where(reaches, source[best], -1), np.where(reaches, error[best], 0.0)


def _joined(tree: Tree, source: Int[np.ndarray, "leaves"]) -> tuple[Cells, Int[np.ndarray, "kept"]]:
    """Leaves and their sources, after halves with one source are one leaf."""
    of_node = np.full(len(tree.child), -2)
    of_node[tree.node_of_leaf] = source
    for split in reversed(tree.splits):
        lower, upper = of_node[tree.child[split]], of_node[tree.child[split] + 1]
        of_node[split] = np.where(lower == upper, lower, -2)
    is_inside = np.zeros(len(tree.child), bool)
    for split in tree.splits:
        is_inside[tree.child[split]] = is_inside[tree.child[split] + 1] = is_inside[split] | (of_node[split] > -2)
    kept = np.flatnonzero((of_node > -2) & ~is_inside)
    return tree.cells[kept], of_node[kept]


_FEW, _MANY = 2**10, 2**14  # pairs that are answered at once, of few and of many
_ROUNDINGS = 16
_ENDS = 4 * float(np.finfo(np.float32).eps)  # how well ends of the domain are told


@jax.tree_util.register_pytree_with_keys_class
@dataclass(frozen=True, eq=False)
class PairPLR(HeldFile):
    """The distance between any two points of a planar workspace.

    Made by :func:`construct_pairs` and :func:`load`. It is a pytree of arrays: a jitted function can close over
    it or take it as an argument.

    Attributes:
        file: The bytes that :func:`save` writes, padded with zeros, then their number (see ``held``).
    """

    file: UInt8[Array, "padded"] | UInt8[np.ndarray, "padded"]

    @cached_property
    def tables(self) -> PairTables:
        """What a query reads, derived from the file alone when it is first asked for.

        They are many times as large as the file, and may take as many times as long as it to make. Raises
        ``ValueError`` if the file was cut off behind its outline, and that is none.
        """
        with jax.ensure_compile_time_eval():  # also where a function is traced that closes over it
            try:
                return build_pair_tables(self.stored, self.num_bytes)
            except ValueError as error:
                raise ValueError(f"The file cannot be asked: {error}.") from error

    def tree_flatten_with_keys(self) -> tuple[tuple[tuple[GetAttrKey, Any], ...], None]:
        """The tables and the file."""
        return ((GetAttrKey("tables"), self.tables), (GetAttrKey("file"), self.file)), None

    @classmethod
    def tree_unflatten(cls, _: None, children: tuple[Any, Any]) -> "PairPLR":
        """That of tables and a file."""
        tables, file = children
        pairs = cls(file)
        vars(pairs)["tables"] = tables
        return pairs

    def with_label(self, label: str) -> "PairPLR":
        """The same with another label, and with the tables if there are any: see :meth:`HeldFile.with_label`."""
        labeled = super().with_label(label)
        if "tables" in vars(self):
            vars(labeled)["tables"] = self.tables
        return labeled

    def __call__(
        self, x: ArrayLike, y: ArrayLike | PreparedGoals, *, outside: Outside = "inf"
    ) -> Float[Array, "*batch"]:
        """Distance between points: the length of the shortest path in free space.

        Clean under ``jax.jit``, ``jax.vmap`` and ``jax.grad``, in both arguments: the gradient leads away from where
        the path goes first. It is zero where the distance is 0 or ``inf``.

        Args:
            x: Points, ``(..., 2)``, NumPy or JAX.
            y: Points, of a shape that broadcasts with that of ``x``; or goals that :meth:`prepared` made, whose batch
                does.
            outside: What points outside the domain get, as for :func:`evaluate`; with ``"clamp"`` the ways of both
                ends to the domain are added.

        Returns:
            Distances, ``(...)``, in the default precision of JAX at the most, as of :func:`evaluate`; the corners and
            what is between them have 32 bits. ``pairs(x, y) == pairs(y, x)`` to the last bit, and 0 for ``x == y``.
            ``inf`` where no path joins the points; NaN for NaN. Points in obstacles get what the corners that their
            leaf lists give, which means nothing.

        Raises:
            ValueError: If points do not have two coordinates, are not real, or do not broadcast, or ``outside`` is
                none of the three.
        """
        if isinstance(y, PreparedGoals):
            return self._to_prepared(x, y, as_outside(outside))
        return self._answered(partial(_distances, outside=as_outside(outside)), x, y)[0]

    def prepared(self, goals: ArrayLike) -> PreparedGoals:
        """Goals that are asked for many times, as second points of a call.

        It then takes about half the time on small maps, a fifth on large ones. Clean under ``jax.jit`` and
        ``jax.vmap``, as where an environment draws its goal in ``reset``. Answers differ from those of the points
        themselves by rounding; they have no gradient in the goals, whose coordinates have 32 bits, and with
        ``outside="clamp"`` a goal outside stays there: ``inf``. To pairs of another map they mean nothing.

        Args:
            goals: The goals, ``(..., 2)``.

        Returns:
            The goals and the distance of each from all corners, ``(..., corners)``: 4 bytes a corner.

        Raises:
            ValueError: As for a call.
        """
        goals = self._from_middle("goals", goals)
        points = jnp.asarray(goals, jnp.float32)
        (inside,), shape, _ = _checked(self.tables, points)
        to_corners = _to_corners(self.tables, jax.lax.stop_gradient(inside))
        return PreparedGoals(points, to_corners.reshape(*shape, len(self.tables.distances)))

    def _to_prepared(self, x: ArrayLike, goals: PreparedGoals, outside: Outside) -> Float[Array, "*batch"]:
        x, batch = self._from_middle("x", x), goals.points.shape[:-1]
        _require_broadcast("x and goals", x, goals.points)
        size, corners = goals.to_corners.shape[-1], len(self.tables.distances)
        if size != corners:
            raise ValueError(
                f"Goals must have been prepared by these pairs, of {corners} corners, got goals of {size}: call the "
                "prepared of these."
            )
        if not prod(batch):
            return jnp.zeros(np.broadcast_shapes(x.shape[:-1], batch), jnp.float32)
        number = np.arange(prod(batch), dtype=np.uint32).reshape(*batch, 1)
        answer = partial(_distances_to, self.tables, goals, outside=outside)
        if not is_on_one_host(x, goals.points, self.tables.walls):
            return answer(x, number)[0]
        x = np.asarray(x, jax.dtypes.canonicalize_dtype(_floats_of(x)))
        return jnp.asarray(answered_in_parts(answer, (_FEW, _MANY), x, number)[0])

    def bounds(self, x: ArrayLike, y: ArrayLike) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Proven bounds of the distance between points of free space.

        The proof covers what the file and a query round. It is about points of free space, walls included, but not
        such as count as free to the workspace's tolerance alone.

        Args:
            x: Points, as for a call.
            y: Points.

        Returns:
            Lower bounds, at least 0, and upper bounds: lengths of paths that are certainly free, ``inf`` where none
            was found, as from points on a wall, or nearer to one than 4e-6 of the domain's width.

        Raises:
            ValueError: As for a call.
        """
        lower, upper = self._answered(_bounds, x, y)
        return lower, upper

    def to(self, goal: ArrayLike) -> PLR:
        """The distance to one goal, as an ordinary PLR of cones.

        Each leaf has the one corner that serves it best, judged by what the pairs answer at some of its points, and
        is halved a few times where none serves all of it. Nothing is proven of it: use :func:`certify`. Not inside
        ``jit``: there, call the pairs with ``y=goal``.

        Args:
            goal: The goal, ``(2,)``, in the domain.

        Returns:
            The PLR.

        Raises:
            ValueError: If the goal is not two finite numbers, lies outside the domain, or nothing reaches it.
        """
        return plr_to(self.stored, self, goal)

    def _answered(self, answer: Callable[..., tuple[Array, ...]], x: ArrayLike, y: ArrayLike) -> tuple[Array, ...]:
        """What a function of the tables and points answers: in parts, on all cores of a CPU."""
        x, y = self._from_middle("x", x), self._from_middle("y", y)
        _require_broadcast("x and y", x, y)
        if not is_on_one_host(x, y, self.tables.walls):
            return answer(self.tables, x, y)
        with np.errstate(over="ignore"):  # far outside
            points = [np.asarray(p, jax.dtypes.canonicalize_dtype(_floats_of(x, y))) for p in (x, y)]
        answers = answered_in_parts(partial(answer, self.tables), (_FEW, _MANY), *points)
        return tuple(map(jnp.asarray, answers))

    def _from_middle(self, name: str, x: ArrayLike) -> Array | np.ndarray:
        """Points counted from the middle of the domain: those of NumPy in their own precision."""
        x = x if isinstance(x, jax.Array) else as_array(x)
        if x.ndim == 0 or x.shape[-1] != 2:
            raise ValueError(f"{name} must be points of shape (..., 2), got {x.shape}.")
        if not (jnp.issubdtype(x.dtype, jnp.floating) or jnp.issubdtype(x.dtype, jnp.integer)):
            raise ValueError(f"{name} must be real numbers, got an array of {x.dtype}.")
        if isinstance(x, np.ndarray) and not isinstance(self.file, Tracer):
            return x - self._middle
        x = jnp.asarray(x)
        require_resolved(x.dtype, self.tables.unresolved)
        first, rest = (jnp.broadcast_to(part, x.shape) for part in self.tables.middle)
        return (x - first) - rest

    @cached_property
    def _middle(self) -> Float[np.ndarray, "2"]:
        return (self.domain.lo + self.domain.hi) / 2

    @cached_property
    def stored(self) -> Stored:
        """What the file holds."""
        return Stored.from_bytes(self.to_bytes())

    @property
    def domain(self) -> Box:
        """The closed box that both points are of."""
        return self.stored.domain

    @property
    def num_leaves(self) -> int:
        """Number of leaves of the partition."""
        return len(self.stored.cells)

    @property
    def num_corners(self) -> int:
        """Number of corners that paths turn at."""
        return len(self.stored.corner)

    def __repr__(self) -> str:
        if isinstance(self.file, Tracer):
            return "PairPLR(of arrays that are traced)"
        leaves, corners = self.num_leaves, self.num_corners
        return f"PairPLR(num_leaves={leaves}, num_corners={corners}, num_bytes={self.num_bytes}, {self.domain})"


def pairs_of_stored(stored: Stored) -> PairPLR:
    """The PairPLR whose file holds this."""
    return pairs_from_bytes(stored.to_bytes())


def pairs_from_bytes(data: bytes) -> PairPLR:
    """The PairPLR that a file's bytes hold; raises ``ValueError`` saying what is wrong with them."""
    pairs = PairPLR(held(data))
    vars(pairs)["stored"] = Stored.from_bytes(data)
    return pairs


@partial(jax.jit, static_argnames="outside")
def _distances(tables: PairTables, x: Array, y: Array, outside: Outside) -> tuple[Float[Array, "*batch"]]:
    if outside == "clamp":
        (x, way_x), (y, way_y) = (_clamped(tables, p.astype(_floats_of(x, y))) for p in (x, y))
        return (_distances(tables, x, y, "inf")[0] + (way_x + way_y),)
    (x, y), shape, answer = _checked(tables, x, y)
    if outside == "nan":
        answer = jnp.where(jnp.isinf(answer), jnp.nan, answer)
    single = [jax.lax.stop_gradient(p.astype(jnp.float32)) for p in (x, y)]
    ways = shortest_ways(tables, *single)
    length = jnp.where(jnp.isfinite(ways.length), ways.length, ways.least).astype(x.dtype)
    is_straight = (ways.from_x == single[1]).all(axis=1) & (ways.from_y == single[0]).all(axis=1)

    def legs(x: Float[Array, "n 2"], y: Float[Array, "n 2"]) -> Float[Array, "n"]:
        from_x, from_y = (p.astype(x.dtype) for p in (ways.from_x, ways.from_y))
        return jnp.where(is_straight, _norm(x - y), _norm(x - from_x) + _norm(y - from_y))

    # As it changes with the ends, also by what 32 bits leave of them.
    length += jnp.where(jnp.isfinite(length), legs(x, y) - legs(*single).astype(x.dtype), 0)
    return (jnp.where(jnp.isfinite(answer), length, answer).reshape(shape),)


@jax.jit
def _to_corners(tables: PairTables, points: Float[Array, "n 2"]) -> Float[Array, "n size"]:
    return distances_to_corners(tables, points)


@partial(jax.jit, static_argnames="outside")
def _distances_to(
    tables: PairTables, goals: PreparedGoals, x: Array, number: Array, outside: Outside
) -> tuple[Float[Array, "*batch"]]:
    """Distances from points to the goals of some numbers, ``(*batch, 1)``."""
    if outside == "clamp":
        x, way = _clamped(tables, x.astype(_floats_of(x)))
        return (_distances_to(tables, goals, x, number, "inf")[0] + way,)
    points, to_corners = (each.reshape(-1, each.shape[-1]) for each in (goals.points, goals.to_corners))
    number = jnp.broadcast_to(number[..., 0], jnp.broadcast_shapes(x.shape[:-1], number.shape[:-1]))
    (x, y), shape, answer = _checked(tables, x, points[number])
    single, end = (jax.lax.stop_gradient(p.astype(jnp.float32)) for p in (x, y))
    length, via = ways_to_goals(tables, jax.lax.stop_gradient(to_corners), single, end, number.ravel())
    if outside == "nan":
        answer = jnp.where(jnp.isinf(answer), jnp.nan, answer)
    via, length = via.astype(x.dtype), length.astype(x.dtype)
    # As it changes with the point, also by what 32 bits leave of it.
    change = _norm(x - via) - _norm(single.astype(x.dtype) - via)
    length += jnp.where(jnp.isfinite(length), change, 0)
    return (jnp.where(jnp.isfinite(answer), length, answer).reshape(shape),)


@jax.jit
def _bounds(tables: PairTables, x: Array, y: Array) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    (x, y), shape, answer = _checked(tables, x, y)
    dtype, (x, y) = x.dtype, (jax.lax.stop_gradient(p.astype(jnp.float32)) for p in (x, y))
    relative = _ROUNDINGS * jnp.finfo(jnp.float32).eps
    absolute = relative * (jnp.abs(tables.middle[0]) + tables.half).max()  # of the domain's largest coordinate
    least = shortest_ways(tables, x, y).least
    lower = jnp.maximum((1 - relative) * least - (tables.rounding[0] + absolute), 0.0)
    # A point nearer to a wall may pass behind those that are moved into free space.
    free = tables.in_free_space
    is_clear = is_inside(free, x) & is_inside(free, y)
    length = jnp.where(is_clear, shortest_ways(free, x, y).length, jnp.inf)
    upper = (1 + relative) * length + (tables.rounding[1] + absolute)
    lower, upper = (jnp.where(jnp.isfinite(answer), p.astype(dtype), answer).reshape(shape) for p in (lower, upper))
    return lower, upper


def _clamped(
    tables: PairTables, x: Float[Array, "*batch 2"]
) -> tuple[Float[Array, "*batch 2"], Float[Array, "*batch"]]:
    """The point of the domain that is nearest to each, and how far that is; points that are not finite stay."""
    half = jnp.broadcast_to(tables.half.astype(x.dtype), x.shape)
    beyond = jnp.isfinite(x).all(axis=-1, keepdims=True) & (jnp.abs(x) > _ends(tables, x))
    nearest = jnp.where(beyond, jnp.copysign(half, jax.lax.stop_gradient(x)), x)
    return nearest, length_of([(x - nearest)[..., axis] for axis in range(2)])


def _checked(
    tables: PairTables, *points: Array
) -> tuple[list[Float[Array, "n 2"]], tuple[int, ...], Float[Array, "n"]]:
    """Points, or pairs, in rows and inside the domain; their shape; and what to answer.

    That is ``inf`` outside, NaN for NaN, else 0.
    """
    batches = jnp.broadcast_arrays(*(p.astype(_floats_of(*points)) for p in points))
    shape, rows = batches[0].shape[:-1], [p.reshape(-1, 2) for p in batches]
    farthest = reduce(jnp.maximum, map(jnp.abs, rows))
    answer = jnp.where((farthest > _ends(tables, farthest)).any(axis=1), jnp.inf, jnp.zeros((), farthest.dtype))
    answer = jnp.where(jnp.isnan(farthest).any(axis=1), jnp.nan, answer)
    return [jnp.where(jnp.isfinite(answer)[:, None], p, 0.0) for p in rows], shape, answer


def _require_broadcast(names: str, x: Array | np.ndarray, y: Array | np.ndarray) -> None:
    """Raise ``ValueError`` if points do not broadcast."""
    try:
        jnp.broadcast_shapes(x.shape, y.shape)
    except ValueError:
        raise ValueError(f"{names} must broadcast, got shapes {x.shape} and {y.shape}.") from None


def _floats_of(*points: Any) -> Any:
    """The precision of an answer: 64 bits if a point is of as many, else 32."""
    return jnp.float64 if jnp.float64 in [p.dtype for p in points] else jnp.float32


def _ends(tables: PairTables, x: Float[Array, "*batch 2"]) -> Float[Array, "*batch 2"]:
    """How far from the middle points count as inside: to what rounding leaves of the ends, wherever the origin is."""
    ends = tables.half + _ENDS * (tables.half + jnp.abs(tables.middle[0]))
    return jnp.broadcast_to(ends.astype(x.dtype), x.shape)


def _norm(v: Float[Array, "n 2"]) -> Float[Array, "n"]:
    """Lengths of vectors, of slope 0 at 0."""
    square = (v * v).sum(axis=1)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)
