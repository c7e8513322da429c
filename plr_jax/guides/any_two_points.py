"""Guide: find the distance between any two points, or from many points to many goals.

| what changes | use | answer |
| --- | --- | --- |
| both points, among polygons | `plr_jax.construct_pairs` | within 4e-7 of the map's width, except beside walls |
| both cells of a grid | `plr_jax.construct_grid_pairs` | exact length of a shortest grid path |
| both points, any metric | `plr_jax.construct_metric_pairs` | approximate |
| the point, to a fixed list of goals | `plr_jax.construct_pairs` | as above |
| the point, to a fixed list of goals, fastest | `plr_jax.construct_many`, `plr_jax.stack` | as exact as PLRs |
| the nearest of several goals | `plr_jax.NearestGoal` | as exact as its oracles |

# Among polygons

A `plr_jax.PairPLR` stores the map and, for every cell of a partition, the corners at which shortest paths may turn.
It is a pytree, and works under `jit`, `vmap` and `grad` in both points.

```python
import plr_jax

workspace = plr_jax.scenes.maze().workspace
pairs = plr_jax.construct_pairs(workspace, max_bytes=1024)
x, y = workspace.sample_free(1000, seed=0), workspace.sample_free(1000, seed=1)
distance = pairs(x, y)  # (n,); the batches are broadcast
lower, upper = pairs.bounds(x[:3], y[:3])  # proven

goals = pairs.prepared(y)  # goals that are queried many times; also inside jit
distance = pairs(x, goals)  # large batches take less time

plr = pairs.to(y[0])  # the distance to one goal, a PLR with cone leaves
graph = plr_jax.VisibilityGraph(workspace, y[0])  # exact distances
print(plr(x[:3]), graph(x[:3]))  # to y[0]
print(distance[:3], graph.between(x[:3], y[:3]))  # from each point of x to the point of y in the same row
```

`prepared` returns `plr_jax.pairs.PreparedGoals`. A larger budget makes queries faster, not more exact. The workspace
may have at most 8,192 reflex corners. Points closer to a wall than 4e-6 of the map's width may see past its end: see
`plr_jax.construct_pairs`. `plr_jax.save` and `plr_jax.load` take pairs, too. `pairs.numpy()` answers without JAX.

# On a grid

`plr_jax.GridPairs` gives path lengths between any two cells of a grid. Its file stores only the map.

```python
import numpy as np

free = np.ones((32, 32), bool)  # free[row, column]; row 0 is the lowest y
free[16, :24] = False
steps = plr_jax.construct_grid_pairs(free)  # or a GridGraph(free, connectivity=8)
print(steps((3.5, 3.5), (3.5, 28.5)), steps.bounds((3.5, 3.5), (3.5, 28.5)))

goals, positions = np.array([[3.5, 3.5], [28.5, 3.5]]), np.array([[3.5, 28.5], [9.5, 9.5]])
print(steps.window(goals, positions, radius=5).shape)  # (agents, 11, 11): steps to each agent's goal
to_dock = steps.to((3.5, 3.5))  # a plr_jax.pairs.DistanceToCell: one goal
graph = plr_jax.GridGraph(free, goal=(3.5, 3.5))  # the same distances, found by search on the host
assert (to_dock(positions) == graph(positions)).all()
```

# Another metric

`plr_jax.pairs.MetricPairs` is one PLR over pairs of points, in boxes of at most 3 dimensions. It needs only a
symmetric function of two batches of points, and suits smooth metrics: among obstacles, its errors are far larger than
those of `construct_pairs`.

```python
def great_circle(a, b):  # angle between two places on a sphere, each a latitude and a longitude
    half = np.sin((a - b) / 2) ** 2
    return 2 * np.arcsin(np.sqrt(half[:, 0] + np.cos(a[:, 0]) * np.cos(b[:, 0]) * half[:, 1]))

region = plr_jax.Box((0.5, -0.3), (1.1, 0.6))
metric = plr_jax.construct_metric_pairs(great_circle, region, leaf="continuous", max_leaves=500)
print(metric((0.6, -0.2), (1.0, 0.5)), great_circle(np.array([[0.6, -0.2]]), np.array([[1.0, 0.5]])))
```

# A list of goals

For many goals among polygons, one `PairPLR` is smaller, more exact, and built in less time than a PLR of each goal.
A stack of PLRs answers faster. For 50 goals in the floor plan, on 2 cores:

| | bytes | construction | mean error | lower bound / distance | 700,000 distances | 700,000 bounds |
| --- | --: | --: | --: | --: | --: | --: |
| `PairPLR`, prepared goals | 4,094 | 0.5 s | 4e-7 | 1.000 | 0.3 s | 3 s |
| 50 certified PLRs of 1 KB | 50,969 | 4.8 s | 0.007 | 0.951 | 0.002 s | 0.005 s |

Oracles made by `with_goal` share the corners of the map. `plr_jax.construct_many` builds their cones together, with
mostly smaller mean errors than those of `construct`. With `certified=True`, proven errors are mostly smaller instead.
`plr_jax.stack` combines PLRs into one function, a `plr_jax.plr.PLRStack`.

```python
first = plr_jax.VisibilityGraph(workspace, y[0])
oracles = [first, *(first.with_goal(goal) for goal in y[1:8])]
plrs = plr_jax.construct_many(oracles, workspace.bounds, leaf="cone", max_bytes=512)
stack = plr_jax.stack(plrs)
print(stack([0, 5, 7], x[:3]))  # the distance of x[0] to goal 0, of x[1] to goal 5, of x[2] to goal 7
nearest = stack(np.arange(8)[:, None], x).min(axis=0)  # (n,); this also works inside jit
```

A stack is fastest if all its PLRs have the same leaf model. If only the nearest goal counts, a single PLR of a
`plr_jax.NearestGoal` is enough: see `plr_jax.guides.distance_function`. All classes of pairs are in `plr_jax.pairs`.

# In C and JavaScript

The module of a `plr_jax.PairPLR` exports `distance(x, y)`, `waypoint(x, y)` and `bounds(x, y)`. In C, use
`pairs.to(goal)`, the distance to one goal. The header of a `plr_jax.GridPairs` defines
`int32_t grid_steps(uint32_t from, uint32_t to)`, which reads tables from a separate file: write the bytes
`header.table` to it.

```python
from pathlib import Path

Path("pairs.mjs").write_text(pairs.js_module())
Path("to_goal.h").write_text(pairs.to((0.06, 0.07)).c_header("to_goal"))

header = plr_jax.construct_grid_pairs(np.ones((8, 8), bool)).c_header("grid")
Path("grid.h").write_text(header.text)
Path("grid.tables").write_bytes(header.table)
```
"""
