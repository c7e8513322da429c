"""By which of a distance function's symmetries a domain is folded: those that are reflections along common axes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._types import DistanceFn, SymmetricFn, Symmetry
from plr_jax.geometry.box import Box
from plr_jax.plr.folding.folding import Folding

_SAME = 1e-12  # of entries of orthogonal matrices
_SAME_PLACE = 1e-9  # of a coordinate, or of the domain's width


def folding_of(distance_fn: DistanceFn, domain: Box) -> Folding | None:
    """The folding that halves a domain most often; None if no symmetry makes it smaller."""
    symmetries = _commuting(distance_fn.symmetries, domain) if isinstance(distance_fn, SymmetricFn) else []
    folding = _mirrored(symmetries, domain, (domain.lo + domain.hi) / 2)
    if folding is None or np.prod(folding.box.width) >= np.prod(domain.width) * (1 - _SAME_PLACE):
        return None
    return folding


def _commuting(symmetries: Sequence[Symmetry], domain: Box) -> list[Symmetry]:
    """Symmetries that are reflections, undo themselves, commute and do not mix periodic axes with others."""
    kept: list[Symmetry] = []
    for symmetry in symmetries:
        matrix = symmetry.matrix
        is_reflection = np.allclose(matrix, matrix.T, atol=_SAME) and _is_unit(matrix @ matrix)
        mixes = np.abs(matrix - np.diag(np.diag(matrix))).max(axis=1) > _SAME
        commutes = all(np.allclose(matrix @ other.matrix, other.matrix @ matrix, atol=_SAME) for other in kept)
        if is_reflection and commutes and not (mixes & np.array(domain.periodic)).any():
            kept.append(symmetry)
    return kept


def _is_unit(matrix: Float[np.ndarray, "dim dim"]) -> bool:
    return np.allclose(matrix, np.eye(len(matrix)), atol=_SAME)


def _mirrored(symmetries: list[Symmetry], domain: Box, start: Float[np.ndarray, "dim"]) -> Folding | None:
    """The folding at the mirrors that cut the domain, which pass through a point near the start; None without any."""
    if not symmetries:
        return None
    matrices = np.stack([symmetry.matrix for symmetry in symmetries])
    # Axes, one a row, along which all reflections are diagonal; those along which they are already stay.
    dim = matrices.shape[1]
    mixes = (np.abs(matrices * (1 - np.eye(dim))) > _SAME).any(axis=(0, 1))
    axes = np.eye(dim)
    if mixes.any():
        weight = 2.0 ** -np.arange(len(matrices))  # with which no two combinations of signs have one sum
        block = np.einsum("n,nij->ij", weight, matrices)[np.ix_(mixes, mixes)]
        _, vectors = np.linalg.eigh(block)
        largest = np.abs(vectors).argmax(axis=0)
        vectors *= np.sign(vectors[largest, np.arange(len(largest))])
        axes[np.ix_(mixes, mixes)] = vectors.T
    signs = np.einsum("ij,njk,ik->ni", axes, matrices, axes)
    center = _fixed_point(symmetries, domain, start)
    mirrors = _with_pivots(signs < 0, ~np.array(domain.periodic))
    if center is None or np.abs(np.abs(signs) - 1).max() > _SAME_PLACE or not mirrors:
        return None
    folding = Folding(domain, center, axes, mirrors)
    return replace(folding, mirrors=folding.cutting) if folding.cutting else None


def _fixed_point(
    symmetries: list[Symmetry], domain: Box, start: Float[np.ndarray, "dim"]
) -> Float[np.ndarray, "dim"] | None:
    """The point nearest to the start that no symmetry moves; None if there is none."""
    moved = np.concatenate([np.eye(domain.dim) - symmetry.matrix for symmetry in symmetries])
    by = np.concatenate([symmetry.offset for symmetry in symmetries]) - moved @ start
    step = np.linalg.lstsq(moved, by, rcond=None)[0]
    scale = _SAME_PLACE * (np.abs(start) + domain.width)
    if np.abs(moved @ step - by).max() > scale.max():
        return None
    return np.where(np.abs(step) <= scale * 1e-3, start, start + step)


def _with_pivots(
    mirrors: Bool[np.ndarray, "n dim"], may_pivot: Bool[np.ndarray, "dim"]
) -> tuple[tuple[bool, ...], ...]:
    """Mirrors that make the same symmetries, each with an axis that no other reverses: row echelon form modulo 2.

    What reverses only axes that may be no pivots is left out.
    """
    rows, done = mirrors.copy(), 0
    for axis in np.flatnonzero(may_pivot):
        below = np.flatnonzero(rows[done:, axis])
        if not len(below):
            continue
        rows[[done, done + below[0]]] = rows[[done + below[0], done]]
        others = rows[:, axis].copy()
        others[done] = False
        rows[others] ^= rows[done]
        done += 1
    return tuple(tuple(map(bool, row)) for row in rows[:done])
