"""The largest function below the cost-to-go: a convex program over a finite-element space.

A function that is 0 at the goal, continuous across every face that is not proven blocked, and nowhere steeper than a
step there costs, is nowhere above the cost of any path. Of a polynomial cell by cell, the slope is bounded by that of
its control vectors, so that the largest such function, by its integral, solves

    maximize  sum of w u   subject to  |gradient at each control point| <= cost of a step in the cell.

The multipliers are a flow: from everywhere to the goal, along the cheapest ways. The alternating direction method of
multipliers solves it, a Poisson equation an iteration, whose matrix is factored once in a while. What it ends with is
made to satisfy the constraints, rounding included, so that the bound is proven however far it went.

References:
    Benamou and Carlier, "Augmented Lagrangian methods for transport optimization, mean field games and degenerate
    elliptic equations", 2015. Eckstein and Bertsekas, 1992, for over-relaxation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from pyamg import smoothed_aggregation_solver
from scipy.sparse import csc_matrix, csr_array, csr_matrix, diags_array
from scipy.sparse.linalg import cg, splu

from plr_jax.eikonal.cell_costs import CellCosts
from plr_jax.eikonal.elements import FunctionSpace, to_bernstein

# Values bent down, level by level, so that slopes that are a little too steep are no longer.
#
# Wherever a function is steeper than allowed, by a factor ``s``, its values run over some interval. Bending all
# values by a function whose own slope is at most ``1 / s`` on that interval makes it right, and what is farther from
# the goal only moves down by what is lost. That is far less than dividing everything by the largest factor.


@dataclass(frozen=True, eq=False)
class Rescaling:
    """A piecewise linear function of values, 0 at 0, that rises by at most one unit a unit.

    Attributes:
        level: Where its pieces meet, ascending.
        value: What it is there.
    """

    level: Float[np.ndarray, "levels"]
    value: Float[np.ndarray, "levels"]

    def __call__(self, u: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """The values bent down."""
        return np.interp(u, self.level, self.value)


def rescaling_of(
    lowest: Float[np.ndarray, "cells"], highest: Float[np.ndarray, "cells"], factor: Float[np.ndarray, "cells"]
) -> Rescaling:
    """That which divides slopes by a factor, where it is above 1, in cells of given lowest and highest values."""
    order = np.argsort(factor, kind="stable")
    order = order[factor[order] > 1]
    level = np.unique(np.concatenate([lowest[order], highest[order], [lowest.min(), 0.0, highest.max()]]))
    steepest = np.ones(len(level) - 1)
    first, last = np.searchsorted(level, lowest), np.searchsorted(level, highest)
    for cell in order.tolist():  # the steepest last
        steepest[first[cell] : last[cell]] = factor[cell]
    value = np.append(0.0, np.cumsum(np.diff(level) / steepest))
    return Rescaling(level, value - np.interp(0.0, level, value))


# How steep a lower bound of the cost-to-go may be: convex sets of gradients, one a control point.
#
# Along a motion ``dq``, the cost-to-go falls by no more than the motion costs. So of a lower bound with gradient
# ``g``, ``-g`` has to be in the set whose support function is the cost: for a length, a ball; for length and weighted
# turn, a product of balls; where something pulls, a ball moved along a segment. Gradients are in coordinates in which
# a step of length 1 within any block of axes costs 1.


Vectors = Float[np.ndarray, "dim controls"]
ROUNDING = 1e-9  # share of values and of slopes, many times what their evaluation rounds
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True, eq=False)
class SlopeSets:
    """The sets.

    Attributes:
        blocks: Axes whose gradients are bounded together.
        radius: Of the balls, at each control point.
        pulls: Ends of the segment at each control point; None for none. There is one block then.
    """

    blocks: Sequence[Sequence[int]]
    radius: Float[np.ndarray, "controls"]
    pulls: Float[np.ndarray, "2 dim controls"] | None = None

    def project(self, g: Vectors) -> Vectors:
        """The nearest vectors in the sets."""
        offset, radius = self._nearest_offset(g), self.radius
        g, nearest = g - offset, np.empty_like(g)
        for block in self.blocks:
            axes = list(block)
            length = np.sqrt(np.sum(g[axes] ** 2, axis=0))
            nearest[axes] = g[axes] * (radius / np.maximum(length, radius))
        return nearest + offset

    def _nearest_offset(self, g: Vectors) -> Vectors | float:
        """The nearest points of the segments, of what gradients are the negative of."""
        if self.pulls is None:
            return 0.0
        first, along = -self.pulls[0], self.pulls[0] - self.pulls[1]
        t = np.sum((g - first) * along, axis=0) / np.maximum(np.sum(along**2, axis=0), _TINY)
        return first + np.clip(t, 0.0, 1.0) * along

    def factors(self, g: Vectors) -> Float[np.ndarray, "controls"]:
        """By what vectors have to be divided, at the most, to be in the sets; below 1 within."""
        g = g - self._nearest_offset(g)
        length = np.sqrt(np.max([np.sum(g[list(block)] ** 2, axis=0) for block in self.blocks], axis=0))
        if self.pulls is None:
            return length / self.radius
        inner = self.radius - np.linalg.norm(self._nearest_offset(np.zeros_like(g)), axis=0)  # of a ball about 0
        return 1 + (length - self.radius) / np.maximum(inner, _TINY)

    def costs(self, flow: Vectors) -> Float[np.ndarray, "controls"]:
        """What it costs to move along a flow toward the goal, which is against its vectors."""
        norm = np.sum([np.sqrt(np.sum(flow[list(block)] ** 2, axis=0)) for block in self.blocks], axis=0)
        if self.pulls is None:
            return self.radius * norm
        return self.radius * norm + np.max(-np.sum(self.pulls * flow, axis=1), axis=0)


_RELAXATION = 1.6
_LEAST_PENALTY, _LEAST_PENALTY_AT_LAST = 0.2, 100.0  # over the median flow: flows settle sooner, or values do
_LOOK_EVERY = 10  # iterations
_GAIN = 5e-4  # share by which values have to rise
_PATIENCE = 30  # iterations in which they do not, after which they have converged
_RESIDUAL = 1e-2  # share of that of the iteration before, which conjugate gradients leave
_MOST_STEPS = 50  # of conjugate gradients
_MOST_FACTORED = 100_000  # unknowns in space
_COARSEST_GRID = 100  # unknowns of multigrid's smallest equations

Flow = Float[np.ndarray, "dim controls"]


@dataclass(frozen=True, eq=False)
class SlopeProgram:
    """The program on one space.

    Attributes:
        space: The functions.
        gradient: Maps degrees of freedom to the control vectors, axis by axis, in the coordinates of the sets.
        costs: What motions cost in each cell.
        volume: Of each control point.
        weight: The integral of each degree of freedom's basis function.
        goal: The value at the goal, in terms of the degrees of freedom.
    """

    space: FunctionSpace
    gradient: csr_array
    costs: CellCosts
    volume: Float[np.ndarray, "controls"]
    weight: Float[np.ndarray, "dofs"]
    goal: Float[np.ndarray, "dofs"]

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.space.mesh.dim

    @cached_property
    def _cell(self) -> Int[np.ndarray, "controls"]:
        """The cell of each control point."""
        return np.repeat(self.space.mesh.open_cells, len(self.space.lattice))

    @cached_property
    def sets(self) -> SlopeSets:
        """How steep the functions may be at each control point."""
        blocks = [axes for axes, _ in self.costs.motion.blocks]
        pulls = None if self.costs.pulls is None else np.moveaxis(self.costs.pulls[:, self._cell], 2, 1)
        radius = self.costs.least_at(self.space.lattice, self.space.mesh.open_cells).ravel()
        return SlopeSets(blocks, radius, pulls)

    @cached_property
    def doubt(self) -> Float[np.ndarray, "controls"]:
        """Largest over least cost of a step in each control point's cell."""
        most = self.costs.most_at(self.space.lattice, self.space.mesh.open_cells).ravel()
        return most / self.sets.radius

    def slopes(self, u: Float[np.ndarray, "dofs"]) -> Float[np.ndarray, "controls"]:
        """By what slopes at the control points are too steep, below 1 where they are not."""
        return self.sets.factors(self.gradients(u))

    def gradients(self, u: Float[np.ndarray, "dofs"]) -> Vectors:
        """The control vectors, in the coordinates of the sets."""
        return (self.gradient @ u).reshape(self.dim, -1)

    def slopes_within(self, u: Float[np.ndarray, "dofs"]) -> Float[np.ndarray, "open dim"]:
        """Mean control vectors of open cells, as motions that climb the steepest."""
        return self.mean_gradients(u) / self.costs.motion.scale

    def mean_gradients(self, u: Float[np.ndarray, "dofs"]) -> Float[np.ndarray, "open dim"]:
        """Mean control vectors of open cells, in the coordinates of the sets."""
        return self.gradients(u).reshape(self.dim, -1, len(self.space.lattice)).mean(axis=2).T

    def at_goal(self, u: Float[np.ndarray, "dofs"]) -> float:
        """The value at the goal."""
        return float(self.goal @ u)

    def zero(self) -> "Iterate":
        """No flow, and 0 everywhere."""
        return Iterate(np.zeros(len(self.goal)), np.zeros((self.dim, len(self.volume))))

    def rescaling(self, u: Float[np.ndarray, "dofs"]) -> Rescaling:
        """That which makes values, 0 at the goal, satisfy the constraints, rounding included."""
        space, mesh = self.space, self.space.mesh
        nodal = (space.values @ u).reshape(len(mesh.state), -1)[mesh.open_cells]
        control = nodal @ to_bernstein(space.degree, mesh.dim).T
        factor = (1 + ROUNDING) * self.slopes(u).reshape(control.shape).max(axis=1)
        return rescaling_of(control.min(axis=1), control.max(axis=1), factor)

    def solve(self, num_iterations: int, start: "Iterate", factor_at: Sequence[int] = ()) -> "Iterate":
        """So many iterations from a start, enough to tell where the mesh is too coarse.

        Args:
            num_iterations: Iterations.
            start: Values and flow to begin with.
            factor_at: Iterations before which the penalties follow the flow, and the matrix is factored anew.
        """
        state = _Splitting(self, start, _LEAST_PENALTY)
        for iteration in range(num_iterations):
            if iteration in factor_at:
                state = _Splitting(self, state.iterate, _LEAST_PENALTY)
            state.step()
        return state.iterate

    def solve_thoroughly(self, start: "Iterate", most_iterations: int) -> tuple["Iterate", bool]:
        """The best values that satisfy the constraints, and whether they had stopped rising before the limit."""
        state, best, highest, found = _Splitting(self, start, _LEAST_PENALTY_AT_LAST), start, 0.0, 0
        for iteration in range(most_iterations):
            state.step()
            if iteration % _LOOK_EVERY:
                continue
            u = state.u - self.at_goal(state.u)
            value = float(self.weight @ self.rescaling(u)(u))
            if value > (1 + _GAIN) * highest:
                best, highest, found = state.iterate, value, iteration
            elif iteration >= found + _PATIENCE:
                return best, True
        return best, False


@dataclass(frozen=True, eq=False)
class Iterate:
    """Values of the degrees of freedom, and the flow at the control points."""

    values: Float[np.ndarray, "dofs"]
    flow: Flow


class _Splitting:
    """The alternating direction method of multipliers, with penalties that are as large as the flow it starts from.

    Values ``u`` solve a Poisson equation, ``z`` is the nearest to their gradients ``g`` within the sets, and
    ``penalty * y`` is the flow.
    """

    def __init__(self, program: SlopeProgram, start: Iterate, least_penalty: float):
        self._program, radius = program, program.sets.radius
        self._load = program.weight - program.weight.sum() * program.goal
        flow = start.flow
        if not flow.any():  # that of least squares, of the right size whatever the units
            potential = _Poisson(program, 1 / radius).solve(
                self._load, np.zeros_like(flow), np.zeros(len(self._load))
            )
            flow = program.gradients(potential) / radius
        norm = program.sets.costs(flow) / radius
        carried = norm[norm > 0]
        self._penalty = np.maximum(norm, least_penalty * np.median(carried) if carried.size else 1.0) / radius
        self._system = _Poisson(program, self._penalty)
        self.u, g, self._y = start.values, program.gradients(start.values), start.flow / self._penalty
        self._z = program.sets.project(g)

    @property
    def iterate(self) -> Iterate:
        return Iterate(self.u, self._penalty * self._y)

    def step(self) -> None:
        self.u = self._system.solve(self._load, self._z - self._y, self.u)
        g = self._program.gradients(self.u)
        v = _RELAXATION * g + (1 - _RELAXATION) * self._z + self._y
        self._z = self._program.sets.project(v)
        self._y = v - self._z


class _Poisson:
    """The equation of an iteration; one degree of freedom is held at 0.

    In few dimensions its matrix is factored. Beyond, where factors fill up, conjugate gradients with algebraic
    multigrid go on from a guess, until a share of its residual is left.
    """

    def __init__(self, program: SlopeProgram, penalty: Float[np.ndarray, "controls"]):
        weights = np.tile(penalty * program.volume, program.dim)
        self.divergence = csr_array((diags_array(weights) @ program.gradient).T)
        self.matrix = csr_matrix((self.divergence @ program.gradient)[1:, 1:])
        self._factors: Any = None
        if program.dim <= 2 or (program.dim == 3 and len(program.goal) <= _MOST_FACTORED):
            options = {"SymmetricMode": True}
            self._factors = splu(csc_matrix(self.matrix), "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        else:
            self._multigrid = smoothed_aggregation_solver(
                self.matrix, max_coarse=_COARSEST_GRID, improve_candidates=None
            ).aspreconditioner()

    def solve(
        self, load: Float[np.ndarray, "dofs"], field: Flow, guess: Float[np.ndarray, "dofs"]
    ) -> Float[np.ndarray, "dofs"]:
        right = (load + self.divergence @ field.ravel())[1:]
        if self._factors is not None:
            return np.append(0.0, self._factors.solve(right))
        guess = guess[1:] - guess[0]
        left = float(np.linalg.norm(right - self.matrix @ guess))
        u, _ = cg(self.matrix, right, guess, rtol=0.0, atol=_RESIDUAL * left, maxiter=_MOST_STEPS, M=self._multigrid)
        return np.append(0.0, u)
