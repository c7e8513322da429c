"""Points of a domain mirrored into a part of it, where all that a PLR stores is known of the rest as well."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._types import DistanceFn, Points, SymmetricFn, Symmetry
from plr_jax.geometry.box import Box

_CUT = 1e-9  # of a domain's width: what a mirror must have of it on either side


@dataclass(frozen=True, eq=False)
class Folding:
    """How points of a domain are *folded*: seen from a center, along axes of their own, and mirrored.

    A mirror reverses some coordinates. One of them, its *pivot*, no other mirror reverses and is not periodic: points
    whose pivot is negative are mirrored, and so no folded point has a negative pivot.

    Attributes:
        domain: The domain.
        center: From where points are seen. All mirrors pass through it.
        axes: One of the folded coordinates a row, an orthogonal matrix. Those along periodic axes stay what they are.
        mirrors: Which coordinates each mirror reverses.
    """

    domain: Box
    center: Float[np.ndarray, "dim"]
    axes: Float[np.ndarray, "dim dim"]
    mirrors: tuple[tuple[bool, ...], ...]

    @property
    def is_turned(self) -> bool:
        """Whether folded coordinates run along other axes than those of the domain."""
        return not np.array_equal(self.axes, np.eye(self.domain.dim))

    @cached_property
    def pivots(self) -> tuple[int, ...]:
        """The pivot of each mirror; raises ``ValueError`` if one has none."""
        alone = np.sum(self.mirrors, axis=0) == 1
        may_be = np.array(self.mirrors, bool).reshape(-1, self.domain.dim) & alone & ~np.array(self.domain.periodic)
        if not may_be.any(axis=1).all():
            raise ValueError(f"one of its mirrors has no axis of its own: {self.mirrors}")
        return tuple(map(int, may_be.argmax(axis=1)))

    @cached_property
    def box(self) -> Box:
        """The box that holds all folded points, which leaves partition."""
        lo, hi = self._range_before_mirroring
        largest = np.maximum(np.abs(lo), np.abs(hi))
        is_reversed = np.any(np.array(self.mirrors).reshape(-1, self.domain.dim), axis=0)
        lo, hi = np.where(is_reversed, -largest, lo), np.where(is_reversed, largest, hi)
        lo[list(self.pivots)] = 0.0
        periodic = np.array(self.domain.periodic)
        half = self.domain.width / 2
        return Box(np.where(periodic, -half, lo), np.where(periodic, half, hi), self.domain.periodic)

    @property
    def cutting_mirrors(self) -> tuple[tuple[bool, ...], ...]:
        """The mirrors that have points of the domain on either side."""
        lo, hi = self._range_before_mirroring
        least = _CUT * (hi - lo)
        pairs = zip(self.mirrors, self.pivots, strict=True)
        return tuple(mirror for mirror, pivot in pairs if min(-lo[pivot], hi[pivot]) > least[pivot])

    @property
    def _range_before_mirroring(self) -> tuple[Float[np.ndarray, "dim"], Float[np.ndarray, "dim"]]:
        """Least and largest coordinates of the domain before mirroring."""
        ends = self.axes * (self.domain.lo - self.center), self.axes * (self.domain.hi - self.center)
        return np.minimum(*ends).sum(axis=1), np.maximum(*ends).sum(axis=1)

    def __call__(self, x: Float[np.ndarray, "*batch dim"]) -> Float[np.ndarray, "*batch dim"]:
        """The folded points, in the box along axes that are not periodic."""
        z = np.asarray(x, np.float64) - self.center
        z = z @ self.axes.T if self.is_turned else z
        for mirror, pivot in zip(self.mirrors, self.pivots, strict=True):
            z = np.where((z[..., pivot] < 0)[..., None] & np.array(mirror), -z, z)
        return np.where(self.domain.periodic, z, np.clip(z, self.box.lo, self.box.hi))

    def images(self, z: Points) -> Iterator[tuple[Points, Bool[np.ndarray, "n"]]]:
        """Points that fold to given ones, one each, and whether they are in the domain, for each way to mirror."""
        for chosen in product((False, True), repeat=len(self.mirrors)):
            reversals = np.sum([m for m, use in zip(self.mirrors, chosen, strict=True) if use], axis=0)
            mirrored = np.where(np.mod(reversals, 2) == 1, -z, z)
            x = self.center + (mirrored @ self.axes if self.is_turned else mirrored)
            x = np.where(self._is_at_end(x), np.clip(x, self.domain.lo, self.domain.hi), x)
            x = self.domain.wrapped(x)
            yield x, self.domain.contains(x)

    def _is_at_end(self, x: Points) -> Bool[np.ndarray, "n dim"]:
        """Coordinates that only rounding puts outside the domain."""
        near = _CUT * self.domain.width
        return (x >= self.domain.lo - near) & (x <= self.domain.hi + near) & ~np.array(self.domain.periodic)

    def unfold(self, z: Points) -> Points:
        """For each folded point one that folds to it, in the domain if any is."""
        found, missing = None, np.ones(len(z), bool)
        for x, inside in self.images(z):
            found = x if found is None else np.where((missing & inside)[:, None], x, found)
            missing &= ~inside
            if not missing.any():
                break
        assert found is not None, "there is a way to mirror at no mirror"
        return found

    def boxes(
        self, lo: Float[np.ndarray, "leaves dim"], hi: Float[np.ndarray, "leaves dim"]
    ) -> tuple[Float[np.ndarray, "pieces dim"], Float[np.ndarray, "pieces dim"], Int[np.ndarray, "pieces"]]:
        """Corners of the pieces of the domain that fold into leaves, and the leaf of each.

        Raises ``ValueError`` if axes are turned.
        """
        if self.is_turned:
            raise ValueError(
                "Pieces of this PLR are no boxes along the axes of its domain: its leaves are folded by symmetries "
                "along other axes. Use plr.cells with plr.folded_domain."
            )
        lows, highs = [], []
        for chosen in product((False, True), repeat=len(self.mirrors)):
            reversals = np.sum([m for m, use in zip(self.mirrors, chosen, strict=True) if use], axis=0)
            is_odd = np.mod(reversals, 2) == 1
            lows.append(self.center + np.where(is_odd, -hi, lo))
            highs.append(self.center + np.where(is_odd, -lo, hi))
        periodic = np.array(self.domain.periodic)
        low, high = np.concatenate(lows), np.concatenate(highs)
        low, high = (np.where(periodic, x, np.clip(x, self.domain.lo, self.domain.hi)) for x in (low, high))
        kept = (high > low).all(axis=1)
        return low[kept], high[kept], np.flatnonzero(kept) % len(lo)


_SAME = 1e-12  # of entries of orthogonal matrices
_SAME_PLACE = 1e-9  # of a coordinate, or of the domain's width


def folding_of(distance_fn: DistanceFn, domain: Box) -> Folding | None:
    """The folding that halves a domain most often; None if no symmetry makes it smaller."""
    # 1. Symmetries that are reflections, undo themselves, commute and do not mix periodic axes with others.
    symmetries: list[Symmetry] = []
    for symmetry in distance_fn.symmetries if isinstance(distance_fn, SymmetricFn) else ():
        matrix, dim = symmetry.matrix, domain.dim
        is_symmetric = np.allclose(matrix, matrix.T, atol=_SAME)
        is_involution = np.allclose(matrix @ matrix, np.eye(dim), atol=_SAME)
        mixes = np.abs(matrix - np.diag(np.diag(matrix))).max(axis=1) > _SAME
        commutes = all(np.allclose(matrix @ other.matrix, other.matrix @ matrix, atol=_SAME) for other in symmetries)
        if is_symmetric and is_involution and commutes and not (mixes & np.array(domain.periodic)).any():
            symmetries.append(symmetry)
    if not symmetries:
        return None

    # 2. Axes, one a row, along which all reflections are diagonal; those along which they are already stay.
    matrices = np.stack([symmetry.matrix for symmetry in symmetries])
    mixes = (np.abs(matrices * (1 - np.eye(domain.dim))) > _SAME).any(axis=(0, 1))
    axes = np.eye(domain.dim)
    if mixes.any():
        weight = 2.0 ** -np.arange(len(matrices))  # with which no two combinations of signs have one sum
        block = np.einsum("n,nij->ij", weight, matrices)[np.ix_(mixes, mixes)]
        _, vectors = np.linalg.eigh(block)
        largest = np.abs(vectors).argmax(axis=0)
        vectors *= np.sign(vectors[largest, np.arange(len(largest))])
        axes[np.ix_(mixes, mixes)] = vectors.T
    signs = np.einsum("ij,njk,ik->ni", axes, matrices, axes)
    mirrors = _assign_pivots(signs < 0, ~np.array(domain.periodic))

    # 3. The point nearest to the middle of the domain that no symmetry moves.
    middle = (domain.lo + domain.hi) / 2
    moved = np.concatenate([np.eye(domain.dim) - symmetry.matrix for symmetry in symmetries])
    by = np.concatenate([symmetry.offset for symmetry in symmetries]) - moved @ middle
    step = np.linalg.lstsq(moved, by, rcond=None)[0]
    scale = _SAME_PLACE * (np.abs(middle) + domain.width)
    is_fixed = np.abs(moved @ step - by).max() <= scale.max()
    if not is_fixed or np.abs(np.abs(signs) - 1).max() > _SAME_PLACE or not mirrors:
        return None
    center = np.where(np.abs(step) <= scale * 1e-3, middle, middle + step)

    # 4. The mirrors that cut the domain, if they make it smaller.
    folding = Folding(domain, center, axes, mirrors)
    folding = replace(folding, mirrors=folding.cutting_mirrors)
    is_smaller = np.prod(folding.box.width) < np.prod(domain.width) * (1 - _SAME_PLACE)
    return folding if folding.mirrors and is_smaller else None


def _assign_pivots(
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
