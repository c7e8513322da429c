"""Distances between any two points: of a planar workspace, of a grid's cells, of a building, or for any metric.

`construct_pairs` returns a `PairPLR` of a workspace, or `BuildingPairs`; `construct_grid_pairs` returns `GridPairs`,
and `construct_metric_pairs` returns `MetricPairs`. If goals stay fixed, `PreparedGoals` save time with a `PairPLR`,
and `DistanceToCell` with `GridPairs`. `NumpyPairs` answer without JAX.

In the plane (:func:`construct_pairs`), module `construct` builds the file, which `stored` defines; `query` searches
for paths in JAX, `portable` in NumPy; `occlusion` finds what blocks sight. ``GRIDS.md`` explains `GridPairs`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
