"""The piecewise linear regression: a partition of a box and a function in every leaf, ready to be queried."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.tree_util import GetAttrKey
from jaxtyping import Array, Bool, Float, Int, UInt8

from plr_jax._arrays import as_queries, no_attribute, padded, padded_size, require_integer, shortened
from plr_jax._types import ArrayLike, DistanceFn
from plr_jax.geometry.box import Box
from plr_jax.plr._file import (
    DecodedFile,
    decode,
    decode_cells,
    encode,
    filled_coefficients,
    planes_of_leaves,
    relative_to_origin,
)
from plr_jax.plr._proof import BuildInputs, require_updatable, updated_contents
from plr_jax.plr.certificate import Certificate
from plr_jax.plr.container import Container, FileBacked, padded_file
from plr_jax.plr.frame import Corner, Outside, as_outside, corner_if_far
from plr_jax.plr.leaves import as_sourced
from plr_jax.plr.leaves.base import LeafModel
from plr_jax.plr.portable.numpy import NumpyPLR
from plr_jax.plr.query import (
    PointPlacement,
    TableStack,
    bound_points,
    evaluate_points,
    evaluate_points_anywhere,
    find_leaves,
    waypoints_of_points,
)
from plr_jax.plr.tables import Tables, build_tables
from plr_jax.plr.tree import Cells


@jax.tree_util.register_pytree_with_keys_class
class PLR(FileBacked):
    """A distance function stored over a binary space partition (Section III of the paper).

    Made by :func:`construct` and :func:`load`; ``plr(x)`` is :func:`evaluate`. A PLR is a pytree of arrays: a
    jitted function can close over it or take it as an argument. Inside such a function it can be queried; its
    other properties are for the host.

    ``jax.grad`` differentiates with respect to points. A PLR itself has integer tables, so ``jax.grad`` with respect
    to a PLR raises ``TypeError``.

    Attributes:
        file: The bytes that :func:`save` writes, padded with zeros, then their number: see ``held`` in
            ``plr/container.py``.
    """

    def __init__(
        self, file: UInt8[Array, "padded"] | UInt8[np.ndarray, "padded"], *, build_inputs: BuildInputs | None = None
    ) -> None:
        """Wrap the padded bytes of a file, which must be right: see :func:`from_bytes`.

        ``build_inputs`` is what the PLR was built from; :meth:`updated` starts with it. It is not part of the pytree.
        """
        self.file = file
        self.build_inputs = build_inputs

    @cached_property
    def tables(self) -> Tables:
        """What a query reads, derived from ``file`` alone."""
        contents = self._contents
        with jax.ensure_compile_time_eval():  # also in a function that is traced and closes over the PLR
            return tables_of_contents(contents, np.zeros(contents.domain.dim), self.num_bytes)

    @cached_property
    def band(self) -> Float[Array, "2 rows"] | None:
        """Proven lower and upper bounds of the distance minus an answer; None if nothing is proven.

        It has one row for all leaves, or one a leaf, padded to a power of two; see :meth:`bounds`.
        """
        if (certificate := self._contents.certificate) is None:
            return None
        bounds = certificate.bounds().astype(np.float32)
        rows = bounds.shape[1] if bounds.shape[1] == 1 else padded_size(bounds.shape[1])
        with jax.ensure_compile_time_eval():
            return jnp.asarray(padded(bounds.T, rows).T)

    @cached_property
    def _straight(self) -> Float[Array, "_"] | None:
        """The lower bound by the straight line: see :class:`Certificate`."""
        certificate = self._contents.certificate
        if certificate is None or certificate.straight is None:
            return None
        return jax.device_put(certificate.straight.astype(np.float32))

    def tree_flatten_with_keys(self) -> tuple[tuple[tuple[GetAttrKey, Any], ...], None]:
        """Return the tables, the file, the band and the straight line."""
        names = ("tables", "file", "band", "_straight")
        return tuple((GetAttrKey(name), getattr(self, name)) for name in names), None

    @classmethod
    def tree_unflatten(cls, _: None, children: tuple[Any, Any, Any, Any]) -> "PLR":
        """Return the PLR of tables, a file, a band and a straight line."""
        tables, file, band, straight = children
        plr = cls(file)
        plr.tables, plr.band, plr._straight = tables, band, straight
        return plr

    def __getattr__(self, name: str) -> Any:
        raise no_attribute(
            self,
            name,
            "It does not change: plr.updated(oracle) is one of a map that did; of another goal construct one.",
        )

    def with_label(self, label: str) -> "PLR":
        """Return the PLR with another label: see :meth:`FileBacked.with_label`."""
        labeled = super().with_label(label)
        if labeled is not self:
            labeled.tables, labeled.band, labeled.build_inputs = self.tables, self.band, self.build_inputs
            labeled._straight = self._straight
        return labeled

    def __call__(self, x: ArrayLike, *, outside: Outside = "inf") -> Float[Array, "*batch"]:
        """Same as :func:`evaluate`."""
        tables, placed = self._tables_and_points(x)
        if outside == "inf":
            return evaluate_points(tables, placed)
        return evaluate_points_anywhere(tables, placed, as_outside(outside))

    def _tables_and_points(self, x: ArrayLike) -> tuple[Tables, ArrayLike]:
        """Tables to ask and points to ask them for."""
        if isinstance(x, jax.Array):
            return self.tables, x
        x = as_queries(x)
        if x.dtype == np.float64 and x.shape[-1:] == (self.tables.dim,):
            tables, placement = self._tables_and_placement
            return tables, x if placement is None else placement(x)
        return self.tables, x

    @property
    def _tables_and_placement(self) -> tuple[Tables, PointPlacement | None]:
        """The tables for NumPy's 64-bit points, and what to do with these before they are rounded; None: nothing."""
        if isinstance(self.file, Tracer):
            return self.tables, None
        has_doubles = jax.dtypes.canonicalize_dtype(np.float64) == np.float64
        corner = None if has_doubles else self._corner_if_far
        if corner is None and not self.tables.periodic:
            return self.tables, None
        placement = PointPlacement(self.domain if self.tables.periodic else None, corner)
        return self.tables if corner is None else self.tables_from_corner, placement

    @cached_property
    def _corner_if_far(self) -> Corner | None:
        return corner_if_far(self.domain)

    @cached_property
    def tables_from_corner(self) -> Tables:
        """The tables for points counted from the lower corner of a domain that is far from the origin."""
        return tables_of_contents(self._contents, self.domain.lo, self.num_bytes)

    def bounds(self, x: ArrayLike) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Proven bounds of the distance at each point from which the goal can be reached.

        The proof is about what :func:`construct`, :func:`certify` or :func:`solve_eikonal` was given, at points of
        free space, walls included, but not at such as count as free, or reach the goal, to the workspace's tolerance
        alone. It covers what a query rounds. But in a domain far from the origin, as in UTM coordinates, 32-bit
        floats resolve points worse than cells: of JAX's, and under ``jax.jit``, it is about the points that rounding
        makes of them. Give NumPy's 64-bit points, outside of ``jit``, or enable ``jax_enable_x64``.

        Args:
            x: Points, ``(..., dim)``, as for :func:`evaluate`.

        Returns:
            Lower bounds, at least 0, and upper bounds, ``(...)`` each. Both are ``inf`` outside the domain, NaN where
            a coordinate is. In obstacles, and where the goal cannot be reached, they mean nothing.

        Raises:
            ValueError: If nothing is proven of the PLR, or as for :func:`evaluate`.
        """
        band, (tables, placed) = self._require_band(), self._tables_and_points(x)
        return bound_points(tables, band, self._straight, placed)

    @property
    def lower(self) -> "LowerBound":
        """A distance function that is nowhere above the truth, an admissible heuristic; stacks as a PLR does.

        What a leaf answers, less ``max_error``, or less the leaf's own bound if the proof has bounds of leaves, which
        is far closer to the truth. It jumps from leaf to leaf, and so is not consistent: a search must open nodes
        again to which it finds a shorter way.

        Of points ``(..., dim)`` as :meth:`bounds` takes them: at least 0, ``inf`` outside the domain, NaN for NaN;
        where the goal cannot be reached it means nothing. Raises ``ValueError`` if nothing is proven of the PLR.
        """
        self._require_band()
        return LowerBound(self)

    def _require_band(self) -> Float[Array, "2 rows"]:
        if self.band is not None:
            return self.band
        raise ValueError(
            "Nothing is proven of this PLR: construct it with certified=True, use certify(plr, oracle), or give "
            "solve_eikonal a space that classifies boxes, without certified=False."
        )

    @property
    def max_error(self) -> float | None:
        """Proven bound of the largest error anywhere, in units of distance; None if nothing is proven.

        ``inf`` where some leaf is bounded from below alone, as mostly by :func:`solve_eikonal`: see :meth:`bounds`.
        """
        certificate = self._contents.certificate
        return None if certificate is None else certificate.max_error

    def waypoint(self, x: ArrayLike) -> Float[Array | np.ndarray, "*batch dim"]:
        """Where to go straight to from each point: the source of the leaf that holds it.

        A leaf may name the very source that a point is at: for whole paths, see :func:`trace`. It knows no walls.

        Args:
            x: Points, ``(..., dim)``, as for :func:`evaluate`.

        Returns:
            Points, ``(..., dim)``, in the same precision; NaN outside the domain and for NaN. Of NumPy's 64-bit
            points in a domain far from the origin, NumPy's.

        Raises:
            ValueError: If leaves have no sources, as only those of cones do, or as for :func:`evaluate`.
        """
        as_sourced(self.leaf)
        tables, placed = self._tables_and_points(x)
        source = waypoints_of_points(tables, placed)
        return source if tables is self.tables else self.domain.lo + np.asarray(source, np.float64)

    def updated(self, oracle: DistanceFn, before: DistanceFn | None = None, *, max_bytes: int | None = None) -> "PLR":
        """The PLR of a map that has changed here and there, with its proof, far sooner than one made from nothing.

        Of certified cones. Leaves in which all distances are proven to have changed by one number stay, with their
        sources, whose distances are kept in one place. Elsewhere the best leaves are found anew, at the price of a
        leaf that the others have: the mean error is about that of a PLR made from nothing. As far as the budget is
        exceeded leaves are put together, where it is not used up those are made anew that err most. A PLR in memory
        keeps its oracle, and what is known of its tree from one change to the next; the first change takes longer, as
        does one of a PLR from a file.

        Args:
            oracle: The oracle of the map as it is now, such as ``before.with_workspace(workspace)``, for the same
                goal.
            before: The one that the PLR is of; None: the one that it was made or last updated of, in this process.
            max_bytes: Most bytes of the file; None: as when it was made, with the other limits that it had then; or,
                of a file, as many as it has.

        Returns:
            The PLR, of the same domain, label and kind of proof. ``bounds`` hold as those of a new one do. This one
            is as it was, also if that is interrupted.

        Raises:
            ValueError: If it is not one of cones with a proof, the oracles are no visibility graphs of one goal, what
                it is of is not known, or found to be another one than ``before``, or as for :func:`construct`.
        """
        require_updatable(self._contents)
        inputs = self.build_inputs
        if inputs is None:
            if before is None:
                raise ValueError(
                    "What this PLR was made of is not known, as of one from a file: give the oracle of the map "
                    "before, plr.updated(oracle, before)."
                )
            inputs = BuildInputs(before, self.num_bytes)
        elif before is not None and before is not inputs.oracle:
            inputs = replace(inputs, oracle=before, bounds=None, node_costs=None)
        if max_bytes is not None:
            require_integer("max_bytes", max_bytes, 1)
            inputs = replace(inputs, max_bytes=int(max_bytes))
        contents, inputs = updated_contents(self._contents, inputs, oracle, self.label)
        plr = plr_of_leaves(contents, inputs).with_label(self.label)
        plr._contents = contents
        return plr

    def numpy(self) -> NumpyPLR:
        """The same in NumPy alone, by the arithmetic that is part of the file format: quick for a single point."""
        return NumpyPLR(self.to_bytes())

    def c_header(self, name: str) -> str:
        """The same as one header of C99, also valid C++: without heap, with no function of a library but ``sqrtf``.

        It defines ``float NAME_distance(const float x[dim])``, and of cones ``void NAME_waypoint(const float x[dim],
        float waypoint[dim])``; in a domain far from the origin coordinates are doubles. Answers are those of
        :meth:`numpy`, bit for bit, where nothing is fused: compile with ``-ffp-contract=off``.

        Args:
            name: With which all that it defines begins, an identifier of C.

        Returns:
            The text of the header.

        Raises:
            ValueError: If the name is no identifier.
        """
        return self.numpy().c_header(name)

    def js_module(self) -> str:
        """The same as one module of JavaScript, which imports nothing.

        It exports ``distance(x)`` of a point, an array of ``dim`` numbers, and of cones ``waypoint(x)``, an array
        again. Answers are those of :meth:`numpy` to points of 64 bits, as numbers of JavaScript are, bit for bit.

        Returns:
            The text of the module.
        """
        return self.numpy().js_module()

    @staticmethod
    def stack(plrs: Sequence["PLR"]) -> TableStack:
        """One function of all robots' PLRs: a batch of joint configurations in one compiled call.

        Args:
            plrs: One PLR a robot; they may differ in size, dimension and leaf model.

        Returns:
            A function of joint configurations ``(n, robots, dof)``, NumPy, that returns each robot's distance
            ``(n, robots)``, float64: bit for bit what its PLR answers for its leading coordinates.

        Raises:
            ValueError: If they are not a list of PLRs, at least one. When called, if the robots are not as many as
                the PLRs, or a PLR has more dimensions than there are coordinates.
        """
        plrs = as_plrs(plrs)
        tables, placements = zip(*(plr._tables_and_placement for plr in plrs), strict=True)
        return TableStack(tables, (None,) * len(plrs), placements)

    def values_in_leaves(self, leaf: Int[np.ndarray, "n"], x: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n"]:
        """Value at each point of a given leaf's function, continued where the point lies outside the leaf.

        Args:
            leaf: Index of each point's leaf.
            x: The points; around periodic axes, those nearest to the leaf's center that they stand for.

        Returns:
            The values in double precision, ``inf`` for leaves that answer ``inf``.
        """
        is_inf = np.isinf(self._coefficients[leaf, 0])
        coefficients = np.where(is_inf[:, None], 0.0, self._coefficients[leaf])
        lo, hi = self.cells.boxes(self.folded_domain)
        folding = self.container.folding
        x = self.folded_domain.image_near(x if folding is None else folding(x), (lo + hi)[leaf] / 2)
        return np.where(is_inf, np.inf, self.leaf.values(lo[leaf], hi[leaf], coefficients, x))

    @property
    def leaf(self) -> LeafModel:
        """The leaf model; ``leaf.name`` is what :func:`construct` calls it."""
        return self.tables.leaf

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.tables.dim

    @cached_property
    def container(self) -> Container:
        """The file."""
        return Container.from_bytes(self.to_bytes())

    @cached_property
    def domain(self) -> Box:
        """The closed box that the PLR covers."""
        return self.container.domain

    @property
    def folded_domain(self) -> Box:
        """The closed box that leaves partition: the domain, or that of folded points, seen from their center."""
        return self.container.folded_domain

    @cached_property
    def cells(self) -> Cells:
        """The leaves' cells, in the order of the tree's left-to-right traversal."""
        return decode_cells(self.to_bytes())

    @property
    def stored(self) -> Any:
        """What the leaf model stores of the leaves, exactly as in the file."""
        return self._contents.stored

    @property
    def num_leaves(self) -> int:
        """Number of leaves of the partition."""
        return len(self.cells)

    @property
    def depth(self) -> int:
        """Largest number of splits between the root and a leaf."""
        return int(self.cells.depth.sum(axis=1).max())

    @property
    def leaf_boxes(self) -> tuple[Float[np.ndarray, "boxes dim"], Float[np.ndarray, "boxes dim"]]:
        """Corners of the leaves, or of all boxes that fold into one each; ``ValueError`` where those are no boxes."""
        return self._boxes[:2]

    @property
    def leaf_of_box(self) -> Int[np.ndarray, "boxes"]:
        """The leaf of each of :attr:`leaf_boxes`."""
        return self._boxes[2]

    @cached_property
    def _boxes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        lo, hi = self.cells.boxes(self.folded_domain)
        folding = self.container.folding
        return (lo, hi, np.arange(len(lo))) if folding is None else folding.boxes(lo, hi)

    @property
    def unreachable(self) -> Bool[np.ndarray, "leaves"]:
        """Leaves of which nothing was found to reach the goal: they borrow a neighbor's plane or answer ``inf``."""
        return self.leaf.coefficients(self.cells, self.stored)[:, 0] == np.inf

    @property
    def num_unreachable(self) -> int:
        """Number of leaves that answer ``inf``."""
        return int(np.isinf(self.intercept).sum())

    @property
    def slope(self) -> Float[np.ndarray, "leaves dim"]:
        """Slope of every leaf's (mean) plane, in the folded domain."""
        return self._planes[1]

    @property
    def intercept(self) -> Float[np.ndarray, "leaves"]:
        """Intercept of every leaf's (mean) plane ``slope . x + intercept``; ``inf`` where a leaf answers it."""
        return self._planes[0]

    def __repr__(self) -> str:
        if np.ndim(self.file) != 1 or isinstance(self.file, Tracer):
            return f"PLR({self.leaf.name!r}, of arrays that are traced or stacked)"
        return (
            f"PLR({self.leaf.name!r}, dim={self.dim}, num_leaves={self.num_leaves}, num_bytes={self.num_bytes}, "
            f"{self.domain})"
        )

    @cached_property
    def _contents(self) -> DecodedFile:
        return decode(self.to_bytes())

    @cached_property
    def _coefficients(self) -> Float[np.ndarray, "leaves terms"]:
        return filled_coefficients(self._contents)

    @cached_property
    def _planes(self) -> tuple[Float[np.ndarray, "leaves"], Float[np.ndarray, "leaves dim"]]:
        return planes_of_leaves(self._contents, self._coefficients)


def as_plrs(plrs: Iterable[PLR]) -> list[PLR]:
    """A list of PLRs that are stacked, at least one, or ``ValueError``."""
    if not isinstance(plrs, Iterable):
        raise ValueError(f"plrs must be a list of PLRs, got {shortened(plrs)}; for one give [plr].")
    plrs = list(plrs)
    for i, plr in enumerate(plrs):
        if not isinstance(plr, PLR):
            raise ValueError(f"Only PLRs can be stacked, number {i} is {shortened(plr)}.")
    if not plrs:
        raise ValueError("A stack needs at least one PLR, got none.")
    return plrs


def tables_of_contents(contents: DecodedFile, origin: Corner, num_bytes: int) -> Tables:
    """What queries read of a file of so many bytes, for points counted from an origin."""
    domain, numbers = relative_to_origin(contents, origin)
    tables = build_tables(domain, contents.tree.leaves, numbers, contents.leaf, num_bytes)
    return tables.with_folding(contents.folding, origin)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class LowerBound:
    """A distance function that is nowhere above the truth: see :attr:`plr_jax.PLR.lower`.

    Attributes:
        plr: The PLR.
        is_lower_bound: True, by which planners know.
    """

    plr: PLR
    is_lower_bound = True

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.plr.dim

    def __call__(self, x: ArrayLike) -> Float[Array, "*batch"]:
        """The lower of the bounds, of points ``(..., dim)``."""
        return self.plr.bounds(x)[0]

    @staticmethod
    def stack(fns: Sequence["LowerBound"]) -> TableStack:
        """One function of all robots' lower bounds, as PLRs stack."""
        if not fns or not all(isinstance(fn, LowerBound) for fn in fns):
            raise ValueError(f"Lower bounds of PLRs can be stacked, at least one, got {shortened(fns)}.")
        first, *_ = fns
        return replace(
            first.plr.stack([fn.plr for fn in fns]), bands=tuple((fn.plr.band, fn.plr._straight) for fn in fns)
        )


def from_bytes(data: bytes) -> PLR:
    """The PLR that a file's bytes hold.

    Args:
        data: What :meth:`PLR.to_bytes` gave.

    Returns:
        The PLR, which answers as the one that was written, bit for bit.

    Raises:
        ValueError: If the bytes are not those of a PLR file of a version this release reads, its distances are
            beyond 32-bit floats, or reading it would take far more than a file of its size ought to.
    """
    if not isinstance(data, bytes | bytearray | memoryview):
        raise ValueError(f"data must be the bytes of a PLR file, got {shortened(data)}.")
    data = bytes(data)
    return _assemble(data, decode(data))


def plr_of_leaves(contents: DecodedFile, build_inputs: BuildInputs | None = None) -> PLR:
    """Return the PLR that the file of these leaves gives, bit for bit, without reading the file."""
    return _assemble(encode(contents), contents, build_inputs)


def _assemble(data: bytes, contents: DecodedFile, build_inputs: BuildInputs | None = None) -> PLR:
    """Return the PLR of a file's bytes, with all that the first query needs; it does not keep the contents."""
    plr = PLR(padded_file(data), build_inputs=build_inputs)
    plr._contents = contents
    plr.domain = contents.domain if contents.folding is None else contents.folding.domain
    _ = plr.tables, plr.band, plr._straight, plr._corner_if_far
    del plr._contents
    return plr


def with_certificate(plr: PLR, certificate: Certificate) -> PLR:
    """The same PLR with another proof."""
    return plr_of_leaves(replace(plr._contents, certificate=certificate)).with_label(plr.label)


def leaf_of(plr: PLR, x: Float[np.ndarray, "*batch dim"]) -> Int[np.ndarray, "*batch"]:
    """Index of the leaf that answers for each point."""
    tables, placement = plr._tables_and_placement
    return np.asarray(find_leaves(tables, x if placement is None else placement(x))).astype(np.int64)
