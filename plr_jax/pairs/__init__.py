"""Distances between any two points: of a planar workspace, of a grid's cells, of any metric.

In the plane (:func:`construct_pairs`) a cell lists the corners at which paths from it may turn first, as
``geometry/cell_sight.py`` finds them. The module `construct` builds the lists, and `stored` holds the layout of the
file. The module `query` searches the tables in JAX; `portable` does so without JAX. The module `hiding` finds the
walls between a cell and a corner, and the chords of obstacles that hide most points. :class:`PreparedGoals` store the
distances of goals that are queried many times. On grids (:func:`construct_grid_pairs`) distances are exact:
see ``GRIDS.md``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
