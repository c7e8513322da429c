"""Distance functions over maps and configuration spaces, compressed into kilobytes and queried in batches under JAX.

The compressed function is a PLR (piecewise linear regression): the map is divided into boxes, and the function has
one simple formula in each box.

```python
import plr_jax

workspace = plr_jax.Workspace(((0, 0), (10, 6)), obstacles=[[(3, 0), (4, 0), (4, 4), (3, 4)]])
oracle = plr_jax.VisibilityGraph(workspace, goal=(9, 1))  # computes exact distances to the goal
plr = plr_jax.construct(oracle, workspace.bounds, leaf="cone", max_bytes=1024, certified=True)  # compresses them

x = workspace.sample_free(1000, seed=0)  # points (n, 2), one per row
distance = plr(x)  # (n,); also under jit, vmap and grad
lower, upper = plr.bounds(x)  # proven
print(plr_jax.metrics.error_map(plr, oracle, x))
plr_jax.save(plr, "field.plr")
```

# Guides, with examples that run

- `plr_jax.guides.distance_function`: maps, exact distances, PLRs, files. `construct`, `certify`, `save`, `load`.
- `plr_jax.guides.any_two_points`: `construct_pairs`, `construct_grid_pairs`, `construct_many`, `stack`.
- `plr_jax.guides.buildings`: `Building`, `Link`, `BuildingPLR`, `BuildingPairs`.
- `plr_jax.guides.inside_jit`: `grid_distance`, on maps that are created inside `jit`.
- `plr_jax.guides.changing_map`: `Workspace.with_obstacles`, `VisibilityGraph.with_workspace`.
- `plr_jax.guides.costs_and_volumes`: `solve_eikonal`; cost maps, voxels, bodies, arms.
- `plr_jax.guides.cost_distance`: `cost_distance` over rasters, for GIS.
- `plr_jax.guides.teams`: `bl_plan`, `validate`, `replan`, `lifelong`.
- `plr_jax.guides.follow_the_field`: `descend`, `trace`.
- `plr_jax.guides.gradients`: `polygon_distance`, `VisibilityGraph.vertex_gradient`, `PLR.tunable`.
- `plr_jax.guides.c_and_javascript`: `PLR.c_header`, `PLR.js_module`, `load_numpy`.
- `plr_jax.guides.command_line`: the command `plr-jax`.

`plr_jax.guides` itself lists, for each class whose objects are called like functions, the arguments and the result.
`metrics` measures errors, `plot` draws, and `scenes` has ready-made maps and functions that read map files. `plr` has
more classes and functions for PLRs, `pairs` for distances between any two points.

# Which axis is which

Points are rows `(x, y)` or `(x, y, z)` in every call: queries, starts, goals, agents.

- Pixels and cells are `free[row, column]`, and row 0 has the lowest `y`: `Workspace.from_mask`, `GridGraph`,
  `construct_grid_pairs`, `grid_distance`, and the windows that `GridPairs.window` returns.
- Rasters of numbers are `values[row, column]`, or `values[z, y, x]` in three dimensions, with the last axis along
  `x`: `GridField`, `RasterCost`.
- Voxels are `free[x, y, z]`, with the first axis along `x`: `VoxelSpace`, `VoxelGraph`, `scenes.read_volume`.

In an image, row 0 is the top: use `Workspace.from_mask(free, row0="top")`, and `values[::-1]` for rasters. The
transpose `.T` turns a raster into voxels and back.

A name of this package is imported when it is first used. So loading and querying a PLR imports neither Shapely nor
Matplotlib.
"""

import lazy_loader

__version__ = "0.2.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # names are listed in __init__.pyi
