"""A team's PLRs behind OMPL's scalar callback: C++ asks Python for the estimate of one joint configuration a call.

The least that such a callback can do: Python hands the address of OMPL's state to one function that Numba has
compiled, which follows it to the coordinates, looks up each robot's plane, and sums up. Reading the coordinates
through OMPL's bindings would take longer than all of that. Numba is imported with this module.
"""

from typing import Any

import numpy as np
from jaxtyping import Float
from numba import njit
from numba.np.numpy_support import carray

from experiments.baselines.ompl_motions import pointer, word
from plr_jax import PLR

_HEADER, _FRAME = 4, 4


class ScalarTables:
    """A team's PLRs of two dimensions, each as a slot's leaf and a leaf's plane, for the kernels of this module.

    Args:
        plrs: One PLR a robot.
    """

    def __init__(self, plrs: list[PLR]):
        leaves, planes, frames = zip(*map(_tables, plrs), strict=True)
        self._kept = leaves, planes, np.array(frames)
        self._header = np.zeros((1 + len(plrs), _HEADER), np.int64)
        self._header[0] = len(plrs), self._kept[2].ctypes.data, 0, 0
        for row, leaf, plane in zip(self._header[1:], leaves, planes, strict=True):
            row[:] = leaf.ctypes.data, plane.ctypes.data, *leaf.shape

    @property
    def address(self) -> int:
        """Where the tables begin; they live as long as this object."""
        return self._header.ctypes.data


def _tables(plr: PLR) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Leaf of each slot of the finest grid, planes of the leaves, and the grid's place."""
    lo, hi = plr.leaf_boxes
    finest = (hi - lo).min(axis=0)
    leaf_of_slot = np.empty(np.rint(plr.domain.width / finest).astype(int), np.uint16)
    first, last = (np.rint((side - plr.domain.lo) / finest).astype(int) for side in (lo, hi))
    for leaf, ((x0, y0), (x1, y1)) in enumerate(zip(first, last, strict=True)):
        leaf_of_slot[x0:x1, y0:y1] = leaf
    planes = np.ascontiguousarray(np.column_stack([plr.intercept, plr.slope]))
    return leaf_of_slot, planes, [*plr.domain.lo, *(1 / finest)]


@njit
def sums(q, address: int):
    """The Numba loop: sum of the robots' distances in each joint configuration ``(n, robots, 2)``."""
    total = np.empty(len(q))
    for k in range(len(q)):
        total[k] = _sum(q[k], address)
    return total


@njit
def sum_at_state(state: int, address: int):
    """The same for an OMPL state of a real vector space, given by the ``id`` of its Python object."""
    # The layout of nanobind's objects and OMPL's states is as in experiments.baselines.ompl_motions.
    offset, flags = carray(pointer(state + 16), (2,), np.int32)
    values = state + offset
    if not flags & 4:
        values = word(values)
    robots = word(address)
    return _sum(carray(pointer(word(values + 8)), (robots, 2), np.float64), address)


@njit
def _sum(q, address):
    robots = word(address)
    header = carray(pointer(address), (1 + robots, _HEADER), np.int64)
    frame = carray(pointer(header[0, 1]), (robots, _FRAME), np.float64)
    total = 0.0
    for i in range(robots):
        rows, columns = header[1 + i, 2], header[1 + i, 3]
        x, y = q[i, 0], q[i, 1]
        row = int((x - frame[i, 0]) * frame[i, 2])
        column = int((y - frame[i, 1]) * frame[i, 3])
        if not (0 <= row <= rows and 0 <= column <= columns):
            return np.inf
        slot = min(row, rows - 1) * columns + min(column, columns - 1)
        leaf = carray(pointer(header[1 + i, 0]), (rows * columns,), np.uint16)[slot]
        plane = carray(pointer(header[1 + i, 1] + 24 * leaf), (3,), np.float64)
        total += plane[0] + plane[1] * x + plane[2] * y
    return total


class Callback:
    """OMPL's cost of a path of states: one call of a Python method a motion, and nothing else.

    Args:
        q: The states' joint configurations.
        tables: What is looked up; None for a method that only returns, the floor under any callback.
    """

    def __init__(self, q: Float[np.ndarray, "n robots 2"], tables: ScalarTables | None):
        from ompl import base, geometric

        answer = base.Cost(0.0)

        class _Floor(base.OptimizationObjective):
            def motionCost(self, first: Any, last: Any) -> Any:
                return answer

        class _Looked(base.OptimizationObjective):
            def motionCost(self, first: Any, last: Any) -> Any:
                return base.Cost(sum_at_state(id(last), address))

        address = 0 if tables is None else tables.address
        space = base.RealVectorStateSpace(q[0].size)
        space.setBounds(float(q.min()), float(q.max()))
        information = base.SpaceInformation(space)
        information.setStateValidityChecker(lambda _: True)
        information.setup()
        self._path, state = geometric.PathGeometric(information), space.allocState()
        for configuration in q:
            space.copyFromReals(state, configuration.ravel().tolist())
            self._path.append(state)
        self._objective = (_Floor if tables is None else _Looked)(information)
        self._tables = tables  # whose address the objective has
        self.num_calls = len(q) - 1

    def __call__(self) -> float:
        """Sum of the estimates of all states but the first."""
        return self._path.cost(self._objective).value()
