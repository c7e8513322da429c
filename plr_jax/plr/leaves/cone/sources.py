"""Finding the sources of a distance function that does not offer them, from samples of cells.

Cells are halved until a cone fits each to within noise, or known sources explain every sample of it. Where a source's
distance is that of another one and the way there, it is so exactly, and the fit of both is to the samples of both.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from plr_jax._types import Sources
from plr_jax.geometry.box import Box
from plr_jax.plr.leaves.cone.clusters import BEYOND_NOISE, Clusters, Patches, cluster_patches
from plr_jax.plr.leaves.cone.families import fit_families
from plr_jax.plr.leaves.cone.fit import Cones, Samples, normal_equations
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_fit import CellFit, Sampler

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
