"""Guide: compute distances inside `jit`, also on maps that are created inside `jit`.

Choose by what is known before `jit` compiles:

- The map and the goal are fixed: build a `plr_jax.PLR` beforehand, and call it inside `jit`.
- The map is fixed and the goal is chosen inside `jit`: build pairs with `plr_jax.construct_pairs` beforehand. In
  `reset` of a learning environment, store `goals = pairs.prepared(goal)`; in `step`, call `pairs(x, goals)`.
- The map is created inside `jit`: call `grid_distance`, or `polygon_distance` (see `plr_jax.guides.gradients`).

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
    return plr(x) - plr(next_x)  # the step reduces the distance by this much

x = jnp.array(workspace.sample_free(100, seed=0), jnp.float32)
print(reward(x, x + 0.01).shape)
```

# A map that is an array

`plr_jax.grid_distance(free, goal)` returns a `plr_jax.GridDistance`. The map `free[row, column]` and the goal
`(x, y)` may be traced. Cell `[i, j]` covers `x` in `[j, j + 1]` and `y` in `[i, i + 1]`, and everything beyond the
grid is blocked. The center of cell `[i, j]` is `(j + 0.5, i + 0.5)`: add 0.5 to integer cell positions, column first.

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

Distances are `inf`, with a gradient of 0, in blocked cells and where no path leads to the goal. If the goal is
blocked or outside the grid, distances are `inf` everywhere. A field that was made under `vmap` must be called under
`vmap`: `jax.vmap(lambda field, x: field(x))(fields, x)`. The argument `moves` selects the paths:

- `"any-angle"` (the default): all paths that stay out of blocked cells, and do not pass between two blocked cells
  that share only a corner.
- `4`: steps between cells with a common side.
- `8`: also diagonal steps, if both cells beside the step are free.

Without a goal, the result is a `plr_jax.traced.GridDistances`, the distance between any two points:

```python
free = jnp.ones((11, 11), bool).at[5, :8].set(False)  # a wall
between = plr_jax.grid_distance(free, None, moves=8)
print(between(jnp.array([1.5, 1.5]), jnp.array([[1.5, 1.5], [1.5, 9.5]])))
```

# How many corners

Any-angle paths bend at corners of blocked cells. Time and memory grow with the square of `max_corners`, the largest
number of corners of a map; without a goal, time grows with the cube. The default allows all corners of up to 17 x 17
cells, and half of the corners of larger grids. With a smaller number, mazes become several times faster. If a map has
more corners, its distances are NaN and `field.is_complete` is false. So begin with a small number, and double it
until `is_complete` is true for all maps of a sample:

```python
maps = jax.random.bernoulli(jax.random.key(1), 0.9, (1000, 11, 11))
max_corners = 8
while not jax.vmap(
    lambda free: plr_jax.grid_distance(free, jnp.array([1.5, 1.5]), max_corners=max_corners).is_complete
)(maps).all():
    max_corners *= 2
print(max_corners)
```

# In an environment

In `reset`, compute the field and store it in the environment's state. If the agent stands on cell centers, store
`field.cells` instead, and index `cells[row, column]`. With any-angle paths, a step is then much faster than with
`field(x)`. If the agent moves between neighboring cells, use `moves=4` or `moves=8`: the distance is then the total
length of the steps. Compared with any-angle paths, a reset on 11 x 11 cells takes 115 or 8.2 times less CPU time.

If `step` resets the environment, `vmap` turns `lax.cond` into both of its branches, so every step also runs `reset`,
which computes a field. So create a pool of states beforehand, and let each reset pick a state from the pool. If
resets need new maps, compute a few new states in each step, outside of `vmap`, and put them into the pool in place of
old ones.

```python
def reset(key):
    free = jax.random.bernoulli(key, 0.8, (15, 15)).at[jnp.array([0, 14]), jnp.array([0, 14])].set(True)
    cells = plr_jax.grid_distance(free, jnp.array([14.5, 14.5]), moves=4).cells
    return {"agent": jnp.array([0, 0]), "cells": cells}  # the agent's row and column

pool = jax.vmap(reset)(jax.random.split(jax.random.key(2), 1024))

def step(state, action, key):
    cells, old = state["cells"], state["agent"]
    agent = jnp.clip(old + jnp.array([[0, 1], [1, 0], [0, -1], [-1, 0]])[action], 0, 14)
    agent = jnp.where(jnp.isinf(cells[*agent]), old, agent)  # distances of blocked cells are inf
    before, after = cells[*old], cells[*agent]
    is_done = (after == 0) | jnp.isinf(after)  # at the goal, or on a map without a path
    number = jax.random.randint(key, (), 0, 1024)
    new = jax.tree.map(lambda leaf, same: jnp.where(is_done, leaf[number], same), pool, {**state, "agent": agent})
    return new, jnp.where(jnp.isinf(before), 0, before - after), is_done  # state, reward, done

state, keys = jax.tree.map(lambda leaf: leaf[:64], pool), jax.random.split(jax.random.key(3), 64)
state, reward, is_done = jax.jit(jax.vmap(step))(state, jnp.zeros(64, int), keys)
```

The rule by which agents move must forbid the motions that the distance forbids: into blocked cells, and between two
blocked cells that share only a corner. Otherwise rewards are `inf` or NaN. Oracles run on the host, not inside `jit`.
"""
