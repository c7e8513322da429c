"""Compress distance functions over configuration spaces into kilobytes, and plan with them.

A `DistanceFn` maps points ``(n, dim)`` to distances ``(n,)``, ``inf`` where the goal cannot be reached. A
`HeuristicFn` maps joint configurations ``(n, robots, dof)`` to costs-to-go ``(n,)``.

# Discover: compute exact distances

```python
import plr_jax

workspace = plr_jax.Workspace(((0, 0), (10, 6)), obstacles=[[(3, 0), (4, 0), (4, 4), (3, 4)]])
oracle = plr_jax.VisibilityGraph(workspace, goal=(9, 1))
```

- Maps: `Workspace` and `Box`; published scenes and file readers in `scenes`. Teams: `Problem` with several `Robot`
  objects: `PointRobot`, `DiscRobot`, `RectangleRobot`, `PolygonRobot`.
- Oracles: `VisibilityGraph`, `Roadmap`, `Euclidean`, `Dubins`, `ReedsShepp`, `GridField`, `GridGraph`, `VoxelGraph`,
  `NearestGoal`; `robot_distance_fns` makes one per robot of a problem.
- Inside `jit`, on maps that are traced arrays: `grid_distance` returns a `GridDistance` to one goal, or
  `GridDistances` between any two points.
- Without an oracle: `solve_eikonal` needs only a space: `PlaneSpace`, `VoxelSpace`, `RigidBodySpace`, `PlanarArm`, or
  `ClearanceSpace` for any robot with a signed distance. Protocols for your own space: `FreeTest`, `SeesBoxes`, and
  `ConfigurationSpace`, which returns a `CellState`.
- Costs of motions: `MotionCost`, and cost maps, which give a cost per unit of length: `CostMap`, `RasterCost`,
  `LipschitzCost`, `DirectionalCost`.

**Axis order.** Points are always rows `(x, y)` or `(x, y, z)`.

- Pixels and cells are `free[row, column]`, row 0 at the lowest `y`: `Workspace.from_mask`, `GridGraph`,
  `construct_grid_pairs`, `grid_distance`, `GridPairs.window`. For a picture, use `from_mask(free, row0="top")`.
- Rasters are `values[row, column]` or `values[z, y, x]`: `GridField`, `RasterCost`. For a picture use `values[::-1]`.
- Voxels are `free[x, y, z]`: `VoxelSpace`, `VoxelGraph`, `scenes.read_volume`. `.T` converts from and to rasters.

# Store: compress distances into kilobytes

```python
field = plr_jax.construct(oracle, workspace.bounds, max_bytes=1024, certified=True)
plr_jax.save(field, "field.plr")
field = plr_jax.load("field.plr")
```

- A `PLR` stores the distance to one goal: `construct`, or `construct_many` for many goals; `certify` adds proven
  bounds; `plr.updated` follows a changed map.
- Pairs store distances between any two points: `construct_pairs` returns a `PairPLR`, `construct_grid_pairs` returns
  `GridPairs`, `construct_metric_pairs` returns `MetricPairs`; see `pairs`.
- Files: `save`, `load` and `from_bytes`; without JAX, `load_numpy` returns a `NumpyPLR`.
- Options of `construct`: `BuildOptions` with `CellFit`, `least_squares`, `largest_error`, `center_error`,
  `maximum_depth`, `best_axis`, `cyclic_axis`. An interrupted build warns with `ConstructionInterrupted`. File formats
  and arithmetic are documented in `plr`.

# Use: query batches, follow gradients, plan

```python
import jax
import numpy as np

x = workspace.sample_free(1000, seed=0)
distance, slope = field(x), jax.vmap(jax.grad(field))(x)
lower, upper = field.bounds(x)
```

- Queries: call a PLR, or use `evaluate`; `stack` combines several into a `PLRStack`.
- Paths: `trace` returns the paths that cone leaves store, `Traces` with a `TraceStatus`; `descend` follows any field
  to its goal, a `Descent` with a `DescentStatus`.
- Teams: `bl_plan` plans with `BLOptions` and a heuristic (`zero`, `straight_line`, `sum_of_distances`) and returns a
  `Solution` with `Status` and `Stats`. `replan` plans for a team in motion; `lifelong` replans as
  robots get new goals, a `LifelongRun`. `ompl_objective` guides OMPL planners.

# Look: check and draw results

```python
print(plr_jax.metrics.error_map(field, oracle, x))
plr_jax.plot.plot_contours(field, workspace=workspace, goal=(9, 1))
```

- `metrics` measures errors, `plot` draws. `validate` checks a path with independent geometry and returns a
  `ValidationReport`. `path_cost` and `makespan` evaluate paths.

The public names are listed in ``__init__.pyi`` and loaded on first use. A program that only loads and queries a PLR
imports neither Shapely, NetworkX and Matplotlib nor the slow parts of SciPy.
"""

import lazy_loader

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the list is in __init__.pyi
