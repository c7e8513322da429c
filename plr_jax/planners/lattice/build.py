"""The configurations that robots visit: a lattice of cells, and the primitives that lead from cell to cell.

Every cell that holds a free configuration has one representative: its center where that is free, else the free
sample that lies farthest from obstacles, so that a passage narrower than a cell is still found. Headings are
periodic. Robots of one kind share a table of the motions between representatives. For each of them, its own start and
goal represent their cells, which makes the ends of every path exact: they are nodes of the table beside the others.
"""

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._problem import Problem, straight_costs
from plr_jax.collision.walls import MotionTest, motion_test
from plr_jax.geometry.workspace import Workspace
from plr_jax.planners.lattice.motions import End, Lattice, MotionTable
from plr_jax.robots.motion import shorter_turn
from plr_jax.robots.robot import Robot

Primitive: TypeAlias = tuple[int, int, int]
"""A motion to another cell: so many columns, rows and turns away."""

PRIMITIVES: tuple[Primitive, ...] = (
    *((dx, dy, 0) for dx, dy in product((-1, 0, 1), repeat=2) if dx or dy),
    (0, 0, 1),
    (0, 0, -1),
)
"""To the eight neighbors, and a turn either way for robots that turn."""

_SAMPLES = 7  # along an axis of a cell whose center is blocked
_WIDEST_TURN = np.pi / 4
_ROUNDING = 1e-9
_CHUNK = 1 << 12  # cells at a time, between two looks at the clock


class Grid(NamedTuple):
    """Equal cells over a robot's configuration space."""

    lo: Float[np.ndarray, "dof"]
    shape: tuple[int, ...]
    side: Float[np.ndarray, "dof"]

    def cells_of(self, q: Float[np.ndarray, "n dof"]) -> Int[np.ndarray, "n"]:
        """The cells of configurations, the nearest ones outside."""
        index, size = np.floor((q - self.lo) / self.side).astype(np.intp), np.array(self.shape)
        index[:, 2:] %= size[2:]
        return np.asarray(np.ravel_multi_index(tuple(np.clip(index, 0, size - 1).T), self.shape))

    def centers(self) -> Float[np.ndarray, "cells dof"]:
        """Centers of all cells."""
        axes = [lo + (np.arange(n) + 0.5) * side for lo, n, side in zip(*self, strict=True)]
        return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)

    def neighbors(
        self, cells: Int[np.ndarray, "n"], offsets: Int[np.ndarray, "primitives dof"]
    ) -> tuple[Int[np.ndarray, "n primitives"], Bool[np.ndarray, "n primitives"]]:
        """The cells some offsets away, and whether they exist."""
        target = np.stack(np.unravel_index(cells, self.shape), axis=1)[:, None] + offsets
        target[..., 2:] %= np.array(self.shape)[2:]
        exists = ((target >= 0) & (target < self.shape)).all(axis=2)
        cell = np.ravel_multi_index(tuple(np.moveaxis(target, 2, 0)), self.shape, mode="clip")
        return np.asarray(cell), np.asarray(exists)


class Motions(NamedTuple):
    """Representatives of a grid's cells, and the motions between them."""

    grid: Grid
    offsets: Int[np.ndarray, "primitives dof"]
    test: MotionTest
    rotation_weight: float
    q: Float[np.ndarray, "cells dof"]
    free: Bool[np.ndarray, "cells"]
    child: Int[np.ndarray, "cells primitives"]
    cost: Float[np.ndarray, "cells primitives"]

    def with_ends(
        self, starts: Float[np.ndarray, "robots dof"], goals: Float[np.ndarray, "robots dof"]
    ) -> list[Lattice]:
        """The lattices of robots of this kind."""
        ends = np.concatenate([starts, goals])
        motions, cells = self._with_representatives(ends), self.grid.cells_of(ends)
        index, num_cells = np.cumsum(motions.free) - 1, int(motions.free.sum())
        nodes = num_cells + np.arange(len(ends))
        child = np.where(np.isfinite(motions.cost), index[motions.child], index[:, None])[motions.free]
        away, leaving = motions._motions_from(ends)
        away = np.where(np.isfinite(leaving), index[away], nodes[:, None])
        leaving[:, 0] = 0.0
        table = MotionTable(
            np.concatenate([motions.q[motions.free], ends]),
            np.concatenate([child, away], dtype=np.int32),
            np.concatenate([motions.cost[motions.free], leaving]),
            num_cells,
        )
        others = np.concatenate([goals, starts])
        entry = np.stack([motions._motions_to(ends), motions._motions_between(others, ends)], axis=1)
        # A goal that is the start, but for whole turns, is the same node.
        nodes[: len(starts)][straight_costs(starts, goals, 1.0) == 0] += len(starts)
        both = [End(*end) for end in zip(nodes.tolist(), index[cells].tolist(), entry, strict=True)]
        return [Lattice(table, pair) for pair in zip(both[: len(starts)], both[len(starts) :], strict=True)]

    def _with_representatives(self, q: Float[np.ndarray, "n dof"]) -> "Motions":
        """The motions with one of some configurations for each of their cells that has no representative."""
        cells, first = np.unique(self.grid.cells_of(q), return_index=True)
        missing = ~self.free[cells]
        if not missing.any():
            return self
        motions = self._replace(**{name: getattr(self, name).copy() for name in ("q", "free", "child", "cost")})
        motions.q[cells[missing]], motions.free[cells[missing]] = q[first[missing]], True
        # The opposite of an offset may be no primitive: test all motions that begin or end in these cells.
        offsets = np.concatenate([self.offsets, -self.offsets])
        around, exists = self.grid.neighbors(cells[missing], offsets)
        motions.connect(np.unique(around[exists]))
        return motions

    def _motions_from(
        self, q: Float[np.ndarray, "n dof"]
    ) -> tuple[Int[np.ndarray, "n primitives"], Float[np.ndarray, "n primitives"]]:
        """The cells that primitives lead to from configurations, and the costs, ``inf`` where they are not free."""
        cells, exists = self.grid.neighbors(self.grid.cells_of(q), self.offsets)
        row, primitive = np.nonzero(exists & self.free[cells])
        cost = np.full(cells.shape, np.inf)
        cost[row, primitive] = self._motion_costs(q[row], self.q[cells[row, primitive]])
        cost[:, 0] = np.inf
        return cells, cost

    def _motions_to(self, q: Float[np.ndarray, "n dof"]) -> Float[np.ndarray, "n primitives"]:
        """Costs of the motions to configurations by the primitives that lead from representatives to their cells."""
        cells, exists = self.grid.neighbors(self.grid.cells_of(q), -self.offsets)
        row, primitive = np.nonzero(exists & self.free[cells])
        cost = np.full(cells.shape, np.inf)
        cost[row, primitive] = self._motion_costs(self.q[cells[row, primitive]], q[row])
        cost[:, 0] = np.inf
        return cost

    def _motions_between(
        self, begin: Float[np.ndarray, "n dof"], end: Float[np.ndarray, "n dof"]
    ) -> Float[np.ndarray, "n primitives"]:
        """Costs of the motions from configurations to others by each primitive that leads from cell to cell."""
        cells, exists = self.grid.neighbors(self.grid.cells_of(begin), self.offsets)
        row, primitive = np.nonzero(exists & (cells == self.grid.cells_of(end)[:, None]))
        cost = np.full(cells.shape, np.inf)
        cost[row, primitive] = self._motion_costs(begin[row], end[row])
        cost[:, 0] = np.inf
        return cost

    def _motion_costs(
        self, begin: Float[np.ndarray, "n dof"], end: Float[np.ndarray, "n dof"], deadline: float = math.inf
    ) -> Float[np.ndarray, "n"]:
        """Cost of straight motions, ``inf`` for those that are not free."""
        return np.where(self.test(begin, end, deadline), straight_costs(begin, end, self.rotation_weight), np.inf)

    def connect(self, cells: Int[np.ndarray, "n"], deadline: float = math.inf) -> None:
        """Test the motions that begin in some cells, in place; ``TimeoutError`` past the deadline."""
        child, exists = self.grid.neighbors(cells, self.offsets)
        exists &= self.free[cells, None] & self.free[child]
        exists[:, 0] = False
        cost = np.full(child.shape, np.inf)
        cost[exists] = self._motion_costs(self.q[cells[np.nonzero(exists)[0]]], self.q[child[exists]], deadline)
        cost[:, 0] = np.where(self.free[cells], 0.0, np.inf)
        self.child[cells], self.cost[cells] = child, cost


@dataclass(frozen=True)
class _Recipe:
    """What motions are built from, the key under which they are kept; when to give up makes no difference to them."""

    workspace: Workspace
    robot: Robot
    rotation_weight: float
    step: float
    primitives: tuple[Primitive, ...]
    deadline: float = field(compare=False)


def num_configurations(workspace: Workspace, robot: Robot, step: float) -> float:
    """About how many configurations the lattice of a robot has if all are free; ``inf`` past all bounds."""
    turns = 2 * math.pi * max(1 / _WIDEST_TURN, robot.circumscribed_radius / step) if robot.dof == 3 else 1
    return turns * math.prod(max(1.0, side / step) for side in workspace.bounds.width.tolist())


def build_lattices(
    problem: Problem, step: float, primitives: Sequence[Primitive], deadline: float = math.inf
) -> list[Lattice]:
    """The lattice of every robot.

    Robots of one kind share their motions, which are kept for the next problem in the same workspace. Cells are at
    most ``step`` wide; turning by one takes a robot's corners as far. Robots without a heading have no turns.

    Raises:
        TimeoutError: If the deadline, on the clock of ``time.perf_counter``, passes first.
    """
    primitives = tuple((int(x), int(y), int(turn)) for x, y, turn in primitives)
    kinds: dict[tuple[Robot, float], list[int]] = {}
    for i, robot in enumerate(problem.robots):
        kinds.setdefault((robot, float(problem.rotation_weights[i])), []).append(i)
    lattices: dict[int, Lattice] = {}
    for (robot, weight), alike in kinds.items():
        recipe = _Recipe(problem.workspace, robot, weight, step, primitives, deadline)
        starts, goals = (q[alike, : robot.dof] for q in (problem.starts, problem.goals))
        motions = _shared_motions(recipe)
        cells = motions.grid.cells_of(starts), motions.grid.cells_of(goals)
        split = (cells[0] == cells[1]) & (straight_costs(starts, goals, 1.0) > 0)
        for k in np.flatnonzero(split).tolist():
            grid = _split_between(motions.grid, np.stack([starts[k], goals[k]]))
            (lattices[alike[k]],) = _motions(recipe, grid).with_ends(starts[[k]], goals[[k]])
        shared = np.flatnonzero(~split)
        if len(shared):
            ours = motions.with_ends(starts[shared], goals[shared])
            lattices.update(zip(np.array(alike)[shared].tolist(), ours, strict=True))
    return [lattices[i] for i in range(len(problem.robots))]


@lru_cache(maxsize=8)
def _shared_motions(recipe: _Recipe) -> Motions:
    return _motions(recipe, _grid(recipe.workspace, recipe.robot, recipe.step))


def _motions(recipe: _Recipe, grid: Grid) -> Motions:
    dof, q, test = len(grid.shape), grid.centers(), motion_test(recipe.workspace, recipe.robot, recipe.deadline)
    offsets = np.array([(0, 0, 0), *(p for p in recipe.primitives if dof == 3 or p[2] == 0)])[:, :dof]
    child = np.empty((len(q), len(offsets)), dtype=np.intp)
    motions = Motions(
        grid, offsets, test, recipe.rotation_weight, q, np.empty(len(q), dtype=bool), child, np.empty(child.shape)
    )
    for cells in _chunks(grid, recipe.deadline):
        q[cells], motions.free[cells] = _representatives(test, grid, q[cells], recipe.deadline)
    for cells in _chunks(grid, recipe.deadline):
        motions.connect(np.arange(cells.start, cells.stop), recipe.deadline)
    return motions


def _grid(workspace: Workspace, robot: Robot, step: float) -> Grid:
    """Cells no larger than a step; headings are centered on the axes, along which hallways lie most often."""
    lo, width = workspace.bounds.lo, workspace.bounds.width
    shape = np.maximum(1, np.ceil(width / step - _ROUNDING)).astype(int)
    side = width / shape
    if robot.dof == 3:
        turn = min(step / robot.circumscribed_radius, _WIDEST_TURN)
        quarters = int(np.ceil(np.pi / 2 / turn - _ROUNDING))
        shape, side = np.append(shape, 4 * quarters), np.append(side, np.pi / 2 / quarters)
        lo = np.append(lo, -side[2] / 2)
    return Grid(lo, tuple(shape.tolist()), side)


def _split_between(grid: Grid, ends: Float[np.ndarray, "2 dof"]) -> Grid:
    """The grid shifted until a face lies between a start and a goal that share a cell."""
    difference = ends[1] - ends[0]
    difference[2:] = shorter_turn(ends[0, 2:], ends[1, 2:])
    axis = int(np.argmax(np.abs(difference) / grid.side))
    middle = ends[0, axis] + difference[axis] / 2
    lo, shape = grid.lo.copy(), list(grid.shape)
    lo[axis] = middle - np.ceil((middle - lo[axis]) / grid.side[axis]) * grid.side[axis]
    shape[axis] += axis < 2  # headings are periodic
    return Grid(lo, tuple(shape), grid.side)


def _chunks(grid: Grid, deadline: float) -> Iterator[slice]:
    """All cells, some at a time, whole positions together, until the deadline."""
    num_cells, per_position = math.prod(grid.shape), math.prod(grid.shape[2:])
    size = max(1, _CHUNK // per_position) * per_position
    for begin in range(0, num_cells, size):
        if time.perf_counter() > deadline:
            raise TimeoutError("The deadline passed before the lattice was built.")
        yield slice(begin, min(begin + size, num_cells))


def _representatives(
    test: MotionTest, grid: Grid, centers: Float[np.ndarray, "cells dof"], deadline: float
) -> tuple[Float[np.ndarray, "cells dof"], Bool[np.ndarray, "cells"]]:
    """A configuration of every cell, and whether it is free."""
    q = centers.copy()
    free = test(q, q, deadline)
    per_position = int(np.prod(grid.shape[2:]))
    clearance = np.repeat(test.workspace.clearance(q[::per_position, :2]), per_position)
    blocked = np.flatnonzero(~free & (clearance + np.hypot(*grid.side[:2]) / 2 >= test.robot.inscribed_radius))
    along = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    samples = np.repeat(q[blocked], _SAMPLES**2, axis=0)
    samples[:, :2] += np.tile(np.array(list(product(along, along))) * grid.side[:2], (len(blocked), 1))
    room, open_ = np.full(len(samples), -np.inf), test(samples, samples, deadline)
    room[open_] = test.workspace.clearance(samples[open_, :2])
    best = np.arange(len(blocked)) * _SAMPLES**2 + room.reshape(-1, _SAMPLES**2).argmax(axis=1)
    q[blocked], free[blocked] = samples[best], open_[best]
    return q, free
