"""Guide: use distances as an admissible heuristic of your own search, such as A*.

A proven lower bound is an admissible heuristic if all steps of the search are segments of free space, each of which
costs at least its length. Three functions give lower bounds:

| goals | heuristic | bytes |
| --- | --- | --- |
| one | `plr.lower(x)` of a `plr_jax.PLR` with `certified="leaves"` | about 1 KB |
| a fixed list | `stack.lower(index, x)` of a `plr_jax.stack` of such PLRs | about 1 KB a goal |
| any point | `pairs.bounds(x, y)[0]` of a `plr_jax.PairPLR` | about 1 to 4 KB in all |

`certified="leaves"` proves bounds for each leaf. With `certified=True`, a file of 1 KB has room for one error of the
whole map only, so that a single leaf of large error spoils the bound everywhere.

For many goals, the bounds of a `PairPLR` are nearer to the distances than those of a stack, but take more time:
`plr_jax.guides.any_two_points` compares them.

Bounds of PLRs jump between leaves, so A* must reopen a node when it finds a shorter path to that node. Evaluate all
nodes in one batch: a call with a single point takes 0.4 to 6 ms, or 0.1 to 0.3 ms with `plr.numpy().bounds(x)`.

# On a grid

On a grid of 8 neighbors, the larger of the bound and the octile distance is a better heuristic than either:

```python
import numpy as np

import plr_jax

free = np.ones((32, 32), bool)  # free[row, column]; row 0 is the lowest y
free[16, :24] = False
cells = np.argwhere(free)[:, ::-1] + 0.5  # centers (x, y) of all free cells, (n, 2)
goal = cells[-1]
octile = np.abs(cells - goal).max(axis=1) + (np.sqrt(2) - 1) * np.abs(cells - goal).min(axis=1)
grid = plr_jax.Workspace.from_mask(free, tolerance=0)  # with other tolerances, walls move
lower, _ = plr_jax.construct_pairs(grid, max_bytes=1024).bounds(cells, goal)
heuristic = np.maximum(lower, octile)  # (n,)
assert (heuristic <= plr_jax.GridGraph(free, goal, connectivity=8)(cells) + 1e-9).all()  # exact costs of A*
```

# Other searches

- A search that may return a costlier path can use the distances `plr(x)`: they are nearer to the truth than lower
  bounds.
- `plr_jax.ompl_objective` makes a certified PLR the heuristic of OMPL's optimizing planners.
- Where costs vary, `plr_jax.solve_eikonal` gives lower bounds of the cost: see `plr_jax.guides.costs_and_volumes`.
- A team's heuristic is the sum over its robots: `plr_jax.sum_of_distances`, see `plr_jax.guides.teams`.
"""
