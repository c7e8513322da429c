"""Finding the sources of a distance function that does not offer them, from samples of cells.

Cells are halved until a cone fits each to within noise, or known sources explain every sample of it. Where a source's
distance is that of another one and the way there, it is so exactly, and the fit of both is to the samples of both.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._types import Sources
from plr_jax.geometry.box import Box
from plr_jax.plr.growth.limits import Rows
from plr_jax.plr.leaves.sparse_squares import solve_sparse, weighted_squares
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_fit import CellFit, Sampler

if TYPE_CHECKING:
    from scipy.sparse import csr_array


# Cones through samples, by least squares, many at once.
#
# The square of ``distance - offset = |x - source|``, which is
#
#     |x|^2 - distance^2 = 2 source . x - 2 offset distance + (offset^2 - |source|^2),
#
# is linear in the source, the offset and the rest. That gives a start; Gauss-Newton steps on the distance itself
# follow. The square also admits ``distance = offset - |x - source|``: where the solution is that one, or its source
# is too far, the slope of a plane gives a second start, a source far away against it.


_STEPS = 6
_RIDGE = 1e-13
_RANK_TOLERANCE = 1e-12


@dataclass(frozen=True, eq=False)
class Samples(Rows):
    """Points, as many of each cell, their distances, and weights: 0 where a point does not count."""

    x: Float[np.ndarray, "cells k dim"]
    distance: Float[np.ndarray, "cells k"]
    weight: Float[np.ndarray, "cells k"]

    def __len__(self) -> int:
        return len(self.x)

    def as_one(self) -> "Samples":
        """Those of all cells that count, as of one."""
        counts = self.weight > 0
        return Samples(self.x[counts][None], self.distance[counts][None], self.weight[counts][None])

    def mean(self, value: Float[np.ndarray, "cells k *rest"]) -> Float[np.ndarray, "cells *rest"]:
        """Weighted mean of what each sample has, 0 in a cell without weight."""
        total = self.weight.sum(axis=1)
        return np.einsum("ck,ck...->c...", self.weight / np.where(total > 0, total, 1)[:, None], value)


@dataclass(frozen=True, eq=False)
class Cones(Rows):
    """Functions ``offset + |x - point|``."""

    point: Float[np.ndarray, "cones dim"]
    offset: Float[np.ndarray, "cones"]

    def __len__(self) -> int:
        return len(self.offset)

    def __call__(self, x: Float[np.ndarray, "cones k dim"]) -> Float[np.ndarray, "cones k"]:
        """Values at points, as many for each cone."""
        return self.offset[:, None] + _length(x - self.point[:, None])

    def errors(self, samples: Samples) -> Float[np.ndarray, "cones k"]:
        """Value minus distance at the samples of a cell for each cone, 0 where they do not count."""
        return np.where(samples.weight > 0, self(samples.x) - samples.distance, 0.0)

    def mean_square(self, samples: Samples) -> Float[np.ndarray, "cones"]:
        """Weighted mean of the squared errors."""
        return samples.mean(np.square(self.errors(samples)))


def fit_cones(samples: Samples, farthest: float) -> Cones:
    """The cone for every cell that errs least, its source at most so far from the samples' center."""
    frame = _Frame.of(samples)
    local, farthest_here = frame.samples(samples), farthest / frame.scale
    starts = _of_squares(local), _of_planes(local, farthest_here)
    one, other = (_descended(local, start, farthest_here) for start in starts)
    is_one = one.mean_square(local) <= other.mean_square(local)
    best = Cones(np.where(is_one[:, None], one.point, other.point), np.where(is_one, one.offset, other.offset))
    return frame.to_world(best)


def refine_cones(samples: Samples, start: Cones, farthest: float) -> Cones:
    """The cone for every cell that errs least, near one to start from."""
    frame = _Frame.of(samples)
    return frame.to_world(_descended(frame.samples(samples), frame.cones(start), farthest / frame.scale))


def normal_equations(
    samples: Samples, cones: Cones
) -> tuple[Float[np.ndarray, "cells terms terms"], Float[np.ndarray, "cells terms"]]:
    """Matrix and right side of the equations of a Gauss-Newton step: of the source, and of the offset last."""
    slope = slopes(samples, cones)
    weighted = slope * samples.weight[..., None]
    normal = weighted.transpose(0, 2, 1) @ slope
    total, terms = samples.weight.sum(axis=1), normal.shape[1]
    normal[:, range(terms), range(terms)] += np.where(total > 0, _RIDGE * total, 1.0)[:, None]
    return normal, np.einsum("ckt,ck->ct", weighted, cones.errors(samples))


def slopes(samples: Samples, cones: Cones) -> Float[np.ndarray, "cells k terms"]:
    """By how much values at samples grow with coordinates of the source, and with the offset last."""
    away = cones.point[:, None] - samples.x
    length = _length(away)[..., None]
    return np.concatenate([away / np.where(length > 0, length, 1), np.ones_like(length)], axis=2)


@dataclass(frozen=True, eq=False)
class _Frame:
    """Coordinates in which the samples of a cell are about 0, and about 1 apart: nothing cancels there."""

    center: Float[np.ndarray, "cells dim"]
    distance: Float[np.ndarray, "cells"]
    scale: Float[np.ndarray, "cells"]

    @staticmethod
    def of(samples: Samples) -> "_Frame":
        center = samples.mean(samples.x)
        spread = np.where(samples.weight > 0, _length(samples.x - center[:, None]), 0.0).max(axis=1)
        return _Frame(center, samples.mean(samples.distance), np.where(spread > 0, spread, 1.0))

    def samples(self, samples: Samples) -> Samples:
        scale = self.scale[:, None]
        x = (samples.x - self.center[:, None]) / scale[:, None]
        return Samples(x, (samples.distance - self.distance[:, None]) / scale, samples.weight)

    def cones(self, cones: Cones) -> Cones:
        point = (cones.point - self.center) / self.scale[:, None]
        return Cones(point, (cones.offset - self.distance) / self.scale)

    def to_world(self, cones: Cones) -> Cones:
        point = self.center + cones.point * self.scale[:, None]
        return Cones(point, self.distance + cones.offset * self.scale)


def _of_squares(samples: Samples) -> Cones:
    """Solutions of the linear equations."""
    x, distance, root = samples.x, samples.distance, np.sqrt(samples.weight)
    design = np.concatenate([2 * x, -2 * distance[..., None], np.ones_like(distance)[..., None]], axis=2)
    square = np.square(x).sum(axis=2) - np.square(distance)
    solution = np.linalg.pinv(design * root[..., None], rcond=_RANK_TOLERANCE) @ (root * square)[..., None]
    return Cones(solution[:, :-2, 0], solution[:, -2, 0])


def _of_planes(samples: Samples, farthest: Float[np.ndarray, "cells"]) -> Cones:
    """Sources as far as may be, from which distances grow as those of the samples do."""
    x, root = samples.x, np.sqrt(samples.weight)[..., None]
    slope = np.linalg.pinv(x * root, rcond=_RANK_TOLERANCE) @ (root * samples.distance[..., None])
    slope = slope[..., 0]
    length = _length(slope)
    upward = np.where(length[:, None] > 0, slope / np.where(length > 0, length, 1)[:, None], np.eye(x.shape[2])[0])
    return _with_offsets(samples, -upward * farthest[:, None])


def _with_offsets(samples: Samples, point: Float[np.ndarray, "cells dim"]) -> Cones:
    """Cones of some sources, as high as errs least."""
    flat = Cones(point, np.zeros(len(point)))
    return Cones(point, -samples.mean(flat.errors(samples)))


def _descended(samples: Samples, start: Cones, farthest: Float[np.ndarray, "cells"]) -> Cones:
    """Gauss-Newton steps from a start, each kept where the error falls."""
    here = _within(samples, start, farthest)
    square = here.mean_square(samples)
    for _ in range(_STEPS):
        normal, moments = normal_equations(samples, here)
        step = np.linalg.solve(normal, moments[..., None])[..., 0]
        there = _within(samples, Cones(here.point - step[:, :-1], here.offset - step[:, -1]), farthest)
        square_there = there.mean_square(samples)
        falls = square_there < square
        here = Cones(np.where(falls[:, None], there.point, here.point), np.where(falls, there.offset, here.offset))
        square = np.where(falls, square_there, square)
    return here


def _within(samples: Samples, cones: Cones, farthest: Float[np.ndarray, "cells"]) -> Cones:
    """The cones, but sources farther than may be moved closer, with offsets that fit."""
    length = _length(cones.point)
    far = length > farthest
    nearer = _with_offsets(samples, cones.point * (farthest / np.where(far, length, 1))[:, None])
    return Cones(np.where(far[:, None], nearer.point, cones.point), np.where(far, nearer.offset, cones.offset))


def _length(vector: Float[np.ndarray, "*n dim"]) -> Float[np.ndarray, "*n"]:
    return np.sqrt(np.square(vector).sum(axis=-1))


# Fitting sources all at once: the offset of one is that of its parent and the way there.
#
# So far fewer numbers explain the samples, and each is the more certain.


def fit_families(cones: Cones, samples: Sequence[Samples], parents: Int[np.ndarray, "sources"]) -> Cones:
    """Cones that err least at the samples of each, by Gauss-Newton steps from given ones.

    A source that is its own parent, a root, keeps an offset of its own; without children it stays as it is.
    """
    from scipy.sparse import diags_array

    is_root = parents == np.arange(len(parents))
    in_family = ~is_root
    in_family[parents[~is_root]] = True
    if not in_family.any():
        return cones
    chains, point, root_offset = _chains(parents), cones.point, np.where(is_root, cones.offset, 0.0)
    count, dim = point.shape
    used = np.append(np.repeat(in_family, dim), is_root & in_family)
    for _ in range(_STEPS):
        here = _cones_by_parents(point, root_offset, parents, chains)
        equations = [normal_equations(samples[i], here[[i]]) for i in range(len(here))]
        normal, moments = (np.concatenate(part) for part in zip(*equations, strict=True))
        of_parameters = _numbers_of_parameters(here, parents, chains) @ diags_array(used.astype(np.float64))
        squares = weighted_squares(of_parameters, normal) + diags_array((~used).astype(np.float64))
        step = solve_sparse(squares, of_parameters.T @ moments.ravel())
        point = point - step[: count * dim].reshape(count, dim)
        root_offset = root_offset - step[count * dim :]
    return _cones_by_parents(point, root_offset, parents, chains)


def _chains(parents: Int[np.ndarray, "sources"]) -> "csr_array":
    """Which sources are on the way from each one to its root, itself and the root among them, as ones."""
    from scipy.sparse import csr_array, eye_array

    child = np.flatnonzero(parents != np.arange(len(parents)))
    onward = csr_array((np.ones(len(child)), (child, parents[child])), shape=(len(parents), len(parents)))
    chains = farther = csr_array(eye_array(len(parents)))
    while (farther := csr_array(farther @ onward)).nnz:
        chains = csr_array(chains + farther)
    return chains


def _cones_by_parents(
    point: Float[np.ndarray, "sources dim"],
    root_offset: Float[np.ndarray, "sources"],
    parents: Int[np.ndarray, "sources"],
    chains: "csr_array",
) -> Cones:
    """Cones whose offsets follow from their parents."""
    return Cones(point, chains @ (root_offset + np.linalg.norm(point - point[parents], axis=1)))


def _numbers_of_parameters(cones: Cones, parents: Int[np.ndarray, "sources"], chains: "csr_array") -> "csr_array":
    """By how much coordinates and offset, source by source, grow with each parameter."""
    from scipy.sparse import csr_array, hstack, vstack

    count, dim = cones.point.shape
    way = cones.point - cones.point[parents]
    length = np.linalg.norm(way, axis=1, keepdims=True)
    way = (way / np.where(length > 0, length, 1)).ravel()
    row, column = np.repeat(np.arange(count), dim), np.arange(count * dim)
    of_parent = (parents[:, None] * dim + np.arange(dim)).ravel()
    entries = np.append(way, -way), (np.append(row, row), np.append(column, of_parent))
    lengths = hstack([csr_array(entries, shape=(count, count * dim)), csr_array(np.eye(count))])
    coordinates = csr_array((np.ones(count * dim), (column, column)), shape=(count * dim, count * (dim + 1)))
    number = np.column_stack([column.reshape(count, dim), count * dim + np.arange(count)])
    return csr_array(csr_array(vstack([coordinates, chains @ lengths]))[number.ravel()])


# Which cells are of one and the same source, and where it is, from cones fitted to the samples of each.
#
# The most certain cone claims all cells whose samples it meets, to within the noise and its own uncertainty there; it
# is fitted again to all their samples, claims anew, and so on. So noise averages out over all that a source explains.


BEYOND_NOISE = 6.0  # times its root mean square no sample errs
_MOST_UNCERTAIN = 10.0  # times the noise is what a claim may be
_UNLIKELY = 5.0  # standard deviations of a mean square
_CLAIMS = 10


@dataclass(frozen=True, eq=False)
class Patches(Rows):
    """Cells and the cones that fit them.

    Attributes:
        samples: Their samples.
        cones: Their cones.
        error: Root mean square error of each, per degree of freedom.
        spread: By how much each source and offset is uncertain, times the noise.
    """

    samples: Samples
    cones: Cones
    error: Float[np.ndarray, "cells"]
    spread: Float[np.ndarray, "cells"]

    @staticmethod
    def fitted(samples: Samples, farthest: float) -> "Patches":
        """A cone for each cell, its source at most so far away."""
        cones = fit_cones(samples, farthest)
        count, terms = (samples.weight > 0).sum(axis=1), samples.x.shape[2] + 1
        error = np.sqrt(cones.mean_square(samples) * count / (count - terms))
        covariance = np.linalg.inv(normal_equations(samples, cones)[0])
        return Patches(samples, cones, error, np.sqrt(np.trace(covariance, axis1=1, axis2=2)))

    def __len__(self) -> int:
        return len(self.error)

    def are_of_noise(self, noise: float) -> Bool[np.ndarray, "cells"]:
        """Which err as noise makes them: where two sources that differ by little meet, cones err by more."""
        freedom = (self.samples.weight > 0).sum(axis=1) - self.samples.x.shape[2] - 1
        return self.error <= noise * (1 + _UNLIKELY / np.sqrt(2 * freedom))


@dataclass(frozen=True, eq=False)
class Clusters:
    """Sources, each with all samples that are of it."""

    cones: Cones
    samples: Sequence[Samples]

    def explain(self, samples: Samples, noise: float) -> Bool[np.ndarray, "cells"]:
        """Which cells have no samples but such as lie on some cone."""
        closest = np.full(samples.distance.shape, np.inf)
        for index in range(len(self.cones)):
            closest = np.minimum(closest, np.abs(self.cones[[index]].errors(samples)))
        return closest.max(axis=1) <= BEYOND_NOISE * noise


def cluster_patches(patches: Patches, noise: float, farthest: float) -> Clusters:
    """All sources of patches, each once, the most certain first."""
    rest = patches[np.argsort(patches.spread, kind="stable")]
    cones, samples = patches.cones[:0], []
    while len(rest):
        claimed = np.arange(len(rest)) == 0
        cone, own = rest.cones[:1], rest.samples[:1]
        for _ in range(_CLAIMS):
            claims = _meets(cone, own, rest.samples, noise)
            claims[0] = True
            if np.array_equal(claims, claimed):
                break
            claimed, own = claims, rest.samples[claims].as_one()
            cone = refine_cones(own, cone, farthest)
        cones, rest = cones.append(cone), rest[~claimed]
        samples.append(own.as_one())
    return Clusters(cones, samples)


def _meets(cone: Cones, own: Samples, samples: Samples, noise: float) -> Bool[np.ndarray, "cells"]:
    """Which cells' samples all lie on a cone, as far as it is certain from its own samples."""
    covariance = np.linalg.inv(normal_equations(own, cone)[0][0])
    slope = slopes(samples, cone)
    variance = np.einsum("cki,ij,ckj->ck", slope, covariance, slope)
    error = np.abs(cone.errors(samples))
    return (error <= BEYOND_NOISE * noise * np.sqrt(1 + np.clip(variance, 0, _MOST_UNCERTAIN**2))).all(axis=1)


_FARTHEST = 100.0  # a source may be, in diagonals of the domain: 32-bit floats lose digits of what is farther
_MOST_HALVINGS = 6  # along an axis
_MOST_CELLS = 2**11
_LEAST_NOISE, _MOST_NOISE = 1e-12, 1e-5  # of the largest distance and the domain


@dataclass(frozen=True, eq=False)
class FoundSources:
    """Sources, and the noise of the distances that they explain: root mean square."""

    sources: Sources
    noise: float


def farthest_source(domain: Box) -> float:
    """How far a source may be from what it explains."""
    return _FARTHEST * float(np.linalg.norm(domain.width))


def samples_of(fit: CellFit, domain: Box) -> Samples:
    """The samples of some cells that reach the goal, all of equal weight."""
    return Samples(fit.cells.points(fit.pattern.u, domain), fit.value, fit.reachable.astype(np.float64))


def find_sources(sampler: Sampler) -> FoundSources:
    """Sources whose cones explain what is sampled, as far as so many cells may tell.

    Where cones fit no cells, as of a smooth function that is no distance, there are none.
    """
    domain, dim = sampler.domain, sampler.domain.dim
    farthest = farthest_source(domain)
    cells, num_cells, noise = Cells.root(dim), 1, 0.0
    patches, clusters = None, Clusters(Cones(np.zeros((0, dim)), np.zeros(0)), [])
    for halving in range(_MOST_HALVINGS * dim + 1):
        fit = sampler(cells)
        fit = fit[fit.reachable.sum(axis=1) >= 2 * (dim + 2)]
        if not len(fit):
            break
        here = Patches.fitted(samples_of(fit, domain), farthest)
        scale = float(np.linalg.norm(domain.width) + np.abs(fit.value).max())
        is_open = here.error > _MOST_NOISE * scale
        patches = here[~is_open] if patches is None else patches.append(here[~is_open])
        if len(patches):
            noise = max(float(np.quantile(patches.error, 0.25)), _LEAST_NOISE * scale)
            clusters = cluster_patches(patches[patches.are_of_noise(noise)], noise, farthest)
            is_open[is_open] = ~clusters.explain(here.samples[is_open], noise)
        num_cells += 2 * np.count_nonzero(is_open)
        if not is_open.any() or num_cells > _MOST_CELLS:
            break
        cells = fit.cells[is_open].split(np.full(np.count_nonzero(is_open), halving % dim))
    return FoundSources(_joined(clusters, noise), noise)


def _joined(clusters: Clusters, noise: float) -> Sources:
    """Sources with their parents, fitted again all at once, without those parents with which samples are not met."""
    cones, samples = clusters.cones, clusters.samples
    normal = [normal_equations(samples[i], cones[[i]])[0] for i in range(len(cones))]
    if not normal:
        return Sources(cones.point, cones.offset, np.zeros(0, np.int64))
    spread = np.sqrt(np.trace(np.linalg.inv(np.concatenate(normal)), axis1=1, axis2=2))
    parents = _parents(cones, BEYOND_NOISE * noise * (spread + spread[:, None]))
    while True:
        joint = fit_families(cones, samples, parents)
        worst = np.array([np.abs(joint[[i]].errors(samples[i])).max() for i in range(len(joint))])
        unmet = (worst > BEYOND_NOISE * noise) & (parents != np.arange(len(parents)))
        if not unmet.any():
            return Sources(joint.point, joint.offset, parents)
        parents = np.where(unmet, np.arange(len(parents)), parents)


def _parents(cones: Cones, tolerance: Float[np.ndarray, "sources sources"]) -> Int[np.ndarray, "sources"]:
    """Of each source the one by way of which its offset is explained best; its own index where none does."""
    onward = cones.offset + np.linalg.norm(cones.point[:, None] - cones.point, axis=2)
    mismatch = np.abs(onward - cones.offset[:, None])
    mismatch[(cones.offset >= cones.offset[:, None]) | (mismatch > tolerance)] = np.inf
    return np.where(np.isfinite(mismatch).any(axis=1), mismatch.argmin(axis=1), np.arange(len(cones)))
