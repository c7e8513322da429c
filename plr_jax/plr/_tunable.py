"""PLRs whose stored values can be trained by gradient descent: :class:`TunablePLR`.

A query reads the parameters of leaves. These are linear functions of the values that a file stores. So a tunable PLR
adds the effect of the values' changes to the parameters, and then asks the query that all PLRs use.
"""

from bisect import bisect_left
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from plr_jax._arrays import as_queries, require_integer
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.plr._file import DecodedFile, encode, filled_coefficients
from plr_jax.plr.container import padded_file
from plr_jax.plr.frame import Corner, Frame
from plr_jax.plr.leaves.base import Coefficients, LinearLeafModel
from plr_jax.plr.query import evaluate_tables
from plr_jax.plr.tables import Tables


def parameter_map(contents: DecodedFile, tables: Tables, origin: Corner) -> tuple[Any, ...]:
    """Return the linear map from changes of free values to changes of the parameters that a query reads.

    Free values are the numbers in a file that determine all leaf functions: see :meth:`LinearLeafModel.free_values`.
    ``tables`` are lookup tables of the file for points relative to ``origin``. The map consists of these arrays:

    - the free values of the file, ``(values,)``, in 64 bits on the host, and in 32 bits;
    - the weights, rows and columns of the entries of a sparse matrix, ``(entries,)`` each, sorted by row. The matrix
      maps values to ``terms`` intermediate numbers of each leaf;
    - a matrix ``(terms, count)`` from the intermediate numbers of any leaf to the leaf's parameters;
    - the place of each of these parameters in the flat ``tables.leaf_parameters``, ``(leaves, count)``.

    ``ValueError`` if parameters are no linear functions of stored values.
    """
    from scipy.sparse import csr_array

    leaf, cells, domain = contents.leaf, contents.tree.leaves, contents.domain
    if not isinstance(leaf, LinearLeafModel):
        raise ValueError(f"Only leaves 'plane', 'continuous' and 'smooth' can be trained, got {leaf.name!r}.")
    # Leaf functions take points relative to `corner`. If the PLR is folded, points are relative to the center of the
    # mirrors instead of `origin`: see `relative_to_origin`.
    corner = origin * (contents.folding is None) + np.asarray(tables.frame, np.float64)[Frame.LO]
    is_free = np.isfinite(leaf.coefficients(cells, contents.stored)[:, :1])

    def filled(coefficients: Float[np.ndarray, "... terms"]) -> Coefficients:
        of_leaves = filled_coefficients(contents, np.where(is_free, coefficients, np.inf))
        return np.where(np.isinf(of_leaves[:, :1]), 0.0, of_leaves)  # no value changes leaves that answer ``inf``

    # 1. A leaf may continue the plane of another one, its source. To find it, store each leaf's index as a constant.
    constants = leaf.coefficients_of_planes(np.arange(len(cells)) + 0.0, np.zeros((len(cells), cells.dim)))
    source = np.rint(leaf.mean_planes(*cells.boxes(domain), filled(constants))[0]).astype(np.int64)
    # 2. The effect of each coefficient of the source. If functions are ``is_cell_relative``, one matrix turns the
    #    coefficients of any leaf into parameters. Other models have a matrix for each leaf.
    units = shared = np.eye(constants.shape[1])
    effects = [filled(unit) for unit in units]
    if leaf.is_cell_relative:
        shared = leaf.leaf_parameters(domain, cells[np.zeros(len(units), np.int64)], units, corner)[:, cells.dim :]
    else:
        effects = [leaf.leaf_parameters(domain, cells, effect, corner) for effect in effects]
    effects = np.stack(effects, axis=2)  # (leaves, terms, terms of the source)
    at, row, column = np.nonzero(effects)
    entries = effects[at, row, column], (len(units) * at + row, len(units) * source[at] + column)
    values, of_values = leaf.free_values(cells, contents.stored)
    matrix = (csr_array(entries, 2 * [len(cells) * len(units)]) @ of_values).tocoo()  # sorted by row
    # 3. Places in the layouts of ``arrange_parameters``. The first parameters describe the cell and stay fixed.
    table, count = tables.leaf_parameters, leaf.num_leaf_parameters(cells.dim)
    places = np.arange(table.size).reshape((-1, count), order="F" if table.ndim == 2 else "C")
    arrays = values, matrix.data, matrix.row, matrix.col, shared, places[: len(cells), -shared.shape[1] :]
    with jax.ensure_compile_time_eval():  # the PLR may be closed over by a traced function
        device = (jax.device_put(each.astype(np.float32 if each.dtype == float else np.int32)) for each in arrays)
        return values, *device


@jax.jit
def _evaluate(tables: Tables, of_values: tuple[Any, ...], changes: Array, x: Array) -> Array:
    # Only changes pass through the map, so initial values give the answers of the PLR, bit for bit. Without the
    # barrier, the compiler would take seconds to fold constant values. The last step is no sum but a scatter, since
    # the compiler would repeat the sum at each point.
    weight, row, column, shared, places = of_values
    terms = weight * jax.lax.optimization_barrier(changes)[column]
    numbers = jnp.zeros(len(places) * len(shared), np.float32).at[row].add(terms, indices_are_sorted=True)
    change = jnp.matmul(numbers.reshape(len(places), -1), shared, precision="highest")
    parameters = tables.leaf_parameters.ravel().at[places].add(change, unique_indices=True)
    return evaluate_tables(replace(tables, leaf_parameters=parameters.reshape(tables.leaf_parameters.shape)), x)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class TunablePLR:
    """A PLR whose stored values can be trained: a pytree with one leaf, the array ``values``.

    :meth:`PLR.tunable` makes it. ``tunable(x)`` is differentiable with respect to the values and to the points, under
    ``jax.jit``, ``jax.vmap`` and ``jax.grad``. So ``jax.grad`` of a loss is a TunablePLR too, as optax expects. The
    tree, its leaves and all indices are constants: a jitted function is compiled once for all values. Only
    TunablePLRs from one PLR can be combined, as by ``jax.tree.map``.

    Attributes:
        values: Numbers in units of distance, ``(n,)``, float32. For planes, the coefficients of one reachable leaf
            after another: the value at the center, then half of the rise across the leaf along each axis. For
            continuous and smooth leaves, the values at corners of leaves. Leaves share these values, so functions
            stay continuous across free faces, as do the gradients of smooth leaves.
        plr: The PLR from whose file the initial values come; training does not change it.
    """

    values: Any  # an array, or what JAX puts in its place
    plr: Any = field(metadata={"static": True})

    @property
    def dim(self) -> int:
        """Number of coordinates of a point."""
        return self.plr.dim

    @property
    def domain(self) -> Box:
        """Closed box that the PLR covers."""
        return self.plr.domain

    def __repr__(self) -> str:
        return f"TunablePLR(num_values={np.size(self.values)}, {self.plr})"

    def __call__(self, x: ArrayLike) -> Float[Array, "*batch"]:
        """Return the distance at each point ``x``, ``(..., dim)``, as :func:`evaluate` does.

        With the initial values, answers are those of the compiled PLR, bit for bit. A leaf without values answers
        ``inf`` or continues the plane of a neighbor. Some files of :func:`solve_eikonal` have a lower bound by
        straight lines. Then answers are at least this bound, also after training: where the bound is larger than the
        leaf's function, the gradient with respect to the values is 0. ``ValueError`` if points are invalid, or if
        ``values`` has another shape than the initial values: use ``jax.vmap`` for stacked values.
        """
        x = x if isinstance(x, jax.Array) else as_queries(x)
        tables, x = self.plr.tables_and_points(x)
        of_values = self.plr.parameter_map if tables is self.plr.tables else self.plr.parameter_map_from_corner
        return _evaluate(tables, of_values[2:], self._changes(), x)

    def _changes(self) -> Array:
        if np.shape(self.values) != (initial := self.plr.parameter_map[1]).shape:
            raise ValueError(f"values must have shape {initial.shape}, got {np.shape(self.values)}.")
        return (self.values - initial).astype(np.float32)

    def to_plr(self, max_bytes: int | None = None) -> Any:
        """Return a :class:`PLR` with the values, rounded as its file stores them.

        Nothing is proven of this PLR: :meth:`PLR.bounds` raises ``ValueError`` unless :func:`certify` proves new
        bounds. The PLR keeps the domain, the tree, mirror symmetries, cut-off leaves and the label. If answers had a
        lower bound by straight lines, they keep this bound. The PLR loses the function of
        :meth:`PLR.with_nearest_goal`, since the nearest goal may change with the values.

        Args:
            max_bytes: Most bytes of the file. Values are rounded to numbers a step apart. The result has the finest
                step tried with which the file is that small; each step tried is 9 % larger than the one before.
                None: values have the resolution of the file from which the PLR was made.

        Raises:
            ValueError: If values have another shape than the initial values, are not finite or too large; or if the
                smallest file has more than ``max_bytes`` bytes.
        """
        # 1. Add the changes to the values in the file, which have 64 bits.
        contents = self.plr._contents
        values = self.plr.parameter_map[0] + np.asarray(self._changes(), np.float64)
        if not np.isfinite(values).all():
            raise ValueError("values must be finite to be stored, got inf or NaN: lower the learning rate.")

        # 2. Round them; for a byte limit, search for the finest step: from the resolution of 32-bit floats to a step
        #    that rounds all values to one number, each 9% larger than the one before.
        def rounded(step: float | None) -> Any:
            stored = contents.leaf.with_free_values(contents.stored, values, step)
            data = encode(replace(contents, stored=stored, certificate=None))
            return type(self.plr)(padded_file(data)).with_label(self.plr.label)

        if max_bytes is None:
            plr = rounded(None)
        else:
            require_integer("max_bytes", max_bytes, 1)
            steps = 2.0 ** np.arange(-24, 2.125, 1 / 8) * np.abs(values).max(initial=np.finfo(np.float32).tiny)
            finest = bisect_left(steps, True, hi=len(steps) - 1, key=lambda s: rounded(s).num_bytes <= max_bytes)
            if (plr := rounded(steps[finest])).num_bytes > max_bytes:
                raise ValueError(f"max_bytes must be at least {plr.num_bytes}, the smallest file, got {max_bytes}.")
        _ = plr.tables  # raises ValueError if they would be too large
        return plr
