"""Guide: turn a distance function into paths to the goal, or into directions.

| you have | use | result |
| --- | --- | --- |
| a field and the map | `plr_jax.descend` | paths that never cross a wall |
| a PLR of cones and the map | `plr_jax.trace` | paths read from the file that never cross a wall |
| a PLR of cones, no map | `plr_jax.trace` | paths read from the file; the first segment may cut a corner |
| a PLR of cones, one step at a time | `plr.waypoint(x)` | the point to go to next |
| a PLR, inside `jit` | `-jax.grad(plr)(x)` | a direction, which leads into walls at corners |
| an exact oracle | `oracle.shortest_path(x)` | the exact path from one point |

# Descend

`plr_jax.descend` takes any field: a PLR, an oracle, or your own function. In a `plr_jax.Workspace`, it reaches the
goal from every start from which a path exists, even if the field has large errors: it only decides which way to go.

```python
import jax
import numpy as np
import plr_jax

problem = plr_jax.scenes.maze()
workspace, goal = problem.workspace, problem.goals[0]
oracle = plr_jax.VisibilityGraph(workspace, goal)
field = plr_jax.construct(oracle, workspace.bounds, max_bytes=1024, leaf="continuous")

starts = workspace.sample_free(100, seed=0)
descent = plr_jax.descend(field, workspace, starts, goal)
print(descent.reached.mean(), descent.lengths[:3], oracle(starts[:3]))
print(descent.paths[0])  # (m, 2): the vertices, from the start to the goal
assert all(status is plr_jax.DescentStatus.REACHED for status in descent.status)
```

The result is a `plr_jax.Descent`; each `plr_jax.DescentStatus` says how one descent ended. In a configuration space,
or with a `cost_map`, `descend` takes finite steps instead, and can get stuck. With a cost map, each start takes a few
tenths of a second.

```python
space = plr_jax.PlaneSpace(workspace)
slow = plr_jax.spaces.LipschitzCost(lambda q: 1 + q[:, 0], lipschitz=1, least=1)
costs = plr_jax.solve_eikonal(space, goal, cost_map=slow, certified=False)
descent = plr_jax.descend(costs, space, starts[:2], goal, cost_map=slow)
print(descent.costs, costs(starts[:2]))
```

# Trace

A PLR of cones stores, for each corner, the next corner on the shortest path. So `plr_jax.trace` reads whole paths
from the file. Give `trace` the workspace, if you have it, so that no path cuts a corner. The result is a
`plr_jax.plr.Traces`, with a `plr_jax.TraceStatus` for each path.

```python
cones = plr_jax.construct(oracle, workspace.bounds, leaf="cone", max_bytes=1024, certified=True)
traces = plr_jax.trace(cones, starts, workspace)
assert traces.arrived.all()
print(traces.paths[0, : traces.counts[0]], traces.lengths[0])
print(plr_jax.trace(cones, starts))  # from the file alone
print(cones.waypoint(starts[:3]))  # also inside jit
```

# Routes of many agents to several exits

Paths lead to the nearest of several exits. If a small file holds no free path from a start, `traces.arrived` is false
there: use `descend` for such starts.

```python
nearest = plr_jax.NearestGoal([oracle, oracle.with_goal((0.9, 0.1))])
cones = plr_jax.construct(nearest, workspace.bounds, leaf="cone", max_bytes=1024)
traces = plr_jax.trace(cones, starts, workspace)
routes = [path[:count] for path, count in zip(traces.paths, traces.counts, strict=True)]
print(traces.arrived.mean(), cones.which(starts[:3]))
```

A workspace rounds vertices to a fine grid, and a file of cones rounds points by up to 2e-8 of the map's width. To
check routes with your own Shapely polygon, grow it by a little more than these errors, as below. Functions of
`plr_jax.plot` return Matplotlib's axes, on which you can draw routes.

```python
import shapely

area = shapely.box(0, 0, 1, 1) - shapely.union_all(workspace.obstacles)  # or your own polygon
assert all(area.buffer(1e-6).covers(shapely.LineString(route)) for route in routes)
ax = plr_jax.plot.plot_workspace(workspace, unit="m")
ax.plot(*routes[0].T)
```

For agents with a radius, build the field for the shrunk area `area.buffer(-radius, join_style="mitre")`. Agents may
push one another nearer to a wall, so test their routes in the full area: see `notebooks/6_pedestrians.ipynb`, with
JuPedSim, which refuses targets on walls.

# Gradient

The gradient of a PLR points away from the goal. It has length 1 in leaves that are cones, and about 1 in other
leaves. Shortest paths touch corners, so steps along the raw gradient may end in walls at corners. Use `descend`,
or build cones for `workspace.inflate(radius, outside=True)`. The inflated workspace has more corners, so raise
`max_bytes` until `max_error` is small. `oracle.directions(x)` returns exact directions.

```python
toward_goal = -jax.vmap(jax.grad(cones))(starts)
exact = oracle.directions(starts)
print(np.einsum("ij,ij->i", toward_goal, exact).min())  # the smallest cosine between the two directions
```
"""
