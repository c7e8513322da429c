"""A table of sources, told by what has changed since another one.

are the steps of coordinates the same, else the new ones; sources in other steps are gone
of every other source before, is it gone
how many are new, and of each: is it on the lattice; and along each axis, is the coordinate one of another new
  source, then which, else is it in the domain, and the coordinate
of every source, has it another parent, and which; of a root likewise the offset
"""

import numpy as np
from jaxtyping import Int

from plr_jax.geometry.box import Box
from plr_jax.plr.file.range_coder import RARE, Coder
from plr_jax.plr.leaves.cone.codec import EXPONENT_BIAS, LARGEST_EXPONENT, STEP_BITS, StoredSources, origin_in_steps

_MOST_BITS, _FAR_BITS = 40, 62  # of a coordinate in the domain, and of any other

Row = tuple[int, ...]
"""A source: whether it is on the lattice, and its coordinates in steps."""


def coded_sources(
    coder: Coder, domain: Box, before: StoredSources, after: StoredSources | None
) -> tuple[StoredSources, Int[np.ndarray, "sources_before"]]:
    """Sources after a change, which are encoded if they are given, and else decoded.

    Returns:
        They, and the index there of each source before, -1 if it is gone.

    Raises:
        ValueError: Saying what is wrong with what is decoded.
    """
    exponent = _coded_unless(coder, "exponent", before.exponent, after and after.exponent)
    fraction = _coded_unless(coder, "fraction", before.fraction, after and after.fraction)
    if abs(exponent) > LARGEST_EXPONENT or fraction < 1:
        raise ValueError(f"it states coordinates in steps of 2**{exponent} and of 1 / {fraction}")
    is_in_steps = exponent == before.exponent, fraction == before.fraction
    rows, rows_after = _rows(before), [] if after is None else _rows(after)
    present = set(rows_after)
    kept = {
        row
        for row in rows
        if is_in_steps[row[0]] and not coder.bit("is gone", after and int(row not in present), RARE)
    }
    new, added = [row for row in rows_after if row not in kept], list[Row]()
    for each in range(coder.count("how many are new", after and len(new))):
        added.append(_coded_row(coder, domain, (2.0**-exponent, float(fraction)), added, new[each] if new else None))
    table = sorted({*kept, *added})
    if not table:
        raise ValueError("it states no sources")
    index = {row: place for place, row in enumerate(table)}
    place = np.array([index[row] if row in kept else -1 for row in rows])
    parent, offset = np.full(len(table), -1), np.zeros(len(table))
    stays = np.flatnonzero(place >= 0)
    parent[place[stays]], offset[place[stays]] = place[before.parent[stays]], before.root_offset[stays]
    for each in range(len(table)):
        parent[each] = _coded_parent(coder, int(parent[each]), after and int(after.parent[each]), len(table))
        is_root = parent[each] == each
        offset[each] = _coded_offset(coder, offset[each], after and after.root_offset[each]) if is_root else 0.0
    code = np.array(table)
    num_fine = int(np.count_nonzero(code[:, 0] == 0))
    return StoredSources(num_fine, exponent, fraction, code[:, 1:], parent, offset), place


def _rows(sources: StoredSources) -> list[Row]:
    is_on_lattice = np.arange(len(sources.code)) >= sources.num_fine
    return [tuple(row) for row in np.column_stack([is_on_lattice, sources.code]).tolist()]


def _coded_unless(coder: Coder, name: str, before: int, after: int | None) -> int:
    """A step's number, if it is not that of before."""
    if not coder.bit(name, None if after is None else int(after != before), RARE):
        return before
    return coder.number(None if after is None else after + EXPONENT_BIAS, STEP_BITS + 1) - EXPONENT_BIAS


def _coded_row(coder: Coder, domain: Box, steps: tuple[float, float], added: list[Row], row: Row | None) -> Row:
    """A new source, after others."""
    kind = coder.bit("is on the lattice", None if row is None else row[0])
    lowest, width, found = origin_in_steps(domain.lo * steps[kind]), domain.width * steps[kind], [kind]
    for axis, (origin, most) in enumerate(zip(lowest.tolist(), width.tolist(), strict=True)):
        value, others = None if row is None else row[1 + axis], list(dict.fromkeys(each[1 + axis] for each in added))
        if others and coder.bit(("is one of them", axis), None if value is None else int(value in others)):
            found.append(others[coder.symbol("which", None if value is None else others.index(value), len(others))])
            continue
        bits = min(int(most).bit_length(), _MOST_BITS)
        if coder.bit("is far", None if value is None else int((value - origin) >> bits != 0), RARE):
            origin, bits = -(1 << _FAR_BITS - 1), _FAR_BITS
        found.append(coder.number(None if value is None else value - origin, bits) + origin)
    return tuple(found)


def _coded_parent(coder: Coder, before: int, after: int | None, count: int) -> int:
    """A parent's number, if it is not that of before, which is -1 where that is gone."""
    if before >= 0 and not coder.bit("has another parent", None if after is None else int(after != before), RARE):
        return before
    if (parent := coder.number(after, (count - 1).bit_length())) >= count:
        raise ValueError(f"it names source {parent} of {count}")
    return parent


def _coded_offset(coder: Coder, before: float, after: float | None) -> float:
    """A root's offset, if it is not that of before."""
    if not coder.bit("has another offset", None if after is None else int(after != before), RARE):
        return before
    return coder.float32(after)
