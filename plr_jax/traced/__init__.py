"""Shortest-path distances on grids and among polygons that may be traced, inside ``jax.jit``.

`grid_distance` returns a `GridDistance` to one goal or `GridDistances` between any two points. `polygon_distance`
returns a `PolygonDistance` or `PolygonDistances`; `polygons_of_discs` makes polygons around discs.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
