"""Guide: compute distances inside `jit`, also on maps that are drawn there.

Choose by what is known before `jit` compiles:

- The map and the goal are fixed: build a `plr_jax.PLR` outside, and call it inside.
- The map is fixed and the goal is drawn inside: build `plr_jax.construct_pairs` outside. In `reset`, store
  `pairs.prepared(goal)`; in `step`, call `pairs(x, goals)`.
- The map is drawn inside: call `plr_jax.grid_distance` inside.

A PLR, a stack of PLRs and pairs are pytrees of arrays. A jitted function may close over them or take them as
arguments.

# A fixed map

```python
import jax
import jax.numpy as jnp
import plr_jax

problem = plr_jax.scenes.maze()
workspace, goal = problem.workspace, problem.goals[0]
plr = plr_jax.construct(plr_jax.VisibilityGraph(workspace, goal), workspace.bounds, leaf="cone", max_bytes=1024)

@jax.jit
def reward(x, next_x):
    return plr(x) - plr(next_x)  # how much closer the step leads

x = jnp.array(workspace.sample_free(100, seed=0), jnp.float32)
print(reward(x, x + 0.01).shape)
```

# A map that is an array

`plr_jax.grid_distance(free, goal)` returns a `plr_jax.GridDistance`. The map `free[row, column]` and the goal
`(x, y)` may be traced. Cell `[i, j]` covers `x` in `[j, j + 1]` and `y` in `[i, i + 1]`, and everything beyond the
grid is blocked.

```python
@jax.jit
def rewards(key):
    free = jax.random.bernoulli(key, 0.7, (11, 11)).at[1, 1].set(True)
    field = plr_jax.grid_distance(free, jnp.array([1.5, 1.5]))
    x = jnp.array([[8.5, 8.5], [3.2, 5.1]])
    return field(x), field.cells, jax.vmap(jax.grad(field))(x), field.is_complete

distance, cells, gradient, is_complete = jax.vmap(rewards)(jax.random.split(jax.random.key(0), 4))
print(distance.shape, cells.shape, gradient.shape)  # (4, 2) (4, 11, 11) (4, 2, 2)
```

Distances are `inf` in blocked cells and where no path leads, with a gradient of 0. The argument `moves` selects the
paths:

- `"any-angle"` (the default): all paths that stay out of blocked cells.
- `4`: steps between cells with a common side.
- `8`: also diagonal steps, if both cells beside the step are free.

Without a goal, the result is a `plr_jax.GridDistances`, the distance between any two points:

```python
free = jnp.ones((11, 11), bool).at[5, :8].set(False)  # a wall
between = plr_jax.grid_distance(free, None, moves=8)
print(between(jnp.array([1.5, 1.5]), jnp.array([[1.5, 1.5], [1.5, 9.5]])))
```

# What it costs

- Any-angle paths bend at corners of blocked cells. Time and memory grow with the square of `max_corners`, the number
  of corners for which there is room. By default there is room for all corners up to 17 x 17 cells, else for half as
  many as the cells have. If your maps have few corners, give a smaller number: mazes become several times faster. If
  a map has more corners than `max_corners`, its answers are NaN and `field.is_complete` is false.
- `grid_distance` computes the field once for each map and goal. Keep the field in the environment's state, from
  `reset` on; do not compute it in `step`.
- Environments that reset themselves inside `step`, under `vmap`, compute both branches of `lax.cond`. So they compute
  a field at every step. Draw a pool of maps with their fields before, and let a reset pick one.

Oracles such as `plr_jax.VisibilityGraph` run on the host, so they cannot be called inside `jit`.
Notebook 5 of the repository shapes rewards with `grid_distance`.
"""
