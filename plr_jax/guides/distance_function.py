"""Guide: store the distance to a goal in a file of a few kilobytes.

There are three steps: describe the map, choose an *oracle* (a function that computes the distance to the goal), and
compress the oracle into a *piecewise linear regression*, a `plr_jax.PLR`. Construction halves a box again and again.
In each final cell, a *leaf*, a simple function approximates the distance.

```python
import plr_jax

obstacles = [[(3, 0), (4, 0), (4, 4), (3, 4)], [(6, 2), (7, 2), (7, 6), (6, 6)]]
workspace = plr_jax.Workspace(bounds=((0, 0), (10, 6)), obstacles=obstacles)
oracle = plr_jax.VisibilityGraph(workspace, goal=(9, 1))
plr = plr_jax.construct(oracle, workspace.bounds, leaf="cone", max_bytes=1024, certified=True)

x = workspace.sample_free(1000, seed=0)  # points (n, 2), one a row
distance = plr(x)  # (n,), workspace units
lower, upper = plr.bounds(x)  # proven, also for the rounding of the query
print(plr.num_bytes, plr.num_leaves, plr.max_error)
print(plr_jax.metrics.error_map(plr, oracle, x))  # an ErrorReport; metrics.error_grid returns a picture of errors
```

# Maps

A map of polygons is a `plr_jax.Workspace`. `plr_jax.scenes.read_workspace` reads files, such as pictures, ROS
`map_server` YAML, GeoJSON and WKT. In pictures, the top row has the highest `y`; in Moving AI's `.map`, the lowest,
unless `row0="top"`. `Workspace.from_mask(free)` takes pixels and `Workspace.from_polygons(parts)` free space as
polygons. For a disc, `workspace.inflate(radius)` grows obstacles by polygons inside the arcs of round corners, so
distances are never too long. With `outside=True`, polygons lie around arcs: paths keep the radius, up to rounding.
`plr_jax.scenes` has ready-made maps. A PLR's domain is a `plr_jax.Box` of any dimension; axes may be periodic.

# Oracles

A `plr_jax.DistanceFn` is any function from points `(n, dim)` to distances `(n,)`. An oracle runs on the host, in
NumPy; a PLR runs inside `jit`, too. If there is no oracle, `plr_jax.solve_eikonal` builds a PLR.

| oracle | distance |
| --- | --- |
| `plr_jax.VisibilityGraph` | exact, for a point among polygons; its PLRs can be certified |
| `plr_jax.Roadmap` | over a probabilistic roadmap (PRM*), for any configuration space with a collision test |
| `plr_jax.GridGraph`, `plr_jax.VoxelGraph` | steps over a grid of 2 or 3 dimensions |
| `plr_jax.GridField` | interpolation of a raster of distances computed elsewhere, for example by scikit-fmm |
| `plr_jax.Euclidean`, `plr_jax.Dubins`, `plr_jax.ReedsShepp` | straight line; cars without obstacles |

```python
import numpy as np

roadmap = plr_jax.Roadmap.from_workspace(workspace, goal=(9, 1), num_samples=1000)
by_roadmap = plr_jax.construct(roadmap, workspace.bounds, tolerance=0.2)

poses = plr_jax.Box((-5, -5, -np.pi), (5, 5, np.pi), periodic=(False, False, True))
parking = plr_jax.ReedsShepp(goal=(0, 0, 0), radius=1)
car = plr_jax.construct(parking, poses, leaf="continuous", max_bytes=1024)
print(roadmap(x[:3]), by_roadmap(x[:3]), parking([[1, 2, 3]]), car((1, 2, 3)))
```

# Construction

`plr_jax.construct` stops at the first limit that is reached: `max_bytes`, `max_leaves`, `max_depth`, or `tolerance`,
the largest error in a cell. Leaves:

- `"cone"`: the length of paths by one corner, exact in most cells. Only among polygons. A corner takes a few bytes.
- `"continuous"`: no jumps from cell to cell, unless a wall is between them; in up to 6 dimensions.
- `"smooth"`: as `"continuous"`, and the gradient hardly jumps; in 1 or 2 dimensions.
- `"plane"`: the leaf of the paper, for any dimension; the function may jump between cells.
- `"best"`: cones if `max_bytes` has ample room for all corners; else the most exact of several PLRs.
  `"continuous"` if the oracle knows no corners, or if corners need over 4 times `max_bytes` and no proof is wanted.

If the oracle is a `VisibilityGraph`, `certified=True` proves the largest error, `plr.max_error`, with any leaf.
`certified="leaves"` stores proven bounds of each leaf, in 2 bytes a leaf. `plr_jax.certify` proves bounds of an
existing PLR. Where walls touch at a point, no error below half of the distance's jump can be proven. `plr.lower` is
never above the true distance: see `plr_jax.guides.heuristics`. Ctrl-C returns the PLR built so far, with a
`plr_jax.ConstructionInterrupted` warning.

# Files and queries

`plr(x)` is `plr_jax.evaluate(plr, x)`. It takes NumPy or JAX arrays `(..., dim)`, also under `jit`, `vmap` and
`grad`. Far from the origin, 32-bit points are too coarse: give NumPy's 64-bit points, outside `jit`.

```python
import jax

plr_jax.save(plr, "field.plr")
again = plr_jax.load("field.plr")  # or plr_jax.from_bytes(plr.to_bytes())
slope = jax.jit(jax.vmap(jax.grad(again)))(x)
assert (again(x) == plr_jax.evaluate(plr, x)).all()
plr_jax.plot.plot_contours(plr, workspace=workspace, goal=(9, 1))
```

# What `inf` means

- *No path to the goal.* PLRs of most oracles answer `inf` in rooms without a path to the goal, except closer than
  1/64 of the domain's width to a point with a path. `workspace.reachable(x, goal)` has no such exception.
- *Outside the domain.* A PLR answers `inf`; `outside="clamp"` extends a PLR beyond its domain.
- *In an obstacle.* A `VisibilityGraph` answers `inf`. A PLR does not store walls and may answer a finite number.
- *A blocked cost.* No path enters a place where a cost map or raster is `inf`.
- *No proven upper bound.* Where `plr.bounds(x)` has `inf` and `plr(x)` has not, the distance may still be finite.

# Several exits

`plr_jax.NearestGoal` is the distance to the nearest of several goals; `which(x)` is the index of that goal. If its
oracles are `VisibilityGraph`s of one workspace, its PLRs of cones can be certified, and their files store the index.
Other files do not. Represent a wide door by a row of goals: the error is at most half their spacing.

```python
exits = plr_jax.NearestGoal([oracle, oracle.with_goal((1, 5))])
plr_jax.save(plr_jax.construct(exits, workspace.bounds, leaf="cone", max_bytes=1024), "exits.plr")
print(plr_jax.load("exits.plr").which(x[:3]), exits.which(x[:3]), exits.shortest_path(x[0]))
```

# Your own rules

`plr_jax.BuildOptions` replaces the rules of the paper's Algorithm 1. The rules are in `plr_jax.plr`; each is a
function of a `plr_jax.plr.CellFit`, the samples of a batch of cells. Fitting: `least_squares`. Which cell to split:
`largest_error`, `center_error`, `maximum_depth`. Along which axis: `best_axis`, `cyclic_axis`. `executor`
evaluates slow oracles in parallel. `leaf=` also takes objects of the classes `plr_jax.plr.Plane` and `Continuous`.

```python
options = plr_jax.BuildOptions(should_split=plr_jax.plr.maximum_depth, split=plr_jax.plr.cyclic_axis)
paper = plr_jax.construct(oracle, workspace.bounds, max_depth=9, options=options)
```
"""
