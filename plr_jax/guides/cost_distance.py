"""Guide: cost distance over rasters, for GIS: travel times to the nearest of several sources, and catchments.

`plr_jax.cost_distance` takes a raster of costs per unit of length and sources. Its answers are about 0.1 % above the
least cost on average. Shortest paths over 8 neighbors are 3 to 5 % too long, and favor some directions.

```python
import numpy as np
import plr_jax

minutes_a_meter = np.full((60, 80), 0.012)  # a raster of 60 rows and 80 columns; row 0 has the lowest y
minutes_a_meter[20:40, 30:50] = 0.05  # a marsh
minutes_a_meter[0:45, 60] = np.nan  # a river: NaN, inf and masked cells are barriers
clinics = [(300, 900), (1_900, 400)]  # points (x, y), in meters from the lower left corner

result = plr_jax.cost_distance(minutes_a_meter, clinics, cell_size=30)
print(result.distance[50, 70], result.nearest[50, 70])  # minutes to the nearest clinic; its row in `clinics`
```

The result is a `plr_jax.CostDistance`. Its arrays have the shape of the raster.

- The sources may also be a boolean mask of the raster's shape, such as the cells of a road.
- `bounds=True` adds `result.lower` and `result.upper`, which are proven for costs that are constant in each cell.
- `max_bytes=8192` adds `result.plr`, a `plr_jax.PLR` of the distance: a small file with a gradient, also for C and
  JavaScript.
- Up to 2 million cells, about 2 kB of memory a cell. Larger rasters take 100 bytes a cell, with the errors of
  scikit-fmm: 0.1 to 0.3 % on average where costs change slowly, 0.5 to 7 % where they jump.

# A least-cost path

`plr_jax.descend` follows the PLR to the nearest source, among the same cells as a `plr_jax.RasterCost`:

```python
result = plr_jax.cost_distance(minutes_a_meter, clinics, cell_size=30, max_bytes=8192)
raster = plr_jax.RasterCost(minutes_a_meter, ((0, 0), (80 * 30, 60 * 30)), "nearest")
village, nearest = (70.5 * 30, 50.5 * 30), clinics[result.nearest[50, 70]]  # the center of cell [50, 70]
walk = plr_jax.descend(result.plr, raster.space(), [village], nearest, cost_map=raster)
print(walk.paths[0], walk.costs)
```

# GeoTIFF and xarray

The raster may be an xarray `DataArray` of two dimensions with evenly spaced coordinates, in which sources are then
given. Heights and masks must have the same coordinates. Use a projection in meters, not degrees. The results are
`DataArray`s of the same coordinates; distances are `inf` where no source can be reached. With
`pip install 'plr-jax[gis]'`:

```text
costs = rioxarray.open_rasterio("friction.tif", masked=True).squeeze("band")
plr_jax.cost_distance(costs, clinics).distance.rio.to_raster("minutes.tif")
```

# Uphill and downhill

With heights, costs depend on the slope along the path. The default is Tobler's hiking function, in seconds a meter;
`slope_cost` may be any other function of slopes, rise over run.

```python
heights = np.fromfunction(lambda row, column: 5.0 * column, (60, 80))  # rises by 5 m every 30 m eastward
hut = [(1_500, 900)]
there = plr_jax.cost_distance(np.ones((60, 80)), hut, cell_size=30, heights=heights)
back = plr_jax.cost_distance(np.ones((60, 80)), hut, cell_size=30, heights=heights, from_sources=True)
print(there.distance[30, 5] / 60, back.distance[30, 5] / 60)  # minutes up to the hut, and down from it
```
"""
