"""Use mirror symmetries of a distance function: a *folding* maps all points into one part of the domain.

A PLR of such a function then stores only this part.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._types import DistanceFn, Points, SymmetricFn, Symmetry
from plr_jax.geometry.box import Box

_CUT = 1e-9  # a mirror cuts the domain if more than this share of its width lies on both sides


@dataclass(frozen=True, eq=False)
class Folding:
    """A map of points into one part of a domain: shift to a center, rotate to given axes, then mirror."""

    domain: Box
    center: Float[np.ndarray, " dim"]  # new origin of coordinates; all mirrors pass through it
    axes: Float[np.ndarray, "dim dim"]  # orthogonal, a row for each folded coordinate; unit vectors of periodic axes
    mirrors: tuple[tuple[bool, ...], ...]  # whether each mirror changes the sign of each coordinate

    @property
    def is_turned(self) -> bool:
        return not np.array_equal(self.axes, np.eye(self.domain.dim))

    @cached_property
    def pivots(self) -> tuple[int, ...]:
        """The *pivot* of each mirror: a non-periodic axis that this mirror reverses and no other mirror does.

        A mirror is applied to the points whose pivot coordinate is negative.
        """
        alone = np.sum(self.mirrors, axis=0) == 1
        may_be = np.array(self.mirrors, bool).reshape(-1, self.domain.dim) & alone & ~np.array(self.domain.periodic)
        if not may_be.any(axis=1).all():
            raise ValueError(f"each mirror must reverse an axis of its own, got {self.mirrors}")
        return tuple(map(int, may_be.argmax(axis=1)))

    @cached_property
    def box(self) -> Box:
        """Box that contains all points of the domain after mirroring; a PLR's leaves partition it."""
        # A mirror's pivot becomes 0 or more. The other axes that the mirror reverses may get either sign, so their
        # range becomes symmetric.
        lo, hi = self._range_before_mirroring
        largest = np.maximum(np.abs(lo), np.abs(hi))
        is_reversed = np.any(np.array(self.mirrors).reshape(-1, self.domain.dim), axis=0)
        lo, hi = np.where(is_reversed, -largest, lo), np.where(is_reversed, largest, hi)
        lo[list(self.pivots)] = 0.0
        half = self.domain.width / 2
        periodic = self.domain.periodic
        return Box(np.where(periodic, -half, lo), np.where(periodic, half, hi), periodic)

    @property
    def cutting_mirrors(self) -> tuple[tuple[bool, ...], ...]:
        """The mirrors that cut the domain: more than the fraction ``_CUT`` of its width lies on each side."""
        lo, hi = self._range_before_mirroring
        pairs = zip(self.mirrors, self.pivots, strict=True)
        return tuple(mirror for mirror, pivot in pairs if min(-lo[pivot], hi[pivot]) > _CUT * (hi - lo)[pivot])

    @property
    def _range_before_mirroring(self) -> tuple[Float[np.ndarray, " dim"], Float[np.ndarray, " dim"]]:
        """Least and largest coordinates of the domain's points, after the folding's shift and rotation."""
        # z_i = sum over j of axes_ij (x_j - center_j): each term is extreme at an end of the domain's axis j.
        ends = self.axes * (self.domain.lo - self.center), self.axes * (self.domain.hi - self.center)
        return np.minimum(*ends).sum(axis=1), np.maximum(*ends).sum(axis=1)

    def __call__(self, x: Float[np.ndarray, "*batch dim"]) -> Float[np.ndarray, "*batch dim"]:
        """Return points ``z`` of :attr:`box`: the points ``x`` of the domain after shift, rotation and mirroring."""
        z = np.asarray(x, np.float64) - self.center
        z = z @ self.axes.T if self.is_turned else z
        for mirror, pivot in zip(self.mirrors, self.pivots, strict=True):
            z = np.where((z[..., pivot] < 0)[..., None] & np.array(mirror), -z, z)
        return np.where(self.domain.periodic, z, np.clip(z, self.box.lo, self.box.hi))

    def images(self, z: Points) -> Iterator[tuple[Points, Bool[np.ndarray, " n"]]]:
        """For each subset of the mirrors, yield the points that the subset maps to ``z``.

        Also yield whether each of these points lies in the domain.
        """
        near = _CUT * self.domain.width
        for is_odd in self._reversals:
            mirrored = np.where(is_odd, -z, z)
            x = self.center + (mirrored @ self.axes if self.is_turned else mirrored)
            near_box = (x >= self.domain.lo - near) & (x <= self.domain.hi + near) & ~np.array(self.domain.periodic)
            x = self.domain.wrapped(np.where(near_box, np.clip(x, self.domain.lo, self.domain.hi), x))
            yield x, self.domain.contains(x)

    @property
    def _reversals(self) -> Bool[np.ndarray, "subsets dim"]:
        """Whether each subset of mirrors reverses each axis: whether an odd number of mirrors in the subset does."""
        num, dim = len(self.mirrors), self.domain.dim
        subsets = np.array(list(product((0, 1), repeat=num)), int).reshape(2**num, num)
        return subsets @ np.array(self.mirrors, int).reshape(num, dim) % 2 == 1

    def unfold(self, z: Points) -> Points:
        """For each folded point ``z``, return a point that the folding maps to it, inside the domain if possible."""
        images = self.images(z)
        x, is_inside = next(images)
        while not is_inside.all() and (image := next(images, None)):  # most points need no further image
            x = np.where((image[1] & ~is_inside)[:, None], image[0], x)
            is_inside |= image[1]
        return x

    def boxes(
        self, lo: Float[np.ndarray, "leaves dim"], hi: Float[np.ndarray, "leaves dim"]
    ) -> tuple[Float[np.ndarray, "pieces dim"], Float[np.ndarray, "pieces dim"], Int[np.ndarray, " pieces"]]:
        """Return the boxes of leaves with corners ``lo`` and ``hi``, and their mirror images, cut to the domain.

        The results are lower corners, upper corners, and the index of each box's leaf. ``ValueError`` if the folding
        rotates points.
        """
        if self.is_turned:
            got = "but this PLR is folded along rotated axes. Use plr.cells with plr.folded_domain"
            raise ValueError(f"Leaf boxes need symmetries along the axes of the domain, {got}.")
        low = np.concatenate([self.center + np.where(is_odd, -hi, lo) for is_odd in self._reversals])
        high = np.concatenate([self.center + np.where(is_odd, -lo, hi) for is_odd in self._reversals])
        domain = self.domain
        low, high = (np.where(domain.periodic, x, np.clip(x, domain.lo, domain.hi)) for x in (low, high))
        is_box = (high > low).all(axis=1)
        return low[is_box], high[is_box], np.flatnonzero(is_box) % len(lo)


# Tolerances of `folding_of`, which tests symmetries.
_SAME = 1e-12  # tolerance for entries of orthogonal matrices
_SAME_PLACE = 1e-9  # tolerance for points, relative to a coordinate or to the domain's width


def folding_of(distance_fn: DistanceFn, domain: Box) -> Folding | None:
    """Return a folding by the symmetries of a distance function; None if no folding makes the domain smaller."""
    # A symmetry maps x to S x + offset, and S is a symmetric involution: S S = 1. So it is a reflection, with
    # eigenvalues 1 and -1, and commuting ones have common orthogonal eigenvectors, the rows of A. In coordinates
    # z = A (x - center) about a common fixed point, the symmetries only change signs:
    #   z_i -> sign_i * z_i, with sign_i = (A S A')_ii.
    # For example, the symmetry that swaps x_0 and x_1 has the axes (1, 1) and (1, -1), both divided by sqrt(2), and
    # changes the sign of z along (1, -1). Points where this coordinate is negative are mirrored: half of the domain
    # remains.
    # 1. Keep symmetric involutions that commute and do not mix periodic axes with others.
    symmetries: list[Symmetry] = []
    for symmetry in distance_fn.symmetries if isinstance(distance_fn, SymmetricFn) else ():
        matrix = symmetry.matrix
        is_symmetric = np.allclose(matrix, matrix.T, atol=_SAME)
        is_involution = np.allclose(matrix @ matrix, np.eye(domain.dim), atol=_SAME)
        mixes = np.abs(matrix - np.diag(np.diag(matrix))).max(axis=1) > _SAME
        commutes = all(np.allclose(matrix @ other.matrix, other.matrix @ matrix, atol=_SAME) for other in symmetries)
        if is_symmetric and is_involution and commutes and not (mixes & np.array(domain.periodic)).any():
            symmetries.append(symmetry)
    if not symmetries:
        return None

    # 2. Diagonalize all of them simultaneously; axes along which all are diagonal already stay as they are.
    matrices = np.stack([symmetry.matrix for symmetry in symmetries])
    mixes = (np.abs(matrices * (1 - np.eye(domain.dim))) > _SAME).any(axis=(0, 1))
    axes = np.eye(domain.dim)
    if mixes.any():
        weight = 2.0 ** -np.arange(len(matrices))  # different combinations of signs have different weighted sums
        block = np.einsum("n,nij->ij", weight, matrices)[np.ix_(mixes, mixes)]
        _, vectors = np.linalg.eigh(block)
        largest = np.abs(vectors).argmax(axis=0)  # made positive, whichever sign LAPACK chooses
        vectors *= np.sign(vectors[largest, np.arange(len(largest))])
        axes[np.ix_(mixes, mixes)] = vectors.T
    signs = np.einsum("ij,njk,ik->ni", axes, matrices, axes)

    # 3. Combine mirrors until each reverses an axis alone (reduced row echelon form modulo 2); drop all others, which
    #    reverse no axis that may be a pivot. Two mirrors one after the other are again a symmetry: it reverses the
    #    axes that exactly one of them reverses, the XOR of their rows.
    rows = signs < 0
    rank = 0  # rows above it have pivots
    for axis in np.flatnonzero(~np.array(domain.periodic)):
        if not len(below := np.flatnonzero(rows[rank:, axis])):
            continue
        rows[[rank, rank + below[0]]] = rows[[rank + below[0], rank]]  # swap
        others = rows[:, axis].copy()
        others[rank] = False
        rows[others] ^= rows[rank]
        rank += 1
    mirrors = tuple(tuple(map(bool, row)) for row in rows[:rank])

    # 4. Find the fixed point of all symmetries that is nearest to the middle of the domain. With x = middle + step,
    #    each symmetry gives (1 - S) step = offset - (1 - S) middle. The solution of least norm is the nearest.
    middle = (domain.lo + domain.hi) / 2
    moved = np.concatenate([np.eye(domain.dim) - symmetry.matrix for symmetry in symmetries])
    shift = np.concatenate([symmetry.offset for symmetry in symmetries]) - moved @ middle
    step = np.linalg.lstsq(moved, shift, rcond=None)[0]
    scale = _SAME_PLACE * (np.abs(middle) + domain.width)
    is_fixed = np.abs(moved @ step - shift).max() <= scale.max()
    are_common = np.abs(np.abs(signs) - 1).max() <= _SAME_PLACE  # whether `axes` are eigenvectors of all symmetries
    if not (is_fixed and are_common and mirrors):  # without mirrors, only periodic axes are reversed
        return None
    center = np.where(np.abs(step) <= scale * 1e-3, middle, middle + step)  # no step by a rounding error

    # 5. Keep the mirrors that cut the domain, if they make it smaller.
    folding = Folding(domain, center, axes, mirrors)
    folding = replace(folding, mirrors=folding.cutting_mirrors)
    is_smaller = np.prod(folding.box.width) < np.prod(domain.width) * (1 - _SAME_PLACE)
    return folding if folding.mirrors and is_smaller else None
