"""Guide: keep a distance function up to date while obstacles of the map come and go.

After a change, make three calls: for the map, for the oracle, and for the PLR. The first two reuse what the change
does not affect. Each call returns a new object, and the old objects stay valid for the old map.

```python
import plr_jax

problem = plr_jax.scenes.maze()
workspace, goal = problem.workspace, problem.goals[0]
oracle = plr_jax.VisibilityGraph(workspace, goal)
plr = plr_jax.construct(oracle, workspace.bounds, leaf="cone", max_bytes=1024, certified=True)

door = [(0.71, 0.19), (0.80, 0.19), (0.80, 0.23), (0.71, 0.23)]  # makes the lowest passage narrower
closed = workspace.with_obstacles(add=[door])
oracle_closed = oracle.with_workspace(closed)
plr_closed = plr_jax.construct(oracle_closed, closed.bounds, leaf="cone", max_bytes=1024, certified=True)

x = closed.sample_free(1000, seed=0)
print(plr_jax.metrics.error_map(plr_closed, oracle_closed, x), "no error above", plr_closed.max_error)

opened = closed.with_obstacles(remove=[door])
oracle_opened = oracle_closed.with_workspace(opened)
```

# The map

`workspace.with_obstacles(add=..., remove=...)` of a `plr_jax.Workspace` takes obstacles in the forms that the
constructor takes. To remove an obstacle, give its index in `workspace.obstacles`, or the obstacle itself. All other
obstacles keep their index: an empty polygon replaces a removed obstacle. Points that another obstacle covers stay
blocked.

# The oracle

`oracle.with_workspace(workspace)` of a `plr_jax.VisibilityGraph` recomputes only the visibility that the change
affects. Its distances equal those of a new oracle, up to rounding. For another goal on an unchanged map, use
`oracle.with_goal(goal)`.

# The PLR

A PLR stores the distances of one map, so construct a new PLR with the oracle of the new map, by the same call as
before. To know whether the old PLR is still good enough, call `plr_jax.certify(plr, oracle)` with the new oracle. The
call proves the largest error of the PLR on the new map.

```python
print(plr_closed.max_error, plr_jax.certify(plr, oracle_closed).max_error)
```

# For other changes

- New distances were measured at some points, such as lengths of trips: train the values that a PLR
  stores: see `plr_jax.guides.gradients`.
- Goals change, the map does not: `plr_jax.construct_pairs` or `plr_jax.construct_many`, in
  `plr_jax.guides.any_two_points`.
- The map changes at every step, or inside `jit`: `plr_jax.grid_distance`, in `plr_jax.guides.inside_jit`.
- Robots of a team are under way when the map changes: `plr_jax.replan`, in `plr_jax.guides.teams`.
"""
