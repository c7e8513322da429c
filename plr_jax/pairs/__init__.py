"""Distances between any two points: of a planar workspace, of a grid's cells, or for any metric.

In the plane (:func:`construct_pairs`), module `construct` builds the file, which `stored` defines; `query` searches
for paths in JAX, `portable` in NumPy; `occlusion` finds what blocks sight. ``GRIDS.md`` explains grids.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
