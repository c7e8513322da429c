"""The public class :class:`PLR`: a distance function that is stored in the leaves of a binary space partition."""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int, UInt8

from plr_jax._arrays import as_list, as_points, as_queries, no_attribute, padded, require_function, shortened
from plr_jax._compiled import has_doubles, is_on_one_host, pytree, serializable
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.plr._file import DecodedFile, decode, encode, filled_coefficients, relative_to_origin
from plr_jax.plr._tunable import TunablePLR, parameter_map
from plr_jax.plr.coding import BitReader, read_tree
from plr_jax.plr.container import Container, FileBacked, padded_file
from plr_jax.plr.frame import Corner, Outside, as_outside, corner_if_far
from plr_jax.plr.leaves import as_sourced, goal_of_leaves, leaf_model, require_goals
from plr_jax.plr.leaves.base import LeafModel
from plr_jax.plr.portable.numpy import NumpyPLR
from plr_jax.plr.query import bound_points, evaluate_anywhere, evaluate_points, goals_of_points, waypoints_of_points
from plr_jax.plr.tables import Tables, build_tables
from plr_jax.plr.team import TableStack
from plr_jax.plr.tree import Cells

_FEW = 2**12  # points: NumPy takes some tenths of a millisecond for so many, compiling a query 80 ms

serializable(Tables, default=lambda leaf: {"leaf": leaf.name}, object_hook=lambda leaf: leaf_model(leaf["leaf"]))


@serializable
@jax.tree_util.register_pytree_with_keys_class
class PLR(FileBacked):
    """A distance function compressed into a tree of cells: each final cell, a *leaf*, stores a simple function.

    :func:`construct` and :func:`load` make PLRs. ``plr(x)`` evaluates a PLR: see :func:`evaluate`. A PLR is immutable
    and a pytree of arrays: a jitted function can close over it or take it as an argument. As an argument, a PLR can
    only be queried, since properties like ``domain`` need concrete arrays. If arrays of a PLR are replaced, as by
    ``jax.tree.map``, queries use the new arrays, but the file, proof and exports raise ``ValueError``. Reference:
    Putman et al., Section III.

    ``jax.grad`` differentiates with respect to points, but raises ``TypeError`` with respect to the PLR, because a
    PLR has integer tables. To train the values that a PLR stores, see :meth:`tunable`.
    """

    array_names = "tables", "file", "band", "goals"
    nearest_goal: Callable[[np.ndarray], np.ndarray] | None = None  # see :meth:`with_nearest_goal`

    def __init__(self, file: UInt8[Array, "padded"] | UInt8[np.ndarray, "padded"]) -> None:
        """Wrap ``file``, the bytes that :func:`save` writes, padded by :func:`~plr_jax.plr.container.padded_file`."""
        self.file = file

    @cached_property
    def tables(self) -> Tables:
        """Lookup tables, decoded from ``file``, with which a query finds and evaluates the leaf of a point."""
        with jax.ensure_compile_time_eval():  # the PLR may be closed over by a traced function
            return tables_of_contents(self._contents, np.zeros(self._contents.domain.dim), self.table_class)

    @cached_property
    def band(self) -> Float[Array, "2 rows"] | None:
        """Proven lower (row 0) and upper (row 1) bounds of (distance - PLR's value); None without a proof.

        There is one column if all leaves share the bounds, else a column per leaf, padded to a power of two.
        """
        if (certificate := self._contents.certificate) is None:
            return None
        with jax.ensure_compile_time_eval():
            return jax.device_put(padded(certificate.bounds().astype(np.float32).T).T)

    @cached_property
    def goals(self) -> Int[Array, " rows"] | None:
        """Index of each leaf's nearest goal, padded to a power of two; None if the file does not store goals."""
        if (goals := goal_of_leaves(self.leaf, self._contents.stored)) is None:
            return None
        with jax.ensure_compile_time_eval():
            return jax.device_put(padded(goals.astype(np.int32)))

    def __getattr__(self, name: str) -> Any:
        raise no_attribute(self, name, "A PLR is immutable: construct a new PLR for a changed map or another goal.")

    def with_nearest_goal(self, nearest_goal: Callable[[np.ndarray], np.ndarray]) -> "PLR":
        """Return a copy whose :meth:`which` calls ``nearest_goal``, such as :meth:`NearestGoal.which`.

        ``nearest_goal`` maps points ``(n, dim)`` to indices of goals ``(n,)``; ``ValueError`` if it is not callable.
        PLR files do not store this function.
        """
        require_function("nearest_goal", nearest_goal)
        plr = copy(self)
        plr.nearest_goal = nearest_goal
        return plr

    def __call__(self, x: ArrayLike, *, outside: Outside = "inf") -> Float[Array, "*batch"]:
        """Return the approximate distance at each point; see :func:`evaluate`."""
        x = x if isinstance(x, jax.Array) else as_queries(x)
        if (reader := self._reader_of_few(x)) is not None:
            return jax.device_put(reader(x, outside=outside))
        tables, x = self.tables_and_points(x)
        return evaluate_points(tables, x) if outside == "inf" else evaluate_anywhere(tables, x, as_outside(outside))

    def _reader_of_few(self, x: Array | np.ndarray) -> NumpyPLR | None:
        """Return a NumPy reader that answers at points ``x`` as JAX does, but without compiling; None if it cannot.

        It can answer at most 4,096 points of 32 or 64 bits that are not traced. It cannot if ``jax_enable_x64`` is
        set, the PLR's arrays were replaced, or the points have 32 bits and the domain is far from the origin.
        """
        if not is_on_one_host(x) or has_doubles() or x.size > _FEW * self.tables.dim:
            return None
        if x.dtype == np.float64:
            return self._reader
        # In a domain far from the origin, the reader tells points apart that 32 bits do not.
        is_near = not isinstance(self.file, Tracer) and self._corner_if_far is None
        return self._reader if x.dtype == np.float32 and is_near else None

    @cached_property
    def _reader(self) -> NumpyPLR | None:
        return self.numpy() if is_on_one_host(*jax.tree.leaves(self)) and self.has_arrays_of_file else None

    def tables_and_points(self, x: Array | np.ndarray) -> tuple[Tables, Array | np.ndarray]:
        """Return the lookup tables for a query at points ``x``, and the points in the form that these tables take.

        Compiled code rounds points to 32 bits, unless ``jax_enable_x64`` is set. Therefore 64-bit NumPy points are
        changed first: they are moved into the domain along periodic axes. If the domain is far from the origin and
        ``jax_enable_x64`` is not set, they are also made relative to its lower corner. Other points stay as they are,
        and so do all points if the PLR is traced.
        """
        is_double = not isinstance(x, jax.Array) and x.dtype == np.float64 and x.shape[-1:] == (self.tables.dim,)
        if not is_double or isinstance(self.file, Tracer):
            return self.tables, x
        x = self.domain.wrapped(x) if self.tables.periodic else x
        if has_doubles() or self._corner_if_far is None:
            return self.tables, x
        return self.tables_from_corner, x - self._corner_if_far

    @cached_property
    def _corner_if_far(self) -> Corner | None:
        return corner_if_far(self.domain)

    @cached_property
    def tables_from_corner(self) -> Tables:
        """Lookup tables of a domain far from the origin, for points relative to its lower corner."""
        return tables_of_contents(self._contents, self.domain.lo, self.table_class)

    def tunable(self) -> TunablePLR:
        """Return a function like this PLR whose stored values can be trained, as by optax: see :class:`TunablePLR`.

        ``ValueError`` if leaves are cones, whose distances are no linear function of stored values, or if the PLR is
        traced or stacked.
        """
        if isinstance(self.file, Tracer):
            raise ValueError("A traced PLR cannot be trained: call tunable() outside of jit and pass on its result.")
        with jax.ensure_compile_time_eval():  # a new array, which a jitted function may be given for its memory
            return TunablePLR(jax.device_put(self.parameter_map[0].astype(np.float32)), self)

    @cached_property
    def parameter_map(self) -> tuple[Any, ...]:
        """A map from changes of stored values to changes of :attr:`tables`, for :class:`TunablePLR`."""
        return parameter_map(self._contents, self.tables, np.zeros(self.dim))

    @cached_property
    def parameter_map_from_corner(self) -> tuple[Any, ...]:
        """A map from changes of stored values to changes of :attr:`tables_from_corner`."""
        return parameter_map(self._contents, self.tables_from_corner, self.domain.lo)

    def bounds(self, x: ArrayLike) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Return proven bounds of the distance at points of free space from which the goal can be reached.

        Return lower bounds, at least 0, and upper bounds, ``(...)`` each, for points ``(..., dim)``. Both are ``inf``
        outside the domain and where the PLR answers ``inf``, and NaN where a coordinate is NaN. In obstacles, and
        elsewhere where the goal cannot be reached, they are meaningless. ``ValueError`` if the PLR has no proof, or
        if the points are invalid (see :func:`evaluate`).

        The proof refers to the oracle or space that was given to :func:`construct`, :func:`certify` or
        :func:`solve_eikonal`, and covers the rounding of a query. It holds on the boundaries of obstacles. It does
        not hold at points that are free, or connected to the goal, only because of the workspace's tolerance. In a
        domain far from the origin, bounds hold for points as :func:`evaluate` rounds them.
        """
        band = self._require_band()
        x = x if isinstance(x, jax.Array) else as_queries(x)
        if (reader := self._reader_of_few(x)) is not None:
            return jax.device_put(reader.bounds(x))
        tables, x = self.tables_and_points(x)
        return bound_points(tables, band, x)

    @property
    def lower(self) -> "LowerBound":
        """A proven lower bound of the distance as a function of points: an admissible heuristic.

        The function returns the first result of :meth:`bounds`. The heuristic is not consistent, because it jumps
        between leaves: A* must reopen a node when it finds a shorter path to that node. For a grid, see
        :mod:`plr_jax.guides.heuristics`. ``plr.lower.stack([a.lower, b.lower])`` combines the lower bounds of a
        team's robots. ``ValueError`` if the PLR has no proof.
        """
        self._require_band()
        return LowerBound(self)

    def _require_band(self) -> Float[Array, "2 rows"]:
        if self.band is not None:
            if np.ndim(self.file) == 1 and not isinstance(self.file, Tracer):
                self.require_arrays_of_file()
            return self.band
        eikonal = "solve_eikonal with a space that classifies boxes and without certified=False"
        advice = f"construct it with certified=True, call certify(plr, oracle), or call {eikonal}"
        costs = "For cost_distance with bounds=True, result.lower and result.upper are proven instead."
        raise ValueError(f"Nothing is proven of this PLR: {advice}. {costs}")

    @property
    def max_error(self) -> float | None:
        """Proven upper bound of the PLR's error, in units of distance, at all points where :meth:`bounds` hold.

        It is ``inf`` if the error of some leaf has no upper bound, and None without a proof.
        """
        certificate = self._contents.certificate
        return None if certificate is None else certificate.max_error

    def waypoint(self, x: ArrayLike) -> Float[Array | np.ndarray, "*batch dim"]:
        """Return each point's next waypoint: the goal or corner (*source*) from which its leaf measures distances.

        A wall may lie between a point and its waypoint. Waypoints are rounded: test segments with a tolerance, as in
        ``workspace.is_visible(x, plr.waypoint(x), 1e-7 * plr.domain.width.max())``. At a source, the waypoint may
        be that source itself. For whole paths see :func:`trace`. Points ``x``, ``(..., dim)``, are given as for
        :func:`evaluate`. Waypoints, ``(..., dim)``, have the precision of ``x``. They are NaN outside the domain and
        where a coordinate is NaN, and have no meaning where the PLR answers ``inf``. For NumPy's 64-bit points in a
        domain far from the origin, the result is a NumPy array. ``ValueError`` if the leaves are not cones, or if the
        points are invalid (see :func:`evaluate`).
        """
        as_sourced(self.leaf)
        x = x if isinstance(x, jax.Array) else as_queries(x)
        if (reader := self._reader_of_few(x)) is not None:
            source = reader.waypoint(x)
            return source if source.dtype == np.float64 else jax.device_put(source)
        tables, x = self.tables_and_points(x)
        source = waypoints_of_points(tables, x)
        return source if tables is self.tables else self.domain.lo + np.asarray(source, np.float64)

    def which(self, x: ArrayLike) -> Int[Array | np.ndarray, "*batch"]:
        """Return the index of the goal that is nearest to each point ``(n, dim)``; -1 where the PLR is not finite.

        Where two goals are about equally near, the index may be wrong. If a goal was given twice, its first index is
        returned. ``ValueError`` if the PLR does not know its goals, or points have another shape.

        A file stores goals only if the PLR has cones and was built from a :class:`NearestGoal` of visibility graphs.
        Such a PLR also answers inside ``jit``, for points ``(..., dim)``. Any other PLR of several goals loses them
        when it is saved, and does not answer inside ``jit``; see :meth:`with_nearest_goal`.
        """
        if isinstance(x, Tracer):
            return goals_of_points(self.tables, require_goals(self.goals), x)
        x = as_points("x", x, self.dim)
        if self.nearest_goal:
            is_finite = np.isfinite(np.asarray(self(x)))
            goal = np.full(len(x), -1)
            goal[is_finite] = self.nearest_goal(x[is_finite])
            return goal
        if (reader := self._reader_of_few(x)) is not None:
            return reader.which(x)
        tables, x = self.tables_and_points(x)
        return np.asarray(goals_of_points(tables, require_goals(self.goals), x), np.int64)

    def numpy(self) -> NumpyPLR:
        """Return the PLR as a :class:`NumpyPLR`, which needs no JAX and is fast for single points."""
        return self._numpy

    @cached_property
    def _numpy(self) -> NumpyPLR:
        return NumpyPLR(self.to_bytes())

    def c_header(self, name: str, compact: bool = False) -> str:
        """Return the PLR as the text of a C99 header, which is also valid C++.

        The header defines ``float NAME_distance(const float x[dim])`` and, for cones, ``void NAME_waypoint(const
        float x[dim], float waypoint[dim])``. In a domain far from the origin, coordinates are doubles. The code
        allocates no memory, and calls only ``sqrtf`` and, if compact, ``memcpy`` and ``memset``. Results equal those
        of :meth:`numpy` bit for bit if compiled with ``-ffp-contract=off``.

        The comment at the top (if compact, at the end) says how many bytes of tables, code and stack the header takes
        on a Cortex-M4, and whether it computes with doubles. Plain tables typically take 4 (planes), 7 (cones), 15
        (continuous) or 45 (smooth leaves) times the size of the file.

        Args:
            name: Prefix of all definitions; ``ValueError`` if it is no C identifier.
            compact: True stores the bytes of :meth:`c_bytes` and a decoder, which take a half to a twelfth of the
                memory of plain tables: typically 1.3 (planes), 2 to 2.5 (cones, continuous) or 3 (smooth leaves)
                times the size of the file, and 1 to 7 KB of code. Queries then take two to five times as long, with
                smooth leaves 38 times.
        """
        return self.numpy().c_header(name, compact)

    def c_bytes(self) -> bytes:
        """Return the bytes that the decoder in a compact C header reads.

        A program can receive such bytes while it runs, and query them once the header's function ``plr_jax_open`` has
        accepted them. For PLR files of 1 KB or more in the plane, the bytes take one to four times the file's size.
        """
        return self.numpy().c_bytes()

    def js_module(self) -> str:
        """Return the PLR as the text of a JavaScript module without imports.

        The module exports ``distance(x)`` for an array of ``dim`` numbers, ``waypoint(x)`` if leaves are cones, and
        ``bounds(x)`` if there is a proof. Results equal those of :meth:`numpy` for 64-bit points, bit for bit.
        """
        return self.numpy().js_module()

    @staticmethod
    def stack(plrs: Sequence["PLR"]) -> TableStack:
        """Combine one PLR per robot of a team into a function of joint configurations, compiled as one.

        PLRs may differ in size, dimension and leaf model. The function maps joint configurations ``(n, robots,
        dof)``, NumPy, to distances ``(n, robots)``, float64. Each PLR is evaluated at the leading ``dim`` coordinates
        of its robot, with the same result as without the stack, bit for bit. ``ValueError`` if ``plrs`` is no list of
        PLRs. The function raises ``ValueError`` if the number of robots is wrong, or a PLR has more dimensions than
        ``dof``.
        """
        plrs = as_plrs(plrs)
        return TableStack(tuple(plrs), (None,) * len(plrs))

    def values_in_leaves(self, leaf: Int[np.ndarray, " n"], x: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, " n"]:
        """Evaluate the function of leaf ``leaf[i]`` at point ``x[i]``, also outside that leaf, in double precision.

        If the PLR is folded, points are first mirrored into :attr:`folded_domain`. Along periodic axes, they are
        then moved by whole periods to near the leaf's center.
        """
        is_inf = np.isinf(self._coefficients[leaf, 0])
        coefficients = np.where(is_inf[:, None], 0.0, self._coefficients[leaf])
        lo, hi = self.cells.boxes(self.folded_domain)
        folding = self.container.folding
        x = self.folded_domain.image_near(x if folding is None else folding(x), (lo + hi)[leaf] / 2)
        return np.where(is_inf, np.inf, self.leaf.values(lo[leaf], hi[leaf], coefficients, x))

    @property
    def leaf(self) -> LeafModel:
        """Leaf model; its ``name`` is the ``leaf`` argument of :func:`construct`."""
        return self.tables.leaf

    @property
    def dim(self) -> int:
        """Number of coordinates of a point."""
        return self.tables.dim

    @cached_property
    def container(self) -> Container:
        return Container.from_bytes(self.file_bytes)

    @cached_property
    def domain(self) -> Box:
        """Closed box that the PLR covers."""
        return self.container.domain

    @property
    def folded_domain(self) -> Box:
        """Closed box that the leaves partition: the domain or, with mirror symmetries, the box of mirrored points."""
        return self.container.folded_domain

    @cached_property
    def cells(self) -> Cells:
        """Cells of the leaves, in left-to-right traversal order of the tree."""
        return read_tree(BitReader(self.container.last.body), self.dim).leaves

    @property
    def stored(self) -> Any:
        """Decoded data of all leaves, exactly as in the file; the type depends on the leaf model."""
        return self._contents.stored

    @property
    def num_leaves(self) -> int:
        """Number of leaves, which is the number of final cells."""
        return len(self.cells)

    @property
    def depth(self) -> int:
        """Largest number of splits between the root and a leaf."""
        return int(self.cells.depth.sum(axis=1).max())

    @property
    def leaf_boxes(self) -> tuple[Float[np.ndarray, "boxes dim"], Float[np.ndarray, "boxes dim"]]:
        """Lower and upper corners of the leaves' boxes, ``(boxes, dim)`` each.

        If the PLR is folded by mirror symmetries, the mirror images of the leaves are boxes, too. ``ValueError`` if
        the axes of the symmetries are rotated against the axes of the domain.
        """
        return self._boxes[:2]

    @property
    def leaf_of_box(self) -> Int[np.ndarray, " boxes"]:
        """Index of the leaf to which each box in :attr:`leaf_boxes` belongs."""
        return self._boxes[2]

    @cached_property
    def _boxes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        lo, hi = self.cells.boxes(self.folded_domain)
        folding = self.container.folding
        return (lo, hi, np.arange(len(lo))) if folding is None else folding.boxes(lo, hi)

    @property
    def unreachable(self) -> Bool[np.ndarray, " leaves"]:
        """Whether the file marks each leaf as having no path to the goal.

        Such a leaf continues the plane of a neighbor, or answers ``inf``.
        """
        is_inf = np.isinf(self.leaf.coefficients(self.cells, self.stored)[:, 0])
        cut_off = self._contents.cut_off
        return is_inf if cut_off is None else is_inf | cut_off

    @property
    def num_unreachable(self) -> int:
        """Number of leaves that answer ``inf``; :attr:`unreachable` may mark more leaves."""
        return int(np.isinf(self.intercept).sum())

    @property
    def slope(self) -> Float[np.ndarray, "leaves dim"]:
        """Gradient of each leaf's plane (of a curved leaf's mean plane), in coordinates of :attr:`folded_domain`."""
        return self._planes[1]

    @property
    def intercept(self) -> Float[np.ndarray, " leaves"]:
        """Constant term of each leaf's plane ``slope @ x + intercept``; ``inf`` for leaves that answer ``inf``."""
        return self._planes[0]

    def __repr__(self) -> str:
        try:
            size = f"dim={self.dim}, num_leaves={self.num_leaves}, num_bytes={self.num_bytes}"
            return f"PLR({self.leaf.name!r}, {size}, {self.domain})"
        except (TypeError, ValueError):
            return f"PLR({self.leaf.name!r}, of arrays that are traced, stacked or replaced)"

    @cached_property
    def _contents(self) -> DecodedFile:
        return decode(self.to_bytes())

    @cached_property
    def _coefficients(self) -> Float[np.ndarray, "leaves terms"]:
        return filled_coefficients(self._contents)

    @cached_property
    def _planes(self) -> tuple[Float[np.ndarray, " leaves"], Float[np.ndarray, "leaves dim"]]:
        """Constant term and gradient of each leaf's plane, or of a curved leaf's mean plane."""
        contents, coefficients = self._contents, self._coefficients
        is_inf = np.isinf(coefficients[:, 0])
        lo, hi = contents.tree.leaves.boxes(contents.domain)
        center, half = contents.leaf.mean_planes(lo, hi, np.where(is_inf[:, None], 0.0, coefficients))
        slope = half * 2 / (hi - lo)
        return np.where(is_inf, np.inf, center - np.sum(slope * (lo + hi) / 2, axis=1)), slope


def as_plrs(plrs: Sequence[PLR]) -> list[PLR]:
    return as_list("plrs", plrs, "PLRs, such as [plr]", lambda plr: isinstance(plr, PLR))


def tables_of_contents(contents: DecodedFile, origin: Corner, num_bytes: int) -> Tables:
    """Build the lookup tables of a decoded file of ``num_bytes`` bytes, for points given relative to ``origin``."""
    domain, numbers = relative_to_origin(contents, origin)
    leaf = leaf_model(contents.leaf.name)  # as from a file, without the options of a construction
    tables = build_tables(domain, contents.tree.leaves, numbers, leaf, num_bytes)
    if contents.straight is not None:
        tables = replace(tables, straight=jax.device_put(contents.straight.arrays))
    return tables if contents.folding is None else tables.with_folding(contents.folding, origin)


@pytree
class LowerBound:
    """A function that is proven never to exceed the true distance; see :attr:`plr_jax.PLR.lower`."""

    plr: Any  # a PLR or a stack of PLRs
    is_lower_bound = True  # tells planners that the function is an admissible heuristic

    @property
    def dim(self) -> int:
        return self.plr.dim

    def __call__(self, *x: ArrayLike) -> Float[Array, "*batch"]:
        """Return a lower bound of the distance at each point ``(..., dim)``; see :meth:`PLR.bounds`.

        The argument is ``x``. For a stack, the arguments are ``index, x``, as for :meth:`PLRStack.bounds`.
        """
        return self.plr.bounds(*x)[0]

    @staticmethod
    def stack(fns: Sequence["LowerBound"]) -> TableStack:
        """Combine one lower bound per robot into a function of joint configurations; see :meth:`PLR.stack`."""
        fns = as_list("fns", fns, "lower bounds, such as [plr.lower]", lambda fn: isinstance(fn, LowerBound))
        return replace(PLR.stack([fn.plr for fn in fns]), bands=tuple(fn.plr.band for fn in fns))


def from_bytes(data: bytes) -> PLR:
    """Decode a PLR from the result of :meth:`PLR.to_bytes`; both PLRs give the same answers, bit for bit.

    ``ValueError`` if the bytes are no PLR file of a version that this release reads, distances do not fit 32-bit
    floats, or the lookup tables would be far larger than usual for a file of this size.
    """
    if not isinstance(data, bytes | bytearray | memoryview):
        raise ValueError(f"data must be the bytes of a PLR file, got {shortened(data)}. Use load for a file's name.")
    data = bytes(data)
    return plr_of_leaves(decode(data), data=data)


def plr_of_leaves(contents: DecodedFile, data: bytes | None = None) -> PLR:
    """Build a PLR and its lookup tables from the content of a file; ``data`` has the file's bytes, if known."""
    plr = PLR(padded_file(encode(contents) if data is None else data))
    plr._contents = contents
    plr.domain = contents.domain if contents.folding is None else contents.folding.domain
    # Compute what queries need, then drop the decoded content, which takes memory and can be decoded again.
    _ = plr.tables, plr.band, plr.goals, plr._corner_if_far
    del plr._contents
    return plr
