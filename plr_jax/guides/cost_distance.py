"""Guide: cost distance over rasters, for GIS: travel times to the nearest of several sources, and catchments.

`plr_jax.cost_distance` takes a raster of costs per unit of length, and sources. In our experiments, its mean errors
are 0.03 to 0.2 % of the mean distance, with heights 0.5 to 0.6 %. Shortest paths over 8 neighbors are 3 to 5 % too
long on average, and favor some directions.

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

The result is a `plr_jax.CostDistance`. Its arrays have the shape of the raster. Where no source can be reached,
`distance` is `inf` and `nearest` is -1.

- The sources may also be a boolean mask of the raster's shape, such as the cells of a road.
- Rasters of up to 2 million cells, or 4 million with `bounds=True` or with heights, take kilobytes of memory a cell:
  about 9 GB for 2 million cells. Larger rasters, without bounds and heights, take 100 bytes a cell, and have the
  errors of scikit-fmm: 0.1 to 0.3 % on average where costs change slowly, 0.5 to 7 % where costs jump.

# A least-cost path

`result.path` returns a path from the center of a point's cell to the nearest source. Its cost is the distance there.
If a raster has more than 2 million cells, the result has paths only with `bounds=True` or with heights: else follow a
PLR, as below.

```python
village = (70.5 * 30, 50.5 * 30)  # the center of cell [50, 70]
print(result.path(village))  # vertices (n, 2)
```

# How good is it?

`bounds=True` adds `result.lower` and `result.upper`, which are proven for costs that are constant in each cell.
`upper` is the distance, rounded up, so only `lower` adds information. In our experiments, the mean gap between the
bounds is 2 to 4 % of the mean distance. As a share of the distance itself, the gap is larger near sources, and
may be everywhere if costs of neighbors differ by a factor of 100 or more.

```python
result = plr_jax.cost_distance(minutes_a_meter, clinics, cell_size=30, bounds=True)
reached = (result.nearest >= 0) & (result.distance > 0)
gap = result.upper[reached] - result.lower[reached]
print((gap / result.distance[reached]).mean())
```

# A file of kilobytes

`max_bytes=8192` adds `result.plr`, a `plr_jax.PLR` of the distance: a small file with a gradient, also for C and
JavaScript. It has no proven bounds, and finite values in barriers. Measure its errors at the centers of cells:

```python
result = plr_jax.cost_distance(minutes_a_meter, clinics, cell_size=30, max_bytes=8192)
centers = np.stack(np.meshgrid(30 * np.arange(80) + 15, 30 * np.arange(60) + 15), axis=-1)  # (60, 80, 2)
error = np.abs(result.plr(centers) - result.distance)[reached]
print(error.mean(), error.max())
```

`plr_jax.descend` follows the PLR to a source, among the same cells as a `plr_jax.RasterCost`. Its paths are
approximate: compare `walk.costs` with the distance.

```python
raster = plr_jax.RasterCost(minutes_a_meter, ((0, 0), (80 * 30, 60 * 30)), "nearest")
walk = plr_jax.descend(result.plr, raster.space(), [village], clinics[result.nearest[50, 70]], cost_map=raster)
print(walk.paths[0], walk.costs)
```

# GeoTIFF and xarray

The raster may be an xarray `DataArray` of two dimensions with evenly spaced coordinates. Sources and paths then have
these coordinates, and so must heights and masks. Use a projection in meters, not degrees. The results are
`DataArray`s with the same coordinates and reference system. With `pip install 'plr-jax[gis]'`:

```text
costs = rioxarray.open_rasterio("friction.tif", masked=True).squeeze("band")
result = plr_jax.cost_distance(costs, clinics)
result.distance.rio.to_raster("minutes.tif")  # inf where no clinic can be reached
minutes = result.distance.where(np.isfinite(result.distance), -9999)  # -9999 instead of inf
minutes.rio.write_nodata(-9999).rio.to_raster("minutes_with_nodata.tif")
raster = plr_jax.RasterCost(costs, interpolation="nearest")  # for descend, in the coordinates of the file
```

# Uphill and downhill

With heights, costs depend on the slope along the path. The default is Tobler's hiking function, in seconds a meter
of horizontal distance; `slope_cost` may be any other function of slopes, rise over run. The costs are then factors
without a unit, such as 1 in fields and 2.5 in forest.

```python
heights = np.fromfunction(lambda row, column: 5.0 * column, (60, 80))  # rises by 5 m every 30 m eastward
hut = [(1_500, 900)]
there = plr_jax.cost_distance(np.ones((60, 80)), hut, cell_size=30, heights=heights)
back = plr_jax.cost_distance(np.ones((60, 80)), hut, cell_size=30, heights=heights, from_sources=True)
print(there.distance[30, 5] / 60, back.distance[30, 5] / 60)  # minutes up to the hut, and down from it
print(there.path((5.5 * 30, 30.5 * 30)), back.path((5.5 * 30, 30.5 * 30))[::-1])  # both in the direction of walking
```
"""
