import numpy as np

from plr_jax import Current, PlaneSpace, Workspace
from plr_jax.eikonal.mesh import cell_costs, coarse_mesh

SPACE = PlaneSpace(Workspace(((0, 0), (1, 1))))


def test_costs_are_between_their_bounds_whichever_way_motions_go():
    current = Current(lambda q: 0.4 * np.stack([q[:, 1], -q[:, 0]], axis=1), speed=1.0, lipschitz=0.4, fastest=0.6)
    mesh = coarse_mesh(SPACE, np.ones(2), 64, 64)
    costs = cell_costs(SPACE, current, mesh)
    rng = np.random.default_rng(0)
    cell = rng.integers(len(mesh.state), size=2000)
    lo, hi = (corner[cell] for corner in mesh.boxes)
    w = current.velocity_fn(lo + rng.random(lo.shape) * (hi - lo))
    angle = rng.uniform(0, 2 * np.pi, len(cell))
    v = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    a, along = 1 - np.sum(w * w, axis=1), np.sum(w * v, axis=1)
    time = (np.sqrt(along**2 + a) - along) / a
    assert (costs.least_rates[cell] <= time).all() and (time <= costs.most(v, cell) + 1e-12).all()
    midway = costs.midway.most(v, cell)
    assert (midway < costs.most(v, cell)).all() and abs(np.mean(midway / time) - 1) < 0.05
