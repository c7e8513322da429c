"""Proven lower bounds of the cost-to-go: the slope program on meshes that are refined where the flow loses most."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array, vstack

from plr_jax.eikonal.costs import axis_scale
from plr_jax.eikonal.elements import function_space
from plr_jax.eikonal.mesh import Mesh, coarse_mesh
from plr_jax.eikonal.program import Iterate, SlopeProgram
from plr_jax.spaces import CellState, ConfigurationSpace

KM = 1.0
POW = 1.0
LEV = 1
_COARSEST = 1 / 16  # share of the cells that the first mesh has
_SHARE = 0.7  # of the loss, in cells that are refined
_GROWTH = 1.7, 2.0  # least and most, of the number of cells
_FIRST, _NEXT, _LAST = 150, 40, 150  # iterations on the first mesh, on those after it, and at the end
_INSET = 1e-9  # of a cell, by which points keep off its faces


@dataclass(frozen=True, eq=False)
class LowerBoundField:
    """A function that is nowhere above the cost-to-go."""

    program: SlopeProgram
    values: Float[np.ndarray, "dofs"]

    @property
    def mesh(self) -> Mesh:
        """The cells."""
        return self.program.space.mesh


def solve_lower(space: ConfigurationSpace, goal: Float[np.ndarray, "dim"], max_cells: int) -> LowerBoundField:
    """The largest function below the cost-to-go on a mesh of at most so many cells."""
    scale = axis_scale(space.motion_cost)
    mesh = coarse_mesh(space, scale, int(_COARSEST * max_cells))
    degree = 2 if mesh.dim <= 2 else 1
    program = slope_program(mesh, space, goal, degree)
    iterate = program.solve(_FIRST, program.zero(), (20, 40, 80))
    while True:
        which = _marked(program, iterate, max_cells)
        if not len(which):
            break
        msh = program.space.mesh
        mm = msh.refined(which, space)
        for _ in range(LEV - 1):
            # mixed cells within the marked
            par = msh.locate(mm.fractions(np.arange(len(mm.state)), np.full(msh.dim, 0.5)))
            mk = np.zeros(len(msh.state), bool)
            mk[which] = True
            again = np.flatnonzero(mk[par] & (mm.state == 2))
            again = again[: max(0, (max_cells - len(mm.state)) // 3)]
            mm = mm.refined(again, space)
        finer = slope_program(mm, space, goal, degree)
        print(
            len(finer.space.mesh.state),
            np.bincount(finer.space.mesh.state),
            losses(program, iterate).sum() / program.weight.sum(),
        )
        iterate = finer.solve(_NEXT, _prolonged(program, iterate, finer), (_NEXT // 2,))
        program = finer
    print(
        len(mesh.state),
        len(program.space.mesh.state),
        program.mean(iterate.values - program.at_goal(iterate.values)),
        program.slopes(iterate.values).max(),
    )
    iterate = program.solve(_LAST, iterate, (_LAST // 4,), at_last=True)
    return LowerBoundField(program, iterate.values - program.at_goal(iterate.values))


def slope_program(mesh: Mesh, space: ConfigurationSpace, goal: Float[np.ndarray, "dim"], degree: int) -> SlopeProgram:
    """The program on the part of a mesh that the goal is connected to."""
    at = (goal - mesh.domain.lo) / mesh.domain.width
    cell = mesh.locate(at[None])
    mesh = mesh.without(~mesh.connected_to(int(cell[0])))
    functions = function_space(mesh, degree)
    gradient = csr_array(vstack(functions.gradients(axis_scale(space.motion_cost))))
    num_controls = len(functions.lattice)
    volume = np.repeat(mesh.volumes[mesh.open_cells] / num_controls, num_controls)
    value_at_goal = functions.interpolation(cell, mesh.local(cell, at[None])).toarray()[0]
    blocks = [axes for axes, _ in space.motion_cost.blocks]
    return SlopeProgram(
        functions, gradient, blocks, np.ones(len(volume)), volume, functions.integrals(), value_at_goal
    )


def _marked(program: SlopeProgram, iterate: Iterate, max_cells: int) -> Int[np.ndarray, "some"]:
    """The cells that lose most, to be refined next."""
    mesh, loss = program.space.mesh, losses(program, iterate)
    num_cells, parts = len(mesh.state), 2**mesh.dim - 1
    order = np.argsort(-loss, kind="stable")
    enough = np.searchsorted(np.cumsum(loss[order]), _SHARE * loss.sum()) + 1
    least, most = (int((growth - 1) * num_cells / parts) for growth in _GROWTH)
    num = min(max(enough, least), most, (max_cells - num_cells) // parts, np.count_nonzero(loss))
    return mesh.open_cells[order[:num]]


def losses(program: SlopeProgram, iterate: Iterate) -> Float[np.ndarray, "open"]:
    """What the flow through each open cell costs, less what it gains in value, and all of it in a mixed cell.

    Their sum is about how far the integral of the function is below that of the cost-to-go.
    """
    mesh, num_controls = program.space.mesh, len(program.space.lattice)
    gradient = (program.gradient @ iterate.values).reshape(program.dim, -1, num_controls).mean(axis=2)
    flow = iterate.flow.reshape(program.dim, -1, num_controls).mean(axis=2)
    cost = program.flow_norm(flow) * program.cost[::num_controls]
    gain = np.where(mesh.state[mesh.open_cells] == CellState.MIXED, (1 - KM) * cost, np.sum(flow * gradient, axis=0))
    return mesh.volumes[mesh.open_cells] * np.maximum(cost - gain, 0.0) ** POW


def _prolonged(coarse: SlopeProgram, iterate: Iterate, fine: SlopeProgram) -> Iterate:
    """The same function and flow on a finer mesh."""
    space, mesh = fine.space, coarse.space.mesh
    size = len(space.lattice)
    inset = 0.5 + (space.lattice[space.node_of % size] - 0.5) * (1 - _INSET)
    x = space.mesh.fractions(space.node_of // size, inset)
    cell = mesh.locate(x)
    values = coarse.space.interpolation(cell, mesh.local(cell, x)) @ iterate.values
    parent = mesh.locate(space.mesh.fractions(space.mesh.open_cells, np.full(mesh.dim, 0.5)))
    place = np.full(len(mesh.state), 0)
    place[mesh.open_cells] = np.arange(len(mesh.open_cells))
    flow = iterate.flow.reshape(coarse.dim, -1, size).mean(axis=2)[:, place[parent]]
    return Iterate(values, np.repeat(flow, size, axis=1))
