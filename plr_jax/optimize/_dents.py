"""The way out of dents of a field: best-first search that fills them, cell by cell.

References:
    Barraquand and Latombe, "Robot motion planning: a distributed representation approach", 1991: local minima of a
    potential are filled until a configuration below them is found.
"""

import heapq
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from plr_jax.spaces import ConfigurationSpace

_MOST_EXPANSIONS = 1000
_CELL, _STEPS = 1 / 32, (1, 2, 4)  # side of cells as a share of the domain; steps in sides

Point = Float[np.ndarray, "dim"]
Chain = Float[np.ndarray, "k dim"]


class Dents:
    """The dents of a field that paths were stuck in so far.

    Args:
        values: The field, ``inf`` outside the domain.
        space: The configuration space.
        directions: Motions of cost 1.
    """

    def __init__(
        self, values: Callable[[Chain], Float[np.ndarray, "k"]], space: ConfigurationSpace, directions: Chain
    ):
        self.values, self.space = values, space
        scale = space.motion_cost.scale
        side = _CELL * float((scale * space.domain.width).max())
        self.counts = np.maximum(1, np.rint(scale * space.domain.width / side))
        self.steps = np.concatenate([side * share * directions for share in _STEPS])
        self.known: list[tuple[Point, Chain | None]] = []

    def way_out(self, x: Point, below: float) -> Chain | None:
        """Configurations that free motions lead to, one after the other, the last with a value below one.

        Those of a dent that is known and seen are used again. None where the search finds none.
        """
        for stuck, chain in self.known:
            if self.space.are_free(x[None], stuck[None])[0]:
                if chain is None:
                    return None
                if self.values(chain[-1:])[0] < below:
                    return np.concatenate([stuck[None], chain])
        chain = self._filled(x, below)
        self.known.append((x, chain))
        return chain

    def _filled(self, x: Point, below: float) -> Chain | None:
        """Best-first search by the field's values, one configuration a cell."""
        found, parent, frontier, claimed = [x], [-1], [(0.0, 0)], set(self._cells(x[None]))
        for _ in range(_MOST_EXPANSIONS):
            if not frontier:
                return None
            _, node = heapq.heappop(frontier)
            y, values = self._neighbors(found[node], claimed)
            for z, value in zip(y, values.tolist(), strict=True):
                found.append(z)
                parent.append(node)
                heapq.heappush(frontier, (value, len(found) - 1))
            if len(values) and values.min() < below:
                return self._chain(found, parent, len(found) - len(values) + int(np.argmin(values)))
        return None

    def _neighbors(self, x: Point, claimed: set[tuple[int, ...]]) -> tuple[Chain, Float[np.ndarray, "k"]]:
        """Configurations that steps lead to, the lowest in each cell that is not claimed, which they claim."""
        y = self.space.domain.wrapped(x + self.steps)
        values = self.values(y)
        order = np.argsort(values, kind="stable")
        order = order[np.isfinite(values[order])]
        is_new = np.array([cell not in claimed for cell in self._cells(y[order])], dtype=bool)
        order = order[is_new]
        order = order[self.space.are_free(np.broadcast_to(x, y[order].shape), y[order])]
        lowest = {}
        for i, cell in zip(order.tolist(), self._cells(y[order]), strict=True):
            lowest.setdefault(cell, i)
        claimed.update(lowest)
        which = np.array(list(lowest.values()), dtype=int)
        return y[which], values[which]

    def _cells(self, x: Chain) -> list[tuple[int, ...]]:
        """The cells of a uniform grid that hold configurations."""
        domain = self.space.domain
        return list(map(tuple, np.floor((x - domain.lo) / domain.width * self.counts).astype(int).tolist()))

    @staticmethod
    def _chain(found: list[Point], parent: list[int], node: int) -> Chain:
        """The configurations from the first one, without it, to another."""
        chain = []
        while node > 0:
            chain.append(found[node])
            node = parent[node]
        return np.stack(chain[::-1])
