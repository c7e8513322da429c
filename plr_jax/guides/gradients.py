"""Guide: differentiate distances, by points, goals, walls and stored values.

| distance | has a gradient with respect to | call |
| --- | --- | --- |
| PLR, stack, pairs | point | `jax.grad(plr)(x)` |
| PLR of planes, continuous or smooth leaves | value that the file stores | `plr.tunable()` |
| polygons, inside `jit` | point, goal, vertex | `plr_jax.polygon_distance` |
| discs, inside `jit` | center, radius | `plr_jax.traced.polygons_of_discs` |
| polygons, on the host | point, goal, vertex | `oracle.directions`, `oracle.vertex_gradient` |
| grids, inside `jit` | point, goal; not which cells are free | `plr_jax.grid_distance` |
| `plr_jax.cost_distance` | cost of a cell: compute it, as the length of `result.path(x)` in the cell | |

A gradient is that of one shortest path. By the point, it is the unit vector against the first segment; by the goal,
the unit vector along the last segment. By a corner, it is the sum of two unit vectors if the path turns there: each
points to the corner from the vertex before it or after it on the path. By all other vertices, it is 0. `jax.jvp` and
`jax.hessian` work inside `jit`, too. `notebooks/8_gradients_of_a_distance.ipynb` has pictures.

# Move walls

`plr_jax.polygon_distance(polygons, goal)` returns a `plr_jax.traced.PolygonDistance`, exact for up to 256 vertices.
All arguments may be traced; for many maps, use `jax.vmap`. Here walls move to shorten the paths to a door.

```python
import jax
import jax.numpy as jnp
import numpy as np
import optax
import plr_jax

bounds, door = ((0, 0), (10, 6)), jnp.array([9.0, 1.0])
walls = jnp.array([[(3, 0), (3.2, 0), (3.2, 4), (3, 4)], [(6, 1), (6.2, 1), (6.2, 6), (6, 6)]])
x = jax.random.uniform(jax.random.key(0), (500, 2), maxval=jnp.array([10.0, 6.0]))

def mean_distance(shifts):
    distance = plr_jax.polygon_distance(walls + shifts[:, None], door, bounds=bounds)(x)
    return jnp.mean(distance, where=jnp.isfinite(distance))  # points in walls have distance inf

optimizer = optax.adam(0.1)

@jax.jit
def step(shifts, state):
    cost, gradient = jax.value_and_grad(mean_distance)(shifts)
    updates, state = optimizer.update(gradient, state)
    return jnp.clip(optax.apply_updates(shifts, updates), -0.5, 0.5), state, cost

state = optimizer.init(shifts := jnp.zeros((2, 2)))
for _ in range(20):
    shifts, state, cost = step(shifts, state)
print(shifts, cost)
gaps = (jnp.abs(x[:, None] - walls.mean(axis=1)) - jnp.ptp(walls, axis=1) / 2).max(axis=2)  # to boxes; < 0 inside
penalty = (jnp.maximum(0.1 - gaps, 0) ** 2).mean()  # add this to a cost, to keep walls 0.1 away from points
```

Without a goal, `polygon_distance` returns a `plr_jax.traced.PolygonDistances`. Pad polygons by repeated vertices, or
by rows of NaN after you rotate or scale vertices: in gradients, 0 times NaN is NaN.

```python
def between(centers):
    return plr_jax.polygon_distance(plr_jax.traced.polygons_of_discs(centers, radii=0.8), None)(x[0], door)

print(jax.grad(between)(jnp.array([(5.0, 3.0), (7.0, 2.0)])))
```

# Larger maps

`plr_jax.VisibilityGraph` runs on the host, for maps of any size. `oracle.vertex_gradient(x)` is a SciPy sparse
matrix: a row for each point, two columns for each row of `workspace.obstacle_vertices`, and two for the goal. A
`custom_vjp` makes it a gradient of JAX. Here all points keep a path to the goal; else the mean is `inf`.

```python
x, shape = np.asarray(x), walls.shape  # a callback must not compute with arrays of JAX

def on_host(vertices):
    workspace = plr_jax.Workspace(bounds, np.asarray(vertices, float).reshape(shape))
    oracle, points = plr_jax.VisibilityGraph(workspace, (9, 1)), x[workspace.is_free(x)]
    by_vertices = np.asarray(oracle.vertex_gradient(points).mean(axis=0))[:-2].reshape(-1, 2)
    return np.float32(oracle(points).mean()), by_vertices.astype(np.float32)

def forward(vertices):
    like = jax.ShapeDtypeStruct((), jnp.float32), jax.ShapeDtypeStruct(vertices.shape, jnp.float32)
    return jax.pure_callback(on_host, like, vertices)

mean_on_host = jax.custom_vjp(lambda vertices: forward(vertices)[0])
mean_on_host.defvjp(forward, lambda by_vertices, scale: (scale * by_vertices,))
print(jax.jit(jax.grad(mean_on_host))(walls.reshape(-1, 2)))
```

# Train what a PLR stores

Planes, continuous and smooth leaves are linear in the values that the file stores. `plr.tunable()` returns a
`plr_jax.plr.TunablePLR`, a pytree of the values. With more values than measurements, noise is fitted: use few bytes.

```python
problem = plr_jax.scenes.maze()
oracle = plr_jax.VisibilityGraph(problem.workspace, problem.goals[0])
plr = plr_jax.construct(oracle, problem.workspace.bounds, leaf="continuous", max_bytes=512)
measured = 1.2 * oracle(x := problem.workspace.sample_free(500, seed=0))

@jax.jit
def train(tunable, state):
    loss, gradient = jax.value_and_grad(lambda fn: ((fn(x) - measured) ** 2).mean())(tunable)
    updates, state = optimizer.update(gradient, state)
    return optax.apply_updates(tunable, updates), state, loss

tunable, optimizer = plr.tunable(), optax.adam(0.01)
state = optimizer.init(tunable)
for _ in range(100):
    tunable, state, loss = train(tunable, state)
print(loss, tunable.to_plr(max_bytes=512))  # to_plr makes a PLR for a file, without a proof
```

# Where gradients jump

- **Two equally short paths**: the gradient is that of one. Average over many points, and keep the best of all steps.
- **A gap closes or opens**: the distance jumps, and no gradient shows it beforehand. Try several starts.
- **Points in a wall**: distance `d = inf`, gradient 0. Masks as above suffice for means. For other functions, such as
  a variance, first replace `inf`, or gradients are NaN: `ok = jnp.isfinite(d)`, then `d = jnp.where(ok, d, 0)`.
- **Polygons that cross themselves**, after free moves of vertices: distances are wrong. Check `shapely.is_valid`.
- **Second derivatives** jump where a point begins to see another corner.
- **Leaves**: planes jump from leaf to leaf; so do gradients of continuous leaves, and of smooth leaves at walls.
"""
