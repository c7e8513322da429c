"""PLRs as functions: one of a point, many of an index and a point."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import prod

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

from plr_jax._arrays import mixed, padded, padded_size, shortened
from plr_jax._types import ArrayLike
from plr_jax.plr._plr import PLR
from plr_jax.plr.query.lookup import evaluate_tables
from plr_jax.plr.query.picked import Picked
from plr_jax.plr.query.points import as_array
from plr_jax.plr.query.tables import Tables

_MOST_NUMBERS = 1 << 32  # of an array of all PLRs: indices are 32-bit


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class _Column:
    """One array of several tables.

    Attributes:
        flat: The array if it is the same for all; else theirs, one behind the other.
        shape: Of one of them.
        first: Where each begins, if they differ in length; else they are as long as ``shape`` says.
        is_shared: Whether it is the same for all.
    """

    flat: Array
    first: UInt32[Array, "tables"] | None
    shape: tuple[int, ...] = field(metadata={"static": True})
    is_shared: bool = field(metadata={"static": True})

    @staticmethod
    def of(arrays: Sequence[np.ndarray]) -> "_Column":
        """That of arrays of one type and number of axes; those of one axis may differ in length."""
        sizes = [each.size for each in arrays]
        if sum(sizes) >= _MOST_NUMBERS:
            raise ValueError(f"{len(arrays):,} PLRs have tables too large for one stack; make several of fewer PLRs.")
        if all(np.array_equal(arrays[0], each) for each in arrays[1:]):
            return _Column(jnp.asarray(arrays[0]), None, arrays[0].shape, True)
        flat = np.concatenate([each.ravel() for each in arrays])
        if len(set(sizes)) == 1:
            return _Column(jnp.asarray(flat), None, arrays[0].shape, False)
        first = np.cumsum([0, *sizes[:-1]]).astype(np.uint32)
        return _Column(jnp.asarray(padded(flat, padded_size(len(flat)))), jnp.asarray(first), (max(sizes),), False)

    def pick(self, which: UInt32[Array, "*batch"]) -> "Array | Picked":
        """The array of each point's tables."""
        if self.is_shared:
            return self.flat
        start = which * np.uint32(prod(self.shape)) if self.first is None else self.first[which]
        return Picked(self.flat, self.shape, start, self.flat.dtype)


def _side_by_side(tables: Tables) -> Tables:
    """The same, smaller, with what is read of a leaf side by side: of many PLRs, each array read is waited for.

    Numbers that several slots of pages have stand there once.
    """
    numbers = np.asarray(tables.numbers)
    if numbers.ndim == 1:
        return tables
    rows = np.ascontiguousarray(numbers.T)
    if tables.pages is None:
        return replace(tables, numbers=jnp.asarray(rows.ravel()))
    key = np.zeros(len(rows), np.uint64)
    for column in rows.view(np.uint32).T:
        key = mixed(key + column + np.uint64(1))
    _, first, row = np.unique(key, return_index=True, return_inverse=True)
    used = int(np.flatnonzero(row != row[-1]).max(initial=0)) + 2  # behind them all are alike, most likely padding
    slots = jnp.asarray(row[:used].astype(np.uint16))
    return replace(tables, numbers=jnp.asarray(rows[first].ravel()), leaf_of_slot=slots, is_indirect=True)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class _Alike:
    """PLRs whose tables have one structure, array by array."""

    columns: tuple[_Column, ...]
    structure: jax.tree_util.PyTreeDef = field(metadata={"static": True})

    def pick(self, which: UInt32[Array, "*batch"]) -> Tables:
        """The tables of each point's PLR."""
        return jax.tree_util.tree_unflatten(self.structure, [column.pick(which) for column in self.columns])


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class PLRStack:
    """Many PLRs as one function: ``f(index, x)`` is the distance of each point by the PLR of its index.

    Made by :func:`stack`. A pytree of arrays: a jitted function can close over it or take it as an argument, under
    ``jax.vmap`` and ``jax.grad`` too. PLRs of one leaf model whose files are of one byte class have tables of one
    shape, and stacks of as many of them share compiled code.

    Attributes:
        groups: The tables of PLRs whose tables are alike in shape.
        group: The group of each PLR.
        place: Its place there.
        dim: Number of axes.
    """

    groups: tuple[_Alike, ...]
    group: UInt32[Array, "plrs"]
    place: UInt32[Array, "plrs"]
    dim: int = field(metadata={"static": True})

    def __len__(self) -> int:
        return self.group.shape[0]

    def __call__(self, index: ArrayLike, x: ArrayLike) -> Float[Array, "*batch"]:
        """Distance of each point by the PLR of its index.

        Args:
            index: Indices of PLRs, integers of any shape that broadcasts with the batch.
            x: Points, ``(..., dim)``, NumPy or JAX. NumPy's 64-bit points are rounded as JAX rounds them: in a
                domain far from the origin, a PLR alone places them better.

        Returns:
            Distances, of the shape to which index and batch broadcast: what the PLR of the index answers, up
            to rounding. NaN where
            the index is not that of a PLR; negative ones do not count from the end.

        Raises:
            ValueError: If ``x`` has another last axis than ``dim``, or ``index`` holds no integers.
        """
        index = index if isinstance(index, jax.Array) else np.asarray(index)
        x = x if isinstance(x, jax.Array) else as_array(x)
        if index.dtype.kind not in "iu":
            raise ValueError(f"index must hold integers, numbers of PLRs, got an array of {index.dtype}.")
        if x.ndim == 0 or x.shape[-1] != self.dim:
            raise ValueError(f"Points must have shape (..., {self.dim}), got {x.shape}.")
        return _evaluate(self, index, x)


def stack(plrs: Sequence[PLR]) -> PLRStack:
    """One function of many PLRs: ``stack(plrs)(index, x)``, a pytree.

    Args:
        plrs: The PLRs, at least one, all of one number of dimensions; of any leaf models and sizes. It is fastest
            where all have one model and files of one byte class: else all kinds of tables are read for every point.

    Returns:
        The function. For a team, one PLR a robot, see :meth:`PLR.stack`.

    Raises:
        ValueError: If they are not a list of PLRs, at least one, of one number of dimensions; or all their tables
            together are too large for 32-bit indices.
    """
    try:
        plrs = list(plrs)
    except TypeError:
        raise ValueError(f"plrs must be a list of PLRs, got {shortened(plrs)}; for one give [plr].") from None
    for i, plr in enumerate(plrs):
        if not isinstance(plr, PLR):
            raise ValueError(f"Only PLRs can be stacked, number {i} is {shortened(plr)}.")
    if len(dims := {plr.dim for plr in plrs}) != 1:
        raise ValueError(
            f"A stack needs PLRs of one number of dimensions, at least one, got those of {sorted(dims)}."
        )
    kinds, group, place = {}, [], []
    for plr in plrs:
        arrays, structure = jax.tree_util.tree_flatten(_side_by_side(plr.tables))
        kind = structure, tuple((len(array.shape), array.shape[1:], str(array.dtype)) for array in arrays)
        members = kinds.setdefault(kind, [])
        group.append(list(kinds).index(kind))
        place.append(len(members))
        members.append([np.asarray(array) for array in arrays])
    groups = tuple(
        _Alike(tuple(_Column.of(column) for column in zip(*members, strict=True)), structure)
        for (structure, _), members in kinds.items()
    )
    return PLRStack(groups, jnp.asarray(np.array(group, np.uint32)), jnp.asarray(np.array(place, np.uint32)), *dims)


@jax.jit
def _evaluate(stacked: PLRStack, index: Array, x: Array) -> Float[Array, "*batch"]:
    shape = jnp.broadcast_shapes(index.shape, x.shape[:-1])
    index, x = jnp.broadcast_to(index, shape), jnp.broadcast_to(x, (*shape, x.shape[-1]))
    is_one = (index >= 0) & (index < len(stacked))
    known = jnp.where(is_one, index, 0).astype(jnp.uint32)
    place, group = stacked.place[known], stacked.group[known]
    value = None
    for number, alike in enumerate(stacked.groups):
        here = group == number
        of_group = evaluate_tables(alike.pick(jnp.where(here, place, jnp.uint32(0))), x)
        value = of_group if value is None else jnp.where(here, of_group, value)
    assert value is not None
    return jnp.where(is_one, value, jnp.nan)


def evaluate(plr: PLR, x: ArrayLike) -> Float[Array, "*batch"]:
    """Approximate distance at each point: the function of the leaf that holds it (Section III-A of the paper).

    Clean under ``jax.jit``, ``jax.vmap`` and ``jax.grad``; the gradient is that of the leaf's function, finite
    everywhere, and zero where the distance is ``inf``.

    Args:
        plr: The PLR, of any leaf model.
        x: Points, ``(..., dim)``, NumPy or JAX, in the units of the domain. Computed in their own precision, at
            least 32 bits; coefficients are 32-bit floats. NumPy's 64-bit points are placed in 64 bits where the
            domain is far from the origin.

    Returns:
        Distances of shape ``(...)``. A PLR never tests collision: every point of the closed domain gets a finite
        value, in an obstacle too, except in leaves of which nothing reaches the goal and that touch no leaf of which
        something does. Those, and points outside the domain, get ``inf``; a NaN coordinate gives NaN. Cones answer a
        finite number everywhere in the domain, where the goal cannot be reached as well. The upper edge of the domain
        belongs to the last cell; that of a periodic axis is its lower edge, and points are wrapped around it, NumPy's
        64-bit ones in 64 bits. An approximation may be a little below 0 near the goal.

    Raises:
        ValueError: If the last axis of ``x`` is not ``dim`` long, or its numbers are not real.
    """
    return plr(x)
