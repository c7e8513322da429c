"""Distances between any two points: of a planar workspace, of a grid's cells, of any metric.

In the plane (:func:`construct_pairs`) a cell lists the corners at which paths from it may turn first, as
``geometry/cell_sight`` finds them. `outline` is what a file keeps of the workspace, `stored` the layout of the file,
and a `query` reads `tables`: `near_walls` between a cell and a corner, and `occluders`, which hide most points from
one another. After a change of the map (`updated`) lists are found anew where it matters. To `goals` that stay
a query takes about half the time, or a fifth. On grids (:func:`construct_grid_pairs`) the same is exact, see
``GRIDS.md``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
