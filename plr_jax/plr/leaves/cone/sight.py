"""Choosing sources in sight: of those that serve a box about as well, one that most of it sees.

Who goes straight from a point to its leaf's source meets a wall where the source is out of sight. There the distance
is larger than the cone says, for if it were in sight, the way by it would be as short. So samples tell.
"""

from bisect import bisect_left
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.geometry.convex_pieces import areas
from plr_jax.plr.leaves.cone.boxes import ConeBoxes, errors_of_options
from plr_jax.plr.sampling.cell_fit import Sampler, call_oracle
from plr_jax.plr.sampling.pattern import Pattern

PRICE = 30.0
"""Error that counts as much as a way that meets a wall, in proven mean errors of all boxes."""
_LEAST_SHORTFALL = 1e-9
"""Widths of the domain by which a distance is above a cone for certain."""

BoxSources: TypeAlias = Int[np.ndarray, "boxes"]
Pairs: TypeAlias = tuple[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"], Bool[np.ndarray, "pairs"]]


def sources_in_sight(boxes: ConeBoxes, sampler: Sampler, fits: Callable[[BoxSources], bool]) -> BoxSources:
    """The source of every box, another one where a part of it does not see the best one and that one is worth it.

    No box's proven error rises above the largest of all: what is proven of all of them holds as before. Of the
    changes, the most useful first, as many are made as fit.
    """
    box, source = _changes(boxes, sampler)

    def changed(count: int) -> BoxSources:
        result = boxes.source.copy()
        result[box[:count]] = source[:count]
        return result

    if fits(changed(len(box))):
        return changed(len(box))
    return changed(bisect_left(range(1, len(box)), True, key=lambda count: not fits(changed(count))))


def _changes(boxes: ConeBoxes, sampler: Sampler) -> tuple[Int[np.ndarray, "changes"], Int[np.ndarray, "changes"]]:
    """Boxes that are better off with another source, and which; those that gain most, over all their area, first."""
    box, source, by_all = pairs_of_boxes(boxes)
    is_doubted = boxes.source >= 0
    is_doubted[box[by_all & (source == boxes.source[box])]] = False
    box, source, by_all = (column[is_doubted[box]] for column in (box, source, by_all))
    if not len(box):
        return box, source
    doubted, count = np.flatnonzero(is_doubted), len(boxes.source)
    price = PRICE * float(boxes.integral.sum())
    some, option_box = boxes[doubted], np.searchsorted(doubted, box)
    x = some.cells.points(sampler.pattern.u, boxes.domain)
    distance = call_oracle(sampler.distance_fn, x.reshape(-1, x.shape[-1])).reshape(x.shape[:-1])
    error, hidden = errors_and_shares_hidden(some, sampler.pattern, x, distance, option_box, source)
    cost = error + price * hidden
    largest, integral = errors_of_options(boxes.visible, box, source)
    is_own = source == boxes.source[box]
    is_barred = ~is_own & (largest > max(boxes.error.max(), boxes.negligible))
    order = np.lexsort((integral, ~is_own, ~by_all, cost, is_barred, box))
    best = order[np.append(True, box[order[1:]] != box[order[:-1]])]
    gain = np.bincount(box[is_own], cost[is_own], count)[box[best]] - cost[best]
    gain *= np.bincount(boxes.visible.cell, areas(boxes.visible.pieces), count)[box[best]]
    best = best[np.argsort(-gain, kind="stable")]
    best = best[~is_own[best]]
    return box[best], source[best]


def pairs_of_boxes(boxes: ConeBoxes) -> Pairs:
    """Pairs of a box and a source that some point of it may use, box by box, and whether all of it sees it."""
    visible = boxes.visible
    count = len(visible.sources.points)
    key, index = np.unique(visible.cell[visible.piece] * np.int64(count) + visible.source, return_inverse=True)
    box, source = np.divmod(key, count)
    return box, source, np.bincount(index, visible.by_all, len(key)) == np.diff(visible.first_piece)[box]


def errors_and_shares_hidden(
    boxes: ConeBoxes,
    pattern: Pattern,
    x: Float[np.ndarray, "boxes k 2"],
    distance: Float[np.ndarray, "boxes k"],
    box: Int[np.ndarray, "options"],
    source: Int[np.ndarray, "options"],
) -> tuple[Float[np.ndarray, "options"], Float[np.ndarray, "options"]]:
    """Mean error of each source in its box, and the share of it from where a wall is in the way."""
    sources, width = boxes.visible.sources, float(boxes.domain.width.max())
    weight = pattern.weight * np.isfinite(distance)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), pattern.weight.min())
    cone = sources.distances[source, None] + np.linalg.norm(x[box] - sources.points[source, None], axis=2)
    above = np.where(np.isfinite(distance), distance, 0.0)[box] - cone
    is_hidden = above > _LEAST_SHORTFALL * width
    return np.sum(weight[box] * np.abs(above), axis=1), np.sum(weight[box] * is_hidden, axis=1)
