"""Growing a partition from samples: each leaf has the source whose cone errs least, or its own where none is good."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._types import SourcedFn, Sources
from plr_jax.geometry.box import Box
from plr_jax.plr.growth.best_first import Encoding, fit_sampled, grow_best_first
from plr_jax.plr.growth.limits import Limits
from plr_jax.plr.growth.nodes import Nodes, nodes_of_fit
from plr_jax.plr.growth.rules import best_axis, best_open_axis, largest_error
from plr_jax.plr.leaves.base import Rules
from plr_jax.plr.leaves.cone.choice import Choice, choose_sources, sample_weights
from plr_jax.plr.leaves.cone.clusters import BEYOND_NOISE
from plr_jax.plr.leaves.cone.codec import StoredCones
from plr_jax.plr.leaves.cone.fit import Cones, fit_cones
from plr_jax.plr.leaves.cone.sources import FoundSources, farthest_source, find_sources, samples_of
from plr_jax.plr.leaves.cone.stored import num_bytes_of, stored_cones
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_fit import CellFit, Sampler

_VOLUME_POWER = 0.5  # between the largest error (0) and the mean error (1)
_OWN_GAIN = 8.0  # a source of its own takes the bytes of about as many leaves


def grow_from_samples(sampler: Sampler, rules: Rules, limits: Limits) -> tuple[Cells, StoredCones]:
    """Leaves in the order of the tree's traversal, and what a file keeps of them."""
    root, oracle, domain = sampler.root(), sampler.distance_fn, sampler.domain
    if isinstance(oracle, SourcedFn):
        known, may_own = FoundSources(_reached(oracle.sources), 0.0), False
    else:
        known, may_own = find_sources(sampler), True
    leaves = _Leaves(known, may_own, domain, rules, limits)

    def size(nodes: Nodes, leaf: Int[np.ndarray, "leaves"], bits: int) -> int:
        return num_bytes_of(*leaves.stored(nodes[leaf]), domain, limits)

    encoding = Encoding([0], size, lambda nodes, leaf, bits: 0.0)
    first = leaves.nodes_of(root, np.array([np.inf]))
    nodes, leaf, _ = grow_best_first(first, fit_sampled(sampler, leaves.nodes_of), limits, encoding)
    return leaves.stored(nodes[leaf])


def _reached(sources: Sources) -> Sources:
    """The sources that reach the goal."""
    reached = np.isfinite(sources.distances)
    place = np.cumsum(reached) - 1
    return Sources(sources.points[reached], sources.distances[reached], place[sources.parents[reached]])


@dataclass(frozen=True, eq=False)
class _Leaves:
    """How leaves are chosen. A node's coefficients: its source's index, -1 for one of its own; offset; point.

    Where a cell has no reachable sample, the offset is ``inf``.
    """

    known: FoundSources
    may_own: bool
    domain: Box
    rules: Rules
    limits: Limits

    @property
    def cones(self) -> Cones:
        """Those of the sources that all leaves share."""
        return Cones(self.known.sources.points, self.known.sources.distances)

    def nodes_of(self, fit: CellFit, bound: Float[np.ndarray, "cells"]) -> Nodes:
        """Cells as leaves of a round, and whether and when each may be split."""
        choice = choose_sources(fit, self.cones, self.domain)
        cones, is_own = self._chosen(fit, choice)
        samples = samples_of(fit, self.domain)
        error = -cones.errors(samples)
        error[np.abs(error) <= BEYOND_NOISE * self.known.noise] = 0.0
        fit = replace(fit, residual=error)
        priority, axis = np.asarray(self.rules.should_split(fit), float), np.asarray(self.rules.split(fit))
        if self.rules.split is best_axis:  # for planes; of shared sources those that serve the halves best are known
            axis = np.where(is_own, axis, best_open_axis(fit, choice.split_cost))
        offset = np.where(fit.reachable.any(axis=1), cones.offset, np.inf)
        coefficients = np.column_stack([np.where(is_own, -1, choice.source), offset, cones.point])
        nodes = nodes_of_fit(fit, coefficients, np.full(len(fit), np.inf), priority, axis, self.limits)
        return replace(nodes, key=np.minimum(nodes.key * self._importance(fit.cells), bound))

    def _importance(self, cells: Cells) -> Float[np.ndarray, "cells"]:
        """How much the largest error of a cell counts by its volume; a rule of the caller's has the last word."""
        power = _VOLUME_POWER if self.rules.should_split is largest_error else 0.0
        return 2.0 ** (-power * cells.depth.sum(axis=1))

    def _chosen(self, fit: CellFit, choice: Choice) -> tuple[Cones, Bool[np.ndarray, "cells"]]:
        """The cone of each cell, and whether it is of no shared source."""
        chosen = Cones(np.zeros((len(fit), self.domain.dim)), np.zeros(len(fit)))
        shared = np.flatnonzero(choice.source >= 0)
        chosen.point[shared] = self.cones.point[choice.source[shared]]
        chosen.offset[shared] = self.cones.offset[choice.source[shared]]
        is_own, weight = np.zeros(len(fit), bool), sample_weights(fit)
        of_noise = choice.cost <= BEYOND_NOISE * self.known.noise * weight.sum(axis=1)
        tells = ~fit.is_hardly_seen | (choice.source < 0)  # any cone passes through a few samples
        poor = np.flatnonzero(self.may_own & ~of_noise & tells & fit.reachable.any(axis=1))
        if len(poor):
            samples = replace(samples_of(fit[poor], self.domain), weight=weight[poor])
            own = fit_cones(samples, farthest_source(self.domain))
            cost = (samples.weight * np.abs(own.errors(samples))).sum(axis=1)
            better = _OWN_GAIN * cost < choice.cost[poor]
            is_own[poor] = better
            chosen.point[poor[better]], chosen.offset[poor[better]] = own.point[better], own.offset[better]
        return chosen, is_own

    def stored(self, leaves: Nodes) -> tuple[Cells, StoredCones]:
        """Leaves in the order of the tree's traversal, and what a file keeps of them."""
        index, sources = leaves.coefficients[:, 0].astype(np.int64), self.known.sources
        own = np.flatnonzero((index < 0) & np.isfinite(leaves.coefficients[:, 1]))
        index[own] = len(sources.parents) + np.arange(len(own))
        every = Sources(
            np.concatenate([sources.points, leaves.coefficients[own, 2:]]),
            np.append(sources.distances, leaves.coefficients[own, 1]),
            np.append(sources.parents, index[own]),
        )
        return stored_cones(leaves.cells, index, every, self.domain)
