"""Thin parts of obstacles: up to about 5e-6 domain widths, so that 32-bit floats hardly tell both sides apart.

For tests of visibility, walls move 4e-6 domain widths back into their obstacles, so that rounding hides no corner. A
wall stays if its obstacle is so thin that the moved wall would come near free space; corners move in front of it
instead. For this, a wall must be thin as a whole or not at all, and a sharp tip of a thin obstacle must have a corner
on either side. Functions get the ``width`` of the domain.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import shapely
from jaxtyping import Int

from plr_jax.pairs.portable import MARGIN, RECEDING
from plr_jax.pairs.stored import MITRE, Outline

FINEST = 2.0**-24  # finest lattice step, in domain widths: the resolution of 32-bit floats
_NEEDLE = 100  # distances that the tip of a thick obstacle may move back; queries may not resolve sharper tips


def thin_walls(outline: Outline, free_space: Any, width: float) -> Int[np.ndarray, " thin"]:
    """Return the indices of walls of thin obstacles: moved into the obstacle, these walls come near free space."""
    walls: Any = shapely.linestrings(outline.moved_walls(RECEDING * width, moves_all=True).reshape(-1, 2, 2))
    return np.flatnonzero(shapely.dwithin(free_space, walls, MARGIN * width))


def with_thin_parts(
    outline: Outline, vertex: Int[np.ndarray, " points"], free_space: Any, width: float
) -> tuple[Outline, Int[np.ndarray, " found_points"]]:
    """Mark the walls of thin obstacles in an outline, after cutting walls whose obstacle is thin only in part.

    ``vertex`` is the boundary vertex at each point of the outline. Return it for the new outline, too: -1 at cuts.
    """
    # Sharp tips get two points, neighbors on the lattice: a query that rounding puts on or across a thin wall sees
    # the tip's corner on its own side.
    spans = _thin_spans(outline, free_space, width)
    if not any(spans.values()):
        return outline, vertex
    finer = 2 ** int(np.log2(max(1.0, outline.step / (FINEST * width))))
    outline = replace(outline, step=outline.step / finer, points=outline.points * finer)
    places, before = [tuple(place) for place in outline.points.tolist()], np.argsort(outline.following_past_contacts)
    ahead = outline.moved_points(-1.0) - outline.positions
    is_sharp = outline.is_reflex & ~outline.is_shared & (np.linalg.norm(ahead, axis=1) > 0.99 * MITRE)
    onward = outline.positions[outline.following] - outline.positions
    lengths = np.linalg.norm(onward, axis=1)
    ends_thin = {i for i, own in spans.items() if own and own[-1][1] >= lengths[i]}
    taken, rows = set(places), []  # rows: ring, place, vertex, whether the wall from there is thin

    def beside(place: tuple[int, int], x: float, y: float) -> tuple[int, int]:
        # The neighbor on the lattice, not yet taken, that is farthest in the direction (x, y).
        around = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (place[0] + i, place[1] + j) not in taken]
        i, j = max(around, key=lambda step: (step[0] * x + step[1] * y) / np.hypot(*step), default=(0, 0))
        return place[0] + i, place[1] + j

    for ring in range(len(outline.first) - 1):
        for i in range(outline.first[ring], outline.first[ring + 1]):
            own = spans.get(i, [])
            is_thin = bool(own) and own[0][0] <= 0
            rows.append((ring, places[i], vertex[i], is_thin))
            if is_thin and is_sharp[i] and before[i] in ends_thin:
                # The ring turns right around the tip, from the tip's left side to its right side.
                rows.append((ring, beside(places[i], ahead[i][1], -ahead[i][0]), vertex[i], True))
                taken.add(rows[-1][1])
            for at, is_thin in [(end, k == 0) for span in own for k, end in enumerate(span) if 0 < end < lengths[i]]:
                cut = np.rint(outline.points[i] + at / lengths[i] * onward[i] / outline.step).astype(int)
                if (place := tuple(cut.tolist())) not in taken:
                    rows.append((ring, place, -1, is_thin))
                    taken.add(place)
    rings, points, at, thin = (np.array(column) for column in zip(*rows, strict=True))
    first = np.searchsorted(rings, np.arange(len(outline.first)))
    outline = replace(outline, points=points, first=first)
    return replace(outline, thin=np.union1d(np.flatnonzero(thin), thin_walls(outline, free_space, width))), at


def _thin_spans(outline: Outline, free_space: Any, width: float) -> dict[int, list[tuple[float, float]]]:
    """Return, by index of a wall, the intervals to mark as thin, as distances from the start of the wall."""
    reach, following, start = RECEDING * width, outline.following_past_contacts, outline.positions
    onward, moved = start[following] - start, outline.moved_walls(reach, moves_all=True).reshape(-1, 2, 2)
    lengths = np.linalg.norm(onward, axis=1)
    is_turned = (np.diff(moved, axis=1)[:, 0] * onward).sum(axis=1) <= 0
    is_needle = np.linalg.norm(moved[:, 0] - start, axis=1) > _NEEDLE * reach
    thin = np.flatnonzero(is_turned | is_needle | is_needle[following])
    thin = np.union1d(thin, thin_walls(outline, free_space, width)).tolist()
    # 1. Find the parts of moved walls near free space. Sharp tips are thin up to where they move.
    near_free: Any = shapely.buffer(free_space, 2 * MARGIN * width) if thin else None
    spans: dict[int, list[tuple[float, float]]] = {}
    for wall in thin:
        along, length = onward[wall] / max(lengths[wall], 1e-300), float(lengths[wall])
        lo, hi = (moved[wall] - start[wall]) @ along
        near: Any = shapely.get_parts(shapely.intersection(near_free, shapely.LineString(moved[wall])))
        parts = [(shapely.get_coordinates(part) - start[wall]) @ along for part in near if part]
        parts += [np.array([at]) for at, i in ((lo, wall), (hi, following[wall])) if is_needle[i]]
        if is_turned[wall]:
            parts = [np.array([lo, hi, 0.0, length])]
        ends = [(part.min() - 2 * reach, part.max() + 2 * reach) for part in parts]
        spans[wall] = _merged([(a if a > lo else 0.0, b if b < hi else length) for a, b in ends], length, reach)
    # 2. Let thick walls beside thin ones begin with a thin part, so that the rest of them moves back as a whole.
    pending, before = [wall for wall in spans if spans[wall]], np.argsort(following)
    while pending:
        wall = pending.pop()
        beside = [(int(before[wall]), True)] if spans[wall][0][0] <= 0 else []
        beside += [(int(following[wall]), False)] if spans[wall][-1][1] >= lengths[wall] else []
        for other, at_end in beside:
            old_spans, length = spans.get(other, []), float(lengths[other])
            added = (length - 2 * reach, length) if at_end else (0.0, 2 * reach)
            spans[other] = _merged([*old_spans, added], length, reach)
            if spans[other] != old_spans:
                pending.append(other)
    return spans


def _merged(spans: list[tuple[float, float]], length: float, reach: float) -> list[tuple[float, float]]:
    """Close gaps of at most ``2 * reach`` between intervals of a wall, and between them and the wall's ends."""
    merged, at = [], 0.0
    for a, b in sorted(spans):
        if a - at > 2 * reach:
            merged.append((a, b))
        else:
            merged[-1:] = [(merged[-1][0] if merged else 0.0, max(at, b))]
        at = merged[-1][1]
    return [*merged[:-1], (merged[-1][0], length if length - at <= 2 * reach else at)] if merged else []
