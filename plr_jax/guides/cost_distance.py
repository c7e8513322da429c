"""Guide: cost distance over rasters, for GIS: travel times to the nearest of several places, catchments, corridors.

`plr_jax.cost_distance` takes a raster of costs per unit of length, and sources. Shortest paths over 8 neighbors are
3.4 to 5.4 % too long on average, and favor some directions; mean errors here are below 0.5 %, up to 2 million cells.

```python
import numpy as np
import plr_jax

minutes_a_meter = np.full((60, 80), 0.012)  # a raster of 60 rows and 80 columns; row 0 has the lowest y
minutes_a_meter[20:40, 30:50] = 0.05  # a marsh
minutes_a_meter[0:45, 60] = np.nan  # a river: NaN, inf and masked cells are barriers
clinics = [(300, 900), (1_900, 400)]  # points (x, y), in meters from the lower left corner

result = plr_jax.cost_distance(minutes_a_meter, clinics, cell_size=30)
print(result.distance[50, 70], result.nearest[50, 70])  # minutes to the nearest clinic; its row in `clinics`
print(result.path((70.5 * 30, 50.5 * 30)))  # vertices (n, 2) of the path from the center of this cell
```

The result is a `plr_jax.CostDistance`. Where no source can be reached, `distance` is `inf` and `nearest` is -1.

- The sources may also be a boolean mask of the raster's shape, such as the cells of a road.
- Costs must be positive: where travel is free, use a small cost, such as a thousandth of the others.
- With `squeeze=True`, paths pass between barriers that touch in a corner, as over 8-connected cells: for networks,
  such as rivers in a raster whose other cells are barriers. `plr_jax.GridGraph` has this option, too. A road of
  costly cells that touch in corners only is no obstacle: rasterize such roads with `all_touched=True`.

# Files: GeoTIFF and xarray, meters and degrees

With `pip install 'plr-jax[gis]'`, costs and heights may be paths of files, whose scale is applied, or `DataArray`s of
two dimensions with equal coordinates. Cells without data are barriers. Sources and paths have the file's coordinates;
masks have the file's order of rows. Results are `DataArray`s. A path begins in a cell's center.

```text
result = plr_jax.cost_distance("friction.tif", clinics)
result.distance.rio.to_raster("minutes.tif")  # inf where no clinic can be reached
minutes = result.distance.where(np.isfinite(result.distance), -9999)  # -9999 instead of inf
minutes.rio.write_nodata(-9999).rio.to_raster("minutes_with_nodata.tif")
```

Longitudes and latitudes in degrees are recognized by the reference system or the names of the coordinates. Costs are
then per meter on a sphere, points are `(longitude, latitude)`, and a raster of 360 degrees wraps around. In our
experiments on cells of half a degree, distances differ from great circles by 0.05 % on average, by 0.4 % at most. On
the ellipsoid, distances differ from those on the sphere by up to 0.6 %.

# Corridors, and areas within a time

The cheapest path between two places through a cell costs the sum of the cell's distances to both. Cells where the sum
is little above its least value are a corridor. Places may be masks, such as all cells of a reserve. With
heights, use `from_sources=True` for the place where paths start.

```python
from matplotlib.figure import Figure

reserves = [(150, 150)], [(2_300, 1_600)]
total = sum(plr_jax.cost_distance(minutes_a_meter, reserve, cell_size=30).distance for reserve in reserves)
figure = Figure()
figure.subplots().imshow(100 * (total / total.min() - 1), origin="lower", vmax=20)  # per cent above the cheapest
figure.savefig("corridor.png")
```

Areas of at most 15 minutes, as polygons and as GeoJSON (for a file, `x, y = result.distance.x, result.distance.y`):

```python
import contourpy
import shapely

x, y, minutes = 30 * np.arange(80) + 15, 30 * np.arange(60) + 15, np.ma.masked_invalid(result.distance)
contours = contourpy.contour_generator(x, y, minutes, fill_type="ChunkCombinedOffsetOffset")
(points,), *ends = contours.filled(-1, 15)
areas = shapely.from_ragged_array(shapely.GeometryType.POLYGON, points, tuple(end[0] for end in ends))
print(shapely.to_geojson(shapely.multipolygons(areas))[:80])
```

# Uphill and downhill

With heights, costs depend on the slope along the path. The default is Tobler's hiking function, in seconds a meter
of horizontal distance; `slope_cost` may be any other function of slopes, rise over run. The costs are then factors
without a unit, such as 1 in fields and 2.5 in forest. If heights are a file or `DataArray`, costs may be a number.

```python
heights = np.fromfunction(lambda row, column: 5.0 * column, (60, 80))  # rises by 5 m every 30 m eastward
hut, options = [(1_500, 900)], {"cell_size": 30, "heights": heights}
there = plr_jax.cost_distance(np.ones((60, 80)), hut, **options)  # to reach help: from each cell to the source
back = plr_jax.cost_distance(np.ones((60, 80)), hut, **options, from_sources=True)  # to walk out from the source
print(there.distance[30, 5] / 60, back.distance[30, 5] / 60)  # minutes up to the hut, and down from it
```

# How good is it?

In our experiments, mean errors are 0.03 to 0.04 % where costs change slowly, 0.1 to 0.2 % in land classes with roads
of one cell (at most 2.2 % in a cell), and 0.04 to 0.5 % with heights. `bounds=True` adds `result.lower` and
`result.upper`, which are proven for costs that are constant in each cell, in a plane without heights. `upper` is the
distance, rounded up. The mean gap between the bounds is 1.5 to 3 % of the mean distance if sources are at centers of
cells, and up to 10 % if sources are on borders of cells: move them to centers. The gap is larger near sources.

```python
bounded = plr_jax.cost_distance(minutes_a_meter, clinics, cell_size=30, bounds=True)
reached = bounded.nearest >= 0
print((bounded.upper[reached] - bounded.lower[reached]).mean() / bounded.distance[reached].mean())
```

The path search takes 4 kB a cell. Bounds, heights and `squeeze` need it, and are errors above 4 million open cells.
Else, scikit-fmm marches over rasters above 2 million open cells: no paths, errors of 0.1 to 0.3 % where costs change
slowly, 0.5 to 7 % where costs jump, more if random in each cell. 100 million cells take 104 CPU s and 14 GB.

# A file of kilobytes

`max_bytes=8192` adds `result.plr`, a `plr_jax.PLR` of the distance: a small file with a gradient, also for C and
JavaScript. It lacks proven bounds, and its values in barriers are finite. Measure its errors at the centers of cells.
`plr_jax.descend` follows the PLR to a source among the cells of a `plr_jax.RasterCost`. Its paths are approximate:
compare `walk.costs` with the distance.

```python
result = plr_jax.cost_distance(minutes_a_meter, clinics, cell_size=30, max_bytes=8192)
error = np.abs(result.plr(np.stack(np.meshgrid(x, y), axis=-1)) - result.distance)[result.nearest >= 0]
raster = plr_jax.RasterCost(minutes_a_meter, ((0, 0), (80 * 30, 60 * 30)), "nearest")
walk = plr_jax.descend(result.plr, raster.space(), [(70.5 * 30, 50.5 * 30)], clinics[1], cost_map=raster)
print(error.mean(), error.max(), walk.paths[0], walk.costs)
```
"""
