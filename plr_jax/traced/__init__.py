"""Shortest-path distances on grids and among polygons that may be traced, inside ``jax.jit``."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
