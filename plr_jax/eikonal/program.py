"""A convex program for the largest lower bound of the cost-to-go in a finite-element space.

A function is a lower bound under three conditions:

- The function is at most 0 at the goals.
- The function is continuous across every face that is not proven blocked.
- Along every motion, the function rises by no more than the motion costs.

The alternating direction method of multipliers maximizes the function's integral; the multipliers are a flow along
cheapest paths. Finally, the values are rescaled so that they satisfy the conditions, rounding included. So the bound
is proven after any number of iterations.

:class:`CellCosts` bounds the costs of motions, and :class:`SlopeSets` derives the sets in which gradients must lie.
:class:`SlopeProgram` is the program, :class:`_Splitting` the method, and :class:`_Poisson` the linear system that
each step of the method solves.

References: Benamou and Carlier, "Augmented Lagrangian methods for transport optimization, mean field games and
degenerate elliptic equations", 2015. Eckstein and Bertsekas, 1992, for over-relaxation.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float
from scipy.sparse import csc_matrix, csr_array, csr_matrix, diags_array, vstack
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import cg, splu

from plr_jax.eikonal.elements import Curve, FunctionSpace, Numbers, function_space, rescaling_of, to_bernstein
from plr_jax.eikonal.goals import nearest_goals
from plr_jax.eikonal.mesh import CellIndex, Mesh, with_open_contacts
from plr_jax.spaces import CellState, ConfigurationSpace, CostMap, DirectionalCost, MotionCost
from plr_jax.spaces._costs import cost_bounds, pulled

Motions: TypeAlias = Float[np.ndarray, "n dim"]
Vectors: TypeAlias = Float[np.ndarray, "dim controls"]
PerControl: TypeAlias = Float[np.ndarray, " controls"]
Dofs: TypeAlias = Float[np.ndarray, " dofs"]
ROUNDING = 1e-9  # relative margin for rounding of values and slopes
_TINY = float(np.finfo(float).tiny)
# Number of parts of a cell along each axis in which the factor of costs is bounded, by the number of axes.
_PARTS = {1: 16, 2: 8, 3: 3, 4: 2}
# A linear bound of the factor may fall in a cell to this share of the constant bound, but no lower.
_LEAST_LINEAR_BOUND = 0.5


@dataclass(frozen=True, eq=False)
class CellCosts:
    """Bounds of the cost of motions in each cell of a mesh; upper bounds hold at all points that round into the cell.

    A motion by the vector ``dq`` costs from ``lower |dq| + p`` to ``upper |dq| + p``. Here ``|dq|`` is the norm of
    ``motion_cost``, and ``p`` is the larger scalar product of ``dq`` with one of two vectors, the ``pulls``. If
    ``pulls`` is None, ``p`` is 0, and two linear functions of the position in the cell bound the factor of ``|dq|``
    more tightly.
    """

    motion_cost: MotionCost
    cost_map: CostMap | None
    lower: Float[np.ndarray, " cells"]
    upper: Float[np.ndarray, " cells"]
    slope: Float[np.ndarray, "cells dim"]  # change of the linear bounds across each cell
    least: Float[np.ndarray, " cells"]  # the lower linear bound in the middle of the cell
    most: Float[np.ndarray, " cells"]  # the upper linear bound in the middle of the cell
    pulls: Float[np.ndarray, "2 cells dim"] | None = None  # if costs depend on the direction

    @property
    def midway(self) -> "CellCosts":
        """A copy whose upper bounds are the means of the lower and upper bounds: estimates of costs, not bounds."""
        # No cost is negative, so the factor is at least the longest pull.
        longest = 0.0 if self.pulls is None else np.linalg.norm(self.pulls, axis=2).max(axis=0)
        lower, least = np.maximum(self.lower, longest), np.maximum(self.least, longest)
        return replace(self, upper=(lower + self.upper) / 2, most=(least + self.most) / 2)

    @cached_property
    def least_rate(self) -> float:
        """A lower bound, at least 0, of the cost of any motion whose norm is 1, in any cell."""
        saved = 0.0 if self.pulls is None else np.linalg.norm(self.pulls, axis=2).min(axis=0)
        return float(np.maximum(self.lower - saved, 0.0).min())

    def of_motions(self, change: Motions, cell: CellIndex, middle: Motions | None = None) -> Numbers:
        """Return upper bounds of the costs of straight motions by the vectors ``change``, each within one cell.

        ``middle`` are the midpoints of the motions, in local coordinates of the cells (0 to 1). If given, they
        tighten the bounds.
        """
        factor = self.upper[cell]
        if middle is not None:
            factor = np.minimum(self.most[cell] + np.sum(self.slope[cell] * (middle - 0.5), axis=1), factor)
        pulls = None if self.pulls is None else self.pulls[:, cell]
        return self.motion_cost.norm(change) * factor + pulled(pulls, change)


def cell_costs(space: ConfigurationSpace, cost_map: CostMap | None, mesh: Mesh) -> CellCosts:
    """Bound the cost of motions in each cell of a mesh.

    Each cell has constant bounds and, unless costs depend on the direction, also linear bounds, which are tighter.
    """
    # Let x be a position relative to the cell's middle, from -1/2 to 1/2 along each axis, and x_j the middle of part
    # j of the cell, in which lower_j and upper_j bound the factor. Along each axis,
    #   slope = sum over j of x_j * (lower_j + upper_j) / 2 / sum over j of x_j**2,     the least-squares fit.
    # With `within` the largest value of slope . (x - x_j) in a part,
    #   least = min over j of lower_j - slope . x_j - within,     so least + slope . x is a lower bound in each part;
    #   most  = max over j of upper_j - slope . x_j + within,     so most + slope . x is an upper bound.
    motion_cost, num = space.motion_cost, len(mesh.state)
    # 1. Without a cost map the factor is 1. With pulls, constants bound it.
    if cost_map is None or isinstance(cost_map, DirectionalCost):
        lower, upper, pulls = cost_bounds(motion_cost, cost_map, *mesh.grown_boxes)
        return CellCosts(motion_cost, cost_map, lower, upper, np.zeros((num, mesh.dim)), lower, upper, pulls)
    # 2. Bounds of the factor in each part of each cell, a part per column; upper bounds in parts of the grown boxes.
    parts = _PARTS.get(mesh.dim, 1)
    place = np.array(list(product(range(parts), repeat=mesh.dim)))

    def bounds_of_parts(lo, hi):
        ends = (lo[:, None] + (hi - lo)[:, None] * (place + end) / parts for end in (0, 1))
        bounds = cost_bounds(motion_cost, cost_map, *(end.reshape(-1, mesh.dim) for end in ends))
        return (bound.reshape(num, -1) for bound in bounds[:2])

    lo, hi = mesh.grown_boxes
    lower, _ = bounds_of_parts(*mesh.boxes)
    _, upper = bounds_of_parts(lo, hi)
    # 3. The linear bounds. `half` is half the width of a part, and a bit more: grown boxes are a little larger.
    at = (place + 0.5) / parts - 0.5
    slope = (lower + upper) / 2 @ at / np.maximum(np.sum(at**2, axis=0), _TINY)
    half = (hi - lo) / (2 * parts) + (hi - lo - mesh.widths)
    within = np.sum(np.abs(slope) * half / mesh.widths, axis=1, keepdims=True)
    linear = slope @ at.T
    least, most = np.min(lower - linear - within, axis=1), np.max(upper - linear + within, axis=1)
    lower, upper = lower.min(axis=1), upper.max(axis=1)
    # 4. Where the factor jumps, its least and its largest value are better bounds: use them if the linear bounds are
    #    worse in the middle of the cell, or the lower one is far lower somewhere. Over a cell, a linear bound falls
    #    from its middle by at most half the sum of its slopes.
    is_flat = (least - np.abs(slope).sum(axis=1) / 2 < _LEAST_LINEAR_BOUND * lower) | (least < lower) | (most > upper)
    slope[is_flat] = 0.0
    least, most = np.where(is_flat, lower, least), np.where(is_flat, upper, most)
    return CellCosts(motion_cost, cost_map, lower, upper, slope, least, most)


class SlopeSets(NamedTuple):
    """Convex sets for the gradient of a lower bound of the cost-to-go: one set for each coefficient of the gradient.

    The gradient is in Bernstein form; each coefficient is a vector. A set is a ball if costs are lengths, and a
    product of balls if costs are sums of norms over groups of axes (``blocks``). If costs depend on the direction, a
    vector ``g`` is in the set if ``-g`` is within ``radius`` of the segment between both ``pulls``, which
    :class:`CellCosts` explains.
    """

    blocks: Sequence[Sequence[int]]
    radius: PerControl  # the lower bound of the cost of motions of norm 1, at each coefficient's control point
    pulls: Float[np.ndarray, "2 dim controls"] | None = None

    def lengths(self, g: Vectors) -> list[PerControl]:
        """Return, for each group of axes, the Euclidean norm of each vector (a column of ``g``) over these axes."""
        return [np.sqrt(np.sum(g[list(block)] ** 2, axis=0)) for block in self.blocks]

    def project(self, g: Vectors) -> Vectors:
        """Return, for each vector (a column of ``g``), the nearest point of its convex set."""
        # Shorten the part over each group of axes to the radius. With pulls, shorten the vector from the segment's
        # nearest point instead.
        center = self._nearest_center(g)
        g = g - center
        for block, length in zip(self.blocks, self.lengths(g), strict=True):
            g[list(block)] *= self.radius / np.maximum(length, self.radius)
        return g + center

    def _nearest_center(self, g: Vectors) -> Vectors | float:
        # The point nearest to g on the segment from -pulls[0] to -pulls[1]; 0 without pulls.
        if self.pulls is None:
            return 0.0
        first = -self.pulls[0]
        along = self.pulls[0] - self.pulls[1]
        t = np.sum((g - first) * along, axis=0) / np.maximum(np.sum(along**2, axis=0), _TINY)
        return first + np.clip(t, 0.0, 1.0) * along

    def factors(self, g: Vectors) -> PerControl:
        """Return, for each vector (a column of ``g``), a factor such that vector / factor lies in its convex set.

        A vector with a factor of at most 1 lies in the set itself. If ``pulls`` (see the class) is None, the factor
        is the least possible; otherwise, a factor above 1 may be larger than needed.
        """
        # Without pulls, the factor is the largest |g| / radius over groups of axes. With pulls, let d be the distance
        # of g to the segment, and r the radius of a ball around 0 within the set K: `radius` minus the distance of 0
        # to the segment. If d > radius, g is the sum of a point of K and a vector of length d - radius, which lies in
        # the multiple (d - radius) / r of K. So g lies in the multiple 1 + (d - radius) / r.
        length = np.max(self.lengths(g - self._nearest_center(g)), axis=0)
        if self.pulls is None:
            return length / self.radius
        inner = self.radius - np.linalg.norm(self._nearest_center(np.zeros_like(g)), axis=0)
        return 1 + (length - self.radius) / np.maximum(inner, _TINY)

    def costs(self, flow: Vectors) -> PerControl:
        """Return lower bounds of the costs of motions by the vectors ``-flow``.

        The bounds are the values of the support functions of the convex sets (see the class) at the vectors ``flow``.
        """
        # The support function is the maximum of flow . g over g in the set: of a ball, radius * |flow|; of a segment,
        # the larger value at its ends -pulls[0] and -pulls[1]; of a sum of sets, the sum of their support functions.
        of_ball = self.radius * np.sum(self.lengths(flow), axis=0)
        return of_ball if self.pulls is None else of_ball + np.max(-np.sum(self.pulls * flow, axis=1), axis=0)


# Least penalty, as a share of the median flow: flows converge sooner with a small one, values with a large one.
_LEAST_PENALTY = 0.2
_LEAST_PENALTY_AT_LAST = 100.0
_RELAXATION = 1.6  # of each step; without over-relaxation, 1
_LEAST_INFLOW = 0.1  # least flow into a goal, as a share of the mean, for the weight of the value there
_LOOK_EVERY = 10  # iterations between evaluations of the bound
_GAIN = 5e-4  # least relative rise of the bound that counts
_PATIENCE = 30  # iterations without such a rise after which the solver stops
_RESIDUAL = 1e-2  # share of the residual that conjugate gradients leave
_MOST_STEPS = 50  # most steps of conjugate gradients
# In three dimensions, matrices with an envelope (see `_envelope`) up to this limit are factored. Larger matrices have
# a multigrid preconditioner instead. The limit was measured on the turning bodies and arms of experiments/solve.py:
# below it, factors are faster; above it, factoring takes most of the time, as for an arm, whose axes are periodic.
_LARGEST_ENVELOPE = 80_000_000
_COARSEST_GRID = 100  # most unknowns of the coarsest grid of multigrid


class Iterate(NamedTuple):
    """An iterate of the solver: values of the lower bound, and multipliers, which are a flow along cheapest paths."""

    values: Dofs  # of the degrees of freedom
    flow: Vectors  # at the control points of gradients
    inflow: Float[np.ndarray, " goals"]  # flow into each goal


@dataclass(frozen=True, eq=False)
class SlopeProgram:
    """A convex program whose solution is the largest lower bound of the cost-to-go in a finite-element space."""

    space: FunctionSpace
    gradient: csr_array  # maps dofs to control vectors, axis by axis, in the coordinates of `sets`
    costs: CellCosts
    volume: PerControl  # the share of each control point in the volume of its cell
    weight: Dofs  # integrals of the basis functions
    goal: Dofs | csr_array  # maps dofs to the value at the goal; a matrix if there are several goals
    at: Float[np.ndarray, "goals dim"]  # the goals, fractions of the domain
    goal_cells: CellIndex

    @classmethod
    def on(cls, mesh: Mesh, space: ConfigurationSpace, cost_map: CostMap | None, goals: Motions) -> "SlopeProgram":
        """Set up the program on a mesh, with ``goals`` as fractions of the domain.

        Cells that hold goals are never blocked. Cells count as blocked if no chain of faces between unblocked cells
        joins them to a goal's cell.
        """
        # 1. The mesh, in which only cells that paths may join to a goal are open.
        homes = mesh.locate(goals)
        state = mesh.state.copy()
        state[homes[state[homes] == CellState.BLOCKED]] = CellState.MIXED  # goals are free to a tolerance
        mesh = with_open_contacts(mesh.with_state(state), space)
        mesh = mesh.with_state(np.where(mesh.connected_to(homes), mesh.state, np.int8(CellState.BLOCKED)))
        # 2. The matrices. Degree 2 errs far less a cell, but takes too long beyond two dimensions.
        functions = function_space(mesh, (2 if mesh.dim <= 2 else 1))
        gradient = csr_array(vstack(functions.gradients(space.motion_cost.scale)))
        num_controls = len(functions.lattice)
        volume = np.repeat(mesh.volumes[mesh.open_cells] / num_controls, num_controls)
        at_goals = functions.interpolation(homes, mesh.local(homes, goals))
        goal = at_goals.toarray()[0] if len(goals) == 1 else at_goals
        costs = cell_costs(space, cost_map, mesh)
        return cls(functions, gradient, costs, volume, functions.basis_integrals(), goal, goals, homes)

    def below_goals(self, u: Dofs) -> Dofs:
        """Add a constant to a function so that its largest value at a goal is 0.

        ``u`` and the result are the function's values at the degrees of freedom.
        """
        return u - np.max(self.goal @ u)

    @cached_property
    def sets(self) -> SlopeSets:
        cell = np.repeat(self.space.mesh.open_cells, len(self.space.lattice))
        pulls = None if self.costs.pulls is None else np.moveaxis(self.costs.pulls[:, cell], 2, 1)
        return SlopeSets([axes for axes, _ in self.costs.motion_cost.blocks], self._linear(self.costs.least), pulls)

    def _linear(self, middle: Float[np.ndarray, " cells"]) -> PerControl:
        # Linear bounds of the factor at the control points of open cells, from their values in the cells' middles.
        cell = self.space.mesh.open_cells
        return (middle[cell, None] + self.costs.slope[cell] @ (self.space.lattice - 0.5).T).ravel()

    def gradients(self, u: Dofs) -> Vectors:
        # Bernstein coefficients, with each axis divided by its weight in the cost of motions.
        return (self.gradient @ u).reshape(self.space.mesh.dim, -1)

    def mean_gradients(self, u: Dofs) -> Float[np.ndarray, "open dim"]:
        # The mean of a polynomial over a cell is the mean of its Bernstein coefficients.
        return self.gradients(u).reshape(self.space.mesh.dim, -1, len(self.space.lattice)).mean(axis=2).T

    def rescaling(self, u: Dofs) -> Curve:
        # See `rescaling_of`: it makes `u` a lower bound, rounding included. Bernstein coefficients enclose the values
        # of `u` in a cell, and the largest factor of its gradient's coefficients holds for the gradient.
        space, mesh = self.space, self.space.mesh
        nodal = (space.values @ u).reshape(len(mesh.state), -1)[mesh.open_cells]
        control = nodal @ to_bernstein(space.degree, mesh.dim).T
        factor = (1 + ROUNDING) * self.sets.factors(self.gradients(u)).reshape(control.shape).max(axis=1)
        return rescaling_of(control.min(axis=1), control.max(axis=1), factor)

    def losses(self, iterate: Iterate) -> Float[np.ndarray, "open"]:
        """Estimate the integral of cost-to-go minus lower bound, as a sum of a loss for each unblocked cell.

        A cell's loss is its volume times ``max(cost - rise, 0)``. Here, ``cost`` is the cost of the iterate's flow in
        the cell. ``rise`` is the rise of the lower bound along this flow; it is 0 if the cell is not proven free.
        """
        mesh, num_controls = self.space.mesh, len(self.space.lattice)
        flow = iterate.flow.reshape(self.space.mesh.dim, -1, num_controls).mean(axis=2).T
        doubt = self._linear(self.costs.most) / self.sets.radius  # upper over lower bound of the cost of a motion
        cost = (doubt * self.sets.costs(iterate.flow)).reshape(-1, num_controls).mean(axis=1)
        rise = np.sum(flow * self.mean_gradients(iterate.values), axis=1)
        rise[mesh.state[mesh.open_cells] == CellState.MIXED] = 0.0
        return mesh.volumes[mesh.open_cells] * np.maximum(cost - rise, 0.0)

    def losses_at_goals(self, iterate: Iterate) -> Float[np.ndarray, "open"]:
        # Losses of the goals' cells as if all flow there went straight to the goal; 0 for other cells.
        # Let e be the cost of the straight motion to the nearest goal minus the lower bound. Partial integration with
        # the flow f, whose sources are spread evenly and which enters the goals, gives
        #   integral of e = integral of f . grad e + sum over goals of inflow * e(goal).
        # Of both sums, take the terms of the goals' cells.
        # 1. e at the degrees of freedom.
        space, mesh, domain = self.space, self.space.mesh, self.space.mesh.domain
        nearest = nearest_goals(domain.at(self.at), domain, self.costs.motion_cost, domain.at(space.points))[1][:, 0]
        change = domain.difference(domain.width * self.at[nearest], domain.width * space.points)
        excess = self.costs.of_motions(change, self.goal_cells[nearest]) - self.below_goals(iterate.values)
        # 2. The terms of each cell.
        along_flow = self.volume * np.sum(iterate.flow * self.gradients(excess), axis=0)
        loss = np.zeros(len(mesh.state))
        loss[mesh.open_cells] = along_flow.reshape(-1, len(space.lattice)).sum(axis=1)
        np.add.at(loss, self.goal_cells, iterate.inflow * (self.goal @ excess))
        return np.where(np.isin(mesh.open_cells, self.goal_cells), loss[mesh.open_cells], 0.0)

    def solve(self, num_iterations: int, start: Iterate | None, factor_at: Sequence[int] = ()) -> Iterate:
        # Before the iterations in `factor_at`, penalties are fitted to the flow, and the matrix is factored again.
        # Without a start, the first iterate has no flow (see `_Splitting`).
        if start is None:
            flow = np.zeros((self.space.mesh.dim, len(self.volume)))
            start = Iterate(np.zeros(len(self.weight)), flow, np.full(len(self.at), self.weight.sum()))
        splitting = _Splitting(self, start, _LEAST_PENALTY)
        for iteration in range(num_iterations):
            if iteration in factor_at:
                splitting = _Splitting(self, splitting.iterate, _LEAST_PENALTY)
            splitting.step()
        return splitting.iterate

    def solve_thoroughly(self, start: Iterate, most_iterations: int) -> tuple[Iterate, bool]:
        """Iterate until the proven bound stops rising, or ``most_iterations`` times.

        Return the iterate with the best proven bound, and whether the bound stopped rising.
        """
        splitting = _Splitting(self, start, _LEAST_PENALTY_AT_LAST)
        best, highest, improved_at = start, 0.0, 0
        for iteration in range(most_iterations):
            splitting.step()
            if iteration % _LOOK_EVERY:
                continue
            u = self.below_goals(splitting.u)
            value = float(self.weight @ np.interp(u, *self.rescaling(u)))  # the integral of the proven bound
            if value > (1 + _GAIN) * highest:
                best, highest, improved_at = splitting.iterate, value, iteration
            elif iteration >= improved_at + _PATIENCE:
                return best, True
        return best, False


class _Splitting:
    """The alternating direction method of multipliers for a :class:`SlopeProgram`.

    The method maximizes the integral ``load . u`` over degrees of freedom ``u``. The gradients ``G u`` must lie in
    convex sets. The vectors ``z`` in these sets approach ``G u``, and ``y`` are scaled multipliers: the flow is
    ``penalty * y``. With the over-relaxation ``a``, a step is::

        u = argmin  sum(volume * penalty * |G u - z + y|**2) / 2 - load . u      (a Poisson equation)
        v = a * G u + (1 - a) * z + y
        z = the vectors of the sets that are nearest to v
        y = v - z

    With one goal, ``load . u`` is the integral of ``u - u(goal)``. With several goals, ``load . u`` is the integral
    of ``u``, and the values of ``u`` at goals must be at most 0. These values then have vectors ``z`` and ``y`` of
    their own, with the penalty ``stiffness``.
    """

    def __init__(self, program: SlopeProgram, start: Iterate, least_penalty: float):
        self._program = program
        radius, flow, inflow = program.sets.radius, start.flow, start.inflow
        self._load = program.weight - program.weight.sum() * program.goal if len(inflow) == 1 else program.weight
        # 1. The least cost across a goal's cell is to values at goals what the radius of a set is to slopes.
        lower = program.costs.lower[program.goal_cells]
        across = lower * program.costs.motion_cost.norm(program.space.mesh.widths[program.goal_cells])
        # 2. Without a flow, start from the flow of least squares, which has the right size in any units.
        if not flow.any():
            system = _Poisson(program, 1 / radius, inflow * lower / across**2)
            potential = system.solve(self._load, np.zeros_like(flow), 0 * inflow, np.zeros(len(self._load)))
            flow = program.gradients(potential) / radius
            inflow = inflow if len(inflow) == 1 else system.stiffness * (program.goal @ potential)
        # 3. Penalties of |flow| / radius make multipliers as long as gradients may be; where little flows, penalties
        #    are larger.
        norm = program.sets.costs(flow) / radius  # equals |flow| if there are no pulls
        positive = norm[norm > 0]
        self._penalty = np.maximum(norm, least_penalty * np.median(positive) if positive.size else 1.0) / radius
        stiffness = np.maximum(inflow, _LEAST_INFLOW * inflow.mean()) / across
        self._system = _Poisson(program, self._penalty, stiffness)
        # 4. The variables: u, and z and y for gradients and for values at goals.
        self.u = start.values
        self._y = start.flow / self._penalty
        self._z = program.sets.project(program.gradients(start.values))
        self._y_goals, self._z_goals = inflow / stiffness, np.minimum(program.goal @ self.u, 0.0)

    @property
    def iterate(self) -> Iterate:
        return Iterate(self.u, self._penalty * self._y, self._system.stiffness * self._y_goals)

    def step(self) -> None:
        self.u = self._system.solve(self._load, self._z - self._y, self._z_goals - self._y_goals, self.u)
        if len(self._y_goals) > 1:
            v = _RELAXATION * (self._program.goal @ self.u) + (1 - _RELAXATION) * self._z_goals + self._y_goals
            self._z_goals = np.minimum(v, 0.0)
            self._y_goals = v - self._z_goals
        v = _RELAXATION * self._program.gradients(self.u) + (1 - _RELAXATION) * self._z + self._y
        self._z = self._program.sets.project(v)
        self._y = v - self._z


class _Poisson:
    """The linear system (a Poisson equation) of each iteration of :class:`_Splitting`, with its factored matrix.

    Systems with large factors have a multigrid preconditioner instead.
    """

    def __init__(self, program: SlopeProgram, penalty: PerControl, stiffness: Float[np.ndarray, " goals"]):
        # Minimize sum(volume * penalty * |G u - field|**2) / 2 + sum(stiffness * (u at goals - at_goals)**2) / 2
        # - load . u, with G the gradient and V (`weights`) the diagonal matrix of volume * penalty:
        #   (G' V G + goal' stiffness goal) u = load + G' V field + goal' stiffness at_goals.
        # All flow enters a single goal, so there are no terms of goals. The solution is then unique up to a constant,
        # and the first unknown is fixed to 0.
        dim = program.space.mesh.dim
        weights = diags_array(np.tile(penalty * program.volume, dim))
        self.divergence = csr_array((weights @ program.gradient).T)
        matrix = self.divergence @ program.gradient
        self.stiffness = stiffness
        self._num_fixed = int(len(stiffness) == 1)
        if not self._num_fixed:
            self.from_goals = csr_array((diags_array(stiffness) @ program.goal).T)
            matrix = matrix + self.from_goals @ program.goal
        self.matrix = csr_matrix(matrix[self._num_fixed :, self._num_fixed :])
        # Factor the matrix if the domain has one or two axes, or three and a small or narrow free space, so that its
        # factors are small. Else prepare conjugate gradients, with multigrid as their preconditioner.
        self._factors: Any = None
        if dim <= 2 or (dim == 3 and _envelope(self.matrix) <= _LARGEST_ENVELOPE):
            options = {"SymmetricMode": True}
            self._factors = splu(csc_matrix(self.matrix), "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        else:
            from pyamg import smoothed_aggregation_solver  # its import takes 0.1 s, and few programs are so large

            multigrid = smoothed_aggregation_solver(self.matrix, max_coarse=_COARSEST_GRID, improve_candidates=None)
            self._multigrid = multigrid.aspreconditioner()

    def solve(self, load: Dofs, field: Vectors, at_goals: Float[np.ndarray, " goals"], guess: Dofs) -> Dofs:
        # `guess` is a solution to start from, for conjugate gradients.
        fixed = np.zeros(self._num_fixed)
        right = (load + self.divergence @ field.ravel())[self._num_fixed :]
        if not self._num_fixed:
            right = right + self.from_goals @ at_goals
        if self._factors is not None:
            return np.append(fixed, self._factors.solve(right))
        guess = (guess - guess[0])[1:] if self._num_fixed else guess
        # The guess is from the last step: a step reduces its residual, but need not solve exactly.
        norm = float(np.linalg.norm(right - self.matrix @ guess))
        u, _ = cg(self.matrix, right, guess, rtol=0.0, atol=_RESIDUAL * norm, maxiter=_MOST_STEPS, M=self._multigrid)
        return np.append(fixed, u)


def _envelope(matrix: csr_matrix) -> int:
    """Return the size of a symmetric matrix's envelope in the order of reverse Cuthill and McKee.

    The envelope is the sum over rows of the distance of the first entry to the diagonal: it grows with the number of
    unknowns and with the number of unknowns across the free space.
    """
    row = np.argsort(reverse_cuthill_mckee(matrix, symmetric_mode=True))
    first = np.minimum.reduceat(row[matrix.indices], matrix.indptr[:-1])
    return int((row - first).sum())
