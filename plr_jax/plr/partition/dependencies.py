"""Values that depend on others, which depend on others, without cycles."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

if TYPE_CHECKING:
    from scipy.sparse import csr_array

ZERO = 1e-9
"""Below which combinations of weights that are multiples of small powers of two are 0."""


def resolve(step: "csr_array", is_free: Float[np.ndarray, "n"]) -> "csr_array":
    """From what every dependent value is made of to what it is made of in the end: free values alone."""
    from scipy.sparse import csr_array, diags_array

    step = csr_array(step + diags_array(is_free))
    while step[:, np.flatnonzero(is_free == 0)].nnz:
        step = csr_array(step @ step)
        step.eliminate_zeros()
    return step


def eliminated(rows: "csr_array", level: Int[np.ndarray, "groups"], most: int) -> "csr_array":
    """A map of the groups under which all rows vanish: each row gives up the finest group in it."""
    from scipy.sparse import csr_array

    solved: dict[int, dict[int, float]] = {}  # a group, as a combination of groups that are none of the keys
    rows.data[np.abs(rows.data) <= ZERO] = 0
    rows.eliminate_zeros()
    work = 0
    for start, end in zip(rows.indptr[:-1], rows.indptr[1:], strict=True):
        row: dict[int, float] = {}
        for index, weight in zip(rows.indices[start:end].tolist(), rows.data[start:end].tolist(), strict=True):
            work += _add(row, weight, solved.get(index, {index: 1.0}))
        require_few(work, most)
        if not row:
            continue
        pivot = max(row, key=lambda index: (level[index], abs(row[index]), -index))
        scale = row.pop(pivot)
        solution = {index: -weight / scale for index, weight in row.items()}
        for other in solved.values():
            if pivot in other:
                work += _add(other, other.pop(pivot), solution)
        solved[pivot] = solution
    table = [(group, index, weight) for group, row in solved.items() for index, weight in row.items()]
    group, index, weight = np.array(table).reshape(-1, 3).T
    kept = np.setdiff1d(np.arange(len(level)), np.array(list(solved), np.int64))
    coordinates = np.concatenate([group, kept]).astype(int), np.concatenate([index, kept]).astype(int)
    return csr_array((np.concatenate([weight, np.ones(len(kept))]), coordinates), (len(level), len(level)))


def _add(row: dict[int, float], factor: float, other: dict[int, float]) -> int:
    """Add a multiple of another row; how many weights it has."""
    for index, weight in other.items():
        total = row.get(index, 0.0) + factor * weight
        if abs(total) > ZERO:
            row[index] = total
        else:
            row.pop(index, None)
    return len(other)


def require_few(number: int | float, most: int) -> None:
    """Raise ``ValueError`` if weights are more than are allowed."""
    if number > most:
        raise ValueError(
            f"its tied leaves hang on one another by {number:.3g} weights or more; {most} are allowed. Build it of "
            "fewer leaves or in fewer dimensions, or of planes, which are not tied"
        )
