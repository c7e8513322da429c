"""Which of many sources serves the samples of each cell best, and those of its halves."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from plr_jax.geometry.box import Box
from plr_jax.plr.leaves.cone.fit import Cones
from plr_jax.plr.sampling.cell_fit import CellFit, weights_of_fit

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
