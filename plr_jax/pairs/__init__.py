"""Distances between any two points: of a planar workspace, of a grid's cells, or for any metric.

In the plane (:func:`construct_pairs`), each leaf lists the corners at which shortest paths from it may turn first.
The modules: `construct` builds the lists, `stored` defines the file, `query` searches in JAX, `portable` in NumPy,
`hiding` finds what blocks sight. On grids (:func:`construct_grid_pairs`), distances are exact: see ``GRIDS.md``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
