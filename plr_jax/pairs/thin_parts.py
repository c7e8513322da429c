r"""Thin parts of obstacles: up to about 5e-6 domain widths, so that 32-bit floats hardly tell both sides apart.

For tests of visibility, walls move ``RECEDING``, 4e-6 domain widths, back into their obstacles, so that rounding
hides no corner (:meth:`Outline.moved_walls`). A wall is called thin if its obstacle is so thin that the moved wall
would come near free space on the other side. A thin wall stays in place, and the corners at its ends move in front of
the wall instead. For this, walls are cut so that each is thin as a whole or not at all. A sharp tip of a thin
obstacle gets a corner on either side::

             free space
    ==a======================b==      a wall from a to b, with free space on its left
       \                    /
        lo----------------hi          the wall, moved back; its ends move along the mitres of its corners
    ============================      the other side of the obstacle: the wall is thin where lo-hi comes near it
             free space

Functions get the ``width`` of the domain, in workspace units.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool, Int

from plr_jax.pairs.portable import MARGIN, RECEDING
from plr_jax.pairs.stored import MITRE, Outline

FINEST = 2.0**-24  # finest lattice step, in domain widths: the resolution of 32-bit floats
_NEEDLE = 100  # distances that the tip of a thick obstacle may move back; queries may not resolve sharper tips
# An outline, and the index of the boundary vertex at each of its points, -1 for none.
VertexOutline = tuple[Outline, Int[np.ndarray, " _"]]
_Spans = list[tuple[float, float]]  # intervals of a wall, as distances from its start


def are_thin(outline: Outline, free_space: Any, width: float) -> Bool[np.ndarray, " walls"]:
    """Return whether each wall is thin: moved into its obstacle, a thin wall comes near free space."""
    walls: Any = shapely.linestrings(outline.moved_walls(RECEDING * width, moves_all=True).reshape(-1, 2, 2))
    return shapely.dwithin(free_space, walls, MARGIN * width)


def with_thin_parts(outline: Outline, vertex: Int[np.ndarray, " _"], free_space: Any, width: float) -> VertexOutline:
    """Cut walls that are thin only in part, and mark the thin walls of the outline.

    A wall is thin where moving it into its obstacle would bring it near free space on the other side. ``vertex`` is
    the index of the boundary vertex at each point of the outline. Return the new outline, and the vertex at each of
    its points, -1 at cuts. A sharp tip between thin walls gets two points with the same vertex.
    """
    if not any((spans := _thin_spans(outline, free_space, width)).values()):
        return outline, vertex
    # 1. Halve the lattice step while it stays at least the finest one: cuts and second points need close places.
    finer = 2 ** int(np.log2(max(1.0, outline.step / (FINEST * width))))
    outline = replace(outline, step=outline.step / finer, points=outline.points * finer)
    # 2. Find sharp tips. `ahead` is the mitre vector of each point, into free space. At a tip of angle t its length
    #    is 1 / sin(t / 2), but at most `MITRE`, which tips below 29 degrees reach.
    ahead = outline.moved_points(-1.0) - outline.positions
    is_sharp = outline.is_reflex & ~outline.is_shared & (np.linalg.norm(ahead, axis=1) > 0.99 * MITRE)
    previous = np.argsort(outline.following_past_contacts)  # the inverse permutation
    onward = outline.positions[outline.following] - outline.positions
    lengths = np.linalg.norm(onward, axis=1)
    thin_at_end = {wall for wall, own in spans.items() if own and own[-1][1] >= lengths[wall]}

    places = [tuple(place) for place in outline.points.tolist()]
    taken = set(places)

    def free_neighbor(place: tuple[int, int], x: float, y: float) -> tuple[int, int]:
        # Among the neighbors on the lattice that no point has taken, the one whose direction is closest to (x, y).
        steps = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (place[0] + i, place[1] + j) not in taken]
        i, j = max(steps, key=lambda step: (step[0] * x + step[1] * y) / np.hypot(*step), default=(0, 0))
        return place[0] + i, place[1] + j

    # 3. List the points of the new outline: ring, place, vertex, and whether the wall that begins there is thin.
    rows = []
    for i, ring in enumerate(np.repeat(np.arange(len(outline.first) - 1), np.diff(outline.first))):
        own = spans.get(i, [])
        is_thin = bool(own) and own[0][0] <= 0
        rows.append((ring, places[i], vertex[i], is_thin))
        # A sharp tip between thin walls gets a second point, a neighbor on the lattice: a query that rounding
        # puts on or across a thin wall sees the tip's corner on its own side. Seen along `ahead`, the ring
        # reaches the tip on its left and leaves it on its right, so the second point is on the right.
        if is_thin and is_sharp[i] and previous[i] in thin_at_end:
            rows.append((ring, free_neighbor(places[i], ahead[i][1], -ahead[i][0]), vertex[i], True))
            taken.add(rows[-1][1])
        # Cut the wall inside: at the start of a span, a thin wall begins, at its end a thick one.
        ends = [(end, k == 0) for span in own for k, end in enumerate(span) if 0 < end < lengths[i]]
        for distance, is_thin in ends:
            cut = np.rint(outline.points[i] + distance / lengths[i] * onward[i] / outline.step).astype(int)
            if (place := tuple(cut.tolist())) not in taken:
                rows.append((ring, place, -1, is_thin))
                taken.add(place)
    rings, points, vertex, is_thin = (np.array(column) for column in zip(*rows, strict=True))
    first = np.searchsorted(rings, np.arange(len(outline.first)))
    outline = replace(outline, points=points, first=first, is_thin=is_thin)
    return replace(outline, is_thin=is_thin | are_thin(outline, free_space, width)), vertex


def _thin_spans(outline: Outline, free_space: Any, width: float) -> dict[int, _Spans]:
    """Return a dictionary from the index of a wall to its thin parts, intervals of distance from the wall's start.

    A wall is thin where moving it ``RECEDING * width`` into its obstacle would bring it near free space on the other
    side; ``width`` is that of the domain. The intervals
    of a wall are ascending and disjoint. Walls without an entry are not thin.
    """
    reach = RECEDING * width
    following = outline.following_past_contacts
    start = outline.positions
    onward = start[following] - start
    lengths = np.linalg.norm(onward, axis=1)
    moved = outline.moved_walls(reach, moves_all=True).reshape(-1, 2, 2)
    # 1. Find walls that are thin in part. Moved back, these walls turn round, end at a needle (a tip that moves by
    #    more than `_NEEDLE * reach`), or come near free space.
    is_turned = (np.diff(moved, axis=1)[:, 0] * onward).sum(axis=1) <= 0
    is_needle = np.linalg.norm(moved[:, 0] - start, axis=1) > _NEEDLE * reach
    is_thin = is_turned | is_needle | is_needle[following] | are_thin(outline, free_space, width)
    thin = np.flatnonzero(is_thin).tolist()
    # 2. Find their thin parts, with `2 * reach` on either side.
    near_free: Any = shapely.buffer(free_space, 2 * MARGIN * width) if thin else None
    spans: dict[int, _Spans] = {}
    for wall in thin:
        length = float(lengths[wall])
        if is_turned[wall]:  # thin as a whole
            spans[wall] = [(0.0, length)]
            continue
        along = onward[wall] / max(lengths[wall], 1e-300)
        lo, hi = (moved[wall] - start[wall]) @ along
        # The moved wall is thin near free space. A needle is thin from its tip to where the tip moves.
        near: Any = shapely.get_parts(shapely.intersection(near_free, shapely.LineString(moved[wall])))
        parts = [(shapely.get_coordinates(part) - start[wall]) @ along for part in near if part]
        parts += [np.array([end]) for end, i in ((lo, wall), (hi, following[wall])) if is_needle[i]]
        ends = [(part.min() - 2 * reach, part.max() + 2 * reach) for part in parts]
        # The moved wall is the part from `lo` to `hi` of the wall. Parts that reach these ends reach the wall's ends.
        spans[wall] = _merged([(a if a > lo else 0.0, b if b < hi else length) for a, b in ends], length, reach)
    # 3. Let the neighbor of a wall that is thin up to their common point be thin for `2 * reach` from this point.
    #    Otherwise the point, which is not between two thin walls, would move back and tilt the thin wall. Now only
    #    the short part tilts. If it fills its wall, the next neighbor needs one, too. Spans only grow, so the loop
    #    ends.
    pending = [wall for wall in spans if spans[wall]]
    previous = np.argsort(following)
    while pending:
        wall = pending.pop()
        neighbors = [(int(previous[wall]), True)] if spans[wall][0][0] <= 0 else []
        neighbors += [(int(following[wall]), False)] if spans[wall][-1][1] >= lengths[wall] else []
        for neighbor, at_end in neighbors:
            old_spans, length = spans.get(neighbor, []), float(lengths[neighbor])
            added = (length - 2 * reach, length) if at_end else (0.0, 2 * reach)
            spans[neighbor] = _merged([*old_spans, added], length, reach)
            if spans[neighbor] != old_spans:
                pending.append(neighbor)
    return spans


def _merged(spans: _Spans, length: float, reach: float) -> _Spans:
    """Sort intervals of a wall of the given length, and close gaps of at most ``2 * reach``.

    Gaps are those between intervals, and from the first and last interval to the ends of the wall.
    """
    merged: _Spans = []
    end = 0.0  # of the last interval, at first the start of the wall
    for a, b in sorted(spans):
        if a - end <= 2 * reach:
            a, b = merged.pop()[0] if merged else 0.0, max(end, b)
        merged.append((a, b))
        end = b
    if merged and length - end <= 2 * reach:
        merged[-1] = (merged[-1][0], length)
    return merged
