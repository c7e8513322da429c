"""The configurations that robots visit: a lattice of cells, and the primitives that lead from cell to cell.

Every cell that holds a free configuration has one representative: its center where that is free, else the free
sample that lies farthest from obstacles, so that a passage narrower than a cell is still found. Headings are
periodic. Robots of one kind share a table of the motions between representatives. For each of them, its own start and
goal represent their cells, which makes the ends of every path exact: they are nodes of the table beside the others.
Where both lie in one cell, one more primitive leads from each to the other, and motions to the cell lead to the goal.
"""

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import require_time
from plr_jax._problem import Problem, straight_costs
from plr_jax.collision.walls import Indifferent, MotionTest, motion_test
from plr_jax.geometry.workspace import Workspace
from plr_jax.planners._options import PRIMITIVES as PRIMITIVES
from plr_jax.planners._options import Primitive
from plr_jax.planners.lattice.joint import Ends, Lattice, MotionTable
from plr_jax.robots.robot import Robot

_SAMPLES = 7  # along an axis of a cell whose center is blocked
_WIDEST_TURN = np.pi / 4
_ROUNDING = 1e-9
_MOST_KEPT = 1 << 18  # motions of a kind of robot that are kept for the next problem
_CHUNK = 1 << 12  # cells at a time, between two looks at the clock


Cells: TypeAlias = Int[np.ndarray, "n"]
Offsets: TypeAlias = Int[np.ndarray, "primitives dof"]
Children: TypeAlias = Int[np.ndarray, "n primitives"]
Flags: TypeAlias = Bool[np.ndarray, "n primitives"]
Configurations: TypeAlias = Float[np.ndarray, "n dof"]
Costs: TypeAlias = Float[np.ndarray, "n primitives"]
Entries: TypeAlias = tuple[Int[np.ndarray, "n 2 primitives"], Float[np.ndarray, "n 2 primitives"]]
EachWay: TypeAlias = Float[np.ndarray, "n #primitives dof"]


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

    def neighbors(self, cells: Cells, offsets: Offsets) -> tuple[Children, Flags]:
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

    def with_ends(self, starts: Configurations, goals: Configurations) -> list[Lattice]:
        """The lattices of robots of this kind."""
        ends, differ = np.concatenate([starts, goals]), straight_costs(starts, goals, 1.0) > 0
        motions, cells = self._with_representatives(ends), self.grid.cells_of(ends)
        if (differ & (cells[: len(starts)] == cells[len(starts) :])).any():
            # One more primitive: from a start to a goal in its cell, and back.
            motions = motions._replace(
                offsets=np.append(motions.offsets, np.zeros_like(motions.offsets[:1]), axis=0),
                child=np.append(motions.child, np.arange(len(motions.q))[:, None], axis=1),
                cost=np.append(motions.cost, np.full((len(motions.q), 1), np.inf), axis=1),
            )
        table = motions._table(ends)
        nodes = table.num_cells + np.arange(len(ends))
        # A goal that is the start, but for whole turns, is the same node.
        nodes[: len(starts)][~differ] += len(starts)
        columns = nodes, motions._nodes[cells], *motions._entries(ends, nodes)
        by_robot = (np.stack(np.split(column, 2), axis=1) for column in columns)
        return [Lattice(table, Ends(*of_robot)) for of_robot in zip(*by_robot, strict=True)]

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

    @property
    def _nodes(self) -> Int[np.ndarray, "cells"]:
        """The node of each cell's representative, where it has one."""
        return np.cumsum(self.free) - 1

    def _table(self, ends: Float[np.ndarray, "ends dof"]) -> MotionTable:
        """The motions that begin at representatives, then those at starts and goals."""
        nodes, num_cells = self._nodes, int(self.free.sum())
        child = np.where(np.isfinite(self.cost), nodes[self.child], nodes[:, None])[self.free]
        cells, leads = self._neighbors(self.grid.cells_of(ends), self.offsets)
        cost = self._costs(leads, ends[:, None], self.q[cells])
        away = np.where(np.isfinite(cost), nodes[cells], num_cells + np.arange(len(ends))[:, None])
        cost[:, 0] = 0.0
        q, cost = np.concatenate([self.q[self.free], ends]), np.concatenate([self.cost[self.free], cost])
        child, side = np.concatenate([child, away], dtype=np.int32), self.grid.side
        return MotionTable(q, child, cost, num_cells, side, self.offsets * side)

    def _entries(self, ends: Configurations, nodes: Cells) -> Entries:
        """Where motions to starts, then goals, begin, and what they cost, as in :class:`Ends`."""
        num_robots, cells = len(ends) // 2, self.grid.cells_of(ends)
        others, others_nodes, others_cells = (np.roll(column, num_robots, axis=0) for column in (ends, nodes, cells))
        same_cell = cells == others_cells
        by, enters = self._neighbors(cells, -self.offsets)
        crosses = enters & (by == others_cells[:, None])
        crosses[:, -1] |= same_cell & (nodes != others_nodes)
        cost = [self._costs(enters, self.q[by], ends[:, None]), self._costs(crosses, others[:, None], ends[:, None])]
        # Into the cell of both, motions lead to the goal, and to the start only where the way to the goal is blocked.
        to_goal = np.isfinite(cost[0][num_robots:])
        enters &= ~same_cell[:, None] | np.concatenate([~to_goal, to_goal])
        begin = np.where(enters, self._nodes[by], -1), np.where(crosses, others_nodes[:, None], -1)
        return np.stack(begin, axis=1), np.stack(cost, axis=1)

    def _neighbors(self, cells: Cells, offsets: Offsets) -> tuple[Children, Flags]:
        """The cells some offsets away, and whether they are others that have a representative."""
        target, exists = self.grid.neighbors(cells, offsets)
        return target, exists & self.free[target] & (target != cells[:, None])

    def _costs(self, possible: Flags, begin: EachWay, end: EachWay, deadline: float = math.inf) -> Costs:
        """Costs of straight motions, ``inf`` for those that are not possible or not free."""
        begin, end = (np.broadcast_to(q, (*possible.shape, q.shape[2]))[possible] for q in (begin, end))
        cost = np.full(possible.shape, np.inf)
        free = self.test(begin, end, deadline)
        cost[possible] = np.where(free, straight_costs(begin, end, self.rotation_weight), np.inf)
        return cost

    def represent(self, cells: slice, deadline: float) -> None:
        """Find a configuration of each of some cells, whole positions, and whether it is free, in place."""
        q, clearance_of = self.q[cells].copy(), self.test.workspace.clearance
        free = self.test(q, q, deadline)
        per_position = math.prod(self.grid.shape[2:])
        clearance = np.repeat(clearance_of(q[::per_position, :2]), per_position)
        reach = np.hypot(*self.grid.side[:2]) / 2
        blocked = np.flatnonzero(~free & (clearance + reach >= self.test.robot.inscribed_radius))
        along = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
        samples = np.repeat(q[blocked], _SAMPLES**2, axis=0)
        samples[:, :2] += np.tile(np.array(list(product(along, along))) * self.grid.side[:2], (len(blocked), 1))
        room, open_ = np.full(len(samples), -np.inf), self.test(samples, samples, deadline)
        room[open_] = clearance_of(samples[open_, :2])
        best = np.arange(len(blocked)) * _SAMPLES**2 + room.reshape(-1, _SAMPLES**2).argmax(axis=1)
        q[blocked], free[blocked] = samples[best], open_[best]
        self.q[cells], self.free[cells] = q, free

    def connect(self, cells: Int[np.ndarray, "n"], deadline: float = math.inf) -> None:
        """Test the motions that begin in some cells, in place; ``TimeoutError`` past the deadline."""
        child, leads = self._neighbors(cells, self.offsets)
        cost = self._costs(leads & self.free[cells, None], self.q[cells][:, None], self.q[child], deadline)
        cost[:, 0] = np.where(self.free[cells], 0.0, np.inf)
        self.child[cells], self.cost[cells] = child, cost


def num_configurations(workspace: Workspace, robot: Robot, step: float) -> float:
    """About how many configurations the lattice of a robot has if all are free; ``inf`` past all bounds."""
    turns = 2 * math.pi * max(1 / _WIDEST_TURN, robot.circumscribed_radius / step) if robot.dof == 3 else 1
    return turns * math.prod(max(1.0, side / step) for side in workspace.bounds.width.tolist())


def build_lattices(
    problem: Problem, step: float, primitives: Sequence[Primitive], deadline: float = math.inf
) -> list[Lattice]:
    """The lattice of every robot.

    Robots of one kind share their motions, which are kept for the next problem in the same workspace unless they are
    many. Cells are at most ``step`` wide; turning by one takes a robot's corners as far. Robots without a heading
    have no turns.

    Raises:
        TimeoutError: If the deadline, on the clock of ``time.perf_counter``, passes first.
    """
    kinds, lattices = list(zip(problem.robots, problem.rotation_weights.tolist(), strict=True)), {}
    for robot, weight in dict.fromkeys(kinds):
        alike = [i for i, kind in enumerate(kinds) if kind == (robot, weight)]
        starts, goals = (q[alike, : robot.dof] for q in (problem.starts, problem.goals))
        motions = motions_of(problem.workspace, robot, weight, step, primitives, deadline)
        lattices.update(zip(alike, motions.with_ends(starts, goals), strict=True))
    return [lattices[i] for i in range(len(problem.robots))]


def motions_of(
    workspace: Workspace,
    robot: Robot,
    weight: float,
    step: float,
    primitives: Sequence[Primitive],
    deadline: float = math.inf,
) -> Motions:
    """The motions of a kind of robot, as :func:`build_lattices` has them, without starts and goals."""
    primitives = tuple((int(x), int(y), int(turn)) for x, y, turn in primitives)
    is_small = num_configurations(workspace, robot, step) * (1 + len(primitives)) <= _MOST_KEPT
    return (_kept if is_small else _motions)(workspace, robot, weight, step, primitives, Indifferent(deadline))


def _motions(
    workspace: Workspace, robot: Robot, weight: float, step: float, primitives: tuple[Primitive, ...], deadline: float
) -> Motions:
    # Cells no larger than a step; headings are centered on the axes, along which hallways lie most often.
    lo, width = workspace.bounds.lo, workspace.bounds.width
    shape = np.maximum(1, np.ceil(width / step - _ROUNDING)).astype(int)
    side = width / shape
    if robot.dof == 3:
        turn = min(step / robot.circumscribed_radius, _WIDEST_TURN)
        quarters = int(np.ceil(np.pi / 2 / turn - _ROUNDING))
        shape, side = np.append(shape, 4 * quarters), np.append(side, np.pi / 2 / quarters)
        lo = np.append(lo, -side[2] / 2)
    grid = Grid(lo, tuple(shape.tolist()), side)
    test = motion_test(workspace, robot, deadline)
    dof, q = len(grid.shape), grid.centers()
    offsets = np.array([(0, 0, 0), *(p for p in primitives if dof == 3 or p[2] == 0)])[:, :dof]
    child = np.empty((len(q), len(offsets)), dtype=np.intp)
    motions = Motions(grid, offsets, test, weight, q, np.empty(len(q), dtype=bool), child, np.empty(child.shape))
    for cells in _chunks(grid, deadline):
        motions.represent(cells, deadline)
    for cells in _chunks(grid, deadline):
        motions.connect(np.arange(cells.start, cells.stop), deadline)
    return motions


_kept = lru_cache(maxsize=8)(_motions)


def _chunks(grid: Grid, deadline: float) -> Iterator[slice]:
    """All cells, some at a time, whole positions together, until the deadline."""
    num_cells, per_position = math.prod(grid.shape), math.prod(grid.shape[2:])
    size = max(1, _CHUNK // per_position) * per_position
    for begin in range(0, num_cells, size):
        require_time(deadline, "the lattice was built")
        yield slice(begin, min(begin + size, num_cells))
