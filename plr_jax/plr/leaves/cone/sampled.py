"""Growing a partition from samples: each leaf has the source whose cone errs least, or its own where none is good."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._types import SourcedFn, Sources
from plr_jax.geometry.box import Box
from plr_jax.plr.file.bits import BitWriter
from plr_jax.plr.growth.best_first import (
    Encoding,
    best_axis,
    best_open_axis,
    fit_sampled,
    grow_best_first,
    largest_error,
)
from plr_jax.plr.growth.limits import Limits, Nodes, nodes_of_fit
from plr_jax.plr.leaves.base import Rules
from plr_jax.plr.leaves.cone.codec import StoredCones, stored_cones, write_cones
from plr_jax.plr.leaves.cone.sources import (
    BEYOND_NOISE,
    Cones,
    FoundSources,
    farthest_source,
    find_sources,
    fit_cones,
    samples_of,
)
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_fit import CellFit, Sampler, weights_of_fit

# Which of many sources serves the samples of each cell best, and those of its halves.


_NUMBERS_AT_ONCE = 2**22


@dataclass(frozen=True, eq=False)
class Choice:
    """The best source for each cell.

    Attributes:
        source: Its index; -1 for a cell without a reachable sample.
        cost: Weighted sum of the absolute errors of its cone at the samples; ``inf`` without a source.
        split_cost: The same for halves of the cell along each axis, each with a source of its own.
    """

    source: Int[np.ndarray, "cells"]
    cost: Float[np.ndarray, "cells"]
    split_cost: Float[np.ndarray, "cells dim"]


def sample_weights(fit: CellFit) -> Float[np.ndarray, "cells k"]:
    """Samples as errors count in the choice of a source."""
    return weights_of_fit(fit.reachable, fit.weight) * fit.pattern.weight


def choose_sources(fit: CellFit, cones: Cones, domain: Box) -> Choice:
    """The best of all sources for each cell; the first of equals."""
    cell, source = _candidates(fit, cones, domain)
    cost = _costs(fit, cones, domain, cell, source)
    cells, dim = fit.cells.depth.shape
    choice = Choice(np.full(cells, -1), np.full(cells, np.inf), np.full((cells, dim), np.inf))
    if len(cell):
        first = np.flatnonzero(np.append(True, cell[1:] != cell[:-1]))
        least, of_cell = np.minimum.reduceat(cost, first), cell[first]
        order = np.lexsort((cost[:, 0], cell))
        choice.source[of_cell], choice.cost[of_cell] = source[order[first]], least[:, 0]
        choice.split_cost[of_cell] = least[:, 1 : 1 + dim] + least[:, 1 + dim :]
    return choice


def _candidates(fit: CellFit, cones: Cones, domain: Box) -> tuple[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"]]:
    """Cells and sources whose cones may take a sampled value there, or come closest to one, cell by cell."""
    center = fit.cells.points(np.zeros((1, domain.dim)), domain)[:, 0]
    corner = fit.cells.points(np.abs(fit.pattern.u).max(axis=0, keepdims=True), domain)[:, 0]
    radius = np.linalg.norm(corner - center, axis=1)
    highest = np.where(fit.reachable, fit.value, -np.inf).max(axis=1) + radius
    lowest = np.where(fit.reachable, fit.value, np.inf).min(axis=1) - radius
    parts = [(np.zeros(0, np.int64), np.zeros(0, np.int64))]
    at_once = max(1, _NUMBERS_AT_ONCE // (len(cones) * domain.dim + 1))
    for start in range(0, len(center) if len(cones) else 0, at_once):
        some = slice(start, start + at_once)
        value = cones.offset + np.linalg.norm(center[some, None] - cones.point, axis=2)
        beyond = np.maximum(value - highest[some, None], lowest[some, None] - value)
        near = beyond <= np.maximum(beyond.min(axis=1, keepdims=True), 0.0)
        cell, source = np.nonzero(near & np.any(fit.reachable[some], axis=1, keepdims=True))
        parts.append((start + cell, source))
    cell, source = (np.concatenate(column) for column in zip(*parts, strict=True))
    return cell, source


def _costs(
    fit: CellFit, cones: Cones, domain: Box, cell: Int[np.ndarray, "pairs"], source: Int[np.ndarray, "pairs"]
) -> Float[np.ndarray, "pairs parts"]:
    """Weighted sums of absolute errors over a cell, its lower halves along each axis, and its upper halves."""
    weight, upper = sample_weights(fit), (fit.pattern.u > 0).astype(np.float64)
    parts = np.concatenate([np.ones((len(upper), 1)), 1 - upper, upper], axis=1)
    x = fit.cells.points(fit.pattern.u, domain)
    cost = np.empty((len(cell), parts.shape[1]))
    at_once = max(1, _NUMBERS_AT_ONCE // x[0].size)
    for start in range(0, len(cell), at_once):
        some = slice(start, start + at_once)
        here = cell[some]
        cost[some] = (weight[here] * np.abs(cones[source[some]](x[here]) - fit.value[here])) @ parts
    return cost


_VOLUME_POWER = 0.5  # between the largest error (0) and the mean error (1)
_OWN_GAIN = 8.0  # a source of its own takes the bytes of about as many leaves


def grow_from_samples(sampler: Sampler, rules: Rules, limits: Limits) -> tuple[Cells, StoredCones]:
    """Leaves in the order of the tree's traversal, and what a file keeps of them."""
    root, oracle, domain = sampler.root(), sampler.distance_fn, sampler.domain
    if isinstance(oracle, SourcedFn):
        every = oracle.sources
        reached = np.isfinite(every.distances)
        parents = (np.cumsum(reached) - 1)[every.parents[reached]]
        known = FoundSources(Sources(every.points[reached], every.distances[reached], parents), 0.0)
    else:
        known = find_sources(sampler)
    leaves = _Leaves(known, not isinstance(oracle, SourcedFn), domain, rules, limits)

    def size(nodes: Nodes, leaf: Int[np.ndarray, "leaves"], bits: int) -> int:
        write_cones(body := BitWriter(), domain, leaves.stored(nodes[leaf])[1])
        return limits.file_size(domain.dim, len(leaf), body.num_bits)

    encoding = Encoding([0], size, lambda nodes, leaf, bits: 0.0)
    first = leaves.nodes_of(root, np.array([np.inf]))
    nodes, leaf, _ = grow_best_first(first, fit_sampled(sampler, leaves.nodes_of), limits, encoding)
    return leaves.stored(nodes[leaf])


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
        # How much the largest error of a cell counts by its volume; a rule of the caller's has the last word.
        power = _VOLUME_POWER if self.rules.should_split is largest_error else 0.0
        return replace(nodes, key=np.minimum(nodes.key * 2.0 ** (-power * fit.cells.depth.sum(axis=1)), bound))

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
